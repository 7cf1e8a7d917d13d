"""The planes of a decoded picture: luma as it was coded, upright."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PLANAR = re.compile(r"yuvj?4\d\dp|yuva4\d\dp|nv\d\d|gray")
_DEEP = re.compile(r"yuva?4\d\dp\d+le|gray1\dle|p\d1\dle|nv20le")
_INTERLEAVED = {"yuyv422": 0, "yvyu422": 0, "uyvy422": 1}
"""8 bits with chroma between: where the first luma stands."""
_COLOURS = re.compile(r"yuvj|gbr|pal|0?rgb|0?bgr|argb|abgr|mono")
_FULL_RANGE = 2
"""FFmpeg's AVCOL_RANGE_JPEG: levels from 0 to 255."""
WHITE_LIMITED_DN, WHITE_FULL_DN = 235, 255
"""White of 8 bits in limited range (ITU-R BT.601, BT.709) and in full range."""


def luma(raw: Any) -> NDArray[np.uint8]:
    """Luma, (h, w) uint8, upright: a read-only view where that can be; deeper than 8 bits: the upper 8."""
    name = raw.format.name
    if _PLANAR.fullmatch(name):
        return turned(_plane(raw, np.uint8), raw)
    # the decoder's own conversion would stretch limited range
    if name in _INTERLEAVED:
        return turned(_plane(raw, np.uint8, 2)[:, _INTERLEAVED[name] :: 2], raw)
    if _DEEP.fullmatch(name):
        # p010 and the like keep their bits at the upper end
        shift = 8 if name.startswith("p") else raw.format.components[0].bits - 8
        return turned((_plane(raw, np.uint16) >> shift).astype(np.uint8), raw)
    return turned(raw.to_ndarray(format="gray"), raw)


def _plane(raw: Any, kind: Any, samples: int = 1) -> NDArray[Any]:
    plane = raw.planes[0]
    whole = np.frombuffer(plane, kind).reshape(-1, abs(plane.line_size) // np.dtype(kind).itemsize)
    whole.flags.writeable = False  # the decoder may still predict from this memory
    rows = whole if plane.line_size > 0 else whole[::-1]
    return rows[: raw.height, : samples * raw.width]


def white_dn(raw: Any) -> int:
    """Luma of white."""
    name, known = raw.format.name, raw.color_range
    if known == _FULL_RANGE or _COLOURS.match(name) or (name.startswith("gray") and not known):
        return WHITE_FULL_DN
    return WHITE_LIMITED_DN


def quarters(raw: Any) -> int:
    """Quarter turns, counter-clockwise, that put the picture upright."""
    return round(getattr(raw, "rotation", 0) / 90) % 4


def turned(picture: NDArray[np.uint8], raw: Any) -> NDArray[np.uint8]:
    """``picture`` upright.

    Parameters
    ----------
    picture : as decoded
    raw : PyAV's frame
    """
    turns = quarters(raw)
    return np.ascontiguousarray(np.rot90(picture, turns)) if turns else picture
