"""A run as the diagnosis sees it: few, evenly spaced means of y, beta, taut-line radius and marker distance, with their noise.

The last two carry no hydrodynamics (theory.md 4): faults of camera, clock and line show there. Where a load cell stood in a line
that keeps its length, its means are a fifth channel (``cell``). Means over a third of a second keep
all that a tow does and make the noise's covariance small enough to be held whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ...geometry import DatumFit
from ...geometry.mapping import ProjectiveMapping
from ...geometry.poses import Poses, framed, poses_from_tracks, poses_of, without_lags
from ...identify.data import RunData, run_data
from ...record.run import Run
from ...record.tables import SEEN
from ...simulate.model import Array
from .cell import cell_means
from .channels import LINE, PULL
from .evened import evened
from .lasting import as_distances_show
from .slow import LINE_SD_M, SLOW_PX, SLOW_UNSEEN_PX, SlowErrors, lag_of
from .still import StillNoise, still_noise
from .tow_run import Marks, TowRun, means_of

TOGETHER = ([0, 1], [2], [3])
"""Channels whose errors are taken together: y and beta are shown by the same dynamics."""
MOST_BLOCKS = 130
"""Means to the longest run: a choice, for the time of all that follows."""
SHORTEST_S = 0.3
"""Of a mean: no tow moves faster."""


@dataclass(frozen=True)
class _Turned:
    """Unit vectors (n, 2) from the second mark to the first and from the post to the tow point, and from LCG to it, m."""

    along: Array
    pull: Array
    arm: Array


@dataclass(frozen=True)
class _Series:
    """Channels of a run or of its static record, frame by frame.

    The last variance is the covariance of y and beta; of the modes the first ``lags`` are a codec's.
    """

    t_s: Array
    values: Array
    variance: Array
    modes: Array
    shutter: Array
    x_m: Array
    lags: int = 0
    sigma_px: float = 0.1


@dataclass(frozen=True)
class Recorded:
    """A run as it was recorded.

    Attributes
    ----------
    run : the run folder as read
    motion, common : as ``identify.run_data`` takes
    tracks, fit : pixels and datum, where there are
    static : tracks of the model held still, or None
    """

    run: Run
    motion: pd.DataFrame
    common: Array | None = None
    tracks: pd.DataFrame | None = None
    fit: DatumFit | None = None
    static: pd.DataFrame | None = None


def tow_runs(recorded: Sequence[Recorded], step_s: float) -> list[TowRun]:
    """Prepare the runs of a campaign: what their static records say of the measurement's noise is taken together.

    Parameters
    ----------
    recorded : the runs
    step_s : of the blocks, the same for all runs
    """
    means = [_held_still(each, step_s) for each in recorded]
    pictures: dict[tuple[int, int] | None, list[int]] = {}
    for index, each in enumerate(recorded):
        camera = each.run.file.camera
        pictures.setdefault(None if camera is None else camera.image_size_px, []).append(index)
    noises: dict[int, list[StillNoise | None]] = {}
    for alike in pictures.values():
        together = [
            still_noise([None if m is None else m[:, channels] for m in (means[k] for k in alike)], step_s)
            for channels in TOGETHER
        ]
        noises.update(zip(alike, map(list, zip(*together, strict=True)), strict=True))
    found = [_tow_run(each, noises[k], step_s) for k, each in enumerate(recorded)]
    for alike in pictures.values():
        for k, run in zip(alike, as_distances_show([found[k] for k in alike]), strict=True):
            found[k] = run
    return [_with_cell(run) for run in found] if any(run.data.gauge is not None for run in found) else found


def _with_cell(run: TowRun) -> TowRun:
    """The same with the load cell's channel."""
    n = len(run.centre_s)
    cell = cell_means(run.data, run.start_s, run.step_s, n)
    if cell is None:
        nothing = np.full((n, 1), np.nan)
        return _with_channel(run, nothing, np.eye(n))
    wide = _with_channel(run, cell.pull_n[:, None], cell.covariance)
    return replace(wide, cell_s=cell.centre_s, cell_spread_s2=cell.spread_s2)


def without_cell(runs: Sequence[TowRun]) -> list[TowRun]:
    """The same without the load cell's channel.

    Parameters
    ----------
    runs : as the diagnosis sees them
    """
    return [
        replace(
            run,
            values=run.values[:, :PULL],
            covariance=run.covariance[:PULL],
            modes=run.modes[..., :PULL],
            lags=run.lags[..., :PULL],
        )
        for run in runs
    ]


