"""A model of one's own as equations: its course against closed forms, where it begins, what it misses, the corrected model back."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import towline
from towline.cli import main
from towline.diagnose.effects import Parameter
from towline.diagnose.own import Input, Missing, Model, Number, Output, State
from towline.diagnose.own.back import corrected, from_file, put_in, run_model
from towline.diagnose.own.course import Grid, Put, held, read_at, simulated
from towline.diagnose.own.gap import OwnGap, own_gap
from towline.diagnose.own.library import delayed, lagged, limited, played
from towline.diagnose.own.model import rate_of
from towline.diagnose.own.read import read_model
from towline.diagnose.own.records import Record, SampleNoise, together
from towline.diagnose.own.simulator import OwnSimulator
from towline.record import InputError
from towline.record.corrected_file import CorrectedFile
from towline.record.results import read_result

RNG = np.random.default_rng
W2, C, NOISE = 60.0, 0.15, 0.004
EQUATIONS = """
from towline.diagnose.own import Missing, Model, Number, Output, State
from towline.diagnose.effects import Parameter

MODEL = Model(
    states=[State("h", "m", size=1.0, equation="tank")],
    inputs=[],
    numbers=[Number("a", "1/s", 0.4, least=0.0)],
    outputs=[Output("h", "m", stage="gauge")],
    rates=lambda t, x, u, p: [-p.a * x.h],
)
"""


def pendulum(w2: float = W2, c: float = C) -> Model:
    return Model(
        [State("angle", "rad"), State("rate", "rad/s")],
        [],
        [Number("w2", "1/s2", w2, least=0.0), Number("c", "1/s", c, least=0.0)],
        [Output("angle", "rad", stage="encoder")],
        lambda t, x, u, p: (x.rate, -p.w2 * np.sin(x.angle) - p.c * x.rate),
    )


def swings(
    count: int = 150, step_s: float = 0.05, starts: tuple[float, ...] = (1.5,), friction: float = 0.0
) -> list[Record]:
    """Large swings by scipy, which shares nothing with what is tested."""
    t, rng, found = step_s * np.arange(count), RNG(1), []
    for k, start in enumerate(starts):

        def rates(t: float, y: np.ndarray) -> list[float]:
            return [y[1], -W2 * np.sin(y[0]) - C * y[1] - friction * np.tanh(y[1] / 0.05)]

        clean = solve_ivp(rates, (0, t[-1]), (start, 0.0), t_eval=t, rtol=1e-9, atol=1e-11).y[0]
        values = (clean + NOISE * rng.normal(size=count))[:, None]
        found.append(Record(f"swing-{k + 1}", step_s, np.zeros((count, 0)), values, (SampleNoise(NOISE),), ()))
    return found


def tank_rows(extra: Callable[[np.ndarray], np.ndarray] = np.zeros_like, count: int = 120) -> np.ndarray:
    """An emptying tank, h' = -0.5 h (and something more), noise 1 mm."""
    t = 0.05 * np.arange(count)
    return np.column_stack([t, np.exp(-0.5 * t) + extra(t) + 1e-3 * RNG(3).normal(size=count)])


def tank_folder(folder: Path, rows: np.ndarray, model: str = EQUATIONS) -> Path:
    (folder / "tank.py").write_text(model)
    text = "\n".join(f"{t:.3f},{1e3 * h:.4f}" for t, h in rows)
    (folder / "emptied.csv").write_text(f"t_s,h_mm\n{text}\n")
    (folder / "data.toml").write_text(
        '[clock]\ncolumn = "t_s"\n\n[[column]]\nname = "h_mm"\nrole = "output"\nof = "h"\nunit = "mm"\nnoise_sd = 1.0\n'
    )
    return folder


# courses -------------------------------------------------------------------------------------------------------------


def test_a_driven_lag_follows_its_closed_form() -> None:
    """x' = (u - x)/T of a command that jumps in the middle: exponentials on both sides, to what RK4 leaves (h/T)^4/120."""
    time_s, step_s, count = 0.7, 0.1, 60
    model = Model(
        [State("x")],
        [Input("u")],
        [Number("time_s", "s", time_s)],
        [Output("x")],
        lambda t, x, u, p: [(u.u - x.x) / p.time_s],
    )
    u = np.where(np.arange(count) < 20, 1.0, -2.0)
    grid = Grid(step_s, count, 4, (True,))
    found = simulated(model, grid, np.zeros((1, 1)), held(u[:, None], grid)[..., None], np.array([[time_s]]))[:, 0, 0]
    t = grid.times_s
    jump = 20 * step_s
    known = np.where(t < jump, 1 - np.exp(-t / time_s), 0.0)
    there = 1 - np.exp(-jump / time_s)
    known = np.where(t >= jump, -2 + (there + 2) * np.exp(-(t - jump) / time_s), known)
    assert np.abs(found - known).max() < 20 * (step_s / 4 / time_s) ** 4


