"""Residuals of many runs at a glance: a strip each, drawn by hand in a thousandth of the time of a whole figure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .draw import BLUE, ORANGE, SHADE, drawn
from .html import Html, image
from .series import Array, Residuals

WIDTH, LANE, GAP = 420, 30, 4
"""Pixels: of the strip, of a channel's lane, between the lanes."""
COLUMNS = 210
"""Stretches of a strip: what a strip's width shows."""
REACH = 5.0
"""Sigmas from the middle of a lane to its edge."""


def residual_strip(rest: Residuals) -> Html:
    """Measured minus fitted over the stated sigma against time, y above and beta below: least and largest of each stretch."""
    times, of = _stretches(rest.t_s)
    lanes: list[str] = []
    columns: dict[str, ArrayLike] = {"t_s": times}
    for k, (name, values, colour) in enumerate(
        (("y", rest.y_m / rest.sigma_y_m, BLUE), ("beta", rest.beta_rad / rest.sigma_beta_rad, ORANGE))
    ):
        low, high = _ends(values, of, len(times))
        columns |= {f"{name}_least_sigma": low, f"{name}_largest_sigma": high}
        lanes.append(_lane(k * (LANE + GAP), times, low, high, colour))
    height = 2 * LANE + GAP
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}">'
        f"{''.join(lanes)}</svg>"
    )
    words = "residuals of y and beta over their sigma, least and largest of each stretch"
    return image(svg.encode("ascii"), "image/svg+xml", words, (drawn(words, "strip", {"": columns}),))


def _stretches(t_s: Array) -> tuple[Array, NDArray[np.int_]]:
    """Middle of each of ``COLUMNS`` stretches of equal length that hold samples, and each sample's stretch."""
    span = max(float(t_s[-1] - t_s[0]), 1e-12)
    place = np.minimum(((t_s - t_s[0]) / span * COLUMNS).astype(int), COLUMNS - 1)
    held, of = np.unique(place, return_inverse=True)
    return t_s[0] + (held + 0.5) * span / COLUMNS, of


def _ends(values: Array, of: NDArray[np.int_], count: int) -> tuple[Array, Array]:
    """Least and largest finite value of each stretch, NaN where there is none."""
    known = np.isfinite(values)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, of[known], values[known])
    np.maximum.at(high, of[known], values[known])
    return np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan)


def _lane(top: float, times: Array, low: Array, high: Array, colour: str) -> str:
    middle, scale = top + LANE / 2, LANE / 2 / REACH
    good = np.isfinite(low)
    span = max(float(times[-1] - times[0]), 1e-12)
    x = np.round((times[good] - times[0]) / span * (WIDTH - 2) + 1, 1)
    ends = np.round(middle - scale * np.clip([high[good], low[good]], -REACH, REACH), 1)
    ends[1] = np.maximum(ends[1], ends[0] + 1)  # one value is a dot
    strokes = "".join(f"M{a:g} {b:g}V{c:g}" for a, b, c in zip(x, *ends, strict=True))
    return (
        f'<rect y="{middle - 2 * scale:g}" width="{WIDTH}" height="{4 * scale:g}" fill="{SHADE}"/>'
        f'<path d="{strokes}" stroke="{colour}" stroke-width="1.6" fill="none"/>'
    )
