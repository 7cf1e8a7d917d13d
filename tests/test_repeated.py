"""A codec that leaves a picture as it was: such places are told, and as unsure as the way since the last picture of its own."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from towline.vision.scatter import _moved_since, with_scatter
from towline.vision.spots.stretch import Stretch

HALF_PX = 12
SIGMA_PX = 0.02


def picture(u: float, v: float, noise: np.ndarray) -> np.ndarray:
    row, column = np.indices(noise.shape)
    return np.clip(40 + 150 * np.exp(-0.5 * ((column - u) ** 2 + (row - v) ** 2) / 2.0**2) + noise, 0, 255).astype(
        np.uint8
    )


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
        stretch.keep(0, luma, u, 50.0, HALF_PX, 0.0)
    assert stretch.repeats[0] == [False, False, True, True, False]
    stretch.clear()
    stretch.frames.append((5, 0.2, False))
    stretch.keep(0, own[2], 61.0, 50.0, HALF_PX, 0.0)
    assert stretch.repeats[0] == [True]  # over the end of a stretch
    stretch.frames.append((7, 0.28, False))
    stretch.keep(0, own[2], 61.0, 50.0, HALF_PX, 0.0)
    assert stretch.repeats[0] == [True, False]  # not the frame before


def tracks(speed_px: float, every: int, rng: np.random.Generator, frames: int = 600) -> tuple[pd.DataFrame, np.ndarray]:
    """A mark to and fro, ``speed_px`` a frame at the most; each ``every``-th picture left as it was. And the truth."""
    t_s = np.arange(frames) / 25
    repeated = np.arange(frames) % every == every - 1
    truth = np.column_stack([400 + speed_px * 25 / 0.5 * np.sin(0.5 * t_s), np.full(frames, 200.0)])
    place = truth + rng.normal(0, SIGMA_PX, truth.shape)
    place[repeated] = place[np.flatnonzero(repeated) - 1]
    columns = {"t_s": t_s, "marker": "bow", "u_px": place[:, 0], "v_px": place[:, 1], "repeated": repeated.astype(int)}
    return pd.DataFrame(columns | {"sigma_u_px": SIGMA_PX, "sigma_v_px": SIGMA_PX}), truth


class Bow:
    name, on, depth_m = "bow", "model", 0.0


class Flat:
    def to_tank(self, pixel, depth):
        class Places:
            xy_m, per_px = pixel, np.tile(np.eye(2), (len(pixel), 1, 1))

        return Places


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


def test_places_before_and_after_all_pictures_of_their_own() -> None:
    rows = pd.DataFrame({"t_s": np.arange(20) / 10, "u_px": np.arange(20.0), "v_px": 0.0})
    own = np.zeros(20, dtype=bool)
    own[5:8] = True
    moved = _moved_since(rows, own)
    assert np.isfinite(moved).all()
    assert (moved[own] == 0).all()
    assert (_moved_since(rows, own & (np.arange(20) == 5)) == 0).all()  # one picture tells no rate
