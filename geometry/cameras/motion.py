"""Both cameras' poses of one tow -> one motion, with the match that it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ...record.errors import GeometryError, InputError
from ...record.run import RUN_FILE, Run, cameras_of
from ..camera import Array
from ..mapping import Mapping
from ..motion import motion_table
from ..poses import Poses
from .afloat import afloat_view, tells_roll
from .flash import Lit, Tie, tie_of
from .join import BOTH, FIRST, SECOND, Joined, join_views
from .match import Known, Match, match_views
from .view import view_of

CAMERA_COLUMN = "camera"
"""Of the motion: which camera a row is from, by its name; both names with a + where both see the model; empty: neither does."""


AFLOAT = ("heave_m", "roll_rad", "pitch_rad")
"""Of the motion, where the marks tell them: each with ``sigma_`` and ``common_``."""
ROLLS_BY = 2.0
"""The model rolls, heaves or pitches where one of these varies by more than so many of its standard deviations: less is noise."""


@dataclass(frozen=True)
class JointMotion:
    """The motion of a tow that two cameras filmed.

    Attributes
    ----------
    motion : as ``geometry.Motion.motion``, on the first camera's clock, with ``camera``, and ``AFLOAT`` where the marks tell these
    common, lag : (k, n, 3), (l, n, 3), as ``geometry.Motion``'s
    match : of the two, in x, y and heading, or with heave, roll and pitch where the model rolls
    joined : poses, of as many numbers
    afloat : poses with heave, roll and pitch, at the same times; None where the marks do not tell them
    rolls : the model rolls, heaves or pitches by more than noise; y and heading are then told with these taken out
    untold : why there is no roll, in words; None where there is
    flash : what flashes say of the second camera's clock; None: none was seen by both
    """

    motion: pd.DataFrame
    common: Array
    lag: Array
    match: Match
    joined: Joined
    afloat: Joined | None
    rolls: bool
    untold: str | None
    flash: Tie | None = None


def joint_motion(
    run: Run,
    poses: Sequence[Poses],
    mappings: Sequence[Mapping],
    lit: tuple[Sequence[Lit], Sequence[Lit]] = ((), ()),
    about: Known | None = None,
) -> JointMotion:
    """Join what two cameras say of one tow.

    Parameters
    ----------
    run : with two ``[[camera]]``
    poses, mappings : of each, as ``poses_from_tracks`` and ``run_mapping`` give for each of ``cameras_of(run)``
    lit : flashes that each saw; what they say of the clock counts beside the motion, by its weight, where the two do not contradict
        one another
    about : what else is known of the clock beforehand, as from when the pictures of both came; a clock that the motion tells badly
        is then no error. None: nothing

    Raises
    ------
    InputError : neither motion nor flash tell the second camera's clock, or both never see the model long enough
    """
    camera = run.file.cameras[1]
    if camera.offset_s is not None:
        return _joined_with(run, poses, mappings, Known(camera.offset_s, camera.offset_sd_s))
    found = None
    try:
        found = _joined_with(run, poses, mappings, about)
    except InputError:
        tie = tie_of(*lit, None)
        if tie is None:
            raise
    else:
        tie = tie_of(*lit, found.match.clock)
    if tie is None or (found is not None and not tie.agrees):
        assert found is not None
        return replace(found, flash=tie)
    return replace(_joined_with(run, poses, mappings, tie.known), flash=tie)


def _joined_with(run: Run, poses: Sequence[Poses], mappings: Sequence[Mapping], known: Known | None) -> JointMotion:
    """The joint motion with what is known of the clock beforehand."""
    views, camera = cameras_of(run), run.file.cameras[1]
    one, two = (view_of(view, found) for view, found in zip(views, poses, strict=True))
    untold, risen, afloat, rolls, near_s = tells_roll(run), None, None, False, None
    if untold is None:
        whole = [afloat_view(*each) for each in zip(views, poses, mappings, strict=True)]
        try:
            risen = match_views(whole[0], whole[1], known, rough=(one, two))
        except GeometryError as error:
            untold = f"roll and heave are not told: {error}"
        else:
            afloat, near_s = join_views(risen), risen.clock.offset_s
            rolls = _rolls(afloat)
    if risen is not None and rolls:
        match = risen
    else:
        try:
            match = match_views(one, two, known, near_s)
        except GeometryError as error:
            raise InputError(run.folder / RUN_FILE, f'camera[2 "{camera.name}"]', str(error)) from None
        if risen is not None:
            afloat = join_views(replace(risen, clock=match.clock))
    joined = afloat if rolls and afloat is not None else join_views(match)
    table, modal = motion_table(
        run, joined.t_s, joined.pose[:, :3], joined.covariance[:, :3, :3], joined.modes[..., :3], joined.slow
    )
    if afloat is not None:
        for column, name in enumerate(AFLOAT, 3):
            seen = np.isfinite(afloat.pose[:, column])
            table[name] = afloat.pose[:, column]
            table[f"sigma_{name}"] = np.sqrt(afloat.covariance[:, column, column])
            table[f"common_{name}"] = np.where(
                seen, np.sqrt((afloat.modes[afloat.slow :, :, column] ** 2).sum(axis=0)), np.nan
            )
    table[CAMERA_COLUMN] = camera_names(run, joined)
    return JointMotion(table, modal[joined.slow :], modal[: joined.slow], match, joined, afloat, rolls, untold)


def _rolls(afloat: Joined) -> bool:
    """Whether heave, roll or pitch vary by more than their noise where both cameras see the model."""
    both = afloat.source == BOTH
    if both.sum() < 2:
        return False
    varies = afloat.pose[both, 3:].var(axis=0)
    noise = np.einsum("ndd->nd", afloat.covariance[both])[:, 3:].mean(axis=0)
    slow = afloat.modes[:, both, 3:].var(axis=1).sum(axis=0)  # what the common errors themselves vary by
    return bool((varies > ROLLS_BY**2 * (noise + slow)).any())


def camera_names(run: Run, joined: Joined) -> Array:
    """(n,) which camera each row is from.

    Parameters
    ----------
    run : with two ``[[camera]]``
    joined : its poses
    """
    one, two = (camera.name for camera in run.file.cameras)
    names = {FIRST: one, SECOND: two, BOTH: f"{one}+{two}"}
    return np.array([names.get(int(source), "") for source in joined.source], dtype=object)


__all__ = ["AFLOAT", "CAMERA_COLUMN", "JointMotion", "camera_names", "joint_motion"]
