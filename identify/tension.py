"""T from the motion: a model on a line of constant length weighs its own pull (theory.md 10), and with it a gauge.

The same fit without any stated tension and without any load cell: what it finds is the scale of all forces from the model's mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..record.errors import EstimationError
from ..record.priors import Priors
from ..record.results import GaugeResult, Measured
from ..simulate.model import Array
from .data import RunData
from .fit import Fit, continued, fit_runs
from .joint.common import SCALE
from .joint.gauge import GaugeBlocks, gauge_blocks

WEIGHED_LOG_SD = 0.15
"""Of the scale's logarithm: beyond it the swings do not weigh the model, and a missing tension is asked for."""
AGREES_Z = 2.6
"""The 99 % interval of a normal distribution (2.576)."""
CONTRADICTS_Z = 6.0
"""Of a gauge's scale from 1: chance takes it for this far off in one of a thousand million."""
DEPARTS_Z = 3.0
"""What a gauge's motion says and what is stated differ beyond this many standard deviations: 1 in 370 by chance."""
SCALE_OFF = 0.5
"""... and by this much: what a gauge can be off by without being another quantity. A choice."""
LIGHTEST, HEAVIEST = 1.0, 6.0
"""(m - Y_vdot)/m: water that is moved along weighs something, and no hull drags five times its own mass along."""
SEEN_SWING = 3.0
"""A gauge's scale is judged where the swings of T stand so far above its noise."""


@dataclass(frozen=True)
class GaugeCheck:
    """A load cell against the motion; each (value, standard deviation).

    Attributes
    ----------
    scale : what it reads over what pulls, of the swings alone
    zero_n : what it reads more
    delay_s : by how much its clock is late beyond tension_delay_s
    """

    scale: tuple[float, float]
    zero_n: tuple[float, float]
    delay_s: tuple[float, float]

    @property
    def result(self) -> GaugeResult:
        """For the files."""
        parts = {name: Measured(value=v, std=sd) for name, (v, sd) in vars(self).items()}
        return GaugeResult(**parts)

    def departures(self, priors: Priors) -> list[str]:
        """What is further from a true cell than the priors allow, in words."""
        stated = (
            (
                "it reads",
                "of what pulls",
                self.scale,
                1.0,
                np.hypot(priors.tension_common_sd_rel, priors.tension_sd_rel),
            ),
            ("its zero is", "N", self.zero_n, 0.0, priors.tension_zero_sd_n),
            ("its clock is", "s late", self.delay_s, 0.0, priors.tension_delay_sd_s),
        )
        return [
            f"{words} {value:+.3f} +- {sd:.3f} {unit}; say so in [tow] and [priors]"
            for words, unit, (value, sd), right, allowed in stated
            if abs(value - right) > DEPARTS_Z * float(np.hypot(sd, allowed))
        ]

    @property
    def contradicted(self) -> bool:
        """The motion did not come from such a tension."""
        value, sd = self.scale
        return abs(value - 1) > max(CONTRADICTS_Z * sd, SCALE_OFF)


