"""What every reader hands on: points over frames, and the way from there to towline's tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..errors import InputError
from ..tables import first_fall
from .convention import Array, Convention

if TYPE_CHECKING:
    import pandas as pd

EVEN = 0.25
"""A time may stand this share of a step beside the even raster."""
MOST_FRAMES = 5_000_000
"""From the first frame to the last, 46 hours at 30 Hz: beyond it a frame's number or time is wrong."""
LARGEST = 2.0**53
"""Whole numbers up to this are exact."""
OUTSIDE_PX = 1.0
"""A point may lie this far outside the picture before the convention is doubted."""


@dataclass(frozen=True)
class Wanted:
    """What the file does not say.

    Attributes
    ----------
    rate_hz : frames per second
    markers : name in towline -> the program's own; empty: all points under their own names
    image_height_px, y, origin_px, first_pixel, pixels_per_unit : as in ``Convention``; None: what the program is known for
    camera : of files that hold several; None: the only one
    """

    rate_hz: float | None = None
    markers: Mapping[str, str] = field(default_factory=dict)
    image_height_px: float | None = None
    y: Literal["up", "down"] | None = None
    origin_px: tuple[float, float] | None = None
    first_pixel: float | None = None
    pixels_per_unit: float | None = None
    camera: int | None = None

    def convention(self, first_pixel: float = 0.0, y_up: bool = False) -> Convention:
        """How pixels are counted: as stated, else as the program is known for."""
        return Convention(
            first_pixel=first_pixel if self.first_pixel is None else self.first_pixel,
            y_up=y_up if self.y is None else self.y == "up",
            image_height_px=self.image_height_px,
            origin_px=self.origin_px,
            pixels_per_unit=self.pixels_per_unit or 1.0,
        )


@dataclass(frozen=True)
class Points:
    """Points over frames.

    Attributes
    ----------
    names : the program's own names, m of them
    frame : (n,), rising integers
    t_s : (n,), rising
    x, y : (n, m) in the program's coordinates; NaN is a hole
    convention : how to read x and y
    sigma : (n, m, 2) px, of x and y; NaN where the program says nothing
    notes : for the user
    """

    names: tuple[str, ...]
    frame: Array
    t_s: Array
    x: Array
    y: Array
    convention: Convention
    sigma: Array | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Imported:
    """Tracks from another program.

    Attributes
    ----------
    table : tracks as in formats.md; status measured or lost
    program : which program's format it was
    notes : for the user
    """

    table: pd.DataFrame
    program: str
    notes: tuple[str, ...] = ()


def frame_times(path: Path, frame: Array, rate_hz: float | None) -> Array:
    """Times of numbered frames, s; InputError where no rate is given.

    Parameters
    ----------
    path : of the file
    frame : (n,) numbers of frames
    rate_hz : frames per second, or None
    """
    if rate_hz is None:
        raise InputError(path, "", "holds frame numbers and no times; the frame rate is needed (--rate HZ)")
    return frame / rate_hz


def frames_of_times(path: Path, t_s: Array, rate_hz: float | None, lines: list[int]) -> tuple[Array, Array]:
    """Frame numbers of rising times, and the times themselves.

    With a rate a frame is the nearest to t times rate and its time is frame / rate; without one frames are counted from the
    first row at the even step of the times, which stay as they are.

    Parameters
    ----------
    path : of the file
    t_s : (n,), rising strictly
    rate_hz : frames per second, or None
    lines : line of each in the file, for errors
    """
    row = first_fall(t_s)
    if row is not None:
        raise InputError(path, f"line {lines[row]}, time", f"{t_s[row]:g} s after {t_s[row - 1]:g} s; times must rise")
    wild = np.flatnonzero(np.abs(t_s) * (rate_hz or 1.0) >= LARGEST)
    if len(wild):
        row = int(wild[0])
        raise InputError(path, f"line {lines[row]}, time", f"{t_s[row]:g} s is no time of a recording")
    if rate_hz is not None:
        frame = np.round(t_s * rate_hz).astype(int)
        times = frame / rate_hz
    else:
        if len(t_s) < 2:
            raise InputError(path, "", "one row only; its frame rate cannot be seen (--rate HZ)")
        step = float(np.median(np.diff(t_s)))
        if t_s[-1] - t_s[0] > MOST_FRAMES * step:
            raise InputError(
                path,
                f"line {lines[-1]}, time",
                f"{t_s[-1]:g} s is too long after {t_s[0]:g} s at steps of {step:.4g} s",
            )
        step = (t_s[-1] - t_s[0]) / round((t_s[-1] - t_s[0]) / step)
        frame = np.round((t_s - t_s[0]) / step).astype(int)
        off = np.abs(t_s - t_s[0] - frame * step)
        if off.max() > EVEN * step:
            row = int(np.argmax(off))
            raise InputError(
                path,
                f"line {lines[row]}, time",
                f"{t_s[row]:g} s lies {off[row]:.3g} s beside even steps of {step:.4g} s; say the frame rate (--rate HZ)",
            )
        times = t_s
    same = np.flatnonzero(np.diff(frame) <= 0)
    if len(same):
        row = int(same[0]) + 1
        raise InputError(
            path, f"line {lines[row]}, time", f"{t_s[row]:g} s falls into frame {frame[row]}, as the row before does"
        )
    return frame, times


