"""What two cameras say together of a tow while it is filmed: the second one's clock as soon as it is told, then one course of both.

It takes what each camera's ``live.jsonl`` says, frame by frame. From time to time all that both saw so far is matched as it is
after a tow (``geometry.cameras``): clock, and what the two have in common. In between the newest frames are joined by the last
match. Until the clock is told one camera speaks alone wherever it sees the model; the other stands in where it does not, at a time
that is known from when its pictures came, as badly as that is known. It reads no clock of this machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import DatumFit
from ..geometry.cameras.afloat import NUMBERS, tells_roll
from ..geometry.cameras.join import Joined, join_views
from ..geometry.cameras.match import TOLD_S, Known, Match, unmatched
from ..geometry.cameras.motion import AFLOAT, JointMotion, camera_names, joint_motion
from ..geometry.cameras.view import POINTS
from ..geometry.cameras.words import joint_sentences
from ..geometry.motion import motion_table
from ..record.errors import InputError, TowlineError
from ..record.run import Run, cameras_of
from .camera_frames import MARGIN_S, CameraFrames

ARRIVAL_SD_S = 0.2
"""How well the second camera's clock is known from when the pictures of both came (standard deviation): encoders, networks and
players hold pictures back by up to half a second, each in its own way. A choice; offsets are looked for within five of it."""
FIRST_S, GROWS = 4.0, 1.2
"""Both are matched when they have filmed for so long, and again when they have for so many times as long: a match takes longer the
more there is, so that all of a tow's together take as long as a few of the last."""
SILENT_S = 0.5
"""Of a camera whose pictures come later than the other's by more than this nothing is waited for."""


@dataclass(frozen=True)
class Course:
    """The newest frames of both, joined, (n, ...) in their order.

    Attributes
    ----------
    joined : their poses
    told : the clock was told by motion or flash
    """

    joined: Joined
    told: bool


