"""What ``towline lens`` says of views, board and coefficients; its map of cells and its windows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from towline.geometry.camera import Lens
from towline.geometry.lens import Board, BoardView, Calibration, calibrate, coverage
from towline.geometry.lens.advice import advice
from towline.geometry.lens.boards import nearest_corners_px
from towline.geometry.lens.coverage import Coverage, covered_cells, differ_px, uncovered
from towline.geometry.lens.fit import offset_weights
from towline.record import GeometryError

SIZE = (800, 400)
"""Eight cells of 100 px across, four down."""
TRUE = Lens(700.0, 700.0, 402.0, 199.0, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
SQUARE_M = 0.03


def views(lens: Lens, count: int, noise_px: float = 0.1) -> list[BoardView]:
    """Of a board of 6 x 5 squares, tilted by up to 35 degrees, all over the picture."""
    rng, board = np.random.default_rng(1), Board(6, 5, SQUARE_M)
    flat, made = board.corners_m - board.corners_m.mean(0), []
    while len(made) < count:
        turn = Rotation.from_euler("xyz", rng.uniform(-0.6, 0.6, 3)).as_matrix()
        aim, _ = lens.normalise(np.array([[rng.uniform(100, 700), rng.uniform(80, 320)]]))
        place = flat @ turn.T + rng.uniform(0.3, 0.5) * np.array([*aim[0], 1.0])
        pixel = lens.distort(place[:, :2] / place[:, 2:])
        if (pixel > 4).all() and (pixel < np.array(SIZE) - 4).all():
            pixel = pixel + rng.normal(scale=noise_px, size=pixel.shape)
            made.append(BoardView(f"view {len(made)}", np.arange(len(flat)), board.corners_m, pixel))
    return made


@pytest.fixture(scope="module")
def good() -> Calibration:
    """Twelve views of a flat board, taken as flat; all that is said of it is replaced in the cases."""
    made = calibrate(views(TRUE, 12), SIZE, coefficients=2, flat=True)
    return replace(
        made,
        scatter=1.0,
        scatter_sd=0.1,
        condition=1e4,
        covariance_corners=made.covariance,
        lens=replace(made.lens, fx_px=made.lens.fy_px + 50.0),
    )


def widened(calibration: Calibration, factors: dict[int, float]) -> dict[str, Any]:
    """Standard deviations times factors, by parameter."""
    factor = np.ones(9)
    for index, size in factors.items():
        factor[index] = size
    return {"covariance": calibration.covariance * np.outer(factor, factor)}


def few(calibration: Calibration, used: int) -> dict[str, Any]:
    return {"views": tuple(replace(view, used=k < used) for k, view in enumerate(calibration.views))}


def said(calibration: Calibration) -> list[str]:
    return advice(calibration, coverage(calibration))


TILT = "): add views with the board tilted by 30 to 45 degrees about both of its sides"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (lambda c: few(c, 9), "only 9 views are used; with 15 to 30 both the lens and its errors are known better"),
        (lambda c: few(c, 10), None),
        (lambda _: {"condition": 2e6}, f", condition 2.0e+06{TILT}"),
        (lambda _: {"condition": 9e5}, None),
        (
            lambda _: {"scatter": 1.21},
            "the views pull the lens 1.1 times as far as independent corners would; all standard deviations are wider by that",
        ),
        (lambda _: {"scatter": 1.19}, None),
        (
            lambda c: widened(c, {4: 1.002, 5: 1.5}),
            "of k1, k2 the jackknife over the views tells a larger deviation still; it is the one stated",
        ),
        # what scatter widens already is no larger deviation; a scatter below one narrows nothing
        (lambda c: {"scatter": 1.19, **widened(c, dict.fromkeys(range(9), 1.19**0.5))}, None),
        (lambda _: {"scatter": 0.5}, None),
    ],
)
def test_weak_views(good: Calibration, changes: Any, sentence: str | None) -> None:
    """Sentences that are not said of the good calibration; None: nothing is added to what is said of that."""
    added = [one for one in said(replace(good, **changes(good))) if one not in said(good)]
    assert len(added) == (sentence is not None)
    assert sentence is None or added[0].endswith(sentence)


def test_a_focal_length_known_badly_is_weak(good: Calibration) -> None:
    """To 1.2 %; the corners alone say the same."""
    factor = 0.012 * good.lens.fx_px / good.sd[0]
    wide = widened(good, {0: factor})["covariance"]
    found = said(replace(good, covariance=wide, covariance_corners=wide))
    assert f"the views fix the lens weakly (focal length to 1.2 %, condition 1.0e+04{TILT}" in found


SHAPE_M = np.array([[0.0, 0, 0], [3e-4, 0, -4e-4], [0, 1e-4, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("within_m", "across_m", "sentence"),
    [
        (1.4e-5, 1.4e-5, None),  # below 1/2000 of a square of 30 mm
        (
            1.2e-4, 2.3e-4,
            "the board is not flat and true: its corners lie off by 0.12 mm within it and 0.23 mm out of its plane (the largest by "
            "0.50 mm); this was fitted with the lens",
        ),
        (1.6e-5, 0.0, "the board is not flat and true: its corners lie off by 0.02 mm within it and 0.00 mm out of its plane"),
        (0.0, 1.6e-5, "the board is not flat and true: its corners lie off by 0.00 mm within it and 0.02 mm out of its plane"),
    ],
)  # fmt: skip
def test_a_board_that_is_not_flat(good: Calibration, within_m: float, across_m: float, sentence: str | None) -> None:
    shaped = replace(good.fit, shape_m=SHAPE_M, shape_sd_m=np.array([within_m, across_m]))
    found = [one for one in said(replace(good, fit=shaped)) if one.startswith("the board")]
    assert len(found) == (sentence is not None)
    assert sentence is None or found[0].startswith(sentence)


def test_three_views_cannot_tell_a_boards_shape() -> None:
    made = calibrate(views(TRUE, 3), SIZE, coefficients=1, leave_out=False)
    assert any(s.startswith("the board is taken as flat: 3 views cannot tell its shape (") for s in said(made))


@pytest.mark.parametrize(
    ("distortion", "coefficients", "sentence"),
    [
        # no tangential part: p1 and p2 are not told
        (
            (-0.2, 0.05, 0.0, 0.0, 0.0),
            4,
            "are not told by these views; without them (--coefficients 2) the lens differs by at most",
        ),
        ((-0.2, 0.05, 0.0, 0.0, 0.0), 2, None),
        (
            (-0.2, 0.05, 0.0, 0.0, 0.0),
            5,
            "is not told by these views; without it (--coefficients 4) the lens differs by at most",
        ),
        ((-0.2, 0.05, 4e-3, 0.0, 0.3), 5, None),
        ((-0.2, 0.05, 4e-3, 0.0, 0.0), 2, "but not fitted: --coefficients 5"),
    ],
)
def test_coefficients(distortion: tuple[float, ...], coefficients: int, sentence: str | None) -> None:
    """Of a lens whose coefficients are known: fitted although not there, left out although there, and as they should be."""
    made = calibrate(
        views(replace(TRUE, distortion=np.array(distortion)), 12), SIZE, coefficients=coefficients, flat=True
    )
    found = [one for one in said(made) if "told by these views" in one]
    assert len(found) == (sentence is not None)
    assert sentence is None or sentence in found[0]


@pytest.mark.parametrize(
    ("fy_px", "sentence"),
    [
        (
            1007.9,
            "fx - fy = -7.90 +- 4.00 px: the pixels may be square (--square-pixels knows the focal length better)",
        ),
        (1008.1, None),
        (991.9, None),
    ],
)
def test_square_pixels(good: Calibration, fy_px: float, sentence: str | None) -> None:
    """The difference's own deviation: 3^2 + 4^2 - 2 x 4.5 = 4^2."""
    covariance = good.covariance.copy()
    covariance[:2, :2] = [[9.0, 4.5], [4.5, 16.0]]
    found = said(replace(good, lens=replace(good.lens, fx_px=1000.0, fy_px=fy_px), covariance=covariance))
    assert [one for one in found if "pixels" in one] == ([] if sentence is None else [sentence])


