"""day.json: where a day of tows filmed live stands, as it was said after the last one."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import Measured, ResultFile, _Part


class DayWish(_Part):
    """One derivative against what is wished of it."""

    value: float | None = Field(description="dimensional, SI, at the day's speed; null: not determined")
    std: float | None = Field(description="standard deviation of value")
    unit: str = Field(description="unit of value; empty where there is none")
    percent: float | None = Field(description="half-width of the 95 % interval, % of value")
    wished_percent: float | None = Field(description="of plan.toml; null: no plan was given")
    met: bool | None = Field(description="percent is no more than what is wished; null: nothing is wished")


class DayNext(_Part):
    """The tow that helps most next."""

    tow_point_m: float = Field(description="X_T ahead of LCG")
    line_length_m: float = Field(description="L")
    speed_m_s: float = Field(description="U")
    release_y_m: float = Field(description="y_CG at the release, at rest")
    release_beta_rad: float = Field(description="heading at the release")
    percent: dict[str, float] = Field(description="half-widths expected with it, %, by derivative")


class DayFile(ResultFile):
    """day.json."""

    schema_name: Literal["towline/day"] = Field(default="towline/day", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    tows: list[str] = Field(description="folders of the tows that are fitted together, in their order")
    repeat: dict[str, str] = Field(description="tows that cannot be used, and why: to be repeated")
    named: dict[str, list[str]] = Field(description="what was named while a tow was filmed, where it may spoil the tow")
    derivatives: dict[str, DayWish] = Field(description="the six, by their names")
    x_v_m: Measured | None = Field(description="X_v = N_v / Y_v, ahead of LCG; null: not determined")
    enough: bool = Field(description="every wish is met")
    next_tow: DayNext | None = Field(description="null: the wish is met, there is no plan, or no tow is possible")
    problem: str = Field(description="why there are no derivatives; empty: there are")
    words: list[str] = Field(description="the same in sentences")


__all__ = ["DayFile", "DayNext", "DayWish"]
