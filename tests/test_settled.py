"""Steady or not, by the motion alone: closed forms, two simulators, noise of several colours; stability and the bracket of X_v."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import fsolve
from scipy.signal import lfilter

from towline.identify.bracket import bracket_words, neutral_bracket
from towline.identify.settled import judge, slowest_swing_s, tail_mean
from towline.identify.steady import UnsettledError, judged_tow, stands_off, steady_state
from towline.identify.transient import fit_transient
from towline.pipeline.analysis import Batch, fit_steady_batch, good_for
from towline.pipeline.stages import RunMotion
from towline.record import EstimationError, InputError
from towline.record.results import TowStability
from towline.record.run import Run, with_line
from towline.record.schema import RunFile
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full
from towline.simulate.model import full_rates

MARINER = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, y_delta=-2.0, n_delta=2.4)
FRIGATE = Hull(4.655, 0.3519, -6.804, -1.00, -1.490076, -0.9457, speed_m_s=0.725, y_delta=0.5, n_delta=-0.25425)
TOW = Tow(1.28, 0.91, 1.649, 3.96, rudder_rad=np.radians(-5.0))
FRIGATE_TOW = Tow(0.725, 0.71, 0.5, None, 0.50, rudder_rad=-0.28)
SLOWEST_S = slowest_swing_s(2.66, 1.28)
STRETCH_RAD = 1e-4
"""A line of 20 kN/m is let go at the length that 3.96 N give it; what the tow pulls besides, 4 % of that, is 8e-6 m of 0.91 m, and
rings. The rest of a line that keeps its tension is 1e-3 off, and a tow let go there swings by 2e-3."""


def rest_of(hull: Hull, tow: Tow) -> np.ndarray:
    """Steady alpha and beta, (2,), rad."""

    def rates(angles: np.ndarray) -> np.ndarray:
        return full_rates(0.0, np.array([*angles, -tow.speed_m_s * np.sin(angles[1]), 0.0]), hull, tow)[2:]

    return fsolve(rates, [0.3, 0.03], xtol=1e-13)


def swum(hull: Hull, tow: Tow, aside_deg: float, t_s: np.ndarray) -> np.ndarray:
    """alpha, beta (n, 2) of a tow let go aside of its rest."""
    alpha, beta = rest_of(hull, tow)
    start = Start(
        alpha_rad=alpha + float(np.radians(aside_deg)), beta_rad=beta, v_m_s=-tow.speed_m_s * float(np.sin(beta))
    )
    return simulate_full(hull, tow, start, t_s)[["alpha_rad", "beta_rad"]].to_numpy()


def coloured(rng: np.random.Generator, n: int, sd_deg: float, time_s: float) -> np.ndarray:
    """First-order noise at 25 Hz, (n, 2), rad."""
    fall = np.exp(-0.04 / time_s)
    fresh = rng.normal(size=(n, 2)) * np.sqrt(1 - fall**2)
    fresh[0] /= np.sqrt(1 - fall**2)
    return np.radians(sd_deg) * lfilter([1.0], [1.0, -fall], fresh, axis=0)


def run_of(tow: Tow, length_m: float = 2.66, name: str = "r", **more: object) -> Run:
    """A run that comes with its motion."""
    table = {"speed_m_s": tow.speed_m_s, "line_length_m": tow.line_length_m, "tow_point_m": tow.tow_point_m}
    table["line"] = tow.line
    if tow.tension_n is not None:
        table["tension_n"] = tow.tension_n
    tables = {
        "name": name, "source": {"motion": "motion.csv"}, "tow": table, "water": {},
        "model": {"length_pp_m": length_m, "mass_kg": 78.0}, **more,
    }  # fmt: skip
    return Run(Path(), check_tables(tables, RunFile, Path("run.toml")))


def motion_of(t_s: np.ndarray, angles: np.ndarray) -> pd.DataFrame:
    """As ``record.read_motion`` gives it."""
    alpha, beta = angles.T
    return pd.DataFrame({"t_s": t_s, "y_cg_m": 0.1, "alpha_rad": alpha, "beta_rad": beta, "status": "measured"})


def moved(run: Run, motion: pd.DataFrame) -> RunMotion:
    """As ``stages.moved`` gives it."""
    return RunMotion(run, motion, None, None, None)


@pytest.mark.parametrize("rate", [0.03, 0.004, -0.006])
def test_a_swing_of_known_rate_and_period_is_found(rate: float) -> None:
    """Closed form; white noise of 0.05 degrees: rate and frequency within 5 of their standard deviations, amplitude to 5 %."""
    t, rng = np.arange(0, 60, 0.04), np.random.default_rng(5)
    swing = 0.03 * np.exp(-rate * t) * np.cos(0.37 * t + 1.0)
    angles = np.column_stack([0.3 + swing, 0.05 - swing / 4]) + rng.normal(0, np.radians(0.05), (len(t), 2))
    found = fit_transient(t, angles, SLOWEST_S)
    assert found.rate(1)[0] == pytest.approx(-rate, abs=5 * found.rate(1)[1])
    assert found.rate(1)[1] < 2e-4
    assert found.period_s == pytest.approx(2 * np.pi / 0.37, rel=2e-3)
    parts, _ = found.swing(30.0)
    np.testing.assert_allclose(np.hypot(*parts.T), 0.03 * np.exp(-30 * rate) * np.array([1, 0.25]), rtol=0.05)


@pytest.mark.slow
def test_swinging_tows_are_refused_and_resting_ones_are_not() -> None:
    """30 MARINER tows each at 5 degrees of rudder, 40 s, noise of 0.05 degrees with 0.5 s: swings of 0.2 to 10 degrees, and none.

    The smallest that matters here is 0.1 degrees: half the standard deviation of F, times w W / 2.
    """
    t = np.arange(0, 40, 0.04)
    refused, said = {"swings": 0, "rests": 0}, set()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        tow = replace(TOW, tow_point_m=float(rng.choice([1.446, 1.548, 1.649, 1.751])))
        error = coloured(rng, len(t), 0.05, 0.5)
        for name, aside in (("swings", float(np.exp(rng.uniform(np.log(0.4), np.log(12))))), ("rests", 0.0)):
            motion = motion_of(t, swum(MARINER, tow, aside, t) + error)
            try:
                found = steady_state(run_of(tow), motion, None)
            except UnsettledError as refusal:
                refused[name] += 1
                said.add(refusal.stability.verdict)
            else:
                assert found.whole == (found.span_s[0] == 0.0)
    assert refused["swings"] == 30
    assert refused["rests"] <= 1  # 2 of 100 are allowed
    assert said <= {"swinging", "decaying", "growing"}


def test_slow_drift_is_refused_and_says_what_it_does() -> None:
    """0.3 degrees in 40 s, as a hull that takes on water: no trend over any ten seconds is larger than the noise."""
    t, rng = np.arange(0, 40, 0.04), np.random.default_rng(1)
    angles = rest_of(MARINER, TOW) + np.radians(0.3) / 40 * t[:, None] * [1.0, 0.2]
    with pytest.raises(UnsettledError, match=r"drifts by .* over its last 10\.1 s") as refusal:
        steady_state(run_of(TOW), motion_of(t, angles + coloured(rng, len(t), 0.02, 0.3)), None)
    assert refusal.value.stability.verdict == "drifting"


def test_what_matters_is_held_against_the_uncertainty_of_f() -> None:
    """A swing of 0.15 degrees: refused where nothing else errs, let pass where the camera errs by half a degree; F is widened."""
    t, rng = np.arange(0, 60, 0.04), np.random.default_rng(2)
    angles = rest_of(MARINER, TOW) + np.radians(0.15) * np.cos(0.37 * t)[:, None] * [1.0, -0.25]
    motion = motion_of(t, angles + rng.normal(0, 1e-4, (len(t), 2)))
    with pytest.raises(UnsettledError, match=r"period of 1[67]\.\d s"):
        steady_state(run_of(TOW), motion, None)
    camera = np.zeros((1, len(t), 3))
    camera[0, :, 2] = np.radians(0.5)
    found = steady_state(run_of(TOW), motion, camera)
    leak = np.radians(0.15) * 2 / (0.37 * (found.span_s[1] - found.span_s[0]))
    assert np.sqrt(found.covariance[0, 0]) >= leak / np.sqrt(2) * 0.9


def test_a_decaying_tow_says_how_long_to_wait_and_settles_then() -> None:
    """Swing of 8 degrees with a time constant of 25 s: refused at 40 s; the time it names is enough and not twice too long."""
    rng = np.random.default_rng(3)

    def tow(length_s: float) -> pd.DataFrame:
        t = np.arange(0, length_s, 0.04)
        swing = np.radians(8.0) * np.exp(-t / 25) * np.cos(0.4 * t)
        return motion_of(t, rest_of(MARINER, TOW) + swing[:, None] * [1.0, -0.25] + rng.normal(0, 3e-4, (len(t), 2)))

    judged = judged_tow(run_of(TOW), tow(40.0), None)
    assert judged.stability.verdict == "decaying"
    assert judged.stability.lambda_per_s == pytest.approx(-0.04, abs=5e-4)
    assert judged.wait_s is not None
    with pytest.raises(UnsettledError, match=f"settled some {judged.wait_s:.0f} s after its end"):
        steady_state(run_of(TOW), tow(40.0), None)
    assert steady_state(run_of(TOW), tow(40.0 + 1.1 * judged.wait_s), None).span_s[0] > 60.0
    with pytest.raises(UnsettledError):
        steady_state(run_of(TOW), tow(40.0 + 0.5 * judged.wait_s), None)


def test_a_record_shorter_than_half_a_swing_is_not_judged() -> None:
    t = np.arange(0, 9, 0.04)
    with pytest.raises(InputError, match=r"a swing may last 20\.8 s .* less than 10\.4 s"):
        steady_state(run_of(TOW), motion_of(t, np.full((len(t), 2), 0.1)), None)
    with pytest.raises(EstimationError, match="15 samples of alpha and beta; at least 24"):
        judge(np.arange(0, 60, 4.0), np.full((15, 2), 0.1), SLOWEST_S)
    bunched = np.concatenate([np.linspace(0, 0.2, 20), np.linspace(59.8, 60, 20)])
    with pytest.raises(EstimationError, match="too few times"):
        judge(bunched, np.full((40, 2), 0.1), SLOWEST_S)


def test_resting_noise_and_noise_free_records_are_settled() -> None:
    """Also where shake is larger than any other noise, pictures are repeated, and nothing moves at all."""
    t, rng = np.arange(0, 30, 0.04), np.random.default_rng(8)
    white = np.radians(0.1) * rng.normal(size=(len(t), 2))
    shake = np.radians(0.3) * np.sin(2 * np.pi * 1.7 * t)[:, None]
    held = white[np.arange(len(t)) // 10 * 10]
    for error in (white, white + shake, held, 0 * white):
        found = judge(t, np.array([0.3, 0.05]) + error, SLOWEST_S)
        assert found.settled
        assert found.first == 0
        assert found.stability.words == "settled"


def test_the_mean_of_a_slow_noise_under_a_fast_one_is_as_unsure_as_it_is() -> None:
    """200 records of 40 s, half white, half of 2 s: the mean's z has a standard deviation below 1.35 (0.8 s of memory: 2.1)."""
    z = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        mean, covariance = tail_mean(rng.normal(0, np.radians(0.1), (1000, 2)) + coloured(rng, 1000, 0.1, 2.0))
        z.append(mean / np.sqrt(np.diag(covariance)))
    assert 0.9 < np.std(z) < 1.35


