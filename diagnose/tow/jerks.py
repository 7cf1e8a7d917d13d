"""Slackenings of a line, as its radius shows them: what carried the model, when, how long and how hard.

What the taut-line radius shows of a slack line says that, and with it how fast the model went through the water (``surging``). What
the line pulled with, jerks included, no camera sees: it follows from that by the model's inertia.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.robust import MAD_TO_SD
from ...simulate.model import Array
from .surging import NOT_AT_ALL, NUMBERS, PUSHES, STEP_S, Event, Push, Straight, ahead_of, surged

MOST_S = 10.0
"""What seems to carry a model for longer is a radius that drifts, no event; so of windows in which a line is short (slackness)."""
SPRING_RAD_S, DAMPING = 15.0, 0.2
"""Usual frequency of a model on a stiff line, and its damping over the critical one."""
HARD = (1.1, 1.3, 1.6, 2.0, 2.6, 3.4)
"""How hard it may be carried, in the straight tow's resistance: the search's grid. Below 1 no line falls slack."""
LENGTHS_S = tuple(np.geomspace(0.8, 9.0, 18))
"""How long: the search's grid."""
QUIET_Z, STRETCHES = 4.0, (2, 4, 8, 16, 32, 64)
"""Where no stretch of so many means falls short by more than so many standard deviations nothing is sought: choices, for time. Of
tows of nothing the stretches reach 2.1 to 3.9, of lines that fall slack 6.6 and more."""
MOST_COLOUR = 2.5
"""What lasts in a radius makes stretches scatter by up to so many times what white noise does; what scatters more is not noise."""
APART_S = 0.12
"""Of the begins that are tried."""
BOUNCES = tuple((spring, damping) for spring in np.geomspace(9.0, 32.0, 7) for damping in (0.06, DAMPING))
"""Paces of a line's bounce, rad/s, with their damping, that are tried: one that is begun otherwise is out of step within a second,
and no step leads back."""
ALIKE_TRIED, STARTS, STARTS_AGAIN = 8, 3, 1
"""Of every kind of push so many of the grid's events are fitted to means in which no bounce shows (COARSE_S), tried with all of
these, and so many of those fitted to all that shows; and so many bouncing as the likeliest events do. Choices, for time."""
COARSE_S = 0.6
"""A line bounces at 9 rad/s and more."""
LINE = slice(NUMBERS.index("spring"), NUMBERS.index("damping") + 1)
"""Which of them say how a line bounces."""
USUAL = np.log([1.0, 1.0, 1.0, 1.0, SPRING_RAD_S, DAMPING, 1.0])
"""About which they lie, the first three anywhere ..."""
SPREAD = np.array([np.inf, np.inf, np.inf, 0.5, 0.7, 0.7, 0.05])
"""... with these standard deviations."""
TURNS, FIRST_TURNS = 15, 6
"""Steps of the fit, and of the one to means in which no bounce shows."""
RUN_OFF_M = 100.0
"""A model that an event carries further than this has run off: no number says by how much."""
ENOUGH, STUCK = 1e-4, 1e4
"""A fit ends where a step gains less than this share of the squares that are left, or gains nothing however much it is damped."""
LONGER, HELD = (1.25, 1.6, 2.0, 2.5), 0.02
"""What carries a model with less than the resistance shows in no radius: an event may have lasted so many times as long as its
radius says, and been the less hard. Those are fitted with their length held to so much of itself."""
SMALL = np.array([0.01, 0.01, 0.01, 0.01, 0.02, 0.05, 0.01])
"""Steps of its slopes."""
AT_MOST = np.array([0.3, 0.2, 0.2, 0.3, 0.3, 0.5, 0.05])
"""No number changes by more in a step."""


