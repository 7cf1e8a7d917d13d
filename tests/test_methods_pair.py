"""The pair of two decaying tows and nothing else: decay fits at two tow points, then the closed form (9.2 with s = -l3 + i w)."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods import derivatives_from_coefficients, fit_decay, modal_derivatives
from towline.simulate import Hull, Start, Tow, simulate_full, simulate_linear

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
SIGMA = np.array([1e-3, np.radians(0.1)])
DRAWS = 16
LARGEST_SCATTER = np.array([0.011, 0.009, 0.010, 0.0025, 0.008, 0.005])
"""About 1.7 times the scatter over 30 other draws, 0.62 0.53 0.49 0.11 0.38 0.21 %; joint fit: 0.50 0.40 0.48 0.07 0.32 0.19."""


@pytest.mark.slow
def test_two_decaying_tows_give_all_six_with_true_errors() -> None:
    """60 s at 10 Hz, 1 mm and 0.1 degree. rms z over derivatives and draws is 1 within 4 standard errors and 15 %.

    Six correlated derivatives count as three. The same records through their four roots (9.3) are useless: the real roots
    are too weak in the record, and the stated errors say so.
    """
    rng = np.random.default_rng(21)
    t = np.arange(0, 60, 0.1)
    tows = [Tow(1.28, 0.91, x, 3.96) for x in (1.446, 1.751)]
    clean = [
        simulate_linear(HULL, w, Start(y_cg_m=0.2, beta_rad=0.03), t)[["y_cg_m", "beta_rad"]].to_numpy() for w in tows
    ]
    found, roots_sd = [], []
    for _ in range(DRAWS):
        fits = [fit_decay(t, *(c + SIGMA * rng.normal(size=c.shape)).T) for c in clean]
        found.append(modal_derivatives([f.swing(w) for f, w in zip(fits, tows, strict=True)]))
        first, second = (f.coefficients() for f in fits)
        covariance = np.zeros((8, 8))
        covariance[:4, :4], covariance[4:, 4:] = first[1], second[1]
        roots_sd.append(derivatives_from_coefficients(first[0], second[0], (tows[0], tows[1]), covariance).sd)
    z = np.array([(f.six - SIX) / f.sd for f in found])
    assert abs(np.sqrt(np.mean(z**2)) - 1) < 4 / np.sqrt(2 * DRAWS * 3) + 0.15, z.std(axis=0)
    scatter = np.std([f.six / SIX for f in found], axis=0)
    assert (scatter < LARGEST_SCATTER).all(), scatter
    assert (np.median(roots_sd, axis=0) > 0.3 * np.abs(SIX)).sum() >= 4, np.median(roots_sd, axis=0) / np.abs(SIX)


def test_the_pair_is_a_linear_idea() -> None:
    """Full-sine tows without noise: the bias grows with the square of the swing, 0.3 % at 5 cm, 1 % at 10 cm, 4.5 % at 20 cm."""
    t = np.arange(0, 60, 0.1)
    worst = []
    for y_0 in (0.05, 0.1, 0.2):
        swings = []
        for x in (1.446, 1.751):
            tow = Tow(1.28, 0.91, x, 3.96)
            motion = simulate_full(HULL, tow, Start(y_cg_m=y_0), t)
            swings.append(fit_decay(t, motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy()).swing(tow))
        worst.append(np.abs(modal_derivatives(swings).six / SIX - 1).max())
    np.testing.assert_allclose(worst, [0.0028, 0.0105, 0.0447], rtol=0.03)
