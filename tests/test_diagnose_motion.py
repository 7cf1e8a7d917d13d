"""Runs that came as motion, without pixels: their channels, what can be asked of them, and the gap found in them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.diagnose.effects import LIBRARY
from towline.diagnose.gap import diagnosed
from towline.diagnose.inference import engine
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.grams import Columns, Grams
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.tow.beside import NOTABLE, beside_smaller
from towline.diagnose.tow.data import Recorded, tow_runs
from towline.diagnose.tow.fields import Fields
from towline.diagnose.tow.pushes import pushes
from towline.diagnose.tow.slow import SLOW_S, SLOW_UNSEEN_PX
from towline.diagnose.tow.tow_run import TowRun
from towline.diagnose.tow.towed import TowSimulator
from towline.diagnose.tow.waves import waves
from towline.record import Run, RunFile
from towline.record.schema import WaterTable
from towline.record.toml import check_tables
from towline.simulate import Histories, Hull, Start, Tow, simulate_full

HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
SIX = HULL.six
SD = np.array([1e-3, np.radians(0.1)])
STEP_S, HERTZ = 0.5, 25


def made(seed: int, x_t: float, start_m: float, push: tuple[float, float] = (0.0, 0.0), **more: Any) -> TowRun:
    """45 s of a simulated tow with noise; ``more``: of ``simulate_full``."""
    t = 3.0 + np.arange(45 * HERTZ) / HERTZ
    extra = {"extra": lambda *_: push} if any(push) else {}
    motion = simulate_full(HULL, Tow(1.28, 0.91, x_t, 3.96), Start(y_cg_m=start_m), t - 3.0, **extra, **more)
    rng = np.random.default_rng(seed)
    table = pd.DataFrame(
        {
            "t_s": t,
            "y_cg_m": motion["y_cg_m"] + rng.normal(0, SD[0], len(t)),
            "beta_rad": motion["beta_rad"] + rng.normal(0, SD[1], len(t)),
            "alpha_rad": np.nan,
            "sigma_y_cg_m": SD[0],
            "sigma_beta_rad": SD[1],
            "status": "measured",
        }
    )
    content = {
        "name": f"x{x_t}",
        "source": {"motion": "motion.csv"},
        "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": x_t, "tension_n": 3.96, "line": "constant"},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0, "tank_width_m": 4.6},
    }
    run = Run(Path(), check_tables(content, RunFile, Path("run.toml")))
    return tow_runs([Recorded(run, table)], STEP_S)[0]


@pytest.fixture(scope="module")
def tows() -> list[TowRun]:
    return [made(k, x, y) for k, (x, y) in enumerate(((1.446, 0.2), (1.751, -0.2)))]


def test_blocks_of_a_motion_have_its_sigmas_and_no_line(tows: list[TowRun]) -> None:
    """Twelve or thirteen frames to a block: a thirteenth of the variance, and slow errors of an assumed size on top."""
    run = tows[0]
    assert run.marks is None
    assert (run.start_s, run.half_width_m, run.length_pp_m, run.density_kg_m3) == (3.0, 2.3, 2.66, 1000.0)
    n = len(run.centre_s)
    assert run.values.shape == (n, 4)
    assert np.isnan(run.values[:, 2:]).all()
    assert not run.shutter.any()
    counts = np.bincount(np.floor(np.arange(45 * HERTZ) / HERTZ / STEP_S + 1e-9).astype(int))[:n]
    assert set(counts) == {12, 13}
    slow = SLOW_UNSEEN_PX / 0.1
    lag = np.abs(run.centre_s[:, None] - run.centre_s)
    for channel, sd in enumerate(SD):
        wanted = sd**2 * (np.diag(1 / counts) + slow**2 * np.exp(-lag / SLOW_S))
        np.testing.assert_allclose(run.covariance[channel], wanted, rtol=1e-9)
    for channel in (2, 3):
        np.testing.assert_array_equal(run.covariance[channel], np.eye(n))
    truth = simulate_full(HULL, Tow(1.28, 0.91, 1.446, 3.96), Start(y_cg_m=0.2), np.append(0.0, run.centre_s))
    # a mean over half a second of a swing of 0.2 m is half a millimetre off its middle
    assert np.abs(run.values[:, 0] - truth["y_cg_m"][1:]).max() < 5 * SD[0] / np.sqrt(12) + 5e-4
    fastest = [
        simulate_full(HULL, Tow(1.28, 0.91, x, 3.96), Start(y_cg_m=y), np.arange(0, 45, 0.1))["v_m_s"].abs().max()
        for x, y in ((1.446, 0.2), (1.751, -0.2))
    ]
    still: Any = SimpleNamespace(hypothesis=SimpleNamespace(own=np.zeros((2, 10))))
    said = re.fullmatch(r"sway velocities of the runs reach (0\.\d\d) m/s", TowSimulator(tows).reached(still))
    assert said is not None
    # from differences of noisy means: four deviations of one
    assert float(said[1]) == pytest.approx(max(fastest), abs=4 * (SD[0] + 1.28 * SD[1]) / np.sqrt(12) + 0.005)


# one-off pushes ---------------------------------------------------------------------------------------------------

IMPULSE_N_S, AT_S, LASTED_S = 0.5, 20.0, 0.5


def kick(t_s: np.ndarray, *_: object) -> tuple[np.ndarray, float]:
    return IMPULSE_N_S / LASTED_S * ((t_s > AT_S) & (t_s < AT_S + LASTED_S)), 0.0


@pytest.mark.slow
def test_a_push_that_comes_once_is_told_with_run_time_and_impulse(tows: list[TowRun]) -> None:
    """Random forces alone would follow it: each run's motion is smooth, and no channel leaves anything over."""
    third = made(2, 1.6, 0.15)
    found = diagnosed(
        TowSimulator([tows[0], made(1, 1.751, -0.2, extra=kick), third]),
        LIBRARY,
        "test",
        {},
        rng=np.random.default_rng(0),
    )
    assert found.file.verdict == "unknown"
    assert found.file.p_unknown > 0.95
    told = re.search(r"It looks like a push that comes once, in x1\.751 at (\d+\.\d) s\.", found.file.sentences[-1])
    assert told is not None
    assert float(told[1]) == pytest.approx(AT_S + LASTED_S / 2, abs=STEP_S)
    assert found.file.where.span_s[0] <= AT_S + LASTED_S
    free = found.ranking.free
    assert free is not None
    (side_n, moment_n_m) = free.fitted.hypothesis.numbers[0]
    (found_push,) = pushes(found.inference, found.ranking.base)
    length_s = found_push.end_s - found_push.begin_s
    # by how much its middle may be off, at the rate at which the impulse turns into another place: a block of the 5 s to its peak
    sd = np.sqrt(np.diag(free.fitted.solved.covariance)[-2:])
    assert length_s * side_n == pytest.approx(IMPULSE_N_S, abs=3 * length_s * sd[0] + IMPULSE_N_S * STEP_S / 5)
    assert abs(moment_n_m) < 4 * sd[1]
    assert not pushes(*_nothing(TowSimulator([*tows, third])))


