"""A steady tow while it is filmed: where it will come to rest, how well that is known, and whether X_v stands.

As long as the record still swings or drifts, the mean of the fit that describes its end says where it goes (``transient``); once
it has settled, the settled tail's mean. A towed hull has four roots, the fit one swing and one exponential: what that leaves is in
the mean's errors, as a share of what still moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ..record.errors import EstimationError, InputError
from ..record.results import Measured
from ..record.run import Run
from ..simulate.model import Array
from .settled import SURE, Judged, tail_mean
from .steady import (
    SteadyState,
    fit_steady,
    judged_tow,
    stands_off,
    state_of,
    tow_angles,
    window_modes,
)
from .transient import Transient

FORM = 0.3
"""Of what still moves would move a plain mean by, the fit's mean errs by so much before a whole swing was seen, and by this over
the cube of the swings seen after. All but exact motions, 3 to 8 degrees aside: MARINER at 2.2 m (two pairs of roots) errs by 0.1
to 0.3 of it in 12 to 16 s, 0.02 to 0.07 in 22 s, 0.01 in 30 s; a frigate (one pair) by 0.02 to 0.1, 0.02 and 0.01."""
STANDS = 0.9
"""X_v stands where all that more seconds of this tow could do leaves this share of its standard deviation."""


@dataclass(frozen=True)
class Settling:
    """What a record says so far of where its tow comes to rest.

    Attributes
    ----------
    words : in a sentence
    state : where it rests, or will; None: nothing is told yet, ``words`` says why
    settled : it rests, by what ``steady_state`` asks of a tow
    wait_s : how much longer it takes to; None: it has settled, or that is not told
    independent : samples of white noise that would know the mean as well as this window's coloured ones; None: not settled
    """

    words: str
    state: SteadyState | None = None
    settled: bool = False
    wait_s: float | None = None
    independent: float | None = None


def settling(run: Run, motion: pd.DataFrame, common: Array | None) -> Settling:
    """Where a tow comes to rest, from its record so far.

    Parameters
    ----------
    run : the run folder as read
    motion : with alpha_rad and beta_rad
    common : (k, n, 3) of ``geometry.Motion`` or None

    Raises
    ------
    InputError : not a tow, or without alpha
    """
    good, times, angles = tow_angles(run, motion)
    try:
        found = judged_tow(run, motion, common)
    except InputError as short:
        return Settling(short.message)
    if not found.settled:
        return _before(run, found, times, window_modes(common, good, found.first))
    mean, noise = tail_mean(angles[found.first :])
    modes = window_modes(common, good, found.first)
    state = state_of(
        run, times[found.first :], mean, noise + found.small, modes, found.stability, whole=found.first == 0
    )
    slope = state.force()[1]
    scatter = angles[found.first :] - mean
    independent = float(np.var(scatter @ slope) / max(float(slope @ noise @ slope), 1e-300))
    seconds = times[-1] - times[found.first]
    words = f"settled: {_angles(state)} over {seconds:.0f} s, worth {independent:.0f} independent samples"
    return Settling(words, state, True, None, independent)


def _before(run: Run, found: Judged, times: Array, modes: Array) -> Settling:
    """Of a tow that still moves: the mean of the fit that describes it, where it goes there."""
    fit, verdict = found.transient, found.stability.verdict
    falls = fit.rates[0] > SURE * fit.rate(0)[1]
    if verdict in ("growing", "shearing off") or (verdict == "drifting" and not falls):
        return Settling(f"{found.stability.words}: it is not told where it will rest")
    covariance = fit.covariance[np.ix_((3, 7), (3, 7))] + _form(fit)
    state = state_of(run, times[found.first :], fit.amplitudes[:, 0], covariance, modes, found.stability)
    wait = "" if found.wait_s is None else f", settled in some {found.wait_s:.0f} s"
    words = f"{found.stability.words}{wait}; it will rest at {_angles(state)}"
    return Settling(words, replace(state, settled=False), False, found.wait_s)


def _form(fit: Transient) -> Array:
    """(2, 2), covariance of the mean for what the fit's form leaves: a share of what still moves (``FORM``)."""
    swings = fit.rates[2] * (fit.end_s - fit.begin_s) / (2 * np.pi)
    return (FORM / max(swings, 1.0) ** 3) ** 2 * _carried(fit)


def _carried(fit: Transient) -> Array:
    """(2, 2), by what swing and exponential would move a plain mean over the fit's record at the worst phase, squared."""
    span = fit.end_s - fit.begin_s
    parts, _ = fit.swing((fit.begin_s + fit.end_s) / 2)
    half, fallen = 0.5 * fit.rates[1] * span, fit.rates[0] * span
    envelope = float(np.sinh(half) / half) if abs(half) > 1e-6 else 1.0
    parts = parts * envelope * min(1.0, 2.0 / (fit.rates[2] * span))
    drift = fit.amplitudes[:, 1] * (float(-np.expm1(-fallen) / fallen) if abs(fallen) > 1e-6 else 1.0)
    return parts @ parts.T + np.outer(drift, drift)


def _angles(state: SteadyState) -> str:
    sd = np.sqrt(np.maximum(np.diag(state.covariance + state.common.T @ state.common), 0.0))
    a, b, sd_a, sd_b = np.degrees([state.alpha_rad, state.beta_rad, *sd])
    return f"alpha {a:+.2f} +- {sd_a:.2f}, beta {b:+.2f} +- {sd_b:.2f} degrees"


@dataclass(frozen=True)
class NeutralPoint:
    """X_v by a tow that is being filmed and those before it.

    Attributes
    ----------
    words : in a sentence
    x_v_m : None: not told, ``words`` says why
    interval_m : 95 %
    stands : more seconds of this tow would not tell it better by a tenth
    """

    words: str
    x_v_m: Measured | None = None
    interval_m: tuple[float, float] | None = None
    stands: bool = False


def neutral_point(now: Settling, before: Sequence[SteadyState], wish_m: float | None = None) -> NeutralPoint:
    """X_v by a tow as far as it has settled, and by the steady tows before it.

    Parameters
    ----------
    now : of the tow that is being filmed
    before : the others
    wish_m : half-width of the 95 % interval that is enough, m; None: not said
    """
    state = now.state
    if state is None:
        return NeutralPoint(f"no X_v yet: {now.words}")
    if not stands_off(state):
        return NeutralPoint(
            f"no X_v yet: {now.words}; a side force that its errors leave in no doubt is needed (rudder over)"
        )
    if not any(abs(tow.tow_point_m - state.tow_point_m) > 0 for tow in before):
        return NeutralPoint(f"{now.words}; X_v needs a steady tow at another tow point")
    try:
        fit = fit_steady([*before, state])
        least = fit_steady([*before, replace(state, covariance=np.zeros((2, 2)))])
    except EstimationError as error:
        return NeutralPoint(f"no X_v: {error}; {now.words}")
    low, high = fit.interval_m
    enough = wish_m is not None and (high - low) / 2 <= wish_m
    stands = now.settled and (enough or least.x_v_m.std >= STANDS * fit.x_v_m.std)
    why = "the wish is met" if enough else "longer would not tell it better"
    said = f"stands: {why}" if stands else "settling" if not now.settled else "settled; longer tells it better"
    words = f"X_v {fit.x_v_m.value:.4f} +- {fit.x_v_m.std:.4f} m (95 %: {low:.4f} to {high:.4f}), {said}; {now.words}"
    return NeutralPoint(words, fit.x_v_m, fit.interval_m, stands)


__all__ = ["STANDS", "NeutralPoint", "Settling", "neutral_point", "settling"]
