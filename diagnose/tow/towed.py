"""Towed models as a simulator for the diagnosis."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...geometry.normal import inverse_of_normal
from ...record.priors import LINE_LENGTH_SD_M
from ...simulate.model import Array
from ..effects import KEPT, LAWS, PULLEYS, SLACK, SMALLEST_COSINE, Effect, offset_each
from ..inference.apart import Apart
from ..inference.grams import reduced
from ..inference.hypothesis import FREE, Hypothesis
from ..inference.inexact import HALF_SURE, WIDTH
from ..inference.noise import Noise, RunNoise
from .channels import CHANNELS
from .columns import OWN, own_numbers
from .delays import delay_effects
from .fields import OtherHull
from .model import TowModel
from .noise import measured_noise, tow_noise
from .numbers import SIX, shared_numbers
from .pushes import pushes
from .quiet import quieter
from .shifts import shift_effects
from .slackness import jerk_effects, slack_effects, surging_kg
from .springs import springing_effects
from .start import base_hypotheses, lawful_hypotheses, settings_of, straight_pull
from .surging import Swinging
from .tow_run import TowRun
from .unknown import free_forms, one_off, repeating
from .waves import waves
from .weak import by_motion, missed

if TYPE_CHECKING:
    from ..inference.evidence import Fitted, Inference

PRIORS = {
    "y_b": 1.5e-3, "beta_b": 1.5e-3, "tension": 5e-3, "tow_point": 7e-4, "line": LINE_LENGTH_SD_M, "speed": 1.5e-3,
    "longer": 0.05, "ahead": 0.05,
}  # fmt: skip
"""Of each run's own numbers where [priors] is silent: m, rad; tension and speed relative. The last two: of a line with a law of its
own, m and m/s."""
LARGEST_FORCE_SHARE = 0.05
"""Of the line's pull: random forces above this are a gap, not noise."""
SMALLEST_SD = 0.003
"""Of a reference derivative, relative: no simulator is surer of itself."""
LINE = CHANNELS.index("line")
PAYS_OUT, LEAST_BLOCKS = 2.5, 10
"""Lines with a law of their own are tried where the radius varies by so many times its noise, in runs of so many means at least (or
where the runs are not followed). Choices, for time."""
BOUNCES_S = 2.0
"""Or where it does for so long in most runs: a soft line's bounce dies out soon after the model is let go."""
SAME_HULL = 1e-3
"""Derivatives that differ by less answer random forces alike: their sizes, which are fitted, hold the difference."""

TENSION_SCALE = ("", ("tension scale", "all derivatives together"))
TURNING, TURNS_GAIN = 2, 5.0
"""Of pulleys that are out of round so many are tried, where the momenta miss less by this chi-square: for time, choices."""
CLOCK = ("frame_rate", ("frame_rate", "carriage speed"))
"""What no motion can tell apart (gap.md), and the effect that raises the question; another standard does: a weight, a clock."""
UNWEIGHED, WEIGHED = 1.0, 0.1
"""Swings weigh the model on a line that keeps its length (theory.md 10): were T known to UNWEIGHED only, derivatives known to
WEIGHED by the motion alone are no symmetry with it.
"""