def test_beside_a_fit_that_has_run_off_no_push_is_looked_for(tows: list[TowRun]) -> None:
    """A weight keeps the line's pull: the simulator without effects may end anywhere, some of its numbers without a variance."""
    inference, base = _nothing(TowSimulator(tows))
    asked = list(beside_smaller(inference, base))
    assert asked

    class RunOff:
        simulator, noise = inference.simulator, inference.noise

        def solve(self, *given: object) -> object:
            solved = inference.solve(*given)
            return replace(solved, covariance=solved.covariance * (np.arange(len(solved.covariance)) > 0))

    assert list(beside_smaller(RunOff(), base)) == []


WAVE_M, WAVE_N = 0.078, 0.15


def washboard(t_s: np.ndarray, y: np.ndarray, *_: object) -> tuple[np.ndarray, float]:
    return WAVE_N * np.sin(2 * np.pi * y / WAVE_M + 0.7), 0.0


@pytest.mark.slow
def test_a_force_that_repeats_across_the_tank_is_told_with_its_distance() -> None:
    """Between two of the free form's own wave numbers; the same in three tows."""
    runs = [made(k, x, y, extra=washboard) for k, (x, y) in enumerate(((1.446, 0.2), (1.751, -0.2), (1.6, 0.15)))]
    found = diagnosed(TowSimulator(runs), LIBRARY, "test", {}, rng=np.random.default_rng(0))
    assert found.file.verdict == "unknown"
    told = re.search(
        r"It looks like a force that comes and goes every (\d+\.\d) cm across the tank", found.file.sentences[-1]
    )
    assert told is not None
    # a quarter of a wave a metre is the grid
    assert abs(100 / float(told[1]) - 1 / WAVE_M) < 0.25
    free = found.ranking.free
    assert free is not None
    sine, cosine, *turn, off = free.fitted.hypothesis.numbers[0]
    sd = np.sqrt(np.diag(free.fitted.solved.covariance)[-5:])
    assert np.hypot(sine, cosine) == pytest.approx(WAVE_N, abs=4 * sd[:2].max())
    assert (np.abs(turn) < 4 * sd[2:4]).all()
    (wave,) = waves(found.inference, found.ranking.base)
    assert wave.per_unit + off == pytest.approx(1 / WAVE_M, abs=4 * sd[4])


