"""Has a tow come to rest? Judged from its motion alone (4.7.1, 5.1; 3.2.3).

Every tail of the record is fitted with a mean, an exponential and a swing (``transient``). A tail is not settled where a fit says
that something is left in it, beyond the noise's own colour **and** of a size that matters: what it does to F = T sin(alpha+beta),
through which alone it reaches X_v, against the uncertainty that F has anyway. A short tail shows little of a slow swing, so the
fits of longer ones are asked too, as long as they still hold in it: a swing that does not decay is in the last ten seconds as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import fdtri

from ..record.errors import EstimationError
from ..simulate.model import Array
from .noise import LARGEST_ORDER, autoregression
from .transient import FEWEST_BLOCKS, Transient, fit_transient

SLOWEST_SHIP_LENGTHS = 10.0
"""A swing lasts at most as long as the carriage takes for this many Lpp: 6.4-10.1 in Table 4.5, 7.4-9.1 in Table 8.6."""
SHORTEST_S = 4.0
"""No tail is shorter, however fast the model swings: a choice."""
SHORTEST_SWING = 0.5
"""A tail shorter than this share of the longest swing cannot tell a swing from a drift."""
STEP = 0.1
"""Tails begin at every such share of the record."""
CHANCE = 1e-4
"""Noise alone passes for a swing or a drift in this share of fits at a fixed rate; the search over rates makes it more."""
SMALL_SHARE = 0.5
"""What is left may move F by this share of F's standard deviation: added in quadrature it widens that by 12 % ..."""
SMALL_FORCE = 1e-3
"""... or by this share of F itself: half a millimetre of X_v at a tow point half a metre ahead of it ..."""
SMALL_RAD = 2e-5
"""... or by what this does in both angles: a thousandth of a degree, for tows without noise or side force."""
HOLDS = 1.5
"""A longer tail's fit holds in a shorter one where it leaves at most so many times what the shorter one's own leaves."""
FAIR = 4.0
"""A settled tow's decay is read where the fit leaves at most so many times the median of all."""
WORTH = 0.3
"""The window is the longest settled tail, unless a shorter one's mean has less than this share of its variance: by chance alone
one of several has a little less."""
PARAMETERS = 11
"""Of a transient: in each of two channels a mean, an exponential and a swing (two amplitudes), and three rates for both."""
ROUNDING_RAD = 1e-8
"""Less is nothing, in records without noise."""
SURE = 3.0
"""A rate of growth or decay is one beyond so many of its standard deviations."""
LONGEST_WAIT_S = 600.0
"""A swing that needs longer to settle counts as one that does not decay."""
SHEARED_RAD = np.radians(2.0)
"""A tow shears off where what grows has carried an angle this far, and by a factor e at least."""


@dataclass(frozen=True)
class Left:
    """What a tow still does in a window.

    Attributes
    ----------
    what : "swing" or "drift"
    leak : what it may move the window's mean F by, at the worst phase, in F's unit
    tolerance : what it might, in the same unit
    size_rad : (2,), of alpha and beta: amplitude at the window's end, or change over the window
    span_s : of the window
    fit : that says so
    """

    what: str
    leak: float
    tolerance: float
    size_rad: Array
    span_s: float
    fit: Transient


Verdict = Literal["settled", "decaying", "swinging", "growing", "drifting", "shearing off"]


@dataclass(frozen=True)
class Stability:
    """What a record alone says of a tow's stability (3.2.3).

    Attributes
    ----------
    verdict : "settled", "decaying", "swinging" (neither growth nor decay is told), "growing", "drifting" or "shearing off"
    lambda_per_s, lambda_sd_per_s : of the swing, or of the real root that shears off; negative = decaying. None: nothing was seen
    period_s : of the swing; None without one
    """

    verdict: Verdict
    lambda_per_s: float | None = None
    lambda_sd_per_s: float | None = None
    period_s: float | None = None

    @property
    def words(self) -> str:
        """As it stands on the page: ``decaying, lambda -0.0100 +- 0.0010 1/s, period 17.9 s``."""
        text = self.verdict
        if self.lambda_per_s is not None and self.lambda_sd_per_s is not None:
            text += f", lambda {rate_text(self.lambda_per_s, self.lambda_sd_per_s)} 1/s"
        return text if self.period_s is None else f"{text}, period {self.period_s:.1f} s"


