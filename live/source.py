"""Where frames come from while a tow is filmed: a file at its own rate, a stream of the network, any camera. One thread hears each.

What comes is put into a queue as it came, coded; whoever takes it decodes it. The thread that hears never waits for the one that
looks, so that nothing is lost here because the other is slow.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

from ..record.errors import VideoError
from .camera import Camera
from .clock import Times
from .genicam import PREFIX, GenICamera
from .pieces import ARRIVAL_BASE, Ended, Packet, Piece, opened_of

Kind = Literal["file", "stream", "camera", "genicam"]
OPEN_S = 10.0
"""How long a source may take to answer."""
SILENT_S = 2.0
"""A stream that says nothing for so long is opened anew: what comes then is taken up at once."""
AGAIN_S = 0.2
"""Between two tries to open it."""
PROBE_BYTES, PROBE_US = "1000000", "500000"
"""Of a stream that are read to learn what it is, at most; they are handed on, nothing of them is lost."""
UDP_BUFFER_BYTES = 1 << 23
"""What the system and the reader keep of a UDP stream that is not fetched at once: some seconds of 720p."""
TRANSPORT_BYTES = 188
"""Of a packet of MPEG's transport stream, in which the reader counts."""
UNSTAMPED = ("mpjpeg", "mjpeg")
"""Formats, by ffmpeg's names, whose pictures carry no time: they are stamped on arrival."""


Heard = Callable[[Piece], Times | None]
"""Takes a piece; a packet's times on the recording's clock."""


def kind_of(source: str) -> Kind:
    """What a source is, by how it is written: an index or a device, an address, or else a file.

    Examples
    --------
    >>> kind_of("0"), kind_of("udp://127.0.0.1:5000"), kind_of("tow.mp4"), kind_of("genicam:#4711")
    ('camera', 'stream', 'file', 'genicam')
    """
    if source.startswith(PREFIX):
        return "genicam"
    if source.isdecimal() or source.startswith("/dev/"):
        return "camera"
    return "stream" if "://" in source else "file"


class Hearing:
    """Hears one source in a thread of its own.

    Parameters
    ----------
    source : as typed
    kept : called in that thread with every piece before anybody else has it: the recording, which gives packets their times
    came : set with every piece, for who listens to several; None: nobody does

    Attributes
    ----------
    pieces : what came, in its order, and a packet's times
    """

    def __init__(self, source: str, kept: Heard, came: threading.Event | None = None) -> None:
        self.source, self._kept, self._came = source, kept, came
        self.pieces: queue.SimpleQueue[tuple[Piece, Times | None]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._hear, name="live source", daemon=True)

    def start(self) -> None:
        """Begin to hear."""
        self._thread.start()

    def stop(self) -> None:
        """Hear no more; the last piece is ``Ended``."""
        self._stop.set()

    def join(self) -> None:
        """Wait until the source is closed."""
        self._thread.join()

    def _hear(self) -> None:
        error = ""
        try:
            for piece in _HEARD_BY[kind_of(self.source)](self.source, self._stop):
                self._say(piece)
        except Exception as fault:  # of any library, in a thread: whoever listens must know
            error = str(fault) or type(fault).__name__
        try:
            self._say(Ended(error))
        except Exception as fault:  # of the recording
            self._put(Ended(error or str(fault)), None)

    def _say(self, piece: Piece) -> None:
        self._put(piece, self._kept(piece))

    def _put(self, piece: Piece, times: Times | None) -> None:
        self.pieces.put((piece, times))
        if self._came is not None:
            self._came.set()


def _file(source: str, stop: threading.Event) -> Iterator[Piece]:
    """A video file's packets, each when it is time for it."""
    from ..vision.recording.decode import opened

    with opened(Path(source)) as container:
        video = container.streams.video[0]
        yield opened_of(video, True)
        began, first_s = time.monotonic(), None
        for packet in container.demux(video):
            if not packet.size:
                continue
            stamp = packet.dts if packet.dts is not None else packet.pts
            if stamp is not None:
                due_s = float(stamp * packet.time_base)
                first_s = due_s if first_s is None else first_s
                if stop.wait(max(began + due_s - first_s - time.monotonic(), 0.0)):
                    return
            yield _piece(packet, time.monotonic())


def _stream(source: str, stop: threading.Event) -> Iterator[Piece]:
    """Packets of an address, which is opened anew whenever it has ended or gone silent."""
    import av.error

    again, began = False, time.monotonic()
    while not stop.is_set():
        try:
            with _answering(source) as container:
                video = container.streams.video[0]
                by_source = container.format.name not in UNSTAMPED
                yield opened_of(video, by_source, again)
                again = True
                for packet in container.demux(video):
                    if stop.is_set():
                        return
                    if packet.size:
                        yield _piece(packet, time.monotonic(), by_source)
        except (av.error.FFmpegError, OSError) as error:
            if not again and time.monotonic() - began > OPEN_S:
                raise VideoError(f"{source}: does not answer ({str(error).splitlines()[0]})") from None
        stop.wait(AGAIN_S)


def _answering(source: str) -> Any:
    """The source, open; RTSP by TCP, on which nothing is lost, and by UDP where the server has no other."""
    import av.error

    options = {"probesize": PROBE_BYTES, "analyzeduration": PROBE_US}
    if source.startswith("udp:"):
        fifo = UDP_BUFFER_BYTES // TRANSPORT_BYTES
        options |= {"buffer_size": str(UDP_BUFFER_BYTES), "fifo_size": str(fifo), "overrun_nonfatal": "1"}
    if not source.startswith("rtsp:"):
        return _with_video(source, options)
    try:
        return _with_video(source, {**options, "rtsp_transport": "tcp"})
    except av.error.FFmpegError:
        return _with_video(source, {**options, "rtsp_transport": "udp"})


def _with_video(source: str, options: dict[str, str]) -> Any:
    import av

    container = av.open(source, options=options, timeout=(OPEN_S, SILENT_S), metadata_errors="replace")
    if not container.streams.video:
        container.close()
        raise VideoError(f"{source}: holds no video stream")
    if not container.streams.video[0].codec_context.width:  # joined between two key frames
        container.close()
        raise TimeoutError("no key frame yet")
    return container


def camera_pieces(source: str, stop: threading.Event) -> Iterator[Piece]:
    """A camera's pictures, coded here without loss.

    Parameters
    ----------
    source : its index or device, or its address by GenICam
    stop : set: no more are wanted

    Raises
    ------
    VideoError : it does not open, or gives no picture
    """
    camera = GenICamera(source) if kind_of(source) == "genicam" else Camera(source)
    try:
        yield opened_of(camera.template, camera.by_source)
        while not stop.is_set():
            for packet, arrived_s in camera.packets():
                yield _piece(packet, arrived_s)
    except EOFError:
        return
    finally:
        camera.close()


def _piece(packet: Any, arrived_s: float, by_source: bool = True) -> Packet:
    data, key, corrupt = bytes(packet), bool(packet.is_keyframe), bool(packet.is_corrupt)
    if not by_source:
        ticks = round(arrived_s / ARRIVAL_BASE)
        return Packet(data, ticks, ticks, ARRIVAL_BASE, key, corrupt, arrived_s)
    return Packet(data, packet.pts, packet.dts, Fraction(packet.time_base), key, corrupt, arrived_s)


_HEARD_BY: dict[Kind, Callable[[str, threading.Event], Iterator[Piece]]] = {
    "file": _file,
    "stream": _stream,
    "camera": camera_pieces,
    "genicam": camera_pieces,
}

__all__ = ["Hearing", "camera_pieces", "kind_of"]
