"""The joint fit's inside against closed forms and the simulator: exponential, partials, paths, large swings, efficiency."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scipy.linalg import expm

from towline.identify import fit_runs
from towline.identify.joint.full import full_paths
from towline.identify.joint.linear import exponential, linear_paths, system_matrices
from towline.identify.joint.parameters import COUNT, hull_from, run_tow
from towline.identify.joint.partials import TURNING, linearise
from towline.identify.joint.thin import thinned
from towline.identify.limits.bound import cramer_rao
from towline.identify.methods.criteria import fit_criterion
from towline.identify.multistart import multistart
from towline.identify.response import full_response, linear_response
from towline.record import EstimationError, Priors
from towline.simulate import Start, Tow, linear_system, simulate_full
from towline.simulate.model import Hull, Line, alpha_from_y, full_state


@pytest.mark.parametrize("norm", [0.02, 3.0, 40.0])
def test_the_exponential_and_its_derivatives_against_scipys_of_the_block_matrix(norm: float) -> None:
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(2, 5, 5)) - 1.5 * np.eye(5)
    matrix *= norm / np.abs(matrix).sum(axis=-1).max()
    slopes = rng.normal(size=(2, 3, 5, 5))
    steps = np.array([1.0, 0.4])
    power, change = exponential(matrix, slopes, steps)
    for b in range(2):
        for k in range(3):
            block = np.block([[matrix[b], slopes[b, k]], [np.zeros((5, 5)), matrix[b]]])
            exact = expm(block * steps[b])
            # rounding grows with the squarings: about norm times 1e-16 of the largest entry
            scale = np.abs(exact).max() * max(norm, 1.0)
            np.testing.assert_allclose(power[b], exact[:5, :5], atol=1e-14 * scale)
            np.testing.assert_allclose(change[b, k], exact[:5, 5:], atol=1e-13 * scale)


@pytest.mark.parametrize("line", ["constant", "surge"])
def test_partials_against_the_complex_step_of_the_one_equation_of_motion(line: Line) -> None:
    """Any state and tow, off-centre tow point, moving post, rudder over, carriage gaining speed: equal to rounding."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        values = np.array(
            [
                *rng.uniform([100, 40, -70, -90, -70, -80], [200, 80, -30, -40, -30, -30]),
                *rng.uniform(-0.6, 0.6, 4),
                *rng.uniform([2, 1.2, 0.6, 0.8], [6, 1.9, 1.4, 1.6]),
                *rng.uniform([-7, 0, -40, -5, 1.5], [-1, 80, 10, 5, 2.2]),
                *rng.uniform([10, -30, -0.5, -0.5], [30, -10, 0.5, 0.5]),
            ]
        )
        tow = replace(
            Tow(1.28, 0.91, 1.5, 3.96),
            tow_point_offset_m=0.03,
            post_amplitude_m=0.05,
            post_frequency_hz=0.2,
            post_phase_rad=0.7,
            rudder_rad=0.2,
            line=line,
        )
        # the carriage at 1.03 of its nominal speed and gaining 0.02 of it in a second
        share, late = (1.03, 0.02) if line == "surge" else (1.0, 0.0)

        def there(moved: np.ndarray, tow: Tow = tow, share: float = share, late: float = late) -> tuple[Hull, Tow]:
            nominal = run_tow(tow, moved).speed_m_s
            now = replace(run_tow(tow, moved), speed_m_s=nominal * share, speed_rate_m_s2=nominal * late)
            return hull_from(moved, 1.1, 78.0).at_speed(nominal), now

        def both(moved: np.ndarray) -> np.ndarray:
            found = full_state(1.3, moved[6:10], *there(moved))
            return np.append(found.rates, found.tension_n)

        hull, here = there(values)
        every = tuple(range(COUNT))
        found = linearise(1.3, values[6:10, None], _columns(hull), here, every, 1.1)
        moved = np.zeros((4, 4 + COUNT, 1))
        moved[range(4), range(4)] = 1.0
        slopes = found.along(moved, 4, every)[:, :, 0]
        # alpha' by itself, of no more parameters than those that turn the line at a state that stands
        turning = linearise(1.3, values[6:10, None], _columns(hull), here, TURNING, 1.1, False)
        np.testing.assert_array_equal(turning.turn_along(moved[:, 4:], every)[:, 0], slopes[0, 4:])
        pulls = found.tension_along(moved[:, 4:], every)[:, 0] if line == "surge" else None
        for index in range(COUNT):
            column = values.astype(complex)
            column[index] += 1e-30j
            exact = np.imag(both(column)) / 1e-30
            at = index - 6 if 6 <= index < 10 else 4 + index
            np.testing.assert_allclose(slopes[:, at], exact[:4], rtol=1e-11, atol=1e-13)
            if pulls is not None and not 6 <= index < 10:
                assert pulls[index] == pytest.approx(exact[4], rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("line", ["constant", "surge"])
def test_a_path_of_longer_steps_or_other_values_leads_to_the_same_answer(campaigns: ModuleType, line: Line) -> None:
    """Where the next path is looked for changes how long it takes; sensitivities are promised to one in ten thousand."""
    runs = [campaigns.still_run(x, campaigns.times(20.0, 20.0)) for x in (1.446, 1.751)]
    runs = [replace(d, tow=replace(d.tow, line=line), mass_kg=78.0) for d in runs]
    along = [-4.0, 35.0, -10.0, 0.0, 1.85]
    values = np.zeros((2, COUNT))
    values[:, :14] = [[*campaigns.SIX, 0.15, 0.02, 0, 0, 3.96, d.tow.tow_point_m, 0.91, 1.28] for d in runs]
    values[:, 14 : 14 + len(along)] = along
    exact, fine = full_paths(runs, values, 1.28)
    _, rough = full_paths(runs, values, 1.28, rough=True)
    _, beside = full_paths(runs, values * 1.003, 1.28)
    assert rough.step_s > fine.step_s
    for guess in (rough.path, beside.path, beside):
        found, there = full_paths(runs, values, 1.28, guess=guess)
        np.testing.assert_allclose(there.states, fine.states, atol=1e-10)
        for (path, slope), (right, steep) in zip(found, exact, strict=True):
            np.testing.assert_allclose(path, right, atol=1e-10)
            np.testing.assert_allclose(slope, steep, atol=1e-4 * np.abs(steep).max(axis=2, keepdims=True).max())
    # of the second run only; and of a record that the path does not cover there is nothing to take
    (alone,), _ = full_paths(runs[1:], values[1:], 1.28, guess=rough.path.of([1]))
    np.testing.assert_allclose(alone[0], exact[1][0], atol=1e-10)
    assert rough.path.on(fine.step_s, 2 * fine.states.shape[1]) is None


def _columns(hull):
    return replace(
        hull,
        **{name: np.atleast_1d(getattr(hull, name)) for name in ("y_v", "y_r_minus_mu", "n_v", "n_r")},
    )


def test_the_linear_path_over_gaps_and_jitter_is_the_matrix_exponential(campaigns: ModuleType) -> None:
    """Every sample at its own time: against exp(A t) by eigenvalues, to 1e-11 of the amplitude."""
    rng = np.random.default_rng(3)
    t = campaigns.times(25.0, 60.0)
    keep = (t < 20) | (t > 31)
    keep[rng.integers(1, len(t) - 1, 100)] = False
    t = t[keep] + rng.uniform(0, 0.4 / 25, keep.sum())
    run = campaigns.still_run(1.649, t)
    values = np.array([*campaigns.SIX, 0.15, 0.02, 0.01, -0.02, 3.96, 1.649, 0.91, 1.28])
    response, _ = linear_response(run, values, 1.28)
    matrix, _ = linear_system(campaigns.HULL, run.tow)
    np.testing.assert_allclose(system_matrices([run], values[None], 1.28, [])[0][0, :4, :4], matrix, rtol=1e-14)
    roots, shapes = np.linalg.eig(matrix)
    sizes = np.linalg.solve(shapes, values[6:10].astype(complex))
    exact = np.real((shapes[:2] * sizes) @ np.exp(roots[:, None] * (t - t[0]))).T
    np.testing.assert_allclose(response, exact, atol=1e-11)


def test_a_run_among_others_answers_as_alone(campaigns: ModuleType) -> None:
    runs = [campaigns.still_run(x, campaigns.times(rate, 20.0)) for x, rate in ((1.446, 20.0), (1.751, 31.0))]
    values = np.array([[*campaigns.SIX, 0.15, 0, 0, 0, 3.96, d.tow.tow_point_m, 0.91, 1.28] for d in runs])
    together = linear_paths(runs, values, 1.28, (0, 3, 7, 11))
    for i, run in enumerate(runs):
        alone = linear_paths([run], values[i : i + 1], 1.28)[0]
        np.testing.assert_allclose(together[i][0], alone[0], atol=1e-13)
        np.testing.assert_allclose(together[i][1], alone[1][:, [0, 3, 7, 11]], atol=1e-10)


@pytest.fixture(scope="module")
def large(campaigns: ModuleType):
    t = campaigns.times(16.0)
    return [
        campaigns.still_run(x, t, "full", Start(alpha_rad=float(a)))
        for x, a in zip(campaigns.POINTS_M, campaigns.LARGE_STARTS_RAD, strict=True)
    ]


def test_large_swings_are_followed_by_all_steps_at_once(campaigns: ModuleType, large) -> None:
    """alpha to 50 degrees: Runge-Kutta at 0.05 s errs by 1e-7 of the amplitude of 0.7 m, also where Newton begins far off."""
    values = np.array(
        [
            [*campaigns.SIX, a, 0, 0, 0, 3.96, d.tow.tow_point_m, 0.91, 1.28]
            for d, a in zip(large, campaigns.LARGE_STARTS_RAD, strict=True)
        ]
    )
    for run, (response, _) in zip(large, full_response(large, values, 1.28), strict=True):
        assert np.degrees(np.abs(alpha_from_y(run.y_m, run.beta_rad, run.tow)).max()) > 45
        np.testing.assert_allclose(response, np.column_stack([run.y_m, run.beta_rad]), atol=1e-7)
    astray = values.copy()
    astray[:, 0] *= 0.2  # past 90 degrees: no motion, and no exception
    assert any(np.isnan(r).any() for r, _ in full_response(large, astray, 1.28))
    motion = simulate_full(campaigns.HULL, large[3].tow, Start(alpha_rad=0.1), campaigns.times(16.0, 20.0))
    assert np.isfinite(motion["y_cg_m"]).all()


def test_large_swings_give_the_derivatives_without_a_guess(campaigns: ModuleType, large) -> None:
    """No noise: back to 1e-5. The linear form on the same records is tens of per cent off."""
    still = [replace(r, priors=Priors()) for r in large]
    np.testing.assert_allclose(fit_runs(still, "full").six, campaigns.SIX, rtol=3e-5)
    assert np.abs(fit_runs(still, "linear").six / campaigns.SIX - 1).max() > 0.1


@pytest.mark.slow
def test_large_swings_are_unbiased(campaigns: ModuleType, large) -> None:
    """5 seeds: the mean error of each derivative lies within 4 of its standard errors (the benchmark: 50 seeds, 2)."""
    errors, sds = [], []
    for seed in range(5):
        fit = fit_runs(campaigns.campaign(large, np.random.default_rng([4, seed])), "full")
        errors.append(fit.six - campaigns.SIX)
        sds.append(np.sqrt(np.diag(fit.covariance)))
    z = np.mean(errors, axis=0) / (np.mean(sds, axis=0) / np.sqrt(len(errors)))
    assert np.abs(z).max() < 4


@pytest.mark.slow
@pytest.mark.parametrize("nuisance", [False, True])
def test_the_fit_scatters_by_the_bound(campaigns: ModuleType, nuisance: bool) -> None:
    """A slice of the benchmark: 60 campaigns at 16 Hz. The mean square of the standardised errors over six (correlated)
    derivatives is 1 within 4 standard errors, sqrt(2 / 60) each as if all six were one."""
    t = campaigns.times(16.0)
    priors = campaigns.NUISANCE if nuisance else campaigns.EXACT
    still = [campaigns.still_run(x, t, priors=priors) for x in campaigns.POINTS_M]
    bound = np.sqrt(np.diag(cramer_rao(still, campaigns.SIX)))
    errors, inside = [], []
    for seed in range(60):
        rng = np.random.default_rng([5, seed])
        runs = campaigns.nuisance_campaign(rng, t) if nuisance else campaigns.campaign(still, rng)
        fit = fit_runs(runs, "linear")
        errors.append((fit.six - campaigns.SIX) / bound)
        inside.append(np.abs(fit.six - campaigns.SIX) < 1.96 * np.sqrt(np.diag(fit.covariance)))
    assert abs(np.mean(np.square(errors)) - 1) < 4 * np.sqrt(2 / 60)
    assert np.mean(inside) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / 60)
    if nuisance:
        ignored = fit_runs([campaigns.unaware(r) for r in runs], "linear")
        assert np.abs((ignored.six - campaigns.SIX) / bound).max() > 5


