"""Coloured forces on the hull: the filter against dense covariances, the fit against truth, the choice, the bootstrap."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from towline.identify import fit_runs, fit_with_noise
from towline.identify.colour.bootstrap import bootstrap
from towline.identify.colour.choose import CLEARLY, white_bic
from towline.identify.colour.innovations import maximise
from towline.identify.colour.kalman import Filtered, innovations
from towline.identify.data import RunData
from towline.identify.joint.problem import Answer
from towline.identify.joint.thin import thinned
from towline.identify.noise import ljung_box_p
from towline.record import EstimationError, Priors

RATE_HZ = 8.0


def dense(campaigns: ModuleType, six: np.ndarray, noise: np.ndarray, point: float, t: np.ndarray) -> np.ndarray:
    """Covariance of (y, beta) from rest, (2n, 2n): one motion of hull, force and moment, covariances by powers of its step."""
    from scipy.linalg import expm

    from towline.simulate import Hull, Tow, linear_system

    force, moment, time_s, scale_y, scale_beta = np.exp(noise)
    whole, drive = np.zeros((6, 6)), np.zeros((6, 6))
    whole[:4, :4] = linear_system(Hull(*six, speed_m_s=1.28), Tow(1.28, 0.91, point, 3.96))[0]
    whole[2, 4], whole[3, 5], whole[4, 4], whole[5, 5] = 1 / six[0], 1 / six[1], -1 / time_s, -1 / time_s
    drive[4, 4], drive[5, 5] = 2 * force**2 / time_s, 2 * moment**2 / time_s
    step = expm(whole * (t[1] - t[0]))
    # the covariance that the drive adds in a step: Simpson's rule over 200 parts, good to 1e-10
    parts = np.linspace(0, t[1] - t[0], 201)
    weight = np.where(np.arange(201) % 2, 4.0, 2.0) * (parts[1] / 3)
    weight[[0, -1]] /= 2
    added = sum(w * expm(whole * s) @ drive @ expm(whole * s).T for w, s in zip(weight, parts, strict=True))
    count = len(t)
    state, found = np.diag([0, 0, 0, 0, force**2, moment**2]), np.zeros((count, 2, count, 2))
    for i in range(count):
        cross = state
        for k in range(i, count):
            found[k, :, i, :], found[i, :, k, :] = cross[:2, :2], cross[:2, :2].T
            cross = step @ cross
        state = step @ state @ step.T + added
    white = np.tile([scale_y * campaigns.SIGMA_Y_M, scale_beta * campaigns.SIGMA_BETA_RAD], count)
    return found.reshape(2 * count, 2 * count) + np.diag(white**2)


def test_the_innovations_have_the_likelihood_of_the_dense_covariance(campaigns: ModuleType) -> None:
    """-2 log L of any record: sum of log det S + e' S^-1 e equals log det C + z' C^-1 z; the derivatives too."""
    t = campaigns.times(RATE_HZ, 8.0)
    run = campaigns.still_run(1.649, t)
    noise = np.log([0.03, 0.01, 0.7, 1.2, 0.9])
    z = np.random.default_rng(1).normal(size=(2, len(t))) * [[3e-3], [4e-3]]

    def deviance(six: np.ndarray, noise: np.ndarray) -> float:
        c = dense(campaigns, six, noise, 1.649, t)
        return float(np.linalg.slogdet(c)[1] + z.T.ravel() @ np.linalg.solve(c, z.T.ravel()))

    found = innovations([Filtered(run, z, np.zeros((2, 1, len(t))))], campaigns.SIX, noise, 1.28)[0]
    inverse = np.linalg.inv(found.spread)
    ours = np.linalg.slogdet(found.spread)[1].sum() + np.einsum("ni,nij,nj->", found.error, inverse, found.error)
    assert ours == pytest.approx(deviance(campaigns.SIX, noise), abs=1e-6)
    weighed = np.einsum("nij,nj->ni", inverse, found.error)
    slope = 2 * np.einsum("nki,ni->k", found.d_error[:, 1:], weighed)
    slope += np.einsum("nij,nkji->k", inverse, found.d_spread)
    slope -= np.einsum("ni,nkij,nj->k", weighed, found.d_spread, weighed)
    for index in range(11):
        six, other = campaigns.SIX.copy(), noise.copy()
        step = 1e-4 * abs(six[index]) if index < 6 else 1e-4
        values = []
        for sign in (1, -1):
            moved, changed = six.copy(), other.copy()
            if index < 6:
                moved[index] += sign * step
            else:
                changed[index - 6] += sign * step
            values.append(deviance(moved, changed))
        difference = (values[0] - values[1]) / (2 * step)
        # central differences of numbers near 1e3 by steps of 1e-4: 1e-16 * 1e3 / 1e-4, and the curvature
        assert slope[index] == pytest.approx(difference, rel=1e-4, abs=1e-5 / min(step, 1.0))


def test_runs_filtered_side_by_side_are_each_as_alone(campaigns: ModuleType) -> None:
    """Of unlike lengths, one with a gap, one whose noise grows; to the rounding of some hundred steps."""
    rng, noise = np.random.default_rng(3), np.log([0.03, 0.01, 0.7, 1.2, 0.9])
    cases = []
    for x, seconds, columns in ((1.446, 6.0, 3), (1.649, 10.0, 2), (1.751, 8.0, 3)):
        run = campaigns.still_run(x, campaigns.times(RATE_HZ, seconds))
        kept = np.ones(len(run.t_s), bool)
        kept[20:27] = x != 1.649
        grown = run.covariance[kept] * np.linspace(1, 2 if x == 1.446 else 1, kept.sum())[:, None, None]
        run = replace(run, t_s=run.t_s[kept], covariance=grown, y_m=run.y_m[kept], beta_rad=run.beta_rad[kept])
        residual = rng.normal(size=(2, len(run.t_s))) * 2e-3
        cases.append(Filtered(run, residual, rng.normal(size=(2, columns, len(run.t_s)))))
    for one, beside in zip(cases, innovations(cases, campaigns.SIX, noise, 1.28), strict=True):
        (alone,) = innovations([one], campaigns.SIX, noise, 1.28)
        for name in ("error", "spread", "d_error", "d_spread"):
            wanted = getattr(alone, name)
            assert getattr(beside, name) == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.slow
def test_a_search_far_from_what_was_asked_for_ends_early(campaigns: ModuleType) -> None:
    """White noise and no force: the whole search gains less than ``SLIGHT`` where the early one gave up, and takes longer."""
    rng, t = np.random.default_rng(11), campaigns.times(16.0, 40.0)
    runs = [campaigns.noisy(campaigns.still_run(x, t, "modal"), rng) for x in campaigns.POINTS_M[::3]]
    fit = fit_runs(runs, "linear")
    asked: list[float] = []

    def wanted(few: list[RunData], answers: list[Answer]) -> float:
        asked.append(white_bic(few, answers) - CLEARLY - 5 * np.log(sum(2 * len(d.t_s) for d in few)))
        return asked[-1]

    early = maximise(runs, "linear", fit.speed_m_s, fit.theta, asked=wanted)
    whole = maximise(runs, "linear", fit.speed_m_s, fit.theta)
    assert not early.converged
    assert early.steps < whole.steps / 2
    assert 0 <= early.deviance - whole.deviance < 1.0
    assert whole.deviance > asked[-1]
    near = maximise(runs, "linear", fit.speed_m_s, fit.theta, asked=lambda *_: whole.deviance)
    assert near.steps == whole.steps


@pytest.mark.slow
def test_the_kalman_filters_fit_is_efficient_and_its_intervals_true(campaigns: ModuleType) -> None:
    """8 campaigns of two runs at 16 Hz: a slice of the benchmark. Mean square of z over six derivatives is 1 within 4 standard
    errors of 8 draws, sqrt(2 / 8) as if the six were one; the output error's naive intervals miss by far."""
    t = campaigns.times(16.0)
    z, naive = [], []
    for seed in range(8):
        rng = np.random.default_rng([2, seed])
        runs = [campaigns.noisy(campaigns.pushed_run(x, rng, t), rng) for x in campaigns.POINTS_M[::3]]
        fit = fit_runs(runs, "linear")
        found = maximise(runs, "linear", fit.speed_m_s, fit.theta)
        assert found.converged
        z.append((found.theta[:6] - campaigns.SIX) / np.sqrt(np.diag(found.covariance)[:6]))
        assert fit.naive_covariance is not None
        naive.append((fit.six - campaigns.SIX) / np.sqrt(np.diag(fit.naive_covariance)))
    assert np.mean(np.square(z)) < 1 + 4 * np.sqrt(2 / 8)
    assert np.mean(np.square(z)) > 0.2
    assert np.sqrt(np.mean(np.square(naive))) > 4
    d = found.disturbance
    truth = np.log([campaigns.FORCE_N, campaigns.FORCE_N, campaigns.FORCE_TIME_S, 1.0, 1.0])
    assert (np.abs(found.noise - truth) < 4 * d.log_sd).all()


