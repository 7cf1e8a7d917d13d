"""Where the base fit begins: derivatives of the linear fit, and the measured motion as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import UnivariateSpline

from ...identify import fit_runs
from ...identify.reference import reference_set
from ...record.errors import EstimationError
from ...simulate.model import Array, Tow, full_x_cg_rate
from ..effects import Effect
from ..inference.hypothesis import Hypothesis, Path, with_effects
from .channels import CHANNELS
from .columns import AHEAD, LONGER, SPEED, STATES, own_numbers
from .model import BEYOND
from .tow_run import TowRun

Y, BETA, LINE = (CHANNELS.index(name) for name in ("y", "beta", "line"))
BEGUN = 0.3
"""Of its usual size: where a one-sided number of a law begins."""
SAMPLES = 250
"""Of a record that the rough start takes, at most about twice so many: a choice."""
MOST_UNLIKE = 30.0
"""A linear fit whose mass or moment of inertia is so many times that of a MARINER so long, or less by as much, is no hull's: barges
have six times a MARINER's mass."""
LARGEST_SINE = 0.95
"""The sine of the line's angle, computed from measured places, is cut off here: noise may make it exceed 1."""
SMOOTH_S, SMOOTH_ORDER = 3.0, 3
"""A tow's motion is a cubic over so long."""
USUAL_RESISTANCE = 7e-4
"""R over rho/2 Lpp^2 U^2 of a bare model: the MARINER's 4 N at 1.28 m/s."""
UNKNOWN_REL, GAUGED_REL = 1.0, 0.1
"""Of R where nothing is stated, and where a load cell's mean over a swinging tow stands for it."""
SHAKEN, SHAKEN_S = 4.0, 5.0
"""Marks count as shaken where y or heading scatters by this many times its stated noise, for so long."""


def straight_pull(run: TowRun) -> tuple[float, float]:
    """Tension of a straight tow at the run's speed, N, and how unsure it is at least, relative."""
    data, tow = run.data, run.data.tow
    if not tow.tension_n:
        usual = USUAL_RESISTANCE * 0.5 * run.density_kg_m3 * run.length_pp_m**2 * tow.speed_m_s**2
        return float(usual), UNKNOWN_REL
    gauged = data.tension is not None or getattr(data, "gauge", None) is not None
    return float(tow.tension_n), GAUGED_REL if tow.line == "surge" and gauged else 0.0


def settings_of(run: TowRun) -> dict[str, float]:
    """A run's own numbers as stated: tension of a straight tow, tow point, line and speed."""
    tow = run.data.tow
    return {
        "tension": straight_pull(run)[0],
        "tow_point": tow.tow_point_m,
        "line": tow.line_length_m,
        "speed": tow.speed_m_s,
    }


def base_hypotheses(runs: Sequence[TowRun], speed_m_s: float) -> list[Hypothesis]:
    """The linear fit of all runs, and a MARINER of the model's length, along the measured motion.

    A line that goes slack can lead the linear fit astray; the other begins within a factor of two. The linear form holds T; what
    surge adds begins at its priors. A line that is not as long as stated can lead it so far that nothing comes back (MOST_UNLIKE).

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
    if fitted is not None and np.isfinite(fitted).all() and _like(fitted, sixes[0]):
        sixes.insert(0, fitted)
    nodes = 2 * (max(len(r.centre_s) for r in runs) + BEYOND) + 1
    found = _along(runs, sixes, np.stack([measured_path(run, nodes) for run in runs], axis=-1))
    scatter = [excess_scatter(run) for run in runs]
    if any((wider > SHAKEN).any() for wider in scatter):
        # marks that shake are no motion: followed no closer than they scatter
        smooth = [measured_path(run, nodes, np.maximum(wider, 1.0)) for run, wider in zip(runs, scatter, strict=True)]
        found += _along(runs, sixes, np.stack(smooth, axis=-1))
    return found


def _like(six: Array, usual: Array) -> bool:
    """Whether it has a hull's inertia."""
    ratio = six[:2] / usual[:2]
    return bool(((ratio > 1 / MOST_UNLIKE) & (ratio < MOST_UNLIKE)).all())


