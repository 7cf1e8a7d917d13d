"""The check of a camera set-up over its runs: composes geometry and identify; the command prints it, the page shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtrc

from ..__version__ import __version__
from ..geometry import DatumFit, run_datum
from ..geometry.checks.check import Check, check_geometry, tolerance_names
from ..geometry.checks.checked import Checked
from ..geometry.checks.mistakes import Mistake
from ..geometry.checks.refine import refined
from ..geometry.checks.words import found_fault
from ..geometry.mapping import ProjectiveMapping
from ..geometry.motion import invariants, motion_from_tracks
from ..geometry.poses import Poses, poses_from_tracks, without_lags
from ..identify import RunData, fit_runs, run_data
from ..identify.data import common_key
from ..identify.joint.begin import knows_full_only
from ..identify.tension import GaugeCheck, tension_from_motion
from ..record.cameras_file import CamerasFile
from ..record.check_file import CheckFile, FoundFault, FoundMistake, MapOfUncertainty, PointCheck
from ..record.errors import EstimationError, GeometryError, InputError, TowlineError
from ..record.run import RUN_FILE, Run, all_inputs, cameras_of, read_run
from ..simulate.model import DERIVATIVE_UNITS, Line
from .mistaken import mistakes_of, named
from .progress import Progress as StageProgress
from .stages import fit_run_datum, join_cameras, refuse_corrections, track_run

UNLIKELY = 1e-4
"""A joint fit less probable than this, after its noise is scaled, holds something that is not right."""
GRID = 9
"""Points along either side of the map of uncertainty."""
EFFECT_FRAMES = 300
"""Frames at which a fault's effect on the motion is computed: about as many of each run, evenly."""
SURE = 14.0
"""Log Bayes factor, odds of a million to one, above which the fault stands for sure."""
WORTH_SAYING = 1.0
"""Per cent of a derivative."""
Progress = Callable[[str], None]


def filmed_runs(
    folders: Sequence[str | Path], progress: StageProgress, line: Line | None = None
) -> tuple[list[Run], list[pd.DataFrame], dict[str, str]]:
    """Runs that can be checked, their tracks, and why the others cannot; a single run's reason is raised. A run of two cameras is
    two here, as each camera sees it.

    Parameters
    ----------
    folders : run folders
    progress : is told what is done
    line : what the tow line keeps, "surge" or "constant", instead of what run.toml says; None: what it says
    """
    runs: list[Run] = []
    tables: list[pd.DataFrame] = []
    failed: dict[str, str] = {}
    for folder in folders:
        try:
            run = read_run(folder, line)
            if run.file.source.motion is not None:
                raise InputError(
                    run.folder / RUN_FILE, "source.motion", "a motion holds no pixels; there is no camera to check"
                )
            refuse_corrections(run)
            seen = [(view, track_run(view, progress).table) for view in cameras_of(run)]
            runs += [view for view, _ in seen]
            tables += [table for _, table in seen]
        except TowlineError as error:
            if len(folders) == 1:
                raise
            failed[str(folder)] = str(error)
    return runs, tables, failed


def agreements(folders: Sequence[str | Path], progress: StageProgress) -> tuple[dict[str, CamerasFile], dict[str, str]]:
    """What the two cameras of each run that has two say of each other, by its name, and why they say nothing.

    Parameters
    ----------
    folders : run folders
    progress : is told what is done
    """
    found: dict[str, CamerasFile] = {}
    failed: dict[str, str] = {}
    for folder in folders:
        try:
            run = read_run(folder)
            if run.file.cameras:
                found[run.name] = join_cameras(run, progress=progress)[1]
        except TowlineError as error:
            failed[str(folder)] = str(error)
    return found, failed


def set_ups(runs: Sequence[Run], tables: Sequence[pd.DataFrame]) -> list[tuple[str, list[Run], list[pd.DataFrame]]]:
    """Runs of one camera, datum and set of marks belong together: the stem of their files, the runs, their tracks.

    Parameters
    ----------
    runs : the runs, in their order
    tables : their tracks
    """
    groups: dict[str, list[int]] = {}
    for index, run in enumerate(runs):
        groups.setdefault(common_key(run), []).append(index)
    return [
        ("check" if len(groups) == 1 else f"check-{number}", [runs[i] for i in group], [tables[i] for i in group])
        for number, group in enumerate(groups.values(), 1)
    ]


def checked(
    runs: Sequence[Run],
    tracks: Sequence[pd.DataFrame],
    refine: Sequence[str] = (),
    effects: bool = True,
    progress: Progress | None = None,
) -> Checked:
    """Check one set-up.

    Parameters
    ----------
    runs, tracks : of one set-up
    refine : parameters to estimate (``geometry.checks.refine.CHOICES``)
    effects : also say what each camera parameter's uncertainty does to the derivatives
    progress : is told what is done
    """
    say = progress or (lambda _: None)
    say("checking the camera")
    mistakes = _mistakes(runs, tracks)
    if any(mistake.keys for mistake in mistakes):
        return _mistaken(runs, tracks, mistakes)
    return _checked(runs, tracks, refine, effects, say, mistakes)


