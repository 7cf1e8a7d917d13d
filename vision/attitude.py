"""What a model's roll and pitch do to the distance of two of its marks as they appear in the planes of their depths.

A mark that moves down appears elsewhere in the plane in which it is looked for, and one above another moves aside of it: a model
that rolls or pitches does not keep the distances that a level one keeps. Heave moves all marks alike and changes next to nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.mapping import Mapping
from ..record.schema import Marker

Array = NDArray[np.float64]

DEEPER_M = 0.01
"""The view is nearly straight within this depth."""


def view_slopes(mapping: Mapping, place_px: Array, depth_m: float) -> Array:
    """How a mark's apparent place in the plane of its depth changes as it moves down.

    Parameters
    ----------
    mapping : pixel -> tank
    place_px : (n, 2)
    depth_m : of the plane

    Returns
    -------
    (n, 2) m/m
    """
    high, low = (mapping.to_tank(place_px, depth_m + d).xy_m for d in (0.0, DEEPER_M))
    return (high - low) / DEEPER_M


def distance_slopes(one: Marker, two: Marker, gap_m: Array, by_down: tuple[Array, Array]) -> Array:
    """Change of a pair's apparent distance by roll (starboard down) and pitch (bow up) about the LCG.

    Parameters
    ----------
    one, two : on the model
    gap_m : (n, 2) apparent place of one from two
    by_down : ``view_slopes`` of both, (n, 2) or (1, 2)

    Returns
    -------
    (n, 2) m/rad, by roll and by pitch
    """
    ahead, side = np.subtract(one.body_m, two.body_m)
    down = one.depth_m - two.depth_m
    unit = gap_m / np.maximum(np.linalg.norm(gap_m, axis=1), 1e-12)[:, None]
    turned = np.arctan2(gap_m[:, 1], gap_m[:, 0]) - np.arctan2(side, ahead)
    forward = (unit * np.column_stack([np.cos(turned), np.sin(turned)])).sum(axis=1)
    aside = (unit * np.column_stack([-np.sin(turned), np.cos(turned)])).sum(axis=1)
    (first, second), (along, across) = by_down, zip(one.body_m, two.body_m, strict=True)
    by_roll = (unit * (across[0] * first - across[1] * second)).sum(axis=1)
    by_pitch = (unit * (along[0] * first - along[1] * second)).sum(axis=1)
    return np.column_stack([by_roll - down * aside, down * forward - by_pitch])


__all__ = ["distance_slopes", "view_slopes"]