def rate_text(rate: float, sd: float) -> str:
    """``+0.0057 +- 0.0001``: to the first digit of the standard deviation.

    Parameters
    ----------
    rate : 1/s
    sd : its standard deviation
    """
    places = max(0, -int(np.floor(np.log10(max(sd, 1e-9)))))
    return f"{rate:+.{places}f} +- {sd:.{places}f}"


@dataclass(frozen=True)
class Judged:
    """What ``judge`` finds.

    Attributes
    ----------
    first : the sample that the settled tail begins with; of the shortest tail where none is settled
    left : what is left in that tail; empty: nothing that matters. Largest leak first
    small : (2, 2), covariance of the tail's means for what is left there although it does not matter, rad2
    transient : the fit that describes the record's end, from the longest tail that it holds for
    stability : of the record
    wait_s : how much longer the tow takes to settle; None: it does not decay, or it is settled
    """

    first: int
    left: tuple[Left, ...]
    small: Array
    transient: Transient
    stability: Stability
    wait_s: float | None = None

    @property
    def settled(self) -> bool:
        """Nothing is left that matters."""
        return not self.left


Pull = Callable[[Array], tuple[float, Array]]
"""F and its slope by (alpha, beta), (2,), at angles (2,), in any unit."""


def sine_pull(angles: Array) -> tuple[float, Array]:
    """F/T = sin(alpha+beta) and its slope."""
    return float(np.sin(angles.sum())), np.full(2, np.cos(angles.sum()))


def slowest_swing_s(length_pp_m: float, speed_m_s: float) -> float:
    """The longest period to expect of a towed model, s.

    Parameters
    ----------
    length_pp_m : LBP, m
    speed_m_s : U, m/s
    """
    return SLOWEST_SHIP_LENGTHS * length_pp_m / speed_m_s