@pytest.mark.slow
def test_the_noise_is_chosen_by_what_the_residuals_show(campaigns: ModuleType) -> None:
    t = campaigns.times(16.0)
    rng = np.random.default_rng(3)
    still = [campaigns.still_run(x, t, "modal") for x in campaigns.POINTS_M[::3]]
    white = fit_with_noise(campaigns.campaign(still, rng), "linear")
    assert white.method == "output_error"
    assert "white" in white.notes[0]
    slow = [lfilter([1], [1, -0.94], rng.normal(size=(2, len(t))), axis=1) * np.sqrt(1 - 0.94**2) for _ in still]
    measured = [
        replace(r, y_m=r.y_m + 1e-3 * n[0], beta_rad=r.beta_rad + campaigns.SIGMA_BETA_RAD * n[1])
        for r, n in zip(still, slow, strict=True)
    ]
    codec = fit_with_noise(measured, "linear")
    assert codec.method == "output_error"
    assert "colour of the measurement" in codec.notes[0]
    forced = [campaigns.noisy(campaigns.pushed_run(x, rng, t), rng) for x in campaigns.POINTS_M[::3]]
    pushed = fit_with_noise(forced, "linear")
    assert pushed.method == "innovations"
    assert "force on the hull" in pushed.notes[0]
    assert pushed.disturbance is not None
    assert fit_with_noise(forced, "linear", noise="output").method == "output_error"
    with pytest.raises(EstimationError, match="noise"):
        fit_with_noise(forced, noise="brown")