def test_pixels_that_are_held_square_are_not_asked_about() -> None:
    made = calibrate(views(TRUE, 12), SIZE, coefficients=2, square_pixels=True, flat=True)
    assert not any("square" in one for one in said(made))


def test_cells_with_three_corners_or_inside_a_view_are_covered() -> None:
    """A view from (120, 50) to (380, 250), two corners of it in one more cell, three corners far off in the last cell."""
    corners = [[120.0, 50], [380, 50], [120, 250], [380, 250], [260, 40]]
    far = [[799.4, 399.4], [710.0, 310.0], [720.0, 305.0]]
    views = [
        BoardView("a", np.arange(5), np.zeros((5, 3)), np.array(corners)),
        BoardView("b", np.arange(3), np.zeros((3, 3)), np.array(far)),
    ]
    counts, covered = covered_cells(views, SIZE)
    assert counts.shape == covered.shape == (4, 8)
    wanted = np.zeros((4, 8), dtype=int)
    wanted[0, [1, 2, 3]] = wanted[2, [1, 3]] = 1
    wanted[3, 7] = 3
    np.testing.assert_array_equal(counts, wanted)
    inside = np.zeros((4, 8), dtype=bool)
    inside[:2, 1:4] = (
        True  # middles at 150, 250, 350 and at 50, 150; the third row's at 250 lies on the edge, above 249.5
    )
    inside[2, 1:4] = True
    inside[3, 7] = True
    np.testing.assert_array_equal(covered, inside)
    found = Coverage(SIZE, counts, covered, np.where(covered, 0.25, 120.0))
    assert found.share == pytest.approx(10 / 32)
    assert found.lines()[1:4] == [
        "|     1  1  1             |",
        "|     .  .  .             |",
        "|     1  .  1             |",
    ]
    assert found.lines()[0] == found.lines()[-1] == "+" + "-" * 25 + "+"
    assert found.sd_lines()[4] == "|" + "(>99)" * 7 + " 0.25 |"
    assert uncovered(found, (130.0, 20.0, 380.0, 280.0)) == []
    assert uncovered(found, (130.0, 20.0, 430.0, 280.0)) == ["top right corner", "right side", "bottom right corner"]
    assert uncovered(found, (230.0, 120.0, 240.0, 390.0)) == ["bottom side"]
    assert uncovered(found, (50.0, 120.0, 240.0, 180.0)) == ["left side"]
    assert uncovered(found, (620.0, 120.0, 640.0, 140.0)) == ["middle"]
    assert uncovered(found, (-50.0, -50.0, 99.0, 99.0)) == ["middle"]  # all of it in one cell
    folded = Coverage(SIZE, counts, covered, np.full((4, 8), np.nan))
    assert folded.sd_lines()[1].startswith("|(fold) fold  fold ")


