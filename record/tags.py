"""What printed tags are called in run.toml: aruco:7, or with its dictionary aruco:4x4:7 where tags of several are in one run."""

from __future__ import annotations

import re
from dataclasses import dataclass

DICTIONARIES: dict[str, dict[str, str]] = {
    "aruco": {
        "4x4": "4X4_1000",
        "5x5": "5X5_1000",
        "6x6": "6X6_1000",
        "7x7": "7X7_1000",
        "original": "ARUCO_ORIGINAL",
        "mip_36h12": "ARUCO_MIP_36h12",
    },
    "apriltag": {
        "36h11": "APRILTAG_36h11",
        "25h9": "APRILTAG_25h9",
        "16h5": "APRILTAG_16h5",
        "36h10": "APRILTAG_36h10",
    },
}
"""Kind -> what run.toml calls a dictionary -> OpenCV's name of it; the smaller sets of 4X4 to 7X7 are the beginnings of these."""


@dataclass(frozen=True)
class TagName:
    """A tag as run.toml names it.

    Attributes
    ----------
    kind : "aruco" or "apriltag"
    dictionary : a key of ``DICTIONARIES[kind]``; "" where run.toml does not say
    number : of the tag in its dictionary
    """

    kind: str
    dictionary: str
    number: int

    @property
    def group(self) -> str:
        """Tags of one group are of one dictionary: "aruco", or "aruco:4x4" where it is named."""
        return f"{self.kind}:{self.dictionary}" if self.dictionary else self.kind


def dictionary_pattern(kind: str) -> str:
    """A regular expression of the dictionaries' names, as run.toml and as OpenCV has them ("4x4", "DICT_4X4_50")."""
    names = "|".join(
        rf"{name}(?:_(?:50|100|250|1000))?" if "x" in name else rf"(?:{kind}_)?{name}" for name in DICTIONARIES[kind]
    )
    return rf"(?i:(?:dict_)?(?:{names}))"


def dictionary_names(kind: str) -> str:
    """The dictionaries of a kind for pages and errors: "4x4, 5x5, ..."."""
    return ", ".join(DICTIONARIES[kind])


def tag_name(look: str) -> TagName:
    """Read "aruco:7", "aruco:4x4:7", "aruco:DICT_4X4_50:7", "apriltag:36h11:3".

    Parameters
    ----------
    look : as run.toml has it

    Raises
    ------
    ValueError : no such name, or the dictionary is too small for the number
    """
    for kind, dictionaries in DICTIONARIES.items():
        found = re.fullmatch(rf"{kind}:(?:({dictionary_pattern(kind)}):)?(\d+)", look, re.ASCII)
        if found is None:
            continue
        said, number = (found[1] or "").lower(), int(found[2])
        size = re.search(r"_(50|100|250|1000)$", said)
        if size is not None and number >= int(size[1]):
            raise ValueError(f"look {look!r}: this dictionary ends at {int(size[1]) - 1}")
        return TagName(kind, next((name for name in dictionaries if said and name in said), ""), number)
    raise ValueError(f"look {look!r}: expected aruco:N, apriltag:N, or with a dictionary aruco:4x4:N")


__all__ = ["DICTIONARIES", "TagName", "dictionary_names", "dictionary_pattern", "tag_name"]
