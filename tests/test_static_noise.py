"""The measurement's colour from a record of the model held still: true intervals, the right choice, files that are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import tomlkit
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import binom

from towline.cli import main
from towline.identify import RunData, fit_runs, fit_with_noise
from towline.identify.colour.bootstrap import drawn_record
from towline.identify.colour.bootstrap import pushed as pushed_by
from towline.identify.colour.kalman import Filtered, innovations
from towline.identify.noise import Whitener, from_correlation
from towline.identify.static_records import colours
from towline.identify.still import FEWEST, Slow, Still, block_colour, colour_of, correlation_left
from towline.record import DerivativesFile, Priors, read_result
from towline.record.tables import write_table

WHITE_SHARE = 0.3
SEEDS = 100
SPENT = 1000
"""Samples after which a drawn noise has forgotten its beginning."""


def coloured(rng: np.random.Generator, count: int, rate_hz: float, time_s: float) -> np.ndarray:
    """(count, 2) of unit variance: three tenths white, the rest of first order."""
    a = np.exp(-1 / (rate_hz * time_s))
    drawn = rng.normal(size=(count + SPENT, 2))
    slow = np.asarray(lfilter([np.sqrt(1 - a**2)], [1, -a], drawn, axis=0))[SPENT:]
    return np.sqrt(1 - WHITE_SHARE) * slow + np.sqrt(WHITE_SHARE) * rng.normal(size=(count, 2))


def filmed(
    campaigns: ModuleType,
    clean: list[RunData],
    rng: np.random.Generator,
    rate_hz: float,
    time_s: float,
    static_s: float,
) -> list[RunData]:
    """Runs under a coloured measurement, each with its static record."""
    sd = np.array([campaigns.SIGMA_Y_M, campaigns.SIGMA_BETA_RAD])
    found = []
    for run in clean:
        noise = sd * coloured(rng, len(run.t_s), rate_hz, time_s)
        count = int(static_s * rate_hz)
        still = Still(
            np.arange(count) / rate_hz,
            sd * coloured(rng, count, rate_hz, time_s),
            np.tile(run.covariance[0], (count, 1, 1)),
        )
        found.append(
            replace(
                run,
                y_m=run.y_m + noise[:, 0],
                beta_rad=run.beta_rad + noise[:, 1],
                common_key="camera",
                still=still,
            )
        )
    return found


@pytest.mark.slow
def test_intervals_hold_with_the_static_record_and_not_as_white(campaigns: ModuleType) -> None:
    """100 campaigns, noise that lasts 0.5 s: 95 % intervals of each derivative hold within the binomial's 99.9 % limits."""
    t = campaigns.times(8.0, 40.0)
    clean = [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M]
    inside, white = np.zeros(6), np.zeros(6)
    for seed in range(SEEDS):
        fit = fit_runs(filmed(campaigns, clean, np.random.default_rng([21, seed]), 8.0, 0.5, 60.0), "linear")
        assert fit.naive_covariance is not None
        error = np.abs(fit.six - campaigns.SIX)
        inside += error < 1.96 * np.sqrt(np.diag(fit.covariance))
        white += error < 1.96 * np.sqrt(np.diag(fit.naive_covariance))
    low, high = binom.ppf([0.0005, 0.9995], SEEDS, 0.95)
    assert (inside >= low).all(), inside
    assert (inside <= high).all(), inside
    assert (white < low).all(), white


@pytest.mark.slow
def test_slow_noise_of_the_camera_is_not_taken_for_a_force(campaigns: ModuleType) -> None:
    """Noise that lasts as long as a third of a swing looks like a force, unless the model held still shows the same."""
    t = campaigns.times(8.0)
    clean = [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M]
    runs = filmed(campaigns, clean, np.random.default_rng(22), 8.0, 6.0, 120.0)
    known = fit_with_noise(runs, "linear")
    assert known.method == "output_error"
    assert "static records" in known.notes[0]
    assert fit_with_noise([replace(r, still=None) for r in runs], "linear").method == "innovations"


@pytest.mark.slow
def test_a_force_beside_a_coloured_measurement_is_found(campaigns: ModuleType) -> None:
    t = campaigns.times(8.0)
    rng = np.random.default_rng(23)
    pushed = [campaigns.pushed_run(x, rng, t, 0.05, 0.05, priors=Priors()) for x in campaigns.POINTS_M[::3]]
    fit = fit_with_noise(filmed(campaigns, pushed, rng, 8.0, 2.0, 120.0), "linear")
    assert fit.method == "innovations"
    assert "beyond what the static records show" in fit.notes[0]
    assert fit.disturbance is not None
    # its logarithm's own standard deviation, four times
    assert abs(np.log(fit.disturbance.force_n / 0.05)) < 4 * fit.disturbance.log_sd[0]
    assert (np.abs(fit.six - campaigns.SIX) < 4 * np.sqrt(np.diag(fit.covariance))).all()