@pytest.mark.slow
def test_random_forces_are_neither_pushes_nor_waves(tows: list[TowRun]) -> None:
    """What noise and forces of the fit's own sizes do: odds of e^3 are reached by chance in e^-3 of the campaigns at most."""
    inference, base = _nothing(TowSimulator(tows))
    forces, rng, told = (
        replace(base.forces, side_n=0.05, moment_n_m=0.02),
        np.random.default_rng(1),
        list[tuple[bool, bool]](),
    )
    campaigns = 30
    roots = [np.linalg.cholesky(_whole(inference, forces, k)) for k in range(len(tows))]
    for _ in range(campaigns):
        tables = []
        for table, root in zip(base.linear.columns.tables, roots, strict=True):
            drawn = table.copy()
            drawn[:, :2, 0] = (root @ rng.normal(size=len(root))).reshape(2, -1).T
            tables.append(drawn)
        columns = Columns(tables, base.linear.columns.shared)
        linear, grams = replace(base.linear, columns=columns), Grams(columns, inference.noise)
        solved = inference.solve(grams, base.hypothesis, forces)
        drawn_fit = Fitted(base.hypothesis, forces, 0.0, solved, linear, grams)
        told.append((bool(pushes(inference, drawn_fit)), bool(waves(inference, drawn_fit))))
    expected = campaigns * np.exp(-NOTABLE)
    assert (np.sum(told, axis=0) < expected + 4 * np.sqrt(expected)).all()


def wandering(seed: int, side_n: float, moment_n_m: float, lasts_s: float) -> Callable[..., tuple[float, float]]:
    """First-order random forces, straight between fifths of a second."""
    rng, t_s = np.random.default_rng(seed), np.arange(0.0, 47.0, 0.2)
    keep = np.exp(-0.2 / lasts_s)
    drawn = [rng.normal(size=2)]
    for noise in rng.normal(size=(len(t_s) - 1, 2)):
        drawn.append(keep * drawn[-1] + np.sqrt(1 - keep**2) * noise)
    side, moment = np.array(drawn).T * [[side_n], [moment_n_m]]
    return lambda t, y, *_: (np.interp(t, t_s, side) + 0.0 * y, np.interp(t, t_s, moment) + 0.0 * y)


