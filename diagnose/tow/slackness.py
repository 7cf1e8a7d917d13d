"""Windows in which a line may have gone slack, from the taut-line residual alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtri
from scipy.stats import median_abs_deviation

from ...geometry.checks.bundle import half_sine
from ...simulate.model import RESISTANCE_EXPONENT, Array
from ..effects import Effect, Jerks, jerked, slack
from .channels import LINE
from .courses import Drawn
from .jerks import MOST_S, Radius, events, longer
from .start import straight_pull
from .surging import NOT_AT_ALL, NUMBERS, STEP_S, Event, Push, Straight, Surged, Swinging, courses
from .tow_run import TowRun

SLACK_Z = 8.0
"""A window counts as slack when the radius falls short by so many standard deviations: many are tried. A choice."""
LIKE_THE_MOST = 0.3
"""Windows below this share of the clearest one's significance are left out: a fit that lacks the slack line errs a little in all
runs. Events have courses of their own, and are taken as they are."""
KINDS, AS_GOOD, IN_FORM = 4, 10.0, 0.1
"""Kinds of what carries the models ahead that are tried as effects: so many, as far as the radius alone does not tell them from the
best by more than the second, or than the third of what it explains (no push has exactly these courses). Choices, for time."""
FOUND_COST = 10.0
"""Log evidence that finding an event's six numbers in a run's residual costs: a choice."""
SURGING = 1.05
"""Usual mass in surge over the model's."""
CHANGED = 0.05
"""Of an event's length, hardness and skew, for the slopes of its courses."""
PARTS = 4
"""Of a block, for the course of a jerk: about 0.1 s."""
LEAST_BLOCKS = 10
"""Means that a run must have for it: a choice."""
SLACK_LENGTHS_S = (1.0, 2.0, 3.0, 4.5, 7.0)
"""Windows whose fit begins the search; it then finds the length itself ..."""
AS_LONG = 0.95
"""... up to ``MOST_S``, and a line that is short for this share of it is not slack."""


def slack_effects(runs: Sequence[TowRun], residuals: Sequence[Array]) -> list[Effect]:
    """The most likely slack windows, from the taut line's residual alone: in the run that shows most, in the two, ... in all that
    show any.

    Parameters
    ----------
    runs : as the diagnosis sees them
    residuals : per run (n, 4), measured minus simulated by the fit without effects
    """
    found: list[Effect] = []
    for wave in (False, True):
        windows: list[tuple[float, float] | None] = []
        sure: list[float] = []
        for index, run in enumerate(runs):
            rest = run.off_middle(residuals[index][:, LINE], LEAST_BLOCKS)
            best = (0.0, 0.0, 0.0) if rest is None else _slackest(run.centre_s, rest, 2 if wave else 1)
            sure.append(best[0])
            windows.append((best[1], best[2]))
        clear = max(SLACK_Z, LIKE_THE_MOST * max(sure))
        windows = [w if z > clear else None for w, z in zip(windows, sure, strict=True)]
        if not any(windows):
            continue
        order = sorted((i for i, w in enumerate(windows) if w is not None), key=lambda i: -sure[i])
        for count in range(1, len(order) + 1):
            found.append(slack([w if i in order[:count] else None for i, w in enumerate(windows)], wave))
    return found


