"""The standard deviation of a point that its own window cannot show: read from its path and from the rigid body.

A codec, the air, the sensor's pixels add errors that a fit's residual does not hold. A quintic spline through the path leaves
them over, with knots as far apart as the motion allows. An error that lasts longer than a knot's span stays hidden in a slow
path, but a codec's error has the same size along u and v and only lasts longer where the mark moves slowly; so the axis that
shows more of it speaks for both. At last the distances between the marks, which a rigid body keeps, are held against what the
sigmas let expect of them.

A codec that leaves a part of the picture as it was in the frame before shows the mark where it was, not where it is. Such a
place (``repeated``) is as old as the last picture of its own, and off by what the mark has moved since. In the other pictures of
such a codec a mark may lag as well (``geometry.lag``), about as far as its places scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..geometry.lag import mark_rate
from ..geometry.mapping import Mapping, ray_slopes
from ..geometry.poses import LAG_COLUMN
from ..geometry.robust import MAD_TO_SD
from ..record.corrections import Placed
from ..record.schema import Marker
from .attitude import distance_slopes
from .spots.candidates import Array
from .spots.stretch import GROUND_COLUMNS, LIMIT_COLUMN

SPANS_S = (0.2, 0.3, 0.45, 0.65, 1.0, 1.4, 2.0)
"""Spans of the spline's knots: longer ones leave more of a slow error over, until the motion itself comes up."""
LEAST_KNOT_FRAMES = 5
"""Frames between two knots of the spline at least: a choice, so that each of its pieces is overdetermined."""
LEAST_SPANS = 6
"""A track is long enough for a span when it holds so many: a choice."""
DEGREE = 5
"""Of the spline: what it leaves over of a motion goes with the span to the sixth power, in variance to the
twelfth."""
GROWTH = 1.5
"""Allowed growth from the first span to the second, before any has been seen: a choice."""
SLOWING = 1.08
"""From span to span the residual's variance of an error grows less and less, and never faster than the span (a random walk);
the motion's grows more and more (the span to the twelfth power): where growth quickens by more than this factor, and does not
slow down at the next span, it comes up."""
MOST_POWER = 2.0
"""Power of the span by which an error's variance may grow where the next span shows no motion: an error smoother than a
random walk, as B frames make it. A motion that grows by less has a share below 1 %, and would show at the next span."""
LOOK_SPANS = 3
"""A span of which a track holds only so many does not tell the error, but whether a motion had come up before it: a choice."""
CLIP_SD = 5.0
"""A residual counts at most as this many robust standard deviations."""
MOST_SAMPLES = 3000
"""A longer track is told by its first and last halves of so many, or by every n-th frame: half an hour tells no
more."""
SHARED_EXCESS = 0.3
"""Excess over the fits' own variance that is more than the estimate's scatter (7 % in 400 frames)."""
ODD_VARIANCE = 3.0
"""A frame whose fit is this much worse than usual (partly covered, blurred) speaks for itself only."""
JUMP_SD, JUMP_PX = 12.0, 1.0
"""A step from frame to frame is no motion but a join of two recordings where it leaves the path's own rate by more than a pixel and
so many of the robust standard deviations of such steps: choices, far beyond noise and what a swing changes within a frame."""
RATE_FRAMES = 5
"""Frames on either side of a step whose median step is the path's own rate there: a choice."""
LONGEST_GAP_S = 1.0
"""A track is no one path over a longer gap: no knot of a spline would hold there."""
STILL_PX = 0.02
"""A mark whose median step from picture to picture is below this stands still, as far as a codec shows."""
STILL_FACTOR = 2.5
"""A codec freezes a still mark's error: its sd over what the residuals give (1.9-3.9 on moving marks at crf 18-28)."""
LEAST_OWN = 0.25
"""Share of pictures of their own from which on these alone say how far a codec is off."""
RIGID_GATE = 4.0
"""A ratio of variances counts when it stands this many of its own standard deviations above 1."""
LEAST_SLOPE = 0.02
"""Roll or pitch that does less to all distances than this share of what the other one does is told by none: a choice."""
LEAST_LEFT = 0.05
"""A distance of whose variance less than this share is left beside roll and pitch tells no errors: a choice."""
MOST_RIGID = 9.0
"""Most by which the rigid body's distances widen a variance: a factor of three in sigma. A choice."""

