"""Where the base fit begins: derivatives of the linear fit, and the measured motion as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, UnivariateSpline

from ...identify import fit_runs
from ...identify.reference import reference_set
from ...record.errors import EstimationError
from ...simulate.model import Array, forward_speed
from ..effects import Effect
from ..inference.hypothesis import Hypothesis, Path, with_effects
from .data import CHANNELS, TowRun
from .model import BEYOND
from .rates import AHEAD, LONGER, SPEED

LINE = CHANNELS.index("line")
FEWEST_BLOCKS = 10
"""Means of the line's length that its course needs: a choice."""

SAMPLES = 250
"""Of a record that the rough start takes, at most about twice so many: a choice."""
LARGEST_SINE = 0.95
"""The sine of the line's angle, computed from measured places, is cut off here: noise may make it exceed 1."""
SMOOTH_S, SMOOTH_ORDER = 3.0, 3
"""A tow's motion is a cubic over so long."""
USUAL_RESISTANCE = 7e-4
"""R over rho/2 Lpp^2 U^2 of a bare model: the MARINER's 4 N at 1.28 m/s."""
UNKNOWN_REL, GAUGED_REL = 1.0, 0.1
"""Of R where nothing is stated, and where a load cell's mean over a swinging tow stands for it."""
SHAKEN = 4.0
"""Marks count as shaken where y and heading both scatter by this many times their stated noise."""


def straight_pull(run: TowRun) -> tuple[float, float]:
    """Tension of a straight tow at the run's speed, N, and how unsure it is at least, relative."""
    data, tow = run.data, run.data.tow
    if not tow.tension_n:
        usual = USUAL_RESISTANCE * 0.5 * run.density_kg_m3 * run.length_pp_m**2 * tow.speed_m_s**2
        return float(usual), UNKNOWN_REL
    gauged = data.tension is not None or getattr(data, "gauge", None) is not None
    return float(tow.tension_n), GAUGED_REL if tow.line == "surge" and gauged else 0.0


