"""Motion from channels: at every time the y_CG and beta that fit all readings best, the line taut (thesis 7.4 to 7.13).

Two lamps alone give (7.4), (7.7), (7.9) exactly: beta = asin((y1 - y2)/D), y_CG between them, alpha = asin((y_T - y_post)/L). Two
potentiometers alone give beta = p2 - p1 and y_CG from (2.10). More readings than two are weighed by their deviations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import EstimationError, TowlineError
from .channels import Array, Channel
from .clock import Clock, clock_from_events, clock_from_match
from .setup import ClockTable, SetupFile

if TYPE_CHECKING:
    import pandas as pd

MOTION = ("y", "alpha", "alpha_beta", "beta", "lvdt")
ITERATIONS, REACH = 30, 0.9995
"""``REACH``: sin(alpha) is held below this while iterating."""
SMOOTH_S = 0.5
"""The readings' rates are averaged over this time."""
SLOWER = 1.5
"""A channel whose step is longer than the output's by more than this factor is named as slow: a choice."""
FREE = 1e-3
"""A reading that the fit follows to all but this share has no residual to judge it by."""


@dataclass(frozen=True)
class FromInstruments:
    """Motion from channels.

    Attributes
    ----------
    motion : motion table; sigma_* varies from sample to sample, common_* comes from the clocks
    clocks : by name
    tow_point_m : X_T that was used
    sentences : clocks and residuals in words
    notes : for the user
    """

    motion: pd.DataFrame
    clocks: dict[str, Clock]
    tow_point_m: float
    sentences: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _State:
    """y_CG, beta, alpha at (n,) times, their covariance (n, 3, 3) and how each reading moves them, (n, 3, channels).

    ``residual`` (channels, n) is over what the reading's sd and its own share in the fit let expect; NaN where fitted exactly.
    """

    y: Array
    beta: Array
    alpha: Array
    covariance: Array
    gain: Array
    residual: Array


def motion_from_channels(setup: SetupFile, channels: dict[str, Channel]) -> FromInstruments:
    """Motion table from the channels of a set-up.

    Parameters
    ----------
    setup : which channel measures what
    channels : by name, as ``read_channels`` gives them, on their own clocks

    Returns
    -------
    motion : t_s on the reference clock, y_cg_m, beta_rad, alpha_rad, x_cg_m and tension_n where measured, sigmas, status;
        a sample at which the readings do not fix the motion is lost

    Raises
    ------
    TowlineError : the channels cannot fix the motion, or a clock cannot be matched
    """
    import pandas as pd

    times, notes = _raster(setup, channels)
    reference = {name: c for name, c in channels.items() if c.table.clock is None}
    clocks: dict[str, Clock] = {}
    for table in setup.clock:
        try:
            clocks[table.name] = _clock(setup, table, channels, reference, times)
        except EstimationError as error:
            raise EstimationError(f"clock {table.name!r}: {error}") from None
    common = dict(reference)
    for name, channel in channels.items():
        if channel.table.clock is not None:
            common[name] = channel.on(clocks[channel.table.clock].to_reference(channel.t_s))
    moving = {name: c for name, c in common.items() if c.table.measures in MOTION}
    notes += _slower(moving, times)
    state = _estimated(setup, moving, times)
    good = np.isfinite(state.y)
    if not good.any():
        raise TowlineError(
            f"the channels {', '.join(moving) or 'given'} never fix y_CG and beta together; two lamps, or both potentiometers, or "
            "a lamp and an angle are needed"
        )
    sigma = np.sqrt(np.maximum(np.diagonal(state.covariance, axis1=1, axis2=2), 0.0))
    columns = {"t_s": times, "y_cg_m": state.y, "beta_rad": state.beta, "alpha_rad": state.alpha}
    columns |= _x_cg(setup, common, times, state.beta)
    tensions = [c for c in common.values() if c.table.measures == "tension"]
    if tensions:
        columns["tension_n"] = tensions[0].at(times)[0]
    names = ("y_cg_m", "beta_rad", "alpha_rad")
    columns |= {f"sigma_{name}": np.where(good, sigma[:, k], np.nan) for k, name in enumerate(names)}
    if clocks:
        modes = _common_sd(setup, moving, clocks, times, state)
        columns |= {f"common_{name}": np.where(good, modes[:, k], np.nan) for k, name in enumerate(names)}
    motion = pd.DataFrame(columns)
    motion["status"] = np.where(good, "measured", "lost")
    return FromInstruments(motion, clocks, setup.tow_point_m, tuple(_sentences(clocks, moving, state)), tuple(notes))


