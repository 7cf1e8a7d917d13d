"""Where to look in tracks: the losses one by one, and the worst frames as the sheet has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd


def losses(tracks: pd.DataFrame) -> list[tuple[int, str]]:
    """Every loss of a mark by its first frame, and what it is: "stern lost for 12 frames: covered"; by frames.

    Parameters
    ----------
    tracks : tracks table
    """
    found: list[tuple[int, str]] = []
    for name, rows in tracks.groupby("marker", sort=False):
        lost = (rows["status"] == "lost").to_numpy()
        frames = rows["frame"].to_numpy().astype(int)
        reasons = rows["reason"].to_numpy() if "reason" in rows else np.full(len(rows), "")
        begins = np.flatnonzero(lost & ~np.concatenate([[False], lost[:-1]]))
        for begin in begins:
            after = np.flatnonzero(~lost[begin:])
            count = int(after[0]) if len(after) else len(lost) - int(begin)
            why = reasons[begin] if isinstance(reasons[begin], str) and reasons[begin] else "no reason given"
            found.append((int(frames[begin]), f"{name} lost for {count} frame{'s' if count > 1 else ''}: {why}"))
    return sorted(found)


def next_of(found: list[tuple[int, str]], frame: int, way: int) -> tuple[int, str] | None:
    """The first that comes after (``way`` 1) or before (-1) a frame; None = there is none.

    Parameters
    ----------
    found : by frames
    frame : that is shown
    way : 1 or -1
    """
    if way > 0:
        return next((each for each in found if each[0] > frame), None)
    return next((each for each in reversed(found) if each[0] < frame), None)


def worst(tracks: pd.DataFrame) -> list[tuple[int, str]]:
    """The frames of out/worst.png in its order: losses by time, then the largest sigmas.

    Parameters
    ----------
    tracks : tracks table
    """
    from ..vision.sheet import worst_frames

    return [(pick.frame, f"{pick.marker}, {pick.verdict}") for pick in worst_frames(tracks)]


__all__ = ["losses", "next_of", "worst"]
