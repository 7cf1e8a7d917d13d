"""What the records cannot tell: refusals, combinations, the run that helps, profile likelihoods."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from towline.identify import derivatives_file, fit_runs
from towline.identify.limits.bound import cramer_rao, information, information_of_six
from towline.identify.limits.combinations import determined
from towline.identify.limits.cure import cure, released_run
from towline.identify.limits.identifiability import ANCHOR_SHARE, OPEN_VARIANCE, without_anchors
from towline.identify.limits.profile import interval_end, plausible, profile, walked_outward
from towline.identify.limits.words import combination_name, transient_share
from towline.identify.report import examined
from towline.record import Priors
from towline.record.priors import DerivativePriors, ValuePrior
from towline.record.schema import ModelTable, WaterTable
from towline.simulate import Start, simulate_linear

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


@pytest.mark.once
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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("index", "value", "sd", "bounded_below"),
    [(0, 50.0, 1.0, True), (4, -3.0, 0.4, True), (1, 20.0, 20.0, False)],
)
def test_the_ends_of_a_parabola_are_196_deviations_away(
    index: int, value: float, sd: float, bounded_below: bool
) -> None:
    """Rise ((x - value) / sd)^2; a mass is not looked for below a tenth of its value, and has no end there."""

    def rise(x: float) -> float:
        return ((x - value) / sd) ** 2

    walks = [walked_outward(rise, value, sign * 0.7 * sd, plausible(index, value)) for sign in (-1, 1)]
    low, high = (interval_end(value, walk) for walk in walks)
    assert high == pytest.approx(value + 1.959964 * sd, rel=1e-4)
    assert low == (pytest.approx(value - 1.959964 * sd, rel=1e-4) if bounded_below else None)
    for walk in walks:
        assert [r for _, r in walk] == [rise(v) for v, _ in walk]
        assert all(r < 3.842 for _, r in walk[:-1])  # nothing is fitted beyond the first rise that is high enough
    assert interval_end(value, [(value + 4.0, 4 * 3.841)]) == pytest.approx(
        value + 2.0
    )  # one step that is twice too long


@pytest.mark.parametrize(
    ("index", "value", "within"), [(0, 50.0, (5.0, 500.0)), (3, -50.0, (-500.0, 400.0)), (2, 50.0, (-400.0, 500.0))]
)
def test_where_nothing_rises_the_search_ends_at_what_can_be(
    index: int, value: float, within: tuple[float, float]
) -> None:
    """A mass from a tenth to ten times its value, a damping within nine times its size, and no end in either direction."""
    assert plausible(index, value) == pytest.approx(within)
    for sign in (-1, 1):
        walk = walked_outward(lambda _: 0.0, value, sign * 2.0, within)
        at = np.array([v for v, _ in walk])
        assert ((at > within[0]) & (at < within[1])).all()
        assert not within[0] < at[-1] + 1.5 * (at[-1] - at[-2]) < within[1]  # one more step would leave it
        assert interval_end(value, walk) is None
    assert interval_end(value, []) is None
    assert len(walked_outward(lambda _: 0.0, value, 1e-3, within)) == 14


def test_a_proposed_run_is_that_of_the_linear_form_with_the_noise_that_was_seen(campaigns: ModuleType) -> None:
    """Against ``simulate_linear``; the median covariance counts, one sample of the record is a hundred times worse."""
    run = campaigns.still_run(1.548, campaigns.times(8.0, 20.0))
    covariance = np.tile([[4e-6, 1e-6], [1e-6, 9e-6]], (len(run.t_s), 1, 1))
    covariance[0] *= 100
    run = replace(run, covariance=covariance, t_s=run.t_s + 3.0)
    made = released_run(run, campaigns.SIX, 1.28, 0.1, np.array([2.0, 0.5]))
    assert made is not None
    np.testing.assert_allclose(made.covariance[7], [[16e-6, 1e-6], [1e-6, 2.25e-6]])
    assert (made.tow.tow_point_m, made.tow.line_length_m) == (run.tow.tow_point_m + 0.1, run.tow.line_length_m)
    np.testing.assert_allclose(made.t_s, np.arange(len(run.t_s)) / 8)
    wanted = simulate_linear(campaigns.HULL, made.tow, Start(y_cg_m=0.15), made.t_s)
    np.testing.assert_allclose(made.y_m, wanted["y_cg_m"], atol=1e-6)
    np.testing.assert_allclose(made.beta_rad, wanted["beta_rad"], atol=1e-6)


GROWING = np.array([1, 1, 1, 1, 1, -0.3])
"""Negative yaw damping: the tow oscillates ever wider."""


@pytest.mark.parametrize(
    ("changed", "move_m", "span_s", "proposed"),
    [
        (1.0, "just aft of the neutral point", 20.0, False),
        (1.0, -1.6, 20.0, False),  # behind the centre of gravity
        (GROWING, 0.0, 20.0, False),  # wider than 0.8 of its line before it ends
        (GROWING, 0.0, 1.0, True),
    ],
)
def test_no_run_is_proposed_that_cannot_be_towed(
    campaigns: ModuleType, changed: float | np.ndarray, move_m: float | str, span_s: float, proposed: bool
) -> None:
    six = campaigns.SIX * changed
    move = six[4] / six[2] - 1.548 - 0.001 if isinstance(move_m, str) else move_m
    run = campaigns.still_run(1.548, campaigns.times(8.0, span_s), "modal")
    assert (released_run(run, six, 1.28, move, np.ones(2)) is not None) == proposed


def test_what_is_known_without_the_anchors() -> None:
    """A known information matrix, the anchors' added and taken out again."""
    rng = np.random.default_rng(3)
    six = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
    size, anchor = np.abs(six), six * [1.2, 0.9, 1, 1, 1, 1]
    root = rng.normal(size=(6, 6))
    scaled = root @ root.T + 300 * np.eye(6)
    added = np.diag([*(size[:2] / (ANCHOR_SHARE * anchor[:2])) ** 2, 0, 0, 0, 0])
    outer = np.outer(size, size)
    found = without_anchors(np.linalg.inv(scaled + added) * outer, six, anchor)
    np.testing.assert_allclose(found, np.linalg.inv(scaled) * outer, rtol=1e-8)
    # m' is known by its anchor alone
    scaled = np.diag([0.0, *[400.0] * 5])
    found = np.diag(without_anchors(np.linalg.inv(scaled + added) * outer, six, anchor)) / size**2
    np.testing.assert_allclose(found, [OPEN_VARIANCE, *[1 / 400] * 5], rtol=1e-6)


def test_the_information_on_the_six_is_the_inverse_of_their_covariance(campaigns: ModuleType) -> None:
    """A real run with its start, biases, tension and tow point free: the whole matrix inverted, the six's block inverted again."""
    run = campaigns.still_run(1.548, campaigns.times(4.0, 40.0), "modal", priors=campaigns.NUISANCE)
    matrix, problem = information([run], campaigns.SIX, "linear", 1.28)
    free = np.flatnonzero(problem.free)
    assert len(free) > 10
    inner = matrix[np.ix_(free, free)]
    scale = np.sqrt(np.diag(inner))
    whole = (np.linalg.inv(inner / np.outer(scale, scale)) / np.outer(scale, scale))[:6, :6]
    found = information_of_six(matrix, problem) @ whole
    sd = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(found * sd / sd[:, None], np.eye(6), atol=1e-5)
