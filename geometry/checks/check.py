"""Is the camera geometry right? An answer from the recording itself, without hydrodynamics.

The bundle of datum picks, marks and taut line is fitted with what is stated, within tolerances; if something does not fit, every
fault is tried and the most probable one is named, with those that cannot be told from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import rq

from ...record.run import Run
from ...record.schema import Marker
from ..camera import Array, Lens
from ..datum import DatumFit
from ..datum_model import PLAIN
from ..mapping import ProjectiveMapping
from ..poses import poses_from_tracks, without_lags
from ..rigid import fit_rigid
from .bundle import Bundle, Film, Rig, Solution
from .faults import Scored, refit, screen
from .layout import CAMERA, POSE

TOLERANCE_M = {"depth": 2e-3, "ahead": 1e-3, "aside": 1e-3, "line length": 1e-3, "tow point": 1e-3, "post ahead": 1e-3}
"""How well a tape measure tells places, where [priors] says nothing."""
LENS_TOLERANCE = {
    "fx": 1e-3,
    "fy": 1e-3,
    "cx": 1.0,
    "cy": 1.0,
    "k1": 2e-3,
    "k2": 2e-3,
    "p1": 1e-4,
    "p2": 1e-4,
    "k3": 1e-3,
}
"""How well a careful calibration tells a lens, where [camera] says nothing (fx, fy relative)."""
LINE_SD_M = 5e-4
"""How exactly a taut line keeps its length from frame to frame, beside the marks' own noise."""
ALARM = 2.5
"""Log Bayes factor from which a fault is named: odds of 12 to 1 against nothing wrong."""
TWINS = 3.0
"""Faults within this log Bayes factor of the best one are named beside it."""
TRIED = 6
"""So many faults, the best of the screening, are fitted in full: a choice, for the time that it takes."""
MOST_FRAMES = 1500
"""Of all runs together; for jumps, of each."""
SMOOTH_S = 4.0
"""Errors slower than this are not told from the model's motion."""
SLOW_PX, SLOW_LINE_M = 0.015, 2e-4
"""Slow errors of a mark's place (codec, texture under the light, the pixels' grid) and of a taut line's length (stretch, sag)."""
LEAST_FRAMES = 60
"""A film with fewer frames in use says nothing about how alike its errors are: a choice."""
LEAST_SHARE = 0.2
"""A residual of which the poses take more than the rest of this says nothing about noise."""


@dataclass(frozen=True)
class Check:
    """What the recording says of its geometry.

    Attributes
    ----------
    bundle : the fit's set-up
    sd : tolerances by parameter, the prior of the fit
    null : the fit with everything within its tolerance
    inflation : of the marks' variances
    ranking : faults tried in full, best first
    """

    bundle: Bundle
    sd: Array
    null: Solution
    inflation: float
    ranking: tuple[Scored, ...]

    @property
    def named(self) -> tuple[Scored, ...]:
        """The fault, and those that cannot be told from it; empty where all is well."""
        if not self.ranking or self.ranking[0].evidence < ALARM:
            return ()
        best = self.ranking[0].evidence
        return tuple(s for s in self.ranking if s.evidence > max(best - TWINS, ALARM))


def check_geometry(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], fit: DatumFit) -> Check:
    """Check one camera set-up over its runs.

    Parameters
    ----------
    runs : of one camera, datum and set of marks
    tracks : per run, as ``record.read_tracks`` gives
    fit : the datum's (``run_datum``)

    Raises
    ------
    InputError, GeometryError : no frame can be used
    """
    bundle = bundle_of(runs, tracks, fit)
    sd = tolerances(bundle, runs[0], fit)
    null = bundle.solve(sd)
    inflation = _inflation(bundle, null)
    bundle = bundle.with_inflation(inflation)
    null = bundle.solve(sd)
    ranking: list[Scored] = []
    seen: set[tuple[str, int]] = set()
    for scored in screen(bundle, null, sd):
        key = (scored.fault.kind, scored.fault.item)
        if key in seen:
            continue
        seen.add(key)
        full = refit(bundle, null, sd, scored)
        if scored.fault.kind == "camera turned":
            # the jump itself is no part of the bundle
            jumped = scored.evidence - full.evidence
            full = Scored(full.fault, full.evidence + max(jumped, 0.0), full.gain, full.solution)
        ranking.append(full)
        if len(ranking) == TRIED or scored.evidence < 0:
            break
    ranking.sort(key=lambda scored: -scored.evidence)
    return Check(bundle, sd, null, inflation, tuple(ranking))


