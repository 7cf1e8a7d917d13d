"""What ``towline lens`` says of views, board and coefficients; its map of cells and its windows by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towline.geometry.camera import Lens
from towline.geometry.lens import advice as advices
from towline.geometry.lens.advice import _board, _coefficients, _missing, _pixels, _square_m, _weak
from towline.geometry.lens.boards import Board, BoardView, _nearest
from towline.geometry.lens.coverage import Coverage, covered_cells, differ_px, uncovered
from towline.geometry.lens.fit import _prior
from towline.record import GeometryError

SIZE = (800, 400)
"""Eight cells of 100 px across, four down."""


def calibration(**more: Any) -> Any:
    """A good one: 12 views, focal length to 0.2 %, all deviations those of the corners."""
    sd = np.array([2.0, 2.0, 1.0, 1.0, 0.01, 0.02, 1e-4, 1e-4, 0.05])
    given: dict[str, Any] = {
        "views": [SimpleNamespace(used=k < 12) for k in range(14)],
        "sd": sd,
        "lens": Lens(1000.0, 1000.0, 400.0, 200.0),
        "condition": 1e4,
        "scatter": 1.0,
        "scatter_sd": 0.1,
        "covariance_corners": np.diag(sd**2),
        "covariance": np.diag(sd**2),
        "fit": SimpleNamespace(theta=np.zeros(9), shape_m=np.zeros((4, 3)), shape_sd_m=np.zeros(2)),
        "seen": [BoardView("a", np.arange(3), np.array([[0.0, 0, 0], [0.03, 0, 0], [0.06, 0, 0]]), np.zeros((3, 2)))],
    }
    return SimpleNamespace(**{**given, **more})


def test_weak_views_in_words() -> None:
    assert _weak(calibration()) == []
    few = [SimpleNamespace(used=True)] * 9
    assert _weak(calibration(views=few)) == [
        "only 9 views are used; with 15 to 30 both the lens and its errors are known better"
    ]
    ten = calibration(views=[*few, few[0]])
    assert _weak(ten) == []
    weak = (
        "the views fix the lens weakly (focal length to {} %, condition {}): add views with the board tilted by 30 to 45 degrees "
        "about both of its sides"
    )
    assert _weak(calibration(condition=2e6)) == [weak.format("0.2", "2.0e+06")]
    blurred = calibration()
    blurred.sd = blurred.sd * [6, 1, 1, 1, 1, 1, 1, 1, 1]
    blurred.covariance_corners = np.diag(blurred.sd**2)
    assert _weak(blurred) == [weak.format("1.2", "1.0e+04")]
    pulled = calibration(scatter=1.21)
    pulled.sd = pulled.sd * 1.1
    assert _weak(pulled) == [
        "the views pull the lens 1.1 times as far as independent corners would; all standard deviations are wider by that"
    ]
    assert _weak(calibration(scatter=1.19)) == []
    wider = calibration()
    wider.sd = wider.sd * [1, 1, 1, 1, 1.002, 1, 1, 1.5, 1]
    assert _weak(wider) == [
        "of k1, p2 the jackknife over the views tells a larger deviation still; it is the one stated"
    ]
    # what scatter widens already is no larger deviation; a scatter below one narrows nothing
    assert _weak(calibration(scatter=0.5)) == []


def test_a_board_that_is_not_flat_in_words() -> None:
    few = calibration(views=[SimpleNamespace(used=True)] * 3)
    (said,) = _board(few)
    assert said.startswith("the board is taken as flat: 3 views cannot tell its shape (")
    assert _board(calibration(views=[SimpleNamespace(used=True)] * 30)) == []
    shape = np.array([[0.0, 0, 0], [3e-4, 0, -4e-4], [0, 1e-4, 0], [0, 0, 0]])

    def bent(within: float, across: float) -> list[str]:
        return _board(calibration(fit=SimpleNamespace(shape_m=shape, shape_sd_m=np.array([within, across]))))

    assert bent(1.4e-5, 1.4e-5) == []  # below 1/2000 of a square of 30 mm
    assert bent(1.2e-4, 2.3e-4) == [
        "the board is not flat and true: its corners lie off by 0.12 mm within it and 0.23 mm out of its plane (the largest by "
        "0.50 mm); this was fitted with the lens"
    ]
    assert len(bent(1.6e-5, 0.0)) == len(bent(0.0, 1.6e-5)) == 1
    assert _square_m(calibration().seen) == pytest.approx(0.03)


def test_coefficients_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advices, "_difference", lambda *_: 0.123)
    found: Any = None
    theta = np.array([1000, 1000, 400, 200, -0.2, 0.05, 1e-4, -1e-4, 0.06])
    one = calibration(fit=SimpleNamespace(theta=theta))
    assert _coefficients(one, found, 5, False) == [
        "k3 = 0.0600 +- 0.0500 is not told by these views; without it (--coefficients 4) the lens differs by at most 0.12 px "
        "where boards were, and is safer to use beyond"
    ]
    monkeypatch.setattr(advices, "_missing", lambda *_: "")
    assert _coefficients(one, found, 4, False) == [
        "p1 = 0.0001 +- 0.0001 and p2 = -0.0001 +- 0.0001 are not told by these views; without them (--coefficients 2) the lens "
        "differs by at most 0.12 px where boards were"
    ]
    assert _coefficients(one, found, 2, False) == []
    monkeypatch.setattr(advices, "_missing", lambda *_: "k3 is missing")
    assert _coefficients(one, found, 4, False) == _coefficients(one, found, 2, False) == ["k3 is missing"]
    assert "--coefficients 4" in _coefficients(one, found, 5, False)[0]  # with five nothing can be missing
    # beyond two standard deviations they are told; either of p1 and p2 is enough
    monkeypatch.setattr(advices, "_missing", lambda *_: "")
    for place, free in ((8, 5), (6, 4), (7, 4)):
        far = theta.copy()
        far[place] = -2.01 * one.sd[place]
        assert _coefficients(calibration(fit=SimpleNamespace(theta=far)), found, free, False) == []
        near = theta.copy()
        near[place] = -1.99 * one.sd[place]
        assert len(_coefficients(calibration(fit=SimpleNamespace(theta=near)), found, free, False)) == 1
    monkeypatch.setattr(advices, "_difference", lambda *_: None)
    assert _coefficients(one, found, 5, False) == _coefficients(one, found, 4, False) == []


def test_a_coefficient_left_out_although_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = np.array([1000, 1000, 400, 200, -0.2, 0.05, 3e-4, 0.0, 0.08])
    covariance = np.diag(np.array([2, 2, 1, 1, 0.01, 0.02, 1e-4, 1e-4, 0.02]) ** 2)
    monkeypatch.setattr(advices, "_refitted", lambda *_: SimpleNamespace(theta=theta, covariance=covariance))
    ratio = [1.0]
    monkeypatch.setattr(advices, "view_scatter", lambda _: SimpleNamespace(ratio=ratio[0]))
    assert _missing(calibration(), 4, False) == (
        "k3 = 0.0800 is told by these views (4.0 standard deviations) but not fitted: --coefficients 5"
    )
    ratio[0] = 0.25  # views that agree by chance prove nothing
    assert "(4.0 standard deviations)" in _missing(calibration(), 2, False)
    ratio[0] = 4.0
    assert _missing(calibration(), 4, False) == ""
    ratio[0] = 1.0
    theta[8], theta[6] = 0.03, 5e-4
    assert _missing(calibration(), 2, False).startswith("p1 = 0.0005 is told by these views (5.0 standard deviations)")
    assert _missing(calibration(), 4, False) == ""
    monkeypatch.setattr(advices, "_refitted", lambda *_: None)
    assert _missing(calibration(), 2, False) == ""


def test_square_pixels_in_words() -> None:
    """The difference's own deviation: 3^2 + 4^2 - 2 x 4.5 = 4^2."""
    covariance = np.diag([9.0, 16.0, *[1.0] * 7])
    covariance[0, 1] = covariance[1, 0] = 4.5

    def said(fy_px: float, square: bool = False) -> list[str]:
        return _pixels(calibration(lens=Lens(1000.0, fy_px, 400.0, 200.0), covariance=covariance), square)

    assert said(1007.9) == [
        "fx - fy = -7.90 +- 4.00 px: the pixels may be square (--square-pixels knows the focal length better)"
    ]
    assert said(1008.1) == said(991.9) == said(1000.0, True) == []


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
    np.testing.assert_allclose(_nearest(board, np.arange(9), places), [10, 10, 15, 10, 10, 15, 10, 10, 15])
    some = np.array([0, 2, 5, 8])  # a corner alone in its row and column takes the others' usual
    near = _nearest(board, some, places[some])
    np.testing.assert_allclose(near[1:], [20, 20, 30])
    assert np.isfinite(near[0])
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
    found = _prior(np.array([1e-4, 5e-4]), 0.04, 2)
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
