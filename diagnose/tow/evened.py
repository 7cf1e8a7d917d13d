"""Marks' sigmas whose shares change evenly: how much each mark counts beside the others is then the same in the frames of a mean.

Where a camera's fault puts the marks millimetres nearer together or further apart than they are, that difference goes to one or the
other as their sigmas say. A film's sigmas change from frame to frame by a tenth; in a few frames to a mean, by which faults are
tried, that is tenths of a millimetre of the model's place, as large as what tells one fault from another.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...record.tables import SEEN

EVEN_S = 4.0
"""A running median of so long: of 100 frames it is even to half a percent."""
UNUSUAL = 2.0
"""A frame in which a mark's share is so many times the usual one, or less by as much, stays as it is: a mark was hardly seen."""
SIGMAS = ["sigma_u_px", "sigma_v_px"]


def evened(tracks: pd.DataFrame) -> pd.DataFrame:
    """Tracks whose marks have in every frame the shares of its sigmas that they usually have about then.

    Parameters
    ----------
    tracks : as in tracks.csv

    Returns
    -------
    the same rows; nothing but the sigmas (px) is changed, their geometric mean in a frame is not

    Examples
    --------
    >>> rows = pd.DataFrame({"frame": [0, 0, 1, 1, 2, 2], "t_s": [0, 0, 0.04, 0.04, 0.08, 0.08], "status": "measured"})
    >>> rows["marker"] = ["bow", "stern"] * 3
    >>> rows["sigma_u_px"] = rows["sigma_v_px"] = [0.03, 0.03, 0.033, 0.027, 0.06, 0.06]
    >>> evened(rows)["sigma_u_px"].round(4).tolist()
    [0.03, 0.03, 0.0298, 0.0298, 0.06, 0.06]
    """
    seen = tracks["status"].isin(SEEN) & (tracks[SIGMAS] > 0).all(axis=1)
    rows = tracks[seen].set_index(["frame", "marker"])
    own: Any = pd.DataFrame(np.log(rows[SIGMAS].to_numpy()), rows.index, SIGMAS).unstack("marker").sort_index()
    if len(own) < 2:
        return tracks.copy()
    level = own.mean(axis=1)
    share = own.sub(level, axis=0)
    times_s: Any = np.unique(rows["t_s"])
    apart_s = float(np.median(np.diff(times_s)))
    frames = max(int(EVEN_S / apart_s), 1) if apart_s > 0 else 1
    usual = share.rolling(frames, center=True, min_periods=1).median().where(own.notna())
    usual = usual.sub(usual.mean(axis=1), axis=0)
    as_usual = (share - usual).abs().max(axis=1) <= np.log(UNUSUAL)
    even = np.exp(own.where(~as_usual, usual.add(level, axis=0))).stack("marker", future_stack=True)
    answer = tracks.copy()
    answer.loc[seen, SIGMAS] = even.loc[rows.index, SIGMAS].to_numpy()
    return answer


__all__ = ["evened"]
