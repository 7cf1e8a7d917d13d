"""A simulator of one's own in the diagnosis: a roll decay, a pendulum, another tank's model.

It is a function of numbers and effects; slopes are differences of it. What a user writes: that function, its numbers with priors,
and the effects it knows (``effects.Effect`` with a name, a stage, numbers, and a sentence of physics and of cure).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from ..record.errors import InputError
from ..simulate.model import Array
from .effects import Effect
from .inference.apart import Apart
from .inference.evidence import Fitted, Inference
from .inference.hypothesis import EFFECT_STEP, FREE, Hypothesis, Slopes
from .inference.inexact import HALF_SURE, WIDTH
from .inference.noise import FORCE_SD_N, TIMES_S, Measured, Noise, forced
from .starts import BEGINNINGS, ends

STEP_SHARE = 1e-4
"""Of the one-sided differences by a user's numbers, as a share of the number, at least of its usual size."""
Numbers = dict[str, Array]
Simulate = Callable[["UsersRun", Numbers, dict[str, tuple[Array, ...]]], Array]
"""(run, name -> (k,) numbers, effect name -> its numbers (k,) each) -> (n, c, k): k simulations of a run, side by side."""


@dataclass(frozen=True)
class UsersRun:
    """A measured run.

    Attributes
    ----------
    name : of the run
    centre_s : (n,) evenly spaced times; 100 to 250 (means over blocks of finer samples lose nothing a slow motion has)
    values : (n, c); NaN where not measured
    covariance : (c, n, n) measurement noise of each channel
    """

    name: str
    centre_s: Array
    values: Array
    covariance: Array


@dataclass(frozen=True)
class UsersNumber:
    """A number that is fitted.

    Attributes
    ----------
    name : the simulator's
    start : where the fit begins, for all runs or one each; the prior's mean where ``sd`` is given
    sd : prior standard deviation, None: the data alone decide
    size : how large it usually is: of differences, and of the steps of a fit, so that a number may begin at 0 and change its sign
    """

    name: str
    start: float | Sequence[float]
    sd: float | None = None
    size: float = 1.0


