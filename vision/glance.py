"""Marks while they are filmed: where each seems to be in the frame that came last, told at once and from that frame alone.

The tracks of a recording rest on stretches of frames that are fitted together and judged when they end. Who watches a tow cannot
wait for that: here the same followers work in short stretches, and between their ends each mark is fitted in its newest window.
What is said so is provisional. It goes into no table.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pandas as pd

from ..geometry.mapping import Mapping
from ..record.errors import InputError
from ..record.run import RUN_FILE, Run
from .backend import NUMPY, Backend
from .follower import Glance, Glancing
from .looks import followers
from .recording import Frame
from .rows import COLUMNS
from .scatter import LAG_COLUMN, STILL_FACTOR, with_scatter

WIDEN_FRAMES = 240
"""What a path shows beyond the fits' own sigma is read from so many of the last frames ..."""
WIDEN_EVERY = 120
"""... once in so many: choices, some seconds of usual film, for the cost of it."""
LEAST_WIDEN = 30
"""Frames from which a path tells of its scatter (``scatter.LEAST_KNOT_FRAMES`` times ``LEAST_SPANS``)."""


class Glances:
    """Follows the marks of a run frame by frame and says at once where they seem to be.

    Parameters
    ----------
    run : whose marks
    mapping : pixel -> tank
    lossy : the frames were compressed with loss
    linked : and are made from others: the codec may hold a mark back. Tables keep that apart as modes; here it is in the sigma
    backend : where the fits run

    Raises
    ------
    InputError : a mark's look is told at the end of a stretch only
    """

    def __init__(
        self, run: Run, mapping: Mapping, lossy: bool = True, linked: bool = True, backend: Backend = NUMPY
    ) -> None:
        self._run, self._mapping, self._codec = run, mapping, (lossy, linked)
        self._names = [marker.name for marker in run.file.marker]
        self._following: list[Glancing] = []
        for follower in followers(run, mapping, backend):
            if not isinstance(follower, Glancing):
                raise InputError(
                    run.folder / RUN_FILE, "marker.look", f"{_said(run)}: one of these cannot be followed live"
                )
            follower.look_often()
            self._following.append(follower)
        self._rows: deque[list[tuple]] = deque(maxlen=WIDEN_FRAMES)
        self._more_px2: dict[str, np.ndarray] = {}
        self._lag_px2 = dict.fromkeys(self._names, 0.0)
        self._frames = 0
        self._open: Frame | None = None

    def step(self, frame: Frame) -> tuple[Glance, ...]:
        """Take the next frame; the marks in run.toml's order.

        Raises
        ------
        TrackingError : what is seen cannot be told to be the marks
        """
        self.settle()
        found: dict[str, Glance] = {}
        for follower in self._following:
            follower.see(frame)
            found |= {seen.marker: seen for seen in follower.glance(frame)}
        every = [found[name] for name in self._names]
        self._rows.append([_row(frame, seen) for seen in every])
        self._frames += 1
        self._open = frame
        return tuple(self._widened(seen) for seen in every)

    def settle(self) -> None:
        """What takes longer than a glance, best done while nobody waits: after a frame's values have gone out.

        What is not done when the next frame comes is done then: the values are the same.
        """
        frame, self._open = self._open, None
        if frame is None:
            return
        for follower in self._following:
            follower.settle(frame)
        if self._frames % WIDEN_EVERY == 0 or self._frames == LEAST_WIDEN:
            self._widen()

    def _widen(self) -> None:
        """What paths and rigid distances of the last seconds show beyond the fits (``with_scatter``)."""
        table = pd.DataFrame([row for rows in self._rows for row in rows], columns=COLUMNS)
        wider = with_scatter(table, self._run.file.marker, self._mapping, *self._codec)
        for name in self._names:
            own = (table["marker"] == name).to_numpy()
            sigmas = [t.loc[own, ["sigma_u_px", "sigma_v_px"]].to_numpy() ** 2 for t in (wider, table)]
            more = sigmas[0] - sigmas[1]
            if LAG_COLUMN in wider:
                lags = wider.loc[own, LAG_COLUMN].dropna().to_numpy() ** 2
                self._lag_px2[name] = float(np.median(lags)) if len(lags) else 0.0
                more = more + self._lag_px2[name]
            known = np.isfinite(more).all(axis=1)
            if known.any():
                self._more_px2[name] = np.maximum(np.median(more[known], axis=0), 0.0)

    def _widened(self, seen: Glance) -> Glance:
        if not seen.seen:
            return seen
        more = self._more_px2.get(seen.marker)
        # until a path has told of it, a codec's error is taken to be what it usually is beside the fits' own
        times = STILL_FACTOR if self._codec[0] and more is None else 1.0
        more = np.zeros(2) if more is None else more
        return replace(
            seen,
            sigma_u_px=float(np.hypot(times * seen.sigma_u_px, np.sqrt(more[0]))),
            sigma_v_px=float(np.hypot(times * seen.sigma_v_px, np.sqrt(more[1]))),
            lag_px=float(np.sqrt(self._lag_px2[seen.marker])),
        )


def _said(run: Run) -> str:
    return ", ".join(sorted({marker.look for marker in run.file.marker}))


def _row(frame: Frame, seen: Glance) -> tuple:
    sigmas = seen.u_px, seen.v_px, seen.sigma_u_px, seen.sigma_v_px
    return (frame.index, frame.t_s, seen.marker, *sigmas, "measured" if seen.seen else "lost", seen.reason)


__all__ = ["Glances"]
