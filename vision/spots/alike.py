"""A mark that seems wider than its fellows at first sight: looked at again as one like them.

Marks of one kind look alike. One that stands on the corner of its plate, half on a puck, or beside a line is at first taken for it
and for some of that: too wide, beside its place, and pulled by what is taken for an uneven ground. As narrow as its fellows it
either fits the pixels about its middle as well, and then that is what it is, or it does not: then it is another kind of mark.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .candidates import Array
from .model import expected
from .refine import LADDER, LEAST_SURE_PX, Refined, Refiner
from .stack import Stack

WIDER = 1.2
"""A mark wider than its narrowest fellow by less than this factor is like it."""
MOSTLY = 0.8
"""Of the frames in which a mark must be found as one like its fellow: a choice."""
MIDDLE_WIDTHS = 2.0
"""A mark's middle ends here, in widths: where a Gaussian has fallen to an eighth, what lies beside the mark has more to say."""
LEAST_MIDDLE_PX = 2.1
"""... or at this radius: 13 pixels."""
AS_WELL = 1.25
"""What is left over about its middle is at most this many times what the wider mark leaves there, or what its fellow leaves about
its own: of 8 frames with 9 degrees of freedom each (13 pixels less ground, height and place) the ratio has a standard deviation of
0.24."""
EXCUSED = 2.0
"""What the fellow leaves counts up to this many times what the wider mark leaves: a fellow that stands on a dark bar leaves so much
that it would excuse anything. A choice: marks on the corners of their plates need 1.1 at most."""
Seen = tuple[Refiner, Stack, Refined]
"""A mark's first stretch: what was learnt of it, its windows, what was found."""


def like_their_fellows(seen: Mapping[int, Seen]) -> dict[int, tuple[Refiner, Refined]]:
    """Marks of one kind that are better taken for narrower ones, and what they are then.

    Parameters
    ----------
    seen : by the mark's number, each in the first stretch in which it is followed
    """
    usable = {i: one for i, one in seen.items() if one[0].usual is not None and not one[0].model.reflects}
    if not usable:
        return {}
    narrowest = min(usable, key=lambda i: usable[i][0].width_px)
    known, of_known, found = usable[narrowest]
    usual = np.nanmedian(_left_over(known, of_known, found, found.fit.centre_px, _middle_px(known)))
    answer: dict[int, tuple[Refiner, Refined]] = {}
    for index, (refiner, stack, before) in seen.items():
        if index == narrowest or refiner.width_px < WIDER * known.width_px:
            continue
        trial = Refiner.taught_by(known)
        again = trial.refine(stack)
        sure = again.fit.good & (again.fit.sigma_px.max(axis=1) <= LEAST_SURE_PX)
        if sure.mean() < MOSTLY:
            continue
        middle, reach = again.fit.centre_px, _middle_px(known)
        one, other = (_left_over(r, stack, found, middle, reach) for r, found in ((trial, again), (refiner, before)))
        both = sure & np.isfinite(one) & np.isfinite(other)
        if not both.any():
            continue
        wider = float(np.median(other[both]))
        if np.median(one[both]) <= AS_WELL * max(wider, min(usual, EXCUSED * wider)):
            answer[index] = trial, again
    return answer


def _middle_px(known: Refiner) -> float:
    """Radius of a mark's middle."""
    return max(MIDDLE_WIDTHS * known.width_px, LEAST_MIDDLE_PX)


def _left_over(refiner: Refiner, stack: Stack, found: Refined, middle: Array, reach: float) -> Array:
    """(b,) variance about the fits of the grey values within ``reach`` px of ``middle (b, 2)``; NaN where none was fitted."""
    answer = np.full(len(stack), np.nan)
    for model in LADDER:
        rows = np.flatnonzero((found.step == model.name) & found.fit.good)
        if not len(rows):
            continue
        some = stack.rows(rows)
        values, corner = some.cut(some.start_px, refiner.radius(model))
        gap = values - expected(found.fit.theta[rows], corner, values.shape[2])[0]
        axis = np.arange(values.shape[2])
        du, dv = (axis[None] + corner[:, k, None] - middle[rows, k, None] for k in (0, 1))
        inside = (np.hypot(du[:, None, :], dv[:, :, None]) < reach) & np.isfinite(gap)
        freedom = np.maximum(inside.sum(axis=(1, 2)) - len(model.free), 1)
        answer[rows] = np.where(inside, gap**2, 0.0).sum(axis=(1, 2)) / freedom
    return answer