def filled(points: Points) -> Points:
    """Every frame from the first to the last at the smallest step that occurs; a frame that the file leaves out is a hole."""
    if len(points.frame) < 2:
        return points
    step = int(np.diff(points.frame).min())
    if ((points.frame - points.frame[0]) % step).any():
        step = 1
    frame = np.arange(points.frame[0], points.frame[-1] + 1, step)
    place = (points.frame - frame[0]) // step
    t_s = np.interp(frame, points.frame, points.t_s)
    t_s[place] = points.t_s

    def spread(values: Array) -> Array:
        full = np.full((len(frame), *values.shape[1:]), np.nan)
        full[place] = values
        return full

    sigma = None if points.sigma is None else spread(points.sigma)
    return Points(points.names, frame, t_s, spread(points.x), spread(points.y), points.convention, sigma, points.notes)


def tracks_table(path: Path, points: Points, wanted: Wanted) -> pd.DataFrame:
    """Points -> tracks as in formats.md; a hole is a row with status lost, never a value.

    Parameters
    ----------
    path : of the file that they come from, for messages
    points : as the program has them
    wanted : what the file does not say

    Raises
    ------
    InputError : a wanted name is not there, nothing is measured, or points lie outside a picture of ``image_height_px``
    """
    import pandas as pd

    unknown = [name for name in wanted.markers.values() if name not in points.names]
    if unknown:
        some = ", ".join(points.names[:12]) + (", ..." if len(points.names) > 12 else "")
        raise InputError(path, f"marker {unknown[0]}", f"no such point; found {some}")
    chosen = dict(wanted.markers) or {name: name for name in points.names}
    if not len(points.frame):
        raise InputError(path, "", "holds no row")
    first, last = int(points.frame[0]), int(points.frame[-1])
    if last - first > MOST_FRAMES:
        raise InputError(
            path, f"frame {last}", f"is too far from the first, {first}; at most {MOST_FRAMES} frames are expected"
        )
    points = filled(points)
    columns = [points.names.index(name) for name in chosen.values()]
    u, v = points.convention.to_pixels(points.x[:, columns], points.y[:, columns])
    seen = np.isfinite(u) & np.isfinite(v)
    if not seen.any():
        raise InputError(path, "", "holds no measured point of " + ", ".join(chosen))
    _inside(path, points, list(chosen), u, v, seen, wanted.image_height_px)
    sigma = np.full((*u.shape, 2), np.nan) if points.sigma is None else points.sigma[:, columns]
    sigma = np.where((seen & (sigma > 0).all(axis=2))[..., None], sigma, np.nan)
    count = len(chosen)
    return pd.DataFrame(
        {
            "frame": np.repeat(points.frame, count),
            "t_s": np.repeat(points.t_s, count),
            "marker": list(chosen) * len(points.frame),
            "u_px": np.where(seen, u, np.nan).ravel(),
            "v_px": np.where(seen, v, np.nan).ravel(),
            "sigma_u_px": sigma[..., 0].ravel(),
            "sigma_v_px": sigma[..., 1].ravel(),
            "status": np.where(seen, "measured", "lost").ravel(),
        }
    )


def _inside(
    path: Path, points: Points, names: list[str], u: Array, v: Array, seen: Array, height_px: float | None
) -> None:
    low = -0.5 - OUTSIDE_PX
    out = seen & ((u < low) | (v < low))
    if height_px is not None:
        out |= seen & (v > height_px - 0.5 + OUTSIDE_PX)
    if out.any():
        row, column = np.argwhere(out)[0]
        picture = "the picture" if height_px is None else f"a picture {height_px:g} px high"
        raise InputError(
            path,
            f"frame {points.frame[row]}, {names[column]}",
            f"u = {u[row, column]:.1f}, v = {v[row, column]:.1f} px lies outside {picture}; check --y, --image-height, --origin "
            "and --pixels-per-unit",
        )
