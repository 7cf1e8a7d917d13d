"""One mark from frame to frame: a Kalman filter's prediction, and the strongest spot near it. The fine fit comes later.

What is decided here is only where the window of the next frame is cut; whether the mark was measured is decided by the fit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .candidates import Array
from .ring import RING_WIDTHS, stands_out

SEARCH_PX = 4.0
"""A spot is looked for this far beyond three standard deviations of its prediction."""
SEARCH_LIMIT_PX = 40.0
"""A spot is never looked for farther than this, however long it was unseen; beyond, the whole frame is searched."""
COARSE_SD_PX = 0.3
"""Of the strongest pixel's place with a parabola through its neighbours."""
ACCELERATION_PX_S2 = 300.0
"""White acceleration of the filter; 0.17 px in a frame of 1/30 s, 15 px after ten frames without the mark."""
START_RATE_PX_S = 100.0
"""Standard deviation of a mark's rate when it is first seen: a model let go, or a hand that turns it."""
COAST_FRAMES = 10
"""A mark unseen for longer than this is looked for where it was, not where it would have gone."""
LEAST_RISE = 0.4
"""A spot this much lower than the mark's own, after smoothing, is not taken for a sight of it."""
NEAR_WEIGHT = 0.5
"""How much (of the mark's height) a spot at the edge of the search counts less than one at the middle."""

BRIGHTER = 1.1
"""What is brighter than the mark's own height by more than this factor counts no more than that."""
HEIGHT_MEMORY = 0.2
"""Share of a new frame in the mark's usual height: a choice, so that five frames carry it."""
LIKE = 0.75
"""A height within this factor of the usual, either way, is the mark's: others raise doubt, and lower ones are not
learnt."""


class Filter:
    """Constant velocity in both axes with one covariance (position, cross, rate)."""

    __slots__ = ("cross", "rate", "rate_u", "rate_v", "spread", "t_s", "u", "v")

    def __init__(self, place: Array, t_s: float) -> None:
        self.u, self.v, self.t_s = float(place[0]), float(place[1]), t_s
        self.rate_u = self.rate_v = 0.0
        self.spread, self.cross, self.rate = COARSE_SD_PX**2, 0.0, START_RATE_PX_S**2

    def copy(self) -> Filter:
        """An independent copy."""
        other = Filter.__new__(Filter)
        for name in self.__slots__:
            setattr(other, name, getattr(self, name))
        return other

    def predict(self, t_s: float) -> tuple[float, float, float]:
        """Place at ``t_s`` and its variance, px^2; the filter stays where it is."""
        step = t_s - self.t_s
        spread = self.spread + 2 * step * self.cross + step**2 * self.rate + ACCELERATION_PX_S2**2 * step**4 / 4
        return self.u + step * self.rate_u, self.v + step * self.rate_v, spread

    def update(self, u: float, v: float, t_s: float, variance: float = COARSE_SD_PX**2) -> None:
        """The mark was seen."""
        step = t_s - self.t_s
        pushed = ACCELERATION_PX_S2**2 * step**2
        u_0, v_0, spread = self.predict(t_s)
        cross = self.cross + step * self.rate + pushed * step / 2
        rate = self.rate + pushed
        total = spread + variance
        gain, gain_rate = spread / total, cross / total
        gap_u, gap_v = u - u_0, v - v_0
        self.u, self.v, self.t_s = u_0 + gain * gap_u, v_0 + gain * gap_v, t_s
        self.rate_u += gain_rate * gap_u
        self.rate_v += gain_rate * gap_v
        self.spread, self.cross, self.rate = (1 - gain) * spread, (1 - gain) * cross, rate - gain_rate * cross

    def began(self, place: Array, t_s: float) -> None:
        """The mark was seen a second time: its rate is what lies between."""
        step = t_s - self.t_s
        self.rate_u, self.rate_v = (float(place[0]) - self.u) / step, (float(place[1]) - self.v) / step
        self.rate = 2 * COARSE_SD_PX**2 / step**2 + ACCELERATION_PX_S2**2 * step**2
        self.cross = 0.0

    def stop(self) -> None:
        """Forget the rate: the mark was away for long."""
        self.rate_u = self.rate_v = 0.0
        self.cross, self.rate = 0.0, START_RATE_PX_S**2


