"""out/law.json: the law that the runs miss, as an equation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import Measured, ResultFile, _Part


class LawTerm(_Part):
    """One term of a law."""

    text: str = Field(description="of the grammar (docs/law.md), with the numbers that were fitted")
    acts: Literal["Y", "N", "Y and N", "X", "K"] = Field(
        description="side force, moment, or both; X: ahead, a resistance beyond the straight tow's where it is below 0; K: "
        "heeling, which moves nothing but the marks"
    )
    effect: str = Field(description="name of the effect in law.py and law.toml")
    numbers: dict[str, Measured] = Field(
        description="y: of a side force by rho/2 U^2 L^2; n: of a moment by rho/2 U^2 L^3; x: ahead by rho/2 U^2 L^2; k: of "
        "the marks' place aside by U^2/g; then the numbers inside, and of a heel the roll's period, its damping and how far marks "
        "of unlike height turn the heading"
    )
    units: dict[str, str] = Field(default_factory=dict, description="of the numbers; absent: a plain number")


class LawRow(_Part):
    """One law."""

    text: str = Field(description="its terms")
    probability: float = Field(
        description="posterior, with all that is the same force over the range seen, or the same form with its power fixed"
    )
    terms: list[LawTerm] = Field(description="one or two")
    same: list[str] = Field(
        default_factory=list,
        description="other texts of the same force over the range seen, and of the same form with its power fixed",
    )
    shrink: float | None = Field(default=None, description="of the gap on runs kept aside; null: not worked out")


class GoesWith(_Part):
    """Variables that a force without a form may go with."""

    variables: list[list[str]] = Field(description="groups: a function of each, added up")
    share: float = Field(description="of the evidence, every choice of groups taken as likely beforehand")


class FreeForce(_Part):
    """A force without a form: a smooth function (a Gaussian process) of some variables."""

    variables: list[list[str]] = Field(description="groups: a function of each, added up")
    acts: Literal["Y and N", "X", "K"] = Field(
        default="Y and N",
        description="a side force and a moment; X: ahead, a resistance beyond the straight tow's where below 0; K: heeling",
    )
    probability: float = Field(description="posterior, beside laws, effects of the library and noise")
    shrink: float | None = Field(default=None, description="of the gap on runs kept aside; null: not worked out")


class LawFile(ResultFile):
    """out/law.json."""

    schema_name: Literal["towline/law"] = Field(default="towline/law", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    verdict: Literal["law", "form_open", "field", "no_gap", "other", "unknown", "not_searched"] = Field(
        description="law: the rest of the file says which; form_open: candidates only; field: a force without an equation; else "
        "why says why not"
    )
    why: str = Field(default="", description="why there is no law, in words")
    p_law: float = Field(default=0.0, description="probability of all laws together")
    laws: list[LawRow] = Field(default_factory=list, description="the most probable first")
    field: FreeForce | None = Field(default=None, description="the best force without a form; null: none is missing")
    goes_with: list[GoesWith] = Field(
        default_factory=list, description="what the force goes with, whatever its form, the most probable first"
    )
    seen: dict[str, tuple[float, float]] = Field(
        default_factory=dict, description="variable -> smallest and largest value that the runs have seen"
    )
    sentences: list[str] = Field(default_factory=list, description="in plain words")


__all__ = ["FreeForce", "GoesWith", "LawFile", "LawRow", "LawTerm"]
