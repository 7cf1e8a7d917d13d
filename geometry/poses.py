"""Pixel tracks -> marks in metres -> poses of the rigid body, frame by frame, with the modes of what frames have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.errors import InputError
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from ..record.tables import first_fall, seen_rows
from .camera import Array
from .datum import DatumFit
from .lag import lag_modes
from .line import alpha_of
from .mapping import Mapping, ray_slopes
from .phase import phase_modes
from .pull import pull_modes
from .rigid import RigidFit, fit_rigid
from .shake import camera_shake, turned_back

DEFAULT_SIGMA_PX = 0.1
"""Assumed for tracks without a sigma (a good centroid after H.264)."""
LAG_COLUMN = "sigma_lag_px"
"""Of the tracks: how far a codec that makes a picture from the one before may hold a mark back (standard deviation)."""


@dataclass(frozen=True)
class Poses:
    """Tracks by frame, mapped and fitted.

    Attributes
    ----------
    frames, t_s : (n,)
    markers : on the model
    pixel_px, sigma_px : (n, m, 2) of those; NaN where not measured
    place_m, covariance_m2, modes_m : (n, m, 2), (n, m, 2, 2), (k, n, m, 2), in tank axes as filmed
    rigid : poses; in the carriage's axes where the camera is fixed to the tank
    pose_modes : (k, n, 3)
    lags : so many of the modes, the first ones, are pulls by what stands beside a mark (``pull``) and lags of the codec (``lag``)
    notes : assumptions, for the user
    """

    frames: Array
    t_s: Array
    markers: tuple[Marker, ...]
    pixel_px: Array
    sigma_px: Array
    place_m: Array
    covariance_m2: Array
    modes_m: Array
    rigid: RigidFit
    pose_modes: Array
    lags: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Framed:
    """Tracks by frame, in pixels: what no other camera, depth or place changes.

    Attributes
    ----------
    frames, t_s : (n,)
    pixel_px, sigma_px : (n, m, 2) of all marks; NaN where not measured
    lags, phases : (k, n, m, 2), how a codec holds marks back (``lag``), and how pixels carry them off (``phase``)
    notes : assumptions, for the user
    """

    frames: Array
    t_s: Array
    pixel_px: Array
    sigma_px: Array
    lags: Array
    phases: Array
    notes: tuple[str, ...]


def poses_from_tracks(
    run: Run,
    tracks: pd.DataFrame,
    mapping: Mapping,
    fit: DatumFit | None = None,
    datum_tracks: pd.DataFrame | None = None,
    pulled: bool = False,
) -> Poses:
    """Map the tracks into the tank and fit the rigid model in every frame.

    Marks on the post (camera fixed to the tank, carriage moving through the picture) give the carriage's place in every frame;
    the model's pose is told from there. A frame without one of them is lost.

    Parameters
    ----------
    run, tracks, datum_tracks : see ``motion_from_tracks``
    mapping : ``run_mapping``'s
    fit : the datum's, needed with ``datum_tracks``
    pulled : with the modes by which what stands beside a mark may pull it (``pull``) and pixels carry it off (``phase``)

    Raises
    ------
    InputError : the tracks hold no marker of run.toml, or never two at once; or run.toml has one alone on the model
    """
    return poses_of(run, framed(run, tracks, fit, datum_tracks), mapping, pulled)


def framed(
    run: Run, tracks: pd.DataFrame, fit: DatumFit | None = None, datum_tracks: pd.DataFrame | None = None
) -> Framed:
    """Put the tracks of all marks side by side, the camera's turns taken out.

    Parameters
    ----------
    run, tracks, fit, datum_tracks : as ``poses_from_tracks`` takes

    Raises
    ------
    InputError : the tracks hold no marker of run.toml, or it has one alone on the model; times that do not rise
    """
    everyone = run.file.marker
    if (missing := missing_with_one(run)) is not None:
        raise InputError(run.folder / RUN_FILE, "marker", missing)
    notes: list[str] = []
    pixel, sigma, repeated, frames, times = _by_frame(run, tracks, everyone)
    if not np.isfinite(sigma[np.isfinite(pixel).all(axis=2)]).all():
        notes.append(f"tracks without a sigma: {DEFAULT_SIGMA_PX} px assumed")
    sigma = np.where(np.isfinite(sigma) & (sigma > 0), sigma, DEFAULT_SIGMA_PX)
    lags, phases = lag_modes(frames, times, pixel, _lag_sigma(tracks, everyone), repeated), phase_modes(times, pixel)
    if any(p.track for p in run.file.datum) and fit is not None:
        pixel, sigma, note = _without_shake(datum_tracks, run, fit, frames, pixel, sigma)
        notes.append(note)
    return Framed(frames, times, pixel, sigma, lags, phases, tuple(notes))


def poses_of(run: Run, tracks: Framed, mapping: Mapping, pulled: bool = False) -> Poses:
    """Map what ``framed`` gives into the tank and fit the rigid model in every frame.

    Parameters
    ----------
    run, mapping, pulled : as ``poses_from_tracks`` takes
    tracks : by frame

    Raises
    ------
    InputError : never two marks at once
    """
    everyone = run.file.marker
    pixel, sigma, frames, times, lags = tracks.pixel_px, tracks.sigma_px, tracks.frames, tracks.t_s, tracks.lags
    place, covariance, modes, per_px = _places(run, mapping, everyone, pixel, sigma, lags)
    on_model = np.array([m.on == "model" for m in everyone])
    markers = tuple(m for m in everyone if m.on == "model")
    body = np.array([m.body_m for m in markers])
    rigid = fit_rigid(place[:, on_model], covariance[:, on_model], body)
    slow = len(lags)
    if pulled:
        by_px = pull_modes(times, rigid.pose[:, 2], alpha_of(run, rigid.pose)[0], int(on_model.sum()))
        pulls = np.zeros((len(by_px), *place.shape))
        pulls[:, :, on_model] = by_px
        by_px = np.concatenate([pulls, tracks.phases])
        modes, slow = np.concatenate([np.einsum("nmij,knmj->knmi", per_px, by_px), modes]), slow + len(by_px)
    own = modes[:, :, on_model]
    if run.file.priors.marker_place_sd_m:
        extra = _body_modes(run, rigid, body)
        own = np.concatenate([own, extra])
        modes = np.concatenate([modes, np.zeros((len(extra), *modes.shape[1:]))])
    pose_modes = np.einsum("namj,knmj->kna", np.nan_to_num(rigid.gain), np.nan_to_num(own))
    if not on_model.all():
        posts = tuple(m for m in everyone if m.on == "post")
        rigid, pose_modes = _from_carriage(
            run, posts, rigid, pose_modes, place[:, ~on_model], covariance[:, ~on_model], modes[:, :, ~on_model]
        )
    if not np.isfinite(rigid.pose).any():
        raise InputError(run.out / "tracks.csv", "", "no frame shows two markers at once; no motion can be had from it")
    return Poses(
        frames,
        times,
        markers,
        pixel[:, on_model],
        sigma[:, on_model],
        place[:, on_model],
        covariance[:, on_model],
        own,
        rigid,
        pose_modes,
        slow,
        tracks.notes,
    )


def missing_with_one(run: Run) -> str | None:
    """What cannot be computed where one mark alone stands on the model, in words; None where there are two."""
    marks = [m.name for m in run.file.marker if m.on == "model"]
    if len(marks) != 1:
        return None
    return (
        f"{marks[0]!r} alone on the model: where it is in the picture is all it tells; the heading, with it the motion (y_CG, "
        "beta, alpha) and the derivatives, need a second [[marker]] away from it"
    )


def without_lags(tracks: pd.DataFrame) -> pd.DataFrame:
    """The tracks as if their codec held no mark back: for work that has no use for the lag's modes."""
    return tracks.drop(columns=LAG_COLUMN, errors="ignore")


