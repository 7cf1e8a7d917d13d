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
much: the brightest spot of a frame may be a lamp, or paint. Three marks or more have distances enough to be known by, and each
counts less: marks are alike, and what is brighter than one of them is brighter than all."""
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
SPOT_SD_PX = 0.5
"""How far a spot's centroid may lie from its mark beside what the distances may be off, standard deviation: a choice."""
MOST_PAIRS, PAIRS_AT_ONCE = 4000, 200
"""Pairs of spots that are tried as a pair of markers, the best first, until none can be better than what was found: for time."""
NEAR_PX = 4.0
"""Two spots so near to each other may be one; the same for a spot and where it was."""
SAME_PLACE_PX = 1.0
"""Spots of two searches no farther apart are one."""
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
    refused: Sequence[Sequence[Array | None]] = (),
    sure: Candidates | None = None,
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
    refused : sets of places (one a marker, or None) that were tried before and are not the marks
    sure : those of the spots that would be found anywhere; of the pair of markers farthest apart one is among them. None: all
    """
    body = np.array([m.body_m for m in markers])
    pairs = sorted(
        itertools.combinations(range(len(markers)), 2), key=lambda p: -float(np.hypot(*(body[p[0]] - body[p[1]])))
    )
    if len(candidates) < min(2, len(markers)):
        return Assignment((-1,) * len(markers), np.inf, False, False, None)
    tank = [mapping.to_tank(candidates.centre_px, m.depth_m) for m in markers]
    place, px_m = np.stack([t.xy_m for t in tank]), np.stack([_px_m(t.per_px) for t in tank])
    expected = near_px or [None] * len(markers)
    loose = near_sd_px or [SEEN_SD_PX] * len(markers)
    # one alone has no distances: its contrast is all that tells it
    most = CONTRAST_MOST if len(markers) > 1 else np.inf
    share = 1 / max(len(markers) - 1, 1)
    brightest = (candidates if sure is None else sure).brightest
    own = np.stack([
        _own_cost(candidates, m, near, sd, share, most, brightest(m.colour == "dark"))
        for m, near, sd in zip(markers, expected, loose, strict=True)
    ])  # fmt: skip
    own += PLATE_COST * holds_a_mark(candidates)
    for row, look in enumerate(looks or ()):
        if look is not None:
            contrast, width = (
                np.log(v / was) for v, was in zip((candidates.contrast_dn, candidates.width_px), look, strict=True)
            )
            own[row] += (contrast / SAME_CONTRAST) ** 2 + (width / SAME_WIDTH) ** 2
    if len(markers) == 1:
        return _alone(candidates, own[0])
    seen = _Seen(candidates, markers, body, place, px_m, own, _unlike(candidates))
    weak = np.zeros(len(candidates), dtype=bool)
    if sure is not None:
        apart = np.linalg.norm(candidates.centre_px[:, None] - sure.centre_px[None], axis=2)
        weak = (apart > SAME_PLACE_PX).all(axis=1)
    best = (np.inf, (-1,) * len(markers))
    second = (np.inf, (-1,) * len(markers))
    nearest: tuple[float, float] | None = None
    for first, other in pairs[:3]:
        cost, heading = _pair_costs(place, own, body, first, other, run)
        cost = np.where(weak[:, None] & weak[None], np.inf, cost)
        if markers[first].colour == markers[other].colour:
            cost = cost + seen.alike
        stated = float(np.hypot(*(body[first] - body[other])))
        if nearest is None:
            apart = np.linalg.norm(place[first][:, None] - place[other][None], axis=2)
            flat = int(np.nanargmin(np.abs(apart - stated))) if np.isfinite(apart).any() else 0
            nearest = (float(apart.flat[flat]), stated)
        order = np.argsort(cost, axis=None)[:MOST_PAIRS]
        for start in range(0, len(order), PAIRS_AT_ONCE):
            spots = np.column_stack(np.unravel_index(order[start : start + PAIRS_AT_ONCE], cost.shape))
            alone, turn = cost[tuple(spots.T)], heading[tuple(spots.T)]
            if not alone[0] < second[0]:
                break
            rest = seen.rest_costs(first, other, spots, turn)
            least = alone + np.minimum(rest.min(axis=2), MISSING_COST).sum(axis=1)
            for row in np.argsort(least):
                if not least[row] < second[0]:
                    break
                chosen, total = _complete(spots[row], first, other, float(alone[row]), rest[row])
                if any(_same_places(chosen, places, candidates) for places in refused):
                    continue
                if total < best[0]:
                    if _differs(chosen, best[1], candidates):
                        second = best
                    best = (total, chosen)
                elif total < second[0] and _differs(chosen, best[1], candidates):
                    second = (total, chosen)
    ambiguous = bool(second[0] - best[0] < CLEAR_COST)
    turned = ambiguous and _turned(best[1], second[1], candidates)
    return Assignment(best[1], best[0], ambiguous, turned, nearest, float(second[0] - best[0]))


def line_sd_m(length_m: float) -> float:
    """How far a taut line may be seen off its length, standard deviation."""
    return LINE_SD_M + LINE_SD_SHARE * length_m


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


def _own_cost(
    candidates: Candidates,
    marker: Marker,
    near_px: Array | None,
    near_sd_px: float,
    share: float,
    most: float,
    brightest: float,
) -> Array:
    """Cost of each spot by itself: dimmer than the ``brightest`` of its kind (at most ``most``, of which ``share`` counts),
    stretched, of another colour, far from where it is expected; infinite for a bright spot where a dark mark is meant.
    """
    kind = candidates.dark == (marker.colour == "dark")
    cost = STRETCH_WEIGHT * np.maximum(candidates.stretch - 1.3, 0.0) ** 2
    if marker.colour in TINTS:
        cost += _tint_cost(candidates.tint, np.array(TINTS[marker.colour], dtype=float))
    if near_px is not None:
        cost += ((candidates.centre_px - near_px) ** 2).sum(axis=1) / near_sd_px**2
    else:
        dimmer = np.maximum(np.log(brightest / candidates.contrast_dn), 0.0)
        cost += share * np.minimum(CONTRAST_WEIGHT * dimmer**2, most)
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
        cost = cost + np.where(x < 0, ((np.hypot(x, y) - length) / line_sd_m(length)) ** 2, np.inf)
    np.fill_diagonal(cost, np.inf)
    return np.where(np.isfinite(cost), cost, np.inf), heading


@dataclass(frozen=True)
class _Seen:
    """The spots of a frame and what each would cost as each of m markers.

    Attributes
    ----------
    candidates, markers : c and m of them
    body : (m, 2) m, on deck
    place : (m, c, 2) m, in the tank, each in its marker's plane
    px_m : (m, c), metres of a pixel there
    own : (m, c), cost of a spot by itself
    alike : (c, c), cost of two spots as marks of one kind
    """

    candidates: Candidates
    markers: tuple[Marker, ...]
    body: Array
    place: Array
    px_m: Array
    own: Array
    alike: Array

    def rest_costs(self, first: int, other: int, spots: Array, heading: Array) -> Array:
        """(p, m - 2, c) cost of each spot as each other marker of the bodies that pairs of spots fix.

        Parameters
        ----------
        first, other : markers of the pair
        spots : (p, 2) of each pair
        heading : (p,), rad, of the body that it fixes
        """
        cosine, sine = np.cos(heading), np.sin(heading)
        rotation = np.stack([np.stack([cosine, -sine], axis=1), np.stack([sine, cosine], axis=1)], axis=1)
        pair = float(np.hypot(*(self.body[first] - self.body[other])))
        costs = [np.zeros((len(spots), 0, len(self.candidates)))]
        for index in self.rest(first, other):
            arm = self.body[index] - self.body[first]
            expected = self.place[first, spots[:, 0]] + rotation @ arm
            reach = min(float(np.hypot(*arm)), float(np.hypot(*(self.body[index] - self.body[other]))))
            sd = max(1.0, reach / pair) * (DISTANCE_SD_M + DISTANCE_SD_SHARE * reach)
            variance = sd**2 + (SPOT_SD_PX * self.px_m[index]) ** 2
            cost = ((self.place[index] - expected[:, None]) ** 2).sum(axis=2) / variance + self.own[index]
            if self.markers[index].colour == self.markers[first].colour:
                cost = cost + self.alike[spots[:, 0]]
            np.put_along_axis(cost, spots, np.inf, axis=1)
            costs.append(np.where(np.isfinite(cost), np.minimum(cost, 1e6), 1e6)[:, None])
        return np.concatenate(costs, axis=1)

    def rest(self, first: int, other: int) -> list[int]:
        """The markers that are none of a pair."""
        return [index for index in range(len(self.markers)) if index not in (first, other)]


def _px_m(per_px: Array) -> Array:
    """(c,) metres of a pixel, from (c, 2, 2)."""
    return np.sqrt(np.abs(per_px[:, 0, 0] * per_px[:, 1, 1] - per_px[:, 0, 1] * per_px[:, 1, 0]))


def _complete(spots: Array, first: int, other: int, cost: float, rest: Array) -> tuple[tuple[int, ...], float]:
    """Find the other markers' spots beside the pair's: the assignment that costs least in all.

    Parameters
    ----------
    spots : (2,), of markers ``first`` and ``other``, which cost ``cost``
    rest : (m - 2, c), what each spot costs as each other marker
    """
    from scipy.optimize import linear_sum_assignment

    chosen = [-1] * (len(rest) + 2)
    chosen[first], chosen[other] = int(spots[0]), int(spots[1])
    if not len(rest):
        return tuple(chosen), cost
    # a column per spot, and one per marker for having none
    table = np.column_stack([rest, np.full((len(rest), len(rest)), MISSING_COST)])
    others = [index for index in range(len(chosen)) if index not in (first, other)]
    rows, columns = linear_sum_assignment(table)
    for row, column in zip(rows, columns, strict=True):
        if column < rest.shape[1] and table[row, column] < MISSING_COST:
            chosen[others[row]] = int(column)
    return tuple(chosen), cost + float(np.minimum(table[rows, columns], MISSING_COST).sum())


def _turned(one: tuple[int, ...], two: tuple[int, ...], candidates: Candidates) -> bool:
    """The same spots, to a few pixels, for other markers."""
    places = [candidates.centre_px[[i for i in chosen if i >= 0]] for chosen in (one, two)]
    if len(places[0]) != len(places[1]):
        return False
    apart = np.linalg.norm(places[0][:, None] - places[1][None], axis=2)
    return bool((apart.min(axis=0) <= NEAR_PX).all() and (apart.min(axis=1) <= NEAR_PX).all())


def _same_places(chosen: tuple[int, ...], places: Sequence[Array | None], candidates: Candidates) -> bool:
    """No marker at a place more than a few pixels away."""
    for spot, place in zip(chosen, places, strict=True):
        if (spot < 0) != (place is None):
            return False
        if place is not None and np.hypot(*(candidates.centre_px[spot] - place)) > NEAR_PX:
            return False
    return True


def _differs(one: tuple[int, ...], two: tuple[int, ...], candidates: Candidates) -> bool:
    """Any marker at a place more than a few pixels away."""
    for i, j in zip(one, two, strict=True):
        if i != j and (i < 0 or j < 0 or np.hypot(*(candidates.centre_px[i] - candidates.centre_px[j])) > NEAR_PX):
            return True
    return False