def _along(runs: Sequence[TowRun], sixes: Sequence[Array], states: Array) -> list[Hypothesis]:
    own = np.array([own_numbers(**settings_of(run)) for run in runs])
    own[:, :STATES] = states[:, 0].T
    return [Hypothesis(six, own, path=Path((), states)) for six in sixes]


def excess_scatter(run: TowRun) -> Array:
    """Compare the scatter of y and beta about a smooth course with their stated noise.

    Parameters
    ----------
    run : as the diagnosis sees it

    Returns
    -------
    ratio : (2,) root mean square distance from a running cubic over its stated standard deviation, over the ``SHAKEN_S`` where it
        is largest: a model that rolls when it is let go shakes its marks for a while. White noise as stated has about 1; 1 where
        there are too few blocks
    """
    from scipy.signal import savgol_filter

    good = np.isfinite(run.values[:, :2]).all(axis=1)
    length = max(2 * round(SMOOTH_S / run.step_s / 2) + 1, SMOOTH_ORDER + 2)
    if good.sum() < length:
        return np.ones(2)
    values = run.values[good, :2]
    about = values - savgol_filter(values, length, SMOOTH_ORDER, axis=0)
    sds = np.sqrt([np.diag(run.covariance[k])[good] for k in (0, 1)]).T
    window = np.ones(min(max(round(SHAKEN_S / run.step_s), 1), len(about)))
    return np.sqrt(np.max([np.convolve(s, window / len(window), "valid") for s in (about**2 / sds**2).T], axis=1))


def measured_path(run: TowRun, nodes: int, wider: Sequence[float] | Array = (1.0, 1.0)) -> Array:
    """(4, nodes) alpha, beta, v, r every half block, from smoothing splines of y and beta; beyond the run its last values.

    A model that is further from the post's track than its line is long is at the end of a longer one: as long as it is seen to be.

    Parameters
    ----------
    run : as the diagnosis sees it
    nodes : how many
    wider : how many times as far as their noise y and beta may lie off the splines
    """
    tow, found = run.data.tow, _followed(run, nodes, (Y, BETA), wider)
    length, beyond = tow.line_length_m, run.values[:, LINE]
    if (np.abs(found.sine(length)) > LARGEST_SINE).any() and np.isfinite(beyond).sum() > SMOOTH_ORDER:
        length = length + _followed(run, nodes, (LINE,)).at(LINE)
    alpha = found.angle(length)
    if tow.line == "constant":  # u = U
        sway = (found.rate(Y) - tow.speed_m_s * found.sin_b) / found.cos_b
    else:
        # the tow point's way along its circle gives alpha', and that the sway (2.9)
        sway = found.across * np.cos(alpha + found.at(BETA)) / np.cos(alpha) - tow.tow_point_m * found.rate(BETA)
        sway = sway + found.post_rate * found.cos_b - tow.speed_m_s * found.sin_b
    return np.stack([alpha, found.at(BETA), sway, found.rate(BETA)])


@dataclass(frozen=True)
class _Followed:
    """A measured motion at the nodes, by smoothing splines.

    Attributes
    ----------
    tow : as stated
    at_s : (nodes,); beyond the run its end
    splines : channel -> its course
    post_y, post_rate : of the tow post, m and m/s
    """

    tow: Tow
    at_s: Array
    splines: dict[int, UnivariateSpline]
    post_y: Array
    post_rate: Array

    def at(self, channel: int) -> Array:
        return np.asarray(self.splines[channel](self.at_s))

    def rate(self, channel: int) -> Array:
        return np.asarray(self.splines[channel].derivative()(self.at_s))

    @property
    def sin_b(self) -> Array:
        return np.sin(self.at(BETA))

    @property
    def cos_b(self) -> Array:
        return np.cos(self.at(BETA))

    def sine(self, length_m: Any) -> Array:
        """Of the angle of a line so long; beyond 1 where it does not reach."""
        point = self.tow.tow_point_m * self.sin_b + self.tow.tow_point_offset_m * self.cos_b
        return (self.at(Y) - self.post_y + point) / length_m

    def angle(self, length_m: Any) -> Array:
        """The line's, of a line so long."""
        return np.arcsin(np.clip(self.sine(length_m), -LARGEST_SINE, LARGEST_SINE))

    @property
    def across(self) -> Array:
        """Speed of the tow point across the tank, seen from the post."""
        arm = self.tow.tow_point_m * self.cos_b - self.tow.tow_point_offset_m * self.sin_b
        return self.rate(Y) - self.post_rate + arm * self.rate(BETA)


