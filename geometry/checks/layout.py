"""The bundle's parameter vector: which numbers it holds, by name, and where each part of it lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..camera import Array
from .filmed import Extra

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TURN = ("camera turn right", "camera turn down", "camera turn ahead")
SHIFT = ("camera shift right", "camera shift down", "camera shift ahead")
POSE = (*TURN, *SHIFT)
CAMERA = (*LENS, "skew", *POSE)
DATUM = ("deck height", "datum length", "datum width")
LINE = ("line length", "tow point", "post ahead")
RIG = (*CAMERA, *DATUM, *LINE)
MARK = ("depth", "ahead", "aside")


@dataclass(frozen=True)
class Layout:
    """Where the parts of the parameter vector lie.

    Attributes
    ----------
    names : of the rig's parameters, in the order of the vector; extras come after them
    lens, skew, turn, shift : the camera's
    camera : these four together
    deck_height, datum_length, datum_width : the datum's
    line_length, tow_point, post_ahead : the line's
    depth, ahead, aside : the marks', m numbers each
    extras : faults with their places
    size : p, of the whole vector
    """

    names: tuple[str, ...]
    lens: slice
    skew: int
    turn: slice
    shift: slice
    camera: slice
    deck_height: int
    datum_length: int
    datum_width: int
    line_length: int
    tow_point: int
    post_ahead: int
    depth: slice
    ahead: slice
    aside: slice
    extras: tuple[tuple[Extra, slice], ...]
    size: int

    @staticmethod
    def of(marks: int, extras: Sequence[Extra] = ()) -> Layout:
        """The layout for so many marks, and faults beside the rig."""
        names = (*RIG, *(f"{what} {mark}" for what in MARK for mark in range(marks)))
        depth, ahead, aside = (_part(names, f"{what} 0", marks) for what in MARK)
        ends = np.cumsum([len(names), *(extra.size for extra in extras)]).tolist()
        placed = tuple((extra, slice(end - extra.size, end)) for extra, end in zip(extras, ends[1:], strict=True))
        return Layout(
            names=names,
            lens=_part(names, LENS[0], len(LENS)),
            skew=names.index("skew"),
            turn=_part(names, TURN[0], len(TURN)),
            shift=_part(names, SHIFT[0], len(SHIFT)),
            camera=_part(names, CAMERA[0], len(CAMERA)),
            deck_height=names.index("deck height"),
            datum_length=names.index("datum length"),
            datum_width=names.index("datum width"),
            line_length=names.index("line length"),
            tow_point=names.index("tow point"),
            post_ahead=names.index("post ahead"),
            depth=depth,
            ahead=ahead,
            aside=aside,
            extras=placed,
            size=ends[-1],
        )

    def extras_of(self, kind: str, index: int | None = None) -> list[tuple[Extra, slice]]:
        """Faults of a kind (those of one run only, where ``index`` is given) with their places."""
        return [(e, at) for e, at in self.extras if e.kind == kind and index in (None, e.index)]

    def columns(self, *parts: tuple[slice | int, Array]) -> Array:
        """Slopes (..., p) by the whole vector from those by some of its parts; 0 by all others.

        Parameters
        ----------
        parts : place, and slopes (..., k) by the k numbers there, or (...) by the one number there
        """
        first, slopes = parts[0]
        shape = slopes.shape if isinstance(first, int) else slopes.shape[:-1]
        whole = np.zeros((*shape, self.size))
        for place, values in parts:
            whole[..., place] = values
        return whole


def _part(names: Sequence[str], first: str, count: int) -> slice:
    begin = names.index(first)
    return slice(begin, begin + count)


__all__ = ["CAMERA", "POSE", "Layout"]
