"""Pictures as a recording: a folder of them, or a pattern of names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...record.errors import InputError, VideoError
from ...record.files import reading
from ...record.picture_files import PictureFile, picture_files
from .decode import ClipInfo, Frame, frame_of
from .pictures import USUAL_RATE_HZ

PICTURE_BYTES = 1 << 29
"""512 MiB: a file that is larger is no picture of a recording."""
MOST_BITS, LEAST_BITS = 16, 8
"""Of a grey value."""
CODECS = {".jpg": "mjpeg", ".jpeg": "mjpeg", ".webp": "webp", ".tif": "tiff", ".tiff": "tiff"}
"""ffmpeg's name of how a picture is coded, by its suffix; else the suffix itself."""


@dataclass(frozen=True)
class PictureSequence:
    """A folder of pictures, or a pattern.

    Attributes
    ----------
    path : what ``record.picture_files.picture_files`` takes
    """

    path: Path

    @cached_property
    def _files(self) -> list[PictureFile]:
        found = picture_files(self.path)
        if not found:
            raise VideoError(f"{self.path}: no picture is there")
        return found

    def info(self) -> ClipInfo:
        """Of the first picture that can be read; the rate where the names hold times, else as if it were 25 Hz."""
        first = next((picture for file in self._files if (picture := _read(file.path)) is not None), None)
        if first is None:
            raise VideoError(f"{self.path}: holds no picture that can be read")
        last_s, count = self._files[-1].t_s, len(self._files)
        rate_hz = (count - 1) / last_s if last_s else float(USUAL_RATE_HZ)
        suffix = self._files[0].path.suffix.lower()
        return ClipInfo(
            first.shape[1], first.shape[0], rate_hz, count / rate_hz, CODECS.get(suffix, suffix.lstrip("."))
        )

    def frames(
        self, span_s: tuple[float, float] | None, frame_rate_hz: float | None, exposure_s: float
    ) -> Iterator[Frame]:
        """Frame after frame; a missing number is a missing frame, and one that cannot be read is left out and said."""
        notes: list[str] = []
        shape: tuple[int, ...] | None = None
        bits = 0
        held: Frame | None = None
        for file, t_s in self._timed(frame_rate_hz):
            if span_s is not None and not span_s[0] <= t_s <= span_s[1]:
                continue
            picture = _read(file.path)
            if picture is None or (shape is not None and picture.shape[:2] != shape):
                what = "no picture that can be read" if picture is None else _size(picture.shape, shape)
                notes.append(f"{file.path.name}: {what}; left out")
                continue
            if shape is None:
                shape, bits = picture.shape[:2], _bits(picture)
                if LEAST_BITS < bits < MOST_BITS:
                    notes.append(
                        f"{file.path.name}: grey values are taken as {bits} bits, as far as the first picture's reach"
                    )
            if held is not None:
                yield held
            held = replace(
                frame_of(_eight_or_sixteen(picture, bits), file.number, t_s + exposure_s / 2), notes=tuple(notes)
            )
            notes.clear()
        if held is None and notes:
            raise VideoError(f"{self.path}: holds no picture that can be read")
        if held is not None:
            yield replace(held, notes=(*held.notes, *notes))

    def _timed(self, frame_rate_hz: float | None) -> Iterator[tuple[PictureFile, float]]:
        before: PictureFile | None = None
        for file in self._files:
            if frame_rate_hz is None and file.t_s is None:
                raise VideoError(
                    f"{self.path}: pictures have no times; source.frame_rate_hz is needed, or a pattern that says where their "
                    "names hold one, such as img_{ms}.png"
                )
            if frame_rate_hz is None and before is not None and file.t_s == before.t_s:
                raise VideoError(f"{self.path}: {before.path.name} and {file.path.name} have the same time")
            yield file, file.number / frame_rate_hz if frame_rate_hz is not None else file.t_s or 0.0
            before = file


def _read(path: Path) -> NDArray[Any] | None:
    """The picture upright, as it is coded: grey or BGR; None where it cannot be read."""
    import cv2

    try:
        with reading(path, PICTURE_BYTES) as stream:
            content = np.frombuffer(stream.read(), np.uint8)
        picture = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR) if len(content) else None
    except (InputError, OSError, cv2.error):
        return None
    return picture if picture is not None and picture.dtype in (np.uint8, np.uint16) else None


def _bits(picture: NDArray[Any]) -> int:
    """Bits of a grey value: cameras of 10, 12 or 14 bits write 16, of which the upper ones are empty."""
    if picture.dtype == np.uint8:
        return LEAST_BITS
    return next(bits for bits in (10, 12, 14, MOST_BITS) if picture.max() < 1 << bits)


def _eight_or_sixteen(picture: NDArray[Any], bits: int) -> NDArray[Any]:
    """(h, w) uint8 or uint16 with white at the top, or (h, w, 3) uint8."""
    if picture.dtype == np.uint16:
        full = np.minimum(picture.astype(np.uint32) << (MOST_BITS - max(bits, LEAST_BITS)), (1 << MOST_BITS) - 1)
        picture = full.astype(np.uint16)
        return (picture >> 8).astype(np.uint8) if picture.ndim == 3 else picture
    return picture


def _size(shape: tuple[int, ...], first: tuple[int, ...] | None) -> str:
    assert first is not None
    return f"is {shape[1]} x {shape[0]}, the first {first[1]} x {first[0]}"


__all__ = ["PictureSequence"]
