"""Coded pictures as they come -> frames, at once: no picture is waited for that may come later."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..vision.recording.decode import Frame
from ..vision.recording.luma import luma, white_dn
from .pieces import Opened, Packet
from .stamped import Stamped

_KEPT = 64
"""Packets whose times are kept for pictures that have not come out: more than any decoder holds."""


class Decoding:
    """Decodes one source.

    Parameters
    ----------
    opened : what the source said of itself

    Attributes
    ----------
    damaged : packets that could not be decoded
    """

    def __init__(self, opened: Opened) -> None:
        self.codec, self._by_source = opened.codec, opened.by_source
        self._decoder = _decoder(opened)
        self._times: dict[int, tuple[float, float]] = {}
        self._count = self.damaged = 0
        self._spoiled = True

    def again(self, opened: Opened) -> None:
        """The source was opened anew; frames are counted on."""
        self._decoder, self._spoiled = _decoder(opened), True
        self._times.clear()

    def step(self, packet: Packet, t_s: float) -> Iterator[Stamped]:
        """Take a packet; the frames that are out with it.

        Parameters
        ----------
        packet : the next one
        t_s : its time on the recording's clock (``clock.OneClock``)
        """
        import av
        import av.error

        coded = av.Packet(packet.data)
        # the number stands in for the stamp, which the decoder hands through
        coded.pts = coded.dts = number = self._count
        self._count += 1
        self._times[number] = packet.arrived_s, t_s
        if packet.corrupt:
            self._spoiled = True
        try:
            frames = self._decoder.decode(coded)
        except av.error.FFmpegError:
            self.damaged += 1
            self._spoiled = True
            return
        for raw in frames:
            yield self._stamped(raw)

    def _stamped(self, raw: Any) -> Stamped:
        number = raw.pts
        arrived_s, t_s = self._times.pop(number)
        for old in [n for n in self._times if n < number - _KEPT]:
            del self._times[old]
        if raw.key_frame:
            self._spoiled = False
        damaged = self._spoiled or raw.is_corrupt
        if raw.is_corrupt:
            self._spoiled = True
        frame = Frame(number, t_s, luma(raw), raw, damaged, white_dn(raw), on_arrival=not self._by_source)
        return Stamped(frame, arrived_s)


def _decoder(opened: Opened) -> Any:
    import av

    decoder: Any = av.CodecContext.create(opened.codec, "r")
    if opened.extradata:
        decoder.extradata = opened.extradata
    decoder.width, decoder.height = opened.size_px
    decoder.options = {"err_detect": "crccheck", "flags": "low_delay"}
    decoder.thread_type, decoder.thread_count = "NONE", 1  # threads hold frames back
    return decoder


__all__ = ["Decoding"]
