"""What a model's roll and pitch do to the distance of two of its marks as they appear in the planes of their depths.

A mark that moves down appears elsewhere in the plane in which it is looked for, and one above another moves aside of it: a model
that rolls or pitches does not keep the distances that a level one keeps. Heave moves all marks alike and changes next to nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..record.schema import Marker

Array = NDArray[np.float64]


def distance_slopes(one: Marker, two: Marker, gap_m: Array, aside: tuple[Array, Array]) -> Array:
    """Change of a pair's apparent distance by roll (starboard down) and pitch (bow up) about the LCG.

    Parameters
    ----------
    one, two : on the model
    gap_m : (n, 2) apparent place of one from two
    aside : ``ray_slopes`` of both, (n, 2) or (1, 2)

    Returns
    -------
    (n, 2) m/rad, by roll and by pitch
    """
    ahead, side = np.subtract(one.body_m, two.body_m)
    down = one.depth_m - two.depth_m
    unit = gap_m / np.maximum(np.linalg.norm(gap_m, axis=1), 1e-12)[:, None]
    turned = np.arctan2(gap_m[:, 1], gap_m[:, 0]) - np.arctan2(side, ahead)
    forward = (unit * np.column_stack([np.cos(turned), np.sin(turned)])).sum(axis=1)
    across = (unit * np.column_stack([-np.sin(turned), np.cos(turned)])).sum(axis=1)
    # a mark that moves down, to starboard of the axis by roll and astern of it by pitch, appears back along its ray
    by_pitch, by_roll = (
        (unit * (here * aside[0] - there * aside[1])).sum(axis=1)
        for here, there in zip(one.body_m, two.body_m, strict=True)
    )
    return np.column_stack([-by_roll - down * across, down * forward + by_pitch])


__all__ = ["distance_slopes"]
