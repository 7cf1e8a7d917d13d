"""DLTdv's *xypts.csv (pt1_cam1_X, pt1_cam1_Y, ...) and Argus's (name_cam_1_x, ...): a row per frame, NaN where not digitised.

The first pixel's middle is 1 (MATLAB). DLTdv 1 to 7 and Argus count y from the lower edge, DLTdv8 from the upper one; the file
does not say which, so the user must.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from .points import Points, Wanted, frame_times
from .text import read_sheet

COLUMN = re.compile(r"^(?P<point>.+)_cam_?(?P<camera>\d+)_(?P<axis>[xy])$", re.IGNORECASE)


def read_dltdv(path: Path, wanted: Wanted) -> Points:
    """Read digitised points of one camera; row 1 is frame 0.

    Parameters
    ----------
    path : of the file
    wanted : what the file does not say

    Raises
    ------
    InputError : no such columns, a Y without its X, several cameras and none chosen, y's direction not said, no number
    """
    sheet = read_sheet(path)
    found: dict[int, dict[str, dict[str, int]]] = {}
    for index, cell in enumerate(sheet.header):
        match = COLUMN.match(cell.strip())
        if match:
            axes = found.setdefault(int(match["camera"]), {}).setdefault(match["point"], {})
            axes[match["axis"].lower()] = index
    if not found:
        raise InputError(path, "header", f"no column like pt1_cam1_X; found {', '.join(sheet.header[:6])}")
    camera = wanted.camera if wanted.camera is not None else min(found)
    if camera not in found or (wanted.camera is None and len(found) > 1):
        cameras = ", ".join(str(number) for number in sorted(found))
        raise InputError(path, "header", f"holds cameras {cameras}; say which one (--camera N)")
    points = found[camera]
    for name, axes in points.items():
        if set(axes) != {"x", "y"}:
            absent = "Y" if "y" not in axes else "X"
            raise InputError(path, f"column {name}_cam{camera}_{absent}", "missing beside its other coordinate")
    if wanted.y is None:
        raise InputError(
            path, "", "does not say where y starts: --y up for DLTdv 1-7 and Argus, --y down for DLTdv8 are expected"
        )
    if wanted.y == "up" and wanted.image_height_px is None and wanted.origin_px is None:
        raise InputError(path, "", "y runs from the lower edge; the picture's height is needed (--image-height PX)")
    convention = wanted.convention(first_pixel=1.0)
    frame = np.arange(len(sheet.rows))
    x, y = (np.stack([sheet.numbers(axes[axis]) for axes in points.values()], axis=1) for axis in "xy")
    return Points(tuple(points), frame, frame_times(path, frame, wanted.rate_hz), x, y, convention)
