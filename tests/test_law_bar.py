"""When a law is told: beside a force without a form on runs kept aside; and where what saturates is looked for anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.held_out import worse_aside
from towline.diagnose.inference.hypothesis import with_effects
from towline.diagnose.inference.noise import Forces
from towline.diagnose.inference.ranking import Candidate
from towline.diagnose.law.answer import CLEARLY
from towline.diagnose.law.around import MOVED, distinct, elsewhere, fits, otherwise
from towline.diagnose.law.choose import Start
from towline.diagnose.law.functions import Range, State, begins, term
from towline.diagnose.law.terms import effect_like, effect_of, height_of, text_of
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.record.errors import EstimationError

T_S = 0.1 * np.arange(72)
NOISE = 0.02
SIZES = (1.0, 0.7, 1.3)
"""Of the missing part, one run's over another's."""


def inference_of(missing: Callable[[np.ndarray], np.ndarray], part: Callable[..., np.ndarray]) -> Inference:
    """Runs x = x0 + k t + size x missing(t), and a simulator whose effects are ``part``(effect's name, numbers, t)."""
    rng = np.random.default_rng(8)
    runs = [
        UsersRun(
            f"run-{k}", T_S, (0.5 * T_S + size * missing(T_S) + NOISE * rng.normal(size=len(T_S)))[:, None],
            NOISE**2 * np.eye(len(T_S))[None],
        )
        for k, size in enumerate(SIZES)
    ]  # fmt: skip

    def simulate(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
        found = n["x0"] + n["k"] * T_S[:, None, None]
        for name, numbers in effects.items():
            found = found + SIZES[int(run.name[-1])] * part(name, numbers, T_S[:, None])[:, None]
        return found

    simulator = UsersSimulator(
        runs, simulate, [UsersNumber("k", 0.5, size=0.5)], [UsersNumber("x0", [0.0] * 3)], usual_force=1e-3
    )
    return Inference(simulator, simulator.noise(simulator.starts()[0]))


def swinging(t: np.ndarray) -> State:
    """v = sin t / 10, and nothing else."""
    return State(0.1 * np.sin(t), *[0.0 * t] * 7)


def of_a_term(name: str, numbers: tuple[np.ndarray, ...], t: np.ndarray) -> np.ndarray:
    """What a term's effect does along that."""
    return numbers[0] * term(name.removeprefix("law ")).basis(swinging(t), *numbers[1:])[0]


def fitted(inference: Inference, effects: Sequence[Effect]) -> Fitted:
    start = with_effects(inference.simulator.starts()[0], effects)
    return inference.fit([start], [Forces()], 4, (1,))[0]


def test_a_wrong_law_leaves_more_of_the_runs_kept_aside_than_the_right_one() -> None:
    """A wave is missing; a law of a square is refused beside a wave, and not the other way round. Twins are neither."""
    shapes = {"square": lambda t: t**2, "wave": lambda t: np.sin(3 * t), "twin": lambda t: np.sin(3 * t)}
    inference = inference_of(lambda t: 0.1 * np.sin(3 * t), lambda name, n, t: n[0] * shapes[name](t))
    square, wave, twin = (
        fitted(inference, [Effect(name, "tank", (Parameter("size", "", 0.1),), "", "", sizes=(1.0,))])
        for name in shapes
    )
    assert worse_aside(inference, square, wave, None) > CLEARLY
    assert worse_aside(inference, wave, square, None) < -CLEARLY
    assert worse_aside(inference, wave, square, [1]) < -CLEARLY
    assert not worse_aside(inference, wave, twin, None) > CLEARLY
    assert np.isnan(worse_aside(inference, square, wave, [0, 1, 2]))


def test_what_saturates_is_found_from_a_start_at_another_place() -> None:
    """tanh(v/0.03) is missing, along v = sin t / 10, and a fit begins at tanh(v/0.003): a place looked at anew is near 0.03."""
    place, seen = 0.03, Range({"v": -0.1}, {"v": 0.1}, {"v": 0.07})

    inference = inference_of(lambda t: 0.2 * np.tanh(0.1 * np.sin(t) / place), of_a_term)
    effect = effect_of("tanh(v/0.003)", "Y", (0.2, 0.2))
    start = with_effects(inference.simulator.starts()[0], [effect])
    begun = [Start((effect,), start, Forces(), 0.0, 0.0)]
    begun, ended = fits(inference, begun)
    more = elsewhere(inference, begun, ended, seen)
    assert all(text_of(one.effects[0]).startswith("tanh(v/") for one in more)
    near = [one for one in more if abs(np.log(term(text_of(one.effects[0])).shapes[0].value / place)) < np.log(MOVED)]
    assert near
    best = max(fits(inference, more)[1], key=lambda f: f.log_evidence)
    assert best.hypothesis.numbers[0][-1] == pytest.approx(place, rel=0.2)
    assert best.log_evidence > ended[0].log_evidence


@pytest.mark.parametrize(("text", "free"), [("v|v|", "sign |v|^"), ("v^3", "sign |v|^"), ("sign |v|^4", "sign |v|^")])
def test_a_power_is_found_from_a_fixed_one_and_from_one_that_is_far_off(text: str, free: str) -> None:
    """sign |v|^2.4 is missing, along v = sin t / 10; its coefficient by another power is another by powers of ten."""
    power, seen = 2.4, Range({"v": -0.1}, {"v": 0.1}, {"v": 0.07})

    inference = inference_of(lambda t: 0.2 * np.sign(np.sin(t)) * np.abs(np.sin(t)) ** power, of_a_term)
    effect = effect_of(
        text, "Y", (0.2 / float(term(text).basis(swinging(np.array(1.0)), *[4.0][: "^4" in text])[0]),) * 2
    )
    start = with_effects(inference.simulator.starts()[0], [effect])
    begun, ended = fits(inference, [Start((effect,), start, Forces(), 0.0, 0.0)])
    more = elsewhere(inference, begun, ended, seen)
    assert all(text_of(one.effects[0]).startswith(free) for one in more)
    best = max(fits(inference, more)[1], key=lambda f: f.log_evidence)
    solved, at = best.solved, inference.fixed(best.hypothesis) + 1
    assert best.hypothesis.numbers[0][-1] == pytest.approx(power, abs=3 * np.sqrt(solved.covariance[at, at]))
    assert best.log_evidence > ended[0].log_evidence


SWUNG = swinging(np.linspace(0.0, 2 * np.pi, 400))
SEEN = Range({"v": -0.1}, {"v": 0.1}, {"v": 0.0707}, SWUNG)
"""What v = sin t / 10 has been."""


@pytest.mark.parametrize("rate", [1.7, 1.8, 2.2, 2.3])
def test_a_first_step_too_far_is_not_taken_for_noise(rate: float) -> None:
    """0.2 sin 2t is missing, and a fit begins at a tenth of its size and at another rate, less than a quarter turn off at the end:
    the first step is too long, and if random forces were found along it they would be as large as the whole."""

    def part(_: str, numbers: tuple[np.ndarray, ...], t: np.ndarray) -> np.ndarray:
        return numbers[0] * np.sin(numbers[1] * t)

    inference = inference_of(lambda t: 0.2 * np.sin(2 * t), part)
    effect = Effect("swing", "tank", (Parameter("size", "", 0.2), Parameter("rate", "", 1.0, none=rate)), "", "")
    start = inference.simulator.starts()[0]
    begun = replace(with_effects(start, [effect]), numbers=(np.array([0.02, rate]),))
    _, (end,) = fits(inference, [Start((effect,), begun, Forces(), 0.0, 0.0)])
    sd = np.sqrt(np.diag(end.solved.covariance)[inference.fixed(start) :])
    np.testing.assert_array_less(np.abs(end.hypothesis.numbers[0] + end.solved.shared[-2:] - [0.2, 2.0]), 4 * sd)


@pytest.mark.parametrize("text", ["sign |v|^5", "tanh(v/0.003)", "beyond(v/0.06, 0.1 round)", "wave(12 y)"])
def test_another_form_of_a_term_may_be_as_strong(text: str) -> None:
    """What is usual is a force: by the fifth power a coefficient is 5,000 times that of v|v| along v = sin t / 10."""
    states = State(SWUNG.v, SWUNG.r, 2 * SWUNG.v, *[0.0 * SWUNG.v] * 5)
    seen = Range(SEEN.low, SEEN.high, SEEN.usual, states)
    plain = effect_of("v|v|", "Y and N", (0.2, 0.05))
    other = effect_like(plain, text, "Y and N", seen)
    forces = [
        [p.sd * height_of(text_of(e), "Y", states) for p in e.parameters if p.name[0] == channel]
        for e in (plain, other)
        for channel in "yn"
    ]
    np.testing.assert_allclose([one[0] for one in forces[2:]], [one[0] for one in forces[:2]])


def test_a_step_in_a_power_leaves_the_force_where_it_is() -> None:
    """The force at half the furthest drift changes as the straight step says, whatever becomes of the coefficient."""
    effect = effect_of("sign |v|^2", "Y", (0.2,), SEEN.ends)
    assert effect.moved is not None
    numbers, step, half = np.array([3.0, 2.0]), np.array([0.5, 0.7]), 0.05
    after = effect.moved(numbers, step)
    straight = half**2 * (numbers[0] + step[0] + numbers[0] * np.log(half) * step[1])
    assert after[1] == pytest.approx(2.7)
    assert after[0] * half ** after[1] == pytest.approx(straight)
    small = effect.moved(numbers, 1e-5 * step)
    np.testing.assert_allclose(small, numbers + 1e-5 * step, rtol=1e-8)


def test_a_threshold_is_found_where_a_fit_has_two_powers() -> None:
    """What begins gently at v = 0.06 is missing, along v = sin t / 10; v|v| and v^5 together are like it."""
    inference = inference_of(lambda t: 0.4 * begins(np.sin(t) / 0.6, 0.1), of_a_term)
    effects = tuple(effect_of(text, "Y", (0.2 / 0.1**power,), SEEN.ends) for text, power in (("v|v|", 2), ("v^5", 5)))
    pair = [Start(effects, with_effects(inference.simulator.starts()[0], effects), Forces(), -11.7, 0.0)]
    pair, ended = fits(inference, pair)
    looked = otherwise(inference, pair, ended, SEEN, -5.9)
    alone = [one for one in looked if len(one.effects) == 1]
    assert all(one.log_prior == -5.9 for one in alone)
    starts, ends = fits(inference, alone)
    best = max(range(len(ends)), key=lambda k: ends[k].log_evidence)
    assert text_of(starts[best].effects[0]).startswith("beyond(v/")
    assert ends[best].hypothesis.numbers[0][1] == pytest.approx(0.06, rel=0.15)
    assert ends[best].log_evidence - 5.9 > ended[0].log_evidence - 11.7


def tried(text: str, evidence: float, acts: str = "Y") -> Candidate:
    nothing: Any = None
    return Candidate((effect_of(text, acts, (0.1, 0.1)),), nothing, evidence, -5.9)


def test_a_fixed_power_and_a_free_one_are_one_law_of_both_weights() -> None:
    """Told with the free power, from whichever start it is the best; a moment and a saturation are others."""
    fixed, cubed, free, worse = (
        tried("v|v|", 20.0), tried("v^3", 17.0), tried("sign |v|^2.5", 19.0), tried("sign |v|^4", 18.0)
    )  # fmt: skip
    moment, tanh, nothing = tried("v|v|", 21.0, "N"), tried("tanh(v/0.05)", 15.0), tried("v r", np.nan)
    found = {
        one.effects[0].label: (one, others)
        for one, others in distinct([fixed, cubed, free, worse, moment, tanh, nothing])
    }
    assert set(found) == {c.effects[0].label for c in (free, moment, tanh)}
    one, others = found[free.effects[0].label]
    assert one.log_evidence == free.log_evidence
    assert one.weight == pytest.approx(np.log(np.exp(20.0) + np.exp(17.0) + np.exp(19.0)) - 5.9)
    assert {c.effects for c in others} == {fixed.effects, cubed.effects}
    assert found[tanh.effects[0].label] == (tanh, [])


def test_a_power_that_was_not_found_is_not_told() -> None:
    """Where a fit from another power stays far behind the fixed one, the fixed one is told."""
    fixed, stuck = tried("r^2", 54.8), tried("|r|^1.5", -15.2)
    ((one, others),) = distinct([stuck, fixed])
    assert (one.effects, others) == (fixed.effects, [stuck])


def test_a_start_whose_motion_runs_off_is_left_out_and_the_others_are_fitted() -> None:
    inference = inference_of(
        lambda t: 0.1 * t**2, lambda name, n, t: n[0] * (np.exp(1e4 * t) if name == "off" else t**2)
    )
    starts = []
    for name in ("square", "off"):
        effect = Effect(name, "tank", (Parameter("size", "", 0.1),), "", "", sizes=(1.0,))
        starts.append(Start((effect,), with_effects(inference.simulator.starts()[0], [effect]), Forces(), 0.0, 0.0))
    with np.errstate(all="ignore"):
        with pytest.raises(EstimationError, match="beyond bounds"):
            fitted(inference, starts[1].effects)
        kept, ended = fits(inference, starts)
    assert [one.effects[0].name for one in kept] == ["square"]
    assert ended[0].hypothesis.numbers[0][0] == pytest.approx(0.1, abs=0.01)
