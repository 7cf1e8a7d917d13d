"""The motion of a run, of one camera or of two: each camera's own stages into out/NAME/, and what they say together into out/."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...__version__ import __version__
from ...record.cameras_file import CamerasFile
from ...record.errors import InputError, TowlineError
from ...record.files import write_array
from ...record.results import CameraFile, read_result, write_result
from ...record.run import CORRECTIONS, Run, cameras_of
from ...record.tables import input_hash_of, read_motion, write_table
from ..mistaken import named
from ..progress import Progress
from .motion import CAMERA, COMMON, LAG, MARKS, MOTION, RunMotion, compute_camera_motion, kept_motion, moving_datum
from .tracks import fit_run_datum
from .versions import stamp_of

if TYPE_CHECKING:
    from ...geometry.cameras.flash import Lit

CAMERAS = "cameras.json"


def compute_run_motion(
    run: Run, method: str = "exact", progress: Progress | None = None, fresh: bool = False
) -> RunMotion:
    """Motion of a run, from its own file, from out/ or from its tracks; of two cameras, joined.

    Parameters
    ----------
    run : with a video, tracks or motion, or two ``[[camera]]``
    method : "exact", or the thesis's "trapezoid", "trapezoid_corners" (4.2)
    progress : as in ``track_run``
    fresh : make tracks and motion again even where out/ is up to date
    """
    if not run.file.cameras:
        return compute_camera_motion(run, method, progress, fresh)
    return join_cameras(run, method, progress, fresh)[0]


def join_cameras(
    run: Run, method: str = "exact", progress: Progress | None = None, fresh: bool = False
) -> tuple[RunMotion, CamerasFile]:
    """Motion of a run that two cameras filmed, and what these say of each other.

    Parameters
    ----------
    run, method, progress, fresh : as ``compute_run_motion`` takes

    Raises
    ------
    InputError : as of each camera; or the motion does not tell the clocks apart; or there are corrections by hand
    """
    refuse_corrections(run)
    each = [compute_camera_motion(view, method, progress, fresh) for view in cameras_of(run)]
    stamp = stamp_of(run, "cameras", method)
    paths = {name: run.out / name for name in (MARKS, MOTION, COMMON, LAG, CAMERA, CAMERAS)}
    if not fresh and input_hash_of(paths[MOTION]) == stamp and all(path.is_file() for path in paths.values()):
        kept = _kept(run, each)
        if kept is not None:
            return kept
    if progress is not None:
        progress(f"{run.name}: two cameras", 0, None)
    from ...geometry.cameras.motion import joint_motion
    from ...geometry.cameras.words import cameras_file
    from ...geometry.motion import run_mapping
    from ...geometry.poses import poses_from_tracks

    poses, mappings = [], []
    for m in each:
        assert m.tracks is not None
        with named(m.run, m.tracks):
            fit = fit_run_datum(m.run)
            mappings.append(run_mapping(m.run, fit, method))
            poses.append(poses_from_tracks(m.run, m.tracks, mappings[-1], fit, moving_datum(m.run), pulled=True))
    found = joint_motion(run, poses, mappings, _lit(run, progress))
    said = cameras_file(run, found, __version__, run.input_hashes())
    camera = _camera_file(run, each, said)
    write_table(paths[MARKS], _marks(run, each, said), stamp)
    write_result(paths[CAMERA], camera)
    write_result(paths[CAMERAS], said)
    for name, modes in ((COMMON, found.common), (LAG, found.lag)):
        write_array(paths[name], modes)
    write_table(paths[MOTION], found.motion, stamp)  # last: its stamp vouches for the others
    motion = RunMotion(run, read_motion(paths[MOTION]), found.common, camera, each[0].tracks, found.lag)
    return motion, said


def _lit(run: Run, progress: Progress | None) -> tuple[list[Lit], list[Lit]]:
    """The flashes that each camera saw; none where one of them has no video, or its clock is stated."""
    views = cameras_of(run)
    if run.file.cameras[1].offset_s is not None or any(view.file.source.video is None for view in views):
        return [], []
    from ...vision.flash import brightness, flashes
    from ...vision.recording import read_frames

    found = []
    for view in views:
        if progress is not None:
            progress(f"{view.name}: flashes", 0, None)
        source = view.file.source
        frames = read_frames(view.source_path, source.span_s, source.frame_rate_hz, source.exposure_s)
        found.append(flashes(*brightness(frames), source.exposure_s))
    return found[0], found[1]


def refuse_corrections(run: Run) -> None:
    """Corrections by hand do not say which camera's picture they are of.

    Parameters
    ----------
    run : the run folder as read

    Raises
    ------
    InputError : a run of two cameras has some
    """
    if run.file.cameras and (run.folder / CORRECTIONS).is_file():
        raise InputError(
            run.folder / CORRECTIONS,
            "",
            "corrections by hand cannot be used with two [[camera]] yet; take the file away",
        )


def _camera_file(run: Run, each: list[RunMotion], said: CamerasFile) -> CameraFile:
    """The first camera's file, with what both say: notes and invariants by camera."""
    files = [(camera.name, m.camera) for camera, m in zip(run.file.cameras, each, strict=True) if m.camera is not None]
    notes = [f"{name}: {note}" for name, file in files for note in file.notes]
    invariants = {f"{what} by {name}": value for name, file in files for what, value in file.invariants.items()}
    update = {"inputs": run.input_hashes(), "notes": [*said.sentences, *notes], "invariants": invariants}
    return files[0][1].model_copy(update=update)


def _marks(run: Run, each: list[RunMotion], said: CamerasFile):
    """Both cameras' marks in tank axes, on the first one's clock, by camera."""
    import pandas as pd

    from ...record.tables import read_table

    tables = []
    for camera, m in zip(run.file.cameras, each, strict=True):
        table = read_table(m.run.out / MARKS, ("t_s", "marker"))
        if camera.name == said.cameras[1]:
            table["t_s"] = said.offset_s.value + (1 + said.rate.value) * table["t_s"]
        tables.append(table.assign(camera=camera.name))
    return pd.concat(tables, ignore_index=True).sort_values(["t_s", "camera", "marker"], kind="stable")


def _kept(run: Run, each: list[RunMotion]) -> tuple[RunMotion, CamerasFile] | None:
    """The motion and what the cameras say, as they stand; None where a file of it is damaged, so that it is made anew."""
    motion = kept_motion(run, each[0].tracks)
    try:
        said = read_result(run.out / CAMERAS, CamerasFile)
    except (OSError, ValueError, EOFError, TowlineError):
        return None
    return None if motion is None else (motion, said)


__all__ = ["CAMERAS", "compute_run_motion", "join_cameras", "refuse_corrections"]
