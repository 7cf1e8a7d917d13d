"""A recording's frames: decoded ahead in a thread, each with its true time, damage told."""

from .decode import ClipInfo, Frame, clip_info, read_frames

__all__ = ["ClipInfo", "Frame", "clip_info", "read_frames"]
