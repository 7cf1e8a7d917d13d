"""The corrected model step by step, and as an FMU that wraps the old one: the course of what was fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towline.cli import main
from towline.diagnose.effects import Parameter
from towline.diagnose.own import Input, Missing, Model, Number, Output, State
from towline.diagnose.own.back import put_in
from towline.diagnose.own.back_fmu import Wrapped, check_wrappable
from towline.diagnose.own.course import Grid, held, simulated
from towline.diagnose.own.library import Scales, library_for
from towline.diagnose.own.model import System
from towline.diagnose.own.read import read_model
from towline.record import InputError

EQUATIONS = """
import numpy as np
from towline.diagnose.own import Input, Model, Number, Output, State

MODEL = Model(
    states=[State("v", "m/s", 0.2, equation="cart")],
    inputs=[Input("pull", "N", stage="motor")],
    numbers=[Number("a", "1/s", 0.5, least=0.0), Number("gain", "1/kg", 1.2)],
    outputs=[Output("v", "m/s", stage="encoder")],
    rates=lambda t, x, u, p: [p.gain * u.pull - p.a * x.v],
)
"""
SPRING = Model(
    [State("x", "m", 0.3), State("v", "m/s", -0.2)],
    [Input("pull", "N"), Input("valve", "")],
    [Number("k", "1/s2", 4.0), Number("c", "1/s", 0.3)],
    [Output("x", "m"), Output("v", "m/s")],
    lambda t, x, u, p: (x.v, u.pull + u.valve * x.x - p.k * x.x - p.c * x.v),
)
OFFERED = {
    m.name: m
    for m in library_for(
        SPRING,
        {"x": "v"},
        Scales(
            {"x": 0.5, "v": 1.0}, {"x": 1.0, "v": 2.0}, {"x": 1.0, "v": 2.0}, ["x", "v"], {"pull": 1.0, "valve": 0.5},
            {"x": 0.5, "v": 1.0}, {"x": 0.3, "v": 0.7, "pull": 0.7, "valve": 0.3}, 0.05, 3.0,
        ),
    )
}  # fmt: skip
COUNT, STEP_S = 60, 0.05
PULL = np.sin(0.31 * np.arange(COUNT)) + (np.arange(COUNT) > 30)
VALVE = 0.5 * np.cos(0.1 * np.arange(COUNT))


def stepped(system: System, inner: int) -> np.ndarray:
    one = Wrapped(system, STEP_S / inner)
    one.inputs.update(pull=PULL[0], valve=VALVE[0])
    one.begin()
    found = [list(one.outputs.values())]
    for k in range(COUNT - 1):
        one.inputs.update(pull=PULL[k], valve=VALVE[k])
        one.step(STEP_S)
        found.append(list(one.outputs.values()))
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [("v_lugre_friction", (0.2, 0.1, 0.02, 0.005)), ("pull_lag", (0.12,)), ("pull_delay", (0.07,)), ("pull_backlash", (0.3,)),
     ("valve_saturation", (0.2,)), ("v_lag", (0.1,)), ("x_drift", (0.04,))],
)  # fmt: skip
def test_step_by_step_it_is_the_course_of_the_fit(name: str, numbers: tuple[float, ...]) -> None:
    """Inputs that stay until the next sample: what is missing sees no more of them than at once."""
    system = put_in(SPRING, {"k": 5.0}, [(OFFERED[name], numbers)])
    grid = Grid(STEP_S, COUNT, 4, (True, True))
    start = np.array([[0.3], [-0.2]])
    p = np.array([[5.0], [0.3]])
    known = simulated(system, grid, start, held(np.stack([PULL, VALVE], axis=1), grid)[..., None], p)[:, :, 0]
    found = stepped(system, 4)
    # the last row's outputs see the inputs that are there by then
    np.testing.assert_allclose(found[:-1], known[:-1], rtol=0, atol=1e-9)
    plain = simulated(
        put_in(SPRING, {"k": 5.0}), grid, start, held(np.stack([PULL, VALVE], axis=1), grid)[..., None], p
    )
    assert np.abs(plain[:, :, 0] - known).max() > 1e-3


def test_what_no_step_can_know_is_said() -> None:
    clock, late = OFFERED["clock_rate"], OFFERED["pull_delay"]
    with pytest.raises(
        InputError, match=r"clock_rate: is of the clock by which it was recorded, and no part of the model"
    ):
        check_wrappable(SPRING, [(clock, (0.01,))])
    with pytest.raises(InputError, match=r"pull_delay: comes earlier than it is written down"):
        check_wrappable(SPRING, [(late, (-0.1,))])
    with pytest.raises(InputError, match=r"runs by itself \(co-simulation\)"):
        check_wrappable(replace(SPRING, whole=True))
    one = Wrapped(SPRING, 0.01)
    one.begin()
    one.step(0.1)
    with pytest.raises(InputError, match=r"0\.2 s after steps of 0\.1 s; all must be alike"):
        one.step(0.2)


@pytest.mark.slow
def test_the_command_writes_an_fmu_that_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Written by the command, read by fmpy as any other FMU, to 1e-6 of corrected.py with inputs that stay."""
    pytest.importorskip("fmpy", reason="fmpy, which reads FMUs, is not installed (the extra fmu)")
    pytest.importorskip("pythonfmu", reason="pythonfmu, which writes FMUs, is not installed (the extra fmu)")
    (tmp_path / "cart.py").write_text(EQUATIONS)
    (tmp_path / "data.toml").write_text(
        '[clock]\ncolumn = "t"\n[[column]]\nname = "v"\nrole = "output"\nnoise_sd = 0.01\n'
        '[[column]]\nname = "pull"\nrole = "input"\nhold = "step"\n'
    )
    model = read_model(tmp_path / "cart.py")
    zero = Missing("zero", (Parameter("b", "N", 0.1),), "", "", lambda t, u, b: u + b, input="pull")
    grid = Grid(STEP_S, COUNT, 8, (True,))
    p, start = np.array([[0.5], [1.2]]), np.array([[0.2]])
    truth = put_in(model, {}, [(zero, [0.3])])
    v = simulated(truth, grid, start, held(PULL[:, None], grid)[..., None], p)[:, 0, 0]
    rows = np.column_stack([STEP_S * np.arange(COUNT), v + 0.01 * np.random.default_rng(3).normal(size=COUNT), PULL])
    np.savetxt(tmp_path / "pulled.csv", rows, "%.6f", ",", header="t,v,pull", comments="")
    assert main(["gap", str(tmp_path / "cart.py"), str(tmp_path / "pulled.csv"), "--fmu"]) == 0
    assert "corrected.fmu" in capsys.readouterr().out
    fmu, new = read_model(tmp_path / "out" / "corrected.fmu"), read_model(tmp_path / "out" / "corrected.py")
    assert [i.name for i in fmu.inputs] == ["pull"]
    told = {n.name: n.start for n in new.numbers} | {"start_v": 0.2}
    assert {n.name: n.start for n in fmu.numbers} == pytest.approx(told, rel=1e-12)
    grid = Grid(STEP_S, COUNT, 4, (True,))
    halves = held(PULL[:, None], grid)[..., None]
    one, other = (
        simulated(m, grid, at, halves, np.array([[n.start] for n in m.numbers]))[:, 0, 0]
        for m, at in ((fmu, np.zeros((len(fmu.states), 1))), (new, start))
    )
    assert np.abs(other - v).max() < 0.02
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)
