"""The search for a missing law: the grammar's terms beside one another, by whole-path fits.

The diagnosis's engine decides (inference): every term is an effect with a price for what it takes to write it, alone or with a
second one, and competes with what the diagnosis's library explains, faults of camera, clock and line among it, with free forms,
and with noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np

from ...simulate.model import GRAVITY_M_S2, Array
from ..effects import Effect
from ..gap import Diagnosis
from ..inference.engine import extended
from ..inference.evidence import Fitted, Inference
from ..inference.hypothesis import Hypothesis
from ..inference.ranking import Candidate, Ranking
from ..tow.towed import TowSimulator
from .answer import Searched, answered
from .around import distinct, elsewhere, ended, fits, otherwise, simpler
from .choose import ARM, LawTable, Start, chosen, fields_of, free_path, priors
from .field import is_term
from .functions import Range, State, Term, dimensionless
from .grammar import grammar, heels, resistances
from .terms import AHEAD, APART, HEEL, effect_like, effect_of, height_of, roll_of, written_of

SIDE_SHARE = 0.1
"""Usual force of a missing term: this share of the line's pull; sizes down to a thirtieth are as likely (``Effect.sizes``)."""
AHEAD_SHARE = 0.3
"""Usual resistance beyond a straight tow's, by that: a choice."""
ROOM = 25.0
"""Of a law with less log evidence a second term explains too little to be told."""
HEEL_M = 0.01
"""Usual sway of a heeling model's marks; sizes down to a thirtieth are as likely (``Effect.sizes``)."""


def seen_by(simulator: TowSimulator) -> tuple[State, Range]:
    """The dimensionless state at every mean of the runs, by the measured motion; and its range.

    Parameters
    ----------
    simulator : of the runs
    """
    parts = []
    for run in simulator.runs:
        good = np.isfinite(run.values[:, :2]).all(axis=1)
        t_s, (y, beta) = run.centre_s[good], run.values[good, :2].T
        tow = run.data.tow
        alpha = np.arcsin(np.clip((y + tow.tow_point_m * np.sin(beta)) / tow.line_length_m, -1.0, 1.0))
        v, r = np.gradient(y, t_s) - tow.speed_m_s * beta, np.gradient(beta, t_s)
        turn, time = np.gradient(alpha, t_s) + r, t_s / max(float(t_s[-1]), 1e-9)
        own = (tow.speed_m_s, run.length_pp_m, run.half_width_m)
        state = dimensionless(
            *own, v, r, y, beta, turn_rad_s=turn, time=time, alpha_rad=alpha, tow_point_m=tow.tow_point_m
        )
        parts.append(replace(state, arm=state.arm + 0.0 * t_s))
    every = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(State)}
    states = State(**every)
    moved = {name: x for name, x in every.items() if not name.endswith("_late") and name != "arm"}
    seen = Range(
        {n: float(x.min()) for n, x in moved.items()},
        {n: float(x.max()) for n, x in moved.items()},
        {n: float(np.sqrt(np.mean(x**2))) for n, x in moved.items()},
        states,
    )
    return states, seen


def usual_size(simulator: TowSimulator) -> float:
    """Usual side force of a missing term by rho/2 U^2 L^2.

    Parameters
    ----------
    simulator : of the runs
    """
    first = simulator.runs[0]
    size = 0.5 * first.density_kg_m3 * simulator.speed_m_s**2 * first.length_pp_m**2
    return SIDE_SHARE * float(np.mean([run.data.tow.tension_n or 0.0 for run in simulator.runs])) / size


def law_effects(size: float, states: State, seen: Range, terms: Sequence[Term], acts: str = "Y and N") -> list[Effect]:
    """The grammar's terms as effects, each for a side force and a moment, or ahead.

    Parameters
    ----------
    size : a usual side force by rho/2 U^2 L^2; of a heel the marks' usual sway by U^2/g
    states, seen : of ``seen_by``
    terms : of the grammar
    acts : where: "Y and N" or one of APART
    """
    found = []
    for one in terms:
        height = height_of(one.text, acts, states)
        # a lag's term is as large as a part of the velocity
        height = height if height > 0 else 0.3 * seen.usual[one.variables[0]]
        sd = size / max(height, 1e-9)
        found.append(effect_of(one.text, acts, (sd, ARM * sd, AHEAD_SHARE / SIDE_SHARE * sd, sd), seen.ends))
    return found


