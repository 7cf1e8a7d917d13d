"""The picture of a tow that is filmed, small, a few times a second, with what is seen of the marks drawn into it.

It is drawn by a thread of its own, mostly outside of the interpreter's lock, and is never waited for: a picture that comes while
the last one is drawn, or soon after it, is not drawn; while frames wait for their values pictures are seldom.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..record.files import replacing
from ..record.run import Run
from ..vision.follower import Glance
from ..vision.recording import Frame
from ..vision.recording.luma import turned

PICTURE = "live.jpg"
"""In out/ of a tow; the last one stays."""
EVERY_S = 0.25
"""Between two pictures: a choice, what the eye needs to see a model move."""
SELDOM_S = 1.5
"""Between two while frames wait: on a machine that is always a frame behind somebody still has to see whether the camera sees the
model. A choice."""
WIDEST_PX = 640
"""Of the picture; a larger frame is made smaller."""
QUALITY = 75
"""Of the JPEG, 0 to 100: it is looked at, not measured."""
MARK_BGR, DATUM_BGR, LOST_BGR = (0, 190, 255), (255, 190, 60), (60, 60, 255)
"""Colours of what is drawn: a ring about a mark, a cross at a datum point as it was picked, names of marks that are not seen."""


class Pictures:
    """Draws pictures of one tow.

    Parameters
    ----------
    run : whose out/ they go to
    """

    def __init__(self, run: Run) -> None:
        self._path = run.out / PICTURE
        self._datum = [point.pixel_px for point in run.file.datum]
        self._last_s = -math.inf
        self._next: queue.Queue[tuple[Frame, tuple[Glance, ...]] | None] = queue.Queue(1)
        self._thread = threading.Thread(target=self._draw, name="pictures", daemon=True)
        self._thread.start()

    def offer(self, frame: Frame, marks: tuple[Glance, ...], waiting: bool = False) -> bool:
        """A frame that may be shown; whether it will be. Returns at once.

        Parameters
        ----------
        frame : as decoded
        marks : what is seen in it
        waiting : whether frames wait for their values
        """
        now_s = time.monotonic()
        if now_s < self._last_s + (SELDOM_S if waiting else EVERY_S):
            return False
        try:
            self._next.put_nowait((frame, marks))
        except queue.Full:
            return False
        self._last_s = now_s
        return True

    def close(self) -> None:
        """Draw what was taken, and end."""
        self._next.put(None)
        self._thread.join()

    def _draw(self) -> None:
        while (given := self._next.get()) is not None:
            try:
                data = drawn(*given, self._datum)
                with replacing(self._path) as temporary:
                    temporary.write_bytes(data)
            except OSError:  # a full disk is told by the recording
                continue


def drawn(frame: Frame, marks: tuple[Glance, ...], datum_px: list[tuple[float, float]]) -> bytes:
    """A frame as a small JPEG with rings about its marks and crosses at the datum points.

    Parameters
    ----------
    frame : as decoded
    marks : what is seen in it
    datum_px : where the datum points were picked
    """
    import cv2

    width = frame.luma.shape[1]
    picture = _small(frame, min(1.0, WIDEST_PX / width))
    scale = picture.shape[1] / width

    def at(u: float, v: float) -> tuple[int, int]:
        # pixel centres stand on whole numbers in both
        return round((u + 0.5) * scale - 0.5), round((v + 0.5) * scale - 0.5)

    for u, v in datum_px:
        cv2.drawMarker(picture, at(u, v), DATUM_BGR, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
    lost = [mark.marker for mark in marks if not mark.seen]
    for mark in marks:
        if mark.seen:
            place = at(mark.u_px, mark.v_px)
            cv2.circle(picture, place, 9, MARK_BGR, 2, cv2.LINE_AA)
            _say(picture, mark.marker, (place[0] + 13, place[1] + 4), MARK_BGR)
    if lost:
        _say(picture, f"not seen: {', '.join(lost)}", (8, picture.shape[0] - 10), LOST_BGR)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def _small(frame: Frame, scale: float) -> NDArray[np.uint8]:
    """The picture in colour, upright, made smaller; grey where the decoder's own is not at hand."""
    import cv2

    raw: Any = frame.raw
    if raw is None:
        size = round(frame.luma.shape[1] * scale), round(frame.luma.shape[0] * scale)
        grey = cv2.resize(frame.luma, size, interpolation=cv2.INTER_AREA)
        return np.repeat(np.asarray(grey, np.uint8)[:, :, None], 3, axis=2)
    small = raw.reformat(width=round(raw.width * scale), height=round(raw.height * scale), format="bgr24")
    return np.ascontiguousarray(turned(small.to_ndarray(), raw))


def _say(picture: NDArray[np.uint8], words: str, place: tuple[int, int], colour: tuple[int, int, int]) -> None:
    import cv2

    for ink, thick in (((0, 0, 0), 3), (colour, 1)):
        cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, thick, cv2.LINE_AA)


__all__ = ["EVERY_S", "PICTURE", "Pictures", "drawn"]