def jerk_effects(
    runs: Sequence[TowRun], residuals: Sequence[Array], swinging: Sequence[Swinging] | None = None
) -> list[Effect]:
    """The likeliest slackenings of lines that keep their length, from the taut line's residual: in the run that shows most, in the
    two, ... in all that show any; by the likeliest kinds of what carried the models. What carried one may have come at the same
    time where a line stayed taut, or hardly fell slack, as a carriage slows at the same place of its rails: no radius says so.

    Parameters
    ----------
    runs, residuals : as ``slack_effects`` has them
    swinging : how each run swings; None: as if it did not
    """
    radii: dict[int, Radius] = {}
    tows = [_tow_of(run, NOT_AT_ALL if swinging is None else swinging[k]) for k, run in enumerate(runs)]
    for index, (run, residual, tow) in enumerate(zip(runs, residuals, tows, strict=True)):
        if (radius := _radius(run, residual[:, LINE], tow)) is not None:
            radii[index] = radius
    likely = zip(radii, events(list(radii.values())), strict=True)
    shown: dict[int, list[Event]] = {index: own for index, own in likely if own}
    sure = {index: max(found[0].gain, 0.0) for index, found in shown.items()}
    order = sorted((i for i in sure if sure[i] > SLACK_Z**2 / 2), key=lambda i: -sure[i])
    found: list[dict[int, Event]] = []
    gains: dict[Push, float] = {}
    for event in (e for i in order for e in shown[i]):
        gains[event.push] = gains.get(event.push, 0.0) + event.gain
    least = max(gains.values(), default=0.0)
    least -= max(AS_GOOD, IN_FORM * least)
    kinds = [k for k in sorted(gains, key=lambda k: -gains[k]) if gains[k] > least]
    for push in kinds[:KINDS]:
        shortest = {i: event for i in order for event in shown[i] if event.push == push}
        begun = list(shortest.values())
        for events_of in (begun, *longer([radii[i] for i in shortest], begun)):
            own = dict(zip(shortest, events_of, strict=True))
            clearest, event = next(iter(own.items()))
            # what hardly shows in one run may be what shows clearly in another
            alike = {i: replace(event, tow=tow, gain=0.0) for i, tow in enumerate(tows) if i != clearest}
            found += [dict(islice(own.items(), count)) for count in range(1, len(own) + 1)]
            found += [own | {i: event} for i, event in alike.items()]
    return _jerked(runs, found)


def _jerked(runs: Sequence[TowRun], found: Sequence[dict[int, Event]]) -> list[Effect]:
    """The effects of such events, each in its run."""
    # most are in several
    every = {id(event): event for own in found for event in own.values()}
    shown = dict(zip(every, _courses(list(every.values()), runs[0].step_s / 2), strict=True))
    answers = []
    for own in found:
        said = ", ".join(f"run {i + 1} {own[i].begin_s:.1f}-{own[i].end_s:.1f} s" for i in sorted(own))
        each = {i: shown[id(event)] for i, event in own.items()}
        kinds = (partial(_changing, _drawn(len(runs), each, k)) for k in range(3))
        (first, *_) = own.values()
        jerks = Jerks(len(runs), sorted(own), *kinds)
        answers.append(jerked(jerks, f"{first.push.words}, {said}", FOUND_COST * len(own)))
    return answers


def _radius(run: TowRun, left: Array, tow: Straight) -> Radius | None:
    """What a run's frames show of events beside what the taut line of the fit explains of its blocks; None of too few blocks."""
    good = np.isfinite(left)
    if good.sum() < LEAST_BLOCKS:
        return None
    t_s, means, sd_m = run.radius_by_parts(PARTS)
    explained = np.interp(t_s, run.centre_s[good], (run.values[:, LINE] - left)[good])
    level = np.full_like(t_s, np.median(run.values[good, LINE]))
    # a fit that a hard jerk has led astray explains less than nothing
    shorts = (explained + np.median(left[good]) - means, level - means)
    # most of a block's error is slow: its parts scatter less than if it were white, and a run is taut for most of its time
    scatters = [float(median_abs_deviation(s, nan_policy="omit", scale=float(ndtri(0.75)))) for s in shorts]
    best = int(np.argmin(scatters))
    short, scatter = shorts[best], scatters[best]
    return Radius(t_s, short, min(sd_m, scatter), tow)


def _tow_of(run: TowRun, swinging: Swinging) -> Straight:
    pull, _ = straight_pull(run)
    return Straight(run.data.tow.speed_m_s, pull / surging_kg(run), RESISTANCE_EXPONENT, swinging)


