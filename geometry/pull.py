"""How a mark is pulled by what stands beside it: errors that turn with the model and with its line, shared by the runs of a camera.

A light makes its surroundings bright: the deck glows, a rail, a wet hull or the bar of the tow line mirrors it. Where such a
reflection cannot be told from the mark, the mark is found off its place towards it. As long as nothing turns, the shift is the same
in every frame and looks like a mark that stands elsewhere. When the model yaws, or the line swings, the reflection wanders along
what mirrors it, and the shift with it. How far is a number for nobody; that it goes with the two angles is known:

    shift = a beta + b (alpha + beta),        a and b (2,) px a radian, of each mark

The heading turns the hull under the camera and the lamps, alpha + beta the line against the hull. a and b are common modes, as a
camera's errors are, and the fit of the derivatives finds what there is of them.
"""

from __future__ import annotations

import numpy as np

from .camera import Array
from .local_fit import local_fit

PULL_PX_RAD = 0.4
"""Usual size of a and b (standard deviation), px a radian: glow and deck texture move a light by 0.01-0.03 px while a tow swings
by some 0.05 rad. A choice."""


AROUND_S, WITHOUT_S, PARABOLA = 1.0, 0.2, 2
"""The angles are parabolas through what lies so long before and after, without what lies nearer than the second: an angle that held
the noise of its own frame would explain that noise by a pull, the more frames the surer. A mean instead of a parabola loses half
of a swing of 4 s, and where the marks come into view or go stands 0.6 s aside."""


def pull_modes(t_s: Array, beta_rad: Array, alpha_rad: Array, marks: int) -> Array:
    """Change of the marks' pixels (k, n, m, 2) with each mode of unit variance; angles that do not exist make no mode.

    Parameters
    ----------
    t_s : (n,) times, rising
    beta_rad : (n,) heading, NaN where not measured
    alpha_rad : (n,) angle of the line, NaN where there is no line or it was not measured
    marks : how many, m

    Examples
    --------
    >>> pull_modes(np.array([0.0, 1.0]), np.array([0.0, 0.1]), np.array([np.nan, np.nan]), 2).shape
    (4, 2, 2, 2)
    """
    courses = [_around(t_s, angle) for angle in (beta_rad, alpha_rad + beta_rad) if np.isfinite(angle).any()]
    modes = np.zeros((len(courses), marks, 2, len(beta_rad), marks, 2))
    for course, angle in enumerate(courses):
        for mark in range(marks):
            for axis in (0, 1):
                modes[course, mark, axis, :, mark, axis] = PULL_PX_RAD * angle
    return modes.reshape(-1, len(beta_rad), marks, 2)


def _around(t_s: Array, angle_rad: Array) -> Array:
    """(n,) the angle at each time by a parabola through the frames about it, without its own and the nearest; its own where those
    are too few.
    """
    seen = np.isfinite(angle_rad)
    found, told = local_fit(t_s[seen], angle_rad[seen, None], t_s, AROUND_S, PARABOLA, WITHOUT_S)
    return np.where(told, found[:, 0, 0], np.nan_to_num(angle_rad))


__all__ = ["PULL_PX_RAD", "pull_modes"]
