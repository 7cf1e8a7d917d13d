"""What comes is written as it comes, whole: into a container that a power cut ends but does not spoil.

H.264 and its like go into an MPEG transport stream, in which every packet stands by itself; all else into Matroska without an
index, whose clusters are complete four times a second. Nothing is coded anew.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from ..record.errors import VideoError
from ..record.files import name_on_disk
from ..vision.recording.clock import ON_ARRIVAL, STAMPED
from .clock import OneClock, Times
from .pieces import ARRIVAL_BASE, Ended, Opened, Packet, Piece

TRANSPORT = ("h264", "hevc", "mpeg4", "mpeg2video", "mpeg1video")
"""Codecs, by ffmpeg's names, that a transport stream carries; its packets are whole by themselves."""
SUFFIXES = {True: ".ts", False: ".mkv"}
"""Of the recording, in a transport stream or not."""
FILM = "film"
"""What a recording is called before its suffix, where one camera films."""
START_CODES = b"\0\0\1", b"\0\0\0\1"
"""How units begin in a transport stream (H.264, annex B)."""
SAFE_S = 0.25
"""The file is put on the disk so often. A power cut costs this, what the container holds back (``CLUSTER_MS``), and a picture: a
second of film is what it may cost."""
MATROSKA_TICKS = 90
"""Of ``ARRIVAL_BASE`` in a millisecond, which is what Matroska counts in."""
CLUSTER_MS = "250"
"""Length of Matroska's clusters: what is written at once."""


class _Disk:
    """A file that is only written to, and put on the disk now and then."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._safe_s = time.monotonic()
        name_on_disk(path)

    def write(self, data: bytes) -> int:
        """Write bytes."""
        written = self._file.write(data)
        if time.monotonic() - self._safe_s > SAFE_S:
            self.sync()
        return written

    def sync(self) -> None:
        """All that was written is on the disk."""
        os.fsync(self._file.fileno())
        self._safe_s = time.monotonic()

    def close(self) -> None:
        """Put the rest on the disk."""
        self.sync()
        self._file.close()


class Recorder:
    """Writes one source's pieces into a folder.

    Parameters
    ----------
    folder : of the run; the file is named when the source has answered
    stem : of its name

    Attributes
    ----------
    name : of the file; "" until then
    packets : written so far
    clock : puts their stamps on one clock
    """

    def __init__(self, folder: Path, stem: str = FILM) -> None:
        self._folder, self._stem = folder, stem
        self._container: Any = None
        self._stream: Any = None
        self._disk: _Disk | None = None
        self._codec, self._extradata = "", b""
        self.name = ""
        self.packets = 0
        self.clock = OneClock()

    def take(self, piece: Piece) -> Times | None:
        """Write a piece; a packet's times on the recording's clock."""
        if isinstance(piece, Opened):
            self._open(piece)
        elif isinstance(piece, Packet):
            return self._write(piece)
        elif isinstance(piece, Ended):
            self.close()
        return None

    def name_for(self, opened: Opened) -> str:
        """How the recording of such a source is called."""
        return self._stem + SUFFIXES[opened.codec in TRANSPORT]

    def _open(self, opened: Opened) -> None:
        import av

        if self._container is not None:
            if opened.codec != self._codec:
                raise VideoError(
                    f"the source came back as {opened.codec}, it was {self._codec}: that is another recording"
                )
            self.clock.opened_again()
            return
        transport, self._codec = opened.codec in TRANSPORT, opened.codec
        self.name = self.name_for(opened)
        self.clock.least_ticks = 1 if transport else MATROSKA_TICKS
        self._disk = _Disk(self._folder / self.name)
        options = {"flush_packets": "1"} if transport else {"cluster_time_limit": CLUSTER_MS, "flush_packets": "1"}
        form = "mpegts" if transport else "matroska"
        self._extradata = opened.extradata or b"" if transport else b""
        self._container = av.open(self._disk, "w", format=form, options=options)
        self._stream = self._container.add_stream_from_template(opened.template, opaque=True)
        self._stream.time_base = ARRIVAL_BASE
        if not opened.by_source:
            self._container.metadata[STAMPED] = ON_ARRIVAL

    def _write(self, packet: Packet) -> Times:
        import av

        times = self.clock.step(packet)
        coded = av.Packet(self._head_of(packet) + packet.data)
        coded.pts, coded.dts, coded.time_base = times.pts, times.dts, ARRIVAL_BASE
        coded.is_keyframe, coded.stream = packet.key, self._stream
        self._container.mux(coded)
        self.packets += 1
        return times

    def _head_of(self, packet: Packet) -> bytes:
        """What a decoder must know and the packets do not say, as of RTSP, which says it once, apart: before every key frame."""
        known = packet.key and self._extradata.startswith(START_CODES) and self._extradata not in packet.data
        return self._extradata if known else b""

    def close(self) -> None:
        """End the recording."""
        container, self._container = self._container, None
        if container is not None:
            container.close()
        disk, self._disk = self._disk, None
        if disk is not None:
            disk.close()


__all__ = ["FILM", "Recorder"]
