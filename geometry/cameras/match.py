"""Two views of one tow: the second one's clock and both cameras' common errors, by maximum likelihood where both see the model.

Where both see it their poses differ by the frames' noise, by the cameras' common errors, which are known as modes of unit variance,
and by the motion between two clocks:

    d(t) = z1(t) - z2(s),  t = offset + (1 + rate) s
         = M1(t) a1 - M2(s) a2 + (S1(t) - S2(s)) a - p'(t) (change of offset + change of rate s) + noise

z2 between its frames is the cubic through four of them, so that the noise of neighbouring rows is shared: its covariance is banded,
and known. p' is the rate of the path over some 0.6 s, in which the noise of a row itself has no part. A linear fit with the modes'
unit priors gives the clock's change and the modes; it is repeated until the clock stands. Nothing is smoothed but p'.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky_banded, solve_banded
from scipy.special import chdtrc

from ...record.errors import GeometryError
from ..camera import Array
from .clock import LEAST_TOGETHER_S, Clock, Start, starts
from .view import Between, View, between, between_variance, rate_noise

RATE_SDS = (1e-4, 1e-3)
"""What is known of a camera's rate before anything is seen, relative: crystals are good to 1e-4, a file that says 30 for 29.97 is
off by 1e-3. Either, as likely as the other."""
TOLD_S = 0.02
"""An offset known less well than this (standard deviation) is not told by the motion: half a frame of most cameras."""
SURE_BY = 25.0
"""Of two offsets one is taken where the other's misfit is larger by more (chi-square; five standard deviations)."""
LARGEST_RATE = 5 * RATE_SDS[-1]
"""A match at a larger rate is of two motions that happen to look alike."""
UNLIKE = 0.1
"""And so is one that leaves more than this share of what y and heading vary by, and more than noise."""
STRAYS_S = 1.0
"""A fit that leaves the offset it began with by more has gone to another."""
STEPS = 40
"""Of the clock's iteration, at most; from a start within a twentieth of a second it takes three or four, and more where the path's
rates tell little."""
SMALLEST_S = 1e-6
"""A last step of the clock."""
BLOCKS_S = (0.25, 0.5, 1.0, 2.0)
"""Errors that last show in sums over so long, which then vary by more than their frames."""
FEWEST_BLOCKS = 12
"""Sums of one length that say how much they vary: fewer are not judged."""
COLOURED = 1e-3
"""A sum over frames varies by more than its frames where chance does it less often than this."""
DISAGREE = 1e-3
"""Two cameras whose difference has less probability than this do not agree."""
STILL_SD, STILL = 3.0, 0.01
"""A rate is motion where its mean square is beyond its noise's by so many standard deviations of that; what is none counts by the
second, so that a clock which nothing tells has a standard deviation all the same. Choices."""
TOO_LITTLE = (
    "the motion is too little to tell the second camera's clock{}; state offset_s (a flash, a clap, a common trigger), or film a "
    "tow that swings"
)
"""What is said of that."""
SIZES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.6)
"""Pulls and lags over what is stated of them: sizes that are tried."""
NOTHING = 12.0
"""Sizes whose log likelihood lies so far below the best one's count for nothing: 6e-6 of it."""
TOLD_SHARE = 0.5
"""A mixture of modes is held against what is stated of it where the difference tells it better than that, its variance shrinks by
more than this share. What it hardly tells would be judged by errors of second order, a hundredth of a millimetre."""


@dataclass(frozen=True)
class Match:
    """Two views, matched.

    Attributes
    ----------
    first, second : the views
    clock : of the second one
    rows : (n,) frames of the first at which both see the model
    beside : the second at those times
    values : (K,), posterior means of first's own modes, second's own modes and the marks' own (shared)
    covariance : (2 + K, 2 + K), posterior of the clock (s, and s over the time ``span_s`` about ``middle_s``) and of those
    middle_s, span_s : of the rows, on the second one's clock
    inflation : of the frames' covariances: errors that last, shown by the differences
    chi_square, degrees : of the modes but pulls and lags, against what was stated of them
    found : (D,) mean difference of the poses, first minus second; ``expected`` : (D,) its standard deviation by what is stated
    left : (D,) root mean square of what the match leaves of the differences
    misfit : per row: what neither clock nor modes explain, over the noise of a frame as stated
    """

    first: View
    second: View
    clock: Clock
    rows: NDArray[np.int_]
    beside: Between
    values: Array
    covariance: Array
    middle_s: float
    span_s: float
    inflation: float
    chi_square: float
    degrees: int
    found: Array
    expected: Array
    left: Array
    misfit: float

    @cached_property
    def probability(self) -> float:
        """Of a difference as large or larger than this, if all is as stated."""
        return float(chdtrc(self.degrees, self.chi_square)) if self.degrees else 1.0

    @property
    def agree(self) -> bool:
        """The cameras differ by no more than what is stated of them lets expect."""
        return self.probability >= DISAGREE

    @property
    def widened(self) -> float:
        """Standard deviations of what the cameras have in common are so many times what is stated."""
        return 1.0 if self.agree else float(np.sqrt(max(self.chi_square / self.degrees, 1.0)))