UNEVEN = "uneven ground"
"""Why a mark is lost whose surroundings may have moved it further than its place may be wrong."""


def with_scatter(
    table: pd.DataFrame,
    markers: Sequence[Marker],
    mapping: Mapping,
    lossy: bool = False,
    linked: bool = False,
    anew: Sequence[Placed] = (),
) -> pd.DataFrame:
    """Widen every sigma of ``table`` to what paths and rigid distances show.

    Parameters
    ----------
    table : tracks table; of ``GROUND_COLUMNS``, where it has them, come variances that neither paths nor distances show
    markers : of run.toml
    mapping : pixel -> tank
    lossy : the recording was compressed with loss; a mark that stands still cannot show its error then
    linked : its pictures are made from others: the table then says how far each mark may lag (LAG_COLUMN)
    anew : seeds, at whose frames the paths begin anew: what was followed before may have been something else
    """
    table = table.copy()
    if linked:
        table[LAG_COLUMN] = np.nan
    spread = {m.name: _stated(table, m) for m in markers}
    clearest = min((usual.max() for _, _, usual in spread.values() if usual is not None), default=0.0)
    for marker in markers:
        at, stated, usual = spread[marker.name]
        if usual is None:
            continue
        like = (stated < ODD_VARIANCE * usual).all(axis=1)
        own = _own(table, at)
        if (like & own).sum() >= max(LEAST_OWN * like.sum(), LEAST_KNOT_FRAMES * LEAST_SPANS):
            like &= own
        rows = table.iloc[at[like]]
        t_s, place = rows["t_s"].to_numpy(), rows[["u_px", "v_px"]].to_numpy()
        begins = sorted({seed.frame for seed in anew})
        excess = np.array([_scatter(rows["frame"].to_numpy(), t_s, place[:, i], begins) ** 2 for i in (0, 1)]) - usual
        excess = np.maximum(excess, 0.0)
        if (excess > SHARED_EXCESS * usual).any():
            excess[:] = excess.max()
        elif lossy and len(place) > 1 and np.median(np.abs(np.diff(place, axis=0)), axis=0).max() < STILL_PX:
            excess = np.maximum(excess, STILL_FACTOR**2 * clearest)
        # the frames that were harder to fit than the others stay so
        widened = np.sqrt(stated + excess + _moved_since(table.iloc[at], own) ** 2)
        table.loc[table.index[at], ["sigma_u_px", "sigma_v_px"]] = widened
        if linked:
            table.loc[table.index[at], LAG_COLUMN] = np.sqrt((usual + excess).mean())
    ratio = rigid_ratio(table, markers, mapping)
    if ratio > 1:
        widened = ["sigma_u_px", "sigma_v_px", *([LAG_COLUMN] if linked else [])]
        table[widened] *= np.sqrt(min(ratio, MOST_RIGID))
    return _on_uneven_ground(table, lossy)


def _on_uneven_ground(table: pd.DataFrame, lossy: bool) -> pd.DataFrame:
    """Sigmas with what the ground beside a mark may do to its place; a place that is then known too badly is lost.

    What a codec does to that ground looks alike, and the path has told it.
    """
    limit = table.pop(LIMIT_COLUMN) if LIMIT_COLUMN in table else None
    for sigma, ground in zip(("sigma_u_px", "sigma_v_px"), GROUND_COLUMNS, strict=True):
        if ground in table:
            more = table.pop(ground).fillna(0.0)
            if not lossy:
                table[sigma] = np.sqrt(table[sigma] ** 2 + more)
    if limit is not None and not lossy:
        lost = (table["status"] == "measured") & (table[["sigma_u_px", "sigma_v_px"]].max(axis=1) > limit)
        table.loc[lost, ["u_px", "v_px", "sigma_u_px", "sigma_v_px"]] = np.nan
        table.loc[lost, ["status", "reason"]] = "lost", UNEVEN
        if "repeated" in table:
            table.loc[lost, "repeated"] = 0
    return table


