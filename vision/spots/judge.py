"""Whether a fit is the mark: by its brightness, width, light, sigma, its place against the prediction, and the rigid body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...geometry.mapping import Mapping, ray_slopes
from ...record.schema import Marker
from ..attitude import distance_slopes
from .candidates import Array
from .identity import DISTANCE_SD_M, DISTANCE_SD_SHARE
from .live import COAST_FRAMES
from .refine import SHAPE_LIMIT
from .stretch import Found, Mark

JUMP_PX = 3.0
"""Largest surprise of a spot's place beyond four standard deviations of the prediction."""
JUMP_SD = 4.0
"""Those standard deviations: 1 in 3000 by chance in two directions."""
BRIGHTNESS_RANGE = (0.4, 2.5)
"""Of a spot over its mark's usual brightness; outside it is covered, or something else. Choices."""
COMMON_SPREAD, SAME_SPREAD = 1.5, 1.12
"""Marks whose brightness changes by factors this close to each other saw a change of exposure ..."""
MOST_EXPOSURE, FOUND_EXPOSURE = 8.0, 4.0
"""... if it is no larger than this factor, three stops, or of marks that are found anew two: beyond, all of them are something
else. Choices."""
WIDTH_RANGE = (0.55, 1.8)
"""Of a spot's width over its mark's usual width: the same."""
COVERED_RANGE = (0.8, 1.25)
"""Motion blur spreads a mark's light and leaves its sum; a spot that looks odd and lacks light is partly covered."""
LOOK_SD = 3.0
"""A spot's width and height are known, as shares, to about what its place is known to in widths: so many of those standard
deviations widen their ranges."""
MOST_UNSURE = 0.5
"""... but by no more than this logarithm: a spot of which nothing is known is not the mark. A choice."""
FLUX_SD = 6.0
"""Three standard deviations of a spot's light, which is known to twice what its place is known to in widths."""
LARGEST_SIGMA_PX = 0.5
"""A place known less well than this is none: a choice."""
LARGEST_SIGMA_WIDTHS = 0.15
"""... or than this share of a wide mark's width, a twentieth of its diameter: the same."""
DISTANCE_MEMORY = 0.3
"""Share of a new stretch in what is known of the distance of two marks: a choice."""
DISTANCE_GATE = 6.0
"""A distance off by more than this many standard deviations, beside identity's tolerance, is not the body's."""
TURNED_RAD = np.radians([3.0, 0.5])
"""A model may roll and pitch by so much: more than one on a line does in calm water. Choices."""


def judge(marks: Sequence[Mark | None], found: Found, width: Array, excess: Array, flux: Array) -> Array:
    """Why a fit is not the mark; the reason stays empty where it is.

    ``width``, ``excess`` (residual variance) and ``flux`` (of odd frames; 1 elsewhere) are over the usual ones.

    Parameters
    ----------
    marks : what is known of each mark; None: not yet seen
    found : places and sigmas of the stretch
    width : (markers, frames), over the usual
    excess : (markers, frames), residual variance over the usual
    flux : (markers, frames), light of odd frames over the usual; 1 elsewhere

    Returns
    -------
    surprise : (markers, frames) px between each place and its prediction; NaN where there is none
    """
    reason, brightness = found.reason, found.brightness
    ratio = np.full(brightness.shape, np.nan)
    for index, mark in enumerate(marks):
        if mark is not None:
            sign = -1.0 if mark.live.dark else 1.0
            with np.errstate(invalid="ignore", divide="ignore"):
                ratio[index] = np.log(np.maximum(sign * brightness[index] / _reference(mark, brightness[index]), 1e-9))
    usual = np.array([np.nan if m is None else m.refiner.width_px for m in marks])
    # a frame that is less sure of its mark than the mark's others shows it half hidden: that excuses nothing
    share = np.fmin(np.nan_to_num(found.sigma.max(axis=2)), _usual_sigma(marks, found)[:, None]) / usual[:, None]
    unsure = np.minimum(LOOK_SD * share, MOST_UNSURE)
    low, high = np.log(BRIGHTNESS_RANGE)
    fine = ratio - _common(ratio, COMMON_SPREAD)[None, :]
    with np.errstate(invalid="ignore", divide="ignore"):
        _put(reason, "brightness", ~((fine > low - unsure) & (fine < high + unsure)))
        wide = np.log(width)
        same = (wide > np.log(WIDTH_RANGE[0]) - unsure) & (wide < np.log(WIDTH_RANGE[1]) + unsure)
        _put(reason, "shape", ~same | (excess > SHAPE_LIMIT))
        common = np.where(flux == 1.0, 0.0, _common(ratio, SAME_SPREAD)[None, :])
        unsure = FLUX_SD * share
        light = np.log(np.maximum(flux, 1e-9))
        # what all marks share is the exposure's where it took of their light, and the focus's where it only spread it
        light = np.where(np.abs(light - common) < np.abs(light), light - common, light)
        _put(
            reason, "covered", (light < np.log(COVERED_RANGE[0]) - unsure) | (light > np.log(COVERED_RANGE[1]) + unsure)
        )
        _put(reason, "too faint", found.sigma.max(axis=2) > LARGEST_SIGMA_PX)
    surprise = np.full(brightness.shape, np.nan)
    for index, mark in enumerate(marks):
        if mark is not None:
            _replay(index, mark, found, surprise)
    return surprise