def _with_channel(run: TowRun, values: Array, covariance: Array) -> TowRun:
    return replace(
        run,
        values=np.column_stack([run.values, values]),
        covariance=np.concatenate([run.covariance, covariance[None]]),
        modes=np.pad(run.modes, ((0, 0), (0, 0), (0, 1))),
        lags=np.pad(run.lags, ((0, 0), (0, 0), (0, 1))),
    )


def _held_still(recorded: Recorded, step_s: float) -> Array | None:
    """(n, 4) means over the blocks of a static record, in units of what the stated sigmas make of a mean there."""
    run, fit, static = recorded.run, recorded.fit, recorded.static
    if recorded.tracks is None or fit is None or static is None:
        return None
    # the stated sigmas say how the noise changes over the picture, the static record how large it is there
    still = _from_pixels(run, without_lags(static), fit)
    t_s = still.t_s - still.t_s[0]
    there = np.nanmedian(_mean(t_s, still.variance[:, :4], step_s), axis=0)
    frames = max(len(t_s) / max(t_s[-1], step_s) * step_s, 1.0)
    return _blocks(t_s, still.values, step_s)[2] / np.sqrt(there / frames)


def _tow_run(recorded: Recorded, still: Sequence[StillNoise | None], step_s: float) -> TowRun:
    run, motion, tracks, fit = recorded.run, recorded.motion, recorded.tracks, recorded.fit
    data = run_data(run, motion, recorded.common)
    marks = None
    if tracks is not None and fit is not None:
        tracks = evened(tracks)
        few = framed(run, without_lags(_few(tracks, step_s)), fit)
        marks = Marks(run, tracks, fit, few, _places_of(run, poses_of(run, few, fit.mapping.exact()))[0])
    series = _from_pixels(run, marks.tracks, marks.fit) if marks is not None else _from_motion(run, data, motion)
    start = float(series.t_s[0])
    centre, spread, values, count = _blocks(series.t_s - start, series.values, step_s)
    variance = _mean(series.t_s - start, series.variance, step_s)[: len(centre)] / np.maximum(count, 1)[:, None]
    covariance, cross, slow = _covariances(centre, variance, series, still)
    if marks is not None:
        seen = still[0] is not None
        unfilmed = seen and run.file.source.video is None
        slow = replace(slow, size_px=SLOW_PX if seen else SLOW_UNSEEN_PX, unfilmed=unfilmed)
    water = run.file.water
    width = water.tank_width_m if water is not None else None

    def of_blocks(modes: Array) -> Array:
        means = [_mean(series.t_s - start, m, step_s)[: len(centre)] for m in modes]
        return np.array(means).reshape(len(modes), len(centre), 4)

    return TowRun(
        run.name,
        data,
        marks,
        start,
        step_s,
        centre,
        spread,
        values,
        covariance,
        cross,
        slow,
        of_blocks(series.modes[series.lags :]),
        of_blocks(series.modes[: series.lags]),
        np.array(
            [_mean(series.t_s - start, way.reshape(len(way), -1), step_s)[: len(centre)] for way in series.shutter]
        ).reshape(2, -1, 4, 3),
        run.model.length_pp_m,
        run.water.density_kg_m3,
        0.5 * width if width else float("nan"),
        run,
        centre,
        spread,
        series.t_s - start,
        series.values[:, LINE],
        _mean(series.t_s - start, series.x_m[:, None], step_s)[: len(centre), 0],
    )


def block_step(durations_s: Sequence[float]) -> float:
    """The blocks' length for runs of these durations."""
    return max(SHORTEST_S, max(durations_s) / MOST_BLOCKS)


def corrected(tow: TowRun, run: Run, mapping: Any) -> Array:
    """Change of the run's values (n, 4) with another run.toml or mapping: a frame of each block stands for it.

    Parameters
    ----------
    tow : the run as the diagnosis sees it
    run : the run folder as read
    mapping : pixel -> tank
    """
    assert tow.marks is not None
    mapping = mapping.exact() if isinstance(mapping, ProjectiveMapping) else mapping
    after, _ = _places_of(run, poses_of(run, tow.marks.few, mapping))
    change = after - tow.marks.seen
    good = np.isfinite(change).all(axis=1)
    t_s = tow.marks.few.t_s[good] - tow.start_s
    return np.column_stack([np.interp(tow.centre_s, t_s, c) for c in change[good].T])


