"""The innovations of a tow that a coloured side force and moment push about (App. III: AIII-14 to 20), with derivatives.

State of what the disturbance does: (y, beta, v, r, F, N), the hull's linear equations driven by a first-order force F and
moment N, each with a standard deviation and one time constant. The start of the run is a parameter of the mean, so the state
begins at zero, F and N at their stationary scatter; the gain is the time-varying one until it is steady.
Where a static record shows that the measurement itself is coloured, two more first-order states carry its slow part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...simulate.model import Array
from ..data import RunData
from ..joint.linear import exponential, system_matrices
from ..joint.parameters import LINE_LENGTH, SPEED, TENSION, TOW_POINT
from ..still import Slow

NOISE_NAMES = ("force", "moment", "time", "scale_y", "scale_beta")
"""Logarithms of: sd of the force N, of the moment N m, their time constant s, measurement scatter over the stated sigmas."""
MOVING = 6 + len(NOISE_NAMES)
"""What the covariances move with: the six derivatives and the noise."""
BENDING = 9
"""Of these so many may change the transition; the rest, the measurement's scatter, does not."""
STATES = 6
"""y, beta, v, r, and the coloured force and moment."""
STEP_SHARE = 0.01
"""Steps of time that differ by less than this share of the usual one count as equal."""
STEADY_SHARE = 1e-10
"""The filter's covariance is steady, and not computed again, when it changes from sample to sample by less than this share."""
STEADY_ASKED = 8
"""Whether it is steady is asked after so many samples."""
EPS = 1e-30
"""Step of the complex derivative: so small that it is exact to rounding, as nothing is subtracted."""


@dataclass(frozen=True)
class Innovations:
    """One run's innovations and what they depend on.

    Attributes
    ----------
    error : (n, 2), e
    spread : (n, 2, 2), S = cov e
    d_error : (n, k + 11, 2), by the k columns of the mean, then six derivatives (filter's part only) and noise parameters
    d_spread : (n, 11, 2, 2), by the six derivatives and the noise parameters
    """

    error: Array
    spread: Array
    d_error: Array
    d_spread: Array

    @property
    def white(self) -> Array:
        """(n, 2), of unit variance."""
        return np.linalg.solve(np.linalg.cholesky(self.spread), self.error[:, :, None])[:, :, 0]