@dataclass(frozen=True)
class Radius:
    """What a run shows of events.

    Attributes
    ----------
    t_s : (n,) middles of the means, evenly spaced
    ahead_m : (n,) by how much the line's radius falls short; NaN where it was not measured
    sd_m : noise of those
    tow : that events befall
    """

    t_s: Array
    ahead_m: Array
    sd_m: float
    tow: Straight

    @property
    def step_s(self) -> float:
        """Between the means."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def seen_m(self) -> Array:
        """(n,) the same with 0 where it was not measured."""
        return np.nan_to_num(self.ahead_m)

    @property
    def quiet(self) -> bool:
        """Nothing is sought here."""
        sums = np.concatenate([[0.0], np.cumsum(self.seen_m / self.sd_m)])
        shown = [(sums[n:] - sums[:-n]) / np.sqrt(n) for n in STRETCHES if n < len(sums)]
        colours = [np.clip(MAD_TO_SD * np.median(np.abs(z)), 1.0, MOST_COLOUR) for z in shown]
        return all(z.max() < QUIET_Z * colour for z, colour in zip(shown, colours, strict=True))


def events(radii: Sequence[Radius]) -> list[list[Event]]:
    """Of each run the likeliest event of every kind of push, the likeliest first; none where its radius is quiet or drifts.

    Parameters
    ----------
    radii : of the runs
    """
    loud = [k for k, radius in enumerate(radii) if not radius.quiet]
    shown, smooth = [radii[k] for k in loud], [_coarse(radii[k]) for k in loud]
    # a bounce that is out of step hides what carried the model
    begun = _fitted(smooth, [_of_grid(radius) for radius in smooth], turns=FIRST_TURNS)
    fitted = _fitted(shown, [_begun(radius, own, BOUNCES, STARTS) for radius, own in zip(shown, begun, strict=True)])
    # one line bounces alike whatever carried the model, and in all runs
    likeliest = [max(own, key=lambda event: event.gain) for own in fitted if own]
    alike = [tuple(np.exp(event.numbers[LINE])) for event in likeliest]
    again = _fitted(shown, [_begun(radius, own, alike, STARTS_AGAIN) for radius, own in zip(shown, begun, strict=True)])
    fitted = [one + other for one, other in zip(fitted, again, strict=True)]
    found = {k: [e for e in own if e.length_s < MOST_S] for k, own in zip(loud, fitted, strict=True)}
    answers = []
    for own in (found.get(k, []) for k in range(len(radii))):
        best = _best_of_each([e.push for e in own], np.array([e.gain for e in own]), 1)
        answers.append(sorted((own[k] for k in best), key=lambda event: -event.gain))
    return answers


def longer(radii: Sequence[Radius], found: Sequence[Event]) -> list[list[Event]]:
    """The events as if they had lasted LONGER, one of each run, fitted to their radii; as long as none lasts too long.

    Parameters
    ----------
    radii : of the runs
    found : of each run the likeliest
    """
    starts = []
    for times in LONGER:
        for event in found:
            more = (times - 1) * event.length_s
            start = event.numbers + np.array([-more / 2, np.log(times), *np.zeros(len(NUMBERS) - 2)])
            # of what is beyond the resistance as much as before
            start[2] = np.log1p(np.expm1(max(event.numbers[2], 0.05)) / times)
            starts.append([(event.push, start)])
    fitted = [one for (one,) in _fitted(list(radii) * len(LONGER), starts, HELD)]
    answers = [fitted[k : k + len(found)] for k in range(0, len(fitted), len(found))]
    return [own for own in answers if all(event.length_s < MOST_S for event in own)]


def _begun(
    radius: Radius, coarse: Sequence[Event], bounces: Sequence[tuple[float, float]], count: int
) -> list[tuple[Push, Array]]:
    """Of every kind of push the likeliest ``count``: events as they show without bounces, bouncing in each of these ways."""
    tried = [(event.push, _bouncing(event.numbers, bounce)) for event in coarse for bounce in bounces]
    kinds, numbers = [p for p, _ in tried], np.array([x for _, x in tried])
    (rows,) = _missed([radius], [kinds], [numbers[:, None]], ([numbers], SPREAD))
    return [tried[k] for k in _best_of_each(kinds, -_squares(rows), count)]


def _bouncing(numbers: Array, bounce: tuple[float, float]) -> Array:
    """The same event on a line of this stiffness and damping."""
    changed = numbers.copy()
    changed[LINE] = np.log(bounce)
    return changed


def _best_of_each(kinds: Sequence[Push], gain: Array, count: int) -> list[int]:
    """Indices of the best ``count`` of every kind."""
    order = np.argsort(-gain)
    return [int(k) for push in PUSHES for k in [k for k in order if kinds[k] == push][:count]]


def _coarse(radius: Radius) -> Radius:
    """The same by means over about COARSE_S."""
    many = max(round(COARSE_S / radius.step_s), 1)
    count = len(radius.t_s) // many
    t_s, ahead = (x[: count * many].reshape(count, many) for x in (radius.t_s, radius.ahead_m))
    shown = np.isfinite(ahead).sum(axis=1)
    means = np.where(shown > many / 2, np.nan_to_num(ahead).sum(axis=1) / np.maximum(shown, 1), np.nan)
    return replace(radius, t_s=t_s.mean(axis=1), ahead_m=means, sd_m=radius.sd_m / math.sqrt(many))


def _of_grid(radius: Radius) -> list[tuple[Push, Array]]:
    """Of every kind of push the best of the grid's numbers, ALIKE_TRIED of each."""
    t_s, ahead_m, sd_m, step = radius.t_s, radius.seen_m, radius.sd_m, radius.step_s
    starts = [
        (p, np.log([1.0, n, h, 1.0, SPRING_RAD_S, DAMPING, 1.0])) for p in PUSHES for n in LENGTHS_S for h in HARD
    ]
    pushes, numbers = [p for p, _ in starts], np.array([x for _, x in starts])
    # an event of any begin: as if the tow did not swing
    straight = replace(radius.tow, swinging=NOT_AT_ALL)
    far = surged(pushes, numbers, [straight] * len(starts)).ahead_m
    whole = np.concatenate([np.zeros_like(far[:1]), np.cumsum(far, axis=0)])
    best = np.full(len(starts), -np.inf)
    shifts = math.ceil(step / APART_S)
    for shift in range(shifts):
        # an event that begins shortly before a mean's begin
        early = step * shift / shifts
        means = _block_means(whole, early, step) / sd_m
        padded = np.pad(ahead_m / sd_m, (0, len(means)))
        for k, shape in enumerate(means.T):
            gain = np.correlate(padded, shape)[: len(t_s)] - 0.5 * float(shape @ shape)
            at = int(np.argmax(gain))
            if gain[at] > best[k]:
                best[k], numbers[k, 0] = gain[at], t_s[at] - step / 2 - early
    return [(pushes[k], numbers[k]) for k in _best_of_each(pushes, best, ALIKE_TRIED)]


