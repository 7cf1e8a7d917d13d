"""Which spot is which mark: decided by the known geometry (distances, taut line, heading), not by brightness or nearness."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.mapping import Mapping
from ...record.run import Run
from ...record.schema import Marker
from .candidates import Array, Candidates

DISTANCE_SD_M = 0.004
"""The part of it that does not grow with the distance; the next line's does."""
DISTANCE_SD_SHARE = 0.004
"""How far a seen marker distance may stand from the stated one: places on deck, heights and camera, standard deviation."""
LINE_SD_M = 0.02
"""The part of it that does not grow with the line's length; the next line's does."""
LINE_SD_SHARE = 0.02
"""The same for the taut line (the post's place comes in)."""
HEADING_LIMIT_RAD = np.radians(80.0)
"""A towed model never heads across the tank beyond this (the equations of motion end at 90 degrees)."""
SEEN_SD_PX = 6.0
"""How far the user's rough pick may lie from the mark, standard deviation: a choice."""
CONTRAST_WEIGHT = 4.0
"""Cost of a dimmer spot: by the square of the logarithm, as if contrasts scattered by a factor of e^(1/2), 1.65."""
STRETCH_WEIGHT = 0.5
"""Cost of a spot longer than 1.3 of its width, by the square of the excess: a choice."""
MISSING_COST = 30.0
"""A marker without a spot costs as much as one that stands 5.5 standard deviations off."""
ACCEPT_COST = 25.0
"""Largest cost per pair of markers of an assignment that is believed: 5 standard deviations."""
NEAR_PX = 4.0
"""Two spots so near to each other may be one; the same for a spot and where it was."""
TINTS = {"blue": (1, 0, 0), "green": (0, 1, 0), "red": (0, 0, 1), "yellow": (0, 1, 1), "white": (1, 1, 1)}
"""(blue, green, red) of the colours that run.toml names."""
TINT_SD_RAD = 0.25
"""Angle between a spot's colour and the mark's, in (blue, green, red), standard deviation: a choice."""
WASHED_OUT_COST = 4.0
"""A coloured light that looks white: two standard deviations. A small light's colour is lost in a full pixel, in chroma of half
the resolution, in a codec that has no bits for it; another colour is not."""
WASHED_STEPS = 9
"""Steps from the full colour to white that are compared: a choice."""


@dataclass(frozen=True)
class Assignment:
    """Spots assigned to markers.

    Attributes
    ----------
    chosen : per marker the candidate's index, or -1
    cost : of the whole assignment (squared standard deviations)
    ambiguous : another assignment with other spots costs nearly as much
    nearest_m : where nothing fits: the pair distance nearest to the stated one, and the stated one
    """

    chosen: tuple[int, ...]
    cost: float
    ambiguous: bool
    nearest_m: tuple[float, float] | None

    @property
    def accepted(self) -> bool:
        """At least two markers have a spot and they fit."""
        found = sum(c >= 0 for c in self.chosen)
        missing = len(self.chosen) - found
        return found >= 2 and self.cost - MISSING_COST * missing <= ACCEPT_COST * (found - 1)


def assign(
    candidates: Candidates,
    markers: tuple[Marker, ...],
    mapping: Mapping,
    run: Run,
    near_px: Sequence[Array | None] | None = None,
    near_sd_px: Sequence[float] | None = None,
) -> Assignment:
    """Try every pair of spots as every pair of markers; the rigid body they fix must explain all the others.

    Parameters
    ----------
    candidates : spots of one frame, of one look
    markers : m of them
    mapping : pixel -> tank
    run : kind, tow (for the taut line and the heading)
    near_px : per marker where it is expected (the user's seen_at_px, or where it was seen last), or None
    near_sd_px : how far from there it may be, standard deviation (default ``SEEN_SD_PX``)
    """
    body = np.array([m.body_m for m in markers])
    pairs = sorted(
        itertools.combinations(range(len(markers)), 2), key=lambda p: -float(np.hypot(*(body[p[0]] - body[p[1]])))
    )
    if len(candidates) < 2:
        return Assignment((-1,) * len(markers), np.inf, False, None)
    place = np.stack([mapping.to_tank(candidates.centre_px, m.depth_m).xy_m for m in markers])
    expected = near_px or [None] * len(markers)
    loose = near_sd_px or [SEEN_SD_PX] * len(markers)
    own = np.stack([_own_cost(candidates, m, near, sd) for m, near, sd in zip(markers, expected, loose, strict=True)])
    best = (np.inf, (-1,) * len(markers))
    second = np.inf
    nearest: tuple[float, float] | None = None
    for first, other in pairs[:3]:
        cost, heading = _pair_costs(place, own, body, first, other, run)
        stated = float(np.hypot(*(body[first] - body[other])))
        if nearest is None:
            apart = np.linalg.norm(place[first][:, None] - place[other][None], axis=2)
            flat = int(np.nanargmin(np.abs(apart - stated))) if np.isfinite(apart).any() else 0
            nearest = (float(apart.flat[flat]), stated)
        order = np.argsort(cost, axis=None)[:200]
        for flat in order:
            a, b = np.unravel_index(flat, cost.shape)
            if not np.isfinite(cost[a, b]):
                break
            chosen, total = _complete(
                int(a),
                int(b),
                first,
                other,
                float(cost[a, b]),
                float(heading[a, b]),
                place,
                own,
                body,
                candidates,
                mapping,
                markers,
            )
            if total < best[0]:
                if _differs(chosen, best[1], candidates):
                    second = best[0]
                best = (total, chosen)
            elif _differs(chosen, best[1], candidates):
                second = min(second, total)
    return Assignment(best[1], best[0], bool(second - best[0] < 6.0), nearest)


