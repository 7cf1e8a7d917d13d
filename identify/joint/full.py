"""The full equations' response and its exact sensitivities: classical Runge-Kutta, all steps at once.

The path is found by Newton's method on all steps together: every step of every run is taken from a guess of its begin, side by
side, with its derivatives; a recursion of 4 x 4 matrices then carries what each step lacks to the next. The answer is that
of the step-by-step method, with its sensitivities, in two or three passes; where Newton fails, the steps go one by one.

Step h = 0.05 s at most: Runge-Kutta and the cubic interpolation between steps err by about 1e-6 of the amplitude.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...simulate.model import Array, full_rates, full_y_cg, full_y_cg_rate
from ..data import RunData
from .guess import Guess, Path
from .hermite import between_steps
from .linear import linear_paths
from .parameters import EVERY, LINE_LENGTH, STEEPEST_RAD, TOW_POINT
from .partials import TURNING
from .setting import Setting, setting_of

STATES = range(6, 10)
"""Where a run's begin (alpha, beta, v, r) stands among the parameters."""
PASSES = 12
"""Newton steps of a whole path at most; one that needs more is said not to settle."""
BROADSIDE_RAD = np.pi / 2
"""Line angle alpha + beta on the model at which the equations of motion end (theory.md 9.1)."""
AT_ONCE = 48000
"""Numbers in a row of the sensitivities of one go."""
COARSE = 4
"""Steps in one where the path is looked for step by step."""
CLOSE_ENOUGH = 1e-4
"""Sensitivities are kept when the path's next Newton step is smaller than this (rad, m/s, rad/s): they are then right to one in
ten thousand ..."""
LEADING = 1e-3
"""... or than this where they only lead near the optimum."""
CONVERGED = 1e-6
"""Newton's method ends when no state changes by more than this: the next step is of its square."""


def full_paths(
    runs: list[RunData],
    values: Array,
    reference_speed_m_s: float,
    wanted: tuple[int, ...] = EVERY,
    guess: Path | None = None,
    rough: bool = False,
) -> tuple[list[tuple[Array, Array]], Guess]:
    """(y, beta) of all runs at their samples with sensitivities, all runs side by side.

    Parameters
    ----------
    runs : the runs, in their order
    values : (runs, ``COUNT``), ``RUN_PARAMETERS``; side = alpha rad. With lines of given tension the first 14 will do
    reference_speed_m_s : at which the derivatives are quoted, m/s
    wanted : parameters whose sensitivities are asked for, rising
    guess : of an earlier call, with other values, on another grid or for other priors; makes it faster
    rough : longer steps

    Returns
    -------
    per run response (2, n) and sensitivity (2, len(wanted), n); and the guess for the next call.
    NaN where the motion leaves the equations' range (alpha + beta beyond 90 degrees)
    """
    setting = setting_of(runs, values, reference_speed_m_s, rough)
    enough = LEADING if rough and guess is not None else CLOSE_ENOUGH
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        path, far = _first_path(runs, values, reference_speed_m_s, setting, guess)
        solved = _newton(setting, values, path, wanted, enough, far)
        if solved is None:
            path = _one_by_one(setting, values)
            solved = _newton(setting, values, path, wanted, enough, np.inf) if np.isfinite(path).all() else None
        if solved is None:
            nothing = [(np.full((2, len(d.t_s)), np.nan), np.zeros((2, len(wanted), len(d.t_s)))) for d in runs]
            stale = np.full((4, setting.count + 1, len(runs)), np.nan)
            return nothing, Guess(setting.step, values, stale, stale, stale[:, None][:, :0], ())
        path, moved = solved
        everywhere = slice(0, setting.count + 1)
        gauged = setting.tow.line == "surge" and any(d.gauge is not None for d in runs)
        asked = wanted if gauged else tuple(p for p in wanted if p in TURNING)
        ends = setting.linearised(0, path, asked, everywhere, gauged)
        turns = ends.turn_along(moved, wanted)
        answers = [_sampled(d, i, setting, values, path, moved, ends.rates, turns, wanted) for i, d in enumerate(runs)]
        pulled = ends.tension_along(moved, wanted) if gauged else None
        tension = np.broadcast_to(ends.tension_n, path.shape[1:])
    return answers, Guess(setting.step, values, path, ends.rates, moved, wanted, tension, pulled)


