"""What reality answers to somebody with a clock, a rule or a picture of a board: an effect's number, measured without a tow."""

from __future__ import annotations

import numpy as np

from .camera import camera_of
from .cases import Case

CALLED = {"frame_rate.rate": "frame_rate.fast"}
"""Numbers of run.toml -> the truth's own names, where they differ."""


def measured_apart(case: Case, number: str, sd: float, rng: np.random.Generator) -> float:
    """The number as measured, with an error of ``sd``; about 0 where reality has no such thing.

    Parameters
    ----------
    case : as drawn
    number : ``effect.number``
    sd : of the measurement
    rng : that draws
    """
    true = _k1(case) if number == "lens_distortion.k1" else case.numbers.get(CALLED.get(number, number), 0.0)
    return float(true + sd * rng.normal())


def _k1(case: Case) -> float:
    """The k1 by which a calibration over the whole picture would differ from the stated one: least squares."""
    camera = camera_of(case.camera, case.numbers.get("lens_distortion.bend", 0.0))
    f, cx, cy, k1, k2 = camera.lens
    across, down = np.meshgrid(np.linspace(-cx, cx, 33) / f, np.linspace(-cy, cy, 19) / f)
    flat = np.stack([across.ravel(), down.ravel()], axis=1)
    r2 = (flat**2).sum(axis=1, keepdims=True)
    bent = flat * (1 + k1 * r2 + k2 * r2**2)
    off = bent * camera.fault * (bent**2).sum(axis=1, keepdims=True)
    slope = flat * r2
    return float((slope * off).sum() / (slope**2).sum())
