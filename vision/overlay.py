"""The recording with what was found drawn over it."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.errors import VideoError
from ..record.files import replacing
from ..record.schema import DatumPoint
from ..record.tables import seen_rows
from ..record.x264 import x264_options
from .recording import Frame

# Okabe-Ito, BGR: told apart by colour-blind eyes
COLOURS = ((0, 159, 230), (233, 180, 86), (115, 158, 0), (66, 228, 240), (178, 114, 0), (0, 94, 213), (167, 121, 204))
TRAIL = 40
"""Places of a mark that stay drawn behind it: the last so many frames."""
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: sixteenths of a pixel."""
_TICKS = Fraction(1, 90000)
"""The clock of MPEG: 90 kHz, fine enough for any frame rate."""


def draw_overlay(
    picture: NDArray[np.uint8],
    places: dict[str, NDArray[np.float64] | None],
    datum: Sequence[DatumPoint] = (),
    trails: dict[str, list[NDArray[np.float64]]] | None = None,
    caption: str = "",
    reasons: dict[str, str] | None = None,
) -> NDArray[np.uint8]:
    """Return a copy of ``picture (h, w, 3)`` BGR with circles at the marks, their trails, and crosses at the datum.

    A lost mark is written out, never drawn.

    Parameters
    ----------
    picture : (h, w, 3) uint8, BGR
    places : marker -> (2,) px, or None where it is lost; their order gives the colours
    datum : points that are crossed
    trails : marker -> its last places, px
    caption : line at the foot
    reasons : marker -> why it is lost
    """
    canvas = picture.copy()
    _draw(canvas, places, datum, trails or {}, caption, reasons or {})
    return canvas


def _draw(
    canvas: NDArray[np.uint8],
    places: dict[str, NDArray[np.float64] | None],
    datum: Sequence[DatumPoint],
    trails: dict[str, list[NDArray[np.float64]]],
    caption: str,
    reasons: dict[str, str],
) -> None:
    import cv2

    for point in datum:
        centre = _fixed(point.pixel_px)
        cv2.drawMarker(
            canvas, (round(point.pixel_px[0]), round(point.pixel_px[1])), (255, 255, 255), cv2.MARKER_CROSS, 11, 1
        )
        cv2.circle(canvas, centre, 7 << _SHIFT, (0, 0, 0), 1, cv2.LINE_AA, _SHIFT)
    line = 18
    for index, (name, place) in enumerate(places.items()):
        colour = COLOURS[index % len(COLOURS)]
        if len(trails.get(name, [])) > 1:
            points = np.rint(np.array(trails[name]) * (1 << _SHIFT)).astype(np.int32)
            cv2.polylines(canvas, [points.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA, _SHIFT)
        if place is None:
            why = reasons.get(name, "")
            text = f"{name}: lost ({why})" if why else f"{name}: lost"
        else:
            cv2.circle(canvas, _fixed(place), 9 << _SHIFT, colour, 2, cv2.LINE_AA, _SHIFT)
            text = f"{name} ({place[0]:.2f}, {place[1]:.2f})"
            corner = (round(place[0]) + 13, round(place[1]) + 5)
            write_text(canvas, name, corner, colour)
        write_text(canvas, text, (8, line), colour)
        line += 18
    if caption:
        write_text(canvas, caption, (8, canvas.shape[0] - 8), (255, 255, 255))


def _fixed(place: Sequence[float] | NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0]) * (1 << _SHIFT)), round(float(place[1]) * (1 << _SHIFT))


def write_text(
    canvas: NDArray[np.uint8], text: str, corner: tuple[int, int], colour: tuple[int, int, int], size: float = 0.45
) -> None:
    """Write one line with its lower left at ``corner``, over a black shadow; OpenCV's letters are ASCII only.

    Parameters
    ----------
    canvas : (h, w, 3) uint8, BGR, written on
    text : what is written
    corner : its lower left, (u, v) px
    colour : BGR
    size : OpenCV's scale of the letters
    """
    import cv2

    text = plain(text)
    for shift, ink in ((1, (0, 0, 0)), (0, colour)):
        place = (corner[0] + shift, corner[1] + shift)
        cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, ink, 1, cv2.LINE_AA)


def plain(text: str) -> str:
    """``text`` in ASCII: accents are dropped, what has no such letter becomes a question mark."""
    bare = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return bare.encode("ascii", "replace").decode("ascii")


def reasons_of(table: pd.DataFrame) -> NDArray[np.object_]:
    """Why each row's mark is lost, (n,) texts; empty where it is not lost, or where the table does not say."""
    if "reason" not in table:
        return np.full(len(table), "", dtype=object)
    lost = (table["status"] == "lost").to_numpy()
    said = table["reason"].to_numpy(dtype=object)
    return np.array([str(why) if gone and isinstance(why, str) else "" for why, gone in zip(said, lost)], dtype=object)


