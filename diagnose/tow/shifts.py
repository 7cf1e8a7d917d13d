"""A camera that was turned, or a post that was moved: between two runs, during one, for a while, slowly or little by little.

When, from the residuals of what holds no dynamics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from ...simulate.model import Array
from ..effects import Effect, Parameter
from ..effects.base import share_since
from ..effects.camera import POST, SHIFT
from .tow_run import TowRun

STEP_Z = 8.0
"""A step is looked at as a turned camera when it stands this many standard deviations out: many times are tried. A
choice."""
EDGE = 4
"""Blocks before or after a step."""
OVER_S = (3.0, 9.0, 20.0)
"""How long a slow turn may take, about the clearest step: a fit goes on from there."""
LEAST_OVER_S = 0.02
"""What takes no longer than this is at once."""
UNTIL = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Shares of all runs after which what gave way little by little may stand. A choice; how long nobody looked between two runs
is not known.
"""
WARM = 0.3
"""Share of all runs in which what grows warm comes within 1/e of its end. A choice."""
CREEP_FORM = 0.01
"""Share of its log evidence that a course of nobody's drawing may leave over: no tripod gives way as a straight line, and minutes
between two runs are not in it."""
WHILE_COST = 3.0
"""Log evidence that a second time found beforehand costs: a choice."""
NEAR = 6
"""Blocks about a step that say when it was."""


def shift_effects(runs: Sequence[TowRun], residuals: Sequence[Array]) -> list[Effect]:
    """Turned before each run but the first, little by little in all of them, and where one run's line and marker distance show the
    clearest step, or all that is seen jumps: for good, for a while, or slowly. And a post that was moved before a run.

    Parameters
    ----------
    runs : as the diagnosis sees them
    residuals : per run (n, 4), measured minus simulated by the fit without effects
    """
    names = [run.name for run in runs]
    found = [_since(POST, names, k) for k in range(1, len(runs))] if all(run.marks is not None for run in runs) else []
    if any(run.marks is None or SHIFT.needs(run.marks.run) for run in runs):
        return found
    found += [_since(SHIFT, names, k) for k in range(1, len(runs))]
    if len(runs) > 1:
        found += _little_by_little(runs)
    since, windows = _jumping(runs, residuals)
    clearest, time, where = max((*_step(run, residuals[k]), k) for k, run in enumerate(runs))
    if clearest > STEP_Z:
        since.append((where, time))
        windows += [(where, *ends) for ends in _while(runs[where], residuals[where])]
        found += [_slowly(names, where, time, over, runs[where].step_s) for over in OVER_S]
    found += [_since(SHIFT, names, k, at_s, runs[k].step_s) for k, at_s in _unlike(since, runs)]
    return found + [_between(names, k, begin, end, runs[k].step_s) for k, begin, end in _unlike(windows, runs)]


def _unlike(times: Sequence[tuple[float, ...]], runs: Sequence[TowRun]) -> list[tuple]:
    """Run and times, without those that are within a block of others before them."""
    kept: list[tuple] = []
    for place, *own in times:
        step_s = runs[int(place)].step_s
        if not any(k == place and np.allclose(own, others, rtol=0, atol=step_s) for k, *others in kept):
            kept.append((int(place), *own))
    return kept


def _since(effect: Effect, names: Sequence[str], first: int, time_s: float = 0.0, step_s: float = 1.0) -> Effect:
    def when(name: str, t_s: Array) -> Array:
        place = names.index(name)
        return (
            share_since(t_s, time_s, step_s) if time_s and place == first else np.full(len(t_s), float(place >= first))
        )

    at = f", {time_s:.1f} s" if time_s else ""
    return replace(effect, variant=f"from {names[first]}{at} on", when=when)


def _between(names: Sequence[str], where: int, begin_s: float, end_s: float, step_s: float) -> Effect:
    def when(name: str, t_s: Array) -> Array:
        here = float(names.index(name) == where)
        return here * (share_since(t_s, begin_s, step_s) - share_since(t_s, end_s, step_s))

    return replace(SHIFT, variant=f"in {names[where]}, {begin_s:.1f}-{end_s:.1f} s", when=when, cost=WHILE_COST)


