"""What the records cannot tell: refusals, combinations, the run that helps, profile likelihoods."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from towline.identify import derivatives_file, fit_runs
from towline.identify.limits.bound import cramer_rao
from towline.identify.limits.combinations import determined
from towline.identify.limits.cure import cure
from towline.identify.limits.profile import profile
from towline.identify.limits.words import combination_name, transient_share
from towline.identify.report import examined
from towline.record import Priors
from towline.record.priors import DerivativePriors, ValuePrior
from towline.record.schema import ModelTable, WaterTable

RATE_HZ = 16.0
LOST_S = 20.0


def oscillation(campaigns: ModuleType, point: float, seed: int):
    """One run without its first 20 s."""
    t = campaigns.times(RATE_HZ)
    still = campaigns.still_run(point, t, "modal", priors=Priors())
    kept = t >= LOST_S
    cut = {n: getattr(still, n)[kept] for n in ("t_s", "y_m", "beta_rad", "covariance")}
    cut["covariance"] = cut["covariance"] * RATE_HZ / 64  # as much is known as at 64 Hz
    run = replace(still, common=np.zeros((0, int(kept.sum()), 2)), **cut)
    rng = np.random.default_rng([1, seed])
    sd = np.sqrt(run.covariance[:, [0, 1], [0, 1]])
    return replace(
        run,
        y_m=run.y_m + sd[:, 0] * rng.normal(size=len(sd)),
        beta_rad=run.beta_rad + sd[:, 1] * rng.normal(size=len(sd)),
    )


@pytest.mark.parametrize("point", [1.446, 1.649, 1.751])
def test_a_pure_oscillation_is_refused_and_its_combinations_are_true(campaigns: ModuleType, point: float) -> None:
    """16 seeds: m', I', Y_R and N_v refused in every one; two combinations given, and what is given by itself or combined
    holds the truth in 95 % within 4 binomial standard errors of 16 draws (as if all were one); never 4 sd away."""
    scores = []
    for seed in range(16):
        run = oscillation(campaigns, point, seed)
        found = examined(fit_runs([run], "linear"), [run])
        parts = found.parts
        assert {0, 1, 3, 4} <= set(parts.refused)
        leading = {c.leading: c for c in parts.combinations}
        assert {3, 4} <= set(leading)
        # m' stands with Y_R, I' with N_v (theory: two complex balances, the masses enter with the frequency)
        assert leading[3].coefficients[0] == pytest.approx(0.2, abs=0.05)
        assert leading[3].coefficients[1] == 0.0
        assert leading[4].coefficients[1] == pytest.approx(-0.62, abs=0.06)
        assert leading[3].sd < 0.01 * abs(leading[3].value)
        scores += [(found.fit.six[i] - campaigns.SIX[i]) / np.sqrt(found.covariance[i, i]) for i in parts.single]
        scores += [(c.value - c.coefficients @ campaigns.SIX) / c.sd for c in parts.combinations]
    z = np.abs(scores)
    assert (z < 1.96).mean() > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 16)
    assert z.max() < 5


def test_the_report_says_so_and_names_the_run_that_would_cure_it(campaigns: ModuleType) -> None:
    run = oscillation(campaigns, 1.751, 3)
    file = derivatives_file(
        fit_runs([run], "linear"), [run], ModelTable(length_pp_m=2.66, mass_kg=78.0), WaterTable(), "t", {}, {}, None
    )
    assert not {"m_minus_y_vdot", "i_minus_n_rdot", "y_r_minus_mu", "n_v"} & set(file.derivatives)
    assert "n_r" in file.derivatives
    assert len(file.correlation) == len(file.derivatives)
    words = "\n".join(file.not_identifiable)
    assert "m - Y_vdot, I - N_rdot, Y_r - mU and N_v are not determined by this record" in words
    assert "this record fixes (Y_r - mU) + 0.22" in words
    assert "a second tow point 0.1 m forward of 'x1.751'" in words
    assert "release" in words
    assert "transient" in words


def test_what_is_known_beside_the_record_closes_it(campaigns: ModuleType) -> None:
    """m' from elsewhere to 1 % and K^2 to 1 % leave nothing open in an oscillation; K^2 = I'/m' = 0.4163 m2."""
    known = DerivativePriors(
        m_minus_y_vdot=ValuePrior(value=149.19, std=1.5), k2_m2=ValuePrior(value=62.11 / 149.19, std=0.004)
    )
    run = replace(oscillation(campaigns, 1.649, 1), priors=Priors(derivatives=known))
    fit = fit_runs([run], "linear")
    found = examined(fit, [run])
    assert found.parts.refused == ()
    assert (np.abs(fit.six - campaigns.SIX) < 4 * np.sqrt(np.diag(fit.covariance))).all()
    assert np.sqrt(fit.covariance[1, 1]) / fit.six[1] < 0.02


