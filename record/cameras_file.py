"""out/cameras.json: what two cameras that filmed one tow say of each other."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import Measured, ResultFile, _Part


class Difference(_Part):
    """By how much the two cameras differ in one number of the pose, first minus second, where both see the model."""

    mean: float = Field(description="over the rows that both see, as each camera has it by itself; m or rad")
    expected: float = Field(description="its standard deviation by what is stated of datum, lens and marks; m or rad")
    left: float = Field(description="root mean square of what is left once the match is applied; m or rad")


class CamerasFile(ResultFile):
    """out/cameras.json."""

    schema_name: Literal["towline/cameras"] = Field(default="towline/cameras", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    cameras: tuple[str, str] = Field(description="names, the first one's clock is the run's")
    offset_s: Measured = Field(description="what the first one's clock shows when the second one's shows 0")
    rate: Measured = Field(description="how much faster the first one's clock runs than the second one's, relative")
    offset_stated: bool = Field(
        description="run.toml states offset_s; false: it is from the motion, and from flashes where both saw any"
    )
    flash_s: Measured | None = Field(
        default=None,
        description="how much more the first one's clock shows than the second one's, by flashes that both saw; null: none",
    )
    flash_used: bool = Field(
        default=False, description="flash_s counts in offset_s by its weight; false: none, or it contradicts the motion"
    )
    together: int = Field(description="rows that both cameras see")
    rows: dict[str, int] = Field(
        description="rows of motion.csv by camera, as its column camera has them; lost: by neither"
    )
    agree: bool = Field(description="they differ by no more than what is stated of them lets expect")
    probability: float = Field(
        description="of a difference as large, if all is as stated; below 0.001 they do not agree"
    )
    chi_square: float = Field(description="of their common errors against what is stated of these")
    degrees: int = Field(description="of freedom of chi_square")
    widened: float = Field(
        description="where they do not agree: common standard deviations are so many times what is stated"
    )
    inflation: float = Field(
        description="variance of sums over frames over what single frames let expect; 1: noise is new"
    )
    differences: dict[str, Difference] = Field(
        description="x_m, y_m, heading_rad; where the model rolls also heave_m, roll_rad, pitch_rad"
    )
    rolls: bool | None = Field(
        description="the model rolls, heaves or pitches by more than noise, and y and heading are told with these taken out; null: "
        "its marks do not tell these"
    )
    afloat: dict[str, Measured] = Field(
        description="heave_m, roll_rad, pitch_rad where both see the model: value what it varies by (root mean square about its "
        "mean), std that of a frame; empty: not told"
    )
    sentences: list[str] = Field(description="all of it in words")