def _reference(mark: Mark, brightness: Array) -> float:
    """The brightness to compare with: the running one, or that of the very first stretch."""
    if mark.refiner.stretches > 1:
        return mark.brightness_dn
    middle = np.nanmedian(np.abs(brightness)) if np.isfinite(brightness).any() else np.nan
    return float(middle) if np.isfinite(middle) else mark.brightness_dn


def as_bright(marks: Sequence[Mark | None], amplitude_dn: Array) -> NDArray[np.bool_]:
    """Which spots that are found anew may be their marks by their brightness, but for a change of exposure that marks share.

    Parameters
    ----------
    marks : as they were known; None: not yet seen, and as bright as it is
    amplitude_dn : (markers,), the spots' heights, negative where they are darker than their ground; NaN: none

    Returns
    -------
    (markers,)
    """
    signed = np.array([1.0 if m is None else m.height_dn for m in marks])
    unknown = np.array([m is None for m in marks])
    with np.errstate(invalid="ignore"):
        ratio = np.log(np.maximum(np.where(unknown, np.nan, amplitude_dn / signed), 1e-9))
        fine = ratio - _common(ratio[:, None], COMMON_SPREAD, FOUND_EXPOSURE)
        low, high = np.log(BRIGHTNESS_RANGE)
        return unknown | ((fine > low) & (fine < high))


def _usual_sigma(marks: Sequence[Mark | None], found: Found) -> Array:
    """What each mark's place is usually known to, px: by what has been seen of it before, or in this stretch."""
    return np.array([
        np.nan if m is None else m.sigma_px if np.isfinite(m.sigma_px) else seen_sigma_px(found, i)
        for i, m in enumerate(marks)
    ])  # fmt: skip


def largest_sigma_px(mark: Mark | None) -> float:
    """What a mark's place must be known to, px.

    Parameters
    ----------
    mark : while it is followed
    """
    return max(LARGEST_SIGMA_PX, LARGEST_SIGMA_WIDTHS * (0.0 if mark is None else mark.refiner.width_px))


def seen_sigma_px(found: Found, index: int) -> float:
    """Median over a stretch of what a mark's place is known to, px; NaN where it is never seen.

    Parameters
    ----------
    found : places and sigmas of the stretch
    index : the mark's
    """
    sigma = found.sigma[index].max(axis=1)[found.reason[index] == ""]
    return float(np.median(sigma)) if len(sigma) else float("nan")


def _replay(index: int, mark: Mark, found: Found, surprise: Array) -> None:
    """Run the filter over the fitted places; what it cannot follow has jumped."""
    state, lost = mark.replay, mark.lost
    places, reasons = found.place[index], found.reason[index]
    for row, (_, t_s, _) in enumerate(found.frames):
        if reasons[row]:
            lost += 1
            continue
        u, v, spread = state.predict(t_s) if t_s > state.t_s else (state.u, state.v, state.spread)
        gap = float(np.hypot(places[row, 0] - u, places[row, 1] - v))
        surprise[index, row] = gap
        if gap > JUMP_PX + JUMP_SD * np.sqrt(spread) and lost <= COAST_FRAMES:
            reasons[row] = "jumped"
            lost += 1
            continue
        if lost > COAST_FRAMES:
            state.stop()
        if t_s > state.t_s:
            state.update(float(places[row, 0]), float(places[row, 1]), t_s)
        lost = 0
    mark.lost = lost


def _common(ratio: Array, most: float, exposure: float = MOST_EXPOSURE) -> Array:
    """Per frame the logarithmic change of brightness that all marks share to a factor ``most``; 0 where they do not, or where it is
    larger than ``exposure``.
    """
    seen = np.isfinite(ratio)
    count = seen.sum(axis=0)
    filled = np.where(seen, ratio, 0.0)
    mean = filled.sum(axis=0) / np.maximum(count, 1)
    spread = np.where(seen, np.abs(ratio - mean), 0.0).max(axis=0)
    return np.where((count > 1) & (2 * spread < np.log(most)) & (np.abs(mean) < np.log(exposure)), mean, 0.0)


