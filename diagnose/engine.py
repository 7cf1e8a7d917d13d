"""The diagnosis: which effect explains the gap, how sure, and what cannot be told apart (gap.md).

Base fit, screening of every effect by its score, full fits of the best, pairs on top of the best, free forms for what is in no
library; probabilities from evidence with half of the prior on no gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr

from ..geometry.checks.bundle import half_sine
from ..geometry.normal import inverse_of_normal
from ..record.errors import EstimationError
from ..simulate.model import Array
from .effects import Effect, slack
from .grams import Grams
from .hypothesis import Hypothesis, with_effects
from .inference import Fitted, Inference
from .noise import Forces, Noise
from .tow_data import TowRun
from .tow_model import TowModel
from .tow_start import base_hypothesis
from .unknown import free_forms

P_NO_GAP, P_SINGLE, P_PAIR, P_UNKNOWN = 0.5, 0.36, 0.07, 0.07
"""Prior shares."""
TRIED_SINGLE, TRIED_PAIR = 6, 3
BASE_STEPS, OPEN_STEPS, REFIT_STEPS, GROSS_STEPS = 8, 3, 3, 5
WORTH_PAIRS = 3.0
"""Log evidence a second effect must promise by its score."""
WORTH_PAIRS_BELOW = 30.0
"""Pairs are tried on the second best effect only if it comes this near to the best."""
TWINS = 3.0
"""Effects within this log evidence of the best are not told from it."""
CLEAR = 3.0
"""The headline must beat no gap by this."""
LARGEST_FORCE_SHARE = 0.05
"""Of the line's pull: random forces above this are a gap, not noise."""
SLACK_Z = 8.0
LEAST_BLOCKS = 10
SMALLEST_SD = 0.003
"""Of a reference derivative, relative: no simulator is surer of itself."""
SLACK_LENGTHS_S = (1.0, 2.0, 3.0, 4.5, 7.0)
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Candidate:
    """One or two effects, fitted.

    Attributes
    ----------
    effects : of the library (or a free form)
    fitted : the optimum
    log_evidence : over the base's
    log_prior : share of the prior
    """

    effects: tuple[Effect, ...]
    fitted: Fitted
    log_evidence: float
    log_prior: float

    @property
    def names(self) -> tuple[str, ...]:
        """Effect names, without variants."""
        return tuple(e.name for e in self.effects)


@dataclass(frozen=True)
class Ranking:
    """All hypotheses with probabilities.

    Attributes
    ----------
    base : no effect
    candidates : best first, one per set of names
    probabilities : of the candidates
    p_no_gap, p_unknown : of the rest
    free : the best free form, or None
    excluded : effect -> why it could not be judged
    """

    base: Fitted
    candidates: tuple[Candidate, ...]
    probabilities: Array
    p_no_gap: float
    p_unknown: float
    free: Candidate | None
    excluded: dict[str, str]

    @property
    def set95(self) -> list[tuple[str, ...]]:
        """The fewest hypotheses that hold 95 % of the probability; () is no gap, ("unknown",) unknown."""
        every = [((), self.p_no_gap), (("unknown",), self.p_unknown)]
        every += [(c.names, float(p)) for c, p in zip(self.candidates, self.probabilities, strict=True)]
        every.sort(key=lambda pair: -pair[1])
        total, kept = 0.0, []
        for names, p in every:
            kept.append(names)
            total += p
            if total >= 0.95:
                break
        return kept


