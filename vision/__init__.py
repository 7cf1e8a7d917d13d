"""Frames -> tracks in pixels with a sigma per point."""

from .overlay import draw_overlay
from .recording import ClipInfo, Frame, clip_info, read_frames
from .scatter import path_scatter
from .spots.fit import fit_spots
from .spots.model import SpotFit, start_of, windows
from .tracker import Tracking, track

__all__ = [
    "ClipInfo",
    "Frame",
    "SpotFit",
    "Tracking",
    "clip_info",
    "draw_overlay",
    "fit_spots",
    "path_scatter",
    "read_frames",
    "start_of",
    "track",
    "windows",
]