def test_the_filter_with_a_slow_measurement_has_the_dense_likelihood(campaigns: ModuleType) -> None:
    """Without a force (1e-9 N) the innovations' -2 log L is that of white plus first-order noise alone."""
    t = campaigns.times(8.0, 10.0)
    run = campaigns.still_run(1.649, t)
    noise = np.log([1e-9, 1e-9, 0.7, 1.2, 0.9])
    slow = Slow(np.array([0.4, 0.7]), np.array([0.8, 2.5]))
    z = np.random.default_rng(1).normal(size=(2, len(t))) * [[1e-3], [2e-3]]
    found = innovations([Filtered(run, z, np.zeros((2, 1, len(t))), slow)], campaigns.SIX, noise, 1.28)[0]
    ours = np.linalg.slogdet(found.spread)[1].sum() + (found.white**2).sum()
    dense = 0.0
    lag = np.abs(t[:, None] - t[None, :])
    for c, sd in enumerate(np.exp(noise[3:]) * [campaigns.SIGMA_Y_M, campaigns.SIGMA_BETA_RAD]):
        part = slow.share[c] * np.eye(len(t)) + (1 - slow.share[c]) * np.exp(-lag / slow.time_s[c])
        dense += np.linalg.slogdet(sd**2 * part)[1] + z[c] @ np.linalg.solve(sd**2 * part, z[c])
    assert ours == pytest.approx(dense, abs=1e-6)
    # the slope by the scatters: -2 d log L = 2 (number of samples) - 2 (quadratic form)
    inverse = np.linalg.inv(found.spread)
    weighed = np.einsum("nij,nj->ni", inverse, found.error)
    slope = 2 * np.einsum("nki,ni->k", found.d_error[:, 1:], weighed) + np.einsum(
        "nij,nkji->k", inverse, found.d_spread
    )
    slope -= np.einsum("ni,nkij,nj->k", weighed, found.d_spread, weighed)
    assert slope[9] + slope[10] == pytest.approx(2 * (2 * len(t) - (found.white**2).sum()), rel=1e-6)


def test_the_whitener_is_exact_from_the_first_sample() -> None:
    """A covariance with an autoregression's own continuation becomes the identity."""
    rho = 0.6 * 0.9 ** np.arange(9) + 0.4 * (np.arange(9) == 0)
    regression, share = from_correlation(rho, 100_000)
    assert len(regression) > 3
    whole = list(rho[: len(regression) + 1])
    while len(whole) < 50:
        whole.append(float(regression @ whole[-1 : -len(regression) - 1 : -1]))
    root = np.linalg.cholesky(toeplitz(whole))
    weight = Whitener(
        np.tile(np.eye(2), (50, 1, 1)),
        (regression, regression),
        np.ones(2),
        np.sqrt([share, share]),
        np.zeros(50, dtype=int),
    )
    white = weight(np.stack([root, root], axis=1))[:, 0]
    np.testing.assert_allclose(white @ white.T, np.eye(50), atol=1e-12)


def test_what_a_record_says_of_its_colour() -> None:
    """Long records: time constant, white share and the spectrum at rest to within a fifth, over 20 draws on average."""
    rng = np.random.default_rng(3)
    rate, time_s, found, flat = 16.0, 2.0, [], []
    a = np.exp(-1 / (rate * time_s))
    at_rest = (1 - WHITE_SHARE) * (1 + a) / (1 - a) + WHITE_SHARE
    for _ in range(20):
        values = coloured(rng, 4000, rate, time_s)
        t = np.arange(4000) / rate
        found.append(block_colour(t, values[:, 0], 0.5))
        colour = colour_of([Still(t, values, np.tile(np.eye(2), (4000, 1, 1)))], 1 / rate)
        assert colour is not None
        flat.append(colour.share / (1 - np.array([c.sum() for c in colour.regression])) ** 2 / at_rest)
    variance, share, lasting = np.mean(found, axis=0)
    # means over half a second of a noise that lasts two: the slow part loses 8 % of its variance, the white part 7/8
    assert variance == pytest.approx(0.92 * 0.7 + 0.3 / 8, rel=0.2)
    assert lasting == pytest.approx(time_s, rel=0.2)
    assert share < 0.15
    assert np.mean(flat) == pytest.approx(1.0, abs=0.2)
    short = Still(np.arange(50) / rate, values[:50], np.tile(np.eye(2), (50, 1, 1)))
    assert colour_of([short], 1 / rate) is None
    assert "50 measured samples" in short.useless(1 / rate)
    enough = Still(np.arange(FEWEST) / rate, values[:FEWEST], np.tile(np.eye(2), (FEWEST, 1, 1)))
    assert enough.useless(1 / rate) == ""
    assert "samples a second" in Still(2 * t, values, np.tile(np.eye(2), (4000, 1, 1))).useless(1 / rate)


