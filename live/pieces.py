"""What a source gives, piece by piece: its answer, its packets, its end."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

ARRIVAL_BASE = Fraction(1, 90_000)
"""Ticks of stamps that are made here, on arrival: MPEG's."""


@dataclass(frozen=True)
class Opened:
    """A source answered.

    Attributes
    ----------
    codec : by ffmpeg's name
    template : its stream, for the recording (``add_stream_from_template``); valid while the source is open
    by_source : it stamps its frames
    again : it had been open before
    size_px : (width, height)
    extradata : what the decoder must know before the first packet; None: it stands in the packets
    """

    codec: str
    template: Any
    by_source: bool
    again: bool
    size_px: tuple[int, int]
    extradata: bytes | None


@dataclass(frozen=True)
class Packet:
    """One coded picture.

    Attributes
    ----------
    data : its bytes
    pts, dts : in ``base``; None where it has none
    key : nothing before it is needed to decode it
    corrupt : the way here damaged it, as far as the container can tell
    arrived_s : ``time.monotonic`` when its last byte was here
    """

    data: bytes
    pts: int | None
    dts: int | None
    base: Fraction
    key: bool
    corrupt: bool
    arrived_s: float


@dataclass(frozen=True)
class Ended:
    """Nothing more comes: ``error`` says why, where that is no ordinary end."""

    error: str = ""


def opened_of(stream: Any, by_source: bool, again: bool = False) -> Opened:
    """What is to be said of an open container's stream; the arguments as in ``Opened``."""
    context = stream.codec_context
    return Opened(context.name, stream, by_source, again, (context.width, context.height), context.extradata)


Piece = Opened | Packet | Ended

__all__ = ["ARRIVAL_BASE", "Ended", "Opened", "Packet", "Piece", "opened_of"]