def surging_kg(run: TowRun) -> float:
    """Usual mass in surge.

    Parameters
    ----------
    run : as the diagnosis sees it
    """
    return SURGING * run.run.model.mass_kg


def _courses(found: Sequence[Event], node_s: float) -> list[list[tuple[float, Array]]]:
    """Of each event by how much the line is shorter, m, the model is faster, m/s, and is pushed, over R, as means about each node:
    when these rows (3, n) begin, s, and they. Then the same if it lasts CHANGED longer about the same middle, if it is so much
    harder, and if its first half takes so much the longer.
    """
    steps = np.zeros((4, len(NUMBERS)))
    moved = []
    for event in found:
        steps[1, :2] = -CHANGED * event.length_s / 2, CHANGED
        steps[2, 2] = CHANGED
        steps[3, 3] = CHANGED
        moved += [replace(event, numbers=event.numbers + step) for step in steps]
    each = [_course(t_s, surge, node_s) for t_s, surge in courses(moved)]
    return [each[k : k + len(steps)] for k in range(0, len(each), len(steps))]


def _drawn(count: int, shown: dict[int, list[tuple[float, Array]]], kind: int) -> Drawn:
    """Of ``count`` runs what those that have an event show of one kind: ``_courses``'s rows."""
    longest = max(rows.shape[1] for each in shown.values() for _, rows in each)
    begin_s, values = np.zeros((4, count)), np.zeros((4, count, longest))
    for run, each in shown.items():
        for k, (first_s, rows) in enumerate(each):
            begin_s[k, run] = first_s
            values[k, run, : rows.shape[1]] = rows[kind]
    return Drawn(begin_s, STEP_S, values)


def _changing(drawn: Drawn, t_s: Any) -> Array:
    """A course, and how it changes with its numbers."""
    rows = drawn(t_s)
    rows[1:] -= rows[0]
    rows[1:] /= CHANGED
    return rows


def _course(t_s: Array, surge: Surged, node_s: float) -> tuple[float, Array]:
    """Begin and rows."""
    width = max(1, round(node_s / STEP_S))
    # a cubic spline's own shape: nodes then hold a jerk's impulse wherever it lies between them, and how that moves with it
    box = np.ones(width) / width
    kernel = np.convolve(np.convolve(box, box), np.convolve(box, box))
    # nothing at either end
    beside = 2 * width
    ahead, faster, pushed = (np.pad(row, beside) for row in (surge.ahead_m, surge.faster_m_s, surge.pushed))
    rows = np.array([ahead, *(np.convolve(row, kernel, mode="same") for row in (faster, pushed))])
    return float(t_s[0]) - beside * STEP_S, rows


def _slackest(t_s: Array, rest: Array, power: int) -> tuple[float, float, float]:
    """Significance, begin and end of the (squared) half sine by which ``rest`` falls short most."""

    def short(begin: float, length: float) -> float:
        shape = half_sine(t_s, begin, begin + max(length, 1e-3)) ** power
        size = np.linalg.norm(shape)
        return float(-(shape @ rest) / size) if size > 0 else 0.0

    grid = [(short(b, n), b, n) for n in SLACK_LENGTHS_S for b in np.arange(t_s[0], t_s[-1] - n, n / 5)]
    z, begin, length = max(grid, default=(0.0, 0.0, 1.0))
    if z > SLACK_Z:
        finer = minimize(
            lambda x: -short(x[0], x[1]),
            [begin, length],
            method="Nelder-Mead",
            bounds=[(t_s[0] - MOST_S, t_s[-1]), (SLACK_LENGTHS_S[0] / 2, MOST_S)],
            options={"xatol": 0.02, "fatol": 0.02},
        )
        z, (begin, length) = -float(finer.fun), finer.x
        if length > AS_LONG * MOST_S:
            return 0.0, 0.0, 0.0  # a radius that drifts
    return z, float(begin), float(begin + length)
