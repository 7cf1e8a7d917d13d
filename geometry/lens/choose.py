"""Which frames of a recording serve for a calibration: the board stands still, and not where it has been already."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ..camera import Array
from .boards import Board, BoardView, find_board

STILL_PX = 0.5
"""A board that moves by more than this from one frame to the next is blurred, or skewed by a rolling shutter."""
LOOKS = 200
"""So many frames of a recording are looked at."""
MOST_VIEWS = 40
"""Views that are kept at most: a choice, above the 15 to 30 that lens/advice.py asks for."""
APART_SHARE = 0.02
"""Two views whose corners lie nearer to each other than this share of the picture's width tell the same."""


def still_views(
    frames: Iterable[tuple[str, Array]], board: Board, every: int, window_px: int | None = None
) -> Iterator[BoardView]:
    """Views from every ``every``-th frame in which the board is found and stands still until the next one.

    Parameters
    ----------
    frames : name and luma (h, w) of each frame
    board : which pattern, how many corners, how large
    every : frames from one try to the next
    window_px : half-width of the refinement window; None: by each corner's nearest neighbour
    """
    before: BoardView | None = None
    for index, (name, luma) in enumerate(frames):
        if before is not None:
            after = find_board(luma, board, name, window_px)
            if after is not None and _moved_px(before, after) < STILL_PX:
                yield before
            before = None
        elif index % every == 0:
            before = find_board(luma, board, name, window_px)


def apart(views: Sequence[BoardView], width_px: int, most: int = MOST_VIEWS) -> list[BoardView]:
    """At most ``most`` views, each as far as can be from those before, and none too near; in the order given.

    Parameters
    ----------
    views : of the board
    width_px : of the picture
    most : views to choose at most
    """
    if not views:
        return []
    chosen = [0]
    far = np.array([_moved_px(views[0], view) for view in views])
    while len(chosen) < min(most, len(views)):
        best = int(far.argmax())
        if far[best] < APART_SHARE * width_px:
            break
        chosen.append(best)
        far = np.minimum(far, [_moved_px(views[best], view) for view in views])
    return [views[i] for i in sorted(chosen)]


def _moved_px(one: BoardView, other: BoardView) -> float:
    """Median distance of the corners that both views show; without such, of their middles."""
    _, first, second = np.intersect1d(one.ids, other.ids, return_indices=True)
    if not len(first):
        return float(np.linalg.norm(one.pixel_px.mean(0) - other.pixel_px.mean(0)))
    return float(np.median(np.linalg.norm(one.pixel_px[first] - other.pixel_px[second], axis=1)))