def step_model(
    data: RunData, six: Array, noise: Array, speed_m_s: float, steps_s: Array, slow: Slow | None = None
) -> tuple[Array, Array]:
    """Transition and added covariance over ``steps_s`` (u,), complex: index 0 as is, 1.. moved by i EPS, (u, 12, s, s).

    s is 6, or 8 with the measurement's slow part of y and beta behind.

    Parameters
    ----------
    data : one run
    six : (6,) derivatives, in the order of ``DERIVATIVE_UNITS``
    noise : (5,) parameters, ``NOISE_NAMES``
    speed_m_s : at which ``six`` is quoted
    steps_s : (u,) steps of time, s
    slow : slow part of the measurement, or None
    """
    values = np.zeros((1, 14))
    values[0, :6] = six
    values[0, [TENSION, TOW_POINT, LINE_LENGTH, SPEED]] = [
        data.tow.tension_n,
        data.tow.tow_point_m,
        data.tow.line_length_m,
        data.tow.speed_m_s,
    ]
    matrix, slopes = system_matrices([data], values, speed_m_s, list(range(6)))
    force, moment, time_s = np.exp(noise[:3])
    size = STATES if slow is None else STATES + 2
    whole, d_whole = np.zeros((size, size)), np.zeros((MOVING, size, size))
    whole[:4, :4] = matrix[0, :4, :4]
    d_whole[:6, :4, :4] = slopes[0, :, :4, :4]
    for i in range(2):
        whole[2 + i, 4 + i], d_whole[i, 2 + i, 4 + i] = 1 / six[i], -1 / six[i] ** 2
        whole[4 + i, 4 + i], d_whole[8, 4 + i, 4 + i] = -1 / time_s, 1 / time_s
    drive, d_drive = np.zeros((size, size)), np.zeros((MOVING, size, size))
    for i, sd in enumerate((force, moment)):
        drive[4 + i, 4 + i] = 2 * sd**2 / time_s
        d_drive[6 + i, 4 + i, 4 + i] = 2 * drive[4 + i, 4 + i]
        d_drive[8, 4 + i, 4 + i] = -drive[4 + i, 4 + i]
    if slow is not None:
        for i, variance in enumerate(_slow_variance(data, noise, slow)):
            at = STATES + i
            whole[at, at] = -1 / slow.time_s[i]
            drive[at, at] = 2 * variance / slow.time_s[i]
            d_drive[9 + i, at, at] = 2 * drive[at, at]
    # van Loan: exp of [[A, D], [0, -A']] holds the transition and the covariance that the drive adds
    block, d_block = np.zeros((2 * size, 2 * size)), np.zeros((MOVING, 2 * size, 2 * size))
    for to, a, d in ((block, whole, drive), (d_block, d_whole, d_drive)):
        to[..., :size, :size], to[..., :size, size:], to[..., size:, size:] = a, d, -np.swapaxes(a, -1, -2)
    count = len(steps_s)
    power, change = exponential(np.tile(block, (count, 1, 1)), np.tile(d_block, (count, 1, 1, 1)), steps_s)
    both = np.concatenate([power[:, None], power[:, None] + 1j * EPS * change], axis=1)
    transition = both[:, :, :size, :size]
    return transition, both[:, :, :size, size:] @ np.swapaxes(transition, -1, -2)


def _slow_variance(data: RunData, noise: Array, slow: Slow) -> Array:
    """Stationary variance (2,) of the measurement's slow part: a share of the samples' mean variance."""
    return (1 - slow.share) * np.exp(2 * noise[3:5]) * np.einsum("nii->i", data.covariance) / len(data.covariance)


@dataclass(frozen=True)
class Filtered:
    """What a filter takes of one run.

    Attributes
    ----------
    data : block means (``joint.thin.thinned``); covariance of a sample
    residual : (2, n), measured minus mean response
    slope : (2, k, n), change of the mean response
    slow : the measurement's own colour, where a static record tells it; else it is taken as white
    """

    data: RunData
    residual: Array
    slope: Array
    slow: Slow | None = None

    @property
    def states(self) -> int:
        """Of its filter."""
        return STATES if self.slow is None else STATES + 2


def innovations(runs: Sequence[Filtered], six: Array, noise: Array, speed_m_s: float) -> list[Innovations]:
    """Filter runs, side by side: a step of several takes hardly longer than a step of one.

    Parameters
    ----------
    runs : with equally many states
    six, noise : parameters; noise (5,), ``NOISE_NAMES``
    speed_m_s : at which ``six`` is quoted
    """
    order = sorted(range(len(runs)), key=lambda i: -len(runs[i].data.t_s))
    found = _side_by_side([runs[i] for i in order], six, noise, speed_m_s)
    return [found[order.index(i)] for i in range(len(runs))]