def test_stability_from_the_record_alone() -> None:
    """Frigate of X_v 0.219 m without rudder, let go 3 degrees aside: lambda of what shears off within 10 % of the root."""
    t, rng = np.arange(0, 60, 0.04), np.random.default_rng(6)
    seen: dict[str, TowStability] = {}
    for point, verdict in ((0.10, "shearing off"), (0.20, "shearing off"), (0.38, "settled")):
        tow = replace(FRIGATE_TOW, tow_point_m=point, rudder_rad=0.0)
        length = len(t) if point > 0.15 else 400
        start = Start(alpha_rad=float(np.radians(3.0)))
        angles = simulate_full(FRIGATE, tow, start, t[:length])[["alpha_rad", "beta_rad"]].to_numpy()
        angles = angles + np.radians(0.03) * rng.normal(size=angles.shape)
        found = judged_tow(run_of(tow, 1.13), motion_of(t[:length], angles), None).stability
        assert found.verdict == verdict, point
        if verdict == "shearing off":
            plain = replace(tow, tension_n=0.5, resistance_n=None)
            root = np.linalg.eigvals(linear_system(FRIGATE, plain)[0]).real.max()
            assert found.lambda_per_s == pytest.approx(root, rel=0.1)
        seen[f"x{point}"] = TowStability(verdict=found.verdict, tow_point_m=point)
    bracket = neutral_bracket(seen, (0.217, 0.221), ["x0.38"])
    assert bracket is not None
    assert (bracket.above_m, bracket.below_m, bracket.agrees) == (0.20, 0.38, True)
    assert "between 0.2 m, where x0.1, x0.2 sheared off, and 0.38 m" in bracket_words(bracket)
    assert bracket_words(bracket).endswith("agrees")


