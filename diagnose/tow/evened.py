"""Marks' sigmas that change evenly: how much each of two marks counts is then the same in the frames of a mean.

Where a camera's fault puts the marks millimetres nearer together or further apart than they are, that difference goes to one or the
other as their sigmas say. A film's sigmas change from frame to frame by a tenth; in a few frames to a mean, by which faults are
tried, that is tenths of a millimetre of the model's place, as large as what tells one fault from another.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from ...record.tables import SEEN

EVEN_S = 4.0
"""A running median of so long: of 100 frames it is even to half a percent."""
UNUSUAL = 2.0
"""A frame whose sigma is so many times the usual one keeps it: there the mark was hardly seen."""
SIGMAS = ["sigma_u_px", "sigma_v_px"]


def evened(tracks: pd.DataFrame) -> pd.DataFrame:
    """Tracks whose sigmas are the running median of each mark's.

    Parameters
    ----------
    tracks : as in tracks.csv

    Returns
    -------
    the same rows; nothing but the sigmas (px) is changed, and only of marks that were seen, where there is one

    Examples
    --------
    >>> rows = pd.DataFrame({"frame": range(5), "t_s": 0.04 * np.arange(5), "marker": "bow", "status": "measured"})
    >>> rows["sigma_u_px"] = rows["sigma_v_px"] = [0.031, 0.028, 0.5, 0.03, 0.029]
    >>> evened(rows)["sigma_u_px"].tolist()
    [0.03, 0.03, 0.5, 0.03, 0.03]
    """
    answer = tracks.copy()
    for _, rows in tracks[tracks["status"].isin(SEEN)].sort_values("frame").groupby("marker"):
        apart_s = float(np.median(np.diff(rows["t_s"]))) if len(rows) > 1 else 0.0
        frames = max(int(EVEN_S / apart_s), 1) if apart_s > 0 else 1
        usual = rows[SIGMAS].rolling(frames, center=True, min_periods=1).median()
        answer.loc[rows.index, SIGMAS] = usual.where(rows[SIGMAS] <= UNUSUAL * usual, rows[SIGMAS])
    return answer


__all__ = ["evened"]
