"""Fits that begin at the motion as it was measured: opened first, without asking that it is one motion, and then closed.

A base that cannot follow its runs has numbers that make up for what is missing: no step from there leads anywhere. The measured
motion asks for none. Several starts mostly lead to one place: what aims at the same is closed once, the best first, and what stays
far behind that is not closed at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from ..effects import Effect
from .diagnosable import Diagnosable
from .evidence import Fitted, Inference
from .hypothesis import Hypothesis, with_effects
from .noise import Forces
from .simulator import Simulator
from .spread import Spread

STEPS, OPEN_STEPS = 8, 3
"""Gauss-Newton steps, and those of them in which paths may stay open."""
FAR_BEHIND = 1000.0
"""A fit that is this far behind the best when its path shall be closed is not gone on with: the right ones stand within 500 of
their end there, the others' motion mostly runs away, which takes long to integrate."""
SAME_SD = 0.3
"""Fits whose next steps lead to numbers that differ by less than so many of their standard deviations have one end. Of 63 pairs of
fits of one effect in two sealed campaigns (seed 271135) 57 were as near, and ended within 0.5 in log evidence of one another; two
1.1 apart in an earlier campaign ended 91 apart.
"""
CLOSED_FIRST = 2
"""So many of the best are closed before all others: what they reach says which others can matter."""


@dataclass(frozen=True)
class End:
    """Where a fit has ended.

    Attributes
    ----------
    log_evidence : of where it stands, not of where its next step points to: an end that is still on its way is none
    hypothesis, forces : there
    """

    log_evidence: float
    hypothesis: Hypothesis
    forces: Forces


def first_fit(simulator: Simulator, spread: Spread) -> End:
    """The best end of all starts; of the first alone, where that follows the runs.

    Parameters
    ----------
    simulator : with its runs
    spread : does what is independent

    Raises
    ------
    EstimationError : no motion of the simulator's follows these runs
    """
    first, *others = simulator.starts()
    begun = [f for f in [_opened_alone(simulator, first)] if f is not None]
    found = [end for end in (_closed_alone(simulator, f) for f in begun) if end is not None]
    if not found or not found[0].forces.follow(simulator.most_force):
        more = [f for f in spread(partial(_opened_alone, simulator), others) if f is not None]
        apart = _unlike_all(Inference(simulator, None), more, begun)
        found += [end for end in spread(partial(_closed_alone, simulator), apart) if end is not None]
    if not found:
        raise EstimationError(
            "the simulator without effects cannot follow these runs at all: its motion grows beyond bounds; for a tow: is it "
            "stable (X_T > X_v), and are tow_point_m and tension_n right?"
        )
    return max(found, key=lambda end: end.log_evidence)


def ends_unlike(simulator: Diagnosable, base: Fitted, spread: Spread, best_yet: Effect | None = None) -> list[End]:
    """The best end of every effect that no step from the base leads to, the best first.

    Parameters
    ----------
    simulator : with its runs
    base : the fit without effects
    spread : does what is independent
    best_yet : the best effect that was found, which may ask for them; None: the base alone does
    """
    opened = [f for f in spread(partial(_opened_alone, simulator), simulator.unlike(base, best_yet)) if f is not None]
    best = max([base.log_evidence, *(f.log_evidence for f in opened)])
    going = [f.log_evidence > best - FAR_BEHIND for f in opened]
    found = [_end_of(f) for f, on in zip(opened, going, strict=True) if not on]
    closed = spread(partial(_closed_alone, simulator), [f for f, on in zip(opened, going, strict=True) if on])
    found += [end for end in closed if end is not None]
    of_each: dict[str, End] = {}
    for end in sorted(found, key=lambda end: -end.log_evidence):
        of_each.setdefault(end.hypothesis.effects[0].label, end)
    return list(of_each.values())


