"""A hypothesis against the data: Gauss-Newton with the noise estimated beside it, and its evidence.

Numbers shared by all runs (derivatives, camera modes, effects) and each run's own are fitted together; the own ones are eliminated
run by run. Evidence is Laplace's approximation with the restricted likelihood of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from ..geometry.normal import inverse_of_normal
from ..record.errors import EstimationError
from ..simulate.model import Array
from .effects import Effect
from .noise import SMALLEST, TIMES_S, Forces, Noise
from .tow_model import OWN, Hypothesis, TowModel

PRIORS = {"y_b": 1.5e-3, "beta_b": 1.5e-3, "tension": 5e-3, "tow_point": 7e-4, "line": 7e-4, "speed": 1.5e-3}
"""Of each run's own numbers where [priors] is silent: m, rad; tension and speed relative."""
FREE = 1e6
LARGEST_SHARE = 0.4
"""No derivative changes by more than this share in a step."""
SHORTER = 0.3
FORCE_TRIALS = 16
THREADS = 2
GONE = 5.0
"""m or rad: a simulated motion this far from the measured one has grown beyond bounds."""
LARGEST_SD = 3.0
"""No effect's number changes by more prior standard deviations in a step."""


@dataclass(frozen=True)
class Linear:
    """A hypothesis with residuals and slopes, and priors on what it may change.

    Attributes
    ----------
    rows : per run: residual (n, 4), slopes (n, 4, 16 + p)
    modes : per run (n, 4, k): camera modes
    """

    hypothesis: Hypothesis
    rows: list[tuple[Array, Array]]
    modes: list[Array]


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the shared numbers, without their priors.

    Attributes
    ----------
    matrix, right : of six, modes, effects
    before, chi_square : whitened residuals as they stand, and with each run's own numbers fitted
    log : log determinants of the noise and of the own numbers
    kept : run -> whitened residual, slopes by shared and own numbers, own inverse, cross and right side
    """

    matrix: Array
    right: Array
    before: float
    chi_square: float
    log: float
    kept: dict[int, tuple[Array, ...]]


@dataclass(frozen=True)
class Solved:
    """The linear problem solved at one noise.

    Attributes
    ----------
    log_evidence : up to a constant of the data
    here : the same without the step: what the hypothesis as it stands reaches
    chi_square : whitened residuals after the step, and the priors
    shared : (6 + k + p,) step of six, modes, effects
    own : (runs, 10) step
    covariance : of ``shared``
    left : run -> (N,): whitened residuals after the step
    """

    log_evidence: float
    here: float
    chi_square: float
    shared: Array
    own: Array
    covariance: Array
    left: dict[int, Array]


@dataclass(frozen=True)
class Fitted:
    """A hypothesis at its optimum.

    Attributes
    ----------
    hypothesis, forces : the optimum
    log_evidence : with the noise's prior
    solved : the last linear problem
    linear : the linearisation behind it
    """

    hypothesis: Hypothesis
    forces: Forces
    log_evidence: float
    solved: Solved
    linear: Linear


class Inference:
    """Fits hypotheses to one campaign.

    Parameters
    ----------
    model : all runs

    Attributes
    ----------
    six_prior : mean and standard deviation of the six derivatives, where the simulator's own are to be judged
    """

    def __init__(self, model: TowModel) -> None:
        self.model = model
        self.own_sd = own_sds(model)
        self.stated = np.array([_stated(run) for run in model.runs])
        keys = list(dict.fromkeys(run.data.common_key for run in model.runs if len(run.modes)))
        counts = {k: next(len(r.modes) for r in model.runs if r.data.common_key == k and len(r.modes)) for k in keys}
        offsets = dict(zip(keys, np.cumsum([0, *counts.values()])[:-1], strict=True))
        self.mode_count = sum(counts.values())
        self.noise: Noise | None = None
        self.six_prior: tuple[Array, Array] | None = None
        self.modes = []
        for run in model.runs:
            table = np.zeros((len(run.centre_s), 4, self.mode_count))
            if len(run.modes):
                at = offsets[run.data.common_key]
                table[:, :, at : at + len(run.modes)] = run.modes.transpose(1, 2, 0)
            self.modes.append(table)

    def linear(self, hypotheses: Sequence[Hypothesis]) -> list[Linear]:
        """Linearise hypotheses, all in one integration."""
        return [Linear(h, rows, self.modes) for h, rows in zip(hypotheses, self.model.linear(hypotheses), strict=True)]

    def reduced(self, linear: Linear, noise: Noise, forces: Forces, only: Sequence[int] | None = None) -> Reduced:
        """Normal equations of the shared numbers, the runs' own eliminated; ``only``: these runs."""
        h = linear.hypothesis
        size = 6 + self.mode_count + h.size
        matrix, right = np.zeros((size, size)), np.zeros(size)
        before = chi_square = log = 0.0
        kept = {}
        for i in range(len(self.model.runs)) if only is None else only:
            residual, slope = linear.rows[i]
            every = np.concatenate([slope[:, :, :6], linear.modes[i], slope[:, :, 16:], slope[:, :, 6:16]], axis=2)
            (r, j), determinant = noise.whitened(i, forces, (residual, every))
            shared, own = j[:, :size], j[:, size:]
            sd = self.own_sd[i]
            away = self.stated[i] - h.own[i]
            inner = own.T @ own + np.diag(1 / sd**2)
            to_own = own.T @ r + away / sd**2
            inverse = np.linalg.inv(inner)
            cross = own.T @ shared
            matrix += shared.T @ shared - cross.T @ inverse @ cross
            right += shared.T @ r - cross.T @ inverse @ to_own
            here = float(r @ r + away**2 @ (1 / sd**2))
            before += here
            chi_square += here - float(to_own @ inverse @ to_own)
            log += determinant + np.linalg.slogdet(inner)[1] + 2 * float(np.log(sd).sum())
            kept[i] = (r, shared, own, inverse, cross, to_own)
        return Reduced(matrix, right, before, chi_square, log, kept)

    def priors(self, h: Hypothesis) -> tuple[Array, Array, float]:
        """Of six, modes and effects: precision, gap to the prior's mean, log of the variances."""
        sd = np.array([q.sd for e in h.effects for q in e.parameters])
        none = np.array([q.none for e in h.effects for q in e.parameters])
        here = np.concatenate(h.numbers) if h.numbers else np.zeros(0)
        k = self.mode_count
        mean, known = (h.six, np.zeros(6)) if self.six_prior is None else (self.six_prior[0], self.six_prior[1] ** -2.0)
        precision = np.concatenate([known, np.ones(k), 1 / sd**2])
        return precision, np.concatenate([mean - h.six, np.zeros(k), none - here]), 2 * float(np.log(sd).sum())

    def solve(self, linear: Linear, noise: Noise, forces: Forces, only: Sequence[int] | None = None) -> Solved:
        """One Gauss-Newton step with its evidence."""
        part = self.reduced(linear, noise, forces, only)
        precision, gap, spread = self.priors(linear.hypothesis)
        matrix, right = part.matrix + np.diag(precision), part.right + precision * gap
        known = float(precision @ gap**2)
        covariance = inverse_of_normal(matrix)
        step = covariance @ right
        chi_square = part.chi_square + known - float(right @ step)
        log = part.log + spread + np.linalg.slogdet(matrix)[1]
        own_step = np.zeros((len(self.model.runs), len(OWN)))
        left: dict[int, Array] = {}
        for i, (r, shared, own, inverse, cross, to_own) in part.kept.items():
            own_step[i] = inverse @ (to_own - cross @ step)
            left[i] = r - shared @ step - own @ own_step[i]
        here = -0.5 * (part.before + known + log)
        return Solved(-0.5 * (chi_square + log), here, chi_square, step, own_step, covariance, left)

    def best_forces(self, linear: Linear, noise: Noise, first: Forces) -> tuple[Forces, Solved]:
        """Sizes and time constant of the random forces by the restricted likelihood."""

        def cost(logs: Array, time: int) -> float:
            forces = Forces(max(np.exp(logs[0]), SMALLEST), max(np.exp(logs[1]), SMALLEST), time)
            try:
                return -self.solve(linear, noise, forces).log_evidence - forces.log_prior
            except np.linalg.LinAlgError:
                return 1e12

        start = np.log([first.side_n, first.moment_n_m])
        times = [first.time] if first.time != 1 else [1, 0, 2]
        best: tuple[float, Array, int] | None = None
        for time in times:
            found = minimize(
                cost, start, args=(time,), method="Nelder-Mead", options={"xatol": 0.1, "fatol": 0.05, "maxfev": FORCE_TRIALS,
                "initial_simplex": start + np.array([[0, 0], [0.7, 0], [0, 0.7]])},
            )  # fmt: skip
            if best is None or found.fun < best[0]:
                best = (float(found.fun), found.x, time)
            start = best[1]
        assert best is not None
        forces = Forces(max(np.exp(best[1][0]), SMALLEST), max(np.exp(best[1][1]), SMALLEST), best[2])
        return forces, self.solve(linear, noise, forces)

    def fit(
        self, hypotheses: Sequence[Hypothesis], forces: Sequence[Forces], steps: int, noise_turns: Sequence[int] = ()
    ) -> list[Fitted]:
        """Fit several hypotheses side by side; a step that makes one worse is shortened.

        Parameters
        ----------
        forces : start of the noise
        steps : Gauss-Newton steps
        noise_turns : steps after which the noise is estimated anew
        """
        current, sizes = list(hypotheses), list(forces)
        answers: list[Fitted | None] = [None] * len(hypotheses)
        shares = [1.0] * len(hypotheses)
        for turn in range(steps + 1):
            estimate = turn in noise_turns or turn == steps
            linears = self.linear(current)
            with ThreadPoolExecutor(min(THREADS, len(current))) as pool:
                found = list(pool.map(self._fitted, linears, sizes, [estimate] * len(linears)))
            for index, fitted in enumerate(found):
                old = answers[index]
                if fitted is not None and (old is None or turn in noise_turns or fitted.solved.here >= old.solved.here):
                    answers[index], shares[index] = fitted, 1.0
                    sizes[index] = fitted.forces
                else:
                    shares[index] *= SHORTER
                kept = answers[index]
                if kept is None:
                    raise EstimationError(
                        "the motion simulated from the first fit grows beyond bounds; is the tow stable?"
                    )
                if turn < steps:
                    current[index] = self.stepped(kept.hypothesis, kept.solved, shares[index])
        return [a for a in answers if a is not None]

    def _fitted(self, linear: Linear, forces: Forces, estimate: bool) -> Fitted | None:
        for (residual, _), run in zip(linear.rows, self.model.runs, strict=True):
            if not (np.abs(residual[np.isfinite(run.values)]) < GONE).all():
                return None
        # the dynamics that carry the random forces are the base's: near enough, and the same for all hypotheses
        noise = self.noise or Noise(self.model.runs, linear.hypothesis, self.model.speed_m_s)
        if estimate:
            forces, solved = self.best_forces(linear, noise, forces)
        else:
            solved = self.solve(linear, noise, forces)
        return Fitted(linear.hypothesis, forces, solved.log_evidence + forces.log_prior, solved, linear)

    def stepped(self, h: Hypothesis, solved: Solved, share: float) -> Hypothesis:
        """The hypothesis after (part of) a step."""
        k = self.mode_count
        six, effects = solved.shared[:6], solved.shared[6 + k :]
        limit = np.abs(six) / (LARGEST_SHARE * np.maximum(np.abs(h.six), 1.0))
        if len(effects):
            sd = np.concatenate([[q.sd for q in e.parameters] for e in h.effects])
            limit = np.concatenate([limit, np.abs(effects) / (LARGEST_SD * sd)])
        share = share / max(1.0, float(limit.max()))
        numbers, at = [], 0
        for n in h.numbers:
            numbers.append(n + share * effects[at : at + len(n)])
            at += len(n)
        return replace(h, six=h.six + share * six, own=h.own + share * solved.own, numbers=tuple(numbers))