def searched(
    found: Diagnosis,
    names: int,
    conclude: Callable[[Ranking], Diagnosis],
    say: Callable[[str], None] = lambda _: None,
    held: Sequence[int] | None = None,
) -> Searched:
    """Search for the law that diagnosed runs miss.

    Parameters
    ----------
    found : the diagnosis: its fit without effects, its noise and what its library explains are taken over
    names : how many effects compete in it
    conclude : a ranking -> what follows from it (``gap.concluded``)
    say : is told in a sentence what is done
    held : runs kept aside; None: each in turn
    """
    inference, base = found.inference, found.ranking.base
    simulator = inference.simulator
    assert isinstance(simulator, TowSimulator)
    states, seen = seen_by(simulator)
    say("a force without a form")
    size = usual_size(simulator)
    free = free_path(inference, base, seen, size)
    effects, free_forms = _offered(simulator, size, states, seen)
    say(f"{len(effects)} terms and their pairs")
    single, pair = priors(effects, names)
    fit = _Fits(inference, say)
    table = LawTable(inference, _nearest(base, free, found.ranking), base, effects, free_forms)
    reached = fit.all("fitting", chosen(table, single, pair))
    if table.promises < base.log_evidence:
        # what made that path gains little, and moved it by much to gain it: no term goes on from there
        other = LawTable(inference, base, base, effects, free_forms)
        if fit.all("fitting", fit.new(chosen(other, single, pair))) > reached:
            table = other
    if (best := fit.best_law) is not None and (roll := _roll_of(best.hypothesis)) is not None:
        # a table of heels holds for one roll: of the best
        heeling = [effect for effect in effects if effect.variant == HEEL]
        fit.all("rolling as the best", chosen(LawTable(inference, best, base, heeling, [], roll), single, pair))
    fit.all("at another place, with another power", elsewhere(inference, fit.starts, fit.fitted, seen))
    if (field := fit.ahead_of_laws) is not None:
        # a force without a form has the best path so far
        table = LawTable(inference, field, base, effects, free_forms)
        if fit.all("along the best path", fit.new(chosen(table, single, pair))) > -np.inf:
            fit.all("at another place, with another power", elsewhere(inference, fit.starts, fit.fitted, seen))
    if (best := fit.best_law) is not None and best.worth > base.log_evidence + ROOM:
        # along its own path a second term is seen that another path's errors hide
        own = [_in_both(e, n, seen) for e, n in zip(best.hypothesis.effects, best.hypothesis.numbers, strict=True)]
        beside = LawTable(inference, best, base, [*effects, *own], [], _roll_of(best.hypothesis))
        fit.all("beside the best law", fit.new(chosen(beside, single, pair)))
    fit.all("in other forms", otherwise(inference, fit.starts, fit.fitted, seen, single))
    fit.all("simpler", simpler(fit.starts, fit.fitted, single))
    fit.all("from where they ended", ended(fit.starts, fit.fitted, seen))
    forms = distinct([
        Candidate(s.effects, f, f.worth - base.log_evidence, s.log_prior)
        for s, f in zip(fit.starts, fit.fitted, strict=True)
    ])  # fmt: skip
    ranking = extended(inference, _shared(found.ranking, len(table.sets)), [one for one, _ in forms])
    return answered(conclude(ranking), forms, held, states, seen, table.goes_with())


def _offered(simulator: TowSimulator, size: float, states: State, seen: Range) -> tuple[list[Effect], list[Effect]]:
    """The terms and the forces without a form that are looked at.

    Parameters
    ----------
    simulator : of the runs
    size : a usual side force by rho/2 U^2 L^2
    states, seen : of ``seen_by``
    """
    effects = law_effects(size, states, seen, grammar(seen, bool(np.isfinite(simulator.runs[0].half_width_m))))
    ahead = 0.0
    if any(run.data.tow.line == "surge" for run in simulator.runs):
        effects += law_effects(size, states, seen, resistances(seen), AHEAD)
        ahead = AHEAD_SHARE / SIDE_SHARE * size
    sway = HEEL_M * GRAVITY_M_S2 / simulator.speed_m_s**2
    effects += law_effects(sway, states, seen, heels(seen), HEEL)
    return effects, fields_of(seen, size, ahead, sway)


