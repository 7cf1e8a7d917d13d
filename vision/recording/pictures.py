"""Packets -> pictures, each with its own timestamp, its true number, and whether it can be trusted.

Every packet gets a number on its way into the decoder (in place of its timestamp, which decoders hand through untouched), so that
each picture is known by the packet it came from.

ffmpeg's frame threads read a picture's marks of damage before it is decoded, if pictures are shown in another order than they are
decoded in. There a stream is first read in haste: every error ends it (`Doubt`), pictures are held back until errors of their
own would have shown, and whoever reads it begins again with one thread, which marks damage picture by picture.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import pairwise
from statistics import median
from typing import Any

from .ledger import LONGEST_STEPS, Ledger, Picture, Places
from .slices import FrameCount, holds_forbidden, length_bytes_of

INTRA_ONLY = (
    "mjpeg",
    "mjpegb",
    "prores",
    "dnxhd",
    "ffv1",
    "huffyuv",
    "ffvhuff",
    "utvideo",
    "rawvideo",
    "png",
    "dvvideo",
)
"""Every picture stands alone: damage ends with it."""
ONE_TO_ONE = (*INTRA_ONLY, "h264", "hevc", "mpeg4", "libdav1d", "av1")
"""One packet, one picture shown; elsewhere a packet may hold a picture that is never shown, and its absence says nothing."""
CONCEALS = ("h264", "mpeg4", "mpeg2video", "mpeg1video", "h263")
"""Decoders that mend damage and say so on the picture; of the others an error is asked for."""
READ_ERRORS = 50
"""Errors of the container after which nothing more is expected of it."""
FRAME_THREADS_FROM_PX = 400_000
"""Smaller pictures are decoded faster than they can be used by one thread, and at less cost."""
MOST_THREADS = 8
"""Of a decoder: a choice; each one more holds back one more picture."""
HASTE = ("h264",)
"""Decoders that report every kind of damage as an error, when asked to."""
HELD_BACK = 8
"""Pictures held back in haste. Of 600 broken copies one showed a wrong picture 5 pictures before its error, none earlier."""
_TS_DISCONT = 0x200
"""FFmpeg's AVFMT_TS_DISCONT."""
USUAL_RATE_HZ = 25
"""Of a recording that says nothing of its rate (and has no timestamps): a choice."""
LARGEST_GROWTH = 4
"""A damaged header that makes the picture this many times larger is not believed (nor its memory taken)."""


class Doubt(Exception):
    """A stream that was read in haste is damaged, or its container is."""


