"""Clocks of reality: when a frame was taken, and how late a load cell's record is."""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lane


def true_times(numbers: Lane, t_s: Array, duration_s: float) -> Array:
    """When frames were taken whose times are stated: a rate that is off, off by two rates one after another, or drifts away.

    Parameters
    ----------
    numbers : of the run
    t_s : stated times ``(n,)``
    duration_s : of the film
    """
    found = t_s * (1 + numbers.get("frame_rate.fast", 0.0))
    one, two = numbers.get("frame_rate.piece_one", 0.0), numbers.get("frame_rate.piece_two", 0.0)
    if one or two:
        change = numbers.get("frame_rate.change_s", 0.0)
        found = found + one * np.minimum(t_s, change) + two * np.maximum(t_s - change, 0.0)
    drift = numbers.get("frame_rate.drift", 0.0)
    return found + drift * t_s**2 / duration_s if drift else found


def cell_late(numbers: Lane, true_s: Array, duration_s: float) -> Array:
    """By how much earlier than they are a load cell states its times: steadily, more and more, or more from some time on.

    Parameters
    ----------
    numbers : of the run
    true_s : times ``(n,)``
    duration_s : of the film
    """
    late = numbers.get("sync_delay.delay_s", 0.0) + numbers.get("sync_delay.drift_s", 0.0) * true_s / duration_s
    return late + np.where(true_s > numbers.get("sync_delay.change_s", 0.0), numbers.get("sync_delay.jump_s", 0.0), 0.0)