class TowSimulator(TowModel):
    """A campaign of tows as ``inference.diagnosable.Diagnosable``.

    Parameters
    ----------
    runs : with one block length
    reference : the simulator's own six derivatives, their standard deviations and the speed they are quoted at, judged as they
        are; None: fitted to these runs
    apart : effect.number -> what was measured of it apart from the runs
    without : names of effects that are known not to be there
    hull : its equations, where they are another simulator's (``own.hull``)
    """

    def __init__(
        self,
        runs: Sequence[TowRun],
        reference: tuple[Array, Array, float] | None = None,
        apart: Mapping[str, Apart] | None = None,
        without: Collection[str] = (),
        hull: OtherHull | None = None,
    ) -> None:
        super().__init__(runs, float(np.mean([r.data.tow.speed_m_s for r in runs])), hull=hull)
        self.apart: Mapping[str, Apart] = apart or {}
        self._without = frozenset(without)
        known = None
        if reference is not None:
            six, sd, quoted = reference
            ratio = np.where(np.arange(6) < 2, 1.0, self.speed_m_s / quoted)
            known = (six * ratio, np.maximum(sd * ratio, SMALLEST_SD * np.abs(six * ratio)))
        self._shared = shared_numbers(runs, self.speed_m_s, known)
        mean, spread = self._shared.mean, self._shared.sd
        self.shared_prior: tuple[Array, Array] | None = (mean, spread) if np.isfinite(spread).any() else None
        self.shared_bounds: Array | None = None
        self.stated, self.own_sd = np.array([_stated(run) for run in runs]), own_sds(runs)
        # alpha, beta, v, r, and what little the biases are free
        self.free, self.gone, self.force_scale = 6, 5.0, 1.0
        self.least: float | Array = self._shared.least
        self.modes = _modes(runs)
        self._starts: list[Hypothesis] | None = None
        self._measured: list[RunNoise] | None = None
        self._last: tuple[Array, Noise] | None = None
        self.half_sure, self.sure_width = HALF_SURE, WIDTH
        self.noise_known = True
        self.most_force = LARGEST_FORCE_SHARE * float(np.mean([straight_pull(run)[0] for run in runs]))

    def starts(self) -> Sequence[Hypothesis]:
        """The linear fit of all runs, and a hull like others of its length, along the measured motion."""
        if self._starts is None:
            found = base_hypotheses(self.runs, self.speed_m_s)
            self._starts = [replace(h, shared=self._shared.start(h.shared)) for h in found]
        return self._starts

    def unlike(self, base: Fitted, best: Effect | None = None) -> list[Hypothesis]:
        """Lines with a law of their own, along the measured motion, where the line's radius or the random forces ask for them, or
        the best effect that was found: what a line does for a while, or as it stretches, may be a law of its own.

        Each from a hull like others, all its numbers by the motion, and from the base's hull with the law's first number so.
        """
        laws, pulleys = self._with(LAWS), self._with(PULLEYS)
        if not self._fields.surge.all() or any(np.isfinite(r.values[:, LINE]).sum() < LEAST_BLOCKS for r in self.runs):
            return []  # nothing says how long the line is
        if not (self._asks_for_laws(base) if best is None else best.name in {SLACK, *(law.name for law in laws)}):
            return []
        usual, here = lawful_hypotheses(self.runs, [*laws, *pulleys], [self.starts()[-1], base.hypothesis])
        found = [by_motion(self, h, self.shared_prior) for h in usual]
        found, turning = found[: len(laws)], found[len(laws) :]
        found += [by_motion(self, h, None, first_only=True) for h in here[: len(laws)]]
        plain = [h for h in found if h.effects[0].name == KEPT.name]
        if turning and plain:
            # no step leads from one turn to another: the measured motion says which are the likeliest, if any
            without, *each = missed(self, [plain[0], *turning])
            found += [turning[k] for k in np.argsort(each)[:TURNING] if each[k] < without - TURNS_GAIN]
        return found

    def forms(self, effect: Effect) -> list[Effect]:
        """Of a line with a law of its own, other laws of its name."""
        return [law for law in self._with((*LAWS, *PULLEYS)) if law.name == effect.name]

    def _with(self, effects: Sequence[Effect]) -> list[Effect]:
        return [effect for effect in effects if effect.name not in self._without]

    def _asks_for_laws(self, base: Fitted) -> bool:
        if not base.forces.follow(self.most_force):
            return True
        radii = [residual[:, LINE] for residual, _ in base.linear.rows]
        if any(np.nanstd(r) > PAYS_OUT * run.usual_sd(LINE) for r, run in zip(radii, self.runs, strict=True)):
            return True
        return bool(np.median([self._bounces(base, index) for index in range(len(self.runs))]) > PAYS_OUT)

    def _bounces(self, base: Fitted, index: int) -> float:
        """What a fit leaves of a run's radius where that is most, over BOUNCES_S, in units of its noise."""
        run, solved = self.runs[index], base.solved
        left = base.linear.left(index, solved.shared, solved.own[index])[:, LINE]
        left = np.where(np.isfinite(run.values[:, LINE]), left / run.usual_sd(LINE), 0.0)
        blocks = max(round(BOUNCES_S / run.step_s), 1)
        return float(np.sqrt(np.convolve(left**2, np.full(blocks, 1 / blocks), "valid").max(initial=0.0)))

    def symmetries(self, inference: Inference, base: Fitted) -> Sequence[tuple[str, Sequence[str]]]:
        """The scale of all tensions, unless these swings weigh the model; a clock against the carriage's speed."""
        return [*([] if self._weighed(inference, base) else [TENSION_SCALE]), CLOCK]

    def _weighed(self, inference: Inference, base: Fitted) -> bool:
        """Whether the motion would tell the derivatives to WEIGHED without any knowledge of T."""
        if not self._fields.surge.any():
            return False
        h, own_sd = base.hypothesis, self.own_sd.copy()
        at = OWN.index("tension")
        own_sd[:, at] = UNWEIGHED * np.abs(self.stated[:, at])
        modes = slice(len(h.shared), inference.fixed(h))
        part = reduced(base.grams, base.forces, self.stated - h.own, own_sd, None, modes)
        covariance = inverse_of_normal(part.matrix + np.diag(inference.priors(h).precision))
        sd = np.sqrt(np.maximum(np.diag(covariance)[: len(SIX)], 0.0))
        return bool(sd[0] < WEIGHED * abs(h.shared[0]))

    def noise(self, hypothesis: Hypothesis) -> Noise:
        """Measurement noise, and slow random side forces and moments; hulls that hardly differ (SAME_HULL) share it."""
        six = hypothesis.shared[: len(SIX)]
        if self._last is not None and np.allclose(six, self._last[0], rtol=SAME_HULL, atol=0.0):
            return self._last[1]
        if self._measured is None:
            self._measured = measured_noise(self.runs)
        self._last = (six, tow_noise(self.runs, self.pushed(hypothesis), self._measured))
        return self._last[1]

    def as_quiet_as(self, inference: Inference, base: Fitted) -> TowSimulator:
        """Granted as much slow error as its runs show; itself, where that is as much as before."""
        runs = quieter(self.runs, self.pushed(base.hypothesis), inference, base)
        if all(run is old for run, old in zip(runs, self.runs, strict=True)):
            return self
        quiet = copy(self)
        quiet.runs, quiet._measured, quiet._last = runs, None, None
        return quiet

    def usable(self, library: Sequence[Effect]) -> tuple[list[Effect], dict[str, str]]:
        """Effects that these runs can show, and why the others cannot be judged."""
        usable, excluded = [], {}
        for effect in library:
            if effect.name in self._without:
                excluded[effect.name] = "left out, as it was told"
                continue
            pixels = effect.correct is not None and effect.shift is None
            if pixels and any(run.marks is None for run in self.runs):
                excluded[effect.name] = "a motion holds no pixels"
                continue
            why = next((w for run in self.runs if (w := effect.needs(run.run))), "")
            if why:
                excluded[effect.name] = why
            else:
                usable.append(effect)
        judged = {effect.name for effect in usable}
        return usable, {name: why for name, why in excluded.items() if name not in judged}

    def suggested(self, base: Fitted) -> list[Effect]:
        """Windows in which the line may have gone slack, its bounces, and when the camera may have been turned."""
        step = base.solved
        # of the base's end: before its last step the datum's errors stand in the line's radius
        residuals = [base.linear.left(k, step.shared, own) for k, own in enumerate(step.own)]
        found = (
            *(
                jerk_effects(self.runs, residuals, self._swinging(base.hypothesis))
                if self._fields.surge.all()
                else slack_effects(self.runs, residuals)
            ),
            *springing_effects(self.runs, residuals),
            *shift_effects(self.runs, residuals),
            *((offset_each(len(self.runs)),) if len(self.runs) > 1 else ()),
            *(delay_effects(self.runs, self.node_s, self._taut(base.hypothesis)[0]) if self.celled else ()),
        )
        return self._with(found)

    def _swinging(self, h: Hypothesis) -> list[Swinging]:
        """How the runs swing as they were measured, on lines that keep their lengths."""
        pulls, gains, angles = self._taut(h)
        cosines = np.clip(np.cos(angles), SMALLEST_COSINE, None)
        return [
            Swinging(self.node_s, pull / straight_pull(run)[0] - 1, surging_kg(run) * gain * cosine, cosine)
            for run, pull, gain, cosine in zip(self.runs, pulls.T, gains.T, cosines.T, strict=True)
        ]

    def _taut(self, h: Hypothesis) -> tuple[Array, Array, Array]:
        """(nodes, runs) what the lines of a hypothesis would pull with along the measured motion, N, ``Taut.gain`` there, and their
        angles to the hulls, rad.
        """
        path = self.starts()[0].path
        assert path is not None
        return (*self.taut(h, path), path.states[0] + path.states[1])

    def free_forms(self, shaken_hz: Sequence[float]) -> Sequence[Effect]:
        """Forces of many shapes, faults of what is seen, and what shakes at these frequencies."""
        return free_forms(len(self.runs), shaken_hz)

    def one_off(self, inference: Inference, base: Fitted) -> Sequence[Effect]:
        """What pushed the model once in some runs, and what repeats across the tank, where random forces must stand for it."""
        names = [run.name for run in self.runs]
        return (*one_off(names, pushes(inference, base)), *repeating(waves(inference, base)))

    def free_beside(self) -> Sequence[Effect]:
        """None: real walls, swivels and rolls have not the library's formulas, and what a free form finds beside them is that."""
        return ()

    def reached(self, fitted: Fitted) -> str:
        """At which size of the motion a hull effect's force was at work."""
        fastest = float(np.abs(fitted.hypothesis.own[:, OWN.index("v")]).max())
        speeds = [
            np.abs(np.gradient(r.values[:, 0], self.step_s) - r.data.tow.speed_m_s * r.values[:, 1]) for r in self.runs
        ]
        return f"sway velocities of the runs reach {max(fastest, *(float(np.nanmax(s)) for s in speeds)):.2f} m/s"


