"""Boards, and their corners in a picture: chessboards and ChArUco boards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import GeometryError
from ..camera import Array

WINDOW_SHARE = 0.25
"""Half-width of a corner's refinement window over the distance of its nearest neighbour. On real pictures the residuals fall
slowly up to 0.3; from 0.35 on (oblique boards) windows take in the neighbours' edges and corners go wrong by pixels."""
WINDOW_PX = (2, 11)
"""Its limits, px: smaller windows hold too few pixels, in larger ones the lens bends the edges."""
MARK_SHARE = 0.8
"""Of the way to the nearest edge of a ChArUco mark."""
DETECT_AT_PX = 1600
"""A chessboard is looked for in a copy of at most this length (the time grows with the area), then refined in full."""
LEAST_CORNERS = 8
"""Of a ChArUco board in one view; and they must not lie on one line."""
SHORTEST_SIDE_PX = 4.0
"""Corners nearer to each other than this cannot be refined."""


@dataclass(frozen=True)
class Board:
    """A flat board.

    Attributes
    ----------
    columns, rows : inner corners of a chessboard; squares of a ChArUco board (as their makers count)
    square_m : side of a square
    dictionary : "" for a chessboard; else OpenCV's name of the marks' dictionary ("DICT_6X6_250")
    marker_m : side of a mark (ChArUco)
    legacy : ChArUco with an even number of rows made by OpenCV before 4.6: a mark stands in the first corner
    """

    columns: int
    rows: int
    square_m: float
    dictionary: str = ""
    marker_m: float = 0.0
    legacy: bool = False

    def __post_init__(self) -> None:
        least = 3 if self.dictionary else 2
        if min(self.columns, self.rows) < least or max(self.columns, self.rows) < 3:
            raise GeometryError(f"board {self.columns}x{self.rows}: at least 3x{least} are needed")
        if not 0 < self.square_m < 10:
            raise GeometryError(f"square {self.square_m:g} m: a length between 0 and 10 m is expected")
        if self.dictionary and not 0 < self.marker_m < self.square_m:
            raise GeometryError(
                f"mark {self.marker_m:g} m: a mark of a ChArUco board is smaller than its square ({self.square_m:g} m)"
            )

    @property
    def grid(self) -> tuple[int, int]:
        """Inner corners, (columns, rows)."""
        less = 1 if self.dictionary else 0
        return self.columns - less, self.rows - less

    @property
    def window_share(self) -> float:
        """Half-width of the refinement window over the corners' distance; the marks of a ChArUco board stand nearer."""
        if not self.dictionary:
            return WINDOW_SHARE
        return min(WINDOW_SHARE, MARK_SHARE * (1 - self.marker_m / self.square_m) / 2)

    @property
    def corners_m(self) -> Array:
        """All inner corners in board axes, (n, 3) m, row by row."""
        columns, rows = self.grid
        across, down = np.meshgrid(np.arange(columns), np.arange(rows))
        return self.square_m * np.column_stack([across.ravel(), down.ravel(), np.zeros(columns * rows)])


@dataclass(frozen=True)
class BoardView:
    """A board seen in one picture.

    Attributes
    ----------
    name : of the picture
    ids : (n,), which corners of the board
    board_m : (n, 3), where they are on the board
    pixel_px : (n, 2), where they were found
    """

    name: str
    ids: Array
    board_m: Array
    pixel_px: Array

    def only(self, kept: Array) -> BoardView:
        """With the corners of a mask or index."""
        return BoardView(self.name, self.ids[kept], self.board_m[kept], self.pixel_px[kept])


def find_board(luma: Array, board: Board, name: str = "", window_px: int | None = None) -> BoardView | None:
    """Find a board's corners with sub-pixel places, or None where it is not seen (a chessboard: not seen whole).

    Parameters
    ----------
    luma : (h, w) uint8
    board : which pattern, how many corners, how large
    name : of the picture, for reports
    window_px : half-width of the refinement window for all corners; None = by each corner's nearest neighbour

    Raises
    ------
    GeometryError : the dictionary is unknown.
    """
    found = _charuco(luma, board) if board.dictionary else _chessboard(luma, board)
    if found is None:
        return None
    ids, rough = found
    near = nearest_corners_px(board, ids, rough)
    if (near < SHORTEST_SIDE_PX).any():
        return None
    pixel = _refined(luma, rough, board.window_share * near, window_px)
    return BoardView(name, ids, board.corners_m[ids], pixel)