def _few(tracks: pd.DataFrame, step_s: float) -> pd.DataFrame:
    """About one frame of each block, in which all marks were measured."""
    whole = tracks["status"].isin(SEEN).groupby(tracks["frame"]).transform("all")
    rows = tracks[whole]
    frames, first = np.unique(rows["frame"].to_numpy(), return_index=True)
    block = np.floor((rows["t_s"].to_numpy()[first] - rows["t_s"].min()) / step_s + 0.5).astype(int)
    chosen = frames[np.unique(block, return_index=True)[1]]
    return rows[rows["frame"].isin(chosen)].reset_index(drop=True)


def _places_of(run: Run, found: Poses) -> tuple[Array, _Turned]:
    """Values (n, 4) of poses, and what they turn with."""
    tow, pose = run.tow, found.rigid.pose
    apart = found.place_m[:, 0] - found.place_m[:, 1]
    far = np.linalg.norm(apart, axis=1)
    bow, stern = found.markers[0], found.markers[1]
    stated = float(np.hypot(*(np.array(bow.body_m) - np.array(stern.body_m))))
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x_t, y_t = float(tow.tow_point_m or 0.0), tow.tow_point_offset_m
    arm = np.column_stack([x_t * cosine - y_t * sine, x_t * sine + y_t * cosine])
    off = pose[:, :2] + arm - np.array(tow.post_m)
    radius = np.linalg.norm(off, axis=1)
    values = np.column_stack(
        [pose[:, 1] - tow.post_m[1], pose[:, 2], radius - float(tow.line_length_m or 0.0), far - stated]
    )
    return values, _Turned(apart / far[:, None], off / radius[:, None], arm)


def _from_pixels(run: Run, tracks: pd.DataFrame, fit: DatumFit) -> _Series:
    found = poses_from_tracks(run, tracks, fit.mapping, fit)
    pose = found.rigid.pose
    values, turned = _places_of(run, found)
    along, pull, arm = turned.along, turned.pull, turned.arm
    # line and distance by (x, y, beta) and by the marks
    turn = -pull[:, 0] * arm[:, 1] + pull[:, 1] * arm[:, 0]
    by_pose = np.zeros((len(pose), 4, 3))
    by_pose[:, 0, 1] = by_pose[:, 1, 2] = 1.0
    by_pose[:, 2] = np.column_stack([pull, turn])
    spread = np.einsum("nca,nab,ncb->nc", by_pose, found.rigid.covariance, by_pose)
    spread = np.column_stack([spread, found.rigid.covariance[:, 1, 2]])
    both = found.covariance_m2[:, 0] + found.covariance_m2[:, 1]
    spread[:, 3] = np.einsum("ni,nij,nj->n", along, both, along)
    modes = np.einsum("nca,kna->knc", by_pose, found.pose_modes)
    apart_m = found.modes_m[:, :, 0] - found.modes_m[:, :, 1]
    modes[..., 3] = np.einsum("ni,kni->kn", along, apart_m)
    sigma = float(np.nanmedian(found.sigma_px[np.isfinite(found.pixel_px)]))
    return _Series(found.t_s, values, spread, modes, _shutter(found, along, run), pose[:, 0], found.lags, sigma)


def _shutter(found, along: Array, run: Run) -> Array:
    """(2, n, 4, 3): x, y, beta, distance by a readout of 1 s over the picture's height, or its width, per rate of x, y, beta."""
    camera = run.file.camera
    size = camera.image_size_px if camera is not None else [float(np.nanmax(found.pixel_px[..., k])) for k in (0, 1)]
    return np.array([_read_late(found, along, found.pixel_px[..., k] / size[k] - 0.5) for k in (1, 0)])


def _read_late(found, along: Array, late: Array) -> Array:
    """(n, 4, 3) by marks (n, m) that are read so much later, in readouts."""
    n, m = found.place_m.shape[:2]
    body = np.array([k.body_m for k in found.markers])
    heading = found.rigid.pose[:, 2]
    cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
    moved = np.zeros((n, m, 2, 3))
    moved[:, :, 0, 0] = moved[:, :, 1, 1] = 1.0
    moved[:, :, 0, 2] = -(sine * body[:, 0] + cosine * body[:, 1])
    moved[:, :, 1, 2] = cosine * body[:, 0] - sine * body[:, 1]
    moved = moved * late[:, :, None, None]
    answer = np.zeros((n, 4, 3))
    answer[:, :3] = np.einsum("namj,nmjk->nak", np.nan_to_num(found.rigid.gain), np.nan_to_num(moved))
    answer[:, 3] = np.einsum("nj,njk->nk", np.nan_to_num(along), np.nan_to_num(moved[:, 0] - moved[:, 1]))
    return answer


