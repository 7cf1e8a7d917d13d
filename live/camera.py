"""A camera of this machine (V4L2, DirectShow, AVFoundation) by OpenCV, its pictures coded without loss as they come."""

from __future__ import annotations

import time
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from ..record.errors import VideoError

CODEC, PIXELS = "ffv1", "yuv420p"
OPTIONS = {"level": "3", "coder": "0", "context": "0", "g": "1", "slices": "4", "slicecrc": "1"}
"""Without loss and with little work, every picture by itself, each slice with its sum. What OpenCV hands on was YUV or JPEG before,
with no more colour than this keeps."""
BASE = Fraction(1, 90_000)
"""Ticks of the stamps."""
USUAL_RATE_HZ = 30
"""What is told the coder of a camera that does not say its rate; stamps say when each picture came."""


class Camera:
    """One camera, open.

    Parameters
    ----------
    source : its index, or its device

    Attributes
    ----------
    codec : in which its pictures come out
    template : the coder's stream

    Raises
    ------
    VideoError : it does not open, or gives no picture
    """

    codec = CODEC

    def __init__(self, source: str) -> None:
        import io

        import av
        import cv2

        self._capture = cv2.VideoCapture(int(source) if source.isdecimal() else source)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
        good, picture = self._capture.read() if self._capture.isOpened() else (False, None)
        if not good or picture is None:
            self._capture.release()
            raise VideoError(f"camera {source}: does not open, or gives no picture")
        rate = Fraction(self._capture.get(cv2.CAP_PROP_FPS) or USUAL_RATE_HZ).limit_denominator(1001)
        self._container: Any = av.open(io.BytesIO(), "w", format="matroska")  # holds the coder; nothing is written
        self.template = self._container.add_stream(CODEC, rate=rate, options=OPTIONS)
        self.template.height, self.template.width = picture.shape[:2]
        self.template.pix_fmt = PIXELS
        self.template.codec_context.time_base = BASE
        self._container.start_encoding()  # from here on the stream says what it is
        self._first: tuple[Any, float] | None = (picture, time.monotonic())

    def packets(self) -> Iterator[tuple[Any, float]]:
        """The next picture, coded, and when it was here.

        Raises
        ------
        EOFError : the camera gives no more
        """
        import av
        import cv2

        picture, arrived_s = self._first or self._next()
        self._first = None
        yuv = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420)
        frame = av.VideoFrame.from_ndarray(yuv, format=PIXELS)
        frame.pts, frame.time_base = round(arrived_s / BASE), BASE
        for packet in self.template.encode(frame):
            packet.time_base = BASE
            yield packet, arrived_s

    def _next(self) -> tuple[Any, float]:
        good, picture = self._capture.read()
        if not good:
            raise EOFError
        return picture, time.monotonic()

    def close(self) -> None:
        """Let the camera go."""
        self._capture.release()
        self._container.close()


__all__ = ["Camera"]
