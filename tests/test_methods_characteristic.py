"""Characteristic coefficients <-> derivatives: exact round trips, propagated errors, appendix I with its warning."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.characteristic import (
    appendix_one,
    coefficients_from_roots,
    derivatives_from_coefficients,
    derivatives_from_roots,
    monic_coefficients,
    roots_from_coefficients,
)
from towline.record import EstimationError
from towline.simulate import Hull, Tow, linear_system, stability

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
X1, X2, X3 = 1.751, 1.5985, 1.446


def tow(x_t: float) -> Tow:
    return Tow(1.28, 0.91, x_t, 3.96)


def roots(x_t: float) -> np.ndarray:
    return np.linalg.eigvals(linear_system(HULL, tow(x_t))[0])


def test_the_coefficients_are_those_of_the_state_matrix() -> None:
    np.testing.assert_allclose(coefficients_from_roots(roots(X1)), monic_coefficients(HULL, tow(X1)), rtol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_four_roots_at_two_tow_points_give_all_six_exactly(seed: int) -> None:
    """(9.3) on hulls of every kind; the coefficients' rounding is amplified by up to 1e5."""
    rng = np.random.default_rng(seed)
    six = SIX * rng.uniform(0.5, 1.8, 6)
    hull = HULL.with_six(six)
    pair = tuple(stability(hull, tow(x)).roots for x in (X1, X3))
    found = derivatives_from_roots(pair[0], pair[1], (tow(X1), tow(X3)))
    np.testing.assert_allclose(found.six, six, rtol=1e-8)
    assert not found.notes


def test_errors_of_the_roots_propagate() -> None:
    """4 000 draws of the coefficients with 1e-5 each: sds within 4 standard errors and 2 % (curvature)."""
    first, second = (monic_coefficients(HULL, tow(x)) for x in (X1, X3))
    covariance = np.diag(np.full(8, 1e-10))
    found = derivatives_from_coefficients(first, second, (tow(X1), tow(X3)), covariance)
    rng = np.random.default_rng(6)
    draws = np.array(
        [
            derivatives_from_coefficients(first + a, second + b, (tow(X1), tow(X3))).six
            for a, b in rng.normal(0, 1e-5, (4000, 2, 4))
        ]
    )
    np.testing.assert_allclose(draws.std(axis=0) / found.sd, 1.0, atol=4 / np.sqrt(8000) + 0.02)


def test_sds_of_roots() -> None:
    coefficients = monic_coefficients(HULL, tow(X1))
    covariance = np.diag([4e-10, 1e-10, 9e-10, 1e-10])
    found, sd = roots_from_coefficients(coefficients, covariance)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(roots(X1)), rtol=1e-9)
    rng = np.random.default_rng(7)
    draws = np.array(
        [roots_from_coefficients(c, covariance)[0] for c in rng.multivariate_normal(coefficients, covariance, 4000)]
    )
    ordered = np.take_along_axis(draws, np.argsort(-draws.imag, axis=1), axis=1)[:, 0]
    at = int(np.argmax(found.imag))
    assert ordered.real.std() == pytest.approx(sd[at, 0], rel=0.05)
    assert ordered.imag.std() == pytest.approx(sd[at, 1], rel=0.05)


@pytest.mark.slow
def test_appendix_one_is_exact_without_noise_and_says_what_noise_does() -> None:
    pairs = [r[np.argmax(r.imag)] for r in (roots(x) for x in (X1, X2, X3))]
    z, w = [-p.real for p in pairs], [p.imag for p in pairs]
    tows = [tow(x) for x in (X1, X2, X3)]
    found = appendix_one(z, w, tows, SIX[1], sd=1e-4)
    for index, x in enumerate((X1, X2, X3)):
        np.testing.assert_allclose(np.sort_complex(found.roots[index]), np.sort_complex(roots(x)), atol=1e-6)
        np.testing.assert_allclose(found.coefficients[index], monic_coefficients(HULL, tow(x)), atol=1e-6)
    np.testing.assert_allclose(found.derivatives.six, SIX, rtol=1e-4)
    sd = np.sqrt(np.diag(found.covariance))
    # the warning's own figures (theory.md 9.4: +-0.07 and +-0.09 about 1.27 and 0.18)
    assert (found.x[0], found.y[0]) == pytest.approx((1.27, 0.18), abs=0.006)
    assert "1e-3 makes it useless" in found.warning
    coarse = appendix_one(z, w, tows, SIX[1], sd=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(coarse.covariance)), 10 * sd, rtol=1e-3)
    # tow points 0.1525 m apart: 0.08 in both, and half of m' is gone
    assert (sd[0], sd[3]) == pytest.approx((0.0816, 0.0832), abs=5e-4)
    assert found.derivatives.sd[0] / SIX[0] == pytest.approx(0.514, abs=5e-3)
    rng = np.random.default_rng(8)
    draws = np.array(
        [
            np.concatenate([a.x[:1], a.y[:1]])
            for a in (appendix_one(z + e[:3], w + e[3:], tows, SIX[1]) for e in rng.normal(0, 1e-5, (400, 6)))
        ]
    )
    np.testing.assert_allclose(draws.std(axis=0) / (sd[[0, 3]] / 10), 1.0, atol=4 / np.sqrt(800) + 0.02)


def test_unusable_inputs_are_refused() -> None:
    r = roots(X1)
    with pytest.raises(EstimationError, match="both tow points"):
        derivatives_from_roots(r, r, (tow(X1), tow(X1)))
    with pytest.raises(EstimationError, match="has four"):
        coefficients_from_roots(r[:3])
    with pytest.raises(EstimationError, match="conjugate"):
        coefficients_from_roots(np.array([-1.0, -0.1, 0.1j, 0.2j]))
    with pytest.raises(EstimationError, match="line_length_m"):
        derivatives_from_roots(r, roots(X3), (tow(X1), Tow(1.28, 0.6, X3, 3.96)))
    with pytest.raises(EstimationError, match="equal steps"):
        appendix_one([0.0] * 3, [0.4] * 3, [tow(x) for x in (1.7, 1.6, 1.4)], 60.0)
    wrong = derivatives_from_coefficients(
        monic_coefficients(HULL, tow(X1)), monic_coefficients(HULL, tow(X3)), (tow(X1), tow(X3)), np.eye(8) * 1e-2
    )
    assert "do not hold the derivatives" in wrong.notes[0]


def test_two_tows_alike_where_the_method_needs_them_different_are_refused() -> None:
    """C/A, the second coefficient, is what tells I'."""
    tows = Tow(1.28, 0.91, 1.446, 3.96), Tow(1.28, 0.91, 1.751, 3.96)
    first, second = (monic_coefficients(HULL, t) for t in tows)
    with pytest.raises(EstimationError, match="C/A is the same"):
        derivatives_from_coefficients(first, np.array([second[0], first[1], second[2], second[3]]), tows)
    derivatives_from_coefficients(first, second, tows)
    with pytest.raises(EstimationError, match="two different ones"):
        derivatives_from_coefficients(first, second, (tows[0], tows[0]))
    off = second.copy()
    off[0] *= 1.002
    assert any(
        "must not depend on the tow point" in note for note in derivatives_from_coefficients(first, off, tows).notes
    )
    assert not any("must not depend" in n for n in derivatives_from_coefficients(first, second, tows).notes)