def _stated(table: pd.DataFrame, marker: Marker) -> tuple[Array, Array, Array | None]:
    """A marker's rows, the variances ``(n, 2)`` that its fits state, and their median (None: never measured)."""
    at = np.flatnonzero(table["marker"] == marker.name)
    stated = table.iloc[at][["sigma_u_px", "sigma_v_px"]].to_numpy() ** 2
    seen = np.isfinite(stated).all(axis=1)
    return at, stated, np.median(stated[seen], axis=0) if seen.any() else None


def _own(table: pd.DataFrame, at: Array) -> Array:
    """(n,) rows whose picture is not the one of the frame before; all where tracks do not say."""
    if "repeated" not in table:
        return np.ones(len(at), dtype=bool)
    return ~(table["repeated"].to_numpy()[at] > 0)


def _moved_since(rows: pd.DataFrame, own: Array) -> Array:
    """(n, 2) px that a mark has moved, at its rate, since the last picture of its own; 0 where the picture is its own."""
    moved = np.zeros((len(rows), 2))
    t_s, place = rows["t_s"].to_numpy(), rows[["u_px", "v_px"]].to_numpy()
    seen = np.isfinite(place).all(axis=1)
    known, stale = np.flatnonzero(own & seen), np.flatnonzero(~own & seen)
    if len(known) < 2 or not len(stale):
        return moved
    last = known[np.maximum(np.searchsorted(known, stale) - 1, 0)]
    for axis in (0, 1):
        rate = mark_rate(t_s[known], place[known, axis], t_s[stale])
        moved[stale, axis] = rate * (t_s[stale] - t_s[last])
    return moved


def _scatter(frame: Array, t_s: Array, values: Array, begins: Sequence[int]) -> float:
    """As ``path_scatter``, of the pieces between the frames at which the path begins anew, by their lengths.

    Where all pieces are too short to tell, the whole path does: a jump in it makes a sigma too large, never too small.
    """
    pieces = np.split(np.arange(len(frame)), np.searchsorted(frame, begins))
    told = [p for p in pieces if len(p) >= LEAST_KNOT_FRAMES * LEAST_SPANS]
    if not begins or not told:
        return path_scatter(t_s, values)
    variance = [path_scatter(t_s[p], values[p]) ** 2 for p in told]
    return float(np.sqrt(np.average(variance, weights=[len(p) for p in told])))


def path_scatter(t_s: Array, values: Array) -> float:
    """Standard deviation of a track's error, px; 0 where the track is too short to tell.

    Parameters
    ----------
    t_s, values : (n,) times, s, and places, px, all measured
    """
    # what joins two recordings is no error of a mark
    pieces = [p for p in _unbroken(t_s, values) if p.stop - p.start >= LEAST_KNOT_FRAMES * LEAST_SPANS]
    if not pieces:
        return 0.0
    told = [_scatter_of_one(t_s[p], values[p]) ** 2 for p in pieces]
    return float(np.sqrt(np.average(told, weights=[p.stop - p.start for p in pieces])))


def _scatter_of_one(t_s: Array, values: Array) -> float:
    if len(values) > MOST_SAMPLES:  # two stretches tell as much as an hour
        half = MOST_SAMPLES // 2
        parts = [slice(0, half), slice(len(values) - half, None)]
        return float(np.sqrt(np.mean([_scatter_of_one(t_s[p], values[p]) ** 2 for p in parts])))
    step = float(np.median(np.diff(t_s)))
    spans = sorted({max(LEAST_KNOT_FRAMES, round(span / step)) for span in SPANS_S})
    left = [(n, _left_over(t_s, values, n)) for n in spans if n * LOOK_SPANS <= len(values)]
    found = [(n, variance) for n, variance in left if variance]
    if not found:
        return 0.0
    best, growth = found[0][1], GROWTH
    for place in range(1, len(found)):
        (last, before), (frames, variance) = found[place - 1 : place + 1]
        grown, longer = variance / before, frames / last
        quickens = grown > SLOWING * min(max(growth, 1.0), longer)
        if frames * LEAST_SPANS > len(values) or grown > longer**MOST_POWER:
            break
        if quickens and not _slows_again(found[place : place + 2], grown):
            break
        best, growth = max(best, variance), grown
    return float(np.sqrt(best))


