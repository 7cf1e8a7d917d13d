"""A mark is carried off by where it lies in its pixel: the modes in closed form, in a rendered disc, in the motion, in the fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from slow_modes import assert_told, chi_squares, exact_tow

from towline.geometry import run_datum
from towline.geometry.origins import origins_of
from towline.geometry.phase import PHASE_PX, phase_modes
from towline.identify import RunData
from towline.vision.spots.fit import fit_spots
from towline.vision.spots.model import ELLIPSE, start_of, windows


def test_each_mark_is_off_along_each_axis_by_the_sine_of_its_place() -> None:
    """A crawl over two pixels: nothing at middles and edges, the most a quarter beside them, opposite before and behind."""
    t_s = np.arange(501) / 25.0
    pixel = np.stack(
        [np.stack([100 + 0.1 * t_s, 50 - 0.1 * t_s], axis=1), np.stack([7 + 0 * t_s, 8.25 + 0 * t_s], axis=1)], axis=1
    )
    modes = phase_modes(t_s, pixel)
    assert modes.shape == (4, len(t_s), 2, 2)
    for k, mode in enumerate(modes):
        expected = np.zeros((len(t_s), 2, 2))
        expected[:, k // 2, k % 2] = PHASE_PX * np.sin(2 * np.pi * pixel[:, k // 2, k % 2])
        np.testing.assert_allclose(mode, expected, atol=1e-12)


def test_a_place_holds_no_noise_of_its_own_frame() -> None:
    """About a pixel's middle the sine is steep: with its own noise in it a mode would explain that noise."""
    rng, t_s = np.random.default_rng(3), np.arange(4000) / 25.0
    noise = rng.normal(size=(len(t_s), 1, 2)) * 0.04
    modes = phase_modes(t_s, 20.0 + noise)
    share = [np.corrcoef(modes[k, :, 0, k], noise[:, 0, k])[0, 1] for k in (0, 1)]
    # of 15 frames about each its own is one: a correlation of 1/sqrt(15), not of 1
    assert np.abs(share) == pytest.approx([15**-0.5] * 2, abs=4 / np.sqrt(len(t_s)))


def test_a_lost_mark_has_no_mode() -> None:
    t_s = np.arange(200) / 25.0
    pixel = np.full((200, 2, 2), 10.2)
    pixel[50:60, 0] = np.nan
    pixel[:, 1] = np.nan
    modes = phase_modes(t_s, pixel)
    assert np.isfinite(modes).all()
    assert not modes[:2, 50:60].any()
    assert not modes[2:].any()
    assert modes[0, 70, 0, 0] == pytest.approx(PHASE_PX * np.sin(2 * np.pi * 0.2))


@pytest.mark.parametrize(("across_px", "blur_px", "sign"), [(2.2, 0.4, 1.0), (3.0, 0.0, 1.0), (4.0, 0.0, -1.0)])
def test_a_small_disc_under_a_pixelled_sensor_is_off_by_such_a_sine(
    across_px: float, blur_px: float, sign: float
) -> None:
    """Drawn here, without the renderer: a disc, summed over pixels. The fitted place errs by a sine of its place, of a sign that
    goes with the disc's size, and by a fifth of that beside it (grey values are whole numbers).
    """
    fine, size = 40, 15
    at = (np.arange(size * fine) + 0.5) / fine - 0.5
    off, true = [], np.arange(0.0, 1.0, 0.05)
    for place in true:
        centre = np.array([[7.0 + place, 7.0]])
        disc = (np.hypot(at[:, None] - 7.0, at[None, :] - centre[0, 0]) < across_px / 2).astype(float)
        seen = gaussian_filter(disc, blur_px * fine) if blur_px else disc
        luma = np.round(20 + 180 * seen.reshape(size, fine, size, fine).mean(axis=(1, 3))).astype(np.uint8)
        values, corner = windows(luma, centre, 6)
        start = start_of(values, centre - corner, np.array([0.8]))
        found = fit_spots(values, corner, start, ELLIPSE, (1.0, 0.0), 255.0)
        off.append(float(found.centre_px[0, 0] - centre[0, 0]))
    sine = np.sin(2 * np.pi * true)
    size_px = float(np.dot(off, sine) / np.dot(sine, sine))
    assert 0.2 * PHASE_PX < sign * size_px < 2 * PHASE_PX
    assert np.std(off - size_px * sine) < 0.2 * np.std(off)


def test_the_motion_s_modes_are_what_such_a_shift_does_to_it(samples: Path) -> None:
    run, tracks, made = exact_tow(samples)
    names = [m.name for m in run.file.marker]
    share = np.diag(origins_of(run, run_datum(run, (960, 720)), len(made.common), len(made.lag)).lag["phase"])
    assert share.sum() == 2 * len(names)
    pixel = np.stack([tracks[tracks["marker"] == n][["u_px", "v_px"]].to_numpy() for n in names], axis=1)
    assert_told(run, tracks, made, phase_modes(made.motion["t_s"].to_numpy(), pixel), made.lag[share > 0])


@pytest.mark.slow
@pytest.mark.parametrize("carried", [True, False])
def test_the_fit_takes_it_out_and_says_how_well(campaigns: ModuleType, carried: bool) -> None:
    """Twenty campaigns of two tows, a mark each way off by what is drawn, or not at all: chi-square of six each, 120 +- 15.5."""
    scale_px_m = 15.0  # a picture so small that the marks crawl over a few pixels

    def modes_of(run: RunData) -> RunData:
        marks = [(run.y_m + x * run.beta_rad) * scale_px_m for x in (1.3, -1.1)]
        bow, stern = (
            phase_modes(run.t_s, np.stack([np.stack([m, 0 * m], axis=1) for m in marks], axis=1))[
                ::2, :, :, 0
            ].transpose(2, 0, 1)
            / scale_px_m
        )
        beta = (bow - stern) / 2.4
        return replace(run, lag=np.stack([bow - 1.3 * beta, beta], axis=2), lag_key="camera")

    with_modes, without, _ = chi_squares(campaigns, modes_of, 68, carried)
    # where nothing is off the modes' prior is wider than the truth, and the six are nearer than they say
    assert (120 - 4 * np.sqrt(240) if carried else 20) < with_modes < 120 + 4 * np.sqrt(240)
    assert not carried or without > 2 * with_modes