def _modes(runs: Sequence[TowRun]) -> list[Array]:
    """Per run (n, c, k): the cameras' common errors and their codecs' lags; runs of one datum, of one camera share them."""
    counts = {key: len(modes) for run in runs for key, modes in run.shared}
    offsets = dict(zip(counts, np.cumsum([0, *counts.values()])[:-1], strict=True))
    tables = []
    for run in runs:
        table = np.zeros((*run.values.shape, sum(counts.values())))
        for key, modes in run.shared:
            table[:, :, offsets[key] : offsets[key] + len(modes)] = modes.transpose(1, 2, 0)
        tables.append(table)
    return tables


def own_sds(runs: Sequence[TowRun]) -> Array:
    """Prior standard deviations of each run's own numbers, (runs, len(OWN))."""
    rows = []
    for run in runs:
        tow, priors = run.data.tow, run.data.priors
        (tension, unsure), speed = straight_pull(run), tow.speed_m_s
        rows.append(
            [
                FREE,
                FREE,
                FREE,
                FREE,
                priors.y_bias_sd_m or PRIORS["y_b"],
                priors.beta_bias_sd_rad or PRIORS["beta_b"],
                tension
                * max(
                    unsure, float(np.hypot(priors.tension_sd_rel or PRIORS["tension"], priors.tension_common_sd_rel))
                ),
                priors.tow_point_sd_m or PRIORS["tow_point"],
                priors.line_length_sd_m or PRIORS["line"],
                speed * (priors.speed_sd_rel or PRIORS["speed"]),
                PRIORS["longer"],
                PRIORS["ahead"],
            ]
        )
    return np.array(rows)


def _stated(run) -> Array:
    return own_numbers(**settings_of(run))


__all__ = ["TowSimulator", "own_sds"]
