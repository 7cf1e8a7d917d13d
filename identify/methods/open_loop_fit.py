"""Derivatives from the open loop (8.27): the measured line force drives the free hull, (y, beta) are the output.

Needs no line geometry at all (L, alpha): only the lateral force at the tow point over time, from a load cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_triangular, toeplitz

from ...record.errors import EstimationError
from ...record.priors import Priors
from ...simulate.model import Array, Hull
from ..data import RunData
from ..start import start_state, weak_form_start
from .common import Record, SixEstimate
from .output_error import OutputError, Weight, output_error
from .state_space import open_loop

COMPLEX_STEP = 1e-30
"""Step of the complex derivative: so small that it is exact to rounding, as nothing is subtracted."""
OWN = ("y", "beta", "v", "r", "beta_b")
"""Free in each run: its start and the heading's bias (a bias of y is part of its start: without a line no place is special)."""


@dataclass(frozen=True)
class OpenLoopFit(SixEstimate):
    """Result of ``fit_open_loop``: the six, and the fit behind them.

    Attributes
    ----------
    fit : the output-error fit
    """

    fit: OutputError | None = None


def fit_open_loop(
    records: Sequence[Record],
    force_n: Sequence[Array],
    *,
    force_sd_n: float = 0.0,
    start: Array | None = None,
    reference_speed_m_s: float | None = None,
) -> OpenLoopFit:
    """Six derivatives from (y, beta) and the measured lateral line force T sin(alpha+beta), linear between samples.

    Parameters
    ----------
    records : evenly sampled, at two or more tow points or with a lively transient; their line length and T give the start only
    force_n : per record (n,), N
    force_sd_n : white noise of each force sample; it moves the model that is compared, so errors wander: whitened by their
        full covariance (dense: time grows with the cube of the samples)
    start : (6,); default: the weak form of the towed equations
    reference_speed_m_s : at which the derivatives are quoted; default: the first record's

    Raises
    ------
    EstimationError : a force history of another length, or uneven samples

    With force_sd_n = 0 the force is taken as exact. A gain error of k % in the force is k % in all six.
    """
    for index, (record, force) in enumerate(zip(records, force_n, strict=True)):
        if len(force) != len(record.t_s):
            raise EstimationError(f"record {index}: {len(force)} values of force_n for {len(record.t_s)} samples")
    speed = records[0].tow.speed_m_s if reference_speed_m_s is None else reference_speed_m_s
    data = [run_data_of(r) for r in records]
    six = weak_form_start(data, speed) if start is None else np.asarray(start, dtype=float)
    own = np.array([[*start_state(d), 0.0] for d in data]).ravel()
    unit = np.abs(six)
    size = 6 + len(own)

    def predict(theta: Array) -> tuple[list[Array], list[Array]]:
        responses, slopes = [], []
        for index, (record, force) in enumerate(zip(records, force_n, strict=True)):
            at = slice(6 + len(OWN) * index, 6 + len(OWN) * (index + 1))
            response, slope = _run(record, np.asarray(force), theta[:6] * unit, theta[at], speed)
            whole = np.zeros((*response.shape, size))
            whole[:, :, :6], whole[:, :, at] = slope[:, :, :6] * unit, slope[:, :, 6:]
            responses.append(response)
            slopes.append(whole)
        return responses, slopes

    seen = [np.column_stack([r.y_m, r.beta_rad]) for r in records]
    begin = np.concatenate([six / unit, own])
    clocks = [r.t_s for r in records]
    if force_sd_n > 0:
        # the noise of y and beta from their fourth differences, which the smooth motion hardly enters
        sigma = [np.std(np.diff(s, n=4, axis=0), axis=0) / np.sqrt(70.0) for s in seen]
        fit = OutputError(begin, np.zeros((size, size)), [], False)
        for _ in range(2):
            whiten = [
                _wander(r, fit.theta[:6] * unit, speed, s, force_sd_n) for r, s in zip(records, sigma, strict=True)
            ]
            fit = output_error(predict, seen, clocks, fit.theta, whiten=whiten)
    else:
        fit = output_error(predict, seen, clocks, begin)
    notes = () if fit.converged else ("the fit did not converge",)
    return OpenLoopFit(fit.theta[:6] * unit, fit.covariance[:6, :6] * unit[:, None] * unit, notes, fit)


