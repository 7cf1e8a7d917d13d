"""The budget of X_v from steady tows: what every source does to it, in the fit's own gains (JCGM 100).

X_v is where the line X_T = X_v + k/F begins; its slopes by each tow's angles, pull and tow point are the fit's. The lines sum to
the standard deviation that the fit states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..steady import SteadyFit, SteadyState
from .combine import coverage_factor, effective_degrees
from .components import INFINITE

ALPHA, BETA, PULL, POINT = range(4)
"""Columns of what a steady tow holds."""


@dataclass(frozen=True)
class SteadyLine:
    """What one source does to X_v.

    Attributes
    ----------
    source, name, run : of the line; run "" : of all tows
    evaluation : "A" or "B"
    contribution_m : standard uncertainty of X_v by it
    degrees : of freedom
    origin : where it comes from
    """

    source: str
    name: str
    run: str
    evaluation: str
    contribution_m: float
    degrees: float
    origin: str


@dataclass(frozen=True)
class SteadyBudget:
    """X_v with its sources.

    Attributes
    ----------
    lines : every source that is in it
    outside : source -> why it is in no number
    combined_m, degrees, factor, expanded_m : standard uncertainty, Welch-Satterthwaite's degrees, k, and U = k u for 95 %
    closure : relative difference between the lines, combined, and what the fit states
    """

    lines: tuple[SteadyLine, ...]
    outside: dict[str, str]
    combined_m: float
    degrees: float
    factor: float
    expanded_m: float
    closure: float


def steady_budget(tows: Sequence[SteadyState], fit: SteadyFit) -> SteadyBudget:
    """Sources of the uncertainty of X_v.

    Parameters
    ----------
    tows : as fitted
    fit : of ``fit_steady``

    Examples
    --------
    >>> from towline.identify.steady import SteadyState, fit_steady
    >>> import numpy as np
    >>> frames = np.eye(2) * 1e-8
    >>> tows = [SteadyState(f"at {x}", x, np.arctan(0.1 / (x - 0.2)), 0.0, frames, tow_point_sd_m=1e-3) for x in (0.5, 0.8)]
    >>> found = steady_budget(tows, fit_steady(tows))
    >>> [line.source for line in found.lines], bool(found.closure < 1e-6)
    (['pixels, frame to frame', 'pixels, frame to frame', 'tow point'], True)
    """
    by = fit.by_inputs.reshape(len(tows), 4)
    lines = [*_frames(tows, by), *_cameras(tows, by), *_pulls(tows, by), *_points(tows, by)]
    own = float(sum(line.contribution_m**2 for line in lines))
    if fit.widened > 1:
        rest = float(np.sqrt((fit.widened - 1) * own))
        origin = f"chi-square of the line, {fit.widened:.1f} of 1 expected"
        lines.append(
            SteadyLine("tows off the line", "scatter beyond their errors", "", "A", rest, len(tows) - 2.0, origin)
        )
    parts = np.array([line.contribution_m for line in lines])
    combined = float(np.sqrt((parts**2).sum()))
    degrees = effective_degrees(parts, [line.degrees for line in lines])
    factor = coverage_factor(degrees)
    stated = fit.x_v_m.std
    return SteadyBudget(
        tuple(lines),
        _outside(tows),
        combined,
        degrees,
        factor,
        factor * combined,
        abs(combined / stated - 1) if stated else 0.0,
    )


def _line(source: str, name: str, run: str, evaluation: str, variance: float, origin: str) -> list[SteadyLine]:
    sd = float(np.sqrt(max(variance, 0.0)))
    return [SteadyLine(source, name, run, evaluation, sd, INFINITE, origin)] if sd > 0 else []


def _frames(tows: Sequence[SteadyState], by: np.ndarray) -> list[SteadyLine]:
    found = []
    for tow, slope in zip(tows, by[:, :2], strict=True):
        variance = float(slope @ tow.covariance @ slope)
        origin = "long-run variance of the steady part, and what is left of its swing"
        found += _line("pixels, frame to frame", "mean alpha and beta", tow.name, "A", variance, origin)
    return found


def _cameras(tows: Sequence[SteadyState], by: np.ndarray) -> list[SteadyLine]:
    found = []
    for key in dict.fromkeys((t.common_key, t.common.shape) for t in tows if len(t.common)):
        own = [(t, slope) for t, slope in zip(tows, by[:, :2], strict=True) if (t.common_key, t.common.shape) == key]
        moved = np.sum([t.common @ slope for t, slope in own], axis=0)
        names = "" if len(own) == len(tows) else ", ".join(t.name for t, _ in own)
        origin = "common modes of one camera: datum picks, lens, deck height, marks' places"
        found += _line("camera", f"{len(moved)} common modes", names, "B", float(moved @ moved), origin)
    return found


def _pulls(tows: Sequence[SteadyState], by: np.ndarray) -> list[SteadyLine]:
    """T of each tow, or R where it was not measured; and what the hull resists along itself."""
    scatter = float(sum((slope * t.tension_sd_rel) ** 2 for t, slope in zip(tows, by[:, PULL], strict=True)))
    measured = tows[0].tension_n is not None
    name = "T from tow to tow" if measured else "R from tow to tow, which stands for T"
    found = _line(
        "tension gauge" if measured else "resistance", name, "", "B", scatter, "run.toml [priors] tension_sd_rel"
    )
    moved = np.zeros(2)
    for t, slope in zip(tows, by[:, PULL], strict=True):
        moved += 0.0 if t.along is None else slope * t.along.relative(t.beta_rad)
    for name, one in zip(("resistance_exponent", "x_vv_kg_m"), moved, strict=True):
        found += _line("surge", name, "", "B", float(one**2), "run.toml [priors.surge], or what is usual for the mass")
    return found


def _points(tows: Sequence[SteadyState], by: np.ndarray) -> list[SteadyLine]:
    variance = float(sum((slope * t.tow_point_sd_m) ** 2 for t, slope in zip(tows, by[:, POINT], strict=True)))
    return _line("tow point", "tow_point_m, each tow its own", "", "B", variance, "run.toml [priors] tow_point_sd_m")


def _outside(tows: Sequence[SteadyState]) -> dict[str, str]:
    found = {
        "line length": "in no equation of X_v: alpha is where the tow point is seen from the post",
        "tension gauge, scale": "moves all forces alike, and X_v not at all",
        "density, temperature": "moves all forces alike, and X_v not at all",
    }
    if not any(t.tow_point_sd_m for t in tows):
        found["tow point"] = "taken as exact: [priors] tow_point_sd_m is not stated"
    if not any(t.tension_sd_rel for t in tows):
        found["tension from tow to tow"] = "taken as exact: [priors] tension_sd_rel is not stated"
    return found


__all__ = ["SteadyBudget", "SteadyLine", "steady_budget"]