def _side_by_side(runs: Sequence[Filtered], six: Array, noise: Array, speed_m_s: float) -> list[Innovations]:
    """``innovations`` of runs of which none is longer than the one before it."""
    kinds = [_steps(run.data.t_s) for run in runs]
    models = [
        step_model(run.data, six, noise, speed_m_s, steps, run.slow)
        for run, (_, steps) in zip(runs, kinds, strict=True)
    ]
    transition, added = (np.concatenate(parts) for parts in zip(*models, strict=True))
    # each value once, and its change by each of what moves it: real products of small matrices, not complex ones of twelve copies
    step, d_step = np.real(transition[:, 0]).copy(), np.imag(transition[:, 1:]) / EPS
    drive, d_drive = np.real(added[:, 0]).copy(), np.imag(added[:, 1:]) / EPS
    states, sizes = step.shape[-1], np.array([len(run.data.t_s) for run in runs])
    many, longest, columns = len(runs), int(sizes[0]), max(run.slope.shape[1] for run in runs)
    d_some = d_step[:, :BENDING].reshape(
        len(d_step), -1, states
    )  # products of one tall matrix take the time of one small one
    scale = np.exp(noise[3:5])
    factor, d_factor = np.outer(scale, scale), np.zeros((MOVING, 2, 2))
    for i in range(2):
        d_factor[9 + i, i] += factor[i]
        d_factor[9 + i, :, i] += factor[:, i]
    which, white = np.zeros((longest, many), dtype=int), np.zeros((longest, many, 1, 2, 2))
    measured = np.zeros((longest, many, 2, 1 + columns))
    covariance, d_covariance = np.zeros((many, states, states)), np.zeros((many, MOVING, states, states))
    same, before = np.ones((longest, many), dtype=bool), 0
    for r, (run, (kind, steps)) in enumerate(zip(runs, kinds, strict=True)):
        data, size = run.data, sizes[r]
        share = 1.0 if run.slow is None else np.sqrt(np.outer(run.slow.share, run.slow.share))
        which[:size, r], white[:size, r, 0] = kind + before, data.covariance * share
        measured[:size, r, :, 0] = run.residual.T
        measured[:size, r, :, 1 : 1 + run.slope.shape[1]] = run.slope.transpose(2, 0, 1)
        same[1:size, r] = (data.covariance[1:] == data.covariance[:-1]).all(axis=(1, 2)) & (kind[1:] == kind[:-1])
        before += len(steps)
        for i in range(2):
            covariance[r, 4 + i, 4 + i] = np.exp(2 * noise[i])
            d_covariance[r, 6 + i, 4 + i, 4 + i] = 2 * covariance[r, 4 + i, 4 + i]
            if run.slow is not None:
                covariance[r, STATES + i, STATES + i] = _slow_variance(data, noise, run.slow)[i]
                d_covariance[r, 9 + i, STATES + i, STATES + i] = 2 * covariance[r, STATES + i, STATES + i]
    going = (sizes[None, :] > np.arange(longest)[:, None]).sum(axis=1).tolist()
    unchanged = np.asarray(same.all(axis=1))
    mean, d_mean = np.zeros((many, states, 1 + columns)), np.zeros((many, MOVING, states))
    spread, d_spread = np.empty((longest, many, 2, 2)), np.empty((longest, many, MOVING, 2, 2))
    error, shifted = np.empty(measured.shape), np.empty((longest, many, MOVING, 2))
    steady: bool = False
    flat, cube = (-1, states), (-1, states, states)
    index = np.arange(0)
    on = d_on = gain = gained = inverse = closed = on_t = gained_t = closed_t = np.zeros(0)
    for k in range(longest):
        here = going[k]
        # a steady gain is used while neither step nor weight changes, and no run ends
        steady = steady and bool(unchanged[k]) and here == going[k - 1]
        if steady:
            spread[k], d_spread[k] = spread[k - 1], d_spread[k - 1]
        else:
            if here < len(covariance):
                covariance, d_covariance, mean, d_mean = (a[:here] for a in (covariance, d_covariance, mean, d_mean))
            index = which[k, :here]
            on, d_on = step[index], d_some[index]
            across = _seen(covariance)
            spread[k, :here] = _seen(_turned(across)) + factor * white[k, :here, 0]
            d_spread[k, :here] = _seen(_turned(_seen(d_covariance))) + d_factor * white[k, :here]
            inverse = _inverse(spread[k, :here])
            gain = across @ inverse
            gained = on @ gain
            closed = _without(on, gained)
            on_t, gained_t, closed_t = _turned(on), _turned(gained), _turned(closed)
        e = measured[k, :here] - _turned(_seen(_turned(mean)))
        error[k, :here], shifted[k, :here] = e, _seen(d_mean)
        # the gain moves too: what that does goes by the error alone, and no gain's derivative is written down
        first = e[:, :, :1]
        weighed = (inverse @ first)[:, None]
        d_across = (_seen(d_covariance) @ weighed)[..., 0]
        d_weight = (d_spread[k, :here] @ weighed)[..., 0]
        d_mean = d_mean @ closed_t + d_across @ on_t - d_weight @ gained_t
        d_mean[:, :BENDING] += (d_on @ (mean[:, :, :1] + gain @ first)).reshape(here, *flat)
        mean = on @ mean + gained @ e
        if not steady:
            turned = closed @ covariance
            after = turned @ on_t + drive[index]
            after = (after + _turned(after)) / 2  # an asymmetry of rounding would grow
            half = (d_covariance.reshape(here, *flat) @ closed_t).reshape(here, *cube)
            d_after = (_turned(half).reshape(here, *flat) @ closed_t).reshape(half.shape) + d_drive[index]
            bent = (d_on @ _turned(turned)).reshape(here, *cube)
            d_after[:, :BENDING] += bent + _turned(bent)
            d_after[:, BENDING:] += gained[:, None] @ (d_factor[BENDING:] * white[k, :here]) @ gained_t[:, None]
            steady = k % STEADY_ASKED == 0 and _is_steady(covariance, after, d_covariance, d_after)
            covariance, d_covariance = after, d_after
    return [
        Innovations(
            error[:n, r, :, 0],
            spread[:n, r],
            np.concatenate([-error[:n, r, :, 1 : 1 + run.slope.shape[1]].transpose(0, 2, 1), -shifted[:n, r]], axis=1),
            d_spread[:n, r],
        )
        for r, (run, n) in enumerate(zip(runs, sizes.tolist(), strict=True))
    ]