def bundle_of(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], fit: DatumFit) -> Bundle:
    """The bundle of one set-up, at what is stated.

    Parameters
    ----------
    runs : the runs, in their order
    tracks : tables of the runs, in their order
    fit : of the run's datum
    """
    first = runs[0].file
    markers = [m for m in first.marker if m.on == "model"]
    films, close, poses = [], [], []
    for run, table in zip(runs, tracks, strict=True):
        frames = poses_from_tracks(run, without_lags(table), fit.mapping)
        thin, own = (slice(None, None, max(1, -(-len(frames.t_s) * k // MOST_FRAMES))) for k in (len(runs), 1))
        film = _film(run, frames.t_s, frames.pixel_px, frames.sigma_px)
        films.append(film.only(thin))
        close.append(film.only(own))
        # as filmed: where marks on the post move through the picture, the pose itself is told from them
        pose = fit_rigid(frames.place_m, frames.covariance_m2, np.array([m.body_m for m in frames.markers])).pose
        poses.append(np.where(np.isfinite(pose), pose, 0.0)[thin])
    return Bundle(_rig(runs[0], fit, markers), tuple(films), tuple(poses), LINE_SD_M, tuple(close))


def _film(run: Run, t_s: Array, pixel: Array, sigma: Array) -> Film:
    tow = run.file.tow
    taut = run.file.kind == "tow" and tow is not None and tow.line_length_m is not None and tow.tow_point_m is not None
    taut = taut and all(m.on == "model" for m in run.file.marker)
    assert tow is not None or not taut
    return Film(
        t_s,
        pixel,
        sigma,
        tow.line_length_m if taut and tow is not None else None,
        np.array([tow.tow_point_m or 0.0, tow.tow_point_offset_m] if tow is not None else [0.0, 0.0]),
        np.array(tow.post_m if tow is not None else [0.0, 0.0]),
    )


def _rig(run: Run, fit: DatumFit, markers: Sequence[Marker]) -> Rig:
    lens, skew, rotation, translation = camera_of(fit.mapping)
    points = run.file.datum
    return Rig(
        lens,
        skew,
        rotation,
        translation,
        np.array([p.pixel_px for p in points], dtype=float),
        np.array([p.tank_m for p in points], dtype=float),
        fit.sigma_px,
        np.array([m.body_m for m in markers], dtype=float),
        np.array([m.depth_m for m in markers], dtype=float),
    )


def camera_of(mapping: ProjectiveMapping) -> tuple[Lens, float, Array, Array]:
    """Lens, skew (px), rotation and translation of a mapping; where there is no lens its matrix is taken apart."""
    upper, rotation = rq(mapping.matrix[:, :3])
    signs = np.sign(np.diag(upper))
    signs = np.where(signs == 0, 1.0, signs)
    upper, rotation = upper * signs[None, :], signs[:, None] * rotation
    if np.linalg.det(rotation) < 0:
        upper, rotation = -upper, -rotation
        upper = upper * np.sign(upper[2, 2])
    scale = abs(upper[2, 2])
    inner = upper / scale
    translation = np.linalg.solve(inner, mapping.matrix[:, 3] / scale)
    stated = mapping.lens
    if stated != PLAIN and np.any(stated.vector != PLAIN.vector):
        return stated, 0.0, rotation, translation
    vector = np.array([inner[0, 0], inner[1, 1], inner[0, 2], inner[1, 2], 0, 0, 0, 0, 0])
    return Lens.from_vector(vector), float(inner[0, 1]), rotation, translation


def tolerances(bundle: Bundle, run: Run, fit: DatumFit) -> Array:
    """Prior standard deviations: what is stated, else what a careful person reaches; the pose is free.

    Parameters
    ----------
    bundle : all that the recording says, at what is stated
    run : the run folder as read
    fit : of the run's datum
    """
    priors, camera = run.file.priors, run.file.camera
    stated = {
        "depth": priors.marker_depth_sd_m,
        "ahead": priors.marker_place_sd_m,
        "aside": priors.marker_place_sd_m,
        "line length": 0.0 if priors.line_is_usual else priors.line_length_sd_m,
        "tow point": priors.tow_point_sd_m,
        "post ahead": 0.0,
    }
    lens = bundle.rig.lens
    size = {"fx": lens.fx_px, "fy": lens.fy_px}
    free = fit.mapping.method in ("two_planes", "square_pixels", "homography")
    answer = np.zeros(len(bundle.names))
    for index, name in enumerate(bundle.names):
        what = name.rstrip("0123456789").strip()
        if name in POSE:
            answer[index] = np.inf
        elif name in LENS_TOLERANCE:
            told = camera.sd[CAMERA.index(name)] if camera is not None else 0.0
            answer[index] = told or LENS_TOLERANCE[name] * size.get(name, 1.0)
            if free and name in ("fx", "fy", "cx", "cy"):
                answer[index] = 0.3 * lens.fx_px
        elif name == "skew":
            answer[index] = 0.1 * lens.fx_px if fit.mapping.method == "two_planes" else 0.0
        elif name in stated or what in stated:
            key = name if name in stated else what
            answer[index] = stated[key] or TOLERANCE_M[key]
    return answer


def tolerance_names(check: Check, marks: Sequence[str]) -> list[tuple[str, float]]:
    """Tolerances by name (a mark's number becomes its name), without what is fixed or free.

    Parameters
    ----------
    check : of the set-up
    marks : their names
    """
    answer = []
    for name, sd in zip(check.bundle.names, check.sd, strict=True):
        if 0 < sd < np.inf:
            what, _, number = name.rpartition(" ")
            answer.append((f"{what} {marks[int(number)]}" if number.isdigit() else name, float(sd)))
    return answer


def _inflation(bundle: Bundle, null: Solution) -> float:
    """By how much a sum over frames varies more than if every frame were new and as exact as stated.

    What the residuals' fast part shows of itself, and what no residual shows: slow errors of marks and line that look like motion.
    """
    worst = 1.0
    for film, left, project in zip(bundle.films, null.normal.left, null.normal.project, strict=True):
        used = left.any(axis=1)
        if used.sum() < LEAST_FRAMES:
            continue
        t_s, m = film.t_s[used], film.pixel_px.shape[1]
        alike = SMOOTH_S / float(np.median(np.diff(t_s)))
        sigma = float(np.nanmedian(film.sigma_px))
        slow = [(SLOW_PX / sigma) ** 2, (SLOW_LINE_M / bundle.line_sd_m) ** 2 if film.line_m is not None else 0.0]
        share = np.einsum("njj->nj", project[used])
        shown = [
            long_run_variance(t_s, left[used, j] / np.sqrt(share[:, j]))
            for j in range(2 * m + 1)
            if np.median(share[:, j]) > LEAST_SHARE
        ]
        worst = max(worst, 1.0 + max(alike, 1.0) * max(slow), *shown)
    return worst


def long_run_variance(t_s: Array, series: Array) -> float:
    """Variance that sums of a coloured series show, per sample, after its slow part (a spline) is taken out.

    Parameters
    ----------
    t_s, series : (n,)

    Returns
    -------
    variance : n samples of it sum to n times this; for white noise the variance itself
    """
    from scipy.interpolate import LSQUnivariateSpline

    knots = np.arange(t_s[0] + SMOOTH_S, t_s[-1] - SMOOTH_S, SMOOTH_S)
    rest = series - LSQUnivariateSpline(t_s, series, knots)(t_s)
    centre = np.median(np.abs(rest)) / 0.6745
    rest = np.clip(rest, -4 * centre, 4 * centre)
    lag, total = 1, float(rest @ rest)
    covariance = total
    while lag < len(rest) // 10:
        step = float(rest[lag:] @ rest[:-lag])
        if step <= 0.05 * covariance:
            break
        total += 2 * step
        lag += 1
    return total / max(len(rest) - len(knots) - 4, 1)