def test_the_proposed_run_does_what_it_promises(campaigns: ModuleType) -> None:
    """Made and fitted together with the first: the six lie within 4 of the standard deviations that were predicted."""
    run = oscillation(campaigns, 1.649, 0)
    found = examined(fit_runs([run], "linear"), [run])
    proposed = cure(found.fit, found.fit.six, found.covariance, [run])
    assert proposed[0].move_m == 0.1
    t = campaigns.times(RATE_HZ, 40.0)
    made = campaigns.still_run(1.749, t, "modal", priors=Priors())
    made = replace(made, covariance=made.covariance * RATE_HZ / 64)
    bound = np.sqrt(np.diag(cramer_rao([made, run], campaigns.SIX)))
    # predicted at derivatives that are themselves tens of per cent off along the open directions
    np.testing.assert_allclose(proposed[0].sd, bound, rtol=0.5)


def test_four_tow_points_are_determined_and_left_alone(campaigns: ModuleType) -> None:
    t = campaigns.times(RATE_HZ)
    runs = campaigns.campaign(
        [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M], np.random.default_rng(2)
    )
    fit = fit_runs(runs, "linear")
    found = examined(fit, runs)
    assert found.fit is fit
    assert found.parts.single == tuple(range(6))
    assert found.parts.refused == ()
    # released at rest, the two real modes make up a good part of the motion at first
    share = transient_share(fit, runs[0], 0)
    assert share is not None
    assert share > 0.1
    # the full form's own numbers begin with alpha instead of y: the same state, the same share
    y, beta, tow = fit.own[0, 0], fit.own[0, 1], runs[0].tow
    own = fit.own.copy()
    own[0, 0] = np.arcsin((y + tow.tow_point_m * np.sin(beta)) / tow.line_length_m)
    assert transient_share(replace(fit, form="full", own=own), runs[0], 0) == pytest.approx(share, rel=1e-9)


def test_combinations_of_a_known_covariance() -> None:
    """a + 2 b known to 0.01, a and b not: one combination with that factor and that sd, nothing else refused."""
    six = np.array([10.0, 5.0, -3.0, -4.0, -2.0, -1.0])
    covariance = np.diag([1e-4] * 6)
    open_ = np.zeros(6)
    open_[0], open_[3] = -2.0, 1.0  # Y_R + 0.5 m' is fixed
    covariance += 25.0 * np.outer(open_, open_)
    parts = determined(six, covariance)
    assert parts.refused == (0, 3)
    assert parts.single == (1, 2, 4, 5)
    (combination,) = parts.combinations
    np.testing.assert_allclose(combination.coefficients, [0.5, 0, 0, 1, 0, 0], atol=1e-4)
    assert combination.value == pytest.approx(1.0, abs=1e-3)
    assert combination.sd == pytest.approx(np.sqrt(1.25e-4), rel=0.01)
    assert combination_name(combination) == "(Y_r - mU) + 0.5 (m - Y_vdot)"
    assert parts.directions.shape == (1, 6)  # the one that is open, and no other
    np.testing.assert_allclose(
        np.abs(parts.directions[0][[0, 3]]), np.array([0.2, 0.25]) / np.hypot(0.2, 0.25), atol=1e-3
    )


def test_profiles_agree_with_the_fishers_interval_and_stay_open_where_the_record_does(campaigns: ModuleType) -> None:
    """Four runs: ends within 5 % of 1.96 sd. One oscillation: m' has no lower end, and N_r has both."""
    t = campaigns.times(RATE_HZ)
    runs = campaigns.campaign(
        [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M], np.random.default_rng(2)
    )
    fit = fit_runs(runs, "linear")
    for index in (0, 3):
        found = profile(fit, runs, index)
        half = 1.96 * np.sqrt(fit.covariance[index, index])
        low, high = found.interval
        assert low is not None
        assert high is not None
        assert (high - low) / 2 == pytest.approx(half, rel=0.1)
        assert (np.diff(found.value) > 0).all()
    run = oscillation(campaigns, 1.649, 0)
    weak = fit_runs([run], "linear")
    low, high = profile(weak, [run], 0).interval
    assert low is None or high is None or high > 1.5 * low
    low, high = profile(weak, [run], 5).interval
    assert low is not None
    assert high is not None