def _slows_again(found: list[tuple[int, float]], grown: float) -> bool:
    """Whether growth falls again from a span to the next. A motion that had come up would grow by the twelfth power of the span."""
    return len(found) > 1 and found[1][1] / found[0][1] < grown


def _unbroken(t_s: Array, values: Array) -> list[slice]:
    """Stretches of a track without a jump or a long gap."""
    steps, apart = np.diff(values), np.diff(t_s)
    if len(steps) < 2 * RATE_FRAMES + 1:
        return [slice(0, len(values))]
    rates = steps / apart
    near = np.lib.stride_tricks.sliding_window_view(np.pad(rates, RATE_FRAMES, mode="edge"), 2 * RATE_FRAMES + 1)
    off = np.abs(steps - np.median(near, axis=1) * apart)
    usual = MAD_TO_SD * float(np.median(off))
    breaks = np.flatnonzero((off > max(JUMP_SD * usual, JUMP_PX)) | (apart > LONGEST_GAP_S)) + 1
    ends = [0, *(int(b) for b in breaks), len(values)]
    return [slice(a, b) for a, b in pairwise(ends) if b > a]


def _left_over(t_s: Array, values: Array, frames: int) -> float | None:
    """Variance that a spline with a knot every so many frames leaves over, per degree of freedom."""
    from scipy.interpolate import make_lsq_spline

    inner = t_s[frames : len(t_s) - frames // 2 : frames]
    knots = np.concatenate([[t_s[0]] * (DEGREE + 1), inner, [t_s[-1]] * (DEGREE + 1)])
    try:
        spline = make_lsq_spline(t_s, values, knots, DEGREE)
    except (ValueError, np.linalg.LinAlgError):
        return None
    rest = values - spline(t_s)
    limit = CLIP_SD * max(MAD_TO_SD * float(np.median(np.abs(rest))), 1e-9)
    return float((np.clip(rest, -limit, limit) ** 2).sum() / (len(values) - len(knots) + DEGREE + 1))


def rigid_ratio(table: pd.DataFrame, markers: Sequence[Marker], mapping: Mapping) -> float:
    """Variance of the marks' distances over what the sigmas let expect; 1 where it is not significantly larger.

    Camera errors change the distance slowly over the tank: a quadratic in the place and the heading is taken out. So is what roll
    and pitch do to the distances of three marks and more, frame by frame; of two they cannot be told from errors.

    Parameters
    ----------
    table : tracks table
    markers : of run.toml
    mapping : pixel -> tank
    """
    model = [m for m in markers if m.on == "model"]
    every = max(
        1, len(table) // max(len(model), 1) // MOST_SAMPLES
    )  # an hour's frames tell no more, and fill the memory
    places = {m.name: _in_tank(table[table["marker"] == m.name].iloc[::every], m, mapping) for m in model}
    together = _all_seen(list(places.values()))
    if len(model) > 2 and together.sum() >= LEAST_KNOT_FRAMES * LEAST_SPANS:
        pixels = [table.loc[table["marker"] == m.name, ["u_px", "v_px"]].to_numpy()[::every][together] for m in model]
        aside = [ray_slopes(mapping, pixel, m.depth_m) for pixel, m in zip(pixels, model, strict=True)]
        found = _level([places[m.name] for m in model], together, model, aside)
    else:
        pairs = [(places[one.name], places[two.name]) for j, two in enumerate(model) for one in model[:j]]
        found = [_apart(one, two) for one, two in pairs if len(one[0]) == len(two[0])]
    ratios = [ratio for pair in found if (ratio := _ratio(*pair)) is not None]
    return float(np.median(ratios)) if ratios else 1.0


def _all_seen(places: Sequence[tuple[Array, Array]]) -> NDArray[np.bool_]:
    """Frames in which every mark is seen; none where they are not of the same frames."""
    if len({len(xy) for xy, _ in places}) != 1:
        return np.zeros(0, dtype=bool)
    return np.all([np.isfinite(xy).all(axis=1) & np.isfinite(sd).all(axis=(1, 2)) for xy, sd in places], axis=0)


def _apart(one: tuple[Array, Array], two: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Distances (n,) of two marks, their variances (n,), and where and how the pair lies (n, 3)."""
    gap = one[0] - two[0]
    apart = np.linalg.norm(gap, axis=1)
    unit = gap / apart[:, None]
    variance = np.einsum("ni,nij,nj->n", unit, one[1] + two[1], unit)
    return apart, variance, np.column_stack([(one[0] + two[0]) / 2, np.arctan2(unit[:, 1], unit[:, 0])])


def _level(
    places: Sequence[tuple[Array, Array]],
    seen: NDArray[np.bool_],
    markers: Sequence[Marker],
    aside: Sequence[Array],
) -> list[tuple[Array, Array, Array]]:
    """As ``_apart`` of every pair, without what roll and pitch could have done: what all distances together leave of it."""
    pairs = [(i, j) for j in range(len(places)) for i in range(j)]
    apart, alone, state, slopes = [], [], [], []
    to_marks = np.zeros((int(seen.sum()), len(pairs), len(places), 2))
    for k, (i, j) in enumerate(pairs):
        one, two = ((places[m][0][seen], places[m][1][seen]) for m in (i, j))
        distance, variance, lies = _apart(one, two)
        gap = one[0] - two[0]
        to_marks[:, k, i] = gap / distance[:, None]
        to_marks[:, k, j] = -to_marks[:, k, i]
        apart.append(distance - np.median(distance))
        alone.append(variance.mean())
        state.append(lies)
        slopes.append(distance_slopes(markers[i], markers[j], gap, (aside[i], aside[j])))
    turn = np.stack(slopes, axis=1)
    still = np.eye(len(pairs)) - turn @ np.linalg.pinv(turn, rcond=LEAST_SLOPE)
    from_marks = np.einsum("nkl,nlmi->nkmi", still, to_marks)
    spread = np.stack([sd[seen] for _, sd in places], axis=1)
    variance = np.einsum("nkmi,nmij,nkmj->nk", from_marks, spread, from_marks)
    left = np.einsum("nkl,nl->nk", still, np.stack(apart, axis=1))
    told = [k for k in range(len(pairs)) if variance[:, k].mean() > LEAST_LEFT * alone[k]]
    return [(left[:, k], variance[:, k], state[k]) for k in told]


def _ratio(apart: Array, variance: Array, state: Array) -> float | None:
    """Variance of distances over what is expected of it; None where it is not significantly larger."""
    good = np.isfinite(apart) & np.isfinite(variance) & (variance > 0)
    if good.sum() < LEAST_KNOT_FRAMES * LEAST_SPANS:
        return None
    state = state[good]
    scale = np.maximum(state.std(axis=0), 1e-9)
    x, y, b = ((state - state.mean(axis=0)) / scale).T
    basis = np.column_stack([np.ones_like(x), x, y, b, x * y, x * b, y * b, x**2, y**2, b**2])
    rest = apart[good] - basis @ np.linalg.lstsq(basis, apart[good], rcond=None)[0]
    limit = CLIP_SD * MAD_TO_SD * np.median(np.abs(rest))
    rest = np.clip(rest, -limit, limit)
    ratio = float((rest**2).sum() / (len(rest) - basis.shape[1]) / variance[good].mean())
    lag = float((rest[1:] * rest[:-1]).sum() / max((rest**2).sum(), 1e-30))
    independent = len(rest) * (1 - min(max(lag, 0.0), 0.98)) / (1 + min(max(lag, 0.0), 0.98))
    return ratio if ratio > 1 + RIGID_GATE * np.sqrt(2 / independent) else None


def _in_tank(rows: pd.DataFrame, marker: Marker, mapping: Mapping) -> tuple[Array, Array]:
    """Places ``(n, 2)`` m and their covariance ``(n, 2, 2)`` m^2 from the pixels' sigma."""
    seen = mapping.to_tank(rows[["u_px", "v_px"]].to_numpy(), marker.depth_m)
    spread = seen.per_px * rows[["sigma_u_px", "sigma_v_px"]].to_numpy()[:, None, :]
    return seen.xy_m, spread @ spread.swapaxes(1, 2)
