"""Measured against known: how far one motion lies from another, on the measured frames alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..record.errors import TowlineError


@dataclass(frozen=True)
class MotionError:
    """Root mean square differences over the frames that both motions hold.

    Attributes
    ----------
    y_cg_m : m
    beta_deg, alpha_deg : degrees; alpha NaN where neither motion has it
    samples : frames compared
    """

    y_cg_m: float
    beta_deg: float
    alpha_deg: float
    samples: int


def motion_error(measured: pd.DataFrame, reference: pd.DataFrame) -> MotionError:
    """Compare a measured motion with a reference (truth, or a simulation), interpolated to the measured times.

    Parameters
    ----------
    measured : motion table
    reference : motion table that is taken as true

    Raises
    ------
    TowlineError : the two have no time in common
    """
    good = (measured["status"] == "measured").to_numpy()
    times, clock = measured["t_s"].to_numpy(), reference["t_s"].to_numpy()
    good = good & (times >= clock[0] - 1e-9) & (times <= clock[-1] + 1e-9)
    if not good.any():
        raise TowlineError(
            f"the motions have no time in common: {times[0]:.2f} .. {times[-1]:.2f} s, {clock[0]:.2f} .. {clock[-1]:.2f} s"
        )

    def rms(column: str) -> float:
        known = np.interp(times[good], clock, reference[column].to_numpy())
        gap = measured[column].to_numpy()[good] - known
        gap = gap[np.isfinite(gap)]
        return float(np.sqrt(np.mean(gap**2))) if len(gap) else float("nan")

    return MotionError(
        rms("y_cg_m"), float(np.degrees(rms("beta_rad"))), float(np.degrees(rms("alpha_rad"))), int(good.sum())
    )