def test_lenses_differ_by_what_no_turn_takes_up() -> None:
    """A shifted principal point is a turned camera, but for its edges; a larger focal length is no turn at all."""
    covered = np.zeros((4, 8), dtype=bool)
    covered[1:3, 3:5] = True
    lens = Lens(1000.0, 1000.0, 400.0, 200.0)
    shifted = Lens(1000.0, 1000.0, 403.0, 198.0)
    assert differ_px(lens, lens, SIZE, covered) == pytest.approx(0, abs=1e-12)
    assert differ_px(lens, shifted, SIZE, covered) < 0.02
    # middles at 50 px from the centre each way: 1 % of 70.7 px
    longer = Lens(1010.0, 1010.0, 400.0, 200.0)
    assert differ_px(lens, longer, SIZE, covered) == pytest.approx(0.01 * np.hypot(50, 50), rel=0.02)
    assert differ_px(longer, lens, SIZE, covered) == pytest.approx(0.01 * np.hypot(50, 50), rel=0.03)


def test_windows_of_corners_go_by_their_nearest_neighbours() -> None:
    board = Board(3, 3, 0.03)
    places = np.array([[0.0, 0], [10, 0], [25, 0], [0, 20], [10, 20], [25, 20], [0, 50], [10, 50], [25, 50]])
    np.testing.assert_allclose(nearest_corners_px(board, np.arange(9), places), [10, 10, 15, 10, 10, 15, 10, 10, 15])
    some = np.array([0, 2, 5, 8])  # a corner alone in its row and column takes the others' smallest
    near = nearest_corners_px(board, some, places[some])
    np.testing.assert_allclose(near, [20, 20, 20, 30])
    chess, charuco = Board(5, 4, 0.03), Board(5, 4, 0.03, "DICT_4X4_50", 0.024)
    assert (chess.grid, charuco.grid) == ((5, 4), (4, 3))
    assert chess.window_share == 0.25
    assert charuco.window_share == pytest.approx(0.08)
    assert Board(5, 4, 0.03, "DICT_4X4_50", 0.003).window_share == 0.25
    np.testing.assert_allclose(
        charuco.corners_m[[0, 1, 4, 11]], [[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0], [0.09, 0.06, 0]]
    )


def test_a_boards_shape_is_held_within_it_and_across_it_by_their_own_deviations() -> None:
    """Weights of two corners' offsets along both sides and out of the plane, in units of a pixel's variance."""
    found = offset_weights(np.array([1e-4, 5e-4]), 0.04, 2)
    np.testing.assert_allclose(found, [4e6, 4e6, 1.6e5] * 2)


def test_boards_too_small_to_tell_are_refused() -> None:
    """Three by two inner corners of a chessboard, three by three squares of a ChArUco board; sides in metres."""
    assert Board(3, 2, 0.03).grid == (3, 2)
    assert Board(2, 3, 0.03).grid == (2, 3)
    for wrong in ((2, 2), (3, 1)):
        with pytest.raises(GeometryError, match="at least 3x2 are needed"):
            Board(*wrong, 0.03)
    assert Board(3, 3, 0.03, "DICT_4X4_50", 0.02).grid == (2, 2)
    for wrong in ((3, 2), (2, 5)):
        with pytest.raises(GeometryError, match="at least 3x3 are needed"):
            Board(*wrong, 0.03, "DICT_4X4_50", 0.02)
    for side in (0.0, -0.03, 11.0):
        with pytest.raises(GeometryError, match="between 0 and 10 m"):
            Board(5, 4, side)
