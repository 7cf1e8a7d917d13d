"""The noise about a hypothesis: what static records tell of the measurement's, and how forces move a tow along its own path."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.model import TowModel
from towline.diagnose.tow.still import still_noise
from towline.geometry import motion_from_tracks, run_datum
from towline.simulate import Hull, Start, simulate_full

STEP_S = 0.35
WHITE = np.array([[1.0, 0.3], [0.3, 0.8]])
SLOW = np.array([[0.8, 0.4], [0.4, 0.5]])
TIME_S = 0.9


def records(rng: np.random.Generator, sizes: tuple[float, ...], means: int = 34) -> list[np.ndarray]:
    """Drawn by the processes themselves: a recursion in time, not a covariance."""
    decay = np.exp(-STEP_S / TIME_S)
    white, slow = np.linalg.cholesky(WHITE), np.linalg.cholesky(SLOW)
    found = []
    for size in sizes:
        state, rows = slow @ rng.normal(size=2), []
        for _ in range(means):
            rows.append(state + white @ rng.normal(size=2))
            state = decay * state + np.sqrt(1 - decay**2) * (slow @ rng.normal(size=2))
        found.append(np.sqrt(size) * np.array(rows) + rng.normal(size=2) * 50)
    return found


@pytest.mark.slow
def test_records_of_one_camera_tell_its_noise_together() -> None:
    """Of 60 campaigns with five records of 12 s: the true noise, whitened by what was found, has variance 1 within 4 standard
    errors and 4 % (the inverse of a variance from 160 means is 2/160 too large, of five such numbers); that of a mean over 4 s,
    where the colour stands, is right to 15 %, again with 4 standard errors.
    """
    rng, lag = np.random.default_rng(11), np.abs(np.arange(34)[:, None] - np.arange(34)) * STEP_S
    truth = np.kron(WHITE, np.eye(34)) + np.kron(SLOW, np.exp(-lag / TIME_S))
    wholes, slows = [], []
    mean = np.zeros((2, 68))
    mean[0, 10:21], mean[1, 44:55] = 1.0, 1.0
    for _ in range(60):
        noise = still_noise(records(rng, (1.0,) * 5), STEP_S)[2]
        assert noise is not None
        found = np.block([[noise.covariance(i, j, lag) for j in range(2)] for i in range(2)])
        wholes.append(np.trace(np.linalg.solve(found, truth)) / 68)
        slows.append(np.diag(mean @ truth @ mean.T) / np.diag(mean @ found @ mean.T))
    for values, share in ((np.array(wholes), 0.04), (np.array(slows).ravel(), 0.15)):
        assert abs(values.mean() - 1) < share + 4 * values.std() / np.sqrt(len(values))


@pytest.mark.slow
def test_a_record_that_is_really_noisier_keeps_its_size() -> None:
    """Four records alike and one of nine times the variance, 30 times: the median of each within 20 % (a coloured record of 34
    means tells its variance to a third; the median of 30 to 7 %). Records that only scatter are drawn together.
    """
    rng, sizes = np.random.default_rng(5), []
    for _ in range(30):
        noises = still_noise(records(rng, (1.0, 1.0, 1.0, 1.0, 9.0)), STEP_S)
        sizes.append([n.white[0, 0] + n.slow[0, 0] for n in noises if n is not None])
    ratio = np.array(sizes) / [1.8, 1.8, 1.8, 1.8, 16.2]
    assert np.abs(np.median(ratio, axis=0) - 1).max() < 0.2
    together, alone = [], []
    for _ in range(30):
        drawn = records(rng, (1.0,) * 5)
        together += [n.white[0, 0] + n.slow[0, 0] for n in still_noise(drawn, STEP_S) if n is not None]
        alone += [r[:, 0].var(ddof=1) for r in drawn]
    # five times the data: 0.45 of the scatter, were the size common for sure
    assert np.std(np.log(together)) < 0.7 * np.std(np.log(alone))


@pytest.mark.slow
def test_white_records_are_not_called_coloured_and_short_ones_have_no_colour() -> None:
    rng = np.random.default_rng(7)
    noises = [still_noise([rng.normal(size=(34, 1)) for _ in range(5)], STEP_S)[0] for _ in range(40)]
    # Akaike's bar lets a sixth pass by chance, of which most are nearly white
    assert np.mean([n is not None and n.slow[0, 0] > 0.2 for n in noises]) < 0.3
    few = still_noise([np.cumsum(rng.normal(size=(8, 1)), axis=0)], STEP_S)[0]
    assert few is not None
    assert not few.slow.any()


def test_lost_means_and_absent_records_change_nothing_of_the_others() -> None:
    drawn = records(np.random.default_rng(8), (1.0, 1.0))
    holed = [drawn[0].copy(), drawn[1], None, np.full((5, 2), np.nan)]
    holed[0][5:9] = np.nan
    noises = still_noise(holed, STEP_S)
    assert noises[2] is None
    assert noises[3] is None
    assert noises[0] is not None
    assert np.isfinite(noises[0].white).all()
    assert abs((noises[0].white + noises[0].slow)[0, 0] / 1.8 - 1) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("line", ["surge", "constant"])
def test_forces_move_a_tow_as_the_simulator_says_along_its_own_path(cases: ModuleType, line: str) -> None:
    """Against motions by DOP853 with a push (side force or moment) that lasts one block, from a release at 0.12 rad: to 1 % of the
    largest answer of the run.
    """
    runs = []
    for run, tracks, static in cases.campaign("none", np.random.default_rng(3), line=line).runs[:2]:
        fit = run_datum(run, None)
        made = motion_from_tracks(run, tracks, fit)
        runs.append(Recorded(run, made.motion, made.common, tracks, fit, static))
    runs = tow_runs(runs, block_step([45.0]))
    model = TowModel(runs, cases.SPEED_M_S)
    run, tow = runs[0], runs[0].data.tow
    beside = {"mass_kg": run.run.model.mass_kg, "x_udot_kg": -4.0, "x_vr_kg": 40.0} if line == "surge" else {}
    hull = Hull(*cases.SIX, speed_m_s=cases.SPEED_M_S, **beside)
    shared = np.array([*cases.SIX, *(getattr(hull, name, 0.0) or 0.0 for name in model.shared_names[6:])])
    start = Start(alpha_rad=0.12, beta_rad=0.02)
    tows = [r.data.tow for r in runs]
    own = [[0.12, 0.02, 0, 0, 0, 0, t.tension_n, t.tow_point_m, t.line_length_m, t.speed_m_s, 0, 0] for t in tows]
    h = model.begun(Hypothesis(shared, np.array(own)))
    found = model.pushed(h)[0]
    frames_s = run.data.t_s - run.start_s
    block = np.floor(frames_s / run.step_s + 1e-9).astype(int)
    inside = block < len(run.centre_s)

    def means(block_pushed: int, side_n: float, moment_n_m: float) -> np.ndarray:
        def push(t, y, beta, v, r, alpha):
            there = (np.floor(t / run.step_s) == block_pushed) + 0.0 * v
            return side_n * there, moment_n_m * there

        motion = simulate_full(hull, tow, start, frames_s, extra=push)
        count = np.bincount(block[inside])
        return np.column_stack(
            [np.bincount(block[inside], motion[n].to_numpy()[inside]) / count for n in ("y_cg_m", "beta_rad")]
        )

    still = means(0, 0.0, 0.0)
    for pushed in (2, 40):
        for k, force in enumerate(((0.02, 0.0), (0.0, 0.02))):
            truth = (means(pushed, *force) - still) / 0.02
            for channel in range(2):
                off = np.abs(found[:, channel, k, pushed] - truth[:, channel]).max()
                assert off < 0.01 * np.abs(truth[:, channel]).max()
