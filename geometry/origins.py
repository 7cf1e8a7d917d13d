"""What the common modes of a run's motion come from: picks and places of datum points, lens, deck height, marks' places, codec.

The modes themselves are ``motion_from_tracks``'s, in its order: the camera's, each mark's depth, each mark's place along and
across; of the lags: what stands beside a mark, where it lies in its pixel, then the codec.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ..record.run import Run
from .camera import Array
from .datum import DatumFit
from .lag import OF_A_MARK
from .motion import motion_from_tracks
from .phase import PHASES_OF_A_MARK


@dataclass(frozen=True)
class Origins:
    """Shares in the common modes of a run, (k, k) by name; they sum to the unit matrix.

    Attributes
    ----------
    camera : of ``Motion.common``: "picks", "places", "lens", "depth_m of MARK", "body_m of MARK, along" and "..., across"
    lag : of ``Motion.lag``: "surroundings", "phase", "codec"
    """

    camera: dict[str, Array]
    lag: dict[str, Array]


def origins_of(run: Run, fit: DatumFit, common: int, lag: int) -> Origins:
    """Where the modes of a run's motion come from.

    Parameters
    ----------
    run : the run folder as read
    fit : of its datum
    common, lag : how many modes its motion has

    Returns
    -------
    origins : of the exact method; of the trapezoids, whose modes are others, the camera is empty
    """
    marks = [m.name for m in run.file.marker]
    on_model = [m.name for m in run.file.marker if m.on == "model"]
    priors = run.file.priors
    shared = len(fit.mapping.matrix_modes)
    single = [f"depth_m of {name}" for name in marks] if priors.marker_depth_sd_m else []
    if priors.marker_place_sd_m:
        single += [f"body_m of {name}, {way}" for name in on_model for way in ("along", "across")]
    camera: dict[str, Array] = {}
    if common == shared + len(single):
        for name, share in fit.shares.items():
            camera[name] = np.zeros((common, common))
            camera[name][:shared, :shared] = share
        camera |= {name: _only(common, slice(shared + k, shared + k + 1)) for k, name in enumerate(single)}
    codec = OF_A_MARK * len(marks)
    # a recording whose codec holds nothing back has pulls, two or four a mark, and phases alone
    before = lag - codec if lag >= codec else lag
    pulls = max(before - PHASES_OF_A_MARK * len(marks), 0)
    parts = {"surroundings": slice(0, pulls), "phase": slice(pulls, before), "codec": slice(before, lag)}
    return Origins(camera, {name: _only(lag, at) for name, at in parts.items() if at.stop > at.start})


def _only(size: int, at: slice) -> Array:
    found = np.zeros((size, size))
    found[at, at] = np.eye(at.stop - at.start)
    return found


def deck_shapes(run: Run, tracks: pd.DataFrame, fit: DatumFit) -> dict[str, Array]:
    """What marks that stand elsewhere than stated do to the motion (n, 3) of (y_cg, beta, alpha), per metre, of what has no prior.

    Parameters
    ----------
    run : the run folder as read
    tracks : of its marks
    fit : of its datum

    Returns
    -------
    shapes : "depth_m of all marks" together, and "body_m of MARK, along" and "..., across", each where [priors] takes it as exact
    """
    priors = run.file.priors
    asked = {}
    if not priors.marker_depth_sd_m:
        asked["marker_depth_sd_m"] = 1.0
    if not priors.marker_place_sd_m:
        asked["marker_place_sd_m"] = 1.0
    if not asked:
        return {}
    file = run.file.model_copy(update={"priors": priors.model_copy(update=asked)})
    other = replace(run, file=file)
    common = motion_from_tracks(other, tracks, fit).common
    shares = origins_of(other, fit, len(common), 0).camera
    depths = [name for name in shares if name.startswith("depth_m")]
    found = {}
    if "marker_depth_sd_m" in asked and depths:
        found["depth_m of all marks"] = sum(_mode(common, shares[name]) for name in depths)
    if "marker_place_sd_m" in asked:
        found |= {name: _mode(common, shares[name]) for name in shares if name.startswith("body_m")}
    return found


def _mode(common: Array, share: Array) -> Array:
    return common[int(np.argmax(np.diag(share)))]


__all__ = ["Origins", "deck_shapes", "origins_of"]