def _from_carriage(
    run: Run, posts: Sequence[Marker], rigid: RigidFit, pose_modes: Array, place: Array, covariance: Array, modes: Array
) -> tuple[RigidFit, Array]:
    """Poses against the carriage, whose marks say where its post has come to."""
    post = np.array(run.file.tow.post_m) if run.file.tow is not None else np.zeros(2)
    seen = np.asarray(np.isfinite(place).all(axis=2))
    weight = np.where(
        seen[:, :, None, None], np.linalg.inv(np.where(seen[:, :, None, None], covariance, np.eye(2))), 0.0
    )
    total = weight.sum(axis=1)
    known = np.asarray(seen.any(axis=1))
    inverse = np.linalg.inv(np.where(known[:, None, None], total, np.eye(2)))
    gain = np.where(known[:, None, None, None], np.einsum("nij,nmjk->nmik", inverse, weight), 0.0)
    stands = np.array([m.body_m for m in posts]) + post
    gone = np.einsum("nmij,nmj->ni", gain, np.where(seen[:, :, None], place - stands, 0.0))
    pose, spread = rigid.pose.copy(), rigid.covariance.copy()
    pose[:, :2] -= gone
    spread[:, :2, :2] += inverse
    pose[~known], spread[~known] = np.nan, np.nan
    pose_modes = pose_modes.copy()
    pose_modes[:, :, :2] -= np.einsum("nmij,knmj->kni", gain, np.nan_to_num(modes))
    return replace(rigid, pose=pose, covariance=spread), pose_modes


def _without_shake(
    datum_tracks: pd.DataFrame | None, run: Run, fit: DatumFit, frames: Array, pixel: Array, sigma: Array
) -> tuple[Array, Array, str]:
    """Take the camera's turns out of the marks: pixels and sigmas as in the frame whose datum points were picked, and a note."""
    if datum_tracks is None:
        return pixel, sigma, "datum.track: no video to re-find the points in; the camera is taken as standing still"
    shake = camera_shake(datum_tracks, run.file.datum, fit.mapping)
    known = np.isfinite(shake.turn_rad).all(axis=1)
    if not known.any():
        return pixel, sigma, "datum.track: fewer than two points were re-found; the camera is taken as standing still"
    most = float(np.degrees(np.linalg.norm(shake.turn_rad[known], axis=1).max()))
    if shake.still:
        return pixel, sigma, f"datum.track: the camera stood still (turns below {most:.4f} deg, their noise)"
    pixel, variance = turned_back(shake, frames, pixel, fit.mapping)
    text = f"datum.track: the camera turned by up to {most:.3f} deg; taken out frame by frame"
    if not known.all():
        text += f"; {int((~known).sum())} frames without two datum points are lost"
    return pixel, np.sqrt(sigma**2 + variance), text


