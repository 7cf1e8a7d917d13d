"""corrected.json: a model of one's own with what was missing (docs/gap.md)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import Measured, ResultFile, _Part


class PutIn(_Part):
    """Something that was missing."""

    effect: str = Field(description="name")
    acts: Literal["equation", "input", "output", "clock"] = Field(description="what it changes")
    on: str = Field(description="name of the state, input or output; empty: the clock")
    code: str = Field(description="what it does, as Python, of its numbers; empty: the model's own file has it")
    memory: str = Field(
        default="",
        description="drive and decay of a state m of its own, m' = drive - decay m, as Python; empty: it has none",
    )
    numbers: dict[str, Measured] = Field(description="in their order")


class CorrectedFile(ResultFile):
    """out/corrected.json."""

    schema_name: Literal["towline/corrected"] = Field(
        default="towline/corrected", alias="schema", description="this file"
    )
    version: int = Field(default=1, description="of the schema")
    model: str = Field(description="name of the model's file")
    numbers: dict[str, Measured] = Field(description="of the model, as fitted")
    effects: list[PutIn] = Field(description="what was missing and is put in; empty: nothing")


__all__ = ["CorrectedFile", "PutIn"]
