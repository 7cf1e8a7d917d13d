"""What the camera sees, as far as the run is described: the datum's fit, the grid, the view from above, the detector's spots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from ..geometry import DatumFit, fit_datum
from ..record.errors import TowlineError
from ..record.looks import in_words, is_spot, spot_names
from ..record.run import Run
from ..record.schema import CameraTable, DatumPoint, check_datum
from ..record.template import PLACEHOLDER
from ..record.toml import _lists_to_tuples
from ..report.scale_grid import GridLine, enlargement, grid_lines
from ..report.topview import TopView, area_around, top_view
from ..vision.recording import Frame
from ..vision.spots.candidates import find_candidates
from ..vision.spots.search import Search

LEAST_POINTS = 4
"""A plane's homography has eight numbers: four points."""
VIEW_PX = 380.0
"""Of the longer side of the view from above."""


@dataclass(frozen=True)
class Sight:
    """The camera over the datum points that are picked so far.

    Attributes
    ----------
    points : usable datum points, and their numbers in run.toml
    fit : None where there are too few, or they do not fix the camera
    words : why not, or what the fit noted; for the user
    """

    points: tuple[DatumPoint, ...]
    numbers: tuple[int, ...]
    fit: DatumFit | None
    words: tuple[str, ...]
    size_px: tuple[int, int]
    depth_m: float


def sight(content: Any, size_px: tuple[int, int], lens_covariance: NDArray[Any] | None = None) -> Sight:
    """Fit the camera to what a run.toml holds, even if the rest of it is not there yet.

    Parameters
    ----------
    content : the tables, as TOML holds them
    size_px : of the picture
    lens_covariance : (9, 9) of the lens, or None
    """
    points, numbers = [], []
    for number, row in enumerate(content.get("datum", [])):
        try:
            point = DatumPoint.model_validate(_lists_to_tuples(row))
        except ValidationError:
            continue
        if not point.name.startswith(PLACEHOLDER):
            points.append(point)
            numbers.append(number)
    words: list[str] = []
    camera = None
    if "camera" in content:
        try:
            camera = CameraTable.model_validate(_lists_to_tuples(content["camera"]))
        except ValidationError as error:
            missing = ", ".join(str(fault["loc"][-1]) for fault in error.errors(include_url=False))
            words.append(f"the lens is not complete ({missing}): taken as free of distortion until it is")
        if camera is not None and camera.image_size_px != size_px:
            words.append(f"camera.image_size_px is {list(camera.image_size_px)}, the picture is {list(size_px)}")
            camera = None
    depths = [row["depth_m"] for row in content.get("marker", []) if isinstance(row.get("depth_m"), (int, float))]
    depth = float(np.mean(depths)) if depths else 0.0
    fit = None
    if len(points) < LEAST_POINTS:
        words.append(f"{len(points)} of at least {LEAST_POINTS} datum points; six or more let a bad one be named")
    else:
        try:
            check_datum(tuple(points))
            fit = fit_datum(points, camera, depths or [0.0], size_px, lens_covariance)
            words += fit.notes
        except (TowlineError, ValueError, np.linalg.LinAlgError) as error:
            words.append(str(error))
    return Sight(tuple(points), tuple(numbers), fit, tuple(words), size_px, depth)


def grid_of(seen: Sight) -> tuple[list[GridLine], float]:
    """Lines of equal x and y in the plane of the marks, and their step; none where there is no camera."""
    if seen.fit is None:
        return [], 0.0
    try:
        return grid_lines(seen.fit.mapping, area_around(seen.points, seen.depth_m), seen.size_px)
    except TowlineError:
        return [], 0.0


def arrows_of(seen: Sight) -> tuple[float, list[tuple[int, float, float]]]:
    """By how much the residuals are enlarged, and (number in run.toml, du, dv) px of each as drawn."""
    if seen.fit is None:
        return 0.0, []
    times = enlargement(seen.fit.residual_px)
    if not times:
        return 0.0, []
    return times, [(k, *(times * r).tolist()) for k, r in zip(seen.numbers, seen.fit.residual_px, strict=True)]


def view_of(seen: Sight) -> TopView | None:
    """How the plane of the marks is seen from above; None where there is no camera. It is the same for all frames."""
    if seen.fit is None:
        return None
    try:
        area = area_around(seen.points, seen.depth_m)
        return top_view(seen.fit.mapping, area, seen.size_px, 1e3 * max(area.size_m) / VIEW_PX)
    except TowlineError:
        return None


@dataclass(frozen=True)
class Detected:
    """What the detector sees in a frame.

    Attributes
    ----------
    spots_px : all spots, (n, 2)
    marks_px : marker -> its spot, as far as the markers, the line and the datum tell
    words : for the user
    """

    spots_px: NDArray[Any]
    marks_px: dict[str, tuple[float, float]]
    words: str


def detected(frame: Frame, seen: Sight, run: Run | None) -> Detected:
    """The detector's look at one frame, as at the start of tracking.

    Parameters
    ----------
    frame : of the recording
    seen : what the camera sees
    run : checked; None where run.toml is not complete: then only the bright spots are shown
    """
    marks = () if run is None else tuple(m for m in run.file.marker if is_spot(m.look))
    if run is None or seen.fit is None or len(marks) < 2:
        spots = find_candidates(frame.luma)
        why = (
            "run.toml is not complete"
            if run is None
            else "there is no camera yet"
            if seen.fit is None
            else f"no two {in_words([f'{name}s' for name in spot_names()])}"
        )
        return Detected(spots.centre_px, {}, f"{len(spots)} bright spots; which is which is not tried: {why}")
    near: list[NDArray[Any] | None] = [None if m.seen_at_px is None else np.array(m.seen_at_px) for m in marks]
    try:
        chosen, spots = Search(run, marks, seen.fit.mapping).anywhere(frame, near)
    except TowlineError as error:
        return Detected(np.zeros((0, 2)), {}, str(error))
    found = {
        m.name: (float(spots.centre_px[k][0]), float(spots.centre_px[k][1]))
        for m, k in zip(marks, chosen.chosen, strict=True)
        if k >= 0
    }
    if not chosen.accepted:
        return Detected(
            spots.centre_px,
            {},
            f"{len(spots)} spots, none of them fit the markers: check body_m, depth_m, colour, datum",
        )
    doubt = "; another assignment fits nearly as well: give seen_at_px" if chosen.ambiguous else ""
    return Detected(spots.centre_px, found, f"{len(spots)} spots, {len(found)} of {len(marks)} marks found{doubt}")


__all__ = ["Detected", "Sight", "arrows_of", "detected", "grid_of", "sight", "view_of"]