def _block_means(whole: Array, early_s: float, step_s: float) -> Array:
    """Means over blocks (q, k), of sums (n + 1, k), of what begins ``early_s`` before the first of them."""
    first = round(early_s / STEP_S)
    count = len(whole) - 1 - first
    edges = first + np.round(np.arange(0, count * STEP_S / step_s) * step_s / STEP_S).astype(int)
    return np.diff(whole[edges], axis=0) / np.diff(edges)[:, None]


def _missed(
    radii: Sequence[Radius],
    pushes: Sequence[Sequence[Push]],
    numbers: Sequence[Array],
    known: tuple[list[Array], Array],
) -> list[Array]:
    """Of each run (k, m, n + 7) rows: blocks, then what is known of the numbers.

    Parameters
    ----------
    radii : of the runs
    pushes : of each run k
    numbers : of each run (k, m, 7), m sets for each push
    known : of each run (k, 7) about which the numbers lie, and their standard deviations (7,)
    """
    kinds = [p for own, x in zip(pushes, numbers, strict=True) for p in own for _ in range(x.shape[1])]
    tows = [r.tow for r, x in zip(radii, numbers, strict=True) for _ in range(x.shape[0] * x.shape[1])]
    # one integration of all: what a step costs hardly grows with how many go side by side
    with np.errstate(over="ignore", invalid="ignore"):  # one that runs off
        far = ahead_of(kinds, np.concatenate([x.reshape(-1, len(NUMBERS)) for x in numbers]), tows)
    far = np.clip(np.nan_to_num(far, nan=RUN_OFF_M), -RUN_OFF_M, RUN_OFF_M)
    whole = np.zeros((len(far), far.shape[1] + 1))
    np.cumsum(far, axis=1, out=whole[:, 1:])
    fine = STEP_S * np.arange(whole.shape[1])
    found, first = [], 0
    for radius, own, usual in zip(radii, numbers, known[0], strict=True):
        flat, step = own.reshape(-1, len(NUMBERS)), radius.step_s
        late, early = radius.t_s + step / 2, radius.t_s - step / 2
        sums = whole[first : first + len(flat)]
        first += len(flat)
        rows = [
            (np.interp(late - b, fine, w) - np.interp(early - b, fine, w)) * (STEP_S / step)
            for b, w in zip(flat[:, 0], sums, strict=True)
        ]
        apart = np.nan_to_num(radius.ahead_m - np.array(rows))
        gaps = np.column_stack([apart / radius.sd_m, (np.repeat(usual, own.shape[1], axis=0) - flat) / known[1]])
        found.append(gaps.reshape(*own.shape[:2], -1))
    return found


