"""A frame with both of its times: the source's own, and when its last byte was here."""

from __future__ import annotations

from dataclasses import dataclass

from ..vision.recording import Frame


@dataclass(frozen=True)
class Stamped:
    """A frame as it came.

    Attributes
    ----------
    frame : its ``t_s`` is the source's stamp, from the first frame on, or the arrival where the source stamps nothing
    arrived_s : when its last byte was here, by this machine's clock that never steps (``time.monotonic``)
    """

    frame: Frame
    arrived_s: float

    @property
    def by_source(self) -> bool:
        """The source stamps its frames."""
        return not self.frame.on_arrival


__all__ = ["Stamped"]
