"""Pixel tracks -> marks in metres -> x_CG, y_CG, beta, alpha, each with a frame part and a common part of uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.errors import GeometryError, InputError
from ..record.results import CameraFile, DatumResidual, Measured
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .camera import Array
from .datum import DatumFit, fit_datum
from .lag import lag_modes
from .mapping import Mapping
from .rigid import RigidFit, fit_rigid
from .shake import camera_shake, turned_back
from .trapezoid import TrapezoidMapping, trapezoid_from_datum

METHODS = ("exact", "trapezoid", "trapezoid_corners")
DEFAULT_SIGMA_PX = 0.1
"""Assumed for tracks without a sigma (a good centroid after H.264)."""
LAG_COLUMN = "sigma_lag_px"
"""Of the tracks: how far a codec that makes a picture from the one before may hold a mark back (standard deviation)."""
_DEPTH_STEP_M = 1e-4


@dataclass(frozen=True)
class Motion:
    """What a run's tracks say of the model's motion.

    Attributes
    ----------
    marks : t_s, marker, x_m, y_m, sigma_x_m, sigma_y_m, status; one row per track row
    motion : formats.md's motion.csv; sigma_* is the part that varies from frame to frame, common_* the part common to
        the run (camera, heights); cov_y_cg_beta_m_rad is the frame part's covariance
    common : (k, n, 3), change of y_cg_m, beta_rad, alpha_rad with each independent unit-variance common mode
    lag : (l, n, 3), the same of the modes in which the codec holds marks back (``lag``); not smooth in the place
    camera : the datum's result
    """

    marks: pd.DataFrame
    motion: pd.DataFrame
    common: Array
    lag: Array
    camera: CameraFile


def run_datum(run: Run, image_size_px: tuple[int, int] | None) -> DatumFit:
    """Fit the camera of a run; ``image_size_px`` of its video, if it has one."""
    file = run.file
    size = file.camera.image_size_px if file.camera else image_size_px
    depths = [m.depth_m for m in file.marker]
    try:
        return fit_datum(file.datum, file.camera, depths, size, lens_covariance(run))
    except GeometryError as error:
        raise InputError(run.folder / RUN_FILE, "", str(error)) from None


def lens_covariance(run: Run) -> Array | None:
    """Covariance of ``Lens.vector`` by [camera]'s calibration or sd, (9, 9); None: taken as exact.

    Raises
    ------
    InputError : the calibration file cannot be used
    """
    camera = run.file.camera
    if camera is None:
        return None
    if camera.calibration is not None:
        from ..record.lens_file import read_lens

        return np.array(read_lens(run.path(camera.calibration)).covariance, dtype=float)
    return np.diag(np.square(camera.sd)) if any(camera.sd) else None


def run_mapping(run: Run, fit: DatumFit, method: str) -> Mapping:
    """The mapping of a run by ``method``, one of ``METHODS``."""
    if method == "exact":
        return fit.mapping
    if method not in METHODS:
        raise GeometryError(f"method {method!r}; expected {', '.join(METHODS)}")
    try:
        trapezoid, sigma = trapezoid_from_datum(run.file.datum, fit.mapping)
    except GeometryError as error:
        raise InputError(run.folder / RUN_FILE, "", str(error)) from None
    return TrapezoidMapping(trapezoid, sigma, fit.mapping, move_corners=method == "trapezoid_corners")


def motion_from_tracks(
    run: Run,
    tracks: pd.DataFrame,
    fit: DatumFit,
    method: str = "exact",
    tool: str = "",
    inputs: dict[str, str] | None = None,
    datum_tracks: pd.DataFrame | None = None,
) -> Motion:
    """Map the tracks of a run into the tank and fit the rigid model to them.

    Parameters
    ----------
    run : its markers, tow and priors
    tracks : as ``record.read_tracks`` gives
    fit : ``run_datum``'s
    method : "exact", "trapezoid" or "trapezoid_corners"
    tool, inputs : written into the camera file
    datum_tracks : datum points re-found in every frame (``camera_shake``), or None: the camera stood as picked

    Raises
    ------
    InputError : the tracks hold no marker of run.toml, or never two at once
    """
    notes = list(fit.notes)
    mapping = run_mapping(run, fit, method)
    found = poses_from_tracks(run, tracks, mapping, fit, datum_tracks)
    notes += found.notes
    markers, rigid = found.markers, found.rigid
    frames, times, place, covariance = found.frames, found.t_s, found.place_m, found.covariance_m2
    modes, pose_modes = found.modes_m, found.pose_modes
    alpha, alpha_slope = _alpha(run, rigid.pose)
    slope = np.zeros((len(frames), 3, 3))  # (y_cg, beta, alpha) by (x, y, beta)
    slope[:, 0, 1] = slope[:, 1, 2] = 1.0
    slope[:, 2] = alpha_slope
    frame_part = slope @ rigid.covariance @ slope.transpose(0, 2, 1)
    modal = np.einsum("nca,kna->knc", slope, pose_modes)
    common_sd = np.sqrt((modal[found.lags :] ** 2).sum(axis=0))
    sd = np.sqrt(np.maximum(np.einsum("ncc->nc", frame_part), 0.0))
    measured = np.asarray(np.isfinite(rigid.pose).all(axis=1))
    table = pd.DataFrame(
        {
            "t_s": times,
            "y_cg_m": rigid.pose[:, 1],
            "beta_rad": rigid.pose[:, 2],
            "alpha_rad": alpha,
            "x_cg_m": rigid.pose[:, 0],
            "sigma_y_cg_m": sd[:, 0],
            "sigma_beta_rad": sd[:, 1],
            "sigma_alpha_rad": sd[:, 2],
            "status": np.where(measured, "measured", "lost"),
            "cov_y_cg_beta_m_rad": frame_part[:, 0, 1],
            "common_y_cg_m": np.where(measured, common_sd[:, 0], np.nan),
            "common_beta_rad": np.where(measured, common_sd[:, 1], np.nan),
            "common_alpha_rad": np.where(measured & np.isfinite(alpha), common_sd[:, 2], np.nan),
            "rigid_chi2": rigid.chi_square,
        }
    )
    camera = CameraFile(
        schema="towline/camera",
        tool=tool,
        inputs=inputs or {},
        method=mapping.method if method != "exact" else fit.mapping.method,
        homographies={m.name: mapping.homography(m.depth_m).tolist() for m in markers},
        rms_px=fit.rms_px,
        datum=[
            DatumResidual(
                name=p.name or f"point {i + 1}",
                residual_px=(float(fit.residual_px[i, 0]), float(fit.residual_px[i, 1])),
                sigma_px=float(fit.sigma_px[i]),
            )
            for i, p in enumerate(run.file.datum)
        ],
        uncertainty_mm=_uncertainty_mm(modes[found.lags :], place),
        invariants=invariants(run, found),
        notes=notes,
    )
    modal = np.where(measured[None, :, None], modal, 0.0)
    return Motion(
        _marks(tracks, frames, place, covariance, markers), table, modal[found.lags :], modal[: found.lags], camera
    )


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
    lags : so many of the modes, the first ones, are lags of the codec
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


def poses_from_tracks(
    run: Run,
    tracks: pd.DataFrame,
    mapping: Mapping,
    fit: DatumFit | None = None,
    datum_tracks: pd.DataFrame | None = None,
) -> Poses:
    """Map the tracks into the tank and fit the rigid model in every frame.

    Marks on the post (camera fixed to the tank, carriage moving through the picture) give the carriage's place in every frame;
    the model's pose is told from there. A frame without one of them is lost.

    Parameters
    ----------
    run, tracks, datum_tracks : see ``motion_from_tracks``
    mapping : ``run_mapping``'s
    fit : the datum's, needed with ``datum_tracks``

    Raises
    ------
    InputError : the tracks hold no marker of run.toml, or never two at once
    """
    everyone = run.file.marker
    notes: list[str] = []
    pixel, sigma, repeated, frames, times = _by_frame(run, tracks, everyone)
    if not np.isfinite(sigma[np.isfinite(pixel).all(axis=2)]).all():
        notes.append(f"tracks without a sigma: {DEFAULT_SIGMA_PX} px assumed")
    sigma = np.where(np.isfinite(sigma) & (sigma > 0), sigma, DEFAULT_SIGMA_PX)
    lags = lag_modes(frames, times, pixel, _lag_sigma(tracks, everyone), repeated)
    if any(p.track for p in run.file.datum) and fit is not None:
        pixel, sigma, note = _steadied(datum_tracks, run, fit, frames, pixel, sigma)
        notes.append(note)
    place, covariance, modes = _places(run, mapping, everyone, pixel, sigma, lags)
    on_model = np.array([m.on == "model" for m in everyone])
    markers = tuple(m for m in everyone if m.on == "model")
    body = np.array([m.body_m for m in markers])
    rigid = fit_rigid(place[:, on_model], covariance[:, on_model], body)
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
        len(lags),
        tuple(notes),
    )


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


def _steadied(
    datum_tracks: pd.DataFrame | None, run: Run, fit: DatumFit, frames: Array, pixel: Array, sigma: Array
) -> tuple[Array, Array, str]:
    """Pixels and sigmas as the camera of the picked frame would have them, and what to tell the user."""
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
    pixel = np.full((len(frames), len(names), 2), np.nan)
    sigma = np.full_like(pixel, np.nan)
    row = np.searchsorted(frames, known["frame"].to_numpy())
    column = known["marker"].map({name: i for i, name in enumerate(names)}).to_numpy()
    measured = (known["status"] == "measured").to_numpy()
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
) -> tuple[Array, Array, Array]:
    """Places (n, m, 2), their frame covariance (n, m, 2, 2) and common modes (k, n, m, 2), those of the lags (px) first."""
    n = len(pixel)
    depth_sd = run.file.priors.marker_depth_sd_m
    place = np.full((n, len(markers), 2), np.nan)
    covariance = np.full((n, len(markers), 2, 2), np.nan)
    shared: list[Array] = []
    own: list[Array] = []
    lagging = np.zeros_like(lags)
    for index, marker in enumerate(markers):
        found = mapping.to_tank(pixel[:, index], marker.depth_m)
        place[:, index] = found.xy_m
        spread = found.per_px * sigma[:, index][:, None, :]
        covariance[:, index] = spread @ spread.transpose(0, 2, 1)
        shared.append(found.modes_m)
        lagging[:, :, index] = np.einsum("nij,knj->kni", found.per_px, lags[:, :, index])
        if depth_sd:
            lower = mapping.to_tank(pixel[:, index], marker.depth_m + _DEPTH_STEP_M).xy_m
            mode = np.zeros((1, n, len(markers), 2))
            mode[0, :, index] = (lower - found.xy_m) / _DEPTH_STEP_M * depth_sd
            own.append(mode)
    return place, covariance, np.concatenate([lagging, np.stack(shared, axis=2), *own])


def _body_modes(run: Run, rigid: RigidFit, body: Array) -> Array:
    """A marker standing off its body_m looks as if its place were turned with the model: modes (2m, n, m, 2)."""
    cosine, sine = np.cos(rigid.pose[:, 2]), np.sin(rigid.pose[:, 2])
    modes = np.zeros((2 * len(body), len(rigid.pose), len(body), 2))
    for index in range(len(body)):
        modes[2 * index, :, index] = -np.column_stack([cosine, sine])
        modes[2 * index + 1, :, index] = -np.column_stack([-sine, cosine])
    return modes * run.file.priors.marker_place_sd_m


def _alpha(run: Run, pose: Array) -> tuple[Array, Array]:
    """alpha = atan2(y_T - y_post, x_post - x_T) (n,) and its slope by (x, y, beta) (n, 3); NaN without a line."""
    tow = run.file.tow
    if run.file.kind != "tow" or tow is None or tow.tow_point_m is None:
        # a forced post moves: its place at each frame is not in run.toml's post_m
        return np.full(len(pose), np.nan), np.full((len(pose), 3), np.nan)
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    arm = np.column_stack(
        [
            tow.tow_point_m * cosine - tow.tow_point_offset_m * sine,
            tow.tow_point_m * sine + tow.tow_point_offset_m * cosine,
        ]
    )
    ahead = tow.post_m[0] - pose[:, 0] - arm[:, 0]
    aside = pose[:, 1] + arm[:, 1] - tow.post_m[1]
    square = ahead**2 + aside**2
    slope = np.column_stack([aside, ahead, ahead * arm[:, 0] - aside * arm[:, 1]]) / square[:, None]
    return np.arctan2(aside, ahead), slope


def invariants(run: Run, poses: Poses) -> dict[str, Measured]:
    """Mean and scatter over frames of what ``invariant_series`` gives."""
    found = {name: _mean_and_scatter(values) for name, values in invariant_series(run, poses).items()}
    return {name: value for name, value in found.items() if np.isfinite([value.value, value.std]).all()}


def invariant_series(run: Run, poses: Poses) -> dict[str, Array]:
    """Marker distances and the taut line's length over time, minus stated, m: name -> (n,) (theory.md 4)."""
    place, pose, markers = poses.place_m, poses.rigid.pose, poses.markers
    found: dict[str, Array] = {}
    for j in range(len(markers)):
        for i in range(j):
            apart = np.linalg.norm(place[:, i] - place[:, j], axis=1)
            stated = np.hypot(*(np.array(markers[i].body_m) - np.array(markers[j].body_m)))
            found[f"distance {markers[i].name}-{markers[j].name}"] = apart - stated
    tow = run.file.tow
    if run.file.kind == "tow" and tow is not None and tow.tow_point_m is not None and tow.line_length_m is not None:
        cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        x = pose[:, 0] + tow.tow_point_m * cosine - tow.tow_point_offset_m * sine
        y = pose[:, 1] + tow.tow_point_m * sine + tow.tow_point_offset_m * cosine
        found["taut line"] = np.hypot(x - tow.post_m[0], y - tow.post_m[1]) - tow.line_length_m
    return found