def _raster(setup: SetupFile, channels: dict[str, Channel]) -> tuple[Array, list[str]]:
    own = {n: c for n, c in channels.items() if c.table.clock is None and c.table.measures in MOTION}
    if setup.times is not None:
        return channels[setup.times].t_s, []
    if not own:
        raise TowlineError("no channel of the reference clock measures the motion; `times` cannot be chosen")
    name = max(own, key=lambda key: own[key].step_s)
    return own[name].t_s, [f"times are those of {name}, {1 / own[name].step_s:.4g} per second"]


def _slower(moving: dict[str, Channel], times: Array) -> list[str]:
    step = float(np.median(np.diff(times)))
    slow = [name for name, c in moving.items() if c.step_s > SLOWER * step]
    return [
        f"{name} is sampled more slowly than the motion: its noise is shared by neighbouring samples, which the sigmas do not say"
        for name in slow
    ]


# the fit at every time ---------------------------------------------------------------------------------------------


def _sine(setup: SetupFile, y: Array, beta: Array) -> Array:
    """sin(alpha) of the taut line (2.10)."""
    tow = setup.tow
    lateral = y - tow.post_m[1] + setup.tow_point_m * np.sin(beta) + tow.tow_point_offset_m * np.cos(beta)
    return lateral / tow.line_length_m


def _line(setup: SetupFile, y: Array, beta: Array) -> tuple[Array, Array, Array]:
    """alpha and its slopes over y and beta; sin(alpha) held below 1."""
    sine = np.clip(_sine(setup, y, beta), -REACH, REACH)
    cosine = np.sqrt(1 - sine**2) * setup.tow.line_length_m
    arm = setup.tow_point_m * np.cos(beta) - setup.tow.tow_point_offset_m * np.sin(beta)
    return np.arcsin(sine), 1 / cosine, arm / cosine


def _predicted(setup: SetupFile, channel: Channel, y: Array, beta: Array) -> tuple[Array, Array, Array]:
    """What a channel would read, and its slopes over y and beta (9.10, 7.13)."""
    kind = channel.table.measures
    if kind == "y":
        ahead, side = setup.place_m(channel.table), channel.table.side_m
        return (
            y + ahead * np.sin(beta) + side * np.cos(beta),
            np.ones_like(y),
            ahead * np.cos(beta) - side * np.sin(beta),
        )
    if kind == "beta":
        return beta, np.zeros_like(y), np.ones_like(y)
    alpha, by_y, by_beta = _line(setup, y, beta)
    if kind == "alpha_beta":
        return alpha + beta, by_y, by_beta + 1
    if kind == "lvdt":
        assert channel.table.pulley_m is not None
        radius = channel.table.pulley_m / 2
        return radius * alpha, radius * by_y, radius * by_beta
    return alpha, by_y, by_beta


def _estimated(setup: SetupFile, moving: dict[str, Channel], times: Array) -> _State:
    readings = [channel.at(times) for channel in moving.values()]
    value = np.array([reading[0] for reading in readings]).reshape(len(moving), len(times))
    sd = np.array([reading[1] for reading in readings]).reshape(len(moving), len(times))
    weight = np.where(np.isfinite(value), 1 / np.where(np.isfinite(value), sd, 1.0) ** 2, 0.0)
    y, beta = np.full(len(times), setup.tow.post_m[1]), np.zeros(len(times))
    for _ in range(ITERATIONS):
        rows, left = _rows(setup, moving, value, y, beta)
        inverse = _inverse(rows, weight)
        step = np.einsum("nij,cnj,cn,cn->ni", inverse, rows, weight, left)
        step = np.where(np.isfinite(step), step, 0.0)
        y, beta = y + step[:, 0], beta + np.clip(step[:, 1], -0.5, 0.5)
        if np.abs(step).max() < 1e-14:
            break
    rows, left = _rows(setup, moving, value, y, beta)
    inverse = _inverse(rows, weight)
    sine = _sine(setup, y, beta)
    lost = np.isnan(inverse[:, 0, 0]) | (np.abs(sine) >= REACH)
    alpha, by_y, by_beta = _line(setup, y, beta)
    spread = np.zeros((len(times), 3, 2))
    spread[:, 0, 0] = spread[:, 1, 1] = 1.0
    spread[:, 2, 0], spread[:, 2, 1] = by_y, by_beta
    covariance = spread @ inverse @ spread.transpose(0, 2, 1)
    gain = np.einsum("nki,nij,cnj,cn->nkc", spread, inverse, rows, weight)
    y, beta, alpha = (np.where(lost, np.nan, part) for part in (y, beta, alpha))
    free = 1 - weight * np.einsum("cni,nij,cnj->cn", rows, inverse, rows)
    judged = (weight > 0) & (free > FREE)
    residual = np.where(judged, left * np.sqrt(weight / np.where(judged, free, 1.0)), np.nan)
    return _State(y, beta, alpha, covariance, gain, residual)