@dataclass(frozen=True)
class Known:
    """What is known of the second camera's clock beforehand: how much more the first one shows when the second one shows ``at_s``,
    and its standard deviation, s.
    """

    offset_s: float
    sd_s: float
    at_s: float = 0.0


@dataclass(frozen=True)
class _Rows:
    """Differences at one clock, whitened."""

    rows: NDArray[np.int_]
    beside: Between
    second_s: Array
    gap: Array
    slope: Array
    white_gap: Array
    white_slope: Array


def match_views(
    first: View,
    second: View,
    known: Known | None = None,
    near_s: float | None = None,
    rough: tuple[View, View] | None = None,
) -> Match:
    """Find the second camera's clock and what both cameras have in common.

    Parameters
    ----------
    first, second : two views of one motion
    known : of the offset beforehand
    near_s : an offset found already, by the same views in other numbers: no other is tried
    rough : the same views in which offsets to begin from are looked for, where those of one camera are too unsure

    Raises
    ------
    GeometryError : both never see the model long enough, or the motion does not tell the clock; says what would
    """
    within = None
    if known is not None:
        reach = 5 * known.sd_s + LARGEST_RATE * abs(known.at_s)
        within = known.offset_s - reach, known.offset_s + reach
    tried = starts(*(rough or (first, second)), within) if near_s is None else [Start(near_s, 0.0)]
    if not tried:
        raise GeometryError(
            f"the two cameras never see the model together for {LEAST_TOGETHER_S:g} s"
            + ("" if within is None else f" with an offset between {within[0]:.2f} and {within[1]:.2f} s")
        )
    found: list[Match] = []
    for start in tried:
        one = _fitted(first, second, start.offset_s, known)
        if one is not None and all(abs(one.clock.offset_s - other.clock.offset_s) > TOLD_S for other in found):
            found.append(one)
    if not found and (_moves(first, np.flatnonzero(first.seen)) <= STILL).all():
        raise GeometryError(TOO_LITTLE.format(""))
    if not found:
        raise GeometryError(
            "no offset of the second camera's clock was found at which the two cameras see one motion: are both recordings of this "
            f"tow, and their frame rates right to {LARGEST_RATE:g}? If they see it together for a few seconds only, state offset_s"
        )
    found.sort(key=lambda match: match.misfit)
    best = found[0]
    sd_s = float(best.clock.sd_at(np.array(best.middle_s)))
    if known is None and sd_s > TOLD_S:
        raise GeometryError(TOO_LITTLE.format(f": its offset would be known to {sd_s:.2g} s"))
    quiet = min(one.inflation for one in found)
    for other in found[1:]:
        if (other.misfit - best.misfit) * min(len(other.rows), len(best.rows)) / quiet < SURE_BY:
            raise GeometryError(
                f"two offsets of the second camera's clock fit alike, {best.clock.offset_s:.2f} and {other.clock.offset_s:.2f} s: "
                "the motion repeats itself; state offset_s within half a swing, with its offset_sd_s"
            )
    return best