def judge(
    t_s: Array,
    angles: Array,
    slowest_s: float,
    pull: Pull = sine_pull,
    error: Callable[[int], tuple[Array, float]] | None = None,
) -> Judged:
    """Look for the settled tail of a record, and say what it does where there is none.

    Parameters
    ----------
    t_s, angles : (n,) s rising, (n, 2) alpha and beta, rad
    slowest_s : the longest period of a swing (``slowest_swing_s``)
    pull : F of the angles
    error : first sample of a tail -> what F's uncertainty holds beside the noise: covariance of the tail's mean angles (2, 2) and a
        relative standard deviation of F; None: nothing

    Raises
    ------
    EstimationError : the record is too short to tell a swing from a drift

    >>> t = np.arange(0, 60, 0.04)
    >>> swing = 0.02 * np.cos(0.35 * t)
    >>> noise = 1e-3 * np.random.default_rng(1).normal(size=(len(t), 2))
    >>> found = judge(t, np.column_stack([0.3 + swing, 0.05 - swing / 3]) + noise, 20.0)
    >>> found.settled, found.stability.verdict
    (False, 'swinging')
    """
    shortest = max(SHORTEST_S, SHORTEST_SWING * slowest_s)
    whole = t_s[-1] - t_s[0] if len(t_s) else 0.0
    if len(t_s) < FEWEST_BLOCKS:
        raise EstimationError(f"{len(t_s)} samples of alpha and beta; at least {FEWEST_BLOCKS} are needed")
    if whole < shortest:
        raise EstimationError(
            f"{len(t_s)} samples of alpha and beta over {whole:.1f} s; a swing may last {slowest_s:.1f} s "
            f"({SLOWEST_SHIP_LENGTHS:g} ship lengths), and less than {shortest:.1f} s of one cannot be told from a drift"
        )
    found: list[tuple[int, Transient]] = []
    best: tuple[float, int, Array] | None = None
    last: tuple[int, list[Left]] = (0, [])
    for start in [*np.arange(t_s[0], t_s[-1] - shortest, STEP * whole), t_s[-1] - shortest]:
        first = int(np.searchsorted(t_s, start - 1e-9))
        try:
            found.append((first, fit_transient(t_s[first:], angles[first:], slowest_s)))
        except EstimationError:
            break
        mean, noise = tail_mean(angles[first:])
        force, slope = pull(mean)
        tolerance = _tolerance(found[-1][1], force, slope, error(first) if error is not None else None)
        left, small = _left(found, slope, tolerance)
        variance = float(np.trace(noise + small)) + ROUNDING_RAD**2
        if not left and (best is None or variance < WORTH * best[0]):
            best = variance, first, small
        last = first, left
    if not found:  # many samples, but at few times
        raise EstimationError(f"alpha and beta over {whole:.1f} s stand at too few times to judge a tow by")
    transient = _describes(found)
    if best is not None:
        return Judged(best[1], (), best[2], transient, _came_to_rest([fit for _, fit in found]))
    # in the words of the fit that describes the end, if it sees what the others do
    mine = [one for one in last[1] if one.fit is transient]
    left = tuple(sorted(mine or last[1], key=lambda one: -one.leak / one.tolerance))
    stability = _stability(transient, left)
    return Judged(last[0], left, np.zeros((2, 2)), transient, stability, _wait_s(transient, left, stability))


def _tolerance(fit: Transient, force: float, slope: Array, error: tuple[Array, float] | None) -> float:
    """What may be left of a swing or drift in the mean F of a tail (``SMALL_SHARE``, ``SMALL_FORCE``)."""
    covariance, relative = error if error is not None else (np.zeros((2, 2)), 0.0)
    _, noise = tail_mean(fit.residual)
    sd = np.sqrt(float(slope @ (noise + covariance) @ slope) + (relative * force) ** 2)
    return float(max(SMALL_SHARE * sd, SMALL_FORCE * abs(force), SMALL_RAD * np.abs(slope).sum()))


def _left(fits: list[tuple[int, Transient]], slope: Array, tolerance: float) -> tuple[list[Left], Array]:
    """What the fits, the last of which is of the tail itself, say is left in it; and the covariance for what does not matter."""
    own = fits[-1][1]
    begin, end = own.begin_s, own.end_s
    span, middle = end - begin, (begin + end) / 2
    rest = np.sqrt((own.residual**2).sum(axis=0) / max(len(own.residual) - PARAMETERS / 2, 1.0))
    found: list[Left] = []
    small = np.zeros((2, 2))
    for _, fit in fits:
        inside = fit.t_s >= begin
        if (np.sqrt((fit.residual[inside] ** 2).mean(axis=0)) > HOLDS * rest).any():
            continue
        # cos and sin amplitudes of (alpha, beta) in the middle, and the envelope's mean beside it
        parts, covariance = fit.swing(middle)
        half, turns = 0.5 * fit.rates[1] * span, fit.rates[2] * span
        envelope = float(np.sinh(half) / half) if abs(half) > 1e-6 else 1.0
        share = envelope * min(1.0, 2.0 / turns)
        if _seen(parts.ravel(), covariance, fit):
            leak = share * float(np.hypot(*(slope @ parts)))
            if leak > tolerance:
                found.append(Left("swing", leak, tolerance, np.hypot(*parts.T) * np.exp(-half), span, fit))
            elif fit is own:
                small += share**2 / 2 * parts @ parts.T
        change, covariance = fit.drift(begin, end)
        if _seen(change, covariance, fit):
            leak = abs(float(slope @ change)) / 2
            if leak > tolerance:
                found.append(Left("drift", leak, tolerance, np.abs(change), span, fit))
            elif fit is own:
                small += np.outer(change, change) / 12
    return found, small


