"""Where the other marks of a model on a taut line may lie, given one of them: a weak mark is looked for there more closely."""

from __future__ import annotations

import itertools

import numpy as np

from ...geometry.mapping import Mapping
from ...record.run import Run
from ...record.schema import Marker
from .candidates import Array, Candidates
from .identity import HEADING_LIMIT_RAD, line_sd_m

LEADING = 24
"""So many of the spots of highest contrast are taken for one of the marks: lamps, rims and datum points are brighter than some. A
choice, for time."""
LINE_SDS = 2.5
"""Standard deviations by which the line may be off its length."""
MOST_WEAK = 1000
"""Spots about those places: on uneven ground a mark is among the least significant. A choice, for time."""
REACH_PX = 6.0
"""About each place: three standard deviations of a marker distance, at a usual camera's two millimetres to the pixel or more.
Places are half as far from each other."""


def leading_of(candidates: Candidates) -> Candidates:
    """The spots of highest contrast.

    Parameters
    ----------
    candidates : spots of one frame
    """
    return candidates.rows(np.argsort(-candidates.contrast_dn)[:LEADING])


def taut_places(
    leading: Candidates, markers: tuple[Marker, ...], mapping: Mapping, run: Run, size_px: tuple[int, int]
) -> Array:
    """Pixels (k, 2) at which the other marks lie when one of the spots is one of them and the line is taut; none without a line.

    Parameters
    ----------
    leading : spots of one frame
    markers : two or more
    mapping : pixel -> tank
    run : kind, tow (line and tow point)
    size_px : (width, height) of the frame
    """
    tow = run.file.tow
    if run.file.kind != "tow" or tow is None or tow.tow_point_m is None or tow.line_length_m is None:
        return np.zeros((0, 2))
    tow_point, post = np.array([tow.tow_point_m, tow.tow_point_offset_m]), np.array(tow.post_m)
    places = [np.zeros((0, 2))]
    for one, other in itertools.permutations(markers, 2):
        kind = leading.centre_px[leading.dark == (one.colour == "dark")]
        tank = mapping.to_tank(kind, one.depth_m)
        arm = np.array(other.body_m) - np.array(one.body_m)
        metres = np.nanmin(np.linalg.norm(tank.per_px, axis=(1, 2)), initial=np.inf)
        step = REACH_PX / 2 * metres / np.hypot(*arm)
        heading = np.arange(-HEADING_LIMIT_RAD, HEADING_LIMIT_RAD, step)
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]).transpose(2, 0, 1)
        # (spots, headings, 2): from the post to the tow point
        line = tank.xy_m[:, None] + turn @ (tow_point - np.array(one.body_m)) - post
        off = np.abs(np.linalg.norm(line, axis=2) - tow.line_length_m)
        taut = (off < LINE_SDS * line_sd_m(tow.line_length_m)) & (line[..., 0] < 0)
        there = (tank.xy_m[:, None] + turn @ arm)[taut]
        if len(there):
            places.append(mapping.to_pixel(np.column_stack([there, np.full(len(there), other.depth_m)])))
    found = np.concatenate(places)
    inside = (found >= 0).all(axis=1) & (found < np.array(size_px)).all(axis=1)
    # many spots' places fall together
    _, first = np.unique(np.rint(found[inside] / (REACH_PX / 2)).astype(int), axis=0, return_index=True)
    return found[inside][first]