def unmatched(first: View, second: View, known: Known) -> Match:
    """Two views as they are stated, before anything was told of them by one another: for what is joined until then.

    Parameters
    ----------
    first, second : two views of one motion
    known : of the second one's clock
    """
    seen_s = second.t_s if len(second.t_s) else np.zeros(1)
    middle, span = _middle(seen_s)
    modes = first.own + second.own + first.shared
    covariance = np.eye(2 + modes)
    covariance[0, 0] = known.sd_s**2 + (RATE_SDS[-1] * (middle - known.at_s)) ** 2
    covariance[1, 1] = (RATE_SDS[-1] * span) ** 2
    clock = Clock(known.offset_s, 0.0, np.diag([known.sd_s**2, RATE_SDS[-1] ** 2]))
    none, nothing = np.zeros(0, dtype=int), np.zeros(first.pose.shape[1])
    beside = between(second, np.zeros(0))
    return Match(
        first,
        second,
        clock,
        none,
        beside,
        np.zeros(modes),
        covariance,
        middle,
        span,
        1.0,
        0.0,
        0,
        nothing,
        nothing,
        nothing,
        0.0,
    )


def _fitted(first: View, second: View, offset_s: float, known: Known | None) -> Match | None:
    """The match nearest to an offset; None where the iteration leaves it or the two no longer overlap."""
    extra = between_variance(second)
    stood = _standing(first, second, (offset_s, 0.0), known, extra)
    if stood is None:
        return None
    offset_s, rate, at = stood
    theta, _, left = _solve(first, second, at, _known_at(offset_s, rate, at, known))
    misfit = float((left @ left + theta[2:] @ theta[2:]) / len(at.rows))
    inflation = _inflation(left, first.t_s[at.rows], first.pose.shape[1])
    if inflation > 1.0:
        # errors that last count for less, and what is known of the cameras for more: another clock
        stood = _standing(first, second, (offset_s, rate), known, extra, inflation)
        if stood is None:
            return None
        offset_s, rate, at = stood
    middle, span = _middle(at.second_s)
    theta, covariance, left = _solve(first, second, at, _known_at(offset_s, rate, at, known), inflation)
    back = np.array([[1.0, -middle / span], [0.0, 1.0 / span]])  # (offset, rate) of (at the middle, over the span)
    clock = Clock(offset_s, rate, back @ covariance[:2, :2] @ back.T)
    stated = ~np.logical_or(*_slow(first, second))
    chi_square, degrees = _against_stated(theta[2:][stated], covariance[2:, 2:][np.ix_(stated, stated)])
    mean = at.slope[..., 2:].mean(axis=0)
    noise = np.sqrt(np.einsum("nd->d", _frame_variance(first, second, at)) * inflation) / len(at.rows)
    left = np.sqrt(((at.gap - at.slope @ theta) ** 2).mean(axis=0))
    if inflation > 1.0 and (left[1:3] > UNLIKE * first.pose[at.rows, 1:3].std(axis=0)).all():
        return None
    return Match(
        first,
        second,
        clock,
        at.rows,
        at.beside,
        theta[2:],
        covariance,
        middle,
        span,
        inflation,
        chi_square,
        degrees,
        at.gap.mean(axis=0),
        np.hypot(np.sqrt((mean**2).sum(axis=1)), noise),
        left,
        misfit,
    )


def _standing(
    first: View,
    second: View,
    begin: tuple[float, float],
    known: Known | None,
    extra: Array,
    inflation: float = 1.0,
) -> tuple[float, float, _Rows] | None:
    """Offset and rate at which the clock stands, and the differences there; None where the iteration leaves where it began."""
    offset_s, rate = begin
    for _ in range(STEPS):
        at = _differences(first, second, offset_s, rate, extra)
        if at is None:
            return None
        middle, span = _middle(at.second_s)
        change, turn = _solve(first, second, at, _known_at(offset_s, rate, at, known), inflation)[0][:2]
        # the change is one of the first clock at the middle of the rows: offset + (1 + rate) middle
        offset_s += float(change - turn / span * middle)
        rate += float(turn / span)
        if abs(offset_s - begin[0]) > STRAYS_S or abs(rate) > LARGEST_RATE:
            return None
        if max(abs(change), abs(turn)) < SMALLEST_S:
            break
    at = _differences(first, second, offset_s, rate, extra)
    return None if at is None else (offset_s, rate, at)


def _known_at(offset_s: float, rate: float, at: _Rows, known: Known | None) -> tuple[Array, Array]:
    """``_clock_prior`` at these differences."""
    return _clock_prior(offset_s, rate, *_middle(at.second_s), known)


def _middle(second_s: Array) -> tuple[float, float]:
    """The middle of the rows and half of what they span, on the second clock."""
    low, high = float(second_s[0]), float(second_s[-1])
    return (low + high) / 2, max((high - low) / 2, 1e-3)


