"""What a window cannot show: the scatter of a path, and a codec that leaves a picture as it was."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from towline.vision import path_scatter
from towline.vision.scatter import with_scatter
from towline.vision.spots.stretch import Stretch

HALF_PX = 12
SIGMA_PX = 0.02


class Bow:
    name, on, depth_m = "bow", "model", 0.0


class Flat:
    def to_tank(self, pixel, depth):
        class Places:
            xy_m, per_px = pixel, np.tile(np.eye(2), (len(pixel), 1, 1))

        return Places


@pytest.mark.parametrize("regular", [True, False])
def test_the_scatter_of_a_path_is_its_noise_whatever_the_frame_times(regular: bool) -> None:
    """A swinging mark with 0.05 px of white noise at even and at uneven times; 600 frames know a standard deviation to 3 %."""
    rng = np.random.default_rng(41)
    t = np.arange(600) / 30
    if not regular:
        t = np.sort(rng.choice(np.arange(900), 600, replace=False)) / 30
    path = 400 + 30 * np.sin(0.35 * t)
    found = [path_scatter(t, path + rng.normal(0, 0.05, 600)) for _ in range(10)]
    assert abs(np.mean(found) / 0.05 - 1) < 0.05
    assert np.std(found) < 0.06 * 0.05
    assert path_scatter(t, path) < 0.002
    assert path_scatter(t[:10], path[:10]) == 0.0


def test_the_scatter_of_a_path_holds_an_error_with_a_memory() -> None:
    """A codec's error of 0.05 px that lasts 8 frames: at least 0.7 of its sd is seen beside a swing of 100 px
    (a spline with knots a second apart takes up what is slower than that)."""
    rng = np.random.default_rng(42)
    t = np.arange(1800) / 30
    path = 400 + 100 * np.sin(0.63 * t)
    found = []
    for _ in range(6):
        error = np.zeros(1800)
        for k in range(1, 1800):
            error[k] = np.exp(-1 / 8) * error[k - 1] + rng.normal(0, 0.05 * np.sqrt(1 - np.exp(-2 / 8)))
        found.append(path_scatter(t, path + error))
    assert 0.7 * 0.05 < np.mean(found) < 1.05 * 0.05


def test_a_join_of_two_recordings_is_no_scatter() -> None:
    """The path leaps by 60 px where the second recording begins: the scatter stays that of the noise, to its own 5 %."""
    rng = np.random.default_rng(43)
    t = np.arange(500) / 25
    path = 400 + 30 * np.sin(0.7 * (t % 10.0))
    path[250:] += 60.0
    found = [path_scatter(t, path + rng.normal(0, 0.05, 500)) for _ in range(10)]
    assert abs(np.mean(found) / 0.05 - 1) < 0.05
    pause = np.where(t < 10, t, t + 5)
    found = [path_scatter(pause, path + rng.normal(0, 0.05, 500)) for _ in range(10)]
    assert abs(np.mean(found) / 0.05 - 1) < 0.05


def test_an_error_smoother_than_a_random_walk_is_seen_and_a_fast_motion_is_none() -> None:
    """B frames smooth an error over a quarter of a second: seven tenths of it are seen. That the mark swings at 0.8 Hz by 20 px
    leaves the scatter what it is: a spline with knots half a period apart still follows it."""
    rng = np.random.default_rng(44)
    t = np.arange(750) / 25
    window = np.hanning(9) / np.sqrt((np.hanning(9) ** 2).sum())
    still, swinging = [], []
    for _ in range(8):
        error = np.convolve(rng.normal(0, 0.05, 750 + 8), window, mode="valid")
        still.append(path_scatter(t, 400 + error))
        swinging.append(path_scatter(t, 400 + 20 * np.sin(2 * np.pi * 0.8 * t) + error))
    assert 0.7 * 0.05 < np.mean(still) < 1.05 * 0.05
    assert np.mean(swinging) < 1.2 * np.mean(still)


def test_the_axis_that_shows_a_codecs_error_speaks_for_both() -> None:
    """Along v the mark hardly moves and its error is frozen; the sigma there follows u."""
    rng = np.random.default_rng(43)
    t = np.arange(600) / 30
    table = pd.DataFrame(
        {
            "frame": np.arange(600),
            "t_s": t,
            "marker": "bow",
            "u_px": 400 + 50 * np.sin(0.5 * t) + rng.normal(0, 0.06, 600),
            "v_px": 200 + 0.06 + 0.5 * np.sin(0.5 * t),
            "sigma_u_px": 0.02,
            "sigma_v_px": 0.02,
        }
    )

    wide = with_scatter(table, [Bow], Flat(), lossy=True)  # pyright: ignore[reportArgumentType]
    assert abs(wide["sigma_u_px"].median() / 0.06 - 1) < 0.1
    np.testing.assert_allclose(wide["sigma_v_px"], wide["sigma_u_px"])


def picture(u: float, v: float, noise: np.ndarray) -> np.ndarray:
    row, column = np.indices(noise.shape)
    return np.clip(40 + 150 * np.exp(-0.5 * ((column - u) ** 2 + (row - v) ** 2) / 2.0**2) + noise, 0, 255).astype(
        np.uint8
    )


def repeats(stretch: Stretch) -> list[bool]:
    kept = stretch.stack(0, (120, 100))
    assert kept is not None
    return kept[2].tolist()


def test_a_picture_left_as_it_was_is_known_wherever_its_window_is_cut() -> None:
    rng = np.random.default_rng(2)
    own = [picture(60 + 0.3 * k, 50.0, rng.normal(0, 2, (100, 120))) for k in range(3)]
    elsewhere = own[1].copy()
    elsewhere[:20] += 1  # the water moves on, the mark's part of the picture does not
    stretch = Stretch(1)
    for frame, (luma, u) in enumerate(
        [(own[0], 60.0), (own[1], 60.4), (own[1], 60.6), (elsewhere, 60.6), (own[2], 61.0)]
    ):
        stretch.frames.append((frame, frame / 25, False))
        stretch.keep(0, luma, u, 50.0, HALF_PX)
    assert repeats(stretch) == [False, False, True, True, False]
    stretch.clear()
    stretch.frames.append((5, 0.2, False))
    stretch.keep(0, own[2], 61.0, 50.0, HALF_PX)
    assert repeats(stretch) == [True]  # over the end of a stretch
    stretch.frames.append((7, 0.28, False))
    stretch.keep(0, own[2], 61.0, 50.0, HALF_PX)
    assert repeats(stretch) == [True, False]  # not the frame before


def tracks(speed_px: float, every: int, rng: np.random.Generator, frames: int = 600) -> tuple[pd.DataFrame, np.ndarray]:
    """A mark to and fro, ``speed_px`` a frame at the most; each ``every``-th picture left as it was. And the truth."""
    t_s = np.arange(frames) / 25
    repeated = np.arange(frames) % every == every - 1
    truth = np.column_stack([400 + speed_px * 25 / 0.5 * np.sin(0.5 * t_s), np.full(frames, 200.0)])
    place = truth + rng.normal(0, SIGMA_PX, truth.shape)
    place[repeated] = place[np.flatnonzero(repeated) - 1]
    columns = {
        "frame": np.arange(frames),
        "t_s": t_s,
        "marker": "bow",
        "u_px": place[:, 0],
        "v_px": place[:, 1],
        "repeated": repeated.astype(int),
    }
    return pd.DataFrame(columns | {"sigma_u_px": SIGMA_PX, "sigma_v_px": SIGMA_PX}), truth


@pytest.mark.parametrize("speed_px", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("every", [2, 3])
def test_a_repeated_place_is_off_by_the_way_since(speed_px: float, every: int) -> None:
    table, truth = tracks(speed_px, every, np.random.default_rng(4))
    wide = with_scatter(table, [Bow], Flat())  # pyright: ignore[reportArgumentType]
    again = table["repeated"].to_numpy() > 0
    error = table["u_px"].to_numpy() - truth[:, 0]
    sigma = wide["sigma_u_px"].to_numpy()
    # the pictures of their own are as sure as they are, whatever the others do: 10 % is three sd of a scatter from 300
    assert np.median(sigma[~again]) == pytest.approx(SIGMA_PX, rel=0.1)
    # the others' errors are the way of one frame, of the very size that is granted: never more than noise on top of it
    assert (np.abs(error[again]) < sigma[again] + 5 * SIGMA_PX).all()
    assert np.sqrt((error[again] ** 2).mean()) == pytest.approx(np.sqrt((sigma[again] ** 2).mean()), rel=0.1)


@pytest.mark.parametrize(("own", "wider"), [((5, 6, 7), True), ((5,), False)])
def test_places_before_and_after_all_pictures_of_their_own(own: tuple[int, ...], wider: bool) -> None:
    """A mark at 10 px/s: those of its own are as sure as stated, the others less sure; one picture tells no rate."""
    t_s = np.arange(20) / 10
    repeated = np.where(np.isin(np.arange(20), own), 0, 1)
    columns = {"frame": np.arange(20), "t_s": t_s, "marker": "bow", "u_px": 10 * t_s, "v_px": 0.0, "repeated": repeated}
    found = with_scatter(pd.DataFrame(columns | {"sigma_u_px": SIGMA_PX, "sigma_v_px": SIGMA_PX}), [Bow], Flat())  # pyright: ignore[reportArgumentType]
    sigma = found["sigma_u_px"].to_numpy()
    assert np.isfinite(sigma).all()
    assert sigma[repeated == 0] == pytest.approx(SIGMA_PX)
    # one frame of 0.1 s after the last picture of its own it may be a pixel off, two frames after two
    expected = np.hypot(SIGMA_PX, [1.0, 2.0]) if wider else SIGMA_PX
    assert sigma[[max(own) + 1, max(own) + 2]] == pytest.approx(expected)
