"""What a page shows of a run beside its fit: its picture, and the truth it was rendered from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...record.errors import TowlineError
from ...record.results import TruthFile, read_result
from ...record.run import Run
from ...record.tables import SEEN, read_motion, seen_rows
from .motion import RunMotion

if TYPE_CHECKING:
    import pandas as pd

    from ...report import RunPage


def read_truth(run: Run) -> TruthFile | None:
    """truth/derivatives.json of a rendered ``run``, or None; a broken one is as good as none."""
    path = run.folder / "truth" / "derivatives.json"
    if not path.is_file():
        return None
    try:
        return read_result(path, TruthFile)
    except TowlineError:
        return None


def read_true_motion(run: Run) -> pd.DataFrame | None:
    """truth/motion.csv of a rendered ``run`` (truth.csv beside run.toml is read as well), or None."""
    for path in (run.folder / "truth" / "motion.csv", run.folder / "truth.csv"):
        if path.is_file():
            try:
                return read_motion(path)
            except TowlineError:
                return None
    return None


def make_run_page(m: RunMotion, fitted: pd.DataFrame | None, problem: str | None) -> RunPage:
    """What a page shows of a run.

    Parameters
    ----------
    m : its picture, tracks and motion
    fitted : t_s, y_cg_m, beta_rad of the fit to it; None without
    problem : why there is none, in words
    """
    from ...report import RunPage

    return RunPage(
        m.run.name,
        draw_picture(m.run, m.tracks),
        m.tracks,
        m.motion,
        fitted,
        read_true_motion(m.run),
        m.camera,
        problem,
    )


def draw_picture(run: Run, tracks: pd.DataFrame | None, share: float = 0.15) -> np.ndarray | None:
    """A frame of a run with its marks drawn, (h, w, 3) BGR; None without a video.

    Parameters
    ----------
    run : with a video
    tracks : its tracks
    share : of the way through the record at which the frame is taken
    """
    if run.file.source.video is None or tracks is None or tracks.empty:
        return None
    from ...vision import draw_overlay, read_frames

    frames = np.unique(tracks["frame"].to_numpy())
    wanted = int(frames[int(share * (len(frames) - 1))])
    rows = tracks[tracks["frame"] == wanted]
    places: dict[str, np.ndarray | None] = {
        str(r.marker): np.array([r.u_px, r.v_px]) if r.status in SEEN else None for r in rows.itertuples()
    }
    t_s = float(rows["t_s"].iloc[0])
    trails = {}
    for name in places:
        path = tracks[(tracks["marker"] == name) & seen_rows(tracks)]
        trails[name] = list(path[["u_px", "v_px"]].to_numpy())
    source = run.file.source
    stamped_s = t_s - source.exposure_s / 2
    # a picture that was stamped when it came stands later in the recording than its time in the tracks
    near = max(stamped_s - 1.0, 0.0), stamped_s + 1.0
    for frame in read_frames(run.source_path, near, source.frame_rate_hz, source.exposure_s):
        if frame.index == wanted:
            return draw_overlay(frame.bgr(), places, run.file.datum, trails, f"{run.name}  t = {t_s:.2f} s")
    return None
