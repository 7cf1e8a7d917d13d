"""A hypothesis against the data: Gauss-Newton with the noise estimated beside it, and its evidence.

Numbers shared by all runs (derivatives, camera modes, effects) and each run's own are fitted together; the own ones are eliminated
run by run. Evidence is Laplace's approximation with the restricted likelihood of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr

from ...geometry.normal import inverse_of_normal
from ...record.errors import EstimationError
from ...simulate.model import Array
from .grams import Columns, Grams, Reduced, reduced
from .hypothesis import Hypothesis, Slopes
from .members import mixed, over_widest, shares_of
from .noise import SMALLEST, TIMES_S, Forces, Noise
from .shooting import MOST_CLOSINGS
from .simulator import Simulator
from .spread import Spread, one_by_one

LARGEST_SHARE = 0.4
"""No shared number changes by more than this share of itself in a step."""
SHORTER = 0.3
"""A step that does not improve is tried again at this share of its length."""
FORCE_TRIALS = 16
"""Evaluations of the search for the random forces' sizes, for each of their times: a choice, for time."""
WIDE, NARROW = 0.7, 0.1
"""Its first steps, in logarithms of the sizes: of a search, and of one about what was found already."""
SMALLER_TRIED, LEAST_TRIED = (1.0, 0.25, 0.06, 0.015), 3e-4
"""Where that search may begin: at these shares of the forces given, those below the second number (N or N m) left out."""
UNSOLVED = 1e12
"""What random forces cost beside which the normal equations have no solution, or one whose squares sum to less than nothing."""
ALL_TIMES = tuple(range(len(TIMES_S)))
GROUPS = 2
"""Hypotheses are fitted in so many groups, which may run at the same time."""
NEAR = 25.0
"""At the end the noise is estimated once more for hypotheses whose log evidence is within this of the best."""
SETTLED = 0.02
"""A fit whose next step promises less log evidence is at its end, and not stepped any more: its numbers are within a fifth of their
standard deviations of where the step leads, and what it reports has that step in it already."""
CONVERGED_GAIN = 3.0
"""A fit counts as converged when a refinement raises its log evidence, or a step promises to raise it, by less than this."""
STEEP = 1e60
"""A slope beyond this belongs to a motion that grows beyond bounds."""
LARGEST_SD = 3.0
"""No effect's number changes by more prior standard deviations in a step."""
LEAST_VARIANCE = 1e-12
"""Smallest posterior variance of an effect's number, in units of its prior's; anything below is rounding of the inversion."""


@dataclass(frozen=True)
class Linear:
    """A hypothesis with residuals and slopes.

    Attributes
    ----------
    slopes : of the simulation
    columns : residual, slopes by shared numbers (derivatives, camera modes, effects), slopes by own ones
    """

    hypothesis: Hypothesis
    slopes: Slopes
    columns: Columns

    @property
    def rows(self) -> list[tuple[Array, Array]]:
        """Per run: residual (n, c), slopes (n, c, shared + own + p)."""
        return self.slopes.rows

    def left(self, run: int, shared: Array, own: Array) -> Array:
        """(n, c) residual of a run after a step of shared and own numbers."""
        table = self.columns.tables[run]
        return table[:, :, 0] - table[:, :, 1:] @ np.concatenate([shared, own])


@dataclass(frozen=True)
class Solved:
    """The linear problem solved at one noise.

    Attributes
    ----------
    log_evidence : up to a constant of the data
    here : the same without the step: what the hypothesis as it stands reaches
    chi_square : whitened residuals after the step, and the priors
    shared : (s + k + p,) step of shared numbers, modes, effects; one-sided numbers end on their side of it
    own : (runs, own) step
    covariance : of ``shared``
    reduced : the normal equations, for own steps beside other shared ones
    free : the step that nothing holds to a side; None: the same
    beyond : log evidence (as of ``log_evidence``) that only a step to the wrong side would bring
    """

    log_evidence: float
    here: float
    chi_square: float
    shared: Array
    own: Array
    covariance: Array
    reduced: Reduced
    free: Array | None = None
    beyond: float = 0.0


