"""Looks: what a mark of run.toml may look like. One table that the schema, the tracker, the app and the reference page ask.

A look of one's own is registered together with what follows it (``vision.looks``; docs/developer/look.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from .registry import Registry


@dataclass(frozen=True)
class Look:
    """What a mark may look like.

    Attributes
    ----------
    name : as pages and errors write it: "led", "aruco:N"
    pattern : regular expression of the whole value in run.toml; "": the name as it stands
    words : what it is, for the reference page; "": the name says it
    needs : keys of [[marker]] that it cannot be without, each with what it holds ("the place of the patch in the first frame")
    spot : a spot: the app's detector sees it in a single frame, and ``towline render`` draws it
    example : a value that the app offers; "": the name
    stamp : of the code that follows it, put in when that is registered: tracks are made anew when it changes; "": towline's own
    """

    name: str
    pattern: str = ""
    words: str = ""
    needs: Mapping[str, str] = field(default_factory=dict)
    spot: bool = False
    example: str = ""
    stamp: str = ""

    def takes(self, value: str) -> bool:
        """Whether run.toml's ``value`` is this look."""
        return re.fullmatch(self.pattern or re.escape(self.name), value) is not None


LOOKS: Registry[Look] = Registry("towline.looks")


def register_look(look: Look) -> None:
    """Take a look into the table, behind those that are there; one of its name is replaced."""
    LOOKS.add(look.name, look)


def look_of(value: str) -> Look | None:
    """The first look that takes run.toml's ``value``; None: there is none."""
    return next((look for look in LOOKS.all() if look.takes(value)), None)


def is_spot(value: str) -> bool:
    """Whether run.toml's ``value`` names a spot."""
    look = look_of(value)
    return look is not None and look.spot


def listed() -> str:
    """The looks as the reference page has them: "led | disc | aruco:N", with what they are where the names do not say it."""
    return " | ".join(f"{look.name} ({look.words})" if look.words else look.name for look in LOOKS.here())


def named(wanted: Callable[[Look], bool] = lambda _: True) -> list[str]:
    """Names of the looks that are ``wanted``."""
    return [look.name for look in LOOKS.here() if wanted(look)]


def spot_names() -> list[str]:
    """Names of the looks that are spots."""
    return named(lambda look: look.spot)


def in_words(names: Sequence[str], last: str = " or ") -> str:
    """Names in a sentence: "led, disc or template"."""
    return last.join([", ".join(names[:-1]), *names[-1:]] if len(names) > 1 else names)


for _look in (
    Look("led", spot=True),
    Look("disc", spot=True),
    Look("template", needs={"seen_at_px": "the place of the patch in the first analysed frame"}),
    Look("aruco:N", r"aruco:\d+", example="aruco:0"),
    Look("apriltag:N", r"apriltag:\d+", example="apriltag:0"),
):
    register_look(_look)

__all__ = ["LOOKS", "Look", "in_words", "is_spot", "listed", "look_of", "named", "register_look", "spot_names"]