def _followed(
    run: TowRun, nodes: int, channels: Sequence[int], wider: Sequence[float] | Array = (1.0, 1.0, 1.0)
) -> _Followed:
    good = np.isfinite(run.values[:, list(channels)]).all(axis=1)
    t_s = run.centre_s[good]
    at = np.clip(np.arange(nodes) * run.step_s / 2, 0.0, len(run.centre_s) * run.step_s)
    splines = {}
    for k, share in zip(channels, wider, strict=False):
        sd = share * np.sqrt(np.diag(run.covariance[k])[good])
        splines[k] = UnivariateSpline(t_s, run.values[good, k], 1 / sd, s=len(t_s))
    post_y, post_rate = (np.asarray(p) for p in run.data.tow.post_motion(at + run.start_s))
    return _Followed(run.data.tow, at, splines, post_y, post_rate)


def lawful_hypotheses(
    runs: Sequence[TowRun], laws: Sequence[Effect], starts: Sequence[Hypothesis]
) -> list[list[Hypothesis]]:
    """Lines with a law of their own, along the measured motion: of every start's hull, every law.

    Parameters
    ----------
    runs : as the diagnosis sees them
    laws : effects with a law
    starts : with the shared numbers
    """
    nodes = 2 * (max(len(r.centre_s) for r in runs) + BEYOND) + 1
    states = np.stack([paid_path(run, nodes) for run in runs], axis=-1)
    found = []
    for start in starts:
        own = start.own.copy()
        own[:, :STATES], own[:, LONGER] = states[:STATES, 0].T, states[STATES, 0]
        own[:, AHEAD] = states[STATES + 1, 0] - own[:, SPEED]
        plain = replace(start, own=own, path=Path((), states))
        begun = [np.array([q.none + (BEGUN * q.sd if q.one_sided else 0.0) for q in law.parameters]) for law in laws]
        found.append([replace(with_effects(plain, [law]), numbers=(n,)) for law, n in zip(laws, begun, strict=True)])
    return found


def paid_path(run: TowRun, nodes: int) -> Array:
    """(6, nodes) alpha, beta, v, r, the line's length beyond the stated one, u, of the measured motion every half block.

    Parameters
    ----------
    run : as the diagnosis sees it, with the line's radius
    nodes : how many
    """
    tow, found = run.data.tow, _followed(run, nodes, (Y, BETA, LINE))
    longer, heading, turn = found.at(LINE), found.at(BETA), found.rate(BETA)
    now = replace(tow, line_length_m=tow.line_length_m + longer)
    alpha = found.angle(now.line_length_m)
    # the tow point's way across the tank is the line's turning and its lengthening
    line_turn = (found.across - found.rate(LINE) * np.sin(alpha)) / (now.line_length_m * np.cos(alpha))
    ahead = tow.speed_m_s + full_x_cg_rate(alpha, heading, line_turn, turn, now) - np.cos(alpha) * found.rate(LINE)
    aside = found.rate(Y)
    u, v = ahead * found.cos_b + aside * found.sin_b, aside * found.cos_b - ahead * found.sin_b
    return np.stack([alpha, heading, v, turn, longer, u])


__all__ = ["base_hypotheses", "lawful_hypotheses", "measured_path", "paid_path", "settings_of"]
