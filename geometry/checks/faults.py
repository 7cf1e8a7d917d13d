"""What may be wrong with a camera set-up: each fault as numbers that are released, and its score against all the others.

A fault's evidence is the logarithm of its Bayes factor against "nothing is wrong" (Laplace's approximation): half the drop of
chi-square, less what its freedom costs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..camera import Array
from .bundle import Bundle, Extra, Film, Solution
from .jump import Jump, find_jump

POINT_SD_PX, TURN_SD_RAD, SLACK_SD_M = 10.0, 0.01, 0.03
"""How large these faults usually are, a choice: a datum point picked wrongly, a turn of the camera, missing line
length."""
SLACK_LENGTHS_S = (0.5, 1.0, 2.0, 3.0, 4.5, 7.0, 10.0)
"""How long a line may hang slack: windows from half a second to ten seconds, each 1.4 to 2 times the last."""
SLACK_SHIFTS = 6
"""Positions of a slack window within its own length."""
LEAST_TURN_S = 1.0
"""A turn is not looked for nearer than this to a film's ends."""
SCALE_SD = 0.02
"""Of the datum's width and length, as a share: a choice."""

RELEASED: dict[str, dict[str, float]] = {
    "lens": {"k1": 0.1},
    "lens: higher terms": {"k1": 0.1, "k2": 0.1, "p1": 5e-3, "p2": 5e-3},
    "lens: focal length": {"fx": 0.03, "fy": 0.03},
    "lens: principal point": {"cx": 20.0, "cy": 20.0},
    "deck height": {"deck height": 0.03},
    "datum width": {"datum width": SCALE_SD},
    "datum length": {"datum length": SCALE_SD},
    "datum scale": {"datum width": SCALE_SD, "datum length": SCALE_SD},
    "line length": {"line length": 0.02},
    "tow point": {"tow point": 0.02},
    "post ahead": {"post ahead": 0.02},
}
"""Faults that are numbers of the rig, and how large each usually is (fx, fy: relative)."""
MARK_SD_M = 0.02
"""How far a mark may usually lie from where it is stated: a choice."""


@dataclass(frozen=True)
class Fault:
    """A hypothesis.

    Attributes
    ----------
    kind : datum point, camera turned, slack line, or a key of RELEASED, or height/place of a mark
    released : parameter -> standard deviation
    extra : fault that is no number of the rig
    extra_sd : (k,)
    item : datum point's or mark's index, or run's
    ways : how many such were looked at (places, windows)
    """

    kind: str
    released: dict[str, float] = field(default_factory=dict)
    extra: Extra | None = None
    extra_sd: Array = field(default_factory=lambda: np.zeros(0))
    item: int = -1
    ways: int = 1


@dataclass(frozen=True)
class Scored:
    """A hypothesis and what the data say of it.

    Attributes
    ----------
    fault : hypothesis
    evidence : log Bayes factor against nothing wrong
    gain : drop of chi-square
    solution : with the fault's numbers released; None: only screened
    """

    fault: Fault
    evidence: float
    gain: float
    solution: Solution | None = None


def screen(bundle: Bundle, null: Solution, sd: Array) -> list[Scored]:
    """Score every fault by one linear step from the fit without faults, best first.

    Parameters
    ----------
    bundle : all that the recording says, at what is stated
    null : its fit without faults
    sd : prior standard deviations of the bundle's parameters
    """
    names = list(bundle.names)
    free = np.flatnonzero(sd > 0)
    normal = null.normal
    covariance = null.covariance[np.ix_(free, free)]

    def score(fault: Fault, inner: Array, across: Array, right: Array, spread: Array) -> Scored:
        """``inner`` (k, k), ``across`` (k, p_free): of the fault's columns; ``right`` (k,)."""
        left_over = inner - across @ covariance @ across.T
        gain, evidence = _evidence(left_over, right, spread)
        return Scored(fault, evidence - np.log(fault.ways), gain)

    found: list[Scored] = []
    for fault in rig_faults(bundle):
        columns = np.array([names.index(name) for name in fault.released])
        spread = _absolute(bundle, fault.released)
        inner, across = normal.matrix[np.ix_(columns, columns)], normal.matrix[np.ix_(columns, free)]
        found.append(score(fault, inner, across, normal.right[columns], spread))
    found += [score(*parts) for parts in _points(bundle, null, free)]
    for index, film in enumerate(bundle.films):
        found += [score(*parts) for parts in _slacks(bundle, null, free, index, film)]
        turned = _turned(bundle, null, free, covariance, index, film)
        if turned is not None:
            found.append(turned)
    return sorted(found, key=lambda scored: -scored.evidence)


