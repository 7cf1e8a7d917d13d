"""The stage of motion of one camera: from a run's own table, from out/, or from its tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...__version__ import __version__
from ...record.errors import InputError, TowlineError
from ...record.files import read_array, write_array
from ...record.results import CameraFile, read_result, write_result
from ...record.run import RUN_FILE, Run
from ...record.tables import input_hash_of, read_motion, read_tracks, write_table
from ..mistaken import mistake_notes, named
from ..progress import Progress
from .tracks import DATUM, TRACKS, fit_run_datum, track_run
from .versions import stamp_of

if TYPE_CHECKING:
    import pandas as pd

MARKS, MOTION, CAMERA = "marks.csv", "motion.csv", "camera.json"
COMMON, LAG = "motion_common.npy", "motion_lag.npy"


@dataclass(frozen=True)
class RunMotion:
    """A run with its motion.

    Attributes
    ----------
    run : whose it is
    motion : motion table
    common, lag : (k, n, 3), (l, n, 3), modes of (y_cg, beta, alpha) as in ``geometry.Motion``; None where the motion came from
        outside
    camera : camera file; None where the motion came from outside
    tracks : None where the motion came from outside
    """

    run: Run
    motion: pd.DataFrame
    common: np.ndarray | None
    camera: CameraFile | None
    tracks: pd.DataFrame | None
    lag: np.ndarray | None = None


def compute_camera_motion(
    run: Run, method: str = "exact", progress: Progress | None = None, fresh: bool = False
) -> RunMotion:
    """Motion of a run of one camera, from its own file, from out/ or from its tracks.

    Parameters
    ----------
    run : with a video, tracks or motion, or as one of two cameras sees it
    method : "exact", or the thesis's "trapezoid", "trapezoid_corners" (4.2)
    progress : as in ``track_run``
    fresh : make tracks and motion again even where out/ is up to date
    """
    if run.file.source.motion is not None:
        return RunMotion(run, _in_span(run, read_motion(run.source_path)), None, None, None)
    found = track_run(run, progress, fresh)
    # as they stand in the file: the motion is the same whether they were tracked now or before
    tracks = read_tracks(run.out / TRACKS) if found.anew else found.table
    stamp = stamp_of(run, "motion", method)
    paths = {name: run.out / name for name in (MARKS, MOTION, COMMON, LAG, CAMERA)}
    if not fresh and input_hash_of(paths[MOTION]) == stamp and all(p.is_file() for p in paths.values()):
        kept = kept_motion(run, tracks)
        if kept is not None:
            return kept
    if progress is not None:
        progress(f"{run.name}: motion", 0, None)
    from ...geometry import motion_from_tracks

    with named(run, tracks):
        fit = fit_run_datum(run)
        result = motion_from_tracks(run, tracks, fit, method, __version__, run.input_hashes(), moving_datum(run))
    camera = result.camera.model_copy(
        update={"notes": [*mistake_notes(run, tracks), *result.camera.notes, *found.notes]}
    )
    write_table(paths[MARKS], result.marks, stamp)
    write_result(paths[CAMERA], camera)
    for name, modes in ((COMMON, result.common), (LAG, result.lag)):
        write_array(paths[name], modes)
    write_table(paths[MOTION], result.motion, stamp)  # last: its stamp vouches for the others
    return RunMotion(run, read_motion(paths[MOTION]), result.common, camera, tracks, result.lag)


def moving_datum(run: Run) -> pd.DataFrame | None:
    """The datum points as they were found again in every frame; None where the camera is taken as standing still.

    Parameters
    ----------
    run : whose tracks are there
    """
    refound = run.out / DATUM
    moving = run.file.source.video is not None and any(p.track for p in run.file.datum) and refound.is_file()
    return read_tracks(refound) if moving else None


def kept_motion(run: Run, tracks: pd.DataFrame | None) -> RunMotion | None:
    """The motion as it stands in out/; None where a file of it is damaged, so that it is made anew.

    Parameters
    ----------
    run : whose motion was made
    tracks : behind it
    """
    try:
        common, lag = (read_array(run.out / name) for name in (COMMON, LAG))
        motion, camera = read_motion(run.out / MOTION), read_result(run.out / CAMERA, CameraFile)
    except (OSError, ValueError, EOFError, TowlineError):
        return None
    whole = common.shape[1:] == lag.shape[1:] == (len(motion), 3)
    return RunMotion(run, motion, common, camera, tracks, lag) if whole else None


def _in_span(run: Run, motion: pd.DataFrame) -> pd.DataFrame:
    span = run.file.source.span_s
    if span is None:
        return motion
    inside = motion[motion["t_s"].between(*span)].reset_index(drop=True)
    if inside.empty:
        raise InputError(
            run.folder / RUN_FILE, "source.span_s", f"{list(span)} holds no sample of {run.file.source.motion}"
        )
    return inside
