"""What takes most of a gap and leaves something over: an effect that is there, in another form than the library's.

Something left over is no proof that an effect is none of the library's: a real wall, swivel or roll has not the library's formula.
How much of the gap an effect takes tells the two cases apart: by half and less many an effect resembles something else, by nearly
all of it only itself. How sure that makes its name was found on campaigns of the blind check whose effects had other forms, or
were in no library (docs/blind.md).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import expit, softmax

from .held_out import size_aside, taken
from .noise import SMALLEST, Forces

if TYPE_CHECKING:
    from .evidence import Fitted, Inference
    from .ranking import Candidate, Ranking

QUIET = 0.1
"""Of the largest random forces that count as noise: those beside which a gap's size is judged, so that they do not swallow it."""
HALF_SURE, WIDTH = 0.70, 0.05
"""An effect that takes this share of a gap is as likely itself as something else, and how fast that goes over. Of campaigns of the
blind check whose truth was known (seeds 991 and 4001) what was in no library was taken to at most 0.62, what was in another form to
0.77 and more.
"""
UNSURE = 0.1
"""Share to which static records of some seconds tell the noise's variance: a choice."""
LEAST_FORM = 0.01
"""Effects whose own form leaves less than this over are in no other form: geometry is exact, and a course that was read off the
residual takes whatever there is. (A pair may be, if one of its effects may.)
"""
STILL_MOVING = 0.01
"""Of its log evidence: a fit whose next step promises more is not at its end, and what it takes of a gap is not known."""
LOOKED_AT = 3
"""Candidates that may be the one: the best single effects and the best pair. A choice, for time."""
WORTH = 0.01
"""Below this probability of something unknown nothing is shared out."""


def size_of(inference: Inference, fitted: Fitted, forces: Forces) -> float:
    """Mean square of the whitened residuals of all channels beside given random forces; 1: noise alone.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    forces : random forces
    """
    solved = inference.solve(fitted.grams, fitted.hypothesis, forces)
    total, count = 0.0, 0
    for index, run in enumerate(inference.simulator.runs):
        left = inference.left(fitted.linear, forces, solved.shared, solved.own[index], index)
        total, count = total + float(left @ left), count + int(np.isfinite(run.values).sum())
    return total / max(count, 1)


def could_gain(inference: Inference, fitted: Fitted) -> float:
    """Log evidence that the best of all explanations could still add to a fit: one that leaves noise alone, without random forces.

    The noise's variance is known to a share of itself only (UNSURE), and so is this.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    fitted : a hypothesis, fitted
    """
    there = fitted.solved
    quiet = inference.solve(fitted.grams, fitted.hypothesis, Forces(SMALLEST, SMALLEST, fitted.forces.time))
    count = sum(int(np.isfinite(run.values).sum()) for run in inference.simulator.runs)
    # of both only the squares differ from what stands beside them in the evidence
    log = 2 * (there.log_evidence - quiet.log_evidence) + there.chi_square - quiet.chi_square
    return max(0.5 * (there.chi_square - count - log), 0.0) + 0.5 * UNSURE * count


def told_apart(inference: Inference, first: Fitted, both: Fitted) -> float:
    """Log evidence for a second effect in the runs that the first one does not touch: nothing there is of that one's form.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    first, both : with the first effect alone, and with both

    Returns
    -------
    of those runs alone, the shared numbers fitted to them anew; 0 where the first touches all
    """
    fixed = 1 + inference.fixed(first.hypothesis)
    own = slice(fixed, fixed + first.hypothesis.size)
    apart = [k for k, table in enumerate(first.linear.columns.tables) if not table[:, :, own].any()]
    if not apart:
        return 0.0

    def of(fitted: Fitted, forces: Forces) -> float:
        solved = inference.solve(fitted.grams, fitted.hypothesis, forces, apart)
        return solved.log_evidence + inference.sized(fitted.hypothesis, solved)

    return max(of(both, both.forces) - max(of(first, f.forces) for f in (first, both)), 0.0)


def sureness(share: float, half_sure: float = HALF_SURE, width: float = WIDTH) -> float:
    """Probability that an effect which takes this share of a gap, and leaves something over, is the one that is there.

    Parameters
    ----------
    share : of ``share_of``
    half_sure, width : ``Simulator.half_sure``, ``Simulator.sure_width``
    """
    return float(1 / (1 + np.exp(-(share - half_sure) / width)))