def test_a_model_may_be_written_for_one_number_at_a_time() -> None:
    """With math's functions and an ``if``: the same course."""
    import math

    def plain(t, x, u, p):
        if x.rate > 1e9:
            return 0.0, 0.0
        return x.rate, -p.w2 * math.sin(x.angle) - p.c * x.rate

    slow = Model(pendulum().states, [], pendulum().numbers, pendulum().outputs, plain)
    start = {"angle": 1.0}
    one, other = (run_model(m, 0.05, 40, start)["angle"] for m in (pendulum(), slow))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert rate_of(slow) == rate_of(pendulum()) == {"angle": "rate"}


def test_what_is_wrong_in_the_equations_is_said() -> None:
    def one_short(t, x, u, p):
        return [x.rate]

    model = Model(pendulum().states, [], pendulum().numbers, pendulum().outputs, one_short, name="short.py")
    with pytest.raises(InputError, match=r"short\.py: rates: gave 1 values, expected 2"):
        run_model(model, 0.1, 20)

    def misspelt(t, x, u, p):
        return x.rate, -p.w3

    model = Model(pendulum().states, [], pendulum().numbers, pendulum().outputs, misspelt, name="other.py")
    with pytest.raises(InputError, match=r"other\.py: rates: AttributeError: .*w3"):
        run_model(model, 0.1, 20)


def test_inputs_and_outputs_change_as_their_words_say() -> None:
    t = np.linspace(0, 10, 401)
    ramp = (2 * t)[:, None]
    # behind a first-order lag a ramp is late by the time constant, once it has set in
    late = lagged(t, ramp, np.array([0.5]))
    np.testing.assert_allclose(late[200:, 0], 2 * (t[200:] - 0.5), atol=2 * 0.5 * np.exp(-10) * 1.01)
    np.testing.assert_allclose(delayed(t, ramp, np.array([0.33]))[100:, 0], 2 * (t[100:] - 0.33), atol=1e-12)
    np.testing.assert_allclose(lagged(t, ramp, np.array([0.0])), ramp, atol=1e-6)
    wave = np.sin(t)[:, None]
    assert np.abs(limited(wave, np.array([0.4]))).max() == 0.4
    # play of 0.2: on the way up the output is half of it below, on the way down above
    behind = played(wave, np.array([0.2]))[:, 0]
    up, down = (t > 4 * np.pi / 2) & (t < 5 * np.pi / 2 - 1e-9) & (np.sin(t) > -0.7), (t > 2.2) & (t < 4.7)
    np.testing.assert_allclose(behind[up], wave[up, 0] - 0.1, atol=1e-12)
    np.testing.assert_allclose(behind[down], wave[down, 0] + 0.1, atol=1e-12)
    # a parabola is read between its samples exactly
    square = (t**2)[:, None, None]
    np.testing.assert_allclose(
        read_at(square, np.full((401, 1), 0.3))[5:-5, 0, 0], (t[5:-5] + 0.3 * 0.025) ** 2, atol=1e-9
    )


def test_what_is_put_in_is_part_of_the_model() -> None:
    """h' = -a h - q h|h|, as a missing term and written out."""
    missing = Missing(
        "drag", (Parameter("q", "1/(m s)", 0.1),), "", "", lambda t, x, u, p, q: -q * x.h * np.abs(x.h), equation="h"
    )
    plain = Model([State("h", "", 1.0)], [], [Number("a", "", 0.4)], [Output("h")], lambda t, x, u, p: [-p.a * x.h])
    whole = Model(
        plain.states, [], plain.numbers, plain.outputs, lambda t, x, u, p: [-p.a * x.h - 0.3 * x.h * np.abs(x.h)]
    )
    grid = Grid(0.1, 50, 2)
    nothing = np.zeros((len(grid.half_s), 0, 1))
    beside = simulated(plain, grid, np.ones((1, 1)), nothing, np.array([[0.4]]), [Put(missing, (np.array([0.3]),))])
    built = run_model(put_in(plain, {"a": 0.4}, [(missing, [0.3])]), 0.1, 50, inner=2)["h"]
    known = run_model(whole, 0.1, 50, inner=2)["h"]
    np.testing.assert_allclose(beside[:, 0, 0], known, rtol=1e-13)
    np.testing.assert_allclose(built, known, rtol=1e-13)