def _mistakes(runs: Sequence[Run], tracks: Sequence[pd.DataFrame]) -> list[Mistake]:
    """Gross mistakes of the runs of a set-up; what they share is said once."""
    found: dict[tuple[str, tuple[str, ...]], Mistake] = {}
    for run, table in zip(runs, tracks, strict=True):
        for mistake in mistakes_of(run, table):
            found.setdefault((mistake.kind, mistake.keys), mistake)
    return list(found.values())


def _mistaken(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], mistakes: Sequence[Mistake]) -> Checked:
    """The check of a set-up that holds a mistake: it comes first, and no fault is named beside it.

    Raises
    ------
    InputError : nothing can be shown of the set-up; names the mistake
    """
    with named(runs[0], tracks[0]):
        found = _checked(runs, tracks, (), False, lambda _: None, mistakes)
    said = [mistake.line for mistake in mistakes]
    said.append("no statistics are given: they would rest on this set-up; mend run.toml and check again")
    file = found.file.model_copy(
        update={"verdict": "mistake", "sentences": said, "faults": [], "tried": [], "gauges": {}}
    )
    return replace(found, file=file)


def _checked(
    runs: Sequence[Run],
    tracks: Sequence[pd.DataFrame],
    refine: Sequence[str],
    effects: bool,
    say: Progress,
    mistakes: Sequence[Mistake],
) -> Checked:
    datum = fit_run_datum(runs[0])
    poses = [
        poses_from_tracks(run, without_lags(table), datum.mapping) for run, table in zip(runs, tracks, strict=True)
    ]
    try:
        check = check_geometry(runs, tracks, datum)
    except np.linalg.LinAlgError as error:
        raise GeometryError(
            f"{', '.join(run.name for run in runs)}: the camera cannot be checked ({error}); are the datum points picked, and do "
            "the marks move?"
        ) from None
    points = [p.name or f"point {i + 1}" for i, p in enumerate(runs[0].file.datum)]
    marks = [m.name for m in runs[0].file.marker if m.on == "model"]
    names = [run.name for run in runs]
    tried = [found_fault(check, scored, points, marks, names) for scored in check.ranking]
    likely = tried[: len(check.named)]
    unlikely = chdtrc(check.null.degrees, check.null.chi_square) < UNLIKELY
    gauges = gauges_of(runs, tracks, datum) if not mistakes else {}
    contradicted = [name for name, gauge in gauges.items() if gauge.contradicted]
    verdict = "fault" if likely else ("unknown" if unlikely or mistakes or contradicted else "sound")
    values, words = refined(check, refine) if refine else ([], [])
    changes = effects_of(runs, tracks, datum, say) if effects else {}
    file = CheckFile(
        schema="towline/check",
        tool=__version__,
        inputs=all_inputs(runs),
        runs=names,
        verdict=verdict,
        sentences=[
            *(mistake.line for mistake in mistakes),
            *_sentences(verdict, likely, check, runs, changes, bool(unlikely)),
            *(gauge_words(*g) for g in gauges.items()),
        ],
        mistakes=[FoundMistake(kind=m.kind, keys=list(m.keys), sentence=m.line) for m in mistakes],
        faults=likely,
        tried=tried,
        chi_square=check.null.chi_square,
        degrees=check.null.degrees,
        inflation=check.inflation,
        datum=[
            PointCheck(
                name=name,
                residual_px=(float(datum.residual_px[i, 0]), float(datum.residual_px[i, 1])),
                residual_mm=(float(1e3 * datum.residual_m[i, 0]), float(1e3 * datum.residual_m[i, 1])),
                sigma_px=float(datum.sigma_px[i]),
                used=i not in datum.excluded,
            )
            for i, name in enumerate(points)
        ],
        invariants={run.name: invariants(run, found) for run, found in zip(runs, poses, strict=True)},
        tolerances={name: float(sd) for name, sd in tolerance_names(check, marks)},
        uncertainty=_map(runs, poses, datum),
        effects_percent=changes,
        refined=values,
        refined_words=words,
        notes=list(datum.notes),
        gauges={name: gauge.result for name, gauge in gauges.items()},
    )
    return Checked(file, check, list(runs), poses, datum)