def _clock_prior(offset_s: float, rate: float, middle: float, span: float, known: Known | None) -> tuple[Array, Array]:
    """What is known of the clock's change, rows (q, 2) and values (q,): the rate, in units of itself, then the offset if stated, in
    its standard deviations.
    """
    rows, values = [[0.0, 1.0 / span]], [-rate]
    if known is not None:
        rows.append([1.0 / known.sd_s, (known.at_s - middle) / span / known.sd_s])
        values.append((known.offset_s - offset_s - rate * known.at_s) / known.sd_s)
    return np.array(rows), np.array(values)


def _differences(first: View, second: View, offset_s: float, rate: float, extra: Array) -> _Rows | None:
    """The differences where both see the model, at one clock; None where that is nowhere for long."""
    seen = np.flatnonzero(first.seen)
    at_s = (first.t_s[seen] - offset_s) / (1 + rate)
    beside = between(second, at_s)
    rows, beside = (
        seen[beside.told],
        Between(beside.told[beside.told], beside.frame[beside.told], beside.weight[beside.told]),
    )
    if len(rows) < 2 or len(rows) * first.step_s < LEAST_TOGETHER_S:
        return None
    second_s = (first.t_s[rows] - offset_s) / (1 + rate)
    other = beside.of(second.pose)
    gap = first.pose[rows] - other
    if gap.shape[1] > 2:
        gap[:, 2] = (gap[:, 2] + np.pi) % (2 * np.pi) - np.pi
    own = np.moveaxis(first.modes[:, rows], 0, 2)
    others = (
        np.moveaxis(np.stack([beside.of(mode) for mode in second.modes]), 0, 2) if len(second.modes) else own[..., :0]
    )
    path = first.rates[rows] * _moves(first, rows)
    middle, span = _middle(second_s)
    clock = -path[..., None] * np.stack([np.ones_like(second_s), (second_s - middle) / span], axis=-1)[:, None]
    shared = own[..., first.own :] - others[..., second.own :]
    slope = np.concatenate([clock, own[..., : first.own], -others[..., : second.own], shared], axis=2)
    whiten = _Whitener(first.covariance[rows], second.covariance, beside, extra)
    return _Rows(rows, beside, second_s, gap, slope, whiten(gap.reshape(-1)), whiten(slope.reshape(gap.size, -1)))


def _moves(view: View, rows: NDArray[np.int_]) -> Array:
    """(D,) how much of the rates in these rows is motion and not their frames' noise: 1 where it moves, near 0 where it rests.

    What two frames' noise feigns of a rate would tell the clock all the better the longer a model stands: every rate counts by the
    share of its mean square that is beyond that noise, and beyond what chance makes of it.
    """
    square = (view.rates[rows] ** 2).mean(axis=0)
    noise = rate_noise(view) * np.einsum("ndd->nd", view.covariance[rows]).mean(axis=0)
    chance = 1.0 + STILL_SD * 2.0 / np.sqrt(len(rows))  # of squares of which neighbours in pairs share a frame
    return np.clip(1.0 - np.divide(chance * noise, square, out=np.ones_like(noise), where=square > 0), STILL, 1.0)


class _Whitener:
    """Divides rows of differences by the root of their covariance, which neighbours share through the frames between them."""

    def __init__(self, covariance: Array, other: Array, beside: Between, extra: Array) -> None:
        n, size = covariance.shape[:2]
        blocks: list[Array] = [covariance + np.diag(extra) + beside.covariance(other)]
        weighted = beside.weight[..., None, None] * np.nan_to_num(other[beside.frame])
        for lag in range(1, n):
            same = beside.frame[lag:, :, None] == beside.frame[:-lag, None, :]  # (n - lag, 4, 4)
            if not same.any():
                break
            count = np.where(same, beside.weight[lag:, :, None], 0.0)
            blocks.append(np.einsum("nab,nbij->nij", count, weighted[:-lag]))
        width = len(blocks) * size
        band = np.zeros((width, n * size))
        for lag, block in enumerate(blocks):
            columns = np.arange(n - lag) * size
            for i in range(size):
                for j in range(size):
                    if lag * size + i - j >= 0:
                        band[lag * size + i - j, columns + j] = block[:, i, j]
        self._band = cholesky_banded(band, lower=True)

    def __call__(self, values: Array) -> Array:
        return solve_banded((len(self._band) - 1, 0), self._band, values)