@dataclass(frozen=True)
class Fitted:
    """A hypothesis at its optimum.

    Attributes
    ----------
    hypothesis, forces : the optimum
    log_evidence : with the noise's prior and one-sided ones
    solved : the last linear problem
    linear : the linearisation behind it
    grams : its inner products
    estimated : whether the forces' sizes are those of this very linear problem
    """

    hypothesis: Hypothesis
    forces: Forces
    log_evidence: float
    solved: Solved
    linear: Linear
    grams: Grams
    estimated: bool = False

    @property
    def promised(self) -> float:
        """Log evidence that one more step promises: next to nothing at an optimum."""
        return self.solved.log_evidence - self.solved.beyond - self.solved.here

    @property
    def worth(self) -> float:
        """Its log evidence, without what a step promises that is not taken yet; -inf where it is no number."""
        worth = self.log_evidence - max(self.promised - CONVERGED_GAIN, 0.0)
        return worth if np.isfinite(worth) else -np.inf


@dataclass(frozen=True)
class Priors:
    """What is known of the shared numbers, modes and effects beside the runs, at a hypothesis.

    Attributes
    ----------
    precision : (n,) inverse variances
    pull : (n,) minus half the slope of ``chi_square``
    chi_square : squared distances from what is known
    spread : log of the effects' prior variances
    """

    precision: Array
    pull: Array
    chi_square: float
    spread: float


def _settled(fitted: Fitted) -> bool:
    return abs(fitted.promised) < SETTLED


