"""A camera of this machine (V4L2, DirectShow, AVFoundation) by OpenCV."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from ..record.errors import VideoError
from .coding import Coder

PIXELS = "yuv420p"
"""What OpenCV hands on was YUV or JPEG before, with no more colour than this keeps."""


class Camera:
    """One camera, open.

    Parameters
    ----------
    source : its index, or its device

    Attributes
    ----------
    by_source : whether it stamps its pictures: OpenCV hands no stamp on
    template : the coder's stream

    Raises
    ------
    VideoError : it does not open, or gives no picture
    """

    by_source = False

    def __init__(self, source: str) -> None:
        import cv2

        self._capture = cv2.VideoCapture(int(source) if source.isdecimal() else source)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
        good, picture = self._capture.read() if self._capture.isOpened() else (False, None)
        if not good or picture is None:
            self._capture.release()
            raise VideoError(f"camera {source}: does not open, or gives no picture")
        height, width = picture.shape[:2]
        self._coder = Coder(width, height, PIXELS, self._capture.get(cv2.CAP_PROP_FPS))
        self.template = self._coder.template
        self._first: tuple[Any, float] | None = (picture, time.monotonic())

    def packets(self) -> Iterator[tuple[Any, float]]:
        """The next picture, coded, and when it was here.

        Raises
        ------
        EOFError : the camera gives no more
        """
        import cv2

        picture, arrived_s = self._first or self._next()
        self._first = None
        for packet in self._coder.packets(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), arrived_s):
            yield packet, arrived_s

    def _next(self) -> tuple[Any, float]:
        good, picture = self._capture.read()
        if not good:
            raise EOFError
        return picture, time.monotonic()

    def close(self) -> None:
        """Let the camera go."""
        self._capture.release()
        self._coder.close()


__all__ = ["Camera"]
