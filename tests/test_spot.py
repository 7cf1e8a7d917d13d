"""The sub-pixel fit against its Cramer-Rao bound, model by model, and the noise that tracks show."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from towline.vision import fit_spots, start_of, windows
from towline.vision.backend import backend_for
from towline.vision.spots.candidates import find_candidates
from towline.vision.spots.model import (
    ELLIPSE,
    HEIGHT_2,
    P_UU,
    P_VV,
    PLATEAU,
    Q_UU,
    Q_VV,
    REFLECTION_FREE,
    REFLECTION_SHARED,
    SHARED,
    SLOPED,
    U_2,
    V_2,
    expected,
)
from towline.vision.spots.refine import Refiner
from towline.vision.spots.stack import Stack

AMPLITUDE_DN, GROUND_DN, READ_DN, ELECTRONS_PER_DN = 160.0, 20.0, 3.0, 20.0
NOISE = (READ_DN**2, 1 / ELECTRONS_PER_DN)


def spots(count: int, width: float, rng: np.random.Generator, noise: float = 1.0, size: int = 15, dark: bool = False):
    """Gaussian spots at random sub-pixel places, with their Cramer-Rao bound (sd of one coordinate, px, rms)."""
    axis = np.arange(size, dtype=float)
    centre = (size - 1) / 2 + rng.uniform(-0.5, 0.5, (count, 2))
    x = axis[None, None, :] - centre[:, 0, None, None]
    y = axis[None, :, None] - centre[:, 1, None, None]
    bell = np.exp(-(x**2 + y**2) / (2 * width**2))
    picture = GROUND_DN + AMPLITUDE_DN * ((1 - bell) if dark else bell)
    variance = noise**2 * (READ_DN**2 + picture / ELECTRONS_PER_DN)
    if noise == 0:
        return picture, centre, 0.0
    slope = AMPLITUDE_DN * bell / width**2
    information = np.stack([((slope * a) ** 2 / variance).sum(axis=(1, 2)) for a in (x, y)], axis=1)
    picture = picture + rng.normal(size=picture.shape) * np.sqrt(variance)
    return picture, centre, float(np.sqrt((1 / information).mean()))


def begin(picture, centre, width: float, dark: bool = False):
    """Start values half a pixel off, a tenth too wide."""
    return start_of(picture, np.rint(2 * centre) / 2, np.full(len(picture), width), dark)


@pytest.mark.parametrize("model", [ELLIPSE, SLOPED, PLATEAU])
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1.5, 2.5])
def test_the_fit_is_exact_without_noise(width: float, dark: bool, model) -> None:
    picture, centre, _ = spots(50, width, np.random.default_rng(1), noise=0.0, size=21, dark=dark)
    fit = fit_spots(picture, np.zeros((50, 2)), begin(picture, centre, 1.8, dark), model)
    assert fit.good.all()
    assert np.abs(fit.centre_px - centre).max() < 1e-4
    np.testing.assert_allclose(fit.width_px, width, rtol=1e-3)


# extra free parameters cost what the information matrix says: a slope 6-14 % of the sd, the taper 3 %
@pytest.mark.parametrize(("model", "ratio"), [(SHARED, 1.0), (ELLIPSE, 1.0), (SLOPED, 1.14 * 1.03)])
@pytest.mark.parametrize("width", [1.5, 2.5])
def test_the_fit_is_at_its_bound_and_its_sigma_is_true(width: float, model, ratio: float) -> None:
    """1600 coordinates know a standard deviation to 1.8 %: three of them."""
    size = 2 * max(5, round(2.8 * width)) + 1
    picture, centre, bound = spots(800, width, np.random.default_rng(2), size=size)
    start = begin(picture, centre, width if model is SHARED else 1.15 * width)
    fit = fit_spots(picture, np.zeros((800, 2)), start, model, NOISE)
    gap = fit.centre_px - centre
    assert fit.good.all()
    assert np.sqrt((gap**2).mean()) < (ratio + 0.055) * bound
    assert abs((gap / fit.sigma_px).std() - 1) < 0.055
    assert np.abs(gap.mean(axis=0)).max() < 4 * bound / np.sqrt(800)
    assert abs(np.median(fit.chi_square) - 1) < 0.03


def test_a_reflection_over_the_mark_is_told_from_it() -> None:
    """Known widths give the mark's centre more sharply than free ones, both without the bias of a single spot (0.3 px)."""
    rng = np.random.default_rng(3)
    count, size, width = 300, 27, 2.5
    theta = np.zeros((count, 16))
    theta[:, 0], theta[:, 3], theta[:, 9] = GROUND_DN, AMPLITUDE_DN, 1.0
    theta[:, 4:6] = 11.5 + rng.uniform(-0.5, 0.5, (count, 2))
    theta[:, P_UU] = theta[:, P_VV] = 1 / width**2
    theta[:, HEIGHT_2], theta[:, Q_UU], theta[:, Q_VV] = 70.0, 1 / 2.5**2, 1 / 4.0**2
    theta[:, U_2 : V_2 + 1] = theta[:, 4:6] + [0.5, 5.5] + rng.normal(0, 0.2, (count, 2))
    corner = np.zeros((count, 2))
    clean, _ = expected(theta, corner, size)
    picture = clean + rng.normal(size=clean.shape) * np.sqrt(READ_DN**2 + clean / ELECTRONS_PER_DN)
    start = theta.copy()
    start[:, 4:6] = np.rint(2 * theta[:, 4:6]) / 2
    start[:, U_2 : V_2 + 1] = start[:, 4:6] + [0.5, 5.5]
    gaps = {}
    for model in (ELLIPSE, REFLECTION_SHARED, REFLECTION_FREE):
        fit = fit_spots(picture, corner, start, model, NOISE)
        gap = (fit.centre_px - theta[:, 4:6])[fit.good]
        gaps[model.name] = gap
        if model is not ELLIPSE:
            assert fit.good.mean() > 0.98
            # 600 coordinates know a standard deviation to 2.9 %; the free fit is not linear over its own sd (5 % more)
            assert 0.9 < (gap / fit.sigma_px[fit.good]).std() < 1.15
    rms = {name: np.sqrt((gap**2).mean()) for name, gap in gaps.items()}
    assert rms[REFLECTION_SHARED.name] < 0.6 * rms[REFLECTION_FREE.name] < 0.3 * rms[ELLIPSE.name]