@dataclass(frozen=True)
class _Seen:
    """A table by frames.

    Attributes
    ----------
    names : the markers, in the table's order
    row_of : frame -> row of what follows
    place : (frames, markers, 2) px, NaN where not measured
    reason : (frames, markers) texts
    """

    names: list[str]
    row_of: dict[int, int]
    place: NDArray[np.float64]
    reason: NDArray[np.object_]

    @classmethod
    def of(cls, table: pd.DataFrame) -> _Seen:
        names = [str(name) for name in pd.unique(table["marker"])]
        frames, row = np.unique(table["frame"].to_numpy().astype(int), return_inverse=True)
        column = pd.Index(names).get_indexer(pd.Index(table["marker"].astype(str)))
        place = np.full((len(frames), len(names), 2), np.nan)
        reason = np.full((len(frames), len(names)), "", dtype=object)
        measured = seen_rows(table)
        place[row[measured], column[measured]] = table[["u_px", "v_px"]].to_numpy(dtype=float)[measured]
        reason[row, column] = reasons_of(table)
        return cls(names, {int(frame): k for k, frame in enumerate(frames)}, place, reason)

    def trail(self, row: int, marker: int) -> list[NDArray[np.float64]]:
        """The last places of a mark up to ``row``, as far as it was measured without a gap."""
        past = self.place[max(row - TRAIL + 1, 0) : row + 1, marker]
        gaps = np.flatnonzero(np.isnan(past[:, 0]))
        return list(past[gaps[-1] + 1 :] if len(gaps) else past)


def write_overlay(
    path: str | Path,
    frames: Iterable[Frame],
    table: pd.DataFrame,
    datum: Sequence[DatumPoint],
    rate_hz: float,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Write an overlay video (mp4) with the recording's own times, frame by frame, whole or not at all.

    Parameters
    ----------
    path : of the file
    frames : of the recording; one that the table does not hold is shown without marks
    table : tracks, as ``track`` or ``record.read_tracks`` gives
    datum : points that are crossed
    rate_hz : nominal frame rate of the recording
    progress : called with the frames written

    Returns
    -------
    int : frames written

    Raises
    ------
    VideoError : there is no frame
    """
    import av

    seen = _Seen.of(table)
    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        encoder = Encoder(container, rate_hz)
        count = 0
        for frame in frames:
            encoder.put(_drawn(frame, seen, datum), frame.t_s)
            count += 1
            if progress is not None:
                progress(count)
        if not count:
            raise VideoError(f"{path}: no frame to draw")
        encoder.finish()
    return count


def _drawn(frame: Frame, seen: _Seen, datum: Sequence[DatumPoint]) -> NDArray[np.uint8]:
    canvas, caption = frame.bgr(), f"frame {frame.index}  t = {frame.t_s:.3f} s"
    row = seen.row_of.get(frame.index)
    if row is None:
        _draw(canvas, {}, datum, {}, caption, {})
        return canvas
    places = {
        name: None if np.isnan(place[0]) else place for name, place in zip(seen.names, seen.place[row], strict=True)
    }
    trails = {name: seen.trail(row, k) for k, name in enumerate(seen.names)}
    _draw(canvas, places, datum, trails, caption, dict(zip(seen.names, seen.reason[row], strict=True)))
    return canvas


class Encoder:
    """H.264 with the times it is given; the first picture fixes the size (made even, as the codec wants it)."""

    def __init__(self, container: Any, rate_hz: float) -> None:
        self._container, self._rate_hz = container, rate_hz
        self._stream: Any = None
        self._origin_s = 0.0

    def put(self, picture: NDArray[np.uint8], t_s: float) -> None:
        """Write one picture, (h, w, 3) BGR; times rise."""
        import av

        height, width = (size - size % 2 for size in picture.shape[:2])
        if self._stream is None:
            stream = self._container.add_stream("libx264", rate=Fraction(self._rate_hz).limit_denominator(1001))
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            # as many threads wherever it runs, and x264's own steadiness: the same bytes
            stream.options = {"crf": "26", "preset": "veryfast", "threads": "2", **x264_options()}
            stream.codec_context.time_base = _TICKS
            self._stream, self._origin_s = stream, t_s
        shown = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="bgr24")
        shown.pts, shown.time_base = round((t_s - self._origin_s) / _TICKS), _TICKS
        self._container.mux(self._stream.encode(shown))

    def finish(self) -> None:
        """Write what the codec still holds back."""
        if self._stream is not None:
            self._container.mux(self._stream.encode(None))
