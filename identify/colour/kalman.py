"""The innovations of a tow that a coloured side force and moment push about (App. III: AIII-14 to 20), with derivatives.

State of what the disturbance does: (y, beta, v, r, F, N), the hull's linear equations driven by a first-order force F and
moment N, each with a standard deviation and one time constant. The start of the run is a parameter of the mean, so the state
begins at zero, F and N at their stationary scatter; the gain is the time-varying one until it is steady.
Where a static record shows that the measurement itself is coloured, two more first-order states carry its slow part.
"""

from __future__ import annotations

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
STATES = 6
"""y, beta, v, r, and the coloured force and moment."""
STEP_SHARE = 0.01
"""Steps of time that differ by less than this share of the usual one count as equal."""
STEADY_SHARE = 1e-10
"""The filter's covariance is steady, and not computed again, when it changes from sample to sample by less than this share."""
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


def innovations(
    data: RunData,
    six: Array,
    noise: Array,
    speed_m_s: float,
    residual: Array,
    slope: Array,
    slow: Slow | None = None,
) -> Innovations:
    """Filter a run.

    Parameters
    ----------
    data : block means (``joint.thin.thinned``); covariance of a sample
    six, noise : parameters; noise (5,), ``NOISE_NAMES``
    speed_m_s : at which ``six`` is quoted
    residual : (2, n), measured minus mean response
    slope : (2, k, n), change of the mean response
    slow : the measurement's own colour, where a static record tells it; else it is taken as white
    """
    count = len(data.t_s)
    which, steps = _steps(data.t_s)
    transition, added = step_model(data, six, noise, speed_m_s, steps, slow)
    # each value once, and its change by each of what moves it: real products of small matrices, not complex ones of twelve copies
    step, d_step = np.real(transition[:, 0]).copy(), np.imag(transition[:, 1:]) / EPS
    drive, d_drive = np.real(added[:, 0]).copy(), np.imag(added[:, 1:]) / EPS
    states = step.shape[-1]
    white = data.covariance if slow is None else data.covariance * np.sqrt(np.outer(slow.share, slow.share))
    scale = np.exp(noise[3:5])
    factor, d_factor = np.outer(scale, scale), np.zeros((MOVING, 2, 2))
    covariance, d_covariance = np.zeros((states, states)), np.zeros((MOVING, states, states))
    for i in range(2):
        d_factor[9 + i, i] += factor[i]
        d_factor[9 + i, :, i] += factor[:, i]
        covariance[4 + i, 4 + i] = np.exp(2 * noise[i])
        d_covariance[6 + i, 4 + i, 4 + i] = 2 * covariance[4 + i, 4 + i]
        if slow is not None:
            covariance[STATES + i, STATES + i] = _slow_variance(data, noise, slow)[i]
            d_covariance[9 + i, STATES + i, STATES + i] = 2 * covariance[STATES + i, STATES + i]
    measured = np.concatenate([residual[:, None], slope], axis=1).transpose(2, 0, 1).copy()  # (n, 2, 1 + k)
    mean, d_mean = np.zeros((states, measured.shape[2])), np.zeros((MOVING, states))
    spread, d_spread = np.empty((count, 2, 2)), np.empty((count, MOVING, 2, 2))
    error, shifted = np.empty(measured.shape), np.empty((count, MOVING, 2))
    steady = False
    gained, d_gained = np.zeros((states, 2)), np.zeros((MOVING, states, 2))
    d_closed = np.zeros((MOVING, states, states))
    closed = np.zeros((states, states))
    for k in range(count):
        kind = which[k]
        # a steady gain is used while neither step nor weight changes
        steady = steady and kind == which[k - 1] and np.array_equal(data.covariance[k], data.covariance[k - 1])
        if steady:
            spread[k], d_spread[k] = spread[k - 1], d_spread[k - 1]
        else:
            on, d_on = step[kind], d_step[kind]
            across, d_across = _seen(covariance), _seen(d_covariance)
            total = _seen(across.T) + factor * white[k]
            d_total = _seen(d_across.transpose(0, 2, 1)) + d_factor * white[k]
            spread[k], d_spread[k] = total, d_total
            (a, b), (c, d) = total.tolist()
            inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
            gain = across @ inverse
            d_gain = (d_across - gain @ d_total) @ inverse
            left = covariance - gain @ across.T
            lost = gain @ d_across.transpose(0, 2, 1)
            d_left = d_covariance - d_gain @ across.T - lost
            turned = on @ left
            after = turned @ on.T + drive[kind]
            bent = d_on @ turned.T
            d_after = on @ d_left @ on.T + d_drive[kind] + bent + bent.transpose(0, 2, 1)
            # an asymmetry of rounding would grow
            after, d_after = (after + after.T) / 2, (d_after + d_after.transpose(0, 2, 1)) / 2
            size = after.diagonal()
            steady = bool(
                (np.abs(size - covariance.diagonal()) < STEADY_SHARE * size).all()
                and (np.abs((d_after - d_covariance).diagonal(axis1=1, axis2=2)) < 1e3 * STEADY_SHARE * size).all()
            )
            covariance, d_covariance = after, d_after
            gained, d_gained = on @ gain, d_on @ gain + on @ d_gain
            closed, d_closed = _without(on, gained), _without(d_on, d_gained)
        e = measured[k] - _seen(mean.T).T
        error[k] = e
        shifted[k] = _seen(d_mean)
        d_mean = d_mean @ closed.T + d_closed @ mean[:, 0] + d_gained @ measured[k, :, 0]
        mean = step[kind] @ mean + gained @ e
    d_error = np.concatenate([-error[:, :, 1:].transpose(0, 2, 1), -shifted], axis=1)
    return Innovations(error[:, :, 0], spread, d_error, d_spread)


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