def _first_path(
    runs: list[RunData], values: Array, reference: float, setting: Setting, guess: Path | None
) -> tuple[Array, float]:
    """The earlier path moved along its sensitivities, and how far (rad, m/s, rad/s); or the linear form's."""
    if guess is not None and guess.states.shape[2] == len(runs):
        path, far = guess.on(setting.step, setting.count), 0.0 if np.array_equal(values, guess.values) else np.inf
        if isinstance(guess, Guess) and guess.wanted and path is not None and path.shape == guess.states.shape:
            change = (values - guess.values)[:, list(guess.wanted)]
            shift = np.einsum("spnr,rp->snr", guess.moved, change)
            path, far = path + shift, float(np.abs(shift).max())
        if path is not None and np.isfinite(path).all() and np.abs(path[0] + path[1]).max() < STEEPEST_RAD:
            path = path.copy()
            path[:, 0] = values[:, 6:10].T
            return path, far
    times = np.arange(setting.count + 1) * setting.step
    grids = [replace(d, t_s=times) for d in runs]
    start = values.copy()
    offset = np.array([d.tow.tow_point_offset_m for d in runs])
    side = values[:, LINE_LENGTH] * np.sin(values[:, 6]) - values[:, TOW_POINT] * np.sin(values[:, 7]) - offset
    start[:, 6] = side
    motion = np.stack([p for p, _ in linear_paths(grids, start, reference, (), 4)], axis=2)
    y, beta = motion[0], motion[1]
    reach = (y + values[:, TOW_POINT] * np.sin(beta) + offset) / values[:, LINE_LENGTH]
    motion[0] = np.arcsin(np.clip(np.nan_to_num(reach), -0.95, 0.95))
    motion[1:] = np.clip(np.nan_to_num(motion[1:]), -1, 1)
    broad = np.abs(motion[0] + motion[1]) > 1.3
    motion[1][broad] = np.sign(motion[0][broad]) * 1.3 - motion[0][broad]
    motion[:, 0] = values[:, 6:10].T
    return motion, np.inf


def _newton(
    setting: Setting, values: Array, path: Array, wanted: tuple[int, ...], enough: float, far: float
) -> tuple[Array, Array] | None:
    """Path and sensitivities (4, wanted, steps + 1, runs), or None where it does not settle.

    ``far``: how far the path may be off, rad, m/s, rad/s; ``enough``: how near it must be for the sensitivities to be kept.
    """
    known = None
    for _ in range(PASSES):
        # a pass leaves about the square of what was lacking; one that hardly moves the path takes the sensitivities along
        asked = wanted if known is None and far**2 < enough else ()
        moving = tuple(p for p in asked if p not in STATES)
        end, map_ = _steps(setting, path[:, :-1], moving)
        lacking = end - path[:, 1:]
        if not np.isfinite(lacking).all() or not np.isfinite(map_).all():
            return None
        carried = _carry(map_, lacking, values, asked)
        move = carried[:, 0]
        size = float(np.abs(move).max())
        if not np.isfinite(size) or size > 20.0:
            return None
        # far from the path a whole move may overshoot: the angles move by half a radian at most
        share = min(1.0, 0.5 / max(float(np.abs(move[:2]).max()), 1e-300))
        path = path + share * move
        if asked == wanted and size < enough:
            known = carried[:, 1:]
        if size < CONVERGED and known is not None:
            return path, known
        far = size
    return None


