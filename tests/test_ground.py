"""An uneven ground pulls a mark: by how much, read beside it, is what it does to the fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from towline.vision.spots.fit import fit_spots
from towline.vision.spots.ground import pull_about
from towline.vision.spots.model import ELLIPSE, SHARED, SLOPED, Model, U, V, start_of

HALF_PX, INNER_PX, WIDTH_PX, HEIGHT_DN, NOISE_DN = 16, 6, 2.0, 80.0, 1.5
WINDOWS = 300
WITHIN = 0.25
"""Of the ratio of standard deviations: that of 600 errors is known to 3 %; the covariance is read from a ring that holds some
six lengths of the texture, of which the fit's own level and slopes take a part, in 300 windows."""


def _windows(rng: np.random.Generator, texture_dn: float, grain_px: float) -> np.ndarray:
    """Marks in the middle of windows, each over a ground of its own, which they cover."""
    side = 2 * HALF_PX + 1
    ground = np.stack([gaussian_filter(rng.normal(size=(side + 40, side + 40)), grain_px) for _ in range(WINDOWS)])
    ground = 100 + texture_dn * (ground / ground.std())[:, 20:-20, 20:-20]
    axis = np.arange(side) - HALF_PX
    cover = np.exp(-0.5 * (axis[:, None] ** 2 + axis[None, :] ** 2) / WIDTH_PX**2)
    clean = ground + cover * (100 + HEIGHT_DN - ground)
    return clean + rng.normal(0, NOISE_DN, clean.shape)


def _stated_and_true(wide: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations of the centre in u and v: by the ground, by the errors, by the fit."""
    rim = HALF_PX - INNER_PX
    inner, corner = wide[:, rim:-rim, rim:-rim], np.zeros((WINDOWS, 2))
    start = start_of(inner, np.full((WINDOWS, 2), float(INNER_PX)), np.full(WINDOWS, WIDTH_PX))
    noise = (NOISE_DN**2, 0.0)
    fit = fit_spots(inner, corner, start, model, noise)
    error = fit.theta[:, U : V + 1][fit.good] - INNER_PX
    by_noise = np.median(fit.sigma_px**2 / fit.chi_square[:, None], axis=0)
    stated = by_noise * pull_about((wide, corner - rim), (inner, corner), fit.theta, model, noise)
    return np.sqrt(stated), error.std(axis=0), np.median(fit.sigma_px, axis=0)


@pytest.mark.once
@pytest.mark.parametrize("model", [SHARED, ELLIPSE, SLOPED], ids=lambda model: model.name)
@pytest.mark.parametrize("grain_px", [1.0, 2.5])
def test_what_the_ground_does_to_a_centre_is_read_beside_the_mark(model: Model, grain_px: float) -> None:
    stated, true, fitted = _stated_and_true(_windows(np.random.default_rng(1), 6.0, grain_px), model)
    assert stated / true == pytest.approx(1.0, abs=WITHIN)
    assert (true > 1.3 * fitted).all()  # the fit's own sigma, which takes it for noise, is too small: the case is one


def test_an_even_ground_gives_what_the_fit_says() -> None:
    stated, true, fitted = _stated_and_true(_windows(np.random.default_rng(2), 0.0, 2.0), SHARED)
    assert stated / fitted == pytest.approx(1.0, abs=0.1)
    assert true / fitted == pytest.approx(1.0, abs=0.1)