def ranked(
    runs: Sequence[TowRun],
    library: Sequence[Effect],
    progress: Progress | None = None,
    reference: tuple[Array, Array, float] | None = None,
) -> tuple[Inference, Ranking]:
    """Rank every effect and pair.

    Parameters
    ----------
    runs : with one block length
    library : effects to try
    reference : the simulator's own six derivatives, their standard deviations and the speed they are quoted at, judged as they
        are; None: fitted to these runs

    Raises
    ------
    EstimationError : the base cannot be fitted
    """
    say = progress or (lambda _: None)
    speed = float(np.mean([r.data.tow.speed_m_s for r in runs]))
    say("the simulator as it is")
    start = base_hypothesis(runs, speed)
    inference = Inference(TowModel(runs, speed))
    if reference is not None:
        six, sd, quoted = reference
        ratio = np.where(np.arange(6) < 2, 1.0, speed / quoted)
        inference.six_prior = (six * ratio, np.maximum(sd * ratio, SMALLEST_SD * np.abs(six * ratio)))
    base = _first_fit(inference, start)
    inference.noise = Noise(runs, base.hypothesis, speed)
    base = inference.fit([base.hypothesis], [base.forces], 2, (0,))[0]
    usable, excluded = _usable(runs, library)
    usable = [*usable, *_slack_effects(inference, base)]
    say(f"{len(usable)} effects by their scores")
    names = {e.name for e in usable}
    free = list(free_forms())
    scores = screened(inference, base, [*usable, *free])
    singles = _best_variants(scores, usable, TRIED_SINGLE)
    best_free = _best_variants(scores, free, 2)
    say("fitting " + ", ".join(e.name for e in singles))
    gross = max(scores.values(), default=0.0) > 200.0
    fitted = _fit_all(inference, base, [(e,) for e in (*singles, *best_free)], gross)
    single_prior = np.log(P_SINGLE / max(len(names), 1))
    candidates = [
        Candidate(effects, f, f.log_evidence - base.log_evidence, single_prior)
        for effects, f in fitted
        if effects[0] not in free
    ]
    free_found = [
        Candidate(effects, f, f.log_evidence - base.log_evidence, np.log(P_UNKNOWN))
        for effects, f in fitted
        if effects[0] in free
    ]
    candidates.sort(key=lambda c: -c.log_evidence)
    candidates = _settled(inference, candidates, base)
    candidates += _pairs(inference, candidates, base, usable, len(names), say, gross)
    most = LARGEST_FORCE_SHARE * float(np.mean([run.data.tow.tension_n or 1.0 for run in runs]))
    free_form = max(free_found, key=lambda c: c.log_evidence, default=None)
    return inference, _ranking(base, candidates, free_form, excluded, most)


def _first_fit(inference: Inference, start: Hypothesis) -> Fitted:
    """From the measured motion, at first without asking that it is one motion."""
    try:
        return inference.fit([start], [Forces()], BASE_STEPS, (OPEN_STEPS,), OPEN_STEPS)[0]
    except EstimationError:
        raise EstimationError(
            "the simulator without effects cannot follow these runs at all: its motion grows beyond bounds; is the tow stable "
            "(X_T > X_v), and are tow_point_m and tension_n right?"
        ) from None


def _settled(inference: Inference, candidates: list[Candidate], base: Fitted) -> list[Candidate]:
    """The best few taken on until they stand: what is compared with a pair must have come as far as the pair will."""
    few = [c for c in candidates[:3] if c.log_evidence > max(CLEAR, candidates[0].log_evidence - WORTH_PAIRS_BELOW)]
    if not few:
        return candidates
    again = inference.fit([c.fitted.hypothesis for c in few], [c.fitted.forces for c in few], REFIT_STEPS, ())
    better = [
        replace(c, fitted=f, log_evidence=f.log_evidence - base.log_evidence) for c, f in zip(few, again, strict=True)
    ]
    better = [b if b.log_evidence > c.log_evidence else c for b, c in zip(better, few, strict=True)]
    rest = [c for c in candidates if c not in few]
    return sorted((*better, *rest), key=lambda c: -c.log_evidence)