@pytest.mark.slow
def test_the_command_reads_the_static_record(cases: ModuleType, tmp_path: Path) -> None:
    """Two filmed tows, white pixels: the record is read (its hash too), used, and a short one is said to be too short."""
    campaign = cases.campaign("none", np.random.default_rng([24, 1]))
    folders = []
    for k, (run, tracks, static) in enumerate(campaign.runs[:3]):
        path = tmp_path / run.name
        path.mkdir()
        content = run.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        (path / "run.toml").write_text(tomlkit.dumps(content))
        write_table(path / "tracks.csv", tracks)
        write_table(path / "static.csv", static[static["t_s"] < 1.0] if k == 1 else static)
        folders.append(str(path))
    command = ["identify", *folders, "--form", "linear", "--noise", "output", "--no-page", "-o", str(tmp_path / "out")]
    assert main(command) == 0
    result = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
    names = [run.name for run, _, _ in campaign.runs[:3]]
    assert f"{names[0]}/static.csv" in result.inputs
    assert any(names[1] in note and "static record" in note and "25 measured samples" in note for note in result.notes)
    assert not any(names[0] in note and "static record" in note for note in result.notes)
    (tmp_path / names[0] / "static.csv").write_text("frame,t_s\n1,2\n")
    assert main(command) == 3
    result = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
    assert "static.csv" in result.failed[names[0]]


@pytest.mark.parametrize(("memory", "count", "records"), [(0.9, 200, 4), (0.8, 100, 6)])
def test_what_the_means_of_short_records_took_is_put_back(memory: float, count: int, records: int) -> None:
    """Centring n samples of an autoregression lowers its coefficients by about (1 + 3 a)/n; a third of that is granted."""
    rng, found = np.random.default_rng(31), []
    for _ in range(200):
        drawn = rng.normal(size=(records, count + SPENT))
        series = np.asarray(lfilter([1], [1, -memory], drawn, axis=1))[:, SPENT:]
        eye = np.tile(np.eye(2), (count, 1, 1))
        colour = colour_of([Still(np.arange(count) * 1.0, np.column_stack([one, one]), eye) for one in series], 1.0)
        assert colour is not None
        found.append(colour.regression[0].sum())
    assert abs(np.mean(found) - memory) < 2 * (1 + 3 * memory) / count / 3


@pytest.mark.slow
def test_records_drawn_from_a_fit_scatter_as_the_static_record_and_the_force_do(campaigns: ModuleType) -> None:
    """A bootstrap's draws about the fitted motion: the variance of the force's motion and of the record held still."""
    t, rng = campaigns.times(8.0), np.random.default_rng(32)
    pushed = [campaigns.pushed_run(x, rng, t, 0.05, 0.05, priors=Priors()) for x in campaigns.POINTS_M[::3]]
    runs = filmed(campaigns, pushed, rng, 8.0, 2.0, 120.0)
    fit = fit_with_noise(runs, "linear")
    assert fit.disturbance is not None
    colour = colours(runs)[0]
    gone, forced = [], []
    for _ in range(40):
        drawn = drawn_record(fit, runs[0], 0, colour, rng)
        gone.append(np.column_stack([drawn.y_m, drawn.beta_rad]) - fit.response[0])
        forced.append(pushed_by(fit, runs[0], rng))
    still = runs[0].still
    assert still is not None
    whole = np.var(gone, axis=(0, 1))
    parts = np.var(forced, axis=(0, 1)) + still.values.var(axis=0)
    # noise and force last seconds of 60: 40 records hold some hundreds of memories, their variance a tenth of itself
    np.testing.assert_allclose(whole, parts, rtol=0.3)


@pytest.mark.parametrize(
    ("memory", "taken", "left"), [(0.6, 0.6, 0.0), (0.6, 0.0, 0.6), (0.0, 0.0, 0.0), (0.6, 0.3, 0.337)]
)
def test_what_a_filter_leaves_of_the_colour(memory: float, taken: float, left: float) -> None:
    """Two records of x = m x + e filtered by a: the autocorrelation of (1 - a q) / (1 - m q) e, to the tenth of the shorter."""
    rng = np.random.default_rng(4)
    series = [lfilter([1.0], [1.0, -memory], rng.normal(size=n + 200))[200:] for n in (6000, 4000)]
    found = correlation_left(series, np.array([taken]))
    assert len(found) == 401
    assert found[0] == 1.0
    # (m - a)(1 - m a) / (1 - 2 m a + a^2) at lag 1, m of that at each further one
    first = (memory - taken) * (1 - memory * taken) / (1 - 2 * memory * taken + taken**2)
    assert first == pytest.approx(left, abs=0.01)
    np.testing.assert_allclose(found[1:5], first * memory ** np.arange(4), atol=4 / np.sqrt(10_000) + 0.01)