def other_size(luma: Array, board: Board) -> tuple[int, int] | None:
    """The chessboard's inner corners if it is a row or column larger or smaller than stated, else None.

    Parameters
    ----------
    luma : (h, w) uint8
    board : as stated
    """
    if board.dictionary:
        return None
    columns, rows = board.columns, board.rows
    near = [(columns - 1, rows - 1), (columns - 1, rows), (columns, rows - 1)]
    near += [(columns + 1, rows + 1), (columns + 1, rows), (columns, rows + 1)]
    for size in near:
        if min(size) > 2 and _chessboard(luma, Board(*size, board.square_m)) is not None:
            return size
    return None


def _chessboard(luma: Array, board: Board) -> tuple[Array, Array] | None:
    """Rough corners: the classic search (it finds what the sector search misses, not the other way round), then the other."""
    import cv2

    shrink = min(1.0, DETECT_AT_PX / max(luma.shape))
    small = luma
    if shrink < 1:
        small = cv2.resize(luma, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    good, places = cv2.findChessboardCorners(small, board.grid, flags=flags | cv2.CALIB_CB_FAST_CHECK)
    if not good:
        good, places = cv2.findChessboardCornersSB(small, board.grid, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not good:
        return None
    # a pixel of the copy covers several: its centre is the middle of theirs
    scale = np.array([luma.shape[1] / small.shape[1], luma.shape[0] / small.shape[0]])
    rough = (places.reshape(-1, 2).astype(float) + 0.5) * scale - 0.5
    return np.arange(len(rough)), rough


def _charuco(luma: Array, board: Board) -> tuple[Array, Array] | None:
    import cv2

    detector = cv2.aruco.CharucoDetector(_opencv_board(board))
    places, ids, _, _ = detector.detectBoard(luma)
    if ids is None or len(ids) < LEAST_CORNERS:
        return None
    ids = np.asarray(ids).ravel().astype(int)
    spread = np.linalg.svd(board.corners_m[ids, :2] - board.corners_m[ids, :2].mean(0), compute_uv=False)
    if spread[1] < 0.5 * board.square_m:
        return None
    return ids, np.asarray(places, dtype=float).reshape(-1, 2)


def _opencv_board(board: Board):
    import cv2

    number = getattr(cv2.aruco, board.dictionary, None) if board.dictionary.startswith("DICT_") else None
    if not isinstance(number, int):
        known = ", ".join(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))
        raise GeometryError(f"no dictionary {board.dictionary!r}; known: {known}")
    marks = cv2.aruco.getPredefinedDictionary(number)
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, marks)
    made.setLegacyPattern(board.legacy)
    return made


def nearest_corners_px(board: Board, ids: Array, places: Array) -> Array:
    """Measure how near each corner's nearest neighbour along rows and columns is in the picture.

    Parameters
    ----------
    board : which pattern
    ids : (n,) which of its corners
    places : (n, 2) px

    Returns
    -------
    distance : (n,) px; a corner that stands alone in its row and column gets the smallest of the others
    """
    columns, rows = board.grid
    grid = np.full((rows * columns, 2), np.nan)
    grid[ids] = places
    grid = grid.reshape(rows, columns, 2)
    near = np.full((rows, columns), np.inf)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        step = np.where(np.isnan(step), np.inf, step)
        head, tail = [slice(None)] * 2, [slice(None)] * 2
        head[axis], tail[axis] = slice(1, None), slice(None, -1)
        near[tuple(head)] = np.minimum(near[tuple(head)], step)
        near[tuple(tail)] = np.minimum(near[tuple(tail)], step)
    near = near.ravel()[ids]
    alone = np.isinf(near)
    if alone.any():
        near[alone] = near[~alone].min() if (~alone).any() else 2 * SHORTEST_SIDE_PX
    return near


def _refined(luma: Array, rough: Array, half_px: Array, window_px: int | None) -> Array:
    import cv2

    window = np.clip(np.floor(half_px), *WINDOW_PX).astype(int)
    if window_px is not None:
        window = np.full(len(rough), window_px)
    ending = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    places = np.array(rough, dtype=np.float32)
    for half in np.unique(window):
        same = window == half
        start = np.ascontiguousarray(places[same].reshape(-1, 1, 2))
        places[same] = cv2.cornerSubPix(luma, start, (int(half), int(half)), (-1, -1), ending).reshape(-1, 2)
    return places.astype(float)