def _slowly(names: Sequence[str], where: int, middle_s: float, over_s: float, step_s: float) -> Effect:
    """From a found time on over some time; both are fitted."""

    def when(name: str, t_s: Array, middle_s: float, over_s: float) -> Array:
        place = names.index(name)
        if place != where:
            return np.full(len(t_s), float(place > where))
        return _mean_share(t_s, middle_s, max(over_s, LEAST_OVER_S), step_s)

    return replace(
        SHIFT,
        parameters=(
            *SHIFT.parameters,
            Parameter("middle_s", "s", over_s / 3, none=middle_s),
            Parameter("over_s", "s", over_s / 3, none=over_s),
        ),
        members=tuple((*turned, "middle_s", "over_s") for turned in SHIFT.members),
        variant=f"slowly from {names[where]} on, about {middle_s:.0f} s, over about {over_s:g} s",
        when=when,
        timed=2,
        form=CREEP_FORM,
    )


def _mean_share(t_s: Array, middle_s: float, over_s: float, step_s: float) -> Array:
    """Means of ``share_since`` over blocks about ``t_s``."""

    def whole(time_s: Array) -> Array:
        """All of it that was before a time."""
        passed = np.clip((time_s - middle_s) / over_s + 0.5, 0.0, None)
        return over_s * np.where(passed < 1.0, passed**2 / 2, passed - 0.5)

    return (whole(t_s + step_s / 2) - whole(t_s - step_s / 2)) / step_s


def _little_by_little(runs: Sequence[TowRun]) -> list[Effect]:
    """Through all runs: all along, until it stands, and ever slower."""
    lasts = np.array([len(run.centre_s) * run.step_s for run in runs])
    ends = np.cumsum(lasts)
    begins = dict(zip((run.name for run in runs), ends - lasts, strict=True))

    def effect(variant: str, course: Callable[[Array], Array]) -> Effect:
        """``course`` says how far it has come, by the share of all runs that has passed."""
        return replace(
            SHIFT, variant=variant, when=lambda name, t_s: course((begins[name] + t_s) / ends[-1]), form=CREEP_FORM
        )

    return [
        effect("little by little in all runs", partial(_until, 1.0)),
        *(effect(f"little by little, and no further from {s:.0%} of all runs on", partial(_until, s)) for s in UNTIL),
        effect("ever slower, as what grows warm", _ever_slower),
    ]


def _until(share: float, passed: Array) -> Array:
    return np.minimum(passed / share, 1.0)


def _ever_slower(passed: Array) -> Array:
    return 1.0 - np.exp(-passed / WARM)


