"""The tow line as the model's pose shows it (theory.md 4)."""

from __future__ import annotations

import numpy as np

from ..record.run import Run
from ..record.schema import TowTable
from .camera import Array


def alpha_of(run: Run, pose: Array) -> tuple[Array, Array]:
    """alpha = atan2(y_T - y_post, x_post - x_T) (n,) and its slope by (x, y, beta) (n, 3); NaN without a line.

    Parameters
    ----------
    run : its tow
    pose : (n, 3), x_CG m, y_CG m, beta rad
    """
    tow = run.file.tow
    if run.file.kind != "tow" or tow is None or tow.tow_point_m is None:
        # a forced post moves: its place at each frame is not in run.toml's post_m
        return np.full(len(pose), np.nan), np.full((len(pose), 3), np.nan)
    arm = tow_arm(pose[:, 2], tow)
    ahead = tow.post_m[0] - pose[:, 0] - arm[:, 0]
    aside = pose[:, 1] + arm[:, 1] - tow.post_m[1]
    square = ahead**2 + aside**2
    slope = np.column_stack([aside, ahead, ahead * arm[:, 0] - aside * arm[:, 1]]) / square[:, None]
    return np.arctan2(aside, ahead), slope


def tow_arm(beta_rad: Array, tow: TowTable) -> Array:
    """(n, 2) from the CG to the tow point in tank axes, m; a tow point that is not stated is the CG.

    Parameters
    ----------
    beta_rad : (n,) heading
    tow : of run.toml
    """
    cosine, sine = np.cos(beta_rad), np.sin(beta_rad)
    ahead, aside = tow.tow_point_m or 0.0, tow.tow_point_offset_m
    return np.column_stack([ahead * cosine - aside * sine, ahead * sine + aside * cosine])


__all__ = ["alpha_of", "tow_arm"]
