"""Who follows a mark of which look: the contract of a follower, and the table of those that are there.

``register_tracker`` takes in another one, with its look (docs/developer/look.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import pandas as pd

from ..geometry.mapping import Mapping
from ..record.errors import InputError
from ..record.looks import Look, in_words, look_of, register_look, spot_names
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .backend import Backend
from .recording import Frame
from .rows import Rows
from .spots import SpotFollower


class Follower(Protocol):
    """What follows some markers of a run through its frames.

    Attributes
    ----------
    losses : rows that are lost so far, for the progress line
    ambiguous : when the marks were found, another assignment of what was seen to the markers was nearly as good
    """

    losses: int
    ambiguous: bool

    def step(self, frame: Frame) -> None:
        """Take the next frame; it may be ``damaged``."""
        ...

    def finish(self) -> pd.DataFrame:
        """A row a frame and marker, frame by frame.

        Columns as in tracks.csv: frame, t_s, marker, u_px, v_px, sigma_u_px, sigma_v_px, status ("measured", "lost"), and reason
        (why lost, "" where measured). Sigmas are what the frame itself shows; path and rigid body widen them later (``scatter``).

        Raises
        ------
        TrackingError : the marks were never found
        """
        ...


Begin = Callable[[Run, tuple[Marker, ...], Mapping, Backend], Follower]
"""(run, its markers of these looks in run.toml's order, pixel -> tank, where fits run) -> what follows them."""
BeginT = TypeVar("BeginT", bound=Begin)


@dataclass(frozen=True)
class _Tracker:
    looks: tuple[str, ...]
    begin: Begin
    each: bool


_TRACKERS: list[_Tracker] = []


def register_tracker(*looks: Look | str, each: bool = False) -> Callable[[BeginT], BeginT]:
    """Say what follows the marks of some looks; to be put over a class or a function.

    Parameters
    ----------
    looks : a ``Look`` is taken into the table of looks, too; a name stands for one that is there. Who was registered last for a
        look follows it
    each : a follower for each marker, with that one alone; false: one for all markers of these looks

    Returns
    -------
    Callable
        a decorator that hands back what it is put over: a ``Begin``

    Examples
    --------
    >>> from towline.record.looks import Look
    >>> from towline.vision.looks import Rows, register_tracker
    >>> @register_tracker(Look("cross", words="printed, dark on white", needs={"seen_at_px": "where it is first"}))
    ... class Crosses(Rows):
    ...     def step(self, frame):
    ...         for marker in self.markers:
    ...             self.lost(frame.index, frame.t_s, marker, "no cross")
    """
    for look in looks:
        if isinstance(look, Look):
            register_look(look)
    names = tuple(look.name if isinstance(look, Look) else look for look in looks)

    def registered(begin: BeginT) -> BeginT:
        _TRACKERS.append(_Tracker(names, begin, each))
        return begin

    return registered


def followers(run: Run, mapping: Mapping, backend: Backend) -> list[Follower]:
    """What follows the markers of ``run``, by the order of the trackers' registration.

    Raises
    ------
    InputError : nothing follows one of the looks, or not in this number
    """
    marks: dict[int, list[Marker]] = {}
    for marker in run.file.marker:
        marks.setdefault(_tracker_of(run, marker), []).append(marker)
    found: list[Follower] = []
    for number, own in sorted(marks.items()):
        tracker = _TRACKERS[number]
        groups: Sequence[Sequence[Marker]] = [[marker] for marker in own] if tracker.each else [own]
        found += [tracker.begin(run, tuple(group), mapping, backend) for group in groups]
    return found


def _tracker_of(run: Run, marker: Marker) -> int:
    """Number of the tracker that was registered last for a marker's look."""
    look = look_of(marker.look)
    for number in reversed(range(len(_TRACKERS))):
        if look is not None and look.name in _TRACKERS[number].looks:
            return number
    raise InputError(
        run.folder / RUN_FILE,
        f"marker {marker.name!r}.look",
        f"{marker.look!r}: no tracker is registered for this look",
    )


# those that are there ------------------------------------------------------------------------------------------------


@register_tracker("led", "disc")
def _spots(run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend) -> Follower:
    """One for all lights and discs."""
    if len(markers) == 1:
        spots = in_words(spot_names())
        raise InputError(
            run.folder / RUN_FILE,
            f"marker {markers[0].name!r}.look",
            f"{markers[0].look!r} alone: which spot it is shows only beside a second {spots}",
        )
    return SpotFollower(run, markers, mapping, backend)


@register_tracker("aruco:N", "apriltag:N")
def _tags(run: Run, markers: tuple[Marker, ...], *_: object) -> Follower:
    """One for all fiducials."""
    from .patch_follower import FiducialMarks

    return FiducialMarks(run, markers)


@register_tracker("template", each=True)
def _template(run: Run, markers: tuple[Marker, ...], *_: object) -> Follower:
    """One for each template."""
    from .patch_follower import TemplateMark

    return TemplateMark(run, markers)


__all__ = ["Begin", "Follower", "Look", "Rows", "followers", "register_tracker"]