def _while(run: TowRun, residual: Array) -> list[tuple[float, float]]:
    """Begin and end of the stretch of a run whose line and marker distance differ most from the rest.

    Where it begins or ends with the run the rest is as likely to be the one that differs, and is told as well: a camera that was
    turned may have been turned back before the next run.
    """
    both = _rests(run, residual)
    n = both.shape[1]
    sums = np.concatenate([np.zeros((len(both), 1)), np.cumsum(both, axis=1)], axis=1)
    begin, end = (k[..., None] for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    count = np.where((end - begin >= EDGE) & (end - begin <= n - EDGE), end - begin, 0)[..., 0]
    inside = (sums[:, None, :n] - sums[:, :n, None]) ** 2
    # of a mean of zero over the whole run
    shown = np.where(count > 0, inside.sum(axis=0) / np.maximum(count * (1 - count / n), 1e-9), 0.0)
    first, last = np.unravel_index(int(np.argmax(shown)), shown.shape)
    begin_s, end_s = (_sharp(run, both, int(k)) if EDGE <= k <= n - EDGE else 0.0 for k in (first, last))
    whole_s = float(run.centre_s[0] - run.step_s / 2), float(run.centre_s[-1] + run.step_s / 2)
    if first < EDGE:
        return [(whole_s[0], end_s), (end_s, whole_s[1])]
    if last > n - EDGE:
        return [(whole_s[0], begin_s), (begin_s, whole_s[1])]
    return [(begin_s, end_s)]


def _rests(run: TowRun, residual: Array, channels: Sequence[int] = (2, 3)) -> Array:
    """(channels, n): line and marker distance over their noise, about their means; none where too little was seen."""
    rests = [np.zeros((0, len(run.centre_s)))]
    for channel in channels:
        good = np.isfinite(residual[:, channel])
        if good.sum() >= 4 * EDGE:
            sd = run.usual_sd(channel)
            rests.append(np.where(good, residual[:, channel] - residual[good, channel].mean(), 0.0)[None] / sd)
    return np.concatenate(rests)


def _step(run: TowRun, residual: Array) -> tuple[float, float]:
    """Significance and time of the clearest step in line and marker distance together."""
    both = _rests(run, residual)
    if not len(both):
        return 0.0, 0.0
    n = len(run.centre_s)
    squares = [_shown(run, both, float(run.centre_s[k]) + run.step_s / 2) for k in range(EDGE, n - EDGE)]
    at = EDGE + int(np.argmax(squares))
    return float(np.sqrt(max(squares))), _sharp(run, both, at + 1)


def _shown(run: TowRun, both: Array, time_s: float) -> float:
    """What a step at a time explains of all blocks."""
    share = share_since(run.centre_s, time_s, run.step_s)
    share, rest = share - share.mean(), both - both.mean(axis=1, keepdims=True)
    return float(((rest @ share) ** 2).sum() / max(share @ share, 1e-9))


def _jumping(runs: Sequence[TowRun], residuals: Sequence[Array]) -> tuple[list[tuple], list[tuple]]:
    """Where all that is seen jumps, in the run that jumps most: run and time of what is for good; run, begin and end of what is
    for one end of the run, or between two jumps.
    """
    jumps, where = max(((_jumps(run, residuals[k]), k) for k, run in enumerate(runs)), key=lambda each: each[0][:1])
    if not jumps:
        return [], []
    run, half_s = runs[where], runs[where].step_s / 2
    times = sorted(time_s for _, time_s in jumps)
    ends = [float(run.centre_s[0]) - half_s, *times, float(run.centre_s[-1]) + half_s]
    windows = [(ends[1], ends[2])] if len(times) == 2 else [(ends[0], ends[1]), (ends[1], ends[2])]
    return [(where, time_s) for time_s in times], [(where, *window) for window in windows]


def _jumps(run: TowRun, residual: Array) -> list[tuple[float, float]]:
    """Significance and time of the clearest one or two jumps from a block to the next in all that is seen: what moves does not.

    By how much better a step beside a cubic says what is about it than a fourth power does.
    """
    both = _rests(run, residual, range(residual.shape[1]))
    inner = range(NEAR, len(run.centre_s) - NEAR)
    if not len(both) or not len(inner):
        return []
    gains = np.zeros(len(run.centre_s))
    good = np.isfinite(residual)
    seen_whole = np.all(good[:, good.any(axis=0)], axis=1, keepdims=True)
    for k in inner:
        if not seen_whole[k - NEAR : k + NEAR + 1].all():
            continue  # where a mark was lost nothing is known of a jump
        seen = both[:, k - NEAR : k + NEAR + 1].T
        stepped = _broken(run, k, float(run.centre_s[k]) + run.step_s / 2, 4)[:, :5]
        gains[k] = _squares(seen, _powers(run, k, 5)) - _squares(seen, stepped)
    found: list[tuple[float, float]] = []
    while len(found) < 2 and gains.max() > STEP_Z**2:
        at = int(np.argmax(gains))
        found.append((float(np.sqrt(gains[at])), _sharp(run, both, at + 1, 4)))
        gains[max(at - 2 * NEAR, 0) : at + 2 * NEAR + 1] = 0.0
    return found


def _powers(run: TowRun, at: int, count: int) -> Array:
    """(n, count) powers of the time, from 0 on, of the blocks about ``at``."""
    centre_s = run.centre_s[max(at - NEAR, 0) : at + NEAR + 1]
    return ((centre_s - centre_s.mean()) / (NEAR * run.step_s))[:, None] ** np.arange(count)


def _broken(run: TowRun, at: int, time_s: float, count: int) -> Array:
    """(n, count + 2) the same with a step at a time, and with another slope behind it."""
    powers = _powers(run, at, count)
    share = share_since(run.centre_s[max(at - NEAR, 0) : at + NEAR + 1], time_s, run.step_s)
    return np.column_stack([powers, share, share * powers[:, 1]])


def _squares(seen: Array, course: Array) -> float:
    """What is left of ``seen`` (n, channels) beside a course of some numbers in each."""
    return float(np.square(seen - course @ np.linalg.lstsq(course, seen, rcond=None)[0]).sum())


def _sharp(run: TowRun, both: Array, first: int, count: int = 2) -> float:
    """When within its block the step was, about the begin of block ``first``, beside so many powers of the time."""
    at = first - 1
    seen = both[:, max(at - NEAR, 0) : at + NEAR + 1].T

    def left(time_s: float) -> float:
        # what a turned camera does changes as the model moves: a step and another slope behind it
        return _squares(seen, _broken(run, at, time_s, count))

    times = [float(run.centre_s[at]) + run.step_s * k / 20 for k in range(-10, 31)]
    best, width = min(times, key=left), run.step_s / 20
    # a step of many pixels says it far more finely
    found = minimize_scalar(left, bounds=(best - width, best + width), method="bounded")
    return float(found.x)  # pyright: ignore[reportAttributeAccessIssue]


__all__ = ["shift_effects"]