def _sentences(
    verdict: str,
    named: Sequence[FoundFault],
    check: Check,
    runs: Sequence[Run],
    changes: dict[str, dict[str, float]],
    unlikely: bool,
) -> list[str]:
    said: list[str] = []
    if verdict == "sound":
        said.append(
            "nothing is wrong with the camera beyond the tolerances: datum, marker distances and taut line agree"
        )
    elif verdict == "fault":
        said.append(named[0].sentence)
        sure = named[0].evidence > SURE
        odds = "more than a million to 1" if sure else f"{np.exp(named[0].evidence):.0f} to 1"
        said.append(f"odds against nothing being wrong: {odds}")
        if len(named) > 1:
            said.append("these runs do not tell it from: " + "; ".join(f.sentence for f in named[1:]))
    elif not unlikely:
        said.append("datum, marker distances and taut line agree with one another, but not with all that is stated")
    else:
        said.append(
            f"something does not fit (chi-square {check.null.chi_square:.0f} of {check.null.degrees}) and no single fault explains "
            "it; look where the invariants depart in the page, and for two faults at once"
        )
    if not any(film.line_m is not None for film in check.bundle.films):
        said.append("no taut line in these runs: only datum and marker distances were checked")
    spare = 2 * len(runs[0].file.datum) - 6
    if spare < 4:
        said.append(
            f"the datum has {len(runs[0].file.datum)} points: with six or more, a badly picked one could be named"
        )
    worst = sorted(((abs(v), k, p) for k, row in changes.items() for p, v in row.items()), reverse=True)
    if worst and worst[0][0] >= WORTH_SAYING:
        size, key, parameter = worst[0]
        said.append(
            f"the camera's largest share in a derivative: one standard deviation of {parameter} is {size:.1f} % of {key}"
        )
    return said


def _map(runs: Sequence[Run], poses: Sequence[Poses], datum: DatumFit) -> MapOfUncertainty:
    """Common error of places on a grid over what the marks cover."""
    depths = [m.depth_m for found in poses for m in found.markers]
    seen = np.concatenate([found.place_m.reshape(-1, 2) for found in poses])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    margin = 0.05 * (high - low) + 0.02
    x, y = (np.linspace(low[k] - margin[k], high[k] + margin[k], GRID) for k in range(2))
    depth = float(np.mean(depths))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixel = datum.mapping.to_pixel(np.column_stack([grid, np.full(len(grid), depth)]))
    modes = datum.mapping.to_tank(pixel, depth).modes_m
    own = runs[0].file.priors.marker_depth_sd_m
    if own:
        lower = datum.mapping.to_tank(pixel, depth + 1e-4).xy_m - grid
        modes = np.concatenate([modes, (lower / 1e-4 * own)[None]])
    spread = 1e3 * np.sqrt((modes**2).sum(axis=0)).reshape(GRID, GRID, 2)
    return MapOfUncertainty(x_m=x.tolist(), y_m=y.tolist(), x_mm=spread[..., 0].tolist(), y_mm=spread[..., 1].tolist())


# what the camera does to the derivatives ------------------------------------------------------------------------------


def effects_of(
    runs: Sequence[Run], tracks: Sequence[pd.DataFrame], datum: DatumFit, say: Progress, only: str = ""
) -> dict[str, dict[str, float]]:
    """Change of each derivative by one standard deviation of each camera parameter, %: the runs evaluated again with it moved.

    Empty where these runs give no derivatives (no tension, free runs). ``only``: parameters whose name begins so.

    Parameters
    ----------
    runs : the runs, in their order
    tracks : tracks table
    datum : fit of the datum
    say : is told what is done
    only : beginning of the parameters' names; "": all
    """
    tracks = [_thinned(table) for table in tracks]
    try:
        say("camera and derivatives: as stated")
        base = _derivatives(runs, tracks, datum)
    except TowlineError:
        return {}
    changes: dict[str, dict[str, float]] = {name: {} for name in DERIVATIVE_UNITS}

    def put(name: str, moved: np.ndarray) -> None:
        for key, change in zip(changes, 100 * (moved / base - 1), strict=True):
            changes[key][name] = float(change)

    for name, moved_runs in _moved_runs(runs):
        if not name.startswith(only):
            continue
        say(f"camera and derivatives: {name}")
        try:
            put(name, _derivatives(moved_runs, tracks, None))
        except TowlineError:
            continue
    if not "datum picks".startswith(only):
        return changes
    square = np.zeros(len(base))
    mapping = datum.mapping
    for index in range(len(mapping.matrix_modes)):
        say(f"camera and derivatives: datum picks, {index + 1} of {len(mapping.matrix_modes)}")
        square += (_derivatives(runs, tracks, replace(datum, mapping=_along(mapping, index))) - base) ** 2
    put("datum picks", base + np.sign(base) * np.sqrt(square))
    return changes


