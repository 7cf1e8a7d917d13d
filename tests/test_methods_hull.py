"""Hull conditions, prime system, straight-line verdict."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.hull_conditions import (
    from_prime,
    neutral_stern_force,
    probability_by_sampling,
    straight_line_stability,
    to_prime,
    with_stern_force,
)
from towline.record import EstimationError
from towline.simulate import Hull

TABLE_3_1 = Hull(249.6448, 93.9161, -97.17078, -42.7710, -92.5523, -94.0412, speed_m_s=1.30)
SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
LPP_M = 3.15


def test_the_stern_force_moves_both_points_as_in_theory_9_1() -> None:
    found = [with_stern_force(TABLE_3_1, f, LPP_M) for f in (0.0, 7.0, 10.76, 15.85)]
    np.testing.assert_allclose([h.x_r_m for h in found], [2.199, 1.518, 1.248, 0.953], atol=5e-4)
    np.testing.assert_allclose([h.x_v_m for h in found], [0.952, 1.136, 1.248, 1.414], atol=5e-4)
    assert [h.straight_line_stable for h in found] == [True, True, True, False]


def test_a_fin_is_what_the_stern_force_says() -> None:
    """F acts at x_d on the drift v + x_d r there."""
    arm, f = -0.45 * LPP_M, 7.0
    found = with_stern_force(TABLE_3_1, f, LPP_M)
    v, r = 0.3, -0.2
    force = f * (v + arm * r)
    side = (found.y_v - TABLE_3_1.y_v) * v + (found.y_r_minus_mu - TABLE_3_1.y_r_minus_mu) * r
    moment = (found.n_v - TABLE_3_1.n_v) * v + (found.n_r - TABLE_3_1.n_r) * r
    assert (side, moment) == pytest.approx((force, force * arm), rel=1e-12)


def test_the_neutral_force() -> None:
    force = neutral_stern_force(TABLE_3_1, LPP_M)
    neutral = with_stern_force(TABLE_3_1, force, LPP_M)
    assert neutral.x_r_m == pytest.approx(neutral.x_v_m, rel=1e-12)
    assert force == pytest.approx(10.766, abs=1e-3)
    fin = Hull(1, 1, -1, 0.45 * LPP_M, 0.45 * LPP_M, -((0.45 * LPP_M) ** 2), speed_m_s=1)  # nothing but that fin
    with pytest.raises(EstimationError, match="does not change"):
        neutral_stern_force(fin, LPP_M)


def test_primes_go_there_and_back() -> None:
    prime = to_prime(SIX, 1025, 2.66, 1.276, np.diag(SIX**2 * 1e-4))
    again = from_prime(np.array([p.value for p in prime.values()]), 1025, 2.66, 1.276)
    np.testing.assert_allclose(again.six, SIX, rtol=1e-12)
    np.testing.assert_allclose([p.std / abs(p.value) for p in prime.values()], 0.01, rtol=1e-9)


@pytest.mark.parametrize("sd_share", [0.005, 0.02, 0.05])
def test_delta_method_and_sampling_agree(sd_share: float) -> None:
    """Within 4 binomial standard errors and 1 % (the curvature at 5 % errors); the correlations count."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6))
    correlation = root @ root.T
    scale = np.sqrt(np.diag(correlation))
    covariance = correlation / scale[:, None] / scale * np.outer(SIX, SIX) * sd_share**2
    verdict = straight_line_stability(SIX, covariance)
    sampled = probability_by_sampling(SIX, covariance, rng)
    assert abs(verdict.probability_stable - sampled.value) < 4 * sampled.std + 0.01
    assert verdict.criterion.value == pytest.approx(-172.4, abs=0.1)
    assert "straight-line unstable" in verdict.sentence
    assert (verdict.x_v_m.value, verdict.x_r_m.value) == pytest.approx((0.9175, 0.8684), abs=1e-4)


def test_a_hull_known_exactly_is_sure() -> None:
    assert straight_line_stability(SIX, np.zeros((6, 6))).probability_stable == 0.0
    assert straight_line_stability(TABLE_3_1.six, np.zeros((6, 6))).probability_stable == 1.0


@pytest.mark.parametrize(("n_r", "verdict"), [(-57.60, "unstable"), (-80.0, "stable")])
def test_the_verdict_is_as_sure_as_its_own_side(n_r: float, verdict: str) -> None:
    """X_r against X_v; the probability said is that of the verdict."""
    six = np.array([149.19, 62.11, -52.87, -66.33, -48.51, n_r])
    found = straight_line_stability(six, np.diag((0.03 * six) ** 2))
    sure = found.probability_stable if verdict == "stable" else 1 - found.probability_stable
    assert 0.5 < sure <= 1
    assert found.sentence.startswith(f"straight-line {verdict}: ")
    assert found.sentence.endswith(f"probability of that verdict {100 * sure:.1f} %")
    exact = straight_line_stability(six, np.zeros((6, 6)))
    assert exact.probability_stable == float(verdict == "stable")
    assert exact.sentence.endswith("probability of that verdict 100.0 %")
