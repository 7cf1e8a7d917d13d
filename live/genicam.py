"""An industrial camera (GigE Vision, USB3 Vision, CoaXPress) by GenICam: harvesters asks the vendor's GenTL producer.

``genicam:PRODUCER.cti#CAMERA``: the producer is the vendor's file; without one those that GENICAM_GENTL64_PATH names, as the
standard has it, are asked. CAMERA is a serial number, a name that a user gave, or an id; of one camera alone it need not be said.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..record.errors import VideoError
from .coding import Coder

PREFIX = "genicam:"
PATHS = "GENICAM_GENTL64_PATH"
"""Folders of GenTL producers (GenTL standard, section 3)."""
AT_ONCE_S, WAIT_S, SILENT_S = 1e-3, 0.5, 10.0
"""A picture that is there, one that is waited for, and a camera that has ended: it gives none for so long."""
KEPT = 32
"""Pictures that the producer may hold while the machine is busy: a second of them. A choice."""
NS = 1e-9
"""Seconds in a nanosecond."""
BAYER = ("RG", "BG", "GR", "GB")
"""First two colours of the first row."""
Planes = Callable[[NDArray[Any]], NDArray[Any]]


@dataclass(frozen=True)
class Format:
    """How a camera's values become the coder's.

    Attributes
    ----------
    pixels : of the coder
    channels : values of a pixel
    planes : of a picture (h, w) or (h, w, channels)
    """

    pixels: str
    channels: int
    planes: Planes


def formats() -> dict[str, Format]:
    """What can be taken, by GenICam's names (PFNC): grey of any depth keeps every bit, colours what OpenCV's cameras keep."""
    import cv2

    def by(*codes: int) -> Planes:
        def planes(picture: NDArray[Any]) -> NDArray[Any]:
            even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
            for code in codes:
                even = cv2.cvtColor(even, code)
            return even

        return planes

    found = {"Mono8": Format("gray", 1, np.ascontiguousarray)}
    found |= {f"Mono{n}": Format(f"gray{n}le", 1, np.ascontiguousarray) for n in (10, 12, 14, 16)}
    order = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}
    found |= {
        f"Bayer{first}8": Format(
            "yuv420p", 1, by(getattr(cv2, f"COLOR_Bayer{order[first]}2BGR"), cv2.COLOR_BGR2YUV_I420)
        )
        for first in BAYER
    }
    found |= {
        "RGB8": Format("yuv420p", 3, by(cv2.COLOR_RGB2YUV_I420)),
        "BGR8": Format("yuv420p", 3, by(cv2.COLOR_BGR2YUV_I420)),
        "RGBa8": Format("yuv420p", 4, by(cv2.COLOR_RGBA2YUV_I420)),
        "BGRa8": Format("yuv420p", 4, by(cv2.COLOR_BGRA2YUV_I420)),
    }
    return found


def address_of(source: str) -> tuple[list[Path], str]:
    """Producers and camera of an address.

    Parameters
    ----------
    source : as the module says

    Raises
    ------
    VideoError : a producer that is not there, or none at all
    """
    named, _, camera = source.removeprefix(PREFIX).partition("#")
    if named:
        if not Path(named).is_file():
            raise VideoError(f"{source}: no GenTL producer {named}; expected the camera vendor's file, NAME.cti")
        return [Path(named)], camera
    folders = [folder for folder in os.environ.get(PATHS, "").split(os.pathsep) if folder]
    found = sorted(path for folder in folders for path in Path(folder).glob("*.cti"))
    if not found:
        raise VideoError(
            f"{source}: no GenTL producer: {PATHS} names no folder with one; give the vendor's: {PREFIX}/.../NAME.cti"
        )
    return found, camera


class GenICamera:
    """One camera, open.

    Parameters
    ----------
    source : ``genicam:PRODUCER.cti#CAMERA``

    Attributes
    ----------
    by_source : whether it stamps its pictures
    template : the coder's stream

    Raises
    ------
    VideoError : harvesters or the producer is not there, no such camera, it gives no picture, or in a format that cannot be taken
    """

    def __init__(self, source: str) -> None:
        producers, camera = address_of(source)
        try:
            from harvesters.core import Harvester
        except ImportError:
            raise VideoError(f"{source}: needs harvesters: pip install 'towline[genicam]'") from None

        self._source = source
        self._harvester = Harvester()
        self._acquirer: Any = None
        self._coder: Coder | None = None
        try:
            for producer in producers:
                self._harvester.add_file(str(producer))
            self._harvester.update()
            self._acquirer = self._harvester.create(self._which(camera))
            self._acquirer.num_buffers = max(KEPT, self._acquirer.min_num_buffers)
            self._acquirer.start()
            self._begin()
        except VideoError:
            self.close()
            raise
        except Exception as error:  # of the producer: any of GenTL's
            self.close()
            raise VideoError(f"{source}: {_said(error)}") from None

    def _which(self, camera: str) -> int:
        there = self._harvester.device_info_list
        names = [[_of(one, name) for name in ("serial_number", "user_defined_name", "id_")] for one in there]
        told = ", ".join(next(filter(None, own), "?") for own in names) or "none"
        matching = [k for k, own in enumerate(names) if camera in own] if camera else list(range(len(there)))
        if len(matching) != 1:
            what = f"no camera {camera}" if camera else "no camera" if not there else "several cameras"
            raise VideoError(f"{self._source}: {what}; there are: {told} ({PREFIX}...#ONE of them)")
        return matching[0]

    def _begin(self) -> None:
        first = self._next(SILENT_S)
        if first is None:
            raise VideoError(f"{self._source}: gives no picture in {SILENT_S:g} s; is it waiting for a trigger?")
        name, picture, stamp_s, _ = first
        known = formats()
        if name not in known:
            raise VideoError(f"{self._source}: gives {name}; set its PixelFormat to one of {', '.join(known)}")
        self._format, self._name = known[name], name
        planes = self._format.planes(picture)
        grey = self._format.pixels.startswith("gray")
        height, width = planes.shape if grey else (planes.shape[0] * 2 // 3, planes.shape[1])  # chroma lies below
        rate = _of(self._acquirer.remote_device.node_map, "AcquisitionFrameRate")
        self._coder = Coder(width, height, self._format.pixels, float(getattr(rate, "value", 0.0) or 0.0))
        self.template = self._coder.template
        self.by_source = stamp_s is not None
        for _ in range(KEPT):  # came meanwhile, and would be stamped too late where the camera has no clock
            if self._next(AT_ONCE_S) is None:
                break
        self._heard_s = time.monotonic()

    def packets(self) -> Iterator[tuple[Any, float]]:
        """The next picture, coded, and when it was here; nothing, where none came in a while.

        Raises
        ------
        EOFError : the camera has given none for long
        VideoError : its pictures are of another kind than before
        """
        one = self._next(WAIT_S)
        if one is None:
            if time.monotonic() - self._heard_s > SILENT_S:
                raise EOFError
            return
        name, picture, stamp_s, arrived_s = one
        self._heard_s = arrived_s
        if name != self._name:
            raise VideoError(f"{self._source}: its pixel format changed from {self._name} to {name}")
        assert self._coder is not None
        for packet in self._coder.packets(self._format.planes(picture), arrived_s if stamp_s is None else stamp_s):
            yield packet, arrived_s

    def _next(self, wait_s: float) -> tuple[str, NDArray[Any], float | None, float] | None:
        """Pixel format, values, the camera's stamp and the arrival of the next whole picture; None: none came."""
        from genicam.gentl import TimeoutException

        try:
            buffer = self._acquirer.fetch(timeout=wait_s)
        except TimeoutException:
            return None
        arrived_s = time.monotonic()
        with buffer:
            part = buffer.payload.components[0]
            pixels = part.height * part.width
            shape = (part.height, part.width) if part.data.size == pixels else (part.height, part.width, -1)
            stamp_ns = _of(buffer, "timestamp_ns")
            stamp_s = NS * stamp_ns if stamp_ns else None
            return part.data_format, part.data.reshape(shape).copy(), stamp_s, arrived_s

    def close(self) -> None:
        """Let the camera go."""
        if self._acquirer is not None:
            self._acquirer.destroy()
        self._harvester.reset()
        if self._coder is not None:
            self._coder.close()


def _of(thing: Any, name: str) -> Any:
    """What a device says of itself; None: it says nothing of that."""
    try:
        return getattr(thing, name)
    except Exception:  # GenTL has an exception for each reason
        return None


def _said(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


__all__ = ["PREFIX", "GenICamera", "address_of", "formats"]