def _rows(setup: SetupFile, moving: dict[str, Channel], value: Array, y: Array, beta: Array) -> tuple[Array, Array]:
    found = [_predicted(setup, channel, y, beta) for channel in moving.values()]
    rows = np.array([[one[1], one[2]] for one in found]).reshape(len(moving), 2, len(y)).transpose(0, 2, 1)
    model = np.array([one[0] for one in found]).reshape(len(moving), len(y))
    return rows, np.where(np.isfinite(value), value - model, 0.0)


def _inverse(rows: Array, weight: Array) -> Array:
    """(J' W J)^-1 at every time, (n, 2, 2); NaN where two readings are not enough."""
    normal = np.einsum("cni,cn,cnj->nij", rows, weight, rows)
    determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    size = normal[:, 0, 0] * normal[:, 1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(determinant > 1e-12 * size, 1 / determinant, np.nan)
    adjugate = np.stack([normal[:, 1, 1], -normal[:, 0, 1], -normal[:, 0, 1], normal[:, 0, 0]], axis=1).reshape(
        -1, 2, 2
    )
    return adjugate * scale[:, None, None]


def _x_cg(setup: SetupFile, common: dict[str, Channel], times: Array, beta: Array) -> dict[str, Array]:
    """x_CG from the lamps' x, weighed by their deviations."""
    lamps = [c for c in common.values() if c.table.measures == "x"]
    if not lamps:
        return {}
    total, weights = np.zeros(len(times)), np.zeros(len(times))
    for lamp in lamps:
        value, sd = lamp.at(times)
        place = value - setup.place_m(lamp.table) * np.cos(beta) + lamp.table.side_m * np.sin(beta)
        good = np.isfinite(place)
        weight = np.where(good, 1 / np.where(good, sd, 1.0) ** 2, 0.0)
        total += np.where(good, weight * np.where(good, place, 0.0), 0.0)
        weights += weight
    return {"x_cg_m": np.where(weights > 0, total / np.where(weights > 0, weights, 1.0), np.nan)}


# clocks ------------------------------------------------------------------------------------------------------------


def _clock(
    setup: SetupFile, table: ClockTable, channels: dict[str, Channel], reference: dict[str, Channel], times: Array
) -> Clock:
    if table.events_s:
        own, other = np.array(table.events_s).T
        return clock_from_events(own, other, table.event_sd_s, table.drift_sd)
    assert table.match is not None
    channel = channels[table.match]
    if table.against is not None:
        target = reference[table.against].t_s, reference[table.against].value
    else:
        moving = {name: c for name, c in reference.items() if c.table.measures in MOTION}
        state = _estimated(setup, moving, times)
        if channel.table.measures not in MOTION or not np.isfinite(state.y).any():
            raise EstimationError(
                f"the reference's channels alone do not say what {table.match} measures; name one with `against`, or give events_s"
            )
        target = times, _predicted(setup, channel, state.y, state.beta)[0]
    return clock_from_match(
        (channel.t_s, channel.value),
        target,
        search_s=table.search_s,
        detail_s=table.detail_s,
        drift_sd=table.drift_sd,
    )


def _common_sd(
    setup: SetupFile, moving: dict[str, Channel], clocks: dict[str, Clock], times: Array, state: _State
) -> Array:
    """What the clocks' errors do to y_CG, beta, alpha, (n, 3): the readings' rates times the clock's deviation, through the fit."""
    total = np.zeros((len(times), 3))
    width = max(round(SMOOTH_S / float(np.median(np.diff(times)))), 1)
    for name, clock in clocks.items():
        mode = np.zeros((len(times), 3))
        for index, channel in enumerate(moving.values()):
            if channel.table.clock != name:
                continue
            known = np.isfinite(state.y)
            reading = _predicted(setup, channel, state.y, state.beta)[0]
            rate = np.gradient(np.interp(times, times[known], reading[known]), times)
            rate = np.convolve(
                np.pad(rate, (width // 2, width - 1 - width // 2), mode="edge"), np.ones(width) / width, "valid"
            )
            own = times - clock.offset_s
            mode += state.gain[:, :, index] * (rate * clock.time_sd(own))[:, None]
        total += mode**2
    return np.sqrt(total)


def _sentences(clocks: dict[str, Clock], moving: dict[str, Channel], state: _State) -> list[str]:
    said = []
    for name, clock in clocks.items():
        offset_sd, drift_sd = clock.sd
        said.append(
            f"clock {name}: offset {clock.offset_s:+.4f} +- {offset_sd:.4f} s at its {clock.middle_s:.1f} s, "
            f"drift {1e6 * clock.drift:+.1f} +- {1e6 * drift_sd:.1f} ppm"
        )
    for index, name in enumerate(moving):
        left = state.residual[index, np.isfinite(state.y)]
        left = left[np.isfinite(left)]
        if len(left):
            said.append(f"{name}: residual {np.sqrt(np.mean(left**2)):.2f} of what its sd lets expect")
    return said
