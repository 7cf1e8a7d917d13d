"""What the static records of runs that share a camera say together of the measurement's own noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .data import RunData
from .still import Colour, Slow, Still, colour_of, slow_part


def colours(runs: Sequence[RunData]) -> list[Colour | None]:
    """For each run the colour that the static records of its camera say, pooled over the runs that share it."""
    return [colour_of(*_of_camera(run, runs)) for run in runs]


def slow_parts(runs: Sequence[RunData]) -> list[Slow | None]:
    """For each run of block means the slow part that the static records of its camera show; None without one or any."""
    return [slow_part(*_of_camera(run, runs)) for run in runs]


def _of_camera(run: RunData, runs: Sequence[RunData]) -> tuple[list[Still], float]:
    """Static records of the runs that share a run's camera, and that run's step in s."""
    records = [d.still for d in runs if d.still is not None and d.common_key == run.common_key]
    return records, float(np.median(np.diff(run.t_s)))