def test_a_bracket_takes_proofs_only() -> None:
    def run(verdict: str, point: float, rate: float | None = None) -> TowStability:
        found = None if rate is None else {"value": rate, "std": 0.001}
        return TowStability.model_validate({"verdict": verdict, "tow_point_m": point, "lambda_per_s": found})

    assert neutral_bracket({"a": run("growing", 0.1), "b": run("decaying", 0.3), "c": run("drifting", 0.2)}) is None
    assert neutral_bracket({"a": run("settled", 0.1)}) is None  # at rest all the time, nothing pushed it
    swung = neutral_bracket({"a": run("settled", 0.1, -0.2)})
    assert swung is not None
    assert (swung.below_m, swung.above_m, bracket_words(swung)) == (0.1, None, "")
    crossed = neutral_bracket({"a": run("settled", 0.1, -0.2), "b": run("shearing off", 0.2)}, (0.1, 0.2))
    assert crossed is not None
    assert "cannot lie ahead of the first" in bracket_words(crossed)
    apart = neutral_bracket({"a": run("settled", 0.4, -0.2), "b": run("shearing off", 0.2)}, (0.45, 0.47))
    assert apart is not None
    assert apart.agrees is False
    assert "one of the two is wrong" in bracket_words(apart)


@pytest.mark.slow
def test_a_batch_keeps_its_steady_tows_and_says_why_the_others_are_out() -> None:
    """Frigate at 0.44 and 0.56 m settles, at 0.50 m still swings (made so), at 0.14 m shears off."""
    t, rng = np.arange(0, 60, 0.04), np.random.default_rng(7)
    runs = []
    for point in (0.44, 0.50, 0.56, 0.14):
        tow = replace(FRIGATE_TOW, tow_point_m=point)
        if point == 0.14:
            start = Start(alpha_rad=0.1)
            angles = simulate_full(FRIGATE, replace(tow, rudder_rad=0.0), start, t[:500])[
                ["alpha_rad", "beta_rad"]
            ].to_numpy()
        else:
            angles = swum(FRIGATE, tow, -6.0, t)
        if point == 0.50:
            angles = angles + 0.02 * np.cos(1.1 * t)[:, None] * [1.0, -0.2]
        angles = angles + rng.normal(0, 3e-4, angles.shape)
        runs.append(moved(run_of(tow, 1.13, f"x{point}"), motion_of(t[: len(angles)], angles)))
    result = fit_steady_batch(Batch(runs, {}))
    assert list(result.tows) == ["x0.44", "x0.56"]
    assert result.x_v_m.value == pytest.approx(0.219, abs=4 * result.x_v_m.std)
    assert set(result.failed) == {"x0.5", "x0.14"}
    assert "swings by 1.1 and" in result.failed["x0.5"]
    assert "with a measured tension `towline identify` takes it" in result.failed["x0.5"]
    assert "shears off" in result.failed["x0.14"]
    assert {name: seen.verdict for name, seen in result.stability.items()} == {
        "x0.44": "settled", "x0.5": "swinging", "x0.56": "settled", "x0.14": "shearing off",
    }  # fmt: skip
    assert result.x_v_bracket is not None
    assert (result.x_v_bracket.above_m, result.x_v_bracket.below_m, result.x_v_bracket.agrees) == (0.14, 0.44, True)
    assert "X_v lies between 0.14 m" in result.notes[-1]
    with pytest.raises(EstimationError, match=r"1 steady tows; .* X_v lies between 0\.14 m"):
        fit_steady_batch(Batch([runs[0], runs[3]], {}))


