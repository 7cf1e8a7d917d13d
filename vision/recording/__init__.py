"""A recording's frames: decoded ahead in a thread, each with its true time, damage told; a video file's, or another source's."""

from .decode import ClipInfo, Frame
from .source import (
    FrameSource,
    clip_info,
    frame_of,
    open_source,
    read_frames,
    register_source,
    timed_frames,
)

__all__ = [
    "ClipInfo",
    "Frame",
    "FrameSource",
    "clip_info",
    "frame_of",
    "open_source",
    "read_frames",
    "register_source",
    "timed_frames",
]