def rig_faults(bundle: Bundle) -> Iterator[Fault]:
    """Faults that are numbers of the rig."""
    has_line = any(film.line_m is not None for film in bundle.films)
    for kind, released in RELEASED.items():
        if has_line or not {"line length", "tow point", "post ahead"} & set(released):
            yield Fault(kind, released)
    for i in range(len(bundle.rig.depth_m)):
        yield Fault("height of a mark", {f"depth {i}": MARK_SD_M}, item=i, ways=len(bundle.rig.depth_m))
        yield Fault(
            "place of a mark", {f"ahead {i}": MARK_SD_M, f"aside {i}": MARK_SD_M}, item=i, ways=len(bundle.rig.depth_m)
        )


def refit(bundle: Bundle, null: Solution, sd: Array, scored: Scored) -> Scored:
    """Score a fault by the full fit with its numbers released.

    Parameters
    ----------
    bundle : all that the recording says, at what is stated
    null : its fit without faults
    sd : prior standard deviations of the bundle's parameters
    scored : the fault with its score
    """
    fault = scored.fault
    names = list(bundle.names)
    wide = sd.copy()
    columns = [names.index(name) for name in fault.released]
    spread = _absolute(bundle, fault.released)
    wide[columns] = np.hypot(spread, sd[columns])
    extras = [] if fault.extra is None else [(fault.extra, fault.extra_sd)]
    solution = bundle.solve(wide, extras, null)
    gain = null.chi_square - solution.chi_square
    evidence = solution.log_evidence - null.log_evidence
    return Scored(fault, evidence - np.log(fault.ways), gain, solution)


def _evidence(left_over: Array, right: Array, spread: Array) -> tuple[float, float]:
    """Drop of chi-square with the prior ``spread``, and log Bayes factor."""
    inner = left_over + np.diag(1.0 / spread**2)
    gain = float(right @ np.linalg.solve(inner, right))
    sign, size = np.linalg.slogdet(np.eye(len(right)) + (spread[:, None] * left_over * spread[None, :]))
    return gain, 0.5 * gain - 0.5 * (size if sign > 0 else np.inf)


def _absolute(bundle: Bundle, released: dict[str, float]) -> Array:
    focal = {"fx": bundle.rig.lens.fx_px, "fy": bundle.rig.lens.fy_px}
    return np.array([value * focal.get(name, 1.0) for name, value in released.items()])


def _points(bundle: Bundle, null: Solution, free: Array):
    """A badly picked datum point: two numbers in its own two rows."""
    rig = bundle.rig
    gap, slope = bundle.datum_rows(null)
    weight = 1.0 / rig.datum_sigma_px
    count = len(weight)
    for i in range(count):
        rows = slice(2 * i, 2 * i + 2)
        fault = Fault("datum point", extra=Extra("point", i), extra_sd=np.full(2, POINT_SD_PX), item=i, ways=count)
        yield fault, np.eye(2) * weight[i] ** 2, slope[rows][:, free] * weight[i], gap[rows] * weight[i], fault.extra_sd