# where it begins -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_large_swings_begin_within_a_factor_of_three() -> None:
    """Swings of 86 degrees, seven seconds, w2 and c up to three times off: one optimum, that of the start at the truth."""
    records = together(swings())
    ends = [
        OwnSimulator(pendulum(share * W2, other * C), records.records, records.size).starts()[0]
        for share, other in ((1.0, 1.0), (0.34, 2.9), (2.9, 0.34), (3.0, 3.0))
    ]
    for end in ends[1:]:
        np.testing.assert_allclose(end.shared, ends[0].shared, rtol=1e-4)
    assert abs(ends[0].shared[0] - W2) < 0.1


def found_of(model: Model, records: list[Record], **options) -> OwnGap:
    return own_gap(model, together(records), "test", {}, rng=RNG(0), **options)


def tank(**number) -> Model:
    return Model(
        [State("h", "m", equation="tank")],
        [],
        [Number("a", "1/s", 0.4), Number("b", "m/s", **number)],
        [Output("h", "m", stage="gauge")],
        lambda t, x, u, p: [p.b - p.a * x.h],
    )


def emptied(level: float, count: int = 100) -> list[Record]:
    """h' = b - a h to the level b/a = level, a = 0.5."""
    t = 0.06 * np.arange(count)
    values = level + (1 - level) * np.exp(-0.5 * t) + 1e-3 * RNG(5).normal(size=count)
    return [Record("emptied", 0.06, np.zeros((count, 0)), values[:, None], (SampleNoise(1e-3),), ())]


def test_a_one_sided_number_leaves_zero_and_comes_back_to_it() -> None:
    """b >= 0, begun at its bound: 0.1 where the level ends at 0.2, and at the bound where the level ends below nothing."""
    found = found_of(tank(start=0.0, size=0.1, least=0.0), emptied(0.2)).file
    b = found.derivatives["before"]["b"]
    assert found.verdict == "no_gap"
    assert abs(b.value - 0.1) < 4 * b.std < 0.01
    held_at = OwnSimulator(tank(start=0.05, size=0.1, least=0.0), together(emptied(-0.05)).records, 1).starts()[0]
    assert held_at.shared[1] == 0.0


# the diagnosis -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_complete_model_begun_three_times_off_misses_nothing() -> None:
    found = found_of(pendulum(2.9 * W2, 0.4 * C), swings()).file
    assert found.verdict == "no_gap"
    for name, value in (("w2", W2), ("c", C)):
        fitted = found.derivatives["before"][name]
        assert abs(fitted.value - value) < 4 * fitted.std
    assert set(found.where.share) <= {"rate", "encoder", "clock"}
    assert set(found.noise) == {"rate", "time_s"}


@pytest.fixture(scope="module")
def leaky(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, str]:
    """The command on a tank whose gauge drifts by 50 mm: folder, exit code, what it said."""
    folder = tank_folder(tmp_path_factory.mktemp("tank"), tank_rows(lambda t: 0.05 * t / t[-1]))
    code = main(["gap", str(folder / "tank.py"), str(folder / "emptied.csv")])
    return folder, code, ""


@pytest.mark.slow
def test_the_command_says_what_is_missing_and_writes_it(leaky: tuple[Path, int, str]) -> None:
    folder, code, _ = leaky
    assert code == 0
    file = json.loads((folder / "out" / "gap.json").read_text())
    assert file["verdict"] == "effect"
    (name,) = file["ranking"][0]["effects"]
    # a drift of the gauge and what flows in all the time are h + b t and the same of a slow tank: one of the two
    assert name == "h_drift"
    size = file["ranking"][0]["parameters"]["h_drift.size"]
    assert abs(size["value"] - 0.05) < 4 * size["std"] < 0.05
    assert file["where"]["stage"] == "gauge"
    assert {str(p.name) for p in (folder / "out").iterdir()} == {"gap.json", "corrected.json", "corrected.py"}


@pytest.mark.slow
def test_the_corrected_model_comes_back_as_python_and_json(leaky: tuple[Path, int, str]) -> None:
    """Both give the course of what was fitted, to 1e-6 of its size."""
    folder, _, _ = leaky
    old = read_model(folder / "tank.py")
    new = read_model(folder / "out" / "corrected.py")
    file = read_result(folder / "out" / "corrected.json", CorrectedFile)
    again = from_file(file, old)
    courses = [run_model(m, 0.05, 120, {"h": 1.0})["h"] for m in (new, again)]
    a, size = file.numbers["a"].value, file.effects[0].numbers["size"].value
    t = 0.05 * np.arange(120)
    for course in courses:
        np.testing.assert_allclose(course, np.exp(-a * t) + size * t / t[-1], rtol=0, atol=1e-6)