class Inference:
    """Fits hypotheses to one campaign.

    Parameters
    ----------
    simulator : of all runs
    noise : of the measurement, and of random forces about a motion near these; None: anew about every motion that is tried
    spread : does what is independent

    Attributes
    ----------
    mode_count : of camera modes, over all runs
    """

    def __init__(self, simulator: Simulator, noise: Noise | None, spread: Spread = one_by_one) -> None:
        self.spread = spread
        self.simulator, self._noise = simulator, noise
        self.own_sd, self.stated = simulator.own_sd, simulator.stated
        self.own_count = simulator.own_sd.shape[1]
        self.mode_count = simulator.modes[0].shape[2]

    @property
    def noise(self) -> Noise:
        """Of all hypotheses."""
        assert self._noise is not None
        return self._noise

    def linear(self, hypotheses: Sequence[Hypothesis], closings: int = MOST_CLOSINGS) -> list[Linear]:
        """Linearise hypotheses, all together; ``closings`` 0: about paths that may be open."""
        found = self.simulator.linear(hypotheses, closings)
        return [Linear(h, slopes, self._columns(h, slopes)) for h, slopes in zip(hypotheses, found, strict=True)]

    def _columns(self, h: Hypothesis, slopes: Slopes) -> Columns:
        tables, first = [], len(h.shared)
        last = first + self.own_count
        for (residual, slope), modes in zip(slopes.rows, self.simulator.modes, strict=True):
            parts = [residual[..., None], slope[:, :, :first], modes, slope[:, :, last:], slope[:, :, first:last]]
            tables.append(np.concatenate(parts, axis=2))
        return Columns(tables, self.fixed(h) + h.size)

    def fixed(self, h: Hypothesis) -> int:
        """Shared numbers and modes: what stands before the effects' numbers."""
        return len(h.shared) + self.mode_count

    def reduced(self, grams: Grams, h: Hypothesis, forces: Forces, only: Sequence[int] | None = None) -> Reduced:
        """Normal equations of the shared numbers, the runs' own eliminated; ``only``: these runs."""
        modes = slice(len(h.shared), self.fixed(h))
        return reduced(grams, forces, self.stated - h.own, self.own_sd, only, modes)

    def priors(self, h: Hypothesis) -> Priors:
        """Of shared numbers, modes and effects, and what was measured of effects apart from the runs."""
        sd = np.array([q.sd for e in h.effects for q in e.parameters])
        none = np.array([q.none for e in h.effects for q in e.parameters])
        here = np.concatenate(h.numbers) if h.numbers else np.zeros(0)
        k = self.mode_count
        prior = self.simulator.shared_prior
        mean, known = (h.shared, np.zeros(len(h.shared))) if prior is None else (prior[0], prior[1] ** -2.0)
        precision = np.concatenate([known, np.ones(k), 1 / sd**2])
        gap = np.concatenate([mean - h.shared, np.zeros(k), none - here])
        pull, chi_square = precision * gap, float(precision @ gap**2)
        found = [f"{e.name}.{q.name}" for e in h.effects for q in e.parameters]
        for name, told in self.simulator.apart.items():
            own = np.flatnonzero([one == name for one in found])
            off = told.value - (here[own] if len(own) else np.array([told.none]))
            precision[self.fixed(h) + own] += told.sd**-2.0
            if len(own):
                pull[self.fixed(h) + own] += off / told.sd**2
            chi_square += float((off**2).sum()) / told.sd**2
        return Priors(precision, pull, chi_square, 2 * float(np.log(sd).sum()))

    def solve(self, grams: Grams, h: Hypothesis, forces: Forces, only: Sequence[int] | None = None) -> Solved:
        """One Gauss-Newton step with its evidence."""
        part = self.reduced(grams, h, forces, only)
        prior = self.priors(h)
        matrix, right = part.matrix + np.diag(prior.precision), part.right + prior.pull
        covariance = inverse_of_normal(matrix)
        step = covariance @ right
        chi_square = part.chi_square + prior.chi_square - float(right @ step)
        log = part.log + prior.spread + np.linalg.slogdet(matrix)[1]
        here = -0.5 * (part.before + prior.chi_square + log)
        sided, beyond = self._on_their_side(h, step, covariance)
        return Solved(
            -0.5 * (chi_square + log), here, chi_square, sided, part.own_step(sided), covariance, part, step, beyond
        )

    def _on_their_side(self, h: Hypothesis, step: Array, covariance: Array) -> tuple[Array, float]:
        """The best step that leaves every one-sided number on its side, and half the chi-square that this costs."""
        return within(step, covariance, self._least(h, len(step)), self._most(h, len(step)))

    def _least(self, h: Hypothesis, size: int) -> Array:
        """(size,) the smallest steps that leave one-sided numbers on their side."""
        least, effects = np.full(size, -np.inf), [q for e in h.effects for q in e.parameters]
        if self.simulator.shared_bounds is not None:
            least[: len(h.shared)] = np.minimum(self.simulator.shared_bounds[0] - h.shared, 0.0)
        sided = np.flatnonzero([q.one_sided for q in effects])
        if len(sided):
            least[self.fixed(h) + sided] = (np.array([q.none for q in effects]) - np.concatenate(h.numbers))[sided]
        return least

    def _most(self, h: Hypothesis, size: int) -> Array:
        """(size,) the largest steps that leave shared numbers below their upper bounds."""
        most = np.full(size, np.inf)
        if self.simulator.shared_bounds is not None:
            most[: len(h.shared)] = np.maximum(self.simulator.shared_bounds[1] - h.shared, 0.0)
        return most

    def bounded(self, h: Hypothesis, solved: Solved) -> float:
        """What bounds of the shared numbers take off the log evidence: log of the probability that each, alone, is between."""
        if self.simulator.shared_bounds is None:
            return 0.0
        count = len(h.shared)
        free = h.shared + (solved.shared if solved.free is None else solved.free)[:count]
        sd = np.sqrt(np.maximum(np.diag(solved.covariance)[:count], 0.0))
        least, most = self.simulator.shared_bounds
        return float((log_ndtr((free - least) / sd) + log_ndtr((most - free) / sd)).sum())

    def sized(self, h: Hypothesis, solved: Solved) -> float:
        """What the effects' priors add to the log evidence beside one normal distribution each: an effect may be of any of its
        sizes and members, and some numbers are on one side only.
        """
        if not h.size:
            return 0.0
        own = slice(self.fixed(h), self.fixed(h) + h.size)
        parameters = [p for e in h.effects for p in e.parameters]
        sd = np.array([p.sd for p in parameters])
        sided = np.flatnonzero([p.one_sided for p in parameters])
        mean = np.concatenate(h.numbers) - [p.none for p in parameters]
        mean = mean + (solved.shared if solved.free is None else solved.free)[own]
        # in units of the widest prior: a variance is above zero, at most one
        variance, vectors = np.linalg.eigh(solved.covariance[own, own] / np.outer(sd, sd))
        known = (vectors * np.clip(variance, LEAST_VARIANCE, 1.0)) @ vectors.T
        return mixed(over_widest(mean / sd, known, shares_of(h.effects), sided))

    def left(self, linear: Linear, forces: Forces, shared: Array, own: Array, run: int) -> Array:
        """(N,) whitened residual of a run after a step of shared and own numbers."""
        return self.noise.whitened(run, forces, [linear.left(run, shared, own)])[0]

    def best_forces(
        self, grams: Grams, h: Hypothesis, first: Forces, times: Sequence[int], near: bool = False
    ) -> tuple[Forces, Solved]:
        """Sizes and time constant (of ``times``) of the random forces by the restricted likelihood; ``near``: ``first`` was found
        so about here, and its own time needs a narrow search only.
        """

        def cost(logs: Array, time: int) -> float:
            forces = Forces(max(np.exp(logs[0]), SMALLEST), max(np.exp(logs[1]), SMALLEST), time)
            try:
                solved = self.solve(grams, h, forces)
            except np.linalg.LinAlgError:
                return UNSOLVED
            cost = -solved.log_evidence - forces.log_prior(self.simulator.most_force)
            return cost if solved.chi_square >= 0 and np.isfinite(cost) else UNSOLVED

        begun = np.log(np.minimum([first.side_n, first.moment_n_m], self.simulator.most_force))
        # an effect that explains much leaves far smaller forces than those it began with
        tried = [
            begun + np.log(share)
            for share in SMALLER_TRIED
            if share == 1.0 or share * max(first.side_n, first.moment_n_m) > LEAST_TRIED
        ]
        near = near and times[0] == first.time
        start = begun if near else min(tried, key=lambda logs: cost(logs, times[0]))
        best: tuple[float, Array, int] | None = None
        for time in times:
            found = minimize(
                cost, start, args=(time,), method="Nelder-Mead", options={"xatol": 0.1, "fatol": 0.05, "maxfev": FORCE_TRIALS,
                "initial_simplex": start + (NARROW if near and time == first.time else WIDE) * np.array([[0, 0], [1, 0], [0, 1]])},
            )  # fmt: skip
            if best is None or found.fun < best[0]:
                best = (float(found.fun), found.x, time)
            start = best[1]
        assert best is not None
        forces = Forces(max(np.exp(best[1][0]), SMALLEST), max(np.exp(best[1][1]), SMALLEST), best[2])
        return forces, self.solve(grams, h, forces)

    def fit(
        self,
        hypotheses: Sequence[Hypothesis],
        forces: Sequence[Forces],
        steps: int,
        noise_turns: Sequence[int] | None = (),
        open_turns: int = 0,
        begun: Sequence[Fitted] = (),
    ) -> list[Fitted]:
        """Fit several hypotheses side by side; a step that makes one worse is shortened, and one at its end takes none.

        Parameters
        ----------
        forces : start of the noise
        steps : Gauss-Newton steps, at most
        noise_turns : steps after which the noise is estimated anew, or sooner where a fit is at its end; it is again at the end,
            for all that come near the best; None: it stays as it is given
        open_turns : the first steps, in which paths stay open and every step is taken
        begun : fits of these hypotheses, whose linear problems are the first turn's; none: it makes them
        """
        count = len(hypotheses)
        if not count:
            return []
        groups = [
            (
                hypotheses[k::GROUPS],
                forces[k::GROUPS],
                steps,
                noise_turns or (),
                open_turns,
                count == 1,
                begun[k::GROUPS],
            )
            for k in range(min(GROUPS, count))
        ]
        known = [self._noise, *(e for h in hypotheses for e in h.effects)]
        known += [part for f in begun for part in (f.hypothesis, f.linear, f.grams)]
        found = self.spread(lambda group: self._turns(*group), groups, known)
        ends = [found[k % GROUPS][k // GROUPS] for k in range(count)]
        return ends if noise_turns is None else self._with_noise(ends)

    def _turns(
        self,
        hypotheses: Sequence[Hypothesis],
        forces: Sequence[Forces],
        steps: int,
        noise_turns: Sequence[int],
        open_turns: int,
        all_times: bool,
        begun: Sequence[Fitted],
    ) -> list[Fitted]:
        current, sizes = list(hypotheses), list(forces)
        answers: list[Fitted | None] = [None] * len(hypotheses)
        shares = [1.0] * len(hypotheses)
        going, estimated = list(range(len(hypotheses))), [not noise_turns] * len(hypotheses)
        for turn in range(steps + 1):
            if turn == 0 and begun:
                problems = [(f.linear, f.grams) for f in begun]
            else:
                closings = 0 if turn < open_turns else MOST_CLOSINGS
                problems = [(linear, None) for linear in self.linear([current[k] for k in going], closings)]
            for index, (linear, grams) in zip(tuple(going), problems, strict=True):
                estimate = turn in noise_turns and turn < steps and not estimated[index]
                fitted, old = self._one_fitted(linear, sizes[index], estimate, all_times, grams), answers[index]
                if (
                    fitted is not None
                    and turn >= open_turns
                    and not (estimated[index] or estimate)
                    and _settled(fitted)
                ):
                    estimate, fitted = True, self._one_fitted(linear, sizes[index], True, all_times, fitted.grams)
                estimated[index] |= estimate
                free = turn <= open_turns or estimate
                if fitted is not None and (
                    old is None or (_as_sound(fitted, old) and (free or fitted.solved.here >= old.solved.here))
                ):
                    answers[index], shares[index] = fitted, 1.0
                    sizes[index] = fitted.forces
                else:
                    shares[index] *= SHORTER
                kept = answers[index]
                if kept is None:
                    raise EstimationError("the motion simulated from the first fit grows beyond bounds")
                if kept is fitted and turn >= open_turns and estimated[index] and _settled(kept):
                    going.remove(index)
                elif turn < steps:
                    current[index] = self.stepped(kept, shares[index])
            if not going:
                break
        return [a for a in answers if a is not None]

    def _with_noise(self, found: Sequence[Fitted]) -> list[Fitted]:
        """The noise estimated once more for those near the best."""
        best = max(f.log_evidence for f in found)

        def again(k: int) -> tuple[Forces, Solved] | None:
            first = found[k].forces
            times = sorted(ALL_TIMES, key=lambda k: k != first.time)
            try:
                return self.best_forces(found[k].grams, found[k].hypothesis, first, times, found[k].estimated)
            except np.linalg.LinAlgError:  # it stays with the noise that it has
                return None

        near = [k for k, fitted in enumerate(found) if fitted.log_evidence > best - NEAR]
        answers = list(found)
        for k, noise in zip(near, self.spread(again, near), strict=True):
            if noise is not None:
                fitted = self._fitted(found[k].linear, found[k].grams, *noise)
                answers[k] = fitted if _as_sound(fitted, found[k]) else found[k]
        return answers

    def _one_fitted(
        self, linear: Linear, forces: Forces, estimate: bool, all_times: bool, grams: Grams | None = None
    ) -> Fitted | None:
        """The linear problem solved; the noise estimated where wished. None: it has no solution."""
        if not self._bounded(linear):
            return None
        h = linear.hypothesis
        grams = grams or Grams(linear.columns, self._noise or self.simulator.noise(h))
        try:
            solved = self.solve(grams, h, forces)
            if estimate:
                forces, solved = self.best_forces(grams, h, forces, ALL_TIMES if all_times else (forces.time,))
            return replace(self._fitted(linear, grams, forces, solved), estimated=estimate)
        except np.linalg.LinAlgError:
            return None

    def _fitted(self, linear: Linear, grams: Grams, forces: Forces, solved: Solved) -> Fitted:
        h = linear.hypothesis
        log_evidence = solved.log_evidence + forces.log_prior(self.simulator.most_force) + self.sized(h, solved)
        log_evidence += self.bounded(h, solved) - sum(e.cost for e in h.effects)
        if solved.chi_square < 0:
            # squares that sum to less than nothing: slopes of a motion that has run off cancel beyond all digits
            log_evidence = -np.inf
        return Fitted(h, forces, log_evidence, solved, linear, grams)

    def _bounded(self, linear: Linear) -> bool:
        """Whether neither the motion nor its slopes grow beyond bounds."""
        gone = self.simulator.gone
        for (residual, slope), run in zip(linear.rows, self.simulator.runs, strict=True):
            good = np.isfinite(run.values)
            if not (np.abs(residual[good]) < gone).all() or not (np.abs(slope[good]) < STEEP).all():
                return False
        return True

    def stepped(self, fitted: Fitted, share: float) -> Hypothesis:
        """The hypothesis after a step, its path taken along.

        No shared number changes by more than LARGEST_SHARE of itself, no effect's by more than LARGEST_SD, and by ``share`` of that
        after steps that did not improve: one that would is held there, and the others take the best step beside it. A step that
        nothing holds is shortened to ``share``.
        """
        h, solved = fitted.hypothesis, fitted.solved
        first, fixed = len(h.shared), self.fixed(h)
        most = np.full(len(solved.shared), np.inf)
        most[:first] = share * LARGEST_SHARE * np.maximum(np.abs(h.shared), self.simulator.least)
        if h.size:
            most[fixed:] = share * LARGEST_SD * np.concatenate([[q.sd for q in e.parameters] for e in h.effects])
        if (np.abs(solved.shared) > most).any():
            free = solved.shared if solved.free is None else solved.free
            least, top = self._least(h, len(free)), np.minimum(self._most(h, len(free)), most)
            step, _ = within(free, solved.covariance, np.maximum(least, -most), top)
            own = solved.reduced.own_step(step)
        else:
            step, own = share * solved.shared, share * solved.own
        shared, effects = step[:first], step[fixed:]
        numbers, at = [], 0
        for effect, n in zip(h.effects, h.numbers, strict=True):
            own_step = effects[at : at + len(n)]
            numbers.append(n + own_step if effect.moved is None else effect.moved(n, own_step))
            at += len(n)
        path = fitted.linear.slopes.moved(shared, own, effects)
        return replace(h, shared=h.shared + shared, own=h.own + own, numbers=tuple(numbers), path=path)


def _as_sound(fitted: Fitted, old: Fitted) -> bool:
    """Whether a fit has a log evidence, or the one before it had none either."""
    return bool(np.isfinite(fitted.log_evidence) or not np.isfinite(old.log_evidence))


def within(step: Array, covariance: Array, least: Array, most: Array) -> tuple[Array, float]:
    """The best step whose numbers stay between bounds, and half the chi-square that this costs.

    Parameters
    ----------
    step : (n,) the best without bounds
    covariance : (n, n) of it
    least, most : (n,), at most and at least 0
    """
    held: list[int] = []
    bounded, cost = step, 0.0
    bounds = np.zeros(0)
    sd = np.sqrt(np.maximum(np.diag(covariance), LEAST_VARIANCE))
    while len(step):
        # the one whose bound costs most alone: with it held, others may stay within theirs
        over = np.maximum(least - bounded, bounded - most) / sd
        over[held] = 0.0
        worst = int(np.argmax(over))
        if not over[worst] > 0:
            return bounded, cost
        held.append(worst)
        bounds = np.append(bounds, least[worst] if bounded[worst] < least[worst] else most[worst])
        away = bounds - step[held]
        weights = np.linalg.solve(covariance[np.ix_(held, held)], away)
        bounded, cost = step + covariance[:, held] @ weights, 0.5 * float(away @ weights)
        bounded[held] = bounds
    return bounded, cost


__all__ = ["TIMES_S", "Fitted", "Inference", "Linear", "Solved", "within"]