def test_a_clipped_spot_is_placed_by_its_flanks() -> None:
    """Pixels at white are only known to be at least white; half of the signal is gone: twice the unclipped bound."""
    picture, centre, bound = spots(300, 2.5, np.random.default_rng(4), size=19)
    clipped = np.minimum(picture, 110.0)
    fit = fit_spots(clipped, np.zeros((300, 2)), begin(clipped, centre, 2.8), ELLIPSE, NOISE, white_dn=110.0)
    assert fit.good.mean() > 0.99
    gap = (fit.centre_px - centre)[fit.good]
    assert np.sqrt((gap**2).mean()) < 2 * bound
    assert abs(np.median(fit.amplitude_dn) / AMPLITUDE_DN - 1) < 0.05
    assert 0.9 < (gap / fit.sigma_px[fit.good]).std() < 1.1


def test_a_disc_is_fitted_by_a_flat_top() -> None:
    axis = np.linspace(-10, 10, 21)
    sub = (np.arange(5) - 2) / 5
    rng = np.random.default_rng(5)
    centre = rng.uniform(-0.5, 0.5, (100, 2))
    picture = np.zeros((100, 21, 21))
    for du in sub:
        for dv in sub:
            x = axis[None, None, :] + du - centre[:, 0, None, None]
            y = axis[None, :, None] + dv - centre[:, 1, None, None]
            picture += GROUND_DN + 120 / (1 + np.exp((np.hypot(x, y) - 4.3) / 0.4))
    picture = picture / 25 + rng.normal(0, READ_DN, picture.shape)
    fit = fit_spots(picture, np.zeros((100, 2)), begin(picture, centre + 10, 3.0), PLATEAU, (READ_DN**2, 0.0))
    gap = fit.centre_px - centre - 10
    assert fit.good.all()
    assert (fit.sharpness > 1.3).all()
    assert np.sqrt((gap**2).mean()) < 0.06
    assert np.abs(gap.mean(axis=0)).max() < 0.02


