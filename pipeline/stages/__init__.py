"""The stages of a run, tracks and motion: each is made again only when its inputs, its options or its version changed.

A stage writes into RUN/out/, with the stamp of what it was made from (``versions``) in the file's first line; a file whose stamp
still matches is read back. Video, tracks, motion; what comes after takes several runs.
"""

from .drawing import draw_tracks
from .motion import CAMERA, MARKS, MOTION, RunMotion, compute_run_motion
from .shown import draw_picture, make_run_page, read_true_motion, read_truth
from .tracks import TRACKS, RunTracks, compute_static_motion, fit_run_datum, track_run, track_static

__all__ = [
    "CAMERA",
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
    "make_run_page",
    "read_true_motion",
    "read_truth",
    "track_run",
    "track_static",
]
