"""What the bundle is made of: one run's frames, the rig as stated, faults that are no number of the rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..camera import Array, Lens


def half_sine(t_s: Array, begin_s: Array | float, end_s: Array | float) -> Array:
    """The usual course of a line that goes slack and tautens again: 0 outside, 1 in the middle."""
    share = (t_s - begin_s) / (end_s - begin_s)
    return np.where((share > 0) & (share < 1), np.sin(np.pi * np.clip(share, 0, 1)), 0.0)


@dataclass(frozen=True)
class Film:
    """One run's frames.

    Attributes
    ----------
    t_s : (n,)
    pixel_px, sigma_px : (n, m, 2); NaN where a mark is lost
    line_m : line length, or None: no taut line (free, forced, post not still)
    tow_point_m : (X_T, Y_T)
    post_m : (2,)
    """

    t_s: Array
    pixel_px: Array
    sigma_px: Array
    line_m: float | None
    tow_point_m: Array
    post_m: Array

    def only(self, kept: slice) -> Film:
        """With some of its frames."""
        return replace(self, t_s=self.t_s[kept], pixel_px=self.pixel_px[kept], sigma_px=self.sigma_px[kept])


@dataclass(frozen=True)
class Rig:
    """What was filmed and what is stated of it.

    Attributes
    ----------
    lens, skew, rotation, translation : camera; skew in px
    datum_px, datum_m, datum_sigma_px : (k, 2), (k, 3), (k,)
    body_m, depth_m : (m, 2), (m,)
    """

    lens: Lens
    skew: float
    rotation: Array
    translation: Array
    datum_px: Array
    datum_m: Array
    datum_sigma_px: Array
    body_m: Array
    depth_m: Array


@dataclass(frozen=True)
class Extra:
    """A fault that is no number of the rig: a badly picked datum point, a camera turned mid-run, a slack line.

    Attributes
    ----------
    kind : "point" (2 numbers, px), "turn" (3, rad), "slack" (1, m)
    index : datum point, or run
    span_s : turn: (first time after it, inf); slack: its begin and end
    """

    kind: str
    index: int
    span_s: tuple[float, float] = (0.0, 0.0)

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return {"point": 2, "turn": 3, "slack": 1}[self.kind]

    def shape(self, t_s: Array) -> Array:
        """Its course over time, (n,): a step, or half a sine."""
        begin, end = self.span_s
        if self.kind == "turn":
            return (t_s >= begin).astype(float)
        return half_sine(t_s, begin, end)


__all__ = ["Extra", "Film", "Rig", "half_sine"]