def _mean_and_scatter(values: Array) -> Measured:
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return Measured(value=float("nan"), std=float("nan"))
    return Measured(value=float(values.mean()), std=float(values.std(ddof=1)))


def _uncertainty_mm(modes: Array, place: Array) -> dict[str, float]:
    """Common error of the marks' places where they were seen: largest and median of x and y, mm.

    Marks' own places on the hull err along the hull: a mark seen alone says nothing of these.
    """
    spread = np.sqrt((modes**2).sum(axis=0)) * 1e3
    seen = np.isfinite(place).all(axis=2) & np.isfinite(spread).all(axis=2)
    if not seen.any():
        return {}
    x, y = spread[seen][:, 0], spread[seen][:, 1]
    return {
        "x_median": float(np.median(x)),
        "x_largest": float(x.max()),
        "y_median": float(np.median(y)),
        "y_largest": float(y.max()),
    }


def _marks(
    tracks: pd.DataFrame, frames: Array, place: Array, covariance: Array, markers: Sequence[Marker]
) -> pd.DataFrame:
    names = [m.name for m in markers]
    rows = tracks[tracks["marker"].isin(names) & tracks["frame"].isin(frames)]
    row = np.searchsorted(frames, rows["frame"].to_numpy())
    column = rows["marker"].map({name: i for i, name in enumerate(names)}).to_numpy()
    sd = np.sqrt(np.einsum("nmii->nmi", covariance))
    return pd.DataFrame(
        {
            "t_s": rows["t_s"].to_numpy(),
            "marker": rows["marker"].to_numpy(),
            "x_m": place[row, column, 0],
            "y_m": place[row, column, 1],
            "sigma_x_m": sd[row, column, 0],
            "sigma_y_m": sd[row, column, 1],
            "status": rows["status"].to_numpy(),
        }
    )
