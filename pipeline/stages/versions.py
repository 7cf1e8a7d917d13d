"""Of what a kept result was made: its stage's version, the tool's, and all inputs.

Who changes what a stage gives raises its version by one, so that results of before are made anew; a change of a comment, a name or
a page is none. ``tests/test_stages.py`` holds the results on a sample: it fails where they changed and the version did not.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

from ...__version__ import __version__
from ...record.run import Run

Stage = Literal["tracks", "static", "motion", "cameras", "fit"]
VERSIONS: dict[Stage, int] = {"tracks": 8, "static": 1, "motion": 4, "cameras": 8, "fit": 2}
"""Raised by one where a stage's results change. What a stage rests on is in its stamp: motion holds the version of tracks too."""
RESTS_ON: dict[Stage, tuple[Stage, ...]] = {
    "tracks": ("tracks",),
    "static": ("tracks", "static"),
    "motion": ("tracks", "motion"),
    "cameras": ("tracks", "motion", "cameras"),
    "fit": ("tracks", "motion", "fit"),
}
"""Stage -> whose versions its stamp holds."""


def made_by(stage: Stage) -> str:
    """The tool's version and those of a stage and of what it rests on, in words.

    Parameters
    ----------
    stage : its name
    """
    return f"towline {__version__}, " + ", ".join(f"{name} {VERSIONS[name]}" for name in RESTS_ON[stage])


def stamp_of(run: Run, stage: Stage, *options: str, without: Collection[str] = ()) -> str:
    """What stands in a stage's files of a run: a hash over its inputs, its options and ``made_by``.

    Parameters
    ----------
    run : the run folder as read
    stage : its name
    options : in words, all that changes the result and stands in no input
    without : names of inputs that the stage does not depend on
    """
    return run.input_hash(stage, made_by(stage), *options, without=without)


__all__ = ["VERSIONS", "made_by", "stamp_of"]
