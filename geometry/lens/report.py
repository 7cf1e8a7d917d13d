"""A calibration as the result file, and as text for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...__version__ import __version__
from ...record.lens_file import BoardPart, CoveragePart, LensFile, LensView
from .boards import Board
from .calibrate import DOUBTFUL, Calibration
from .coverage import Coverage
from .model import PARAMETERS


def lens_file(
    answer: Calibration,
    found: Coverage,
    board: Board,
    not_found: Sequence[str],
    notes: Sequence[str],
    inputs: dict[str, str],
) -> LensFile:
    """The result file of a calibration.

    Parameters
    ----------
    answer : of ``calibrate``
    found : from ``coverage``
    board : which pattern, how many corners, how large
    not_found : names of pictures in which no board was found
    notes : sentences for the user
    inputs : name of an input -> its SHA-256, as the file states them
    """
    shape = answer.fit.shape_m
    rms = np.sqrt((shape**2).mean(0))
    return LensFile(
        tool=__version__,
        inputs=inputs,
        image_size_px=answer.image_size_px,
        fx_px=answer.lens.fx_px,
        fy_px=answer.lens.fy_px,
        cx_px=answer.lens.cx_px,
        cy_px=answer.lens.cy_px,
        distortion=tuple(map(float, answer.lens.distortion)),  # type: ignore[arg-type]
        covariance=answer.covariance.tolist(),
        sd_corners=_sds(answer.covariance_corners),
        sd_views=_sds(answer.covariance_views),
        scatter=answer.scatter,
        sigma_px=answer.sigma_px,
        rms_px=answer.rms_px,
        condition=answer.condition,
        board=BoardPart(
            columns=board.columns,
            rows=board.rows,
            square_m=board.square_m,
            dictionary=board.dictionary,
            marker_m=board.marker_m,
            fitted=bool(answer.fit.shape_sd_m.any()),
            shape_rms_m=(float(rms[0]), float(rms[1]), float(rms[2])),
            shape_max_m=float(np.linalg.norm(shape, axis=1).max()),
        ),
        views=[
            LensView(
                name=view.name,
                points=view.corners,
                points_out=view.corners_out,
                rms_px=view.rms_px,
                expected_px=view.expected_px,
                used=view.used,
                outlier=view.ratio > DOUBTFUL,
                why=view.why,
            )
            for view in answer.views
        ],
        not_found=list(not_found),
        coverage=CoveragePart(
            corners=found.corners.tolist(),
            covered=found.covered.tolist(),
            sd_px=[[None if np.isnan(value) else float(value) for value in row] for row in found.sd_px],
        ),
        notes=list(notes),
    )


def _sds(covariance: np.ndarray) -> dict[str, float]:
    return {name: float(np.sqrt(covariance[i, i])) for i, name in enumerate(PARAMETERS)}


def report_lines(result: LensFile, found: Coverage, file_name: str = "") -> list[str]:
    """What the terminal shows; ``file_name`` of the result file.

    Parameters
    ----------
    result : of ``lens_file``
    found : from ``coverage``
    file_name : of the result file
    """
    used = sum(view.used for view in result.views)
    lines = [
        f"{used} of {len(result.views)} views used, {sum(v.points for v in result.views if v.used)} corners, "
        f"{result.rms_px:.3f} px rms (a coordinate +- {result.sigma_px:.3f} px)",
    ]
    if result.not_found:
        lines.append(f"board not found in {len(result.not_found)}: {', '.join(result.not_found)}")
    lines += ["", "      value        +- sd       (independent corners, jackknife over views)"]
    for name, value in result.values.items():
        unit, digits = ("px", 2) if name in ("fx", "fy", "cx", "cy") else ("", 5)
        sd = result.sd[name]
        deviation = (
            "not fitted"
            if sd == 0
            else (
                f"+- {sd:.{digits}f} {unit:2} ({result.sd_corners[name]:.{digits}f}, {result.sd_views[name]:.{digits}f})"
            )
        )
        lines.append(f"{name:3} {value:11.{digits}f} {deviation}")
    lines += ["", f"{'view':28} corners  rms px  expected px"]
    for view in result.views:
        mark = "" if view.used and not view.outlier else "  doubtful" if view.used else "  LEFT OUT"
        lines.append(f"{view.name:28} {view.points:7d} {view.rms_px:7.3f} {view.expected_px:12.3f}{mark}")
    lines += [
        "",
        f"corners per cell ({100 * found.share:.0f} % of the picture covered; . = inside a view):",
        *found.lines(),
    ]
    lines += ["how far the lens may be wrong there, px ((..) = not covered):", *found.sd_lines(), ""]
    lines += [f"note: {note}" for note in result.notes]
    return [*lines, "", result.camera_toml(file_name)]
