"""Who follows a mark of which look: the contract of a follower, and the table of those that are there.

``register_tracker`` takes in another one, with its look (docs/developer/look.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from ..geometry.mapping import Mapping
from ..record.corrections import Placed
from ..record.errors import InputError
from ..record.looks import LOOKS, Look, in_words, look_of, named, register_look
from ..record.registry import Registry, code_stamp
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .backend import Backend
from .follower import Follower
from .rows import Rows
from .seeded import SeededFollower
from .spots import SpotFollower

Begin = Callable[[Run, tuple[Marker, ...], Mapping, Backend], Follower]
"""(run, its markers of these looks in run.toml's order, pixel -> tank, where fits run) -> what follows them."""
BeginT = TypeVar("BeginT", bound=Begin)


@dataclass(frozen=True)
class Tracker:
    """What follows the marks of some looks, all that have the same together; ``each``: every mark by itself."""

    begin: Begin
    each: bool


TRACKERS: Registry[Tracker] = Registry()
"""By the name of the look; several looks may have one."""


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

    Raises
    ------
    ValueError : there is no look of such a name
    """

    def registered(begin: BeginT) -> BeginT:
        tracker, stamp = Tracker(begin, each), code_stamp(begin)
        for given in looks:
            look = given if isinstance(given, Look) else LOOKS.get(given)
            if look is None:
                raise ValueError(f"no look is called {given!r}; expected {in_words(named())}, or a Look")
            register_look(replace(look, stamp=stamp))
            TRACKERS.add(look.name, tracker)
        return begin

    return registered


def followers(run: Run, mapping: Mapping, backend: Backend, seeds: Sequence[Placed] = ()) -> list[Follower]:
    """What follows the markers of ``run``, by the order of the trackers' registration.

    Parameters
    ----------
    run : the run folder as read
    mapping : pixel -> tank
    backend : where the fits run
    seeds : frames in which a person says where marks are; what follows those begins again there

    Raises
    ------
    InputError : nothing follows one of the looks, or not in this number
    """
    of_each = {marker.name: _tracker_of(run, marker) for marker in run.file.marker}
    found: list[Follower] = []
    for tracker in dict.fromkeys(TRACKERS.here()):
        own = [marker for marker in run.file.marker if of_each[marker.name] == tracker]
        groups = [[marker] for marker in own] if tracker.each else [own]
        found += [_follower(tracker, run, tuple(group), mapping, backend, seeds) for group in groups if group]
    return found


def _follower(
    tracker: Tracker, run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend, seeds: Sequence[Placed]
) -> Follower:
    names = {marker.name for marker in markers}
    own: dict[int, dict[str, Placed]] = {}
    for seed in seeds:
        if seed.marker in names:
            own.setdefault(seed.frame, {})[seed.marker] = seed
    if not own:
        return tracker.begin(run, markers, mapping, backend)
    return SeededFollower(lambda some: tracker.begin(run, some, mapping, backend), markers, own)


def _tracker_of(run: Run, marker: Marker) -> Tracker:
    look = look_of(marker.look)
    tracker = None if look is None else TRACKERS.get(look.name)
    if tracker is None:
        where = f"marker {marker.name!r}.look"
        raise InputError(run.folder / RUN_FILE, where, f"{marker.look!r}: no tracker is registered for this look")
    return tracker


# those that are there ------------------------------------------------------------------------------------------------


@register_tracker("led", "disc")
def _spots(run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend) -> Follower:
    """One for all lights and discs."""
    return SpotFollower(run, markers, mapping, backend)


@register_tracker("aruco:N", "apriltag:N", "aruco:DICTIONARY:N", "apriltag:DICTIONARY:N")
def _tags(run: Run, markers: tuple[Marker, ...], *_: object) -> Follower:
    """One for all fiducials."""
    from .patch_follower import FiducialMarks

    return FiducialMarks(run, markers)


@register_tracker("template", each=True)
def _template(run: Run, markers: tuple[Marker, ...], *_: object) -> Follower:
    """One for each template."""
    from .patch_follower import TemplateMark

    return TemplateMark(run, markers)


__all__ = ["TRACKERS", "Begin", "Follower", "Look", "Rows", "Tracker", "followers", "register_tracker"]