def _seen(values: Array, covariance: Array, fit: Transient) -> bool:
    """Whether values differ from 0 beyond chance: an F test with the fit's own degrees of freedom."""
    return _square(values, covariance) > len(values) * float(fdtri(len(values), fit.freedom, 1 - CHANCE))


def _square(values: Array, covariance: Array) -> float:
    """values' covariance^-1 values, with what the covariance does not hold left out."""
    covariance = covariance + ROUNDING_RAD**2 * np.eye(len(values))
    scale = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / scale[:, None] / scale, rcond=1e-10, hermitian=True)
    return float((values / scale) @ inverse @ (values / scale))


def _describes(fits: list[tuple[int, Transient]]) -> Transient:
    """The fit of the longest tail that leaves no more than ``HOLDS`` times what any later one leaves."""
    scatter = np.array([np.sqrt((f.residual**2).sum(axis=0) / max(len(f.t_s) - PARAMETERS / 2, 1.0)) for _, f in fits])
    for index, (_, fit) in enumerate(fits):
        if (scatter[index] <= HOLDS * np.median(scatter[index:], axis=0)).all():
            return fit
    return fits[-1][1]


def _came_to_rest(fits: list[Transient]) -> Stability:
    """The verdict on a settled tow, with the decay that the tail shows best in which the form still holds."""
    scatter = np.array([np.sqrt((fit.residual**2).mean(axis=0)).max() for fit in fits])
    seen = []
    for fit in [f for f, s in zip(fits, scatter, strict=True) if s < FAIR * np.median(scatter)]:
        parts, covariance = fit.swing(fit.begin_s)
        rate, sd = fit.rate(1)
        if _seen(parts.ravel(), covariance, fit) and rate < -SURE * sd:
            seen.append((_square(parts.ravel(), covariance), Stability("settled", rate, sd, fit.period_s)))
    return max(seen, key=lambda one: one[0])[1] if seen else Stability("settled")


def _stability(fit: Transient, left: tuple[Left, ...]) -> Stability:
    """The verdict on an unsettled tow from the fit that describes its end."""
    span = fit.end_s - fit.begin_s
    rate, sd = fit.rate(0)
    change, covariance = fit.drift(fit.begin_s, fit.end_s)
    grown = rate * span > 1.0 and rate > SURE * sd and _seen(change, covariance, fit)
    if left and grown and np.abs(change).max() > SHEARED_RAD and "drift" in {one.what for one in left}:
        return Stability("shearing off", rate, sd)
    if "swing" not in {one.what for one in left}:
        return Stability("drifting")
    rate, sd = fit.rate(1)
    verdict: Verdict = "growing" if rate > SURE * sd else "decaying" if rate < -SURE * sd else "swinging"
    return Stability(verdict, rate, sd, fit.period_s)


def _wait_s(fit: Transient, left: tuple[Left, ...], stability: Stability) -> float | None:
    """How long until a window of one swing (or a drift's time constant) from then on holds nothing that matters."""
    if stability.verdict == "decaying":
        swing = max((one for one in left if one.what == "swing"), key=lambda one: one.leak)
        rate, period = -fit.rate(1)[0], fit.period_s
    elif stability.verdict == "drifting" and fit.rates[0] > SURE * fit.rate(0)[1]:
        swing = left[0]
        rate, period = float(fit.rates[0]), 0.0
    else:
        return None
    wait = np.log(max(swing.leak / swing.tolerance, 1.0)) / rate + period
    return float(wait) if wait < LONGEST_WAIT_S else None