def _steps(setting: Setting, begin: Array, wanted: tuple[int, ...]) -> tuple[Array, Array]:
    """Every step from its own begin: its end (4, steps, runs) and its derivatives (4, 4 + wanted, steps, runs); ``wanted``: none of
    the path's begin."""
    columns, runs = 4 + len(wanted), begin.shape[2]
    end, slope = np.empty_like(begin), np.empty((4, columns, *begin.shape[1:]))
    together = max(1, AT_ONCE // (columns * runs))
    for first in range(0, begin.shape[1], together):
        here = slice(first, min(first + together, begin.shape[1]))
        end[:, here], slope[:, :, here] = _some_steps(setting, begin[:, here], wanted, here)
    return end, slope


def _some_steps(setting: Setting, begin: Array, wanted: tuple[int, ...], select: slice) -> tuple[Array, Array]:
    """``_steps`` of some of the steps: as many as a processor's cache holds."""
    h = setting.step
    first = np.zeros((4, 4 + len(wanted), *begin.shape[1:]))
    for i in range(4):
        first[i, i] = 1.0

    def stage(part: int, state: Array, moved: Array) -> tuple[Array, Array]:
        found = setting.linearised(part, state, wanted, select)
        return found.rates, found.along(moved, 4, wanted)

    found = setting.linearised(0, begin, wanted, select)
    k1, d1 = found.rates, found.alone(wanted)
    k2, d2 = stage(1, begin + h / 2 * k1, first + h / 2 * d1)
    k3, d3 = stage(1, begin + h / 2 * k2, first + h / 2 * d2)
    k4, d4 = stage(2, begin + h * k3, first + h * d3)
    end = begin + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    d2 += d3
    d2 *= 2
    d2 += d1
    d2 += d4
    d2 *= h / 6
    d2 += first
    return end, d2


def _carry(map_: Array, lacking: Array, values: Array, wanted: tuple[int, ...]) -> Array:
    """s_(k+1) = M_k s_k + b_k for what the path lacks (column 0) and each parameter, (4, 1 + wanted, steps + 1, runs)."""
    steps, runs = map_.shape[2:]
    matrix = np.ascontiguousarray(map_[:, :4].transpose(2, 3, 0, 1))
    added = np.empty((steps, runs, 4, 1 + len(wanted)))
    added[..., 0] = lacking.transpose(1, 2, 0)
    state = np.zeros((steps + 1, runs, 4, 1 + len(wanted)))
    column = 4
    for at, index in enumerate(wanted, start=1):
        if index in STATES:  # only the first step begins elsewhere
            added[..., at] = 0.0
            state[0, :, STATES.index(index), at] = 1.0
        else:
            added[..., at] = map_[:, column].transpose(1, 2, 0)
            column += 1
    here = state[0]
    for k in range(steps):
        here = np.matmul(matrix[k], here, out=state[k + 1])
        here += added[k]
    return state.transpose(2, 3, 0, 1)


def _one_by_one(setting: Setting, values: Array) -> Array:
    """A path for Newton step by step, with longer steps; NaN from where a run goes broadside."""
    h = COARSE * setting.step
    nodes = np.arange(0, setting.count + COARSE, COARSE)
    path = np.full((4, len(nodes), len(values)), np.nan)
    state = values[:, 6:10].T.copy()
    for k in range(len(nodes)):
        if not np.abs(state[0] + state[1]).max() < BROADSIDE_RAD:
            break
        path[:, k] = state
        begin = min(COARSE * k, setting.count)
        at = [setting.at(part, slice(begin, begin + 1)) for part in (0, COARSE, 2 * COARSE)]

        def rates(part: int, here: Array, at=at) -> Array:
            (t, hull, tow), now = at[part], here[:, None]
            more = None if setting.missing is None else setting.missing(t, now, tow)
            return full_rates(t, now, hull, tow, None if more is None else lambda *_: more)[:, 0]

        k1 = rates(0, state)
        k2 = rates(1, state + h / 2 * k1)
        k3 = rates(1, state + h / 2 * k2)
        k4 = rates(2, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    share = np.arange(setting.count + 1) / COARSE
    node = np.minimum(share.astype(int), len(nodes) - 2)
    part = (share - node)[:, None]
    return path[:, node] * (1 - part) + path[:, node + 1] * part


def _sampled(
    data: RunData,
    run: int,
    setting: Setting,
    values: Array,
    path: Array,
    moved: Array,
    rate: Array,
    turns: Array,
    wanted: tuple[int, ...],
) -> tuple[Array, Array]:
    """(alpha, beta) at the samples by cubics between the steps, then y."""
    times = data.t_s - data.t_s[0]
    # (alpha, beta) and behind them their sensitivities; beta's rate is r
    value = np.concatenate([path[:2, None, :, run], moved[:2, :, :, run]], axis=1)
    alpha_rates = np.concatenate([rate[:1, :, run], turns[:, :, run]])
    beta_rates = np.concatenate([path[3:, :, run], moved[3, :, :, run]])
    found = between_steps(value, np.stack([alpha_rates, beta_rates]), setting.step, times)
    (alpha, beta), slope = found[:, 0], found[:, 1:]
    own = replace(data.tow, tow_point_m=values[run, TOW_POINT], line_length_m=values[run, LINE_LENGTH])
    post = replace(own, post_phase_rad=float(np.atleast_1d(setting.tow.post_phase_rad)[run]))
    y = full_y_cg(times, alpha, beta, post)
    slope[0] = full_y_cg_rate(alpha, beta, slope[0], slope[1], own)
    for at, index in enumerate(wanted):
        if index == LINE_LENGTH:
            slope[0, at] += np.sin(alpha)
        elif index == TOW_POINT:
            slope[0, at] -= np.sin(beta)
    return np.stack([np.asarray(y), beta]), slope