def screened(
    inference: Inference, base: Fitted, effects: Sequence[Effect], shares: Sequence[float] = (1.0, 0.2)
) -> dict[str, float]:
    """Log evidence of every effect by one step from ``base``, the best over these shares of its random forces; by label.

    The base's random forces have taken up part of what an effect does: seen with smaller ones it stands out.
    """
    here = base.hypothesis
    linear = inference.linear([with_effects(here, list(effects))])[0]
    grams = Grams(linear.columns, inference.noise_about(linear))
    fixed = 6 + inference.mode_count + here.size
    answers: dict[str, float] = {}
    for share in shares:
        forces = replace(base.forces, side_n=share * base.forces.side_n, moment_n_m=share * base.forces.moment_n_m)
        part = inference.reduced(grams, linear.hypothesis, forces)
        precision, gap, _ = inference.priors(linear.hypothesis)
        matrix, right = part.matrix + np.diag(np.where(np.arange(len(precision)) < fixed, precision, 0)), part.right
        right = right + np.where(np.arange(len(precision)) < fixed, precision * gap, 0)
        inverse = inverse_of_normal(matrix[:fixed, :fixed])
        at = fixed
        for effect in effects:
            own = slice(at, at + len(effect.parameters))
            at = own.stop
            cross = matrix[own, :fixed] @ inverse
            left = matrix[own, own] - cross @ matrix[:fixed, own]
            pull = right[own] - cross @ right[:fixed]
            sd = np.array([p.sd for p in effect.parameters])
            scaled = np.eye(len(sd)) + sd[:, None] * left * sd[None, :]
            gain = float((sd * pull) @ np.linalg.solve(scaled, sd * pull))
            value = 0.5 * gain - 0.5 * np.linalg.slogdet(scaled)[1]
            spread = np.linalg.inv(scaled)
            for k, parameter in enumerate(effect.parameters):
                if parameter.one_sided:
                    z = float(spread[k] @ (sd * pull)) / np.sqrt(spread[k, k])
                    value += np.log(2) + float(log_ndtr(z))
            answers[effect.label] = max(answers.get(effect.label, -np.inf), float(value))
    return answers


def _usable(runs: Sequence[TowRun], library: Sequence[Effect]) -> tuple[list[Effect], dict[str, str]]:
    usable, excluded = [], {}
    for effect in library:
        if any(run.marks is None for run in runs) and effect.correct is not None and effect.name != "datum_bias":
            excluded[effect.name] = "a motion holds no pixels"
            continue
        why = next((w for run in runs if run.marks is not None and (w := effect.needs(run.marks.run))), "")
        if why:
            excluded[effect.name] = why
        else:
            usable.append(effect)
    return usable, excluded


def _best_variants(scores: dict[str, float], effects: Sequence[Effect], count: int) -> list[Effect]:
    """The best variant of each name, the best ``count`` names."""
    best: dict[str, Effect] = {}
    for effect in effects:
        old = best.get(effect.name)
        if old is None or scores[effect.label] > scores[old.label]:
            best[effect.name] = effect
    return sorted(best.values(), key=lambda e: -scores[e.label])[:count]


def _slack_effects(inference: Inference, base: Fitted) -> list[Effect]:
    """The most likely slack windows, from the taut line's residual alone: in the run that shows most, and in all that show any."""
    windows: list[tuple[float, float] | None] = []
    sure: list[float] = []
    for index, run in enumerate(inference.model.runs):
        radius = base.linear.rows[index][0][:, 2]
        good = np.isfinite(radius)
        best = (0.0, 0.0, 0.0)
        if good.sum() >= LEAST_BLOCKS:
            sd = np.sqrt(np.median(np.diag(run.covariance[2])))
            best = _slackest(run.centre_s, np.where(good, radius - np.nanmedian(radius), 0.0) / sd)
        sure.append(best[0])
        windows.append((best[1], best[2]) if best[0] > SLACK_Z else None)
    if not any(windows):
        return []
    most = int(np.argmax(sure))
    alone = slack([w if i == most else None for i, w in enumerate(windows)])
    return [alone] if sum(w is not None for w in windows) == 1 else [alone, slack(windows)]


