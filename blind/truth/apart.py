"""What reality answers to somebody with a clock, a rule or a picture of a board: an effect's number, measured without a tow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .camera import camera_of
from .cases import Case, run_numbers
from .clocks import true_times
from .sight import datum_stretch, deeper


def measured_apart(case: Case, number: str, sd: float, rng: np.random.Generator) -> float:
    """The number as measured, with an error of ``sd``; about 0 where reality has no such thing, or has it in another form.

    Parameters
    ----------
    case : as drawn
    number : ``effect.number``
    sd : of the measurement
    rng : that draws
    """
    numbers = run_numbers(case.numbers, len(case.runs) - 1)
    if number == "lens_distortion.k1":
        true = _k1(case)
    elif number == "frame_rate.rate":  # a clock filmed beside the whole tow
        whole = np.array([case.duration_s])
        true = float(true_times(numbers, whole, case.duration_s)[0]) / case.duration_s - 1
    elif number == "rolling_shutter.readout_s":  # of rows downwards
        true = numbers.get(number, 0.0) - numbers.get("rolling_shutter.up_s", 0.0)
    elif number == "datum_scale.scale":  # of lengths and widths together
        true = float(datum_stretch(numbers)[:2].mean()) - 1
    elif number == "deck_height.depth_m":  # of both marks together, at rest
        at_rest = {name: value for name, value in numbers.items() if name != "deck_height.squat_m"}
        true = (deeper(at_rest, 0) + deeper(at_rest, 1)) / 2
    else:
        true = numbers.get(number, 0.0)
    return float(true + sd * rng.normal())


def _k1(case: Case) -> float:
    """The k1 by which a calibration over the whole picture would differ from the stated one: least squares."""
    wrong, stated = camera_of(case.camera, case.numbers), camera_of(case.camera)
    f, cx, cy, _, _ = stated.lens
    across, down = np.meshgrid(np.linspace(-cx, cx, 33) / f, np.linspace(-cy, cy, 19) / f)
    flat = np.stack([across.ravel(), down.ravel()], axis=1)
    r2 = (flat**2).sum(axis=1, keepdims=True)
    # points at one focal length before a camera that stands in the origin
    ahead, still = np.column_stack([flat, np.ones(len(flat))]), np.eye(3, 4)
    off = (replace(wrong, matrix=still).pixels(ahead) - replace(stated, matrix=still).pixels(ahead)) / f
    slope = flat * r2
    return float((slope * off).sum() / (slope**2).sum())
