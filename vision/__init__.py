"""Frames -> tracks in pixels with a sigma per point.

Names are loaded when they are first asked for, so that a recording can be decoded while the rest is still being imported.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .overlay import draw_overlay
    from .recording import ClipInfo, Frame, clip_info, read_frames
    from .scatter import path_scatter
    from .spots.fit import fit_spots
    from .spots.model import SpotFit, start_of, windows
    from .tracker import Tracking, track

_PLACES = {
    "ClipInfo": ".recording",
    "Frame": ".recording",
    "SpotFit": ".spots.model",
    "Tracking": ".tracker",
    "clip_info": ".recording",
    "draw_overlay": ".overlay",
    "fit_spots": ".spots.fit",
    "path_scatter": ".scatter",
    "read_frames": ".recording",
    "start_of": ".spots.model",
    "track": ".tracker",
    "windows": ".spots.model",
}

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


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name], __name__), name)