@pytest.mark.slow
def test_beside_random_forces_no_effect_ends_far_below_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect can be as good as none: what its evidence may fall below is what its own freedom costs, 5 at most here, however
    small the random forces are that its fit begins with.
    """
    monkeypatch.setattr(engine, "GROSS", -np.inf)
    tows = [
        made(k, x, y, extra=wandering(k, 0.2, 0.1, 1.0))
        for k, (x, y) in enumerate(((1.446, 0.2), (1.751, -0.2), (1.6, 0.1)))
    ]
    found = diagnosed(TowSimulator(tows), LIBRARY, "test", {}, rng=np.random.default_rng(0))
    assert len(found.ranking.candidates) > 4
    assert min(c.log_evidence for c in found.ranking.candidates) > -5


def _nothing(simulator: TowSimulator) -> tuple[Inference, Fitted]:
    found = diagnosed(simulator, LIBRARY[:1], "test", {}, rng=np.random.default_rng(0))
    return found.inference, found.ranking.base


def _whole(inference: Any, forces: Any, run: int) -> np.ndarray:
    side, moment = inference.noise.by_force(run, forces.time)
    return inference.noise.runs[run].measured + forces.side_n**2 * side + forces.moment_n_m**2 * moment


def test_what_a_motion_cannot_show_is_not_asked_of_it(tows: list[TowRun]) -> None:
    simulator = TowSimulator(tows)
    usable, excluded = simulator.usable(LIBRARY)
    names = {e.name for e in usable}
    pixels = {e.name for e in LIBRARY if e.correct is not None} - {"datum_bias"}
    assert set(excluded) == pixels | {"rolling_shutter", "sync_delay", "constant_tension"}
    assert {excluded[name] for name in (*pixels, "rolling_shutter")} == {"a motion holds no pixels"}
    assert excluded["sync_delay"] == "no tension history"
    assert {"cross_current", "crossflow_drag", "datum_bias", "bank_suction"} <= names
    wide = tows[1].run.file.model_copy(update={"water": WaterTable(density_kg_m3=1000.0)})
    one = replace(tows[1], run=replace(tows[1].run, file=wide))
    assert TowSimulator([tows[0], one]).usable(LIBRARY)[1]["bank_suction"] == "water.tank_width_m is not given"
    # what somebody knows is not there is neither tried nor suggested by the runs
    steel = TowSimulator(tows, without=["elastic_line", "bank_suction", "tow_point_offset"])
    fewer, why = steel.usable(LIBRARY)
    assert {e.name for e in fewer} == names - {"elastic_line", "bank_suction", "tow_point_offset"}
    assert {name for name, said in why.items() if said.startswith("left out")} == names - {e.name for e in fewer}
    base = _nothing(simulator)[1]
    assert {e.name for e in simulator.suggested(base)} - {e.name for e in steel.suggested(base)} == {"tow_point_offset"}
    # the post's place aside moves y and nothing else
    bias = next(e for e in LIBRARY if e.name == "datum_bias")
    own = np.zeros((2, 10))
    moved = simulator.measured(Hypothesis(SIX, own, (bias,), (np.array([0.02, 0.005]),)))
    for run, values in zip(tows, moved, strict=True):
        np.testing.assert_allclose(values[:, 0], run.values[:, 0] - 0.005)
        np.testing.assert_array_equal(values[:, 1], run.values[:, 1])


def test_a_reference_is_brought_to_the_tows_speed(tows: list[TowRun]) -> None:
    """Damping goes with the speed, added masses do not; a deviation is never less than a hundredth or so of its value."""
    sd = np.array([1.0, 1.0, 5.0, 5.0, 5.0, 0.0])
    prior = TowSimulator(tows, (SIX, sd, 0.64)).shared_prior
    assert prior is not None
    ratio = np.array([1, 1, 2, 2, 2, 2])
    np.testing.assert_allclose(prior[0], SIX * ratio)
    np.testing.assert_allclose(prior[1][:5], (sd * ratio)[:5])
    assert 0 < prior[1][5] < 0.02 * abs(prior[0][5])


def test_a_tension_log_is_over_its_mean_at_the_runs_own_clock(tows: list[TowRun]) -> None:
    log = np.arange(0.0, 60.0, 0.1), 4.0 + 0.02 * np.arange(600)
    tow = replace(tows[0].data.tow, tension_n=5.0)
    loaded = replace(tows[0], data=replace(tows[0].data, tow=tow, tension=log))
    fields = Fields([loaded, tows[1]], np.full((2, 1), 45.0), 1.28)
    at = np.array([0.0, 10.0, 20.0])
    found = fields.history(at[:, None, None])
    assert found.shape == (3, 2, 1)
    np.testing.assert_allclose(found[:, 0, 0], (4.0 + 0.2 * (at + 3.0)) / 5.0)
    np.testing.assert_array_equal(found[:, 1, 0], 1.0)
    np.testing.assert_array_equal(Fields(tows, np.full((2, 1), 45.0), 1.28).history(at[:, None, None]), np.ones((2, 1)))


@pytest.mark.slow
def test_the_simulated_side_follows_a_tension_log() -> None:
    """Residuals at the truth are the noise; with the mean tension alone they are not."""
    clock = np.arange(0, 60, 0.05)
    tension = 3.96 * (1 + 0.15 * np.sin(2 * np.pi * clock / 20))
    histories = Histories(tension_n=lambda t: float(np.interp(t, clock, tension)))
    run = made(5, 1.548, 0.2, histories=histories)
    mean = float(np.interp(run.data.t_s - 3.0, clock, tension).mean())
    log = (clock + 3.0, tension)
    told = replace(run, data=replace(run.data, tension=log, tow=replace(run.data.tow, tension_n=mean)))
    alpha = np.arcsin(0.2 / 0.91)
    own = np.array([[alpha, 0.0, 0.0, 0.0, 0.0, 0.0, mean, 1.548, 0.91, 1.28, 0, 0]])
    rms = []
    for one in (told, replace(told, data=replace(told.data, tension=None))):
        model = TowSimulator([one])
        rest = model.linear([Hypothesis(SIX, own)])[0].rows[0][0][:, :2]
        rms.append(np.sqrt(np.mean(rest**2, axis=0)) * np.sqrt(12.5) / SD)
    assert (np.abs(rms[0] - 1) < 4 / np.sqrt(2 * 89) + 0.05).all(), rms
    assert (rms[1] > 3).all(), rms


@pytest.mark.slow
@pytest.mark.parametrize(("push", "verdict"), [((0.0, 0.0), "no_gap"), ((0.25, 0.0), "effect")])
def test_a_push_from_one_side_is_found_in_a_motion(push: tuple[float, float], verdict: str) -> None:
    """A hull that pulls by 0.25 N, against drag, a current and a tow point aside."""
    runs = [made(k, x, y, push) for k, (x, y) in enumerate(((1.446, 0.2), (1.548, -0.2), (1.649, 0.15), (1.751, 0.25)))]
    names = {"hull_asymmetry", "cross_current", "crossflow_drag", "tow_point_offset"}
    library = [e for e in LIBRARY if e.name in names]
    found = diagnosed(TowSimulator(runs), library, "t", {}, rng=np.random.default_rng(1)).file
    assert found.verdict == verdict
    if verdict == "effect":
        row = found.ranking[0]
        assert row.effects == ["hull_asymmetry"]
        size = row.parameters["hull_asymmetry.y_star_n_s2_m2"]
        assert abs(size.value - 0.25 / 1.28**2) < 4 * size.std
        assert row.gap_after < row.gap_before
    assert len({row.gap_before for row in found.ranking}) == 1


@pytest.mark.slow
def test_the_command_takes_runs_that_came_as_motion(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    from towline.cli import main

    folders = [motion_run(tmp_path / f"r{x}", point=x, name=f"r{x}") for x in (1.446, 1.751)]
    assert main(["diagnose", *map(str, folders), "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "gap.json").is_file()


def test_random_forces_may_be_a_twentieth_of_the_tension(tows: list[TowRun]) -> None:
    heavy = replace(tows[0], data=replace(tows[0].data, tow=replace(tows[0].data.tow, tension_n=8.04)))
    assert TowSimulator([heavy, tows[1]]).most_force == pytest.approx(0.05 * (8.04 + 3.96) / 2)