class Joint:
    """Joins two cameras' frames as they come.

    Parameters
    ----------
    run : with two ``[[camera]]``
    fits : of each camera's datum
    by_arrival : pictures come as they are taken, so that their arrival says something of the clocks; a film that is played does not
    """

    def __init__(self, run: Run, fits: Sequence[DatumFit], by_arrival: bool = True) -> None:
        self._run, self._by_arrival = run, by_arrival
        self._first, self._second = (CameraFrames(*each) for each in zip(cameras_of(run), fits, strict=True))
        self._match: Match | None = None
        # of a model that may roll one camera tells little until both have told that it does not
        self._size = 3 if tells_roll(run) else NUMBERS
        self._tried_s = FIRST_S / GROWS
        self._until_s, self._count = -np.inf, 0

    def add(self, place: int, records: Iterable[dict[str, Any]]) -> None:
        """Take new lines of a camera's log.

        Parameters
        ----------
        place : 0, 1 : of the first, the second camera
        records : as ``LogReader.records`` gives them
        """
        (self._first, self._second)[place].add(records)

    # the clock ----------------------------------------------------------------------------------------------------------

    @property
    def told(self) -> bool:
        """The second camera's clock is told by motion or flash."""
        return self._match is not None

    def match(self) -> dict[str, Any] | None:
        """Match all that was seen so far, where enough of it is new: what is to be said of the two; None: nothing new."""
        one, two = self._first, self._second
        if not (one.t_s and two.t_s):
            return None
        filmed_s = min(camera.t_s[-1] - camera.began_s for camera in (one, two))
        if filmed_s < GROWS * self._tried_s:
            return None
        self._tried_s = filmed_s
        t_s = round(one.t_s[-1], 6)
        about = self._by_their_arrival()
        if any(not camera.t_s[camera.sure] for camera in (one, two)):
            looked_at = min(len(camera.t_s) for camera in (one, two))
            return self._untold(t_s, about, f"of one camera only {looked_at} pictures were looked at so far")
        for camera in (one, two):
            camera.take_lags()
            camera.take_beat()
        try:
            poses, mappings = (one.poses(one.sure), two.poses(two.sure)), (one.mapping, two.mapping)
            found = joint_motion(self._run, poses, mappings, (one.lit(), two.lit()), about)
        except TowlineError as error:
            self._match = None
            return self._untold(t_s, about, error.message if isinstance(error, InputError) else str(error))
        clock, at_s = found.match.clock, np.array(found.match.middle_s)
        if clock.sd_at(at_s) > TOLD_S:
            self._match = None
            return self._untold(t_s, about, f"the motion tells it to {float(clock.sd_at(at_s)):.2g} s so far")
        self._match = found.match
        return self._said(t_s, found)

    def _by_their_arrival(self) -> Known | None:
        if not self._by_arrival:
            return None
        return Known(self._second.late_s - self._first.late_s, ARRIVAL_SD_S, float(np.median(self._second.t_s)))

    def _said(self, t_s: float, found: JointMotion) -> dict[str, Any]:
        clock = found.match.clock
        return {
            "cameras": joint_sentences(self._run, found),
            "t_s": t_s,
            "told": True,
            "agree": found.match.agree,
            "offset_s": [round(clock.offset_s, 6), round(clock.offset_sd_s, 6)],
            "rate": [round(clock.rate, 9), round(clock.rate_sd, 9)],
        }

    def _untold(self, t_s: float, about: Known | None, why: str) -> dict[str, Any]:
        one, two = (camera.name for camera in self._run.file.cameras)
        said = f"{two}'s clock is not told yet: {why}"
        if about is not None:
            said += f"; by when their pictures came {one}'s shows {about.offset_s:+.2f} +- {about.sd_s:.2f} s more"
        offset = None if about is None else [round(about.offset_s, 6), about.sd_s]
        return {"cameras": [said], "t_s": t_s, "told": False, "agree": None, "offset_s": offset, "rate": None}

    # the course ---------------------------------------------------------------------------------------------------------

    def rows(self, ended: bool = False) -> list[dict[str, Any]]:
        """What both say of the frames that were not told of yet, a line of ``live.jsonl`` each.

        Parameters
        ----------
        ended : no more comes: nothing is waited for
        """
        course = self._course(ended)
        return [] if course is None else list(self._lines(course))

    def _course(self, ended: bool) -> Course | None:
        """The newest frames, joined."""
        one, two, about = self._first, self._second, self._by_arrival
        if not one.t_s or (about and not two.t_s):
            return None
        match, known = self._match, self._by_their_arrival() if two.t_s else None
        if match is None and known is None:
            # nothing is known of the other's clock: the first one alone
            view = one.view_from(self._from(one), 1, self._size, None)
            blank = replace(view, pose=view.pose * np.nan, covariance=view.covariance * np.nan, modes=0 * view.modes)
            none = unmatched(view, blank, Known(0.0, 1.0))
            return self._newer(join_views(none, alone=True), one.t_s[-1], told=False)
        size = self._size if match is None else match.first.pose.shape[1]
        first = one.view_from(self._from(one), 1, size, None if match is None else match.first)
        offset_s = 0.0 if known is None else known.offset_s
        begin_s = first.t_s[0] - offset_s if match is None else float(match.clock.second(first.t_s[:1])[0])
        second = two.view_from(
            begin_s - 2 * POINTS * _step_s(two), POINTS, size, None if match is None else match.second
        )
        if match is None:
            assert known is not None
            joint = unmatched(first, second, known)
        else:
            joint = replace(match, first=first, second=second)
        until_s = self._until(float(joint.clock.first(np.array(two.t_s[-1]))), ended)
        return self._newer(join_views(joint, alone=match is None), until_s, told=match is not None)

    def _from(self, camera: CameraFrames) -> float:
        return max(self._until_s, camera.t_s[0]) - MARGIN_S

    def _until(self, second_s: float, ended: bool) -> float:
        """Until when both have said what they have to say; ``second_s``: the second's last frame, on the first one's clock."""
        one, two = self._first, self._second
        later_s = one.arrived_s[-1] - two.arrived_s[-1]
        if ended:
            return max(one.t_s[-1], second_s)
        if later_s > SILENT_S:
            return one.t_s[-1]
        if later_s < -SILENT_S:
            return second_s
        # between two frames of the second one there must be another one after
        return min(one.t_s[-1], second_s - 2 * _step_s(two))

    def _newer(self, joined: Joined, until_s: float, told: bool) -> Course | None:
        """The rows that were not told of yet."""
        new = (joined.t_s > self._until_s) & (joined.t_s <= until_s)
        if not new.any():
            return None
        self._until_s = float(joined.t_s[new][-1])
        some = replace(
            joined,
            t_s=joined.t_s[new],
            pose=joined.pose[new],
            covariance=joined.covariance[new],
            modes=joined.modes[:, new],
            source=joined.source[new],
        )
        return Course(some, told)

    def _lines(self, course: Course) -> Iterable[dict[str, Any]]:
        joined = course.joined
        table, modal = motion_table(
            self._run, joined.t_s, joined.pose[:, :3], joined.covariance[:, :3, :3], joined.modes[..., :3], joined.slow
        )
        common = np.sqrt((modal**2).sum(axis=0))
        names, arrived_s = camera_names(self._run, joined), self._arrived(joined.t_s)
        values = {
            name: np.column_stack([table[name], table[f"sigma_{name}"], common[:, k]])
            for k, name in enumerate(("y_cg_m", "beta_rad", "alpha_rad"))
        }
        for k, name in enumerate(AFLOAT[: joined.pose.shape[1] - 3], 3):
            sd = np.sqrt(joined.covariance[:, k, k]), np.sqrt((joined.modes[..., k] ** 2).sum(axis=0))
            values[name] = np.column_stack([joined.pose[:, k], *sd])
        for row, t_s in enumerate(joined.t_s):
            self._count += 1
            yield {
                "joint": self._count - 1,
                "t_s": round(float(t_s), 6),
                "arrived_s": round(float(arrived_s[row]), 4),
                "camera": names[row],
                "told": course.told,
                **{name: _numbers(value[row]) for name, value in values.items()},
            }

    def _arrived(self, t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """When the pictures of these times were here: of the first camera, or, after its last one, of the second."""
        one, two = self._first, self._second
        found = np.interp(t_s, one.t_s, one.arrived_s)
        later = t_s > one.t_s[-1]
        return np.where(later, two.arrived_s[-1], found) if len(two.t_s) else found


def _step_s(camera: CameraFrames) -> float:
    """The usual step of its last frames."""
    last = camera.t_s[-20:]
    return float(np.median(np.diff(last))) if len(last) > 1 else 0.0


def _numbers(value: NDArray[np.float64]) -> list[float] | None:
    return [round(float(x), 7) for x in value] if np.isfinite(value).all() else None


__all__ = ["Joint"]