def with_effects(h: Hypothesis, effects: Sequence[Effect]) -> Hypothesis:
    """The hypothesis with more effects, absent at first."""
    numbers = tuple(np.array([q.none for q in e.parameters]) for e in effects)
    return replace(h, effects=(*h.effects, *effects), numbers=(*h.numbers, *numbers))


def own_sds(model: TowModel) -> Array:
    """Prior standard deviations of each run's own numbers, (runs, 10)."""
    rows = []
    for run in model.runs:
        tow, priors = run.data.tow, run.data.priors
        tension, speed = float(tow.tension_n or 1.0), tow.speed_m_s
        rows.append(
            [
                FREE,
                FREE,
                FREE,
                FREE,
                priors.y_bias_sd_m or PRIORS["y_b"],
                priors.beta_bias_sd_rad or PRIORS["beta_b"],
                tension * float(np.hypot(priors.tension_sd_rel or PRIORS["tension"], priors.tension_common_sd_rel)),
                priors.tow_point_sd_m or PRIORS["tow_point"],
                priors.line_length_sd_m or PRIORS["line"],
                speed * (priors.speed_sd_rel or PRIORS["speed"]),
            ]
        )
    return np.array(rows)


def _stated(run) -> Array:
    tow = run.data.tow
    return np.array([0, 0, 0, 0, 0, 0, tow.tension_n, tow.tow_point_m, tow.line_length_m, tow.speed_m_s], dtype=float)


__all__ = ["TIMES_S", "Fitted", "Inference", "Linear", "Solved", "own_sds", "with_effects"]
