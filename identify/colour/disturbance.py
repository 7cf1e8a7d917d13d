"""What pushes a towed hull about: a first-order coloured side force and moment."""

from __future__ import annotations

from dataclasses import dataclass

from ...simulate.model import Array


@dataclass(frozen=True)
class Disturbance:
    """The estimated disturbance.

    Attributes
    ----------
    force_n, moment_n_m : standard deviations
    time_s : correlation time
    scale : (2,), measurement scatter over the stated sigmas, y and beta
    log_sd : (5,), standard deviations of the logarithms of force, moment, time and the two scales
    """

    force_n: float
    moment_n_m: float
    time_s: float
    scale: Array
    log_sd: Array