def ends_from(
    inference: Inference, starts: Sequence[Hypothesis], sets: Sequence[tuple[Effect, ...]], ahead: float
) -> list[Fitted | None]:
    """The best end of each of ``sets`` of effects from all ``starts``; None where none comes near to the best.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    starts : hypotheses without effects, along the measured motion
    sets : effects to begin with
    ahead : log evidence of the best that is known
    """
    answers: list[Fitted | None] = [None] * len(sets)
    known = [inference.noise, *(e for effects in sets for e in effects)]
    # each start by one process: its own fits go one after the other
    alone = Inference(inference.simulator, inference.noise)
    opened = inference.spread(
        lambda start: _opened(alone, [with_effects(start, list(effects)) for effects in sets]), starts, known
    )
    pool: list[tuple[int, Fitted]] = []
    for k in range(len(sets)):
        of_set = sorted((f for found in opened if (f := found[k]) is not None), key=lambda f: -f.log_evidence)
        pool += [(k, f) for f in _unlike_all(inference, of_set)]
    pool.sort(key=lambda one: -one[1].log_evidence)
    for batch in (pool[:CLOSED_FIRST], pool[CLOSED_FIRST:]):
        going = [(k, f) for k, f in batch if f.log_evidence > max(ahead, pool[0][1].log_evidence) - FAR_BEHIND]
        for (k, _), end in zip(going, _closed(inference, [f for _, f in going]), strict=True):
            old = answers[k]
            if end is not None and (old is None or end.worth > old.worth):
                answers[k] = end
                ahead = max(ahead, end.log_evidence)
    return answers


def _unlike_all(inference: Inference, found: Sequence[Fitted], known: Sequence[Fitted] = ()) -> list[Fitted]:
    """Those that aim at other numbers than the ``known`` and those before them."""
    aims, kept = [_aim(inference, f) for f in known], list[Fitted]()
    for one in found:
        numbers, sd = _aim(inference, one)
        if all(not _alike(numbers - other, np.minimum(sd, own)) for other, own in aims):
            aims.append((numbers, sd))
            kept.append(one)
    return kept


def _alike(apart: Array, sd: Array) -> bool:
    return bool((np.abs(apart) < SAME_SD * sd).all())


def _aim(inference: Inference, fitted: Fitted) -> tuple[Array, Array]:
    """Shared and effects' numbers after the next step, and their standard deviations."""
    h, solved = fitted.hypothesis, fitted.solved
    first, fixed = len(h.shared), inference.fixed(h)
    at = np.r_[:first, fixed : len(solved.shared)]
    numbers = np.concatenate([h.shared, *h.numbers]) + solved.shared[at]
    return numbers, np.sqrt(np.maximum(np.diag(solved.covariance)[at], 0.0))


def _opened_alone(simulator: Simulator, start: Hypothesis) -> Fitted | None:
    """The first steps by noise about this very motion; None: it gets nowhere."""
    return _opened(Inference(simulator, None), [start])[0]


def _closed_alone(simulator: Simulator, opened: Fitted) -> End | None:
    """Where it ends by noise about this very motion."""
    end = _closed(Inference(simulator, None), [opened])[0]
    return None if end is None else _end_of(end)


def _opened(inference: Inference, starts: Sequence[Hypothesis]) -> list[Fitted | None]:
    """The first steps, in which paths stay open; None for what gets nowhere."""
    try:
        return list(inference.fit(starts, [Forces()] * len(starts), OPEN_STEPS - 1, None, OPEN_STEPS))
    except (EstimationError, np.linalg.LinAlgError):
        return [None] if len(starts) == 1 else [_opened(inference, [one])[0] for one in starts]


def _closed(inference: Inference, opened: Sequence[Fitted]) -> list[Fitted | None]:
    """The rest of the steps; None for what gets nowhere."""
    hypotheses, forces = [f.hypothesis for f in opened], [f.forces for f in opened]
    try:
        return list(inference.fit(hypotheses, forces, STEPS - OPEN_STEPS + 1, (1,), 0, opened))
    except (EstimationError, np.linalg.LinAlgError):
        return [None] if len(opened) == 1 else [_closed(inference, [one])[0] for one in opened]


def _end_of(found: Fitted) -> End:
    return End(found.log_evidence - found.promised, found.hypothesis, found.forces)


__all__ = ["FAR_BEHIND", "End", "ends_from", "ends_unlike", "first_fit"]