@dataclass(frozen=True)
class TensionFromMotion:
    """What the motion alone says of the tension.

    Attributes
    ----------
    log_factor, log_sd : logarithm of R from the motion over R as stated (or read, or guessed), and its standard deviation
    stated_sd : relative standard deviation of what is stated, all runs together; None: nothing is
    resistance_n : run name -> R from the motion
    tension_n : run name -> (n,) T from the motion at the samples
    gauges : run name -> check of its load cell
    fit : the fit without any tension
    """

    log_factor: float
    log_sd: float
    stated_sd: float | None
    resistance_n: dict[str, float]
    tension_n: dict[str, Array]
    gauges: dict[str, GaugeCheck]
    fit: Fit

    @property
    def factor(self) -> float:
        """R from the motion over R as stated."""
        return float(np.exp(self.log_factor))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of ``factor``, of its logarithm."""
        ends = np.exp(self.log_factor + 1.96 * self.log_sd * np.array([-1, 1]))
        return float(ends[0]), float(ends[1])

    @property
    def z(self) -> float | None:
        """Stated against found, in standard deviations; None where nothing is stated."""
        return None if self.stated_sd is None else self.log_factor / float(np.hypot(self.log_sd, self.stated_sd))

    @property
    def weighed(self) -> bool:
        """The swings are large enough."""
        return self.log_sd < WEIGHED_LOG_SD


def tension_from_motion(fit: Fit, runs: list[RunData]) -> TensionFromMotion | None:
    """R and T from the motion and the model's mass; None where the line's tension is given (or the form is linear).

    Parameters
    ----------
    fit : output error, full form
    runs : as fitted

    Example
    -------
    ``found = tension_from_motion(fit, runs); found.factor, found.interval``
    """
    if fit.form != "full" or runs[0].tow.line != "surge" or fit.method != "output_error":
        return None
    stated = [d for d in runs if d.tension_stated]
    bare = [replace(d, tension_stated=False, gauge=None) for d in runs]
    if any(d.gauge is not None for d in runs):
        # a cell that is wrong bends the fit, and what that leaves is no noise
        alone = fit_runs(bare, fit.form, fit.speed_m_s)
    else:
        alone = continued(fit, bare) if stated else fit
    log_factor, log_sd = alone.common[SCALE]
    found = {d.name: float(own[6] * np.exp(log_factor)) for d, own in zip(runs, alone.own, strict=True)}
    paths = {d.name: t for d, t in zip(runs, alone.tension_n, strict=True)}
    gauges = {d.name: c for d in runs if (c := _checked(d, paths[d.name], log_sd)) is not None}
    return TensionFromMotion(log_factor, log_sd, _stated_sd(stated), found, paths, gauges, alone)


def refuse_impossible(fit: Fit, runs: list[RunData], found: TensionFromMotion | None) -> None:
    """EstimationError where the mass, a missing tension or a gauge cannot be true.

    Parameters
    ----------
    fit : of ``runs``
    runs : the runs, in their order
    found : tension from the motion, or None

    Raises
    ------
    EstimationError : one line with both numbers
    """
    mass = runs[0].mass_kg
    if runs[0].tow.line != "surge" or fit.form != "full" or mass is None:
        return
    if found is not None and found.stated_sd is None and not found.weighed:
        raise EstimationError(
            "tow.tension_n: missing, and these swings are too small to weigh the model: its mass tells the tension to "
            f"{100 * found.log_sd:.0f} % only; measure the tension, or release the model at 6 degrees or more"
        )
    for name, gauge in (found.gauges if found is not None else {}).items():
        if gauge.contradicted:
            raise EstimationError(
                f"tow.tension of run {name!r}: the motion contradicts it: what it reads swings {gauge.scale[0]:.2f} +- "
                f"{gauge.scale[1]:.2f} times as far as what pulls; is it this tow's, and is tension_delay_s right?"
            )
    added, sd = float(fit.six[0]), float(np.sqrt(max(fit.covariance[0, 0], 0.0)))
    if added + 4 * sd < LIGHTEST * mass or added - 4 * sd > HEAVIEST * mass:
        raise EstimationError(
            f"model.mass_kg: {mass:g} kg; the motion gives m - Y_vdot = {added:.4g} +- {sd:.2g} kg, which lies between "
            f"{LIGHTEST:g} and {HEAVIEST:g} times the mass of any hull"
        )


def slack_spells(runs: list[RunData], fit: Fit) -> dict[str, tuple[float, float]]:
    """Runs whose fitted motion would need a line that pushes: name -> first and last time, s. There the equations do not hold.

    Parameters
    ----------
    runs : the runs, in their order
    fit : of ``runs``
    """
    found = {}
    for data, tension in zip(runs, fit.tension_n, strict=False):
        slack = data.t_s[tension <= 0]
        if len(slack):
            found[data.name] = (float(slack[0]), float(slack[-1]))
    return found


def _stated_sd(stated: list[RunData]) -> float | None:
    if not stated:
        return None
    priors = stated[0].priors
    return float(np.hypot(priors.tension_common_sd_rel, priors.tension_sd_rel / np.sqrt(len(stated))))


def _checked(data: RunData, tension: Array, log_sd: float) -> GaugeCheck | None:
    """Straight line of the cell's block means on T from the motion and its slope."""
    blocks: GaugeBlocks | None = gauge_blocks(data)
    if blocks is None or len(blocks.t_s) < 8:
        return None
    clock = data.t_s - data.t_s[0]
    here = np.interp(blocks.t_s, clock, tension)
    slope = np.interp(blocks.t_s, clock, np.gradient(tension, clock))
    mean = float(here.mean())
    rows = np.column_stack([here - mean, np.ones_like(here), -slope])
    if np.std(here) * np.sqrt(len(here)) < SEEN_SWING * blocks.noise_n:
        return None
    inverse = np.linalg.pinv(rows.T @ rows)
    answer = inverse @ rows.T @ blocks.tension_n
    left = blocks.tension_n - rows @ answer
    variance = max(float(left @ left) / (len(here) - 3), blocks.noise_n**2)
    sd = np.sqrt(np.maximum(np.diag(inverse) * variance, 0.0))
    scale_sd = float(np.hypot(sd[0], abs(answer[0]) * log_sd))
    zero = float(answer[1] - answer[0] * mean)
    late = float(answer[2] / answer[0]) if answer[0] else 0.0
    return GaugeCheck(
        (float(answer[0]), scale_sd),
        (zero, float(np.hypot(sd[1], mean * scale_sd))),
        (late, float(sd[2] / max(abs(answer[0]), 1e-3))),
    )


__all__ = ["GaugeCheck", "TensionFromMotion", "refuse_impossible", "slack_spells", "tension_from_motion"]
