"""The lines of a budget that the fit itself carries: its noise, and every input that has a prior, each by its gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ...simulate.model import DERIVATIVE_UNITS, Array
from ..colour.leftover import CORNERS_HZ
from ..joint.gauge import gauge_blocks
from ..joint.parameters import ACROSS, ALONG
from ..joint.problem import OWN
from .gains import Gains

Evaluation = Literal["A", "B"]
CAMERA = "camera"
INFINITE = float("inf")
"""Degrees of freedom of an input whose standard uncertainty is taken as known (JCGM 100, G.4.3)."""
RUN_TOML = "run.toml [priors] "


@dataclass(frozen=True)
class Component:
    """One input of the budget.

    Attributes
    ----------
    source : what the line is grouped by
    name : of the input
    run : which run's; empty: common to all
    evaluation : type A or B (JCGM 100, 2.3.2, 2.3.3)
    u, unit : standard uncertainty of the input; None: of many inputs, no single number
    sensitivity : (q,), change of each quantity with one unit more of what is stated; None: of many inputs
    covariance : (q, q), what it adds to the quantities' covariance
    degrees : of freedom of u
    origin : where u comes from
    status : "fit" (in the fit's own standard deviation), "added" to it, or "not included" (no u: nothing is added)
    """

    source: str
    name: str
    run: str
    evaluation: Evaluation
    u: float | None
    unit: str
    sensitivity: Array | None
    covariance: Array
    degrees: float
    origin: str
    status: Literal["fit", "added", "not included"] = "fit"

    @property
    def included(self) -> bool:
        """It is in the combined uncertainty."""
        return self.status != "not included"

    def known(self, u: float, evaluation: Evaluation, degrees: float, origin: str) -> Component:
        """The line of an input that the fit takes as exact, now that its standard uncertainty is stated.

        Parameters
        ----------
        u : in the line's unit
        evaluation : type A or B
        degrees : of freedom of u
        origin : where u comes from

        Raises
        ------
        ValueError : the line is in the fit already, or has no sensitivity
        """
        if self.included or self.sensitivity is None:
            raise ValueError(f"{self.source}, {self.name}: nothing to add")
        covariance = u**2 * np.outer(self.sensitivity, self.sensitivity)
        return replace(
            self, u=u, evaluation=evaluation, degrees=degrees, origin=origin, covariance=covariance, status="added"
        )


@dataclass(frozen=True)
class ModeOrigin:
    """What some of a camera's common modes come from.

    Attributes
    ----------
    source, name : as in ``Component``
    weight : (k, k), its share of the modes' covariance, which is 1; the shares of a camera sum to the unit matrix
    u, unit : of the input behind, where it is a single one, or of each of many
    origin, evaluation, degrees : as in ``Component``
    mode : which mode it is, where it is a single one
    """

    source: str
    name: str
    weight: Array
    origin: str
    u: float | None = None
    unit: str = ""
    evaluation: Evaluation = "B"
    degrees: float = INFINITE
    mode: int | None = None


@dataclass
class _Lines:
    """Gathers components."""

    gains: Gains
    found: list[Component] = field(default_factory=list)

    def single(
        self,
        source: str,
        name: str,
        run: str,
        u: float,
        unit: str,
        moved: Array,
        origin: str,
        degrees: float = INFINITE,
    ) -> None:
        """An input whose standard uncertainty moves the quantities by ``moved``."""
        self.found.append(
            Component(source, name, run, "B", u, unit, moved / u, np.outer(moved, moved), degrees, origin)
        )

    def many(self, source: str, name: str, run: str, evaluation: Evaluation, covariance: Array, **more: object) -> None:
        """Inputs that have no single number; ``more``: u, unit, degrees, origin."""
        told = {"u": None, "unit": "", "degrees": INFINITE, "origin": ""} | more
        self.found.append(
            Component(source, name, run, evaluation, sensitivity=None, covariance=covariance, **told)  # pyright: ignore[reportArgumentType]
        )


def components_of(gains: Gains, modes: Mapping[str, Sequence[ModeOrigin]]) -> list[Component]:
    """Every line that the fit carries; their covariances sum to the fit's.

    Parameters
    ----------
    gains : of the fit
    modes : key of common modes -> where they come from; a key that is not there is one line
    """
    lines = _Lines(gains)
    _noise(lines)
    _pulls(lines)
    _gauges(lines)
    _modes(lines, modes)
    if gains.problem.gyration is not None:
        _, sd = gains.problem.gyration
        six = gains.theta[:6]
        moved = gains.rows[:, :2] @ (np.array([-six[1] / six[0], 1.0]) / six[0] / sd)
        lines.single("stated derivatives", "k2_m2", "", sd, "m2", moved, f"{RUN_TOML}derivatives.k2_m2")
    return lines.found


# noise ----------------------------------------------------------------------------------------------------------------


def _noise(lines: _Lines) -> None:
    """Noise of the picture, as if it were white with the scatter it has, and what its colour adds.

    Degrees of freedom: a run's noise at the swing's frequency is read from n samples by a spectrum of p coefficients, whose
    relative variance is 2 p/n (Berk, Annals of Statistics 2, 1974), so that it has n/p degrees, n where it is white. Slow noise
    that is left is read from the residuals' periodogram, 2 degrees an ordinate below the corner that it shows. What the fit takes
    of them, the trace of its covariance with what the motion says, is off.
    """
    gains = lines.gains
    size = len(gains.rows)
    white, colour, slow = (np.zeros((size, size)) for _ in range(3))
    degrees, looks, taken = 0.0, 0.0, 0.0
    size_of = gains.informed.slow.size
    corner_hz = float(size_of @ CORNERS_HZ / size_of.sum()) if size_of.any() else min(CORNERS_HZ)
    for data, answer, weight, run, meat in zip(
        gains.runs, gains.answers, gains.weights, gains.informed.white, gains.informed.meat, strict=True
    ):
        rows = gains.of_score(answer.columns)
        told = sum((j @ j.T for j in run.slope), np.zeros((len(answer.columns), len(answer.columns))))
        whole = rows @ told @ rows.T
        taken += float(np.trace(gains.informed.inverse.of(answer.columns) @ told))
        plain = weight.uncoloured(run.slope)
        as_white = rows @ (plain[0] @ plain[0].T + plain[1] @ plain[1].T) @ rows.T
        white += as_white
        colour += whole - as_white
        slow += rows @ meat @ rows.T
        samples = len(data.t_s)
        degrees += sum(samples / max(len(a), 1) for a in weight.regression)
        looks += 2 * 2 * corner_hz * (data.t_s[-1] - data.t_s[0])
    degrees, looks = max(degrees - taken, 1.0), max(looks - taken, 1.0)
    scatter = np.sqrt(np.mean([np.mean(e**2, axis=0) for e in (a.residual.T for a in gains.answers)], axis=0))
    over = np.sqrt(np.mean([w.scale**2 for w in gains.weights], axis=0))
    stated = "which states none" if any(d.assumed_sigma for d in gains.runs) else "that the motion states"
    said = (
        f"residuals of all runs: y {1e3 * scatter[0]:.3g} mm, beta {np.degrees(scatter[1]):.3g} deg rms, "
        f"{over[0]:.2f} and {over[1]:.2f} of the sigma {stated}"
    )
    frames = "pixels, frame to frame"
    more = {"u": float(scatter[0]), "unit": "m", "degrees": degrees}
    if (np.diag(colour) < 0).any():
        lines.many(frames, "noise with its colour", "", "A", white + colour, origin=said, **more)
    else:
        lines.many(frames, "noise as if white", "", "A", white, origin=said, **more)
        if colour.any():
            orders = [len(a) for w in gains.weights for a in w.regression]
            lines.many(
                "codec and slow noise", "colour of the noise", "", "A", colour, degrees=degrees,
                origin=f"residuals: autoregressions of order {min(orders)} to {max(orders)}",
            )  # fmt: skip
    if slow.any():
        lines.many(
            "codec and slow noise", "slow noise left after whitening", "", "A", slow, degrees=looks,
            origin=f"periodogram of the whitened residuals; none with probability {gains.informed.slow.none_p:.2f}",
        )  # fmt: skip


# what has a prior -----------------------------------------------------------------------------------------------------


def _pulls(lines: _Lines) -> None:
    gains, problem = lines.gains, lines.gains.problem
    modes = {k for at in problem.mode_at.values() for k in range(at.start, at.stop)}
    common = {problem.common_at[c.name]: c for c in problem.commons}
    for at, sd in zip(problem.pull.index.tolist(), problem.pull.sd.tolist(), strict=True):
        if at in modes or not problem.free[at]:
            continue
        moved = gains.rows[:, at] / sd
        if at < 6:
            name, unit = list(DERIVATIVE_UNITS.items())[at]
            lines.single("stated derivatives", name, "", sd, unit, moved, f"{RUN_TOML}derivatives.{name}")
        elif at in common:
            _common(lines, common[at].name, float(common[at].sd[0]), moved)
        else:
            run, which = divmod(at - 6, len(OWN))
            _own(lines, OWN[which], gains.runs[run].name, sd, moved)


def _common(lines: _Lines, name: str, sd: float, moved: Array) -> None:
    if name == "tension":
        lines.single(
            "tension gauge", "scale common to all runs", "", sd, "1", moved, f"{RUN_TOML}tension_common_sd_rel"
        )
    elif name == "line_length":
        usual = lines.gains.runs[0].priors.line_is_usual
        origin = "usual: rule, knots and the line's stretch" if usual else f"{RUN_TOML}line_length_sd_m"
        lines.single("line length", "line_length_m", "", sd, "m", moved, origin)
    elif name == "speed":
        lines.single("speed", "speed_m_s", "", sd, "m/s", moved, f"{RUN_TOML}speed_sd_rel")
    elif name in ALONG:
        lines.single("surge", name, "", sd, _UNITS[name], moved, _surge_origin(lines.gains, name))
    elif name in ACROSS:
        lines.single("rudder and asymmetry", name, "", sd, _UNITS[name], moved, _across_origin(lines.gains, name))


_UNITS = {
    "x_udot_kg": "kg",
    "x_vr_kg": "kg",
    "x_vv_kg_m": "kg/m",
    "x_rr_kg_m": "kg m",
    "resistance_exponent": "1",
    "y_delta": "N/rad",
    "n_delta": "N m/rad",
    "y_bias_n": "N",
    "n_bias_n_m": "N m",
}


def _surge_origin(gains: Gains, name: str) -> str:
    said = getattr(gains.runs[0].priors.surge, name) is not None
    return f"{RUN_TOML}surge.{name}" if said else "usual for bare models of this mass (theory.md 10)"


def _across_origin(gains: Gains, name: str) -> str:
    said = getattr(gains.runs[0].priors.derivatives, name) is not None
    return f"{RUN_TOML}derivatives.{name}" if said else "nothing is known: nine times a usual rudder's"


def _own(lines: _Lines, what: str, run: str, sd: float, moved: Array) -> None:
    said = {
        "tension": ("tension gauge", "tension_n", "N", "tension_sd_rel"),
        "tow_point": ("tow point", "tow_point_m", "m", "tow_point_sd_m"),
        "y_b": ("datum biases", "y_b_m", "m", "y_bias_sd_m"),
        "beta_b": ("datum biases", "beta_b_rad", "rad", "beta_bias_sd_rad"),
    }
    source, name, unit, prior = said[what]
    lines.single(source, name, run, sd, unit, moved, RUN_TOML + prior)


def _gauges(lines: _Lines) -> None:
    """A load cell's history: noise of its block means, scale, zero, delay, as ``joint.gauge`` weighs them."""
    gains = lines.gains
    for data, answer in zip(gains.runs, gains.answers, strict=True):
        blocks = gauge_blocks(data)
        if answer.gauge is None or blocks is None:
            continue
        gain = gains.of_score(answer.columns) @ answer.gauge[1] @ blocks.white
        priors = data.priors
        for name, u, unit, key in (
            ("scale of the history", priors.tension_sd_rel, "1", "tension_sd_rel"),
            ("zero of the history", priors.tension_zero_sd_n, "N", "tension_zero_sd_n"),
            ("delay of the history", priors.tension_delay_sd_s, "s", "tension_delay_sd_s"),
        ):
            if u:
                lines.single("tension gauge", name, data.name, u, unit, gain @ blocks.shapes[key], RUN_TOML + key)
        lines.many(
            "tension gauge", "noise of the history", data.name, "A", blocks.noise_n**2 * gain @ gain.T,
            u=blocks.noise_n, unit="N", degrees=float(max(len(blocks.t_s) - 3, 1)),
            origin="third differences of the history's block means",
        )  # fmt: skip


def _modes(lines: _Lines, modes: Mapping[str, Sequence[ModeOrigin]]) -> None:
    gains, problem = lines.gains, lines.gains.problem
    lags = {d.lag_key for d in gains.runs}
    for key, at in problem.mode_at.items():
        rows = gains.rows[:, at]
        of = [d.name for d in gains.runs if any(k == key for k, _ in d.shared)]
        whose = "" if len(of) == len(gains.runs) else ", ".join(of)
        of = [d.name for d in gains.runs if any(k == key for k, _ in d.shared)]
        whose = "" if len(of) == len(gains.runs) else ", ".join(of)
        usual = "codec, pixel phase and surroundings" if key in lags else CAMERA
        whole = ModeOrigin(usual, "common modes, all together", np.eye(rows.shape[1]), "motion's own common error")
        for part in modes.get(key) or (whole,):
            one = rows @ part.weight @ rows.T
            if part.mode is not None and part.u:
                # what is stated more moves the marks' places as the mode does, and the fit finds so much less of it
                component = Component(
                    part.source, part.name, whose, part.evaluation, part.u, part.unit, -rows[:, part.mode] / part.u, one,
                    part.degrees, part.origin,
                )  # fmt: skip
                lines.found.append(component)
            else:
                lines.many(
                    part.source, part.name, whose, part.evaluation, one, u=part.u, unit=part.unit, degrees=part.degrees,
                    origin=part.origin,
                )  # fmt: skip


__all__ = ["CAMERA", "INFINITE", "Component", "ModeOrigin", "components_of"]
