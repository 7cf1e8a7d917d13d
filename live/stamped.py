"""A frame with both of its times: the source's own, and when its last byte was here."""

from __future__ import annotations

from dataclasses import dataclass

from ..vision.recording import Frame


@dataclass(frozen=True)
class Stamped:
    """A frame as it came.

    Attributes
    ----------
    frame : its ``t_s`` is the source's stamp, from the first frame on
    arrived_s : when its last byte was here, by this machine's clock that never steps (``time.monotonic``)
    by_source : the source stamps its frames; false: ``t_s`` is the arrival
    """

    frame: Frame
    arrived_s: float
    by_source: bool = True


__all__ = ["Stamped"]