def _fitted(
    radii: Sequence[Radius],
    starts: Sequence[Sequence[tuple[Push, Array]]],
    length_sd: float = np.inf,
    turns: int = TURNS,
) -> list[list[Event]]:
    """Gauss-Newton from these starts, all of all runs side by side; steps that lose are halved. ``length_sd``: how far the length
    may be from its start, relative; ``turns``: how many steps.
    """
    if not radii:
        return []
    pushes = [[p for p, _ in own] for own in starts]
    here = [np.array([x for _, x in own]) for own in starts]
    steps = np.concatenate([np.zeros((1, len(NUMBERS))), np.diag(SMALL)])

    known, spread = [np.where(np.arange(len(NUMBERS)) == 1, x, USUAL) for x in here], SPREAD.copy()
    spread[1] = length_sd

    def missed(runs: Sequence[int], at: Sequence[Array]) -> list[Array]:
        """Of these runs, their pushes that still go on moved to ``at``."""
        some = [[push for push, on in zip(pushes[k], going[k], strict=True) if on] for k in runs]
        about = [known[k][going[k]] for k in runs]
        return _missed([radii[k] for k in runs], some, [x[:, None] + steps for x in at], (about, spread))

    going = [np.ones(len(x), dtype=bool) for x in here]
    rows, damp = missed(range(len(here)), here), [np.full(len(x), 1e-2) for x in here]
    for _ in range(turns):
        runs = [k for k, on in enumerate(going) if on.any()]
        if not runs:
            break
        trial = [here[k][going[k]] + _change(rows[k][going[k]], damp[k][going[k]]) for k in runs]
        # with what a step from there would ask for: a second integration costs far more than these beside the first
        for k, to, after in zip(runs, trial, missed(runs, trial), strict=True):
            on = np.flatnonzero(going[k])
            before = _squares(rows[k][on])
            less = before - _squares(after)
            better = less > 0
            here[k][on[better]], rows[k][on[better]] = to[better], after[better]
            damp[k][on] *= np.where(better, 1 / 5, 8.0)
            going[k][on[(better & (less < ENOUGH * before)) | (damp[k][on] > STUCK)]] = False
    before = [float(((r.seen_m / r.sd_m) ** 2).sum()) for r in radii]
    return [
        [
            Event(push, x, radius.tow, 0.5 * (total - float(square)))
            for push, x, square in zip(own, at, _squares(beside), strict=True)
        ]
        for radius, own, at, beside, total in zip(radii, pushes, here, rows, before, strict=True)
    ]


def _squares(rows: Array) -> Array:
    """(k,) of rows (k, 8, n) the sum of squares at the numbers."""
    return (rows[:, 0] ** 2).sum(axis=1)


def _change(rows: Array, damp: Array) -> Array:
    """The damped step (k, 7) from rows (k, 8, n) at the numbers and beside them."""
    slope = (rows[:, 1:] - rows[:, :1]) / SMALL[:, None]
    normal = slope @ slope.transpose(0, 2, 1)
    diagonal = np.einsum("kii->ki", normal)
    normal = normal + np.einsum("ki,ij->kij", damp[:, None] * diagonal + 1e-6, np.eye(len(NUMBERS)))
    change = -np.linalg.solve(normal, (slope @ rows[:, 0, :, None]))[..., 0]
    return np.clip(change, -AT_MOST, AT_MOST)


__all__ = ["MOST_S", "Radius", "events", "longer"]