def _own_cost(candidates: Candidates, marker: Marker, near_px: Array | None, near_sd_px: float) -> Array:
    """Cost of each spot by itself: dimmer than the brightest of its kind, stretched, of another colour, far from where it is
    expected; infinite for a bright spot where a dark mark is meant.
    """
    kind = candidates.dark == (marker.colour == "dark")
    brightest = candidates.contrast_dn[kind].max() if kind.any() else 1.0
    cost = CONTRAST_WEIGHT * np.log(brightest / candidates.contrast_dn) ** 2
    cost += STRETCH_WEIGHT * np.maximum(candidates.stretch - 1.3, 0.0) ** 2
    if marker.colour in TINTS:
        cost += _tint_cost(candidates.tint, np.array(TINTS[marker.colour], dtype=float))
    if near_px is not None:
        cost += ((candidates.centre_px - near_px) ** 2).sum(axis=1) / near_sd_px**2
    return np.where(kind, cost, np.inf)


def _tint_cost(tint: Array, wanted: Array) -> Array:
    """(n,) cost of colours ``tint (n, 3)`` for a mark of colour ``wanted (3,)``, more or less washed out; 0 where unknown."""
    share = np.linspace(0.0, 1.0, WASHED_STEPS)[:, None]
    looks = (1 - share) * wanted + share * wanted.max()
    cosine = np.clip(tint @ (looks / np.linalg.norm(looks, axis=1, keepdims=True)).T, -1.0, 1.0)
    cost = (np.arccos(cosine) / TINT_SD_RAD) ** 2 + WASHED_OUT_COST * (share**2).T
    return np.nan_to_num(cost).min(axis=1)


def _pair_costs(place: Array, own: Array, body: Array, first: int, other: int, run: Run) -> tuple[Array, Array]:
    """Cost and heading of every spot pair as markers ``first`` and ``other``, (c, c) each."""
    arm = body[first] - body[other]
    stated = np.hypot(*arm)
    gap = place[first][:, None] - place[other][None]
    apart = np.linalg.norm(gap, axis=2)
    cost = ((apart - stated) / (DISTANCE_SD_M + DISTANCE_SD_SHARE * stated)) ** 2
    cost = cost + own[first][:, None] + own[other][None]
    heading = np.arctan2(gap[:, :, 1], gap[:, :, 0]) - np.arctan2(arm[1], arm[0])
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    tow = run.file.tow
    if run.file.kind != "free":
        cost = np.where(np.abs(heading) < HEADING_LIMIT_RAD, cost, np.inf)
    if run.file.kind == "tow" and tow is not None and tow.tow_point_m is not None and tow.line_length_m is not None:
        cosine, sine = np.cos(heading), np.sin(heading)
        dx, dy = tow.tow_point_m - body[first, 0], tow.tow_point_offset_m - body[first, 1]
        x = place[first][:, None, 0] + cosine * dx - sine * dy - tow.post_m[0]
        y = place[first][:, None, 1] + sine * dx + cosine * dy - tow.post_m[1]
        length = tow.line_length_m
        cost = cost + np.where(x < 0, ((np.hypot(x, y) - length) / (LINE_SD_M + LINE_SD_SHARE * length)) ** 2, np.inf)
    np.fill_diagonal(cost, np.inf)
    return np.where(np.isfinite(cost), cost, np.inf), heading


def _complete(
    a: int,
    b: int,
    first: int,
    other: int,
    cost: float,
    heading: float,
    place: Array,
    own: Array,
    body: Array,
    candidates: Candidates,
    mapping: Mapping,
    markers: tuple[Marker, ...],
) -> tuple[tuple[int, ...], float]:
    """Find the other markers' spots from the body that the pair fixes: the assignment that costs least in all."""
    from scipy.optimize import linear_sum_assignment

    chosen = [-1] * len(markers)
    chosen[first], chosen[other] = a, b
    rest = [index for index in range(len(markers)) if index not in (first, other)]
    if not rest:
        return tuple(chosen), cost
    rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    # a column per spot, and one per marker for having none
    table = np.full((len(rest), len(candidates) + len(rest)), MISSING_COST)
    for row, index in enumerate(rest):
        expected = place[first, a] + rotation @ (body[index] - body[first])
        pixel = mapping.to_pixel(np.array([[*expected, markers[index].depth_m]]))[0]
        away = ((candidates.centre_px - pixel) ** 2).sum(axis=1) / NEAR_PX**2 + own[index]
        away[[a, b]] = np.inf
        table[row, : len(candidates)] = np.where(np.isfinite(away), np.minimum(away, 1e6), 1e6)
    rows, columns = linear_sum_assignment(table)
    for row, column in zip(rows, columns, strict=True):
        if column < len(candidates) and table[row, column] < MISSING_COST:
            chosen[rest[row]] = int(column)
    return tuple(chosen), cost + float(np.minimum(table[rows, columns], MISSING_COST).sum())


def _differs(one: tuple[int, ...], two: tuple[int, ...], candidates: Candidates) -> bool:
    """Any marker at a place more than a few pixels away."""
    for i, j in zip(one, two, strict=True):
        if i != j and (i < 0 or j < 0 or np.hypot(*(candidates.centre_px[i] - candidates.centre_px[j])) > NEAR_PX):
            return True
    return False
