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
SEEN_SD_PX = 4.0
"""How far the user's rough pick may lie from the mark, standard deviation: a choice."""
CONTRAST_WEIGHT, CONTRAST_MOST = 4.0, 6.0
"""Cost of a dimmer spot: by the square of the logarithm, as if contrasts scattered by a factor of e^(1/2), 1.65; and at most so
much: the brightest spot of a frame may be a lamp, or paint."""
ALIKE_CONTRAST, ALIKE_WIDTH = 0.5, 0.3
"""Logarithms by which the contrasts and the widths of two marks of one kind differ, standard deviations: choices."""
STRETCH_WEIGHT = 0.5
"""Cost of a spot longer than 1.3 of its width, by the square of the excess: a choice."""
MISSING_COST = 30.0
"""A marker without a spot costs as much as one that stands 5.5 standard deviations off."""
ACCEPT_COST = 25.0
"""Largest cost per pair of markers of an assignment that is believed: 5 standard deviations."""
SAME_CONTRAST, SAME_WIDTH = 0.5, 0.35
"""Logarithms by which the contrast and the width of one mark differ from frame to frame, standard deviations: choices."""
PLATE_WIDTHS, PLATE_CONTRAST, PLATE_COST = 1.6, 0.4, 5.0
"""A spot that holds another, this many times narrower and of at least this share of the contrast that it has without the other, is
the plate of a mark rather than a mark: what that costs."""
CLEAR_COST = 6.0
"""An assignment stands alone where every other costs so much more: odds of 20 to 1."""
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
    turned : and that is the same spots in another order
    nearest_m : where nothing fits: the pair distance nearest to the stated one, and the stated one
    margin : by how much the next best assignment costs more
    """

    chosen: tuple[int, ...]
    cost: float
    ambiguous: bool
    turned: bool
    nearest_m: tuple[float, float] | None
    margin: float = np.inf

    @property
    def accepted(self) -> bool:
        """At least two markers (the one, where there is one alone) have a spot and they fit."""
        found = sum(c >= 0 for c in self.chosen)
        missing = len(self.chosen) - found
        fits = self.cost - MISSING_COST * missing <= ACCEPT_COST * max(found - 1, 1)
        return found >= min(2, len(self.chosen)) and fits


def assign(
    candidates: Candidates,
    markers: tuple[Marker, ...],
    mapping: Mapping,
    run: Run,
    near_px: Sequence[Array | None] | None = None,
    near_sd_px: Sequence[float] | None = None,
    looks: Sequence[tuple[float, float] | None] | None = None,
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
    looks : per marker the contrast and the width of the spot that it was a frame before, or None
    """
    body = np.array([m.body_m for m in markers])
    pairs = sorted(
        itertools.combinations(range(len(markers)), 2), key=lambda p: -float(np.hypot(*(body[p[0]] - body[p[1]])))
    )
    if len(candidates) < min(2, len(markers)):
        return Assignment((-1,) * len(markers), np.inf, False, False, None)
    place = np.stack([mapping.to_tank(candidates.centre_px, m.depth_m).xy_m for m in markers])
    expected = near_px or [None] * len(markers)
    loose = near_sd_px or [SEEN_SD_PX] * len(markers)
    most = (
        CONTRAST_MOST if len(markers) > 1 else np.inf
    )  # one alone has no distances: its contrast is all that tells it
    own = np.stack(
        [_own_cost(candidates, m, near, sd, most) for m, near, sd in zip(markers, expected, loose, strict=True)]
    )
    own += PLATE_COST * holds_a_mark(candidates)
    for row, look in enumerate(looks or ()):
        if look is not None:
            contrast, width = (
                np.log(v / was) for v, was in zip((candidates.contrast_dn, candidates.width_px), look, strict=True)
            )
            own[row] += (contrast / SAME_CONTRAST) ** 2 + (width / SAME_WIDTH) ** 2
    if len(markers) == 1:
        return _alone(candidates, own[0])
    alike = _unlike(candidates)
    best = (np.inf, (-1,) * len(markers))
    second = (np.inf, (-1,) * len(markers))
    nearest: tuple[float, float] | None = None
    for first, other in pairs[:3]:
        cost, heading = _pair_costs(place, own, body, first, other, run)
        if markers[first].colour == markers[other].colour:
            cost = cost + alike
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
                alike,
                body,
                candidates,
                mapping,
                markers,
            )
            if total < best[0]:
                if _differs(chosen, best[1], candidates):
                    second = best
                best = (total, chosen)
            elif total < second[0] and _differs(chosen, best[1], candidates):
                second = (total, chosen)
    ambiguous = bool(second[0] - best[0] < CLEAR_COST)
    turned = ambiguous and _turned(best[1], second[1], candidates)
    return Assignment(best[1], best[0], ambiguous, turned, nearest, float(second[0] - best[0]))