def test_a_force_that_explains_nothing_is_not_chosen(campaigns: ModuleType) -> None:
    """Colour of a twentieth of a second: nearly white in block means, so that a filter without any force costs least numbers."""
    t = campaigns.times(64.0, 40.0)
    rng = np.random.default_rng(7)
    runs = []
    for x in campaigns.POINTS_M:
        slow = lfilter([1], [1, -0.7], rng.normal(size=(2, len(t))), axis=1) * np.sqrt(1 - 0.7**2)
        made = campaigns.still_run(x, t, "modal")
        runs.append(
            replace(made, y_m=made.y_m + 1e-3 * slow[0], beta_rad=made.beta_rad + campaigns.SIGMA_BETA_RAD * slow[1])
        )
    fit = fit_with_noise(runs, "linear")
    assert fit.method == "output_error"
    assert "explains none of it" in fit.notes[0]


def test_a_filter_without_any_noise_has_no_likelihood(campaigns: ModuleType) -> None:
    """Exact motions lead there: said in words, and a step that leads there is not taken."""
    runs = [campaigns.still_run(x, campaigns.times(8.0, 40.0), "modal") for x in campaigns.POINTS_M[::3]]
    fit = fit_runs(runs, "linear")
    nothing = np.array([-400.0, -400.0, 0.0, -400.0, -400.0])
    with pytest.raises(EstimationError, match="no likelihood"):
        maximise(runs, "linear", 1.28, fit.theta, noise=nothing)


