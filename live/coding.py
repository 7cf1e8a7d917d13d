"""Pictures coded without loss as they come from a camera, for the recording and for whoever looks."""

from __future__ import annotations

import io
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

from numpy.typing import NDArray

CODEC = "ffv1"
OPTIONS = {"level": "3", "coder": "0", "context": "0", "g": "1", "slices": "4", "slicecrc": "1"}
"""Without loss and with little work, every picture by itself, each slice with its sum."""
BASE = Fraction(1, 90_000)
"""Ticks of the stamps."""
USUAL_RATE_HZ = 30
"""What is told the coder of a camera that does not say its rate; stamps say when each picture came."""
FINEST = 1001
"""Denominator of a rate, at most: 30000/1001."""


class Coder:
    """Codes one camera's pictures.

    Parameters
    ----------
    width, height : of a picture
    pixels : how its values lie, by ffmpeg's name: "gray", "gray12le", "yuv420p"
    rate_hz : of the camera; 0: not known

    Attributes
    ----------
    template : the coder's stream, by which a recording knows what comes
    """

    def __init__(self, width: int, height: int, pixels: str, rate_hz: float) -> None:
        import av

        self._pixels = pixels
        rate = Fraction(rate_hz or USUAL_RATE_HZ).limit_denominator(FINEST)
        self._container: Any = av.open(io.BytesIO(), "w", format="matroska")  # holds the coder; nothing is written
        self.template = self._container.add_stream(CODEC, rate=rate, options=OPTIONS)
        self.template.width, self.template.height, self.template.pix_fmt = width, height, pixels
        self.template.codec_context.time_base = BASE
        self._container.start_encoding()  # from here on the stream says what it is

    def packets(self, planes: NDArray[Any], stamp_s: float) -> Iterator[Any]:
        """A picture, coded.

        Parameters
        ----------
        planes : its values, as ``pixels`` has them
        stamp_s : when it was taken or came, by one clock
        """
        import av

        frame = av.VideoFrame.from_ndarray(planes, format=self._pixels)
        frame.pts, frame.time_base = round(stamp_s / BASE), BASE
        for packet in self.template.encode(frame):
            packet.time_base = BASE
            yield packet

    def close(self) -> None:
        """Let the coder go."""
        self._container.close()


__all__ = ["Coder"]