def _by_frame(
    run: Run, tracks: pd.DataFrame, markers: Sequence[Marker]
) -> tuple[Array, Array, NDArray[np.bool_], Array, Array]:
    """Tracks by frame: pixels and sigmas ``(n, m, 2)``, NaN where not measured; which are repeated ``(n, m)``; numbers; times."""
    span = run.file.source.span_s
    if span is not None:
        tracks = tracks[(tracks["t_s"] >= span[0]) & (tracks["t_s"] <= span[1])]
    names = [m.name for m in markers]
    known = tracks[tracks["marker"].isin(names)]
    if known.empty:
        found = ", ".join(sorted(set(tracks["marker"]))) or "none"
        raise InputError(
            run.source_path, "column marker", f"holds none of {', '.join(names)} in the span; found {found}"
        )
    frames, first = np.unique(known["frame"].to_numpy(), return_index=True)
    times = known["t_s"].to_numpy()[first]
    k = first_fall(times)
    if k is not None:
        detail = f"{times[k]:g} s after {times[k - 1]:g} s; times must rise strictly"
        raise InputError(run.source_path, f"frame {frames[k]}, t_s", detail)
    pixel = np.full((len(frames), len(names), 2), np.nan)
    sigma = np.full_like(pixel, np.nan)
    row = np.searchsorted(frames, known["frame"].to_numpy())
    column = known["marker"].map({name: i for i, name in enumerate(names)}).to_numpy()
    measured = seen_rows(known)
    pixel[row[measured], column[measured]] = known[["u_px", "v_px"]].to_numpy()[measured]
    sigma[row[measured], column[measured]] = known[["sigma_u_px", "sigma_v_px"]].to_numpy()[measured]
    repeated = np.zeros(pixel.shape[:2], dtype=bool)
    if "repeated" in known:
        repeated[row[measured], column[measured]] = known["repeated"].to_numpy()[measured] > 0
    return pixel, sigma, repeated, frames, times


def _lag_sigma(tracks: pd.DataFrame, markers: Sequence[Marker]) -> Array:
    """(m,) px, how far a codec may hold each mark back; 0 where the tracks do not say."""
    if LAG_COLUMN not in tracks:
        return np.zeros(len(markers))
    stated = tracks[LAG_COLUMN].groupby(tracks["marker"]).median()
    return np.nan_to_num(stated.reindex([m.name for m in markers]).to_numpy(dtype=float))


def _places(
    run: Run, mapping: Mapping, markers: Sequence[Marker], pixel: Array, sigma: Array, lags: Array
) -> tuple[Array, Array, Array, Array]:
    """Places (n, m, 2), their frame covariance (n, m, 2, 2), common modes (k, n, m, 2), those of the lags first, and m per px."""
    n = len(pixel)
    depth_sd = run.file.priors.marker_depth_sd_m
    place = np.full((n, len(markers), 2), np.nan)
    covariance, per_px = (np.full((n, len(markers), 2, 2), np.nan) for _ in range(2))
    shared: list[Array] = []
    own: list[Array] = []
    lagging = np.zeros_like(lags)
    for index, marker in enumerate(markers):
        found = mapping.to_tank(pixel[:, index], marker.depth_m)
        place[:, index] = found.xy_m
        per_px[:, index] = found.per_px
        spread = found.per_px * sigma[:, index][:, None, :]
        covariance[:, index] = spread @ spread.transpose(0, 2, 1)
        shared.append(found.modes_m)
        if len(lags):
            lagging[:, :, index] = np.einsum("nij,knj->kni", found.per_px, lags[:, :, index])
        if depth_sd:
            mode = np.zeros((1, n, len(markers), 2))
            mode[0, :, index] = ray_slopes(mapping, pixel[:, index], marker.depth_m) * depth_sd
            own.append(mode)
    return place, covariance, np.concatenate([lagging, np.stack(shared, axis=2), *own]), per_px


def _body_modes(run: Run, rigid: RigidFit, body: Array) -> Array:
    """A marker standing off its body_m looks as if its place were turned with the model: modes (2m, n, m, 2)."""
    cosine, sine = np.cos(rigid.pose[:, 2]), np.sin(rigid.pose[:, 2])
    modes = np.zeros((2 * len(body), len(rigid.pose), len(body), 2))
    for index in range(len(body)):
        modes[2 * index, :, index] = -np.column_stack([cosine, sine])
        modes[2 * index + 1, :, index] = -np.column_stack([-sine, cosine])
    return modes * run.file.priors.marker_place_sd_m


__all__ = [
    "LAG_COLUMN",
    "Framed",
    "Poses",
    "framed",
    "missing_with_one",
    "poses_from_tracks",
    "poses_of",
    "without_lags",
]
