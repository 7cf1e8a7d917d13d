"""Frames -> tracks in pixels with a sigma per point."""

from .decode import ClipInfo, Frame, clip_info, read_frames
from .overlay import draw_overlay, overlay_writer
from .spot import SpotFit, fit_spots, windows
from .tracker import Tracking, track

__all__ = [
    "ClipInfo",
    "Frame",
    "SpotFit",
    "Tracking",
    "clip_info",
    "draw_overlay",
    "fit_spots",
    "overlay_writer",
    "read_frames",
    "track",
    "windows",
]