def test_code_that_towline_does_not_write_is_not_run(leaky: tuple[Path, int, str]) -> None:
    folder, _, _ = leaky
    file = read_result(folder / "out" / "corrected.json", CorrectedFile)
    for code in ("__import__('os').getcwd()", "y.__class__", "np.load('x')", "(lambda: y)()", "y +"):
        put = file.effects[0].model_copy(update={"code": code})
        with pytest.raises(InputError, match="its code is no"):
            from_file(file.model_copy(update={"effects": [put]}), read_model(folder / "tank.py"))


def test_the_front_door_gives_the_same_and_corrects(tmp_path: Path) -> None:
    folder = tank_folder(tmp_path, tank_rows())
    found = towline.gap(folder / "tank.py", folder / "emptied.csv")
    assert found.verdict == "no_gap"
    assert "explains these records" in found.sentences[0]
    a = found.derivatives["before"]["a"]
    assert abs(a.value - 0.5) < 4 * a.std


@pytest.mark.slow
def test_an_effect_of_ones_own_is_named_and_one_that_is_left_out_is_unknown() -> None:
    """A pump that beats at 1.3 Hz: named where the model's author offers it, and unknown where not."""
    t = 0.08 * np.arange(70)
    values = np.exp(-0.5 * t) + 0.05 * np.sin(8 * t) + 1e-3 * RNG(2).normal(size=len(t))
    records = [Record("beaten", 0.08, np.zeros((70, 0)), values[:, None], (SampleNoise(1e-3),), ())]
    beat = Missing(
        "beat",
        (Parameter("size", "m", 0.05),),
        "The pump beats.",
        "Take another pump.",
        lambda t, y, a: y + a * np.sin(8 * t)[:, None],
        output="h",
    )
    plain = Model([State("h", "m")], [], [Number("a", "1/s", 0.4)], [Output("h", "m")], lambda t, x, u, p: [-p.a * x.h])
    with_it = Model(plain.states, [], plain.numbers, plain.outputs, plain.rates, missing=[beat])
    found = found_of(with_it, records)
    assert found.file.verdict == "effect"
    assert found.file.ranking[0].effects == ["beat"]
    fixed = corrected(found)
    assert run_model(fixed, 0.05, 70, {"h": 1.0})["h"][20] == pytest.approx(np.exp(-0.5) + 0.05 * np.sin(8.0), abs=3e-3)
    assert found_of(plain, records).file.verdict == "unknown"


def glides(power: float) -> list[Record]:
    """A cart that coasts to either side and drags with a power of its speed: v' = -0.5 v - 0.4 v |v|^(power - 1)."""
    t, rng, found = 0.075 * np.arange(80), RNG(4), []

    def rates(t: float, v: np.ndarray) -> np.ndarray:
        return -0.5 * v - 0.4 * v * np.abs(v) ** (power - 1)

    for k, start in enumerate((1.5, -1.0)):
        clean = solve_ivp(rates, (0, t[-1]), (start,), t_eval=t, rtol=1e-9, atol=1e-11).y[0]
        values = (clean + 1e-3 * rng.normal(size=len(t)))[:, None]
        found.append(Record(f"glide-{k + 1}", 0.075, np.zeros((80, 0)), values, (SampleNoise(1e-3),), ()))
    return found


@pytest.mark.slow
def test_a_near_relative_of_what_is_left_out_is_not_taken_for_it() -> None:
    """Drag by the cube takes nearly all that drag by the square does; what it leaves goes with the speed, and tells."""
    cart = Model(
        [State("v", "m/s", equation="cart")],
        [],
        [Number("a", "1/s", 0.4, least=0.0)],
        [Output("v", "m/s", stage="encoder")],
        lambda t, x, u, p: [-p.a * x.v],
    )
    known = found_of(cart, glides(2.0))
    assert known.file.verdict == "effect"
    assert known.file.ranking[0].effects == ["v_quadratic_damping"]
    assert known.diagnosis.ranking.beside is None
    left_out = found_of(cart, glides(2.0), without=("v_quadratic_damping",))
    assert left_out.file.verdict == "unknown"
    assert left_out.file.where.stage == "cart"
    assert left_out.diagnosis.ranking.beside is not None


@pytest.mark.slow
def test_a_zero_that_wanders_is_no_wrong_zero() -> None:
    """An encoder that drifts by ten times its noise: an offset takes three quarters of it, and is not what is missing."""
    plain = swings(starts=(0.6, 1.3))
    wandered = [replace(one, values=one.values + 0.04 * np.linspace(0, 1, len(one.values))[:, None]) for one in plain]
    known = found_of(pendulum(), wandered)
    assert known.file.verdict == "effect"
    assert known.file.ranking[0].effects == ["angle_drift"]
    left_out = found_of(pendulum(), wandered, without=("angle_drift",))
    assert left_out.file.verdict == "unknown"
    assert left_out.file.where.stage == "encoder"
