"""Frames -> tracks in pixels with a sigma per point.

Names are loaded when they are first asked for, so that a recording can be decoded while the rest is still being imported.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..record.looks import Look
    from .looks import Follower, register_tracker
    from .overlay import draw_overlay
    from .recording import (
        ClipInfo,
        Frame,
        FrameSource,
        clip_info,
        frame_of,
        open_source,
        read_frames,
        register_source,
        timed_frames,
    )
    from .rows import Rows
    from .scatter import path_scatter
    from .spots.fit import fit_spots
    from .spots.model import SpotFit, start_of, windows
    from .tracker import Tracking, track

_PLACES = {
    "ClipInfo": ".recording",
    "Follower": ".looks",
    "Frame": ".recording",
    "FrameSource": ".recording",
    "Look": ".looks",
    "Rows": ".rows",
    "SpotFit": ".spots.model",
    "Tracking": ".tracker",
    "clip_info": ".recording",
    "draw_overlay": ".overlay",
    "fit_spots": ".spots.fit",
    "frame_of": ".recording",
    "open_source": ".recording",
    "path_scatter": ".scatter",
    "read_frames": ".recording",
    "register_source": ".recording",
    "register_tracker": ".looks",
    "start_of": ".spots.model",
    "timed_frames": ".recording",
    "track": ".tracker",
    "windows": ".spots.model",
}

__all__ = [
    "ClipInfo",
    "Follower",
    "Frame",
    "FrameSource",
    "Look",
    "Rows",
    "SpotFit",
    "Tracking",
    "clip_info",
    "draw_overlay",
    "fit_spots",
    "frame_of",
    "open_source",
    "path_scatter",
    "read_frames",
    "register_source",
    "register_tracker",
    "start_of",
    "timed_frames",
    "track",
    "windows",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name], __name__), name)