def _alone(candidates: Candidates, own: Array) -> Assignment:
    """One mark alone: the spot that costs least by itself, ambiguous where another elsewhere costs nearly as much."""
    best = int(np.argmin(own))
    elsewhere = np.hypot(*(candidates.centre_px - candidates.centre_px[best]).T) > NEAR_PX
    second = float(own[elsewhere].min(initial=np.inf))
    cost = float(own[best])
    chosen = best if np.isfinite(cost) else -1
    return Assignment((chosen,), cost, bool(second - cost < CLEAR_COST), False, None)


def holds_a_mark(candidates: Candidates) -> Array:
    """(n,) bool: spots that hold another of their shade, much smaller and not much weaker: a plate with its mark."""
    away = np.linalg.norm(candidates.centre_px[:, None] - candidates.centre_px[None], axis=2)
    inside = away < candidates.width_px[:, None]
    smaller = candidates.width_px[None] * PLATE_WIDTHS < candidates.width_px[:, None]
    without = candidates.contrast_dn[:, None] - candidates.contrast_dn[None]  # the top of a plate is its mark's
    strong = candidates.contrast_dn[None] > PLATE_CONTRAST * without
    return (inside & smaller & strong & (candidates.dark[:, None] == candidates.dark[None])).any(axis=1)


def _own_cost(candidates: Candidates, marker: Marker, near_px: Array | None, near_sd_px: float, most: float) -> Array:
    """Cost of each spot by itself: dimmer than the brightest of its kind (at most ``most``), stretched, of another colour, far
    from where it is expected; infinite for a bright spot where a dark mark is meant.
    """
    kind = candidates.dark == (marker.colour == "dark")
    brightest = candidates.contrast_dn[kind].max() if kind.any() else 1.0
    cost = STRETCH_WEIGHT * np.maximum(candidates.stretch - 1.3, 0.0) ** 2
    if marker.colour in TINTS:
        cost += _tint_cost(candidates.tint, np.array(TINTS[marker.colour], dtype=float))
    if near_px is not None:
        cost += ((candidates.centre_px - near_px) ** 2).sum(axis=1) / near_sd_px**2
    else:
        cost += np.minimum(CONTRAST_WEIGHT * np.log(brightest / candidates.contrast_dn) ** 2, most)
    return np.where(kind, cost, np.inf)


def _unlike(candidates: Candidates) -> Array:
    """(n, n) cost of two spots as marks of one kind: by their contrasts and their widths."""
    contrast, width = np.log(candidates.contrast_dn), np.log(candidates.width_px)
    cost = ((contrast[:, None] - contrast[None]) / ALIKE_CONTRAST) ** 2 + (
        (width[:, None] - width[None]) / ALIKE_WIDTH
    ) ** 2
    return np.minimum(cost, 2 * CONTRAST_MOST)


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
    alike: Array,
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
        if markers[index].colour == markers[first].colour:
            away = away + alike[a]
        away[[a, b]] = np.inf
        table[row, : len(candidates)] = np.where(np.isfinite(away), np.minimum(away, 1e6), 1e6)
    rows, columns = linear_sum_assignment(table)
    for row, column in zip(rows, columns, strict=True):
        if column < len(candidates) and table[row, column] < MISSING_COST:
            chosen[rest[row]] = int(column)
    return tuple(chosen), cost + float(np.minimum(table[rows, columns], MISSING_COST).sum())


def _turned(one: tuple[int, ...], two: tuple[int, ...], candidates: Candidates) -> bool:
    """The same spots, to a few pixels, for other markers."""
    places = [candidates.centre_px[[i for i in chosen if i >= 0]] for chosen in (one, two)]
    if len(places[0]) != len(places[1]):
        return False
    apart = np.linalg.norm(places[0][:, None] - places[1][None], axis=2)
    return bool((apart.min(axis=0) <= NEAR_PX).all() and (apart.min(axis=1) <= NEAR_PX).all())


def _differs(one: tuple[int, ...], two: tuple[int, ...], candidates: Candidates) -> bool:
    """Any marker at a place more than a few pixels away."""
    for i, j in zip(one, two, strict=True):
        if i != j and (i < 0 or j < 0 or np.hypot(*(candidates.centre_px[i] - candidates.centre_px[j])) > NEAR_PX):
            return True
    return False
