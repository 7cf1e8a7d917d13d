"""Pixel tracks -> marks in metres -> x_CG, y_CG, beta, alpha, each with a frame part and a common part of uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..record.errors import GeometryError, InputError
from ..record.results import CameraFile, DatumResidual, Measured
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .camera import Array
from .datum import DatumFit, fit_datum
from .line import alpha_of, tow_arm
from .mapping import Mapping
from .poses import Poses, poses_from_tracks
from .trapezoid import TrapezoidMapping, trapezoid_from_datum

METHODS = ("exact", "trapezoid", "trapezoid_corners")


@dataclass(frozen=True)
class Motion:
    """What a run's tracks say of the model's motion.

    Attributes
    ----------
    marks : t_s, marker, x_m, y_m, sigma_x_m, sigma_y_m, status; one row per track row
    motion : formats.md's motion.csv; sigma_* is the part that varies from frame to frame, common_* the part common to
        the run (camera, heights); cov_y_cg_beta_m_rad is the frame part's covariance
    common : (k, n, 3), change of y_cg_m, beta_rad, alpha_rad with each independent unit-variance common mode
    lag : (l, n, 3), the same of the modes in which what stands beside a mark pulls it (``pull``), a pixel carries it off
        (``phase``) and the codec holds it back (``lag``); they go with angles, way and speed, not with the place
    camera : the datum's result
    """

    marks: pd.DataFrame
    motion: pd.DataFrame
    common: Array
    lag: Array
    camera: CameraFile


def run_datum(run: Run, image_size_px: tuple[int, int] | None) -> DatumFit:
    """Fit the camera of a run; ``image_size_px`` of its video, if it has one.

    Parameters
    ----------
    run : the run folder as read
    image_size_px : width and height of its video, or None
    """
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
    """The mapping of a run by ``method``, one of ``METHODS``.

    Parameters
    ----------
    run : the run folder as read
    fit : of its datum, from ``run_datum``
    method : one of ``METHODS``
    """
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
    found = poses_from_tracks(run, tracks, mapping, fit, datum_tracks, pulled=True)
    notes += found.notes
    markers, rigid = found.markers, found.rigid
    frames, times, place, covariance = found.frames, found.t_s, found.place_m, found.covariance_m2
    modes, pose_modes = found.modes_m, found.pose_modes
    table, modal = motion_table(run, times, rigid.pose, rigid.covariance, pose_modes, found.lags)
    table["rigid_chi2"] = rigid.chi_square
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
    return Motion(
        _marks(tracks, frames, place, covariance, markers), table, modal[found.lags :], modal[: found.lags], camera
    )


def motion_table(
    run: Run, t_s: Array, pose: Array, covariance: Array, pose_modes: Array, slow: int
) -> tuple[pd.DataFrame, Array]:
    """The motion table of poses, and the change of (y_cg, beta, alpha) with each common mode, (k, n, 3), 0 where lost.

    Parameters
    ----------
    run : its tow
    t_s : (n,)
    pose, covariance : (n, 3), (n, 3, 3) of x m, y m, heading rad; NaN where lost
    pose_modes : (k, n, 3)
    slow : so many of these, the first ones, count as no common error of the place
    """
    alpha, alpha_slope = alpha_of(run, pose)
    slope = np.zeros((len(t_s), 3, 3))  # (y_cg, beta, alpha) by (x, y, beta)
    slope[:, 0, 1] = slope[:, 1, 2] = 1.0
    slope[:, 2] = alpha_slope
    frame_part = slope @ covariance @ slope.transpose(0, 2, 1)
    modal = np.einsum("nca,kna->knc", slope, pose_modes)
    common_sd = np.sqrt((modal[slow:] ** 2).sum(axis=0))
    sd = np.sqrt(np.maximum(np.einsum("ncc->nc", frame_part), 0.0))
    measured = np.asarray(np.isfinite(pose).all(axis=1))
    table = pd.DataFrame(
        {
            "t_s": t_s,
            "y_cg_m": pose[:, 1],
            "beta_rad": pose[:, 2],
            "alpha_rad": alpha,
            "x_cg_m": pose[:, 0],
            "sigma_y_cg_m": sd[:, 0],
            "sigma_beta_rad": sd[:, 1],
            "sigma_alpha_rad": sd[:, 2],
            "status": np.where(measured, "measured", "lost"),
            "cov_y_cg_beta_m_rad": frame_part[:, 0, 1],
            "common_y_cg_m": np.where(measured, common_sd[:, 0], np.nan),
            "common_beta_rad": np.where(measured, common_sd[:, 1], np.nan),
            "common_alpha_rad": np.where(measured & np.isfinite(alpha), common_sd[:, 2], np.nan),
        }
    )
    return table, np.where(measured[None, :, None], modal, 0.0)


def invariants(run: Run, poses: Poses) -> dict[str, Measured]:
    """Mean and scatter over frames of what ``invariant_series`` gives.

    Parameters
    ----------
    run : the run folder as read
    poses : of the body, frame by frame
    """
    found = {name: _mean_and_scatter(values) for name, values in invariant_series(run, poses).items()}
    return {name: value for name, value in found.items() if np.isfinite([value.value, value.std]).all()}


def invariant_series(run: Run, poses: Poses) -> dict[str, Array]:
    """Marker distances and the taut line's length over time, minus stated, m: name -> (n,) (theory.md 4).

    Parameters
    ----------
    run : the run folder as read
    poses : of the body, frame by frame
    """
    place, pose, markers = poses.place_m, poses.rigid.pose, poses.markers
    found: dict[str, Array] = {}
    for j in range(len(markers)):
        for i in range(j):
            apart = np.linalg.norm(place[:, i] - place[:, j], axis=1)
            stated = np.hypot(*(np.array(markers[i].body_m) - np.array(markers[j].body_m)))
            found[f"distance {markers[i].name}-{markers[j].name}"] = apart - stated
    tow = run.file.tow
    if run.file.kind == "tow" and tow is not None and tow.tow_point_m is not None and tow.line_length_m is not None:
        point = pose[:, :2] + tow_arm(pose[:, 2], tow)
        found["taut line"] = np.hypot(*(point - np.array(tow.post_m)).T) - tow.line_length_m
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