def _put(reason: NDArray[np.object_], word: str, where: NDArray[np.bool_]) -> None:
    """Name the reason where there is none yet."""
    reason[where & (reason == "")] = word


class Rigid:
    """The marks' distances in the tank, learnt from what is seen."""

    def __init__(self, markers: tuple[Marker, ...], mapping: Mapping) -> None:
        self.markers, self.mapping = markers, mapping
        self.distances: dict[tuple[int, int], float] = {}

    def check(self, found: Found, surprise: Array) -> None:
        """Where a pair's distance is wrong, the mark that surprises most is lost, until all pairs agree."""
        for _ in range(len(self.markers)):
            wrong = np.zeros(found.reason.shape, dtype=bool)
            for i, j in self._pairs():
                rows = found.both(i, j)
                if not len(rows):
                    continue
                gap, sd = self._apart(i, j, found, rows)
                apart = np.linalg.norm(gap, axis=1)
                stated = self.distances.get((i, j), float(np.median(apart)))
                off = rows[self._beyond((i, j), np.abs(apart - stated), gap, sd, found.place[[i, j], rows[0]])]
                wrong[i, off] = wrong[j, off] = True
            if not wrong.any():
                return
            for row in np.flatnonzero(wrong.any(axis=0)):
                worst = int(np.argmax(np.where(wrong[:, row], np.nan_to_num(surprise[:, row]), -1.0)))
                found.reason[worst, row] = "distance"

    def fits(self, index: int, place: Array, sigma: Array, now: Found) -> bool:
        """A mark found again stands at its distance from those that are held."""
        place_all, sigma_all, reason_all = (part[:, -1:].copy() for part in (now.place, now.sigma, now.reason))
        trial = replace(now, place=place_all, sigma=sigma_all, reason=reason_all)
        trial.place[index, 0], trial.sigma[index, 0], trial.reason[index, 0] = place, sigma, ""
        for pair in self._pairs():
            other = pair[0] if pair[1] == index else pair[1]
            if index in pair and pair in self.distances and trial.reason[other, 0] == "":
                gap, sd = self._apart(*pair, trial, np.array([0]))
                off = np.abs(np.linalg.norm(gap, axis=1) - self.distances[pair])
                if self._beyond(pair, off, gap, sd, trial.place[list(pair), 0])[0]:
                    return False
        return True

    def learn(self, found: Found) -> None:
        """Take a stretch's distances in."""
        for i, j in self._pairs():
            rows = found.both(i, j)
            if len(rows):
                apart = float(np.median(np.linalg.norm(self._apart(i, j, found, rows)[0], axis=1)))
                before = self.distances.get((i, j), apart)
                self.distances[(i, j)] = before + DISTANCE_MEMORY * (apart - before)

    def _tank(self, index: int, place: Array, sigma: Array) -> tuple[Array, Array]:
        """Places (n, 2) m and their covariance (n, 2, 2) m^2 from the pixels' sigma."""
        seen = self.mapping.to_tank(place, self.markers[index].depth_m)
        spread = seen.per_px * sigma[:, None, :]
        return seen.xy_m, spread @ spread.swapaxes(1, 2)

    def _apart(self, i: int, j: int, found: Found, rows: Array) -> tuple[Array, Array]:
        """From one mark to another in the tank (n, 2), and the standard deviation of their distance from the pixels, m."""
        (one, one_sd), (two, two_sd) = (self._tank(k, found.place[k, rows], found.sigma[k, rows]) for k in (i, j))
        gap = one - two
        unit = gap / np.maximum(np.linalg.norm(gap, axis=1), 1e-12)[:, None]
        return gap, np.sqrt(np.einsum("ni,nij,nj->n", unit, one_sd + two_sd, unit))

    def _beyond(self, key: tuple[int, int], off: Array, gap: Array, sd: Array, place: Array) -> NDArray[np.bool_]:
        """Whether a pair's distances (n,) are off by more than noise, the camera, and roll and pitch let them be; the pair is about
        at ``place (2, 2)`` px.
        """
        one, two = (self.markers[k] for k in key)
        body = np.subtract(one.body_m, two.body_m)
        # the camera's common errors change slowly over the picture: one standard deviation of identity's tolerance
        gate = DISTANCE_GATE * sd + DISTANCE_SD_M + DISTANCE_SD_SHARE * float(np.hypot(*body))
        beyond = off > gate
        if one.on != "model" or not beyond.any():
            return beyond
        aside = [ray_slopes(self.mapping, p[None], m.depth_m) for p, m in zip(place, (one, two), strict=True)]
        return off > gate + np.abs(distance_slopes(one, two, gap, (aside[0], aside[1]))) @ TURNED_RAD

    def _pairs(self):
        count = len(self.markers)
        return [(i, j) for j in range(count) for i in range(j) if self.markers[i].on == self.markers[j].on]