class UsersSimulator:
    """A user's function as ``inference.diagnosable.Diagnosable``.

    Parameters
    ----------
    runs : with one step
    simulate : the function
    shared, own : numbers of all runs, and of each run (its start)
    response : (hypothesis's shared numbers, run) -> (n, c) of the outputs to a unit force that lasts one step; None: slow random
        errors stand in the outputs themselves
    usual_force : size of the random forces that stay when nothing is missing
    most_force : above this they are a gap
    apart : effect.number -> what was measured of it apart from the runs
    noise_known : whether ``covariance`` is known well enough to say that runs disagree about shared numbers

    Raises
    ------
    InputError : no runs, uneven times, or a shape that does not fit
    """

    def __init__(
        self,
        runs: Sequence[UsersRun],
        simulate: Simulate,
        shared: Sequence[UsersNumber],
        own: Sequence[UsersNumber],
        response: Callable[[Numbers, UsersRun], Array] | None = None,
        usual_force: float = FORCE_SD_N,
        most_force: float = np.inf,
        apart: Mapping[str, Apart] | None = None,
        noise_known: bool = True,
    ) -> None:
        if not runs:
            raise InputError("runs", "", "none given, expected at least one")
        for run in runs:
            _check(run)
        self._runs, self._simulate, self._shared, self._own = list(runs), simulate, list(shared), list(own)
        self._response, self.force_scale = response, usual_force / FORCE_SD_N
        self.step_s = float(np.mean(np.diff(runs[0].centre_s)))
        self.shared_names: tuple[str, ...] = tuple(n.name for n in shared)
        sd = np.array([np.inf if n.sd is None else n.sd for n in shared])
        self.shared_prior: tuple[Array, Array] | None = (self._begin(shared)[0], sd) if np.isfinite(sd).any() else None
        self.shared_bounds: Array | None = None
        self.stated = np.where([n.sd is None for n in own], 0.0, self._begin(own)) if own else np.zeros((len(runs), 0))
        self.own_sd = np.tile([FREE if n.sd is None else n.sd for n in own], (len(runs), 1)).astype(float)
        self.free = sum(n.sd is None for n in own)
        self.modes = [np.zeros((*run.values.shape, 0)) for run in runs]
        self.gone = 100 * max(float(np.nanmax(np.abs(run.values))) for run in runs)
        self.least: float | Array = np.array([n.size for n in shared])
        self.most_force = most_force / self.force_scale
        self.half_sure, self.sure_width = HALF_SURE, WIDTH
        self.noise_known = noise_known
        self.apart: Mapping[str, Apart] = apart or {}

    @property
    def runs(self) -> Sequence[UsersRun]:
        """Measured runs."""
        return self._runs

    def _begin(self, numbers: Sequence[UsersNumber]) -> Array:
        """(runs, numbers) where they begin."""
        count = len(self._runs)
        return np.array([np.broadcast_to(np.asarray(n.start, dtype=float), (count,)) for n in numbers]).T.reshape(
            count, len(numbers)
        )

    def starts(self) -> Sequence[Hypothesis]:
        """The numbers' own starts, and where least squares over longer and longer beginnings of the records end."""
        given = Hypothesis(self._begin(self._shared)[0], self._begin(self._own))
        size = np.concatenate(
            [[n.size for n in self._shared], np.tile([n.size for n in self._own], len(self._runs))]
        ).astype(float)
        if not len(size):
            return [given]
        begun = np.concatenate([given.shared, given.own.ravel()])
        rows = [lambda x, share=share: self._white_rows(self._at(x), share) for share in BEGINNINGS]
        return [given, *(self._at(end) for end in ends(rows, begun, size, range(len(given.shared))))]

    def _at(self, numbers: Array) -> Hypothesis:
        """The hypothesis of shared numbers and each run's own, one after the other."""
        first = len(self._shared)
        return Hypothesis(numbers[:first], numbers[first:].reshape(len(self._runs), len(self._own)))

    def _white_rows(self, h: Hypothesis, share: float) -> tuple[Array, Array]:
        """Residuals (n,) and slopes (n, shared + all own) over the first ``share`` of every run, and the priors, by their sd.

        The user's function gives whole runs, as it does in the fit: it may know its times by itself.
        """
        first, own = len(self._shared), len(self._own)
        residuals, slopes = [], []
        for index, run in enumerate(self._runs):
            residual, slope = self._row(h, index, run)
            sd = np.sqrt(np.einsum("cnn->nc", run.covariance))
            good = np.isfinite(run.values)
            good[max(int(np.ceil(share * len(good))), 2) :] = False
            wide = np.zeros((int(good.sum()), first + own * len(self._runs)))
            by_own = slice(first + own * index, first + own * (index + 1))
            wide[:, :first] = -(slope[..., :first] / sd[..., None])[good]
            wide[:, by_own] = -(slope[..., first : first + own] / sd[..., None])[good]
            residuals.append((residual / sd)[good])
            slopes.append(wide)
        stated = np.concatenate([self._begin(self._shared)[0], self._begin(self._own).ravel()])
        told = [n.sd or np.inf for n in self._shared] + [n.sd or np.inf for n in self._own] * len(self._runs)
        known = 1 / np.array(told, dtype=float)
        residuals.append((np.concatenate([h.shared, h.own.ravel()]) - stated) * known)
        slopes.append(np.diag(known))
        return np.concatenate(residuals), np.concatenate(slopes)

    def linear(self, hypotheses: Sequence[Hypothesis], closings: int) -> list[Slopes]:
        """Residuals and slopes by differences, all variations of a run in one call."""
        return [Slopes([self._row(h, i, run) for i, run in enumerate(self._runs)]) for h in hypotheses]

    def _row(self, h: Hypothesis, index: int, run: UsersRun) -> tuple[Array, Array]:
        here = np.concatenate([h.shared, h.own[index], *h.numbers])
        steps = [STEP_SHARE * max(abs(v), n.size) for v, n in zip(here, [*self._shared, *self._own], strict=False)]
        steps += [EFFECT_STEP * p.sd for e in h.effects for p in e.parameters]
        table = np.column_stack([here, here[:, None] + np.diag(steps)])
        numbers = {n.name: row for n, row in zip([*self._shared, *self._own], table, strict=False)}
        at, effects = len(numbers), {}
        for effect, own in zip(h.effects, h.numbers, strict=True):
            effects[effect.name] = tuple(table[at : at + len(own)])
            at += len(own)
        with np.errstate(all="ignore"):
            values = np.asarray(self._simulate(run, numbers, effects), dtype=float)
        if values.shape != (*run.values.shape, table.shape[1]):
            wanted = (*run.values.shape, table.shape[1])
            raise InputError("simulate", run.name, f"gave shape {values.shape}, expected {wanted}")
        with np.errstate(all="ignore"):
            return run.values - values[..., 0], (values[..., 1:] - values[..., :1]) / steps

    def noise(self, hypothesis: Hypothesis) -> Noise:
        """Measurement noise, and slow random forces."""
        shared = {n.name: np.array([v]) for n, v in zip(self._shared, hypothesis.shared, strict=True)}

        def measured(run: UsersRun) -> Measured:
            n, channels = run.values.shape
            answer = np.zeros((n, channels))
            answer[0] = 1.0
            if self._response is not None:
                answer = self.force_scale * np.asarray(self._response(shared, run))
            good = np.isfinite(run.values)
            lag = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) * self.step_s
            keep = good.T.ravel().astype(float)[:, None]

            def roots(time: int) -> list[Array]:
                root = forced(answer, TIMES_S[time], lag) * keep
                return [root, np.zeros_like(root)]

            return Measured(good, run.covariance, tuple(range(channels)), roots)

        return Noise([measured(run) for run in self._runs])

    def usable(self, library: Sequence[Effect]) -> tuple[list[Effect], dict[str, str]]:
        """All that are given."""
        return list(library), {}

    def as_quiet_as(self, inference: Inference, base: Fitted) -> Self:
        """Itself: the measurement's noise is as it was told."""
        return self

    def unlike(self, base: Fitted, best: Effect | None = None) -> list[Hypothesis]:
        """None: a user's effects begin absent."""
        return []

    def forms(self, effect: Effect) -> list[Effect]:
        """None: all are in the library."""
        return []

    def suggested(self, base: Fitted) -> list[Effect]:
        """None."""
        return []

    def free_forms(self, shaken_hz: Sequence[float]) -> Sequence[Effect]:
        """None: what random forces must explain stands for the unknown."""
        return ()

    def one_off(self, inference: Inference, base: Fitted) -> Sequence[Effect]:
        """None: of what acts once, nothing is known."""
        return ()

    def free_beside(self) -> Sequence[Effect]:
        """None."""
        return ()

    def symmetries(self, inference: Inference, base: Fitted) -> Sequence[tuple[str, Sequence[str]]]:
        """None is known."""
        return ()

    def reached(self, fitted: Fitted) -> str:
        """Nothing is known of the motion."""
        return ""


def _check(run: UsersRun) -> None:
    n, channels = run.values.shape
    if run.centre_s.shape != (n,) or run.covariance.shape != (channels, n, n):
        raise InputError(
            run.name, "values", f"{n} times and {channels} channels ask for covariance ({channels}, {n}, {n})"
        )
    gaps = np.diff(run.centre_s)
    if not np.allclose(gaps, gaps.mean(), rtol=0.05):
        raise InputError(run.name, "centre_s", "times are not evenly spaced; take means over even blocks")


__all__ = ["UsersNumber", "UsersRun", "UsersSimulator"]