def test_windows_beyond_the_edge_are_empty_there() -> None:
    picture = np.arange(100, dtype=np.uint8).reshape(10, 10)
    values, corner = windows(picture, np.array([[0.4, 0.0], [50.0, 50.0]]), 2)
    assert np.isnan(values[0, :2]).all()
    assert values[0, 2, 2] == 0
    assert tuple(corner[0]) == (-2, -2)
    assert np.isnan(values[1]).all()
    stack = Stack(np.ones((1, 9, 9), np.uint8), np.array([[-4, 3]]), np.zeros((1, 2)), (10, 10))
    cut, corner = stack.cut(np.array([[0.0, 8.0]]), 3)
    assert tuple(corner[0]) == (-3, 5)
    assert np.isfinite(cut[0]).tolist() == [[v < 10 and u >= 0 for u in range(-3, 4)] for v in range(5, 12)]


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed (make test KORNIA=0)")
def test_torch_gives_the_same_as_numpy() -> None:
    picture, centre, _ = spots(40, 1.5, np.random.default_rng(6))
    start = begin(picture, centre, 1.6)
    start[:, U_2 : V_2 + 1], start[:, HEIGHT_2] = start[:, 4:6] + 6, 5.0
    for model in (SHARED, SLOPED, PLATEAU):
        one = fit_spots(picture, np.zeros((40, 2)), start, model, NOISE, 255.0)
        two = fit_spots(picture, np.zeros((40, 2)), start, model, NOISE, 255.0, backend_for("torch"))
        np.testing.assert_allclose(one.centre_px, two.centre_px, atol=1e-5)
        np.testing.assert_allclose(one.sigma_px, two.sigma_px, rtol=1e-4)


def stack_of(picture, centre) -> Stack:
    """A mark's windows as the tracker keeps them."""
    values = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    count, size, _ = values.shape
    return Stack(values, np.zeros((count, 2), int), np.rint(2 * centre) / 2, (size, size))


def test_the_noise_of_a_clip_is_read_from_its_residuals() -> None:
    """Read noise and shot noise come out of the windows; rounding adds 1/12. 20 frames of 400 pixels know a variance to 2 %,
    its slope over a spot of 40 pixels to 15 %."""
    picture, centre, _ = spots(64, 2.5, np.random.default_rng(7), size=31)
    refiner = Refiner(2.2, False, 255.0)
    for _ in range(4):
        refined = refiner.refine(stack_of(picture, centre))
    assert refiner.model is SHARED
    variance_ground = refiner.noise[0] + refiner.noise[1] * GROUND_DN
    assert abs(variance_ground / (READ_DN**2 + 1 / 12 + GROUND_DN / ELECTRONS_PER_DN) - 1) < 0.08
    assert abs(refiner.noise[1] - 1 / ELECTRONS_PER_DN) < 0.025
    assert np.sqrt(((refined.fit.centre_px - centre) ** 2).mean()) < 0.025


def test_a_frame_that_is_partly_covered_looks_odd_and_lacks_light() -> None:
    picture, centre, _ = spots(64, 2.0, np.random.default_rng(8), size=31)
    refiner = Refiner(2.0, False, 255.0)
    refiner.refine(stack_of(picture, centre))
    picture[40, :, 16:] = GROUND_DN + 10  # a rail over the right half
    refined = refiner.refine(stack_of(picture, centre))
    assert refined.odd[40]
    assert not 0.8 < refined.flux[40] < 1.25
    assert np.delete(refined.odd, 40).mean() < 0.05


def test_a_candidate_has_the_centroid_and_axes_of_its_region() -> None:
    """skimage measures the same region: its weighted centroid, its ellipse's axes; the ground is zero, so nothing blurs in."""
    import cv2
    from skimage.measure import label, regionprops

    rng = np.random.default_rng(11)
    for _ in range(30):
        picture = np.zeros((120, 160))
        v, u = np.indices(picture.shape)
        (cu, cv), (long, short), turn = rng.uniform(50, 70, 2), rng.uniform(1.5, 3.0, 2), rng.uniform(0, np.pi)
        along, across = (
            (u - cu) * np.cos(turn) + (v - cv) * np.sin(turn),
            (v - cv) * np.cos(turn) - (u - cu) * np.sin(turn),
        )
        luma = (200 * np.exp(-0.5 * ((along / long) ** 2 + (across / short) ** 2))).astype(np.uint8)
        found = find_candidates(luma, expected_width_px=3.0)  # its window of 27 px holds more ground than spot
        blurred = cv2.GaussianBlur(luma.astype(np.float32), (0, 0), 1.5)
        region = regionprops(label(blurred > 0.5 * blurred.max()), intensity_image=blurred)[0]
        row, column = region.centroid_weighted
        assert len(found) == 1
        assert found.centre_px[0] == pytest.approx((column, row), abs=1e-3)  # float32 sums of 1e2 pixels
        assert found.stretch[0] == pytest.approx(region.axis_major_length / region.axis_minor_length, rel=1e-6)
