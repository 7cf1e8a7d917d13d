"""Looks: what marks and datum points of run.toml may look like. Tables that schema, tracker, app and reference page ask.

A look of one's own is registered together with what follows it, or finds it (``vision.looks``; docs/developer/look.md).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from .registry import Registry
from .tags import dictionary_names, dictionary_pattern


@dataclass(frozen=True)
class Look:
    """What a mark may look like.

    Attributes
    ----------
    name : as pages and errors write it: "led", "aruco:N"
    pattern : regular expression of the whole value in run.toml; "": the name as it stands
    words : what it is, for the reference page; "": the name says it
    limits : of what its name stands for, for errors: "(0..3)"
    needs : keys of [[marker]] that it cannot be without, each with what it holds ("the place of the patch in the first frame")
    spot : a spot: the app's detector sees it in a single frame, and ``towline render`` draws it
    example : a value that the app offers; "": the name
    numbered : each is known by a number that it shows; nobody needs to say where it is
    stamp : of the code that follows it, put in when that is registered: tracks are made anew when it changes; "": towline's own
    """

    name: str
    pattern: str = ""
    words: str = ""
    limits: str = ""
    needs: Mapping[str, str] = field(default_factory=dict)
    spot: bool = False
    example: str = ""
    numbered: bool = False
    stamp: str = ""

    def takes(self, value: str) -> bool:
        """Whether run.toml's ``value`` is this look."""
        return re.fullmatch(self.pattern or re.escape(self.name), value) is not None


LOOKS: Registry[Look] = Registry("towline.looks")
"""Of marks, followed from frame to frame."""
DATUM_LOOKS: Registry[Look] = Registry("towline.looks")
"""Of datum points, which ``towline datum`` finds."""


def register_look(look: Look, table: Registry[Look] = LOOKS) -> None:
    """Take a look into a table, behind those that are there; one of its name is replaced."""
    table.add(look.name, look)


def look_of(value: str, table: Registry[Look] = LOOKS) -> Look | None:
    """The first look that takes run.toml's ``value``; None: there is none."""
    return next((look for look in table.all() if look.takes(value)), None)


def is_spot(value: str) -> bool:
    """Whether run.toml's ``value`` names a spot."""
    look = look_of(value)
    return look is not None and look.spot


def listed(table: Registry[Look] = LOOKS) -> str:
    """The looks as the reference page has them: "led | disc | aruco:N", with what they are where the names do not say it."""
    return " | ".join(f"{look.name} ({look.words})" if look.words else look.name for look in table.here())


def named(table: Registry[Look] = LOOKS) -> list[str]:
    """Names of the looks, each with its limits."""
    return [f"{look.name} {look.limits}".strip() for look in table.here()]


def needing(key: str) -> list[str]:
    """Names of the looks of marks that need a key."""
    return [look.name for look in LOOKS.here() if key in look.needs]


def spot_names() -> list[str]:
    """Names of the looks of marks that are spots."""
    return [look.name for look in LOOKS.here() if look.spot]


def in_words(names: Sequence[str], last: str = " or ") -> str:
    """Names in a sentence: "led, disc or template"."""
    return last.join([", ".join(names[:-1]), *names[-1:]] if len(names) > 1 else names)


_ARUCO, _APRILTAG = dictionary_pattern("aruco"), dictionary_pattern("apriltag")
for _look in (
    Look("led", spot=True),
    Look("disc", spot=True),
    Look("template", needs={"seen_at_px": "the place of the patch in the first analysed frame"}),
    Look("aruco:DICTIONARY:N", rf"aruco:{_ARUCO}:\d+", dictionary_names("aruco"), example="aruco:4x4:0", numbered=True),
    Look(
        "apriltag:DICTIONARY:N",
        rf"apriltag:{_APRILTAG}:\d+",
        dictionary_names("apriltag"),
        example="apriltag:36h11:0",
        numbered=True,
    ),
    Look("aruco:N", r"aruco:\d+", example="aruco:0", numbered=True),
    Look("apriltag:N", r"apriltag:\d+", example="apriltag:0", numbered=True),
):
    register_look(_look)
for _look in (
    Look("mark", words="dot or cross near pixel_px"),
    Look("aruco:DICTIONARY:N:CORNER", rf"aruco:{_ARUCO}:\d+:[0-3]"),
    Look("apriltag:DICTIONARY:N:CORNER", rf"apriltag:{_APRILTAG}:\d+:[0-3]"),
    Look("aruco:N:CORNER", r"aruco:\d+:[0-3]"),
    Look("apriltag:N:CORNER", r"apriltag:\d+:[0-3]", limits="(0..3)"),
    Look("checker:COLSxROWS:I,J", r"checker:\d+x\d+:\d+,\d+", words="inner corners"),
):
    register_look(_look, DATUM_LOOKS)

__all__ = [
    "DATUM_LOOKS",
    "LOOKS",
    "Look",
    "in_words",
    "is_spot",
    "listed",
    "look_of",
    "named",
    "needing",
    "register_look",
    "spot_names",
]
