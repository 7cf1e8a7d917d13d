"""Frames -> tracks in pixels with a sigma per point."""

from .decode import ClipInfo, Frame, clip_info, read_frames
from .overlay import draw_overlay
from .scatter import path_scatter
from .spot import SpotFit, fit_spots, start_of, windows
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
