"""How a camera stands to what it sees: turned in the course of the tows, read row by row, its marks at other heights."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .camera import camera_of
from .lanes import Array, Lane


def sighted(camera: Mapping[str, float], numbers: Lane, index: int, true_s: Array, place: Array) -> Array:
    """Pixels of places, through a camera that may have been turned.

    Parameters
    ----------
    camera : as drawn
    numbers : of the run
    index : of the run
    true_s : times ``(n,)``
    place : in the tank ``(n, 3)``, m

    Returns
    -------
    px ``(n, 2)``
    """
    whole = camera_of(camera, numbers)
    turn = [numbers.get(f"camera_shift.{name}_rad", 0.0) for name in ("right", "down", "roll")]
    if not any(turn):
        return whole.pixels(place)
    found, share = np.empty((len(true_s), 2)), turned_share(numbers, index, true_s)
    for still, seen_by in ((0.0, whole), (1.0, whole.turned(*turn))):
        here = share == still
        if here.any():
            found[here] = seen_by.pixels(place[here])
    turning = (share > 0) & (share < 1)
    if turning.any():
        found[turning] = whole.pixels(place[turning], share[turning, None] * np.array(turn))
    return found


def turned_share(numbers: Lane, index: int, true_s: Array) -> Array:
    """How much of its turn the camera has made ``(n,)``: all of it from a run or a time on (before the first, where neither is
    given), slowly over ``over_s``, back again after ``back_s``, or little by little over ``creep_s`` of all recordings.

    Parameters
    ----------
    numbers : of the run
    index : of the run
    true_s : times ``(n,)``
    """
    creep = numbers.get("camera_shift.creep_s", 0.0)
    if creep:
        return np.clip((index * numbers["duration"] + true_s) / creep, 0.0, 1.0)
    first, when = int(numbers.get("camera_shift.first_run", 0)), numbers.get("camera_shift.time_s", -1e9)
    after, here = np.full(len(true_s), float(index > first)), index == first
    back, over = numbers.get("camera_shift.back_s", 0.0), numbers.get("camera_shift.over_s", 0.0)
    if back:
        return 1.0 * (here & (true_s >= when) & (true_s < when + back))
    if over:
        return np.clip((true_s - when) / over, 0.0, 1.0) if here else after
    return np.maximum(after, 1.0 * (here & (true_s >= when)))


def read_late(camera: Mapping[str, float], numbers: Lane, pixel: Array) -> Array | None:
    """How much later than the frame's middle a place of the picture is read, s ``(n,)``: rows downwards, upwards, or columns.

    Parameters
    ----------
    camera : as drawn
    numbers : of the run
    pixel : places ``(n, 2)``

    Returns
    -------
    None where all of it is read at once.
    """
    down = numbers.get("rolling_shutter.readout_s", 0.0) - numbers.get("rolling_shutter.up_s", 0.0)
    across = numbers.get("rolling_shutter.across_s", 0.0)
    if not down and not across:
        return None
    late = down * (pixel[:, 1] / camera["height_px"] - 0.5)
    return late + across * (pixel[:, 0] / camera["width_px"] - 0.5) if across else late


def deeper(numbers: Lane, mark: int) -> float:
    """By how much deeper than stated a mark lies, m: all of them, the first alone, by trim, or as the hull squats at speed.

    Parameters
    ----------
    numbers : of the run
    mark : its number; the first is at the bow
    """
    squat = numbers.get("deck_height.squat_m", 0.0)
    found = numbers.get("deck_height.depth_m", 0.0) + (numbers.get("deck_height.bow_m", 0.0) if mark == 0 else 0.0)
    found += numbers.get("deck_height.trim_m", 0.0) * (1 if mark == 0 else -1)
    return found + (squat * (numbers["speed"] / numbers["speed_ref"]) ** 2 if squat else 0.0)


def datum_stretch(numbers: Lane) -> Array:
    """Where datum points stand, by where they are said to: factors ahead, aside and down ``(3,)``.

    Parameters
    ----------
    numbers : of the run
    """
    both = numbers.get("datum_scale.scale", 0.0)
    ahead, aside = (numbers.get(f"datum_scale.{way}_scale", 0.0) for way in ("ahead", "aside"))
    return np.array([1 + both + ahead, 1 + both + aside, 1.0])
