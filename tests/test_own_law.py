"""A law for a model of one's own: a term of its states that no effect of the library is, by ``towline gap --law``."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towline.cli import main
from towline.diagnose.own import Model, Output, State
from towline.diagnose.own.back import run_model
from towline.diagnose.own.library import Scales, library_for
from towline.diagnose.own.read import read_model
from towline.diagnose.own.terms import laws_for

W2, C, NOISE_RAD, STEP_S, COUNT = 45.0, 0.1, 1e-3, 0.05, 120
START_RAD = 1.4
MODEL = """
import numpy as np
from towline.diagnose.own import Model, Number, Output, State

MODEL = Model(
    [State("angle", "rad"), State("rate", "rad/s")],
    [],
    [Number("w2", "1/s2", 40.0, least=0.0), Number("c", "1/s", 0.2, least=0.0)],
    [Output("angle", "rad", stage="encoder")],
    lambda t, x, u, p: (x.rate, -p.w2 * {pull} - p.c * x.rate),
)
"""
TABLE = '[clock]\ncolumn = "t_s"\n\n[[column]]\nname = "angle_rad"\nrole = "output"\nof = "angle"\nnoise_sd = 0.001\n'


def swing() -> tuple[np.ndarray, np.ndarray]:
    """Times and the angle of a pendulum let go at 80 degrees, by scipy."""
    t_s = STEP_S * np.arange(COUNT)

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -W2 * np.sin(y[0]) - C * y[1]]

    return t_s, solve_ivp(rates, (0, t_s[-1]), (START_RAD, 0.0), t_eval=t_s, rtol=1e-9, atol=1e-11).y[0]


def asked(folder: Path, pull: str) -> dict:
    """gap.json of a pendulum that pulls back with ``pull``."""
    t_s, angle = swing()
    seen = angle + NOISE_RAD * np.random.default_rng(2).normal(size=COUNT)
    np.savetxt(folder / "swing.csv", np.c_[t_s, seen], "%.6f", ",", header="t_s,angle_rad", comments="")
    (folder / "pendulum.py").write_text(MODEL.format(pull=pull))
    (folder / "data.toml").write_text(TABLE)
    assert main(["gap", str(folder / "pendulum.py"), str(folder / "swing.csv"), "--law"]) == 0
    return json.loads((folder / "out" / "gap.json").read_text())


@pytest.mark.slow
def test_equations_of_small_swings_lack_a_sine(tmp_path: Path) -> None:
    """Its size is -w^2, that of the term beside it; the corrected model swings as the truth does."""
    file = asked(tmp_path, "x.angle")
    name = "law rate: sin(angle) - angle"
    first = file["ranking"][0]
    assert file["verdict"] == "effect"
    assert first["effects"] == [name]
    size, w2 = first["parameters"][f"{name}.size"], file["derivatives"]["after"]["w2"]
    assert abs(size["value"] + W2) < 4 * size["std"] < 0.1 * W2
    assert abs(w2["value"] - W2) < 4 * w2["std"] < 0.05 * W2
    again = run_model(read_model(tmp_path / "out" / "corrected.py"), STEP_S, COUNT, {"angle": START_RAD})["angle"]
    # a release that was fitted is off by a part of the noise; its swing stays so
    assert np.abs(again - swing()[1]).max() < 5 * NOISE_RAD


def test_no_term_is_missing_from_the_whole_equation(tmp_path: Path) -> None:
    file = asked(tmp_path, "np.sin(x.angle)")
    assert file["verdict"] == "no_gap"
    assert file["p_no_gap"] > 0.5


def test_a_term_is_what_it_is_written_as() -> None:
    """Of two states in both equations, an angle among them: read as Python each gives what the fit puts in; none twice."""
    model = Model(
        [State("a", "rad"), State("b", "m")], [], [], [Output("a", "rad")], lambda t, x, u, p: (-x.a + x.b, -x.b)
    )
    sizes = {"a": 0.7, "b": 2.0}
    scales = Scales(sizes, sizes, sizes, ["a", "b"], {}, {"a": 0.7}, {"a": 0.3}, 0.1, 10.0)
    terms = laws_for(model, {}, scales)
    names = [m.name for m in (*terms, *library_for(model, {}, scales))]
    assert len(set(names)) == len(names)
    x = SimpleNamespace(a=np.array([0.4, -1.1]), b=np.array([-3.0, 0.2]))
    seen = {}
    for m in terms:
        value = m.changes(0.0, x, None, None, 1.7)
        np.testing.assert_allclose(eval(m.code, {"np": np, "x": x, "size": 1.7}), value, rtol=1e-14)
        # at the usual state it is a share of the usual rate for a number of the usual size
        usual = SimpleNamespace(a=np.array(0.7), b=np.array(2.0))
        share = m.changes(0.0, usual, None, None, m.parameters[0].sd) / sizes[m.equation]
        assert abs(share) == pytest.approx(0.1, rel=1e-2)
        seen.setdefault(m.equation, []).append(tuple(np.round(value / np.abs(value).max(), 12)))
    assert {e: len(set(rows)) for e, rows in seen.items()} == {e: len(rows) for e, rows in seen.items()}
    assert any("sin(a)" in name for name in names)
    assert not any("sin(b)" in name for name in names)