def _solve(
    first: View, second: View, at: _Rows, prior: tuple[Array, Array], inflation: float = 1.0
) -> tuple[Array, Array, Array]:
    """Clock's change and modes (2 + K,), their covariance, and what is left of the whitened differences.

    How large pulls and lags are is stated as what they usually are at most, and how good the rate is as one of two: the differences
    tell it, by their likelihood at each of ``SIZES`` and ``RATE_SDS``; the answer is the mean over these with its scatter.
    """
    rows, values = prior
    slope, gap = at.white_slope / np.sqrt(inflation), at.white_gap / np.sqrt(inflation)
    normal, right = slope.T @ slope, slope.T @ gap
    pulls, lags = _slow(first, second)
    tried = []
    for rate_sd, pull, lag in product(RATE_SDS, SIZES if pulls.any() else (1.0,), SIZES if lags.any() else (1.0,)):
        scale = np.array([1 / rate_sd, 1.0][: len(values)])
        known, said = rows * scale[:, None], values * scale
        weight = np.where(pulls, pull**-2, np.where(lags, lag**-2, 1.0))
        whole, pulled = normal + np.diag(np.concatenate([[0.0, 0.0], weight])), right.copy()
        whole[:2, :2] += known.T @ known
        pulled[:2] += known.T @ said
        factor = cho_factor(whole, lower=True)
        theta = cho_solve(factor, pulled)
        likely = 0.5 * (pulled @ theta - said @ said + np.log(weight).sum()) - np.log(rate_sd)
        likely -= np.log(np.diag(factor[0])).sum()
        tried.append((likely, theta, factor))
    best = max(likely for likely, _, _ in tried)
    tried = [one for one in tried if one[0] > best - NOTHING]
    tried = [(likely, theta, cho_solve(factor, np.eye(len(normal)))) for likely, theta, factor in tried]
    share = np.exp([likely - best for likely, _, _ in tried])
    share /= share.sum()
    theta = sum(s * one for s, (_, one, _) in zip(share, tried, strict=True))
    covariance = sum(
        s * (spread + np.outer(one - theta, one - theta)) for s, (_, one, spread) in zip(share, tried, strict=True)
    )
    return np.asarray(theta), np.asarray(covariance), gap - slope @ theta


def _slow(first: View, second: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of the modes (K,) are pulls, and which are lags of a codec."""
    pulls = np.zeros(first.own + second.own + first.shared, dtype=bool)
    lags = pulls.copy()
    for begin, view in ((0, first), (first.own, second)):
        pulls[begin : begin + view.pulls] = True
        lags[begin + view.pulls : begin + view.slow] = True
    return pulls, lags


def _inflation(left: Array, t_s: Array, size: int) -> float:
    """By how much sums over frames vary more than if every frame's error were new and as stated; 1 where chance explains it."""
    rest = left.reshape(-1, size)
    worst, step = 1.0, float(np.median(np.diff(t_s)))
    for length_s in (step, *BLOCKS_S):
        many = max(1, round(length_s / step))
        count = len(rest) // many
        if count < FEWEST_BLOCKS:
            continue
        sums = rest[: count * many].reshape(count, many, size).sum(axis=1) / np.sqrt(many)
        chi_square, degrees = float((sums**2).sum()), sums.size
        if chdtrc(degrees, chi_square) < COLOURED:
            worst = max(worst, chi_square / degrees)
    return worst


def _against_stated(values: Array, covariance: Array) -> tuple[float, int]:
    """Chi-square and degrees of what the differences tell of the modes, against the unit variance that was stated of them."""
    share, mixture = np.linalg.eigh(np.eye(len(values)) - covariance)
    told = share > TOLD_SHARE
    if not told.any():
        return 0.0, 0
    return float(((mixture.T @ values)[told] ** 2 / share[told]).sum()), int(told.sum())


def _frame_variance(first: View, second: View, at: _Rows) -> Array:
    """(n, D) variance of a row's difference by the frames' noise."""
    both = first.covariance[at.rows] + at.beside.covariance(second.covariance)
    return np.einsum("ndd->nd", both)


__all__ = ["TOLD_S", "Known", "Match", "match_views", "unmatched"]
