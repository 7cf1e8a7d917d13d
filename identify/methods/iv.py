"""Four-stage instrumental variables (6.17-6.20, theory.md 9.7) for A(q) y = B(q) u + w with coloured w and an outside input u.

A tow has no outside input; its version, with instruments from the model's own simulated response, is ``fit_arx(method="iv")``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record.errors import EstimationError
from ...simulate.model import Array
from .least_squares import least_squares_svd


@dataclass(frozen=True)
class Polynomials:
    """A(q^-1) = 1 + a1 q^-1 + .. and B(q^-1) = b1 q^-delay + .. with the covariance of (a, b).

    Attributes
    ----------
    a, b : (na + 1,) with the leading 1, (nb,)
    covariance : (na + nb, na + nb)
    """

    a: Array
    b: Array
    covariance: Array

    @property
    def sd(self) -> Array:
        """Standard deviations of (a1.., b1..)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True)
class FourStages:
    """Result of ``four_stage_iv``.

    Attributes
    ----------
    ls, iv, iv4 : stages 1, 2 and 4
    noise : L of stage 3, (na + nb + 1,), with the leading 1: L w = e
    notes : for the user
    """

    ls: Polynomials
    iv: Polynomials
    iv4: Polynomials
    noise: Array
    notes: tuple[str, ...]


def four_stage_iv(y: Array, u: Array, na: int, nb: int, delay: int = 1) -> FourStages:
    """Estimate A and B: LS; IV with simulated instruments; AR of the equation error; IV on the filtered data.

    Parameters
    ----------
    y, u : (n,), without their means
    na, nb : orders
    delay : of the input, samples

    Raises
    ------
    EstimationError : too few samples
    """
    from scipy.signal import lfilter

    y, u = np.asarray(y, dtype=float), np.asarray(u, dtype=float)
    if len(y) < 5 * (na + nb) + na + nb + delay:
        raise EstimationError(f"{len(y)} samples are too few for {na + nb} coefficients")
    notes: list[str] = []
    first = max(na, nb + delay - 1)
    rows, target = _regression(y, u, na, nb, delay, first)
    least = least_squares_svd(rows, target)
    ls = _polynomials(least.theta, least.covariance, na)
    x = _simulated(ls, u, delay, notes, "stage 1")
    instruments, _ = _regression(x, u, na, nb, delay, first)
    theta = np.linalg.lstsq(instruments.T @ rows, instruments.T @ target, rcond=None)[0]
    error = target - rows @ theta
    noise = _autoregression(error, na + nb)
    coloured = lfilter([1.0], noise, _impulse(200))
    rho = np.correlate(coloured, coloured, "full")[len(coloured) - 1 :]
    iv = _polynomials(theta, _covariance(instruments, rows, error, rho[: len(error) // 5] / rho[0]), na)
    x = _simulated(iv, u, delay, notes, "stage 2")
    y_f, u_f, x_f = (np.asarray(lfilter(noise, [1.0], s)) for s in (y, u, x))
    start = first + len(noise) - 1
    rows, target = _regression(y_f, u_f, na, nb, delay, start)
    instruments, _ = _regression(x_f, u_f, na, nb, delay, start)
    theta = np.linalg.lstsq(instruments.T @ rows, instruments.T @ target, rcond=None)[0]
    error = target - rows @ theta
    iv4 = _polynomials(theta, _covariance(instruments, rows, error, np.ones(1)), na)
    return FourStages(ls, iv, iv4, noise, tuple(notes))


def _regression(y: Array, u: Array, na: int, nb: int, delay: int, first: int) -> tuple[Array, Array]:
    n = len(y)
    columns = [-y[first - k : n - k] for k in range(1, na + 1)]
    columns += [u[first - k : n - k] for k in range(delay, delay + nb)]
    return np.column_stack(columns), y[first:]


def _polynomials(theta: Array, covariance: Array, na: int) -> Polynomials:
    return Polynomials(np.concatenate([[1.0], theta[:na]]), theta[na:], covariance)


def _simulated(model: Polynomials, u: Array, delay: int, notes: list[str], stage: str) -> Array:
    """(B/A) u; an unstable A is mirrored into the unit circle: instruments need only be correlated with the truth."""
    from scipy.signal import lfilter

    roots = np.roots(model.a)
    outside = np.abs(roots) >= 1
    a = model.a
    if outside.any():
        roots = np.where(outside, 0.999 / np.conj(roots), roots)
        a = np.real(np.poly(roots))
        notes.append(f"{stage} gave an unstable model; its instruments come from the mirrored one")
    return np.asarray(lfilter(np.concatenate([np.zeros(delay), model.b]), a, u))


def _autoregression(error: Array, order: int) -> Array:
    rows = np.column_stack([-error[order - k : len(error) - k] for k in range(1, order + 1)])
    return np.concatenate([[1.0], least_squares_svd(rows, error[order:]).theta])


def _impulse(size: int) -> Array:
    return np.eye(1, size)[0]


def _covariance(instruments: Array, rows: Array, error: Array, rho: Array) -> Array:
    """(Z'F)^-1 sigma^2 (sum rho_k Z_t Z_(t+k)') (Z'F)^-T."""
    meat = instruments.T @ instruments
    for k in range(1, len(rho)):
        cross = instruments[:-k].T @ instruments[k:] * rho[k]
        meat = meat + cross + cross.T
    bread = np.linalg.inv(instruments.T @ rows)
    return bread @ meat @ bread.T * float(error @ error) / max(len(error) - rows.shape[1], 1)
