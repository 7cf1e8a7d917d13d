"""One clock for a recording whose source is cut, comes back, and may count anew: stamps that only rise."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from .pieces import ARRIVAL_BASE, Packet

AGREE_S = 1.0
"""Across a gap the source's clock is believed when it went on as this machine's did, to so much; else it has begun anew."""


@dataclass(frozen=True)
class Times:
    """A packet's stamps on the recording's clock, in ticks of ``ARRIVAL_BASE``."""

    pts: int
    dts: int

    @property
    def t_s(self) -> float:
        """Presentation time, s."""
        return float(self.pts * ARRIVAL_BASE)


class OneClock:
    """Puts the stamps of a source on one clock, from 0.

    The source's own steps are kept, whatever they are; only where its clock falls, or stands elsewhere when it was opened anew,
    is what it says shifted: by so much that the gap is as long as it was here.

    Parameters
    ----------
    least_ticks : two frames are at least so far apart: what the recording's container can tell

    Attributes
    ----------
    begun_anew : so often was the clock shifted
    """

    def __init__(self, least_ticks: int = 1) -> None:
        self.least_ticks = least_ticks
        self._shift: int | None = None
        self._last: tuple[int, float] | None = None
        self._opened = False
        self.begun_anew = 0

    def opened_again(self) -> None:
        """The source was opened anew."""
        self._opened = True

    def step(self, packet: Packet) -> Times:
        """Stamps of the next packet; one without any gets its arrival."""
        stamp = packet.dts if packet.dts is not None else packet.pts
        dts = round(packet.arrived_s / ARRIVAL_BASE) if stamp is None else _ticks(stamp, packet.base)
        pts = dts if packet.pts is None else _ticks(packet.pts, packet.base)
        if self._shift is None:
            self._shift = -min(dts, pts)
        if self._last is not None:
            went, waited = dts + self._shift - self._last[0], packet.arrived_s - self._last[1]
            apart_s = abs(float(went * ARRIVAL_BASE) - waited)
            if went <= 0 or (self._opened and apart_s > AGREE_S):
                self._shift += max(round(waited / ARRIVAL_BASE), 1) - went
                self.begun_anew += 1
        self._opened = False
        now = dts + self._shift
        if self._last is not None:
            now = max(now, self._last[0] + self.least_ticks)
        self._last = now, packet.arrived_s
        return Times(pts - dts + now, now)


def _ticks(stamp: int, base: Fraction) -> int:
    return round(stamp * base / ARRIVAL_BASE)


__all__ = ["OneClock", "Times"]