def _from_motion(run: Run, data: RunData, motion: pd.DataFrame) -> _Series:
    n = len(data.t_s)
    values = np.full((n, 4), np.nan)
    values[:, 0], values[:, 1] = data.y_m, data.beta_rad
    variance = np.full((n, 5), np.nan)
    variance[:, 0], variance[:, 1] = data.covariance[:, 0, 0], data.covariance[:, 1, 1]
    variance[:, 4] = data.covariance[:, 0, 1]
    modes = np.zeros((len(data.common), n, 4))
    modes[..., :2] = data.common
    return _Series(data.t_s, values, variance, modes, np.zeros((2, n, 4, 3)), np.full(n, np.nan))


def _blocks(t_s: Array, values: Array, step_s: float) -> tuple[Array, Array, Array, Array]:
    """Mean time, variance of the times, mean values and count of the frames in each block; the last, unfilled one is left out."""
    good = np.isfinite(values[:, :2]).all(axis=1)
    index = np.floor(t_s / step_s + 1e-9).astype(int)
    size = int(index.max())
    size = max(size, 1)
    inside = good & (index < size)
    mean, count = means_of(index[inside], values[inside], size)
    centre = np.bincount(index[inside], t_s[inside], minlength=size) / np.maximum(count, 1)
    centre = np.where(count > 0, centre, (np.arange(size) + 0.5) * step_s)
    off = t_s[inside] - centre[index[inside]]
    spread = np.bincount(index[inside], off**2, minlength=size) / np.maximum(count, 1)
    return centre, spread, mean, count


def _mean(t_s: Array, values: Array, step_s: float) -> Array:
    """Means (blocks, columns) over the whole rows of each block, 0 where there are none; NaN in a column without any value."""
    index = np.floor(t_s / step_s + 1e-9).astype(int)
    size, there = int(index.max()) + 1, np.isfinite(values).any(axis=0)
    good = np.isfinite(values[:, there]).all(axis=1)
    count = np.maximum(np.bincount(index[good], minlength=size), 1)
    answer = np.full((size, values.shape[1]), np.nan)
    for column in np.flatnonzero(there):
        answer[:, column] = np.bincount(index[good], values[good, column], minlength=size) / count
    return answer


def _covariances(
    centre: Array, variance: Array, series: _Series, still: Sequence[StillNoise | None]
) -> tuple[Array, Array, SlowErrors]:
    """(4, n, n) of each channel and (n, n) of y with beta: by the static records' scatter and colour, or by the stated sigmas; and
    slow errors on top.
    """
    n = len(centre)
    lag = lag_of(centre)
    answer = np.zeros((4, n, n))
    roots, slows = np.zeros((4, n)), np.zeros(4)
    for held, channels in zip(still, TOGETHER, strict=True):
        for at, channel in enumerate(channels):
            own = variance[:, channel]
            if not np.isfinite(own).any():
                answer[channel] = np.eye(n)
                continue
            root = roots[channel] = np.sqrt(np.where(np.isfinite(own) & (own > 0), own, np.nanmedian(own)))
            colour = np.eye(n) if held is None else held.covariance(at, at, lag)
            answer[channel] = root[:, None] * colour * root[None, :]
            # a sigma of the marks says how a pixel's error shows in this channel
            per_px = np.sqrt(np.nanmedian(series.variance[:, channel])) / series.sigma_px
            slows[channel] = per_px * (SLOW_PX if held is not None else SLOW_UNSEEN_PX)
    # the share of the errors of y and beta that is the same one
    with np.errstate(invalid="ignore"):
        shared = np.nan_to_num(variance[:, -1] / (roots[0] * roots[1]))
    pair = still[0]
    colour = np.diag(shared) if pair is None else pair.covariance(0, 1, lag)
    if slows[LINE] > 0:
        slows[LINE] = np.hypot(slows[LINE], LINE_SD_M)
    slow = SlowErrors(slows, float(np.median(shared)))
    cross = roots[0][:, None] * colour * roots[1][None, :] + slow.cross(lag)
    return answer + slow.covariance(lag), cross, slow


__all__ = ["Recorded", "block_step", "corrected", "tow_runs", "without_cell"]