def test_block_means_keep_time_and_gaps() -> None:
    from towline.identify import RunData

    t = np.arange(0, 60, 1 / 64)
    t = np.concatenate([t[:1000], t[1100:]])
    tow = Tow(1.28, 0.91, 1.5, 3.96)
    covariance = np.tile(np.diag([1e-6, 3e-6]), (len(t), 1, 1))
    run = RunData("r", t, 2 * t, -t, covariance, np.zeros((0, len(t), 2)), "", tow, None, None, Priors(), False)
    few = thinned(run)
    assert 5 < len(t) / len(few.t_s) < 9
    np.testing.assert_allclose(few.y_m, 2 * few.t_s, atol=1e-12)
    assert not ((few.t_s > t[999]) & (few.t_s < t[1000])).any()
    # information is kept: sum of inverse variances
    np.testing.assert_allclose((1 / few.covariance[:, 0, 0]).sum(), 1e6 * len(t), rtol=1e-9)
    first = thinned(run, keep_first=True)
    assert first.t_s[0] == t[0]


def test_the_criteria_of_appendix_four(campaigns: ModuleType) -> None:
    """det(Q) and tr(S Q) with S the true weights agree with the output-error fit; a wrong S costs efficiency, and says so."""
    t = campaigns.times(16.0)
    runs = campaigns.campaign([campaigns.still_run(x, t) for x in campaigns.POINTS_M], np.random.default_rng(6))
    fit = fit_runs(runs, "linear")
    sd = np.sqrt(np.diag(fit.covariance))
    for criterion in ("trace", "determinant"):
        found = fit_criterion(runs, criterion)
        assert np.abs((found.six - fit.six) / sd).max() < 0.3  # other weights by the scatter's own error
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sd, rtol=0.1)
        np.testing.assert_allclose(np.sqrt(np.diag(found.q)), [1e-3, np.radians(0.1)], rtol=0.1)
    lopsided = fit_criterion(runs, "trace", s=np.diag([1.0, 1e-6]))  # beta hardly counts
    assert (np.diag(lopsided.covariance) > np.diag(fit.covariance)).all()
    with pytest.raises(EstimationError, match="positive definite"):
        fit_criterion(runs, "trace", s=np.diag([1.0, -1.0]))
    with pytest.raises(EstimationError, match="criterion"):
        fit_criterion(runs, "mean")


@pytest.mark.slow
def test_scattered_starts_reach_the_same_optimum_or_a_worse_one(campaigns: ModuleType) -> None:
    t = campaigns.times(16.0)
    runs = campaigns.campaign([campaigns.still_run(x, t) for x in campaigns.POINTS_M], np.random.default_rng(7))
    found = multistart(fit_runs(runs, "linear"), runs, np.random.default_rng(0), starts=8)
    assert found.reached >= 5
    assert found.better == 0