def _is_steady(before: Array, after: Array, d_before: Array, d_after: Array) -> bool:
    """The covariance no longer changes, (r, s, s), nor does its change, (r, 11, s, s)."""
    size = after.diagonal(axis1=1, axis2=2)
    change = np.abs(size - before.diagonal(axis1=1, axis2=2))
    d_change = np.abs((d_after - d_before).diagonal(axis1=2, axis2=3))
    return bool((change < STEADY_SHARE * size).all() and (d_change < 1e3 * STEADY_SHARE * size[:, None]).all())


def _inverse(pairs: Array) -> Array:
    """Of (r, 2, 2)."""
    a, b, c, d = pairs[:, 0, 0], pairs[:, 0, 1], pairs[:, 1, 0], pairs[:, 1, 1]
    return np.array([[d, -b], [-c, a]]).transpose(2, 0, 1) / (a * d - b * c)[:, None, None]


def _turned(matrices: Array) -> Array:
    """(..., i, j) -> (..., j, i)."""
    return np.swapaxes(matrices, -1, -2)


def _seen(rows: Array) -> Array:
    """What is measured of y and beta (..., 2), of states (..., s): with what the measurement's own colour adds to them."""
    return rows[..., :2] if rows.shape[-1] == STATES else rows[..., :2] + rows[..., STATES:]


def _without(step: Array, gained: Array) -> Array:
    """The transition (..., s, s) of an error whose measured part is taken out by ``gained`` (..., s, 2)."""
    left = step.copy()
    left[..., :2] -= gained
    if step.shape[-1] > STATES:
        left[..., STATES:] -= gained
    return left


def _steps(t_s: Array) -> tuple[Array, Array]:
    """For every sample the kind of step to the next, and the kinds' lengths; the last sample steps as usual."""
    gaps = np.diff(t_s)
    usual = float(np.median(gaps))
    rounded = np.rint(np.append(gaps, usual) / (STEP_SHARE * usual)).astype(int)
    kinds, which = np.unique(rounded, return_inverse=True)
    sums = np.bincount(which, weights=np.append(gaps, usual))
    return which, sums / np.bincount(which, minlength=len(kinds))
