"""The stages of a run, tracks and motion: each is made again only when its inputs, its options or its version changed.

A stage writes into RUN/out/, with the stamp of what it was made from (``versions``) in the file's first line; a file whose stamp
still matches is read back. Video, tracks, motion; what comes after takes several runs.
"""

from .drawing import draw_tracks
from .joined import CAMERAS, compute_run_motion, join_cameras, refuse_corrections
from .motion import CAMERA, MARKS, MOTION, RunMotion
from .shown import draw_picture, make_run_page, read_true_motion, read_truth
from .tracks import TRACKS, RunTracks, compute_static_motion, fit_run_datum, track_run, track_static

__all__ = [
    "CAMERA",
    "CAMERAS",
    "MARKS",
    "MOTION",
    "TRACKS",
    "RunMotion",
    "RunTracks",
    "compute_run_motion",
    "compute_static_motion",
    "draw_picture",
    "draw_tracks",
    "fit_run_datum",
    "join_cameras",
    "make_run_page",
    "read_true_motion",
    "read_truth",
    "refuse_corrections",
    "track_run",
    "track_static",
]