def _slackest(t_s: Array, rest: Array) -> tuple[float, float, float]:
    """Significance, begin and end of the half sine by which ``rest`` falls short most."""

    def short(begin: float, length: float) -> float:
        shape = half_sine(t_s, begin, begin + max(length, 1e-3))
        size = np.linalg.norm(shape)
        return float(-(shape @ rest) / size) if size > 0 else 0.0

    grid = [(short(b, n), b, n) for n in SLACK_LENGTHS_S for b in np.arange(t_s[0], t_s[-1] - n, n / 5)]
    z, begin, length = max(grid, default=(0.0, 0.0, 1.0))
    if z > SLACK_Z:
        finer = minimize(
            lambda x: -short(x[0], x[1]), [begin, length], method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02}
        )
        z, (begin, length) = -float(finer.fun), finer.x
    return z, float(begin), float(begin + length)


def _fit_all(
    inference: Inference, base: Fitted, sets: Sequence[tuple[Effect, ...]], gross: bool
) -> list[tuple[tuple[Effect, ...], Fitted]]:
    hypotheses = [with_effects(base.hypothesis, list(effects)) for effects in sets]
    steps = GROSS_STEPS if gross else REFIT_STEPS
    found = inference.fit(hypotheses, [base.forces] * len(sets), steps, (1,))
    return list(zip(sets, found, strict=True))


def _pairs(
    inference: Inference,
    singles: Sequence[Candidate],
    base: Fitted,
    usable: Sequence[Effect],
    names: int,
    say: Progress,
    gross: bool,
) -> list[Candidate]:
    """A second effect on top of the best single ones, where its score promises something."""
    found: list[Candidate] = []
    prior = np.log(P_PAIR / max(names * (names - 1) / 2, 1))
    done: set[frozenset[str]] = set()
    for first in singles[:2]:
        if first.log_evidence < max(CLEAR, singles[0].log_evidence - WORTH_PAIRS_BELOW):
            continue
        rest = [e for e in usable if e.name not in first.names]
        scores = screened(inference, first.fitted, rest, (1.0,))
        second = [e for e in _best_variants(scores, rest, TRIED_PAIR) if scores[e.label] > WORTH_PAIRS]
        second = [e for e in second if frozenset((*first.names, e.name)) not in done]
        if not second:
            continue
        done |= {frozenset((*first.names, e.name)) for e in second}
        say(f"{first.names[0]} with " + ", ".join(e.name for e in second))
        for (effect,), fitted in _fit_all(inference, first.fitted, [(e,) for e in second], gross):
            pair = (*first.effects, effect)
            found.append(Candidate(pair, fitted, fitted.log_evidence - base.log_evidence, prior))
    return found


def _ranking(
    base: Fitted, candidates: Sequence[Candidate], free: Candidate | None, excluded: dict[str, str], most_n: float
) -> Ranking:
    """Probabilities; what leaves random forces above ``most_n`` explains nothing: its share is the unknown's."""
    best: dict[frozenset[str], Candidate] = {}
    for c in candidates:
        key = frozenset(c.names)
        if key not in best or c.log_evidence > best[key].log_evidence:
            best[key] = c
    kept = sorted(best.values(), key=lambda c: -(c.log_evidence + c.log_prior))
    logs = [np.log(P_NO_GAP), np.log(P_UNKNOWN) + (free.log_evidence if free is not None else -np.inf)]
    logs += [c.log_evidence + c.log_prior for c in kept]
    logs = np.array(logs)
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    explains = np.array([f.forces.side_n <= most_n for f in (base, *(c.fitted for c in kept))])
    explains = np.concatenate([explains[:1], [False], explains[1:]])
    unknown = float(shares[~explains].sum())
    shares = np.where(explains, shares, 0.0)
    order = np.lexsort((-logs[2:], -shares[2:]))
    return Ranking(
        base,
        tuple(kept[i] for i in order),
        shares[2:][order],
        float(shares[0]),
        unknown,
        free,
        excluded,
    )


__all__ = ["Candidate", "Ranking", "ranked", "screened"]