def tail_mean(angles: Array) -> tuple[Array, Array]:
    """Mean of the angles ``(n, 2)`` and its covariance from their long-run variance (an autoregression's, at frequency 0).

    The larger of two: of the samples, and of means of several, whose regression reaches back far enough for a slow noise under a
    fast one.
    """
    mean = angles.mean(axis=0)
    rest = angles - mean
    size = max(len(rest) // COARSE, 1)
    coarse = rest[: len(rest) // size * size].reshape(-1, size, 2).mean(axis=1)
    sd = np.array([max(_sd_of_mean(rest[:, k]), _sd_of_mean(coarse[:, k])) for k in range(2)])
    scatter = np.sqrt(np.maximum(np.diag(rest.T @ rest), 1e-300))
    correlation = (rest.T @ rest) / scatter[:, None] / scatter[None, :]
    return mean, correlation * sd[:, None] * sd[None, :]


def _sd_of_mean(rest: Array) -> float:
    """Standard deviation of the mean of one channel, (n,), whose mean is 0."""
    variance = float(np.mean(rest**2))
    coefficients, share = autoregression(rest, min(LARGEST_ORDER, len(rest) // 20))
    # a slow root that the record cannot resolve counts as one memory as long as a batch
    gain = max(1.0 - float(coefficients.sum()), BATCHES / len(rest))
    square = variance * share / gain**2 / len(rest)
    independent = variance / max(
        square, 1e-300
    )  # as many samples the record is worth; the mean and its memory cost three
    return float(np.sqrt(square * independent / max(independent - 3.0, 1.0)))


COARSE = 120
"""Means that a slow noise is looked for in."""
BATCHES = 8
"""No memory of the noise is taken for longer than a record's length over this."""


def words(judged: Judged, tension_known: bool) -> str:
    """Why a tow is not steady, in one line that says what it does and what to do.

    Parameters
    ----------
    judged : of the tow
    tension_known : T is stated or logged
    """
    fit, s = judged.transient, judged.stability
    swing = next((one for one in judged.left if one.what == "swing"), None)
    drift = next((one for one in judged.left if one.what == "drift"), None)
    if s.verdict == "shearing off":
        change, _ = fit.drift(fit.begin_s, fit.end_s)
        return (
            f"shears off: alpha and beta run away by {_degrees(np.abs(change))} degrees, "
            f"with a real root of {rate_text(*fit.rate(0))} 1/s; its tow point lies aft of X_v"
        )
    parts = []
    if swing is not None:
        parts.append(
            f"swings by {_degrees(swing.size_rad)} degrees of alpha and beta with a period of {fit.period_s:.1f} s, "
            f"lambda {rate_text(*fit.rate(1))} 1/s"
        )
    elif drift is not None:
        parts.append(
            f"drifts by {_degrees(drift.size_rad)} degrees of alpha and beta over its last {drift.span_s:.1f} s"
        )
    worst = judged.left[0]
    parts.append(f"which may move F by {_times(worst.leak / worst.tolerance)} times what a steady tow allows")
    take = "`towline identify` takes it" if tension_known else "with a measured tension `towline identify` takes it"
    if judged.wait_s is not None:
        parts.append(f"settled some {judged.wait_s:.0f} s after its end at the earliest: film longer; or {take}")
    elif s.verdict in ("growing", "swinging", "decaying"):
        slowly = "hardly decays" if s.verdict == "decaying" else "does not decay"
        parts.append(f"it {slowly}: no steady tow comes of it; {take}")
    else:
        parts.append("a longer tow would tell where it goes")
    return "; ".join([", ".join(parts[:-1]), parts[-1]])


def _times(ratio: float) -> str:
    return f"{ratio:.1f}" if ratio < 10 else f"{ratio:.0f}"


def _degrees(size_rad: Array) -> str:
    a, b = np.degrees(size_rad)
    return f"{a:.2g} and {b:.2g}"


__all__ = ["Judged", "Left", "Stability", "judge", "slowest_swing_s", "tail_mean", "words"]