def _thinned(table: pd.DataFrame) -> pd.DataFrame:
    """Fewer frames: what a camera's error does to a derivative is smooth in time."""
    frames = np.unique(table["frame"].to_numpy())
    kept = frames[:: max(1, len(frames) // EFFECT_FRAMES)]
    return table[table["frame"].isin(kept)].reset_index(drop=True)


def _along(mapping: ProjectiveMapping, index: int) -> ProjectiveMapping:
    moved: dict[str, Any] = {"matrix": mapping.matrix + mapping.matrix_modes[index]}
    if len(mapping.lens_modes):
        moved["lens"] = type(mapping.lens).from_vector(mapping.lens.vector + mapping.lens_modes[index])
    return replace(mapping, **moved)


def _derivatives(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], datum: DatumFit | None) -> np.ndarray:
    data = _data(runs, tracks, datum)
    return np.array(fit_runs(data, "full" if any(knows_full_only(d) for d in data) else "linear").six)


def _data(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], datum: DatumFit | None) -> list[RunData]:
    data = []
    for run, table in zip(runs, tracks, strict=True):
        fit = datum if datum is not None else run_datum(run, None)
        motion = motion_from_tracks(run, table, fit)
        data.append(run_data(run, motion.motion, motion.common))
    return data


def gauges_of(runs: Sequence[Run], tracks: Sequence[pd.DataFrame], datum: DatumFit) -> dict[str, GaugeCheck]:
    """Load cells of lines that keep their length against the motion: run name -> scale, zero and delay.

    Parameters
    ----------
    runs : the runs, in their order
    tracks : tracks table
    datum : fit of the datum
    """
    if not any(r.file.tow is not None and r.file.tow.tension is not None and r.file.tow.line == "surge" for r in runs):
        return {}
    try:
        data = _data(runs, tracks, datum)
        found = tension_from_motion(fit_runs(data), data)
    except EstimationError:  # of the camera alone there is still something to say
        return {}
    return {} if found is None else found.gauges


def gauge_words(name: str, gauge: GaugeCheck) -> str:
    """One sentence.

    Parameters
    ----------
    name : of the run
    gauge : load cell against the motion
    """
    (scale, scale_sd), (zero, zero_sd), (late, late_sd) = gauge.scale, gauge.zero_n, gauge.delay_s
    said = (
        f"load cell of {name!r} against the motion: it reads {scale:.3f} +- {scale_sd:.3f} of what pulls, its zero is {zero:+.3f} "
        f"+- {zero_sd:.3f} N, its clock {late:+.3f} +- {late_sd:.3f} s late"
    )
    return f"{said}: the motion contradicts it" if gauge.contradicted else said


def _moved_runs(runs: Sequence[Run]) -> Iterator[tuple[str, list[Run]]]:
    """Every stated parameter moved by its standard deviation (or its tolerance)."""
    from ..geometry.checks.check import LENS_TOLERANCE, TOLERANCE_M

    file = runs[0].file
    camera, priors = file.camera, file.priors

    def changed(update: Callable[[Any], dict[str, Any]]) -> list[Run]:
        return [replace(run, file=run.file.model_copy(update=update(run.file))) for run in runs]

    if camera is not None:
        told = camera.sd

        def lens(**change: Any) -> list[Run]:
            return changed(lambda f: {"camera": f.camera.model_copy(update=change)})

        focal = (told[0] / camera.fx_px) or LENS_TOLERANCE["fx"]
        yield (
            f"focal length {100 * focal:.2g} %",
            lens(fx_px=camera.fx_px * (1 + focal), fy_px=camera.fy_px * (1 + focal)),
        )
        centre = told[2] or LENS_TOLERANCE["cx"]
        yield f"principal point u {centre:g} px", lens(cx_px=camera.cx_px + centre)
        centre = told[3] or LENS_TOLERANCE["cy"]
        yield f"principal point v {centre:g} px", lens(cy_px=camera.cy_px + centre)
        radial = told[4] or LENS_TOLERANCE["k1"]
        yield f"k1 {radial:g}", lens(distortion=(camera.distortion[0] + radial, *camera.distortion[1:]))
    deep = priors.marker_depth_sd_m or TOLERANCE_M["depth"]
    yield (
        f"deck height {1e3 * deep:g} mm",
        changed(lambda f: {"marker": tuple(m.model_copy(update={"depth_m": m.depth_m + deep}) for m in f.marker)}),
    )
    off = priors.marker_place_sd_m or TOLERANCE_M["ahead"]
    for axis, word in ((0, "ahead"), (1, "aside")):

        def place(f: Any, axis: int = axis) -> dict[str, Any]:
            first = f.marker[0]
            body = tuple(v + off * (k == axis) for k, v in enumerate(first.body_m))
            return {"marker": (first.model_copy(update={"body_m": body}), *f.marker[1:])}

        yield f"mark {file.marker[0].name} {word} {1e3 * off:g} mm", changed(place)


__all__ = ["Checked", "agreements", "checked", "effects_of", "filmed_runs", "set_ups"]