class Stream:
    """The pictures of an open container's first video stream, in the order they are shown.

    Parameters
    ----------
    decode_threads : None = as many as help
    damaged_at : says of a packet's place in the file, bytes, whether the container knows it to be damaged
    believe_stamps : tell by the timestamps which picture comes before which; else by their place in the file
    haste : let threads work where they hide damage, and raise Doubt at its first sign
    places : timestamps by the pictures' places

    Attributes
    ----------
    in_haste : Doubt may come
    first_stamp : smallest timestamp of a packet, final when the first picture is out; None without timestamps
    last_stamp : largest one so far
    packets : packets so far that hold a picture to be shown, decodable or not
    stopped_by : the container's last error, or None
    step_ticks : usual distance of two timestamps; 0: not known
    gaps : so many packets stand further apart than usual
    begun_again : places, in decoding order, where the container's clock begins again
    """

    def __init__(
        self,
        container: Any,
        decode_threads: int | None = None,
        damaged_at: Callable[[int | None], bool] | None = None,
        believe_stamps: bool = True,
        haste: bool = False,
        places: Places | None = None,
    ) -> None:
        self._container, self._video = container, container.streams.video[0]
        self._decoder = self._video.codec_context
        self._damaged_at = damaged_at or (lambda _: False)
        codec = self._decoder.name
        self._heads = FrameCount(self._decoder.extradata) if codec == "h264" else None
        self._has_units = codec in ("h264", "hevc")
        self._length_bytes = length_bytes_of(codec, self._decoder.extradata)
        # AVI's timestamps are the places of the packets in the file: they follow the decoding order
        shuffled = not believe_stamps or is_avi(container)
        rate, base = mean_rate(container), self._video.time_base
        self.step_ticks = float(1 / (rate * base)) if rate and base else 0.0
        # at a gap only pictures that are shown in another order are uncertain; frames that are counted have no gaps
        step = self.step_ticks if believe_stamps and self._decoder.has_b_frames else 0.0
        self._ledger = Ledger(codec in INTRA_ONLY, codec in ONE_TO_ONE, shuffled, step, places)
        self._restarts = may_begin_again(container)
        self.begun_again: list[int] = []
        self.gaps, self._before = 0, None
        self.in_haste, self._blame = _prepare(self._decoder, decode_threads, haste)
        self.first_stamp: int | None = None
        self.last_stamp: int | None = None
        self.packets = 0
        self.stopped_by: Exception | None = None

    def __iter__(self) -> Iterator[Picture]:
        return self._held_back() if self.in_haste else self._pictures()

    def _held_back(self) -> Iterator[Picture]:
        held: deque[Picture] = deque()
        for expected, picture in enumerate(self._pictures()):
            if picture.damaged or picture.index != expected:
                raise Doubt
            held.append(picture)
            if len(held) > HELD_BACK:
                yield held.popleft()
        if self.stopped_by is not None:
            raise Doubt
        yield from held

    def _pictures(self) -> Iterator[Picture]:
        import av.error

        ledger, decoder = self._ledger, self._decoder
        for packet in self._on_one_clock(self._readable()):
            picture = self._enter(packet)
            if self.in_haste and (picture.damaged or not packet.size):
                raise Doubt
            if not packet.size:
                ledger.fail(picture)
                continue
            packet.pts = picture.number
            try:
                frames = decoder.decode(packet)
            except av.error.FFmpegError:
                if self.in_haste:
                    raise Doubt from None
                # decoding frames in parallel reports an error with a later packet; there the picture's absence tells
                if self._blame:
                    ledger.fail(picture)
                continue
            for raw in frames:
                ledger.show(raw)
            yield from ledger.ready()
        try:
            for raw in decoder.decode(None):
                ledger.show(raw)
        except av.error.FFmpegError:
            if self.in_haste:
                raise Doubt from None
        ledger.end()
        yield from ledger.ready()

    def _readable(self) -> Iterator[Any]:
        """Packets in file order; a part that the container cannot make sense of is skipped."""
        import av.error

        for _ in range(READ_ERRORS):
            try:
                for packet in self._container.demux(self._video):
                    # the demuxer ends with an empty packet without time; inside a file it would end the decoder
                    if packet.size or packet.pts is not None:
                        yield packet
                return
            except av.error.FFmpegError as error:
                self.stopped_by = error

    def _on_one_clock(self, packets: Iterator[Any]) -> Iterator[Any]:
        """Packets whose times go on where the container's clock begins again: one step after the packet before."""
        if not self._restarts:
            yield from packets
            return
        step, shift, number = max(round(self.step_ticks), 1), 0, 0
        before: int | None = None
        held = next(packets, None)
        while held is not None:
            following = next(packets, None)
            stamp = held.dts
            ahead = None if following is None else following.dts
            # one that falls alone is damaged
            falls = before is not None and (ahead is None or ahead + shift < before)
            if falls and before is not None and stamp is not None and stamp + shift < before:
                shift = before + step - stamp
                self.begun_again.append(number)
            if held.dts is not None:
                held.dts += shift
                before = held.dts if before is None else max(before, held.dts)
            if held.pts is not None:
                held.pts += shift
            yield held
            held, number = following, number + 1

    def _enter(self, packet: Any) -> Picture:
        hidden = bool(packet.is_discard)
        picture = Picture(
            self._ledger.entered, packet.pts, packet.dts, hidden=hidden, key=hidden and packet.is_keyframe
        )
        if packet.dts is not None:
            apart = 0 if self._before is None else packet.dts - self._before
            self.gaps += not hidden and self.step_ticks > 0 and apart > LONGEST_STEPS * self.step_ticks
            self._before = packet.dts
        self.packets += not hidden
        if self._heads is not None and packet.size:
            head = self._heads.head(packet)
            picture.reference = head.reference
            picture.spoils = head.gap
            picture.damaged = head.gap or head.repeated
        wiped = self._has_units and holds_forbidden(packet, self._length_bytes)
        if wiped or packet.is_corrupt or self._damaged_at(packet.pos):
            picture.damaged, picture.spoils = True, picture.spoils or picture.reference
        self._ledger.enter(picture)
        stamp = picture.decode_stamp if self.by_place else picture.stamp
        if stamp is not None and not hidden:
            self.last_stamp = stamp if self.last_stamp is None else max(stamp, self.last_stamp)
            if not self._ledger.shown:
                self.first_stamp = stamp if self.first_stamp is None else min(stamp, self.first_stamp)
        return picture

    @property
    def by_place(self) -> bool:
        """Timestamps are told by a picture's place among the others, not by its own packet."""
        return self._ledger.shuffled


def _prepare(decoder: Any, decode_threads: int | None, haste: bool) -> tuple[bool, bool]:
    """Set options and threads.

    Returns
    -------
    in_haste : damage may be hidden, so that its first sign ends all
    blame : an error comes with the packet that caused it
    """
    pixels = decoder.width * decoder.height
    cores = os.cpu_count() or 1
    wanted = decode_threads or (min(cores + 1, MOST_THREADS) if pixels >= FRAME_THREADS_FROM_PX else 1)
    exact = decoder.name in INTRA_ONLY or (decoder.name == "h264" and not decoder.has_b_frames)
    in_haste = haste and not exact and wanted > 1 and decoder.name in HASTE
    by_frame = wanted > 1 and (exact or in_haste)
    mends = decoder.name in CONCEALS and not in_haste
    options = {"err_detect": "crccheck" if mends else "crccheck+explode"}
    if pixels:
        options["max_pixels"] = str(LARGEST_GROWTH * (decoder.width + 128) * (decoder.height + 128))
    decoder.options = options
    decoder.thread_type = "FRAME" if by_frame else "NONE"
    decoder.thread_count = wanted if by_frame else 1
    return in_haste, not by_frame


def mean_rate(container: Any) -> Fraction | None:
    """Pictures per second.

    An AVI states how many places it has a second; a program may leave most of them empty, and the list of its packets tells.

    Parameters
    ----------
    container : open
    """
    video = container.streams.video[0]
    base, rate = video.time_base, video.average_rate or video.guessed_rate
    if is_avi(container) and base:
        stamps = [entry.timestamp for entry in video.index_entries]
        if len(stamps) > 2:
            step = round(median(after - before for before, after in pairwise(stamps)))
            return 1 / (max(step, 1) * base)
    return Fraction(rate) if rate else None


def is_avi(container: Any) -> bool:
    """Whether the container's timestamps are the places of its packets, in decoding order."""
    return "avi" in container.format.name.split(",")


def may_begin_again(container: Any) -> bool:
    """Whether the container's clock may begin again, as where two files were put one behind the other; it states no length then."""
    return bool(container.format.flags & _TS_DISCONT)