def base_hypotheses(runs: Sequence[TowRun], speed_m_s: float) -> list[Hypothesis]:
    """The linear fit of all runs, and a MARINER of the model's length, along the measured motion.

    A line that goes slack can lead the linear fit astray; the other begins within a factor of two. The linear form holds T; what
    surge adds begins at its priors.

    Parameters
    ----------
    runs : as the diagnosis sees them
    speed_m_s : at which forces are quoted
    """
    few = []
    for run in runs:
        data = run.data
        thin = slice(None, None, max(1, len(data.t_s) // SAMPLES))
        few.append(
            replace(
                data,
                tow=replace(data.tow, tension_n=straight_pull(run)[0]),
                t_s=data.t_s[thin],
                y_m=data.y_m[thin],
                beta_rad=data.beta_rad[thin],
                covariance=data.covariance[thin],
                common=data.common[:0, thin],
                tension=None,
                speed=None,
            )
        )
    usual = reference_set("ittc").hull(runs[0].density_kg_m3, runs[0].length_pp_m, speed_m_s).six
    sixes = [np.array(usual)]
    try:
        fitted = fit_runs(few, "linear", speed_m_s).six
    except EstimationError:
        fitted = None
    if fitted is not None and np.isfinite(fitted).all():
        sixes.insert(0, fitted)
    nodes = 2 * (max(len(r.centre_s) for r in runs) + BEYOND) + 1
    found = _along(runs, sixes, np.stack([measured_path(run, nodes) for run in runs], axis=-1))
    scatter = [excess_scatter(run) for run in runs]
    if any((wider > SHAKEN).all() for wider in scatter):
        # marks that shake are no motion: followed no closer than they scatter
        smooth = [measured_path(run, nodes, np.maximum(wider, 1.0)) for run, wider in zip(runs, scatter, strict=True)]
        found += _along(runs, sixes, np.stack(smooth, axis=-1))
    return found


def _along(runs: Sequence[TowRun], sixes: Sequence[Array], states: Array) -> list[Hypothesis]:
    own = []
    for start, run in zip(states[:, 0].T, runs, strict=True):
        tow = run.data.tow
        own.append([*start, 0, 0, straight_pull(run)[0], tow.tow_point_m, tow.line_length_m, tow.speed_m_s, 0, 0])
    return [Hypothesis(six, np.array(own, dtype=float), path=Path((), states)) for six in sixes]


def excess_scatter(run: TowRun) -> Array:
    """Compare the scatter of y and beta about a smooth course with their stated noise.

    Parameters
    ----------
    run : as the diagnosis sees it

    Returns
    -------
    ratio : (2,) root mean square distance from a running cubic over its stated standard deviation; white noise as stated has the
        square root of what the cubic leaves; 1 where there are too few blocks
    """
    from scipy.signal import savgol_filter

    good = np.isfinite(run.values[:, :2]).all(axis=1)
    length = max(2 * round(SMOOTH_S / run.step_s / 2) + 1, SMOOTH_ORDER + 2)
    if good.sum() < length:
        return np.ones(2)
    values = run.values[good, :2]
    about = values - savgol_filter(values, length, SMOOTH_ORDER, axis=0)
    sds = np.sqrt([np.diag(run.covariance[k])[good] for k in (0, 1)]).T
    return np.sqrt((about**2 / sds**2).mean(axis=0))


def measured_path(run: TowRun, nodes: int, wider: Sequence[float] | Array = (1.0, 1.0)) -> Array:
    """(4, nodes) alpha, beta, v, r every half block, from smoothing splines of y and beta; beyond the run its last values.

    ``wider``: how many times as far as their noise y and beta may lie off the splines.

    Parameters
    ----------
    run : as the diagnosis sees it
    nodes : how many
    wider : how many times as far as their noise y and beta may lie off the splines
    """
    tow = run.data.tow
    good = np.isfinite(run.values[:, :2]).all(axis=1)
    t_s = run.centre_s[good]
    at = np.clip(np.arange(nodes) * run.step_s / 2, 0.0, len(run.centre_s) * run.step_s)
    sds = [wider[k] * np.sqrt(np.diag(run.covariance[k])[good]) for k in (0, 1)]
    y, beta = (UnivariateSpline(t_s, run.values[good, k], 1 / sd, s=len(t_s)) for k, sd in enumerate(sds))
    y_cg, y_rate, heading, turn = (np.asarray(f(at)) for f in (y, y.derivative(), beta, beta.derivative()))
    post_y, post_rate = (np.asarray(p) for p in tow.post_motion(at + run.start_s))
    sin_b, cos_b = np.sin(heading), np.cos(heading)
    sine = (y_cg - post_y + tow.tow_point_m * sin_b + tow.tow_point_offset_m * cos_b) / tow.line_length_m
    alpha = np.arcsin(np.clip(sine, -LARGEST_SINE, LARGEST_SINE))
    if tow.line == "constant":  # u = U
        return np.stack([alpha, heading, (y_rate - tow.speed_m_s * sin_b) / cos_b, turn])
    # the tow point's way along its circle gives alpha', and that the sway (2.9)
    across = y_rate - post_rate + (tow.tow_point_m * cos_b - tow.tow_point_offset_m * sin_b) * turn
    sway = across * np.cos(alpha + heading) / np.cos(alpha) - tow.tow_point_m * turn
    sway = sway + post_rate * cos_b - tow.speed_m_s * sin_b
    return np.stack([alpha, heading, sway, turn])


def lawful_hypotheses(runs: Sequence[TowRun], laws: Sequence[Effect], starts: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Lines with a law of their own, along the measured motion: every law from every start's hull.

    Parameters
    ----------
    runs : as the diagnosis sees them
    laws : effects with a law
    starts : of ``base_hypotheses``, with the shared numbers
    """
    nodes = 2 * (max(len(r.centre_s) for r in runs) + BEYOND) + 1
    states = np.stack([paid_path(run, nodes) for run in runs], axis=-1)
    found = []
    for start in starts:
        own = start.own.copy()
        own[:, :4], own[:, LONGER] = states[:4, 0].T, states[4, 0]
        own[:, AHEAD] = states[5, 0] - own[:, SPEED]
        plain = replace(start, own=own, path=Path((), states))
        for law in laws:
            begun = with_effects(plain, [law])
            numbers = np.array([q.none + (0.3 * q.sd if q.one_sided else 0.0) for q in law.parameters])
            found.append(replace(begun, numbers=(numbers,)))
    return found


def paid_path(run: TowRun, nodes: int) -> Array:
    """(6, nodes) alpha, beta, v, r, the line's length beyond the stated one, u, of the measured motion every half block.

    Without pixels nothing says how long the line is: it is taken as stated.

    Parameters
    ----------
    run : as the diagnosis sees it
    nodes : how many
    """
    tow, path = run.data.tow, measured_path(run, nodes)
    radius = run.values[:, LINE]
    good = np.isfinite(radius)
    at = np.clip(np.arange(nodes) * run.step_s / 2, 0.0, len(run.centre_s) * run.step_s)
    if good.sum() < FEWEST_BLOCKS:
        alpha, beta, v, r = path
        u = forward_speed(tow, alpha, beta, v, r, tow.post_motion(at + run.start_s)[1])
        return np.concatenate([path, np.zeros((1, nodes)), np.asarray(u)[None]])
    t_s = run.centre_s[good]

    def spline(values: Array, sd: Array) -> UnivariateSpline:
        return UnivariateSpline(t_s, values, 1 / sd, s=len(t_s))

    sds = [np.sqrt(np.diag(run.covariance[k])[good]) for k in (0, 1, LINE)]
    y, beta, longer = (spline(run.values[good, k], sd) for k, sd in zip((0, 1, LINE), sds, strict=True))
    post_y = np.asarray(tow.post_motion(at + run.start_s)[0])
    heading, turn = np.asarray(beta(at)), np.asarray(beta.derivative()(at))
    sin_b, cos_b = np.sin(heading), np.cos(heading)
    length = tow.line_length_m + np.asarray(longer(at))
    sine = (y(at) - post_y + tow.tow_point_m * sin_b + tow.tow_point_offset_m * cos_b) / length
    alpha = np.arcsin(np.clip(sine, -LARGEST_SINE, LARGEST_SINE))
    x = -length * np.cos(alpha) - tow.tow_point_m * cos_b + tow.tow_point_offset_m * sin_b
    ahead = CubicSpline(at + 1e-9 * np.arange(nodes), x)(at, 1) + tow.speed_m_s
    aside = np.asarray(y.derivative()(at))
    u, v = ahead * cos_b + aside * sin_b, aside * cos_b - ahead * sin_b
    return np.stack([alpha, heading, v, turn, length - tow.line_length_m, u])


__all__ = ["base_hypotheses", "lawful_hypotheses", "measured_path", "paid_path"]