def _shared(ranking: Ranking, fields: int) -> Ranking:
    """The ranking whose free force, where it has one, shares the prior of what is unknown with forces without a form: it is one.

    Parameters
    ----------
    ranking : of the diagnosis
    fields : how many forces without a form there are
    """
    free = ranking.free
    if free is None or not all(effect.force is not None and not effect.bound for effect in free.effects):
        return ranking
    return replace(ranking, free=replace(free, log_prior=free.log_prior - float(np.log(fields))))


class _Fits:
    """Laws and forces without a form that were fitted in full, in turn.

    Parameters
    ----------
    inference : of the diagnosis
    say : is told what is fitted
    """

    def __init__(self, inference: Inference, say: Callable[[str], None]) -> None:
        self._inference, self._say = inference, say
        self.starts: list[Start] = []
        self.fitted: list[Fitted] = []

    def new(self, starts: Sequence[Start]) -> list[Start]:
        """Those of which none of the same terms and numbers inside was fitted.

        Parameters
        ----------
        starts : where fits begin
        """
        done = {start.names for start in self.starts}
        return [start for start in starts if start.names not in done]

    def all(self, why: str, starts: Sequence[Start]) -> float:
        """Fit these, too; the most evidence and prior that one has.

        Parameters
        ----------
        why : in words
        starts : where fits begin
        """
        if not starts:
            return -np.inf
        self._say(f"{why}: " + "; ".join(start.text for start in starts))
        starts, ends = fits(self._inference, starts)
        self.starts += starts
        self.fitted += ends
        return max((f.worth + s.log_prior for s, f in zip(starts, ends, strict=True)), default=-np.inf)

    @property
    def ahead_of_laws(self) -> Fitted | None:
        """The force without a form that has more evidence and prior than every equation; None: an equation has more."""
        best = max(range(len(self.starts)), key=self._weight, default=None)
        if best is None or is_term(self.starts[best].effects[0]):
            return None
        return self.fitted[best]

    @property
    def best_law(self) -> Fitted | None:
        """The equation with the most evidence and prior; None: none was fitted."""
        laws = [k for k, s in enumerate(self.starts) if all(map(is_term, s.effects)) and _has_path(self.fitted[k])]
        return self.fitted[max(laws, key=self._weight)] if laws else None

    def _weight(self, which: int) -> float:
        return self.fitted[which].worth + self.starts[which].log_prior


def _nearest(base: Fitted, free: Fitted, ranking: Ranking) -> Fitted:
    """Whose path through the runs is nearest to the true one: of the fit with the most evidence.

    A force without a form follows marks that a rolling model moves, too; what the library explains better has the better path.
    """
    return max(
        (f for f in (base, free, *(c.fitted for c in ranking.candidates)) if _has_path(f)), key=lambda f: f.worth
    )


def _roll_of(h: Hypothesis) -> Array | None:
    """Period, damping and turning of the model where a law heels it; None: none does.

    Parameters
    ----------
    h : of a law
    """
    heels = (roll_of(e, n) for e, n in zip(h.effects, h.numbers, strict=True) if is_term(e) and e.variant == HEEL)
    return next(heels, None)


def _in_both(effect: Effect, numbers: Array, seen: Range) -> Effect:
    """A law's effect that begins where it was fitted; what acts in a side force or a moment, in both."""
    acts = effect.variant if effect.variant in APART else "Y and N"
    return effect_like(effect, written_of(effect, numbers), acts, seen)


def _has_path(fitted: Fitted) -> bool:
    """Whether a table can begin along its path: that of a lawful line, or of a lag, has other states."""
    return not fitted.hypothesis.lawful and not any(e.lag_s for e in fitted.hypothesis.effects)


__all__ = ["law_effects", "searched", "seen_by", "usual_size"]
