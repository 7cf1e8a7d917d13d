"""lens.json: a calibrated lens, how well it is known, and what it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from .errors import InputError
from .results import ResultFile, read_result, write_result
from .schema import CameraTable

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_NEGATIVE = -1e-7
"""An eigenvalue of the correlation matrix may be this far below zero by rounding."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class BoardPart(_Part):
    """The board."""

    columns: int = Field(description="inner corners of a chessboard, squares of a ChArUco board, across")
    rows: int = Field(description="the same, down")
    square_m: float = Field(description="side of a square")
    dictionary: str = Field(default="", description="of a ChArUco board's marks; empty: a chessboard")
    marker_m: float = Field(default=0.0, description="side of a ChArUco board's marks")
    fitted: bool = Field(description="its shape was fitted with the lens; false: taken as flat and true")
    shape_rms_m: tuple[float, float, float] = Field(
        description="how far its corners are from their places: across, down, out of the plane (root mean square)"
    )
    shape_max_m: float = Field(description="the largest of these offsets")


class LensView(_Part):
    """One picture of the board."""

    name: str = Field(description="file, or frame of the recording")
    points: int = Field(description="corners used")
    points_out: int = Field(default=0, description="corners left out as clearly wrong")
    rms_px: float = Field(description="root mean square distance of measured and projected corners")
    expected_px: float = Field(description="the same for a lens that was fitted without this view")
    used: bool = Field(description="false: left out of the fit")
    outlier: bool = Field(description="misses by more than twice the usual")
    why: str = Field(default="", description="what is wrong with it")


class CoveragePart(_Part):
    """Where in the picture the corners were; rows from the top, columns from the left."""

    corners: list[list[int]] = Field(description="corners per cell")
    covered: list[list[bool]] = Field(description="enough corners in the cell, or its middle inside a view")
    sd_px: list[list[float | None]] = Field(
        description="how far the lens may be wrong there, one coordinate, the camera's attitude left to the datum"
    )


class LensFile(ResultFile):
    """lens.json."""

    schema_name: Literal["towline/lens"] = Field(default="towline/lens", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    image_size_px: tuple[int, int] = Field(description="width, height of the pictures")
    fx_px: float = Field(gt=0, description="focal length along u")
    fy_px: float = Field(gt=0, description="focal length along v")
    cx_px: float = Field(description="principal point, u")
    cy_px: float = Field(description="principal point, v")
    distortion: tuple[float, float, float, float, float] = Field(description="k1 k2 p1 p2 k3 of OpenCV's model")
    covariance: list[list[float]] = Field(description="9 x 9, of fx fy cx cy k1 k2 p1 p2 k3; zero: not fitted")
    sd_corners: dict[str, float] = Field(
        description="standard deviations, had the errors of the corners been independent"
    )
    sd_views: dict[str, float] = Field(description="standard deviations by the jackknife over the views")
    scatter: float = Field(description="variance of the views' pulls over what independent corners let expect")
    sigma_px: float = Field(description="standard deviation of a corner's coordinate")
    rms_px: float = Field(description="root mean square distance over all corners used")
    condition: float = Field(description="of the parameters' correlation matrix")
    board: BoardPart = Field(description="the board")
    views: list[LensView] = Field(description="per picture in which the board was found")
    not_found: list[str] = Field(default_factory=list, description="pictures in which it was not")
    coverage: CoveragePart = Field(description="cells of the picture")
    notes: list[str] = Field(description="what the reader must know")

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return {name: float(np.sqrt(self.covariance[i][i])) for i, name in enumerate(PARAMETERS)}

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter."""
        numbers = (self.fx_px, self.fy_px, self.cx_px, self.cy_px, *self.distortion)
        return dict(zip(PARAMETERS, numbers, strict=True))

    def camera_table(self) -> CameraTable:
        """run.toml's [camera]."""
        return CameraTable(
            image_size_px=self.image_size_px,
            fx_px=self.fx_px,
            fy_px=self.fy_px,
            cx_px=self.cx_px,
            cy_px=self.cy_px,
            distortion=self.distortion,
            sd=tuple(self.sd.values()),  # type: ignore[arg-type]
        )

    def camera_toml(self, path: str = "") -> str:
        """run.toml's [camera] as text to paste; ``path`` of this file, to be named in it."""
        return "\n".join(
            [
                "[camera]",
                f"image_size_px = [{self.image_size_px[0]}, {self.image_size_px[1]}]",
                *(f"{name}_px = {self.values[name]:.4f}" for name in PARAMETERS[:4]),
                "distortion = [" + ", ".join(f"{value:.7f}" for value in self.distortion) + "]",
                "sd = [" + ", ".join(f"{value:.3g}" for value in self.sd.values()) + "]",
                *([f'# calibration = "{path}"  # beside run.toml: their covariance, better than sd'] if path else []),
            ]
        )


def write_lens(path: str | Path, lens: LensFile) -> None:
    """Write lens.json atomically.

    Parameters
    ----------
    path : of the file
    lens : the calibration
    """
    write_result(path, lens)


def read_lens(path: str | Path) -> LensFile:
    """Read lens.json.

    Raises
    ------
    InputError : it is absent, no JSON, another schema, or a covariance that cannot be one.
    """
    lens = read_result(path, LensFile)
    if min(lens.image_size_px) < 1:
        raise InputError(
            path, "image_size_px", f"{list(lens.image_size_px)}: a width and a height above 0 are expected"
        )
    if not all(np.isfinite(value) for value in lens.values.values()):
        raise InputError(path, "fx_px .. distortion", "finite numbers are expected")
    rows = [len(row) for row in lens.covariance]
    if rows != [9] * 9:
        raise InputError(
            path, "covariance", f"{len(rows)} rows of {sorted(set(rows))} numbers; 9 rows of 9 are expected"
        )
    matrix = np.array(lens.covariance)
    if not np.isfinite(matrix).all():
        raise InputError(path, "covariance", "finite numbers are expected")
    sizes = np.sqrt(np.abs(np.diag(matrix)))
    scale = np.where(sizes > 0, sizes, 1.0)
    shares = matrix / np.outer(scale, scale)
    if np.abs(shares - shares.T).max() > 1e-6:
        raise InputError(path, "covariance", "is not symmetric")
    if np.linalg.eigvalsh(shares).min() < _NEGATIVE:
        raise InputError(path, "covariance", "has a negative eigenvalue: no covariance is so")
    return lens