@pytest.mark.slow
def test_run_goes_by_the_motion_and_not_by_the_stated_rudder() -> None:
    t, rng = np.arange(0, 40, 0.04), np.random.default_rng(9)
    error = rng.normal(0, 3e-4, (len(t), 2))
    swings = motion_of(t, swum(MARINER, TOW, 5.0, t) + error)
    rests = motion_of(t, swum(MARINER, TOW, 0.0, t) + error)
    ahead = motion_of(t, error)
    assert good_for(moved(run_of(TOW), swings)) == ("derivatives",)
    assert good_for(moved(run_of(TOW), rests)) == ("steady",)
    assert good_for(moved(run_of(TOW), ahead)) == ("derivatives",)  # behind its post: no side force
    silent = run_of(replace(TOW, tension_n=None))
    assert good_for(moved(silent, swings)) == ("steady",)
    assert good_for(moved(with_line(silent, "surge"), swings)) == ("derivatives",)  # its mass weighs the pull
    assert good_for(moved(with_line(silent, "surge"), rests)) == ("steady",)
    assert good_for(moved(run_of(TOW, kind="free"), rests)) == ()
    died = rest_of(MARINER, TOW) + 0.1 * np.exp(-t / 4)[:, None] * np.cos(0.5 * t)[:, None] * [1.0, -0.3]
    assert good_for(moved(run_of(TOW), motion_of(t, died + error))) == ("derivatives", "steady")


def test_a_small_force_is_no_x_v() -> None:
    t = np.arange(0, 40, 0.04)
    flat = np.zeros((len(t), 2))
    assert stands_off(steady_state(run_of(TOW), motion_of(t, flat + np.array([0.1, 0.02])), None))
    assert not stands_off(steady_state(run_of(TOW), motion_of(t, flat + np.array([0.04, 0.005])), None))


@pytest.mark.once
@pytest.mark.parametrize("other_code", [False, True])
def test_tows_of_both_simulators_rest_where_their_lines_let_them(steady_tows: ModuleType, other_code: bool) -> None:
    """Let go at rest each stays there, but for what a taut line's stretch moves; one that swings by what matters is refused."""
    tow = replace(TOW, line="surge" if other_code else "constant")
    times = np.arange(0.0, 30.0, 0.04)
    hull = steady_tows.MARINER
    still = steady_tows.angles_of(hull, tow, 0.0, times, other_code)
    assert np.abs(still - steady_tows.at_rest(hull, tow)).max() < STRETCH_RAD
    swung = steady_tows.swung(0, other_code, 10.0, 20.0)
    with pytest.raises(UnsettledError):
        steady_state(swung.run, swung.motion, None)