class LiveMark:
    """Where one mark is looked for next."""

    def __init__(self, place: Array, t_s: float, width_px: float, rise_dn: float, dark: bool) -> None:
        self.filter = Filter(place, t_s)
        self.width_px, self.rise_dn, self.dark = width_px, rise_dn, dark
        self.unseen = 0
        """Frames without a sight of it; and frames in which what was seen was much weaker or stronger than it."""
        self.height_dn = 0.0
        self.doubtful = 0

    def expected(self, t_s: float) -> tuple[float, float, float]:
        """Predicted u, v and how far around it to look, px."""
        u, v, spread = self.filter.predict(t_s)
        if self.unseen > COAST_FRAMES:
            u, v = self.filter.u, self.filter.v
        return u, v, min(SEARCH_PX + 3.0 * math.sqrt(spread), SEARCH_LIMIT_PX)

    def learn_height(self, luma: NDArray[np.uint8]) -> None:
        """How far it rises above the ring about it, from the frame in which it was first seen."""
        part, _, _ = self._part(luma, self.filter.u, self.filter.v, 2.0)
        rise, _ = stands_out(part, self.width_px)
        middle = rise.shape[0] // 2
        self.height_dn = max(float(rise[middle - 1 : middle + 2, middle - 1 : middle + 2].max()), 0.0)

    def expect(self, place: Array, t_s: float) -> None:
        """Where the mark stands in the second frame in which it is seen, on the whole picture."""
        if t_s > self.filter.t_s:
            self.filter.began(place, t_s)

    def _part(self, luma: NDArray[np.uint8], u: float, v: float, reach: float) -> tuple[Array, int, int]:
        """Grey values about a place, so many that all within reach has its ring, and the first one's place; dark marks negated."""
        import cv2

        rim = int(reach + RING_WIDTHS * self.width_px + 3)
        u0, u1, v0, v1 = int(u) - rim, int(u) + rim + 1, int(v) - rim, int(v) + rim + 1
        rows, columns = luma.shape
        part = luma[max(v0, 0) : min(v1, rows), max(u0, 0) : min(u1, columns)].astype(np.float32)
        beyond = max(-v0, 0), max(v1 - rows, 0), max(-u0, 0), max(u1 - columns, 0)
        if any(beyond):
            part = cv2.copyMakeBorder(part, *beyond, cv2.BORDER_REPLICATE)
        return (-part if self.dark else part), u0, v0

    def look(self, luma: NDArray[np.uint8], t_s: float) -> tuple[float, float] | None:
        """The strongest spot near the prediction, nearer ones preferred: u, v.

        None where the prediction lies outside the picture. The filter takes the place up unless the spot is much weaker than
        the mark.
        """
        import cv2

        u, v, reach = self.expected(t_s)
        rows_all, columns_all = luma.shape
        if not (0 <= u < columns_all and 0 <= v < rows_all):
            self.unseen += 1
            return None
        part, u0, v0 = self._part(luma, u, v, reach)
        rise, rim = stands_out(part, self.width_px)
        u0, v0 = u0 + rim, v0 + rim
        rows = (np.arange(v0, v0 + rise.shape[0], dtype=np.float32) - v) ** 2
        columns = (np.arange(u0, u0 + rise.shape[1], dtype=np.float32) - u) ** 2
        pull = NEAR_WEIGHT * self.rise_dn / reach**2
        # what is brighter than the mark is not preferred for it: a lamp's mirror image may be
        limit = BRIGHTER * self.height_dn if self.height_dn > 0 else np.inf
        score = np.minimum(rise, limit) - (pull * rows)[:, None] - (pull * columns)[None, :]
        _, _, _, (column, row) = cv2.minMaxLoc(score)
        seen_u = u0 + column + vertex(rise[row, max(column - 1, 0) : column + 2])
        seen_v = v0 + row + vertex(rise[max(row - 1, 0) : row + 2, column])
        height = float(rise[row, column])
        self.doubtful = self.doubtful + 1 if self.height_dn and not LIKE < height / self.height_dn < 1 / LIKE else 0
        if height >= LEAST_RISE * (self.height_dn or 0.6 * self.rise_dn):
            if (
                not self.height_dn or height > LIKE * self.height_dn
            ):  # a rail's edge must not teach what the mark looks like
                self.height_dn += (HEIGHT_MEMORY if self.height_dn else 1.0) * (height - self.height_dn)
            if self.unseen > COAST_FRAMES:
                self.filter.stop()
            self.filter.update(seen_u, seen_v, t_s)
            self.unseen = 0
        else:
            self.unseen += 1
        return seen_u, seen_v


def vertex(three: Array) -> float:
    """Where the parabola through three neighbours has its top, from the middle one, px."""
    if len(three) < 3:
        return 0.0
    left, middle, right = float(three[0]), float(three[1]), float(three[2])
    bend = left - 2 * middle + right
    return 0.0 if bend >= 0 else min(max(0.5 * (left - right) / bend, -0.5), 0.5)