def _wander(record: Record, six: Array, speed: float, sigma: Array, force_sd_n: float) -> Weight:
    """Whitener of white noise of (y, beta), sd ``sigma (2,)``, plus what the force's noise makes of the free hull's motion."""
    n = len(record.t_s)
    pulse = np.zeros(n)
    pulse[1] = force_sd_n  # as a sample of the linear interpolation, a hat
    answer = _run(record, pulse, six, np.zeros(5), speed)[0]
    moved = np.array([toeplitz(np.append(column[1:], 0.0), np.zeros(n)) for column in answer.T])  # (2, n, n)
    both = np.concatenate(list(moved))
    covariance = both @ both.T + np.diag(np.repeat(sigma**2, n))
    factor = np.linalg.cholesky(covariance)

    def whiten(values: Array) -> Array:
        flat = values.reshape(n, 2, -1).transpose(1, 0, 2).reshape(2 * n, -1)
        white = solve_triangular(factor, flat, lower=True)
        return white.reshape(2, n, -1).transpose(1, 0, 2).reshape(values.shape)

    return whiten


def run_data_of(record: Record) -> RunData:
    """Give a record the form that the weak form's fit takes, with weights of one.

    Parameters
    ----------
    record : of one tow
    """
    n = len(record.t_s)
    return RunData(
        "record",
        record.t_s,
        record.y_m,
        record.beta_rad,
        np.broadcast_to(np.eye(2), (n, 2, 2)),
        np.zeros((0, n, 2)),
        "",
        record.tow,
        None,
        None,
        Priors(),
        True,
    )


def _run(record: Record, force: Array, six: Array, own: Array, speed: float) -> tuple[Array, Array]:
    """(y, beta) at the samples, (n, 2), and their slope by (six, own), (n, 2, 11).

    First-order hold; slopes by the complex step through the state matrix. The powers of the transition are doubled, the force is
    convolved with the pulse responses (real and imaginary part apart: one is 1e-30 of the other).
    """
    from scipy.signal import fftconvolve

    step, n = record.step_s, len(force)
    columns = np.repeat(six[:, None], 7, axis=1).astype(complex)
    columns[np.arange(6), np.arange(1, 7)] += 1j * COMPLEX_STEP
    tow = replace(record.tow, tension_n=1.0)
    blocks = np.zeros((7, 6, 6), dtype=complex)
    for index in range(7):
        model = open_loop(Hull(*columns[:, index], speed_m_s=speed), tow)
        blocks[index, :4, :4], blocks[index, :4, 4] = model.a, model.b[:, 0]
        blocks[index, 4, 5] = 1.0 / step
    powers: Array = expm(blocks * step)
    transition: Array = powers[:, :4, :4]
    # from each of: the four unit states (v, y, beta', beta), a force at a step's start, its rise over the step
    begin: Array = np.concatenate([np.broadcast_to(np.eye(4), (7, 4, 4)), powers[:, :4, 4:]], axis=2)
    path: Array = begin[:, :, None, :]  # (7, state, time, begin)
    while path.shape[2] < n:
        path = np.concatenate([path, np.einsum("kij,kjtb->kitb", transition, path)], axis=2)
        transition = transition @ transition
    path = path[:, [1, 3], :n]
    parts: Array = np.concatenate(
        [np.real(path[:1]), np.imag(path[1:]) / COMPLEX_STEP]
    )  # the answer, then its six slopes
    rise = np.diff(force, append=force[-1])
    forced: Array = np.zeros((7, 2, n))
    for at, signal in ((4, force), (5, rise)):
        forced[:, :, 1:] += fftconvolve(parts[:, :, :, at], signal[None, None], axes=2)[:, :, : n - 1]
    y, beta, v, r, bias = own
    free: Array = parts[:, :, :, :4] @ np.array([v, y, r, beta])
    response = (free + forced)[0].T + np.array([0.0, bias])
    own_slope = np.stack([*(parts[0, :, :, b].T for b in (1, 3, 0, 2)), np.tile([0.0, 1.0], (n, 1))], axis=2)
    return response, np.concatenate([(free + forced)[1:].transpose(2, 1, 0), own_slope], axis=2)