def shared_out(inference: Inference, ranking: Ranking) -> Ranking:
    """The same, with the unknown's probability shared with what takes most of the gap.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    ranking : of ``engine``
    """
    if ranking.p_unknown < WORTH:
        return ranking
    orders = _looked_at(ranking.candidates)
    sure = {alike[0]: _sure_of(inference, ranking, ranking.candidates[alike[0]]) for alike in orders[0][1]}
    inexact, left = np.zeros(len(ranking.candidates)), ranking.p_unknown
    for likely, turns in orders:
        left = ranking.p_unknown  # of every order the same is left in the end
        for alike in turns:
            part = left * sure[alike[0]]
            inexact[alike] += likely * part * softmax([ranking.candidates[k].weight for k in alike])
            left -= part
    order = np.argsort(-(ranking.probabilities + inexact), kind="stable")
    return replace(
        ranking,
        candidates=tuple(ranking.candidates[k] for k in order),
        probabilities=ranking.probabilities[order],
        inexact=inexact[order],
        p_unknown=left,
    )


def _sure_of(inference: Inference, ranking: Ranking, candidate: Candidate) -> float:
    simulator = inference.simulator
    return sureness(share_of(inference, ranking, candidate), simulator.half_sure, simulator.sure_width)


def share_of(inference: Inference, ranking: Ranking, candidate: Candidate) -> float:
    """Share of the gap that a candidate takes, of what the best explanation takes: half by the gap's size beside quiet random
    forces, half by the log evidence (beside what stands out of what the best hypothesis leaves). Where the runs disagree, what is
    taken of each by its own numbers explains nothing: there it is the share that goes of runs kept aside.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    ranking : of ``engine``
    candidate : one of its
    """
    if candidate.log_evidence <= 0:
        return 0.0
    free = [c for c in (ranking.free, ranking.beside) if c is not None]
    best = max([*ranking.candidates, *free], key=lambda c: c.log_evidence)
    own, most = candidate.fitted.forces, QUIET * inference.simulator.most_force
    forces = Forces(min(own.side_n, most), min(own.moment_n_m, most), own.time)
    if ranking.rest.disagree and ranking.rest.log_evidence > 0:
        return taken(*(size_aside(inference, f, forces) for f in (ranking.base, candidate.fitted)))
    before, after, least = (size_of(inference, f, forces) for f in (ranking.base, candidate.fitted, best.fitted))
    whole = max(best.log_evidence, candidate.log_evidence + max(ranking.rest.log_evidence, 0.0))
    return 0.5 * (taken(before, after, min(least, 1.0)) + candidate.log_evidence / whole)


def _may_differ(candidate: Candidate) -> bool:
    """Whether a candidate may be in another form: of a pair one effect may be exact, as a height of a mark beside a tow point that
    slips; but what was read off the residual, and leaves something over, is not what is there.
    """
    forms = [e.form for e in candidate.effects]
    read_off = [e.form for e in candidate.effects if e.bound]
    return max(forms) >= LEAST_FORM and min(read_off, default=1.0) >= LEAST_FORM


def _looked_at(candidates: tuple[Candidate, ...]) -> list[tuple[float, list[list[int]]]]:
    """Orders in which candidates take their parts, with their probabilities; those that share a part stand together.

    A pair goes before the best single effect as far as it is likelier even after what the first one's form may have left over for
    another to take (``Candidate.second`` stands in its prior): then there are two. Pairs that do nearly the same share theirs.
    """
    formed = [
        k
        for k, c in enumerate(candidates)
        if _may_differ(c) and c.fitted.promised < STILL_MOVING * max(c.log_evidence, 0.0)
    ]
    order = sorted(formed, key=lambda k: -candidates[k].log_evidence)
    first, *others = [[k] for k in order if len(candidates[k].effects) == 1] or [[]]
    pairs = sorted((k for k in order if len(candidates[k].effects) > 1), key=lambda k: -candidates[k].weight)
    others = others[: LOOKED_AT - 2]
    if not first or not pairs:
        return [(1.0, [best for best in (first, pairs, *others) if best])]
    ahead = float(expit(candidates[pairs[0]].weight - candidates[first[0]].weight))
    return [(ahead, [pairs, first, *others]), (1 - ahead, [first, pairs, *others])]


__all__ = ["could_gain", "share_of", "shared_out", "size_of", "sureness", "told_apart"]
