"""The recording with what was found drawn over it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..record.files import replacing
from ..record.schema import DatumPoint

# Okabe-Ito, BGR: told apart by colour-blind eyes
COLOURS = ((0, 159, 230), (233, 180, 86), (115, 158, 0), (66, 228, 240), (178, 114, 0), (0, 94, 213), (167, 121, 204))
TRAIL = 40
_SHIFT = 4


def draw_overlay(
    picture: NDArray[np.uint8],
    places: dict[str, NDArray[np.float64] | None],
    datum: Sequence[DatumPoint] = (),
    trails: dict[str, list[NDArray[np.float64]]] | None = None,
    caption: str = "",
) -> NDArray[np.uint8]:
    """Return a copy of ``picture (h, w, 3)`` BGR with circles at the marks, their trails, and crosses at the datum.

    A lost mark is written out, never drawn.
    """
    import cv2

    canvas = picture.copy()
    for point in datum:
        centre = _fixed(point.pixel_px)
        cv2.drawMarker(
            canvas, (round(point.pixel_px[0]), round(point.pixel_px[1])), (255, 255, 255), cv2.MARKER_CROSS, 11, 1
        )
        cv2.circle(canvas, centre, 7 << _SHIFT, (0, 0, 0), 1, cv2.LINE_AA, _SHIFT)
    line = 18
    for index, (name, place) in enumerate(places.items()):
        colour = COLOURS[index % len(COLOURS)]
        if trails is not None and len(trails.get(name, [])) > 1:
            points = np.rint(np.array(trails[name]) * (1 << _SHIFT)).astype(np.int32)
            cv2.polylines(canvas, [points.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA, _SHIFT)
        if place is None:
            text = f"{name}: lost"
        else:
            cv2.circle(canvas, _fixed(place), 9 << _SHIFT, colour, 2, cv2.LINE_AA, _SHIFT)
            text = f"{name} ({place[0]:.2f}, {place[1]:.2f})"
            corner = (round(place[0]) + 13, round(place[1]) + 5)
            _write(canvas, name, corner, colour)
        _write(canvas, text, (8, line), colour)
        line += 18
    if caption:
        _write(canvas, caption, (8, canvas.shape[0] - 8), (255, 255, 255))
    return canvas


def _fixed(place) -> tuple[int, int]:
    return round(float(place[0]) * (1 << _SHIFT)), round(float(place[1]) * (1 << _SHIFT))


def _write(canvas: NDArray[np.uint8], text: str, corner: tuple[int, int], colour: tuple[int, int, int]) -> None:
    import cv2

    for shift, ink in ((1, (0, 0, 0)), (0, colour)):
        place = (corner[0] + shift, corner[1] + shift)
        cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, ink, 1, cv2.LINE_AA)


class OverlayWriter:
    """Encodes overlay frames with the recording's own times; ``watch`` fits ``vision.track``'s argument."""

    def __init__(self, container, datum: Sequence[DatumPoint], rate_hz: float) -> None:
        self._container, self._datum, self._rate = container, datum, rate_hz
        self._stream = None
        self._trails: dict[str, list[NDArray[np.float64]]] = {}
        self._origin = 0.0

    def watch(self, frame, places: dict[str, NDArray[np.float64] | None]) -> None:
        """Draw and encode one frame."""
        import av

        for name, place in places.items():
            trail = self._trails.setdefault(name, [])
            if place is None:
                trail.clear()
            else:
                trail.append(place)
                del trail[:-TRAIL]
        picture = draw_overlay(
            frame.bgr(), places, self._datum, self._trails, f"frame {frame.index}  t = {frame.t_s:.3f} s"
        )
        height, width = (size - size % 2 for size in picture.shape[:2])
        if self._stream is None:
            stream = self._container.add_stream("libx264", rate=Fraction(self._rate).limit_denominator(1001))
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            stream.options = {"crf": "26", "preset": "veryfast"}
            stream.codec_context.time_base = Fraction(1, 90000)
            self._stream, self._origin = stream, frame.t_s
        shown = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="bgr24")
        shown.pts, shown.time_base = round((frame.t_s - self._origin) * 90000), Fraction(1, 90000)
        for packet in self._stream.encode(shown):
            self._container.mux(packet)

    def finish(self) -> None:
        """Flush the encoder."""
        if self._stream is not None:
            for packet in self._stream.encode(None):
                self._container.mux(packet)


@contextmanager
def overlay_writer(path: str | Path, datum: Sequence[DatumPoint], rate_hz: float) -> Iterator[OverlayWriter]:
    """Write an overlay video to ``path`` (mp4), whole or not at all."""
    import av

    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        writer = OverlayWriter(container, datum, rate_hz)
        yield writer
        writer.finish()