def test_a_spread_that_is_negative_in_both_channels_has_no_likelihood(
    campaigns: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its determinant is positive as a variance's is, and -2 log L without bound below: a search would run to it."""
    import towline.identify.colour.innovations as room

    rng = np.random.default_rng(4)
    runs = [
        campaigns.noisy(campaigns.still_run(x, campaigns.times(8.0, 40.0), "modal"), rng)
        for x in campaigns.POINTS_M[::3]
    ]
    fit = fit_runs(runs, "linear")
    whole = room.innovations
    negative = lambda *given: [replace(found, spread=-found.spread) for found in whole(*given)]  # noqa: E731
    monkeypatch.setattr(room, "innovations", negative)
    with pytest.raises(EstimationError, match="no likelihood"):
        maximise(runs, "linear", fit.speed_m_s, fit.theta)


@pytest.mark.slow
def test_common_camera_errors_stay_in_the_innovations_form(campaigns: ModuleType) -> None:
    """A 2 % scale of y with its mode is found under a coloured force as well."""
    t = campaigns.times(16.0)
    rng = np.random.default_rng(4)
    runs = []
    for x in campaigns.POINTS_M[::3]:
        made = campaigns.noisy(campaigns.pushed_run(x, rng, t, 0.005, 0.005), rng)
        mode = np.zeros((1, len(t), 2))
        mode[0, :, 0] = 0.02 * made.y_m
        runs.append(replace(made, y_m=1.02 * made.y_m, common=mode, common_key="camera"))
    fit = fit_with_noise(runs, "linear", noise="innovations")
    assert fit.modes["camera"][0] == pytest.approx(1.0, abs=0.3)
    assert (np.abs(fit.six - campaigns.SIX) < 4 * np.sqrt(np.diag(fit.covariance))).all()


@pytest.mark.slow
def test_the_bootstrap_gives_the_fishers_scatter(campaigns: ModuleType) -> None:
    """20 draws know a standard deviation to 16 %, 10 to 24 %: within 4 of that of the Fisher information's, for both models."""
    t = campaigns.times(8.0, 40.0)
    rng = np.random.default_rng(5)
    still = [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M]
    runs = campaigns.campaign(still, rng)
    fit = fit_runs(runs, "linear")
    found = bootstrap(fit, runs, rng, 20)
    ratio = np.sqrt(np.diag(found.covariance) / np.diag(fit.covariance))
    assert (np.abs(ratio - 1) < 4 / np.sqrt(2 * 19)).all(), ratio
    assert (found.interval[:, 0] < fit.six).all()
    assert (found.interval[:, 1] > fit.six).all()
    forced = [campaigns.noisy(campaigns.pushed_run(x, rng, t), rng) for x in campaigns.POINTS_M[::3]]
    fit = fit_with_noise(forced, "linear", noise="innovations")
    found = bootstrap(fit, forced, rng, 10)
    ratio = np.sqrt(np.diag(found.covariance) / np.diag(fit.covariance))
    assert (np.abs(np.log(ratio)) < 4 / np.sqrt(2 * 9)).all(), ratio


def test_a_gap_in_the_record_is_a_longer_step_of_the_filter(campaigns: ModuleType) -> None:
    """Leaving blocks out of a record leaves the innovations of the rest what the joint density of the rest says."""
    t = campaigns.times(RATE_HZ, 8.0)
    kept = np.ones(len(t), bool)
    kept[20:31] = False
    run = campaigns.still_run(1.649, t)
    cut = replace(run, t_s=t[kept], covariance=run.covariance[kept], y_m=run.y_m[kept], beta_rad=run.beta_rad[kept])
    noise = np.log([0.02, 0.02, 0.5, 1.0, 1.0])
    z = np.random.default_rng(6).normal(size=(2, len(t))) * 2e-3
    found = innovations([Filtered(cut, z[:, kept], np.zeros((2, 1, int(kept.sum()))))], campaigns.SIX, noise, 1.28)[0]
    ours = np.linalg.slogdet(found.spread)[1].sum() + (found.white**2).sum()
    rows = np.flatnonzero(np.repeat(kept, 2))
    c = dense(campaigns, campaigns.SIX, noise, 1.649, t)[np.ix_(rows, rows)]
    flat = z.T.ravel()[rows]
    assert ours == pytest.approx(np.linalg.slogdet(c)[1] + flat @ np.linalg.solve(c, flat), abs=1e-6)
    assert len(thinned(cut).t_s) == kept.sum()  # 8 Hz is coarse enough as it stands


@pytest.mark.parametrize("fitted", [None, 3])
def test_the_whiteness_test_is_ljung_and_boxs(fitted: int | None) -> None:
    """n (n + 2) sum rho_k^2 / (n - k) over 30 lags, chi-square of 30 less what was fitted, its variance by 1 + 2 30/400 larger."""
    values = np.random.default_rng(8).normal(size=400)
    values[1:] += 0.15 * values[:-1]
    centred = values - values.mean()
    rho = np.array([centred[k:] @ centred[: len(centred) - k] for k in range(1, 31)]) / (centred @ centred)
    statistic = 400 * 402 * (rho**2 / (400 - np.arange(1, 31))).sum()
    wider = 1 + 60 / 400
    wanted = chi2.sf(statistic / wider, (30 - (fitted or 0)) / wider)
    found = ljung_box_p(values) if fitted is None else ljung_box_p(values, fitted)
    assert found == pytest.approx(wanted, rel=1e-9)
    assert 1e-6 < wanted < 0.5
    # an autoregression fitted to 200 samples elsewhere: 3 x 400 / 200 more in the mean of 30
    assert ljung_box_p(values, elsewhere=(3, 200)) == pytest.approx(
        chi2.sf(statistic / (1 + 6 / 30) / wider, 30 / wider), rel=1e-9
    )
    assert ljung_box_p(values, fitted=28, lags=30) == pytest.approx(
        ljung_box_p(values, fitted=28, lags=33), rel=1e-9
    )  # five lags more than were fitted


@pytest.mark.parametrize(("samples", "lags"), [(500, 62), (1500, 187), (3840, 200)])
def test_white_records_are_called_coloured_as_often_as_stated(samples: int, lags: int) -> None:
    """3,000 white records; unwidened chi-square calls 1.3 to 2 times too many coloured at one in a hundred."""
    rng = np.random.default_rng(samples)
    found = np.array([ljung_box_p(rng.normal(size=samples), lags=lags) for _ in range(3000)])
    for level in (0.05, 0.01):
        assert (found < level).mean() < level * 1.25 + 3 * np.sqrt(level / 3000)
        assert (found < level).mean() > level * 0.75 - 3 * np.sqrt(level / 3000)