def _slacks(bundle: Bundle, null: Solution, free: Array, index: int, film: Film):
    """A slack line: half a sine of missing length, in windows over the whole film; the tow point is nearer than L."""
    if film.line_m is None or len(film.t_s) < 3:
        return
    normal = null.normal
    left, project, slopes = normal.left[index], normal.project[index], normal.slopes[index]
    moved = np.einsum("nj,njp->np", project[:, -1], slopes[:, :, free])
    weight = 1.0 / (bundle.line_sd_m * np.sqrt(bundle.inflation))
    begin, end = float(film.t_s[0]), float(film.t_s[-1])
    windows = [
        (start, start + length)
        for length in SLACK_LENGTHS_S
        if length < end - begin
        for start in np.arange(begin, end - length, length / SLACK_SHIFTS)
    ]
    for span in windows:
        shape = Extra("slack", index, span).shape(film.t_s) * weight
        right = float(shape @ left[:, -1])
        if right <= 0 or np.count_nonzero(shape) < 3:
            continue  # a line does not grow longer
        fault = Fault(
            "slack line",
            extra=Extra("slack", index, span),
            extra_sd=np.array([SLACK_SD_M]),
            item=index,
            ways=len(windows),
        )
        inner = np.array([[float((shape**2) @ project[:, -1, -1])]])
        yield fault, inner, (shape @ moved)[None], np.array([right]), fault.extra_sd


def _turned(bundle: Bundle, null: Solution, free: Array, covariance: Array, index: int, film: Film) -> Scored | None:
    """A camera turned at some time: by what the turn leaves in distances and line, and by the jump of the marks."""
    normal = null.normal
    slopes, project, left = normal.slopes[index], normal.project[index], normal.left[index]
    turning = slopes[:, :, bundle.layout.turn] * (np.arange(slopes.shape[1]) < slopes.shape[1] - 1)[:, None]
    own = np.einsum("nia,nij->naj", turning, project)
    inner = _suffix(np.einsum("naj,njb->nab", own, turning))
    across = _suffix(np.einsum("naj,njp->nap", own, slopes[:, :, free]))
    right = _suffix(np.einsum("nia,ni->na", turning, left))
    spread = np.full(3, TURN_SD_RAD)
    inside = (film.t_s > film.t_s[0] + LEAST_TURN_S) & (film.t_s < film.t_s[-1] - LEAST_TURN_S)
    places = np.flatnonzero(inside)
    if not len(places):
        return None
    left_over = inner[places] - across[places] @ covariance @ across[places].transpose(0, 2, 1)
    whole = left_over + np.diag(1.0 / spread**2)
    gain = np.einsum("na,na->n", right[places], np.linalg.solve(whole, right[places][:, :, None])[:, :, 0])
    price = 0.5 * np.linalg.slogdet(np.eye(3) + spread[0] ** 2 * left_over)[1]
    evidence = 0.5 * gain - price
    jump = jump_of(bundle, null, index)
    best = int(np.argmax(evidence))
    at, value, drop, ways = float(film.t_s[places[best]]), float(evidence[best]), float(gain[best]), len(places)
    if jump is not None:
        near = int(np.argmin(np.abs(film.t_s[places] - jump.t_s)))
        if jump.gain > drop:
            at, ways = jump.t_s, jump.frames
            value, drop = float(evidence[near]) + 0.5 * jump.gain, float(gain[near]) + jump.gain
        elif abs(near - best) <= 1 and jump.gain > 4 * np.log(jump.frames):  # chance reaches half of that
            at = jump.t_s
    extra = Extra("turn", index, (at, np.inf))
    fault = Fault("camera turned", extra=extra, extra_sd=spread, item=index, ways=ways)
    return Scored(fault, value - np.log(ways), drop)


def jump_of(bundle: Bundle, null: Solution, index: int) -> Jump | None:
    """The most likely jump of a film.

    Parameters
    ----------
    bundle : all that the recording says, at what is stated
    null : its fit without faults
    index : of the film
    """
    film, close, m = bundle.films[index], bundle.close[index], len(bundle.rig.depth_m)
    seen = np.isfinite(film.pixel_px).all(axis=(1, 2))
    if not seen.any():
        return None
    whitened = null.normal.slopes[index][seen, : 2 * m, bundle.layout.turn].reshape(-1, m, 2, 3)
    slopes = whitened * film.sigma_px[seen][..., None] * np.sqrt(bundle.inflation)
    # between the bundle's frames the marks, and so their slopes, move by little
    flat = [np.interp(close.t_s, film.t_s[seen], column) for column in slopes.reshape(len(slopes), -1).T]
    return find_jump(close, np.stack(flat, axis=1).reshape(-1, m, 2, 3), bundle.inflation)


def _suffix(values: Array) -> Array:
    """Sums over this frame and all after it."""
    return np.cumsum(values[::-1], axis=0)[::-1]
