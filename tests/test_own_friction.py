"""Friction that gives before it slides (LuGre), against closed forms and an integrator that shares nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towline.diagnose.own import Input, Missing, Model, Number, Output, State
from towline.diagnose.own.back import from_file, put_in, run_model
from towline.diagnose.own.course import over_step, relaxed
from towline.diagnose.own.friction import LEAST_GIVES, STRIBECK, frictions
from towline.record import InputError
from towline.record.corrected_file import CorrectedFile, PutIn
from towline.record.results import Measured

SLIDING, STICKING, GIVE, TIME_S = 0.3, 0.2, 0.02, 0.01
SIZE, RATE = 1.0, 2.0
SLOW, LEAST = STRIBECK * SIZE, LEAST_GIVES * SIZE**2 / RATE
NUMBERS = (SLIDING, STICKING, float(np.sqrt(GIVE**2 - LEAST**2)), TIME_S)
"""What is beyond the least that bristles give."""
LUGRE = frictions("v", 0.2, SIZE, RATE)[2]
CART = Model(
    [State("x", "m"), State("v", "m/s")],
    [Input("pull", "m/s2")],
    [Number("c", "1/s", 0.5)],
    [Output("x", "m"), Output("v", "m/s")],
    lambda t, x, u, p: (x.v, u.pull - p.c * x.v),
)


def rubbed(model: Model, missing: Missing = LUGRE, numbers: tuple[float, ...] = NUMBERS) -> Model:
    made = put_in(model, {}, [(missing, numbers)])
    assert isinstance(made, Model)
    return made


@pytest.mark.once
@pytest.mark.parametrize("speed", [-2.0, 0.03, 0.1, 0.6])
def test_steady_sliding_follows_stribecks_curve(speed: float) -> None:
    """A cart whose motor holds the speed, 50 (u - v): what it lacks of it is the friction over 50."""
    driven = replace(CART, rates=lambda t, x, u, p: (x.v, 50.0 * (u.pull - x.v)))
    v = run_model(rubbed(driven), 0.04, 750, {"v": speed}, {"pull": np.full(750, speed)})["v"][-1]
    friction = SLIDING + STICKING * np.exp(-((v / SLOW) ** 2))
    assert 50.0 * (speed - v) == pytest.approx(np.sign(speed) * friction, rel=1e-6)


def test_before_it_slides_it_is_a_spring_of_sigma_0() -> None:
    """A pull that grows slowly to F m: the bristles hold it, and x = -give ln(1 - m), at first give/F of the pull: 1/sigma_0."""
    t = 0.05 * np.arange(641)
    held = SLIDING + STICKING
    for m in (0.02, 0.5):
        # without a jerk, as a swing about where it is held would creep
        pull = m * held * np.sin(np.pi * np.minimum(t, 30.0) / 60.0) ** 2
        x = run_model(rubbed(CART, numbers=(*NUMBERS[:3], 0.1)), 0.05, len(t), {}, {"pull": pull}, inner=2)["x"][-1]
        # so slow that Stribeck's curve is at its top, but for (v/slow)^2 < 1e-4, and the cart's own forces are 1e-3 of the pull
        assert x == pytest.approx(-GIVE * np.log1p(-m), rel=1e-3)
    slope = -GIVE * np.log1p(-0.02) / (0.02 * held)
    assert slope == pytest.approx(GIVE / held, rel=0.011)


def swung(inner: int, step_s: float = 0.05, count: int = 80) -> np.ndarray:
    spring = replace(CART, rates=lambda t, x, u, p: (x.v, -4.0 * x.x - p.c * x.v))
    return run_model(rubbed(spring), step_s, count, {"x": 1.0}, {}, inner=inner)["x"]


def test_smaller_steps_come_to_the_equations_themselves() -> None:
    """A swing that sticks at last, by Radau with z as an ordinary state: second order, where it turns, leaves a thousandth of 32
    times the step."""
    held, t = SLIDING + STICKING, 0.05 * np.arange(80)

    def rates(t: float, y: np.ndarray) -> list[float]:
        x, v, z = y
        sigma = held / GIVE
        dz = v - sigma * abs(v) * z / (SLIDING + STICKING * np.exp(-((v / SLOW) ** 2)))
        return [v, -4.0 * x - 0.5 * v - sigma * z - sigma * TIME_S * dz, dz]

    known = solve_ivp(rates, (0, t[-1]), (1.0, 0.0, 0.0), method="Radau", t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    coarse, fine = (np.abs(swung(inner) - known).max() for inner in (1, 32))
    assert coarse < 2e-4
    # the turns fall anywhere between two steps: a factor of four to either side
    assert fine < 4 * coarse / 32**2


def test_bristles_that_hardly_give_are_stribecks_friction() -> None:
    static = frictions("v", 0.2, SIZE, RATE)[1]
    spring = replace(CART, rates=lambda t, x, u, p: (x.v, -4.0 * x.x - p.c * x.v))
    numbers = ((SLIDING, STICKING), (SLIDING, STICKING, 0.0, 0.0))
    one, other = (
        run_model(rubbed(spring, m, n), 0.02, 120, {"x": 1.0}, inner=8)["x"]
        for m, n in zip((static, LUGRE), numbers, strict=True)
    )
    # bristles take hold over the least that they give; let go at 1 m, that time passes without friction: a push that is missing
    push = (SLIDING + STICKING) * np.sqrt(2 * LEAST / (4.0 - SLIDING - STICKING))
    assert np.abs(one - other)[:60].max() < push / 2.0
    assert np.abs(one - run_model(spring, 0.02, 120, {"x": 1.0})["x"])[:60].max() > 0.05


def test_a_memory_however_fast_stays_within_bounds_and_slow_ones_are_of_fourth_order() -> None:
    one = np.ones(1)
    assert relaxed(5 * one, 1e12 * 3 * one, 1e12 * one)[0] == pytest.approx(3.0)
    assert relaxed(one, 0.5 * one, 0.0 * one)[0] == 1.5

    def left(count: int) -> float:
        """m' = cos t - (1 + t) m to t = 1, by steps."""
        h, m = 1.0 / count, one
        for k in range(count):
            at = [(np.cos(s) * one, (1 + s) * one) for s in (k * h, (k + 0.5) * h, (k + 0.5) * h, (k + 1) * h)]
            m = over_step(h, m, *at)
        return float(m[0])

    known = solve_ivp(lambda t, m: np.cos(t) - (1 + t) * m, (0, 1), [1.0], rtol=1e-12, atol=1e-13).y[0, -1]
    errors = [abs(left(n) - known) for n in (4, 8, 16)]
    assert errors[0] / errors[1] > 12
    assert errors[1] / errors[2] > 12


def test_it_comes_back_from_a_file_as_it_was() -> None:
    def number(value: float) -> Measured:
        return Measured(value=value, std=0.0)

    values = dict(zip([q.name for q in LUGRE.parameters], NUMBERS, strict=True))
    put = PutIn(
        effect=LUGRE.name,
        acts="equation",
        on="v",
        code=LUGRE.code,
        memory=LUGRE.memory_code,
        numbers={name: number(v) for name, v in values.items()},
    )
    file = CorrectedFile(
        schema="towline/corrected", tool="", inputs={}, model="cart", numbers={"c": number(0.5)}, effects=[put]
    )
    pull = {"pull": np.sin(0.1 * np.arange(100))}
    one, other = (run_model(m, 0.1, 100, {}, pull)["x"] for m in (rubbed(CART), from_file(file, CART)))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    bad = put.model_copy(update={"memory": "(m, __import__('os'))"})
    with pytest.raises(InputError, match="its code is none that towline writes"):
        from_file(file.model_copy(update={"effects": [bad]}), CART)
