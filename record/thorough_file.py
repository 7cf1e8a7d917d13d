"""thorough.json: is the fit's optimum the only one, and do its intervals hold by other ways?"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import ResultFile
from .results import _Part as Part


class CheckedDerivative(Part):
    """One derivative by three ways; SI, at the fit's speed."""

    value: float = Field(description="of derivatives.json")
    std: float = Field(description="of derivatives.json")
    bootstrap_std: float | None = Field(
        description="of the fits to drawn records (their mean is pulled by the priors once more, and not given); null: too few "
        "could be fitted"
    )
    profile_interval: tuple[float | None, float | None] | None = Field(
        description="95 %, where the chi-square rises by 3.84 with all else fitted anew; an end is null where it never does; null: "
        "the noise is a force on the hull, or errors of the camera move in the fit, which the profile does not know"
    )


class ThoroughFile(ResultFile):
    """out/thorough.json."""

    schema_name: Literal["towline/thorough"] = Field(
        default="towline/thorough", alias="schema", description="this file"
    )
    version: int = Field(default=1, description="of the schema")
    runs: list[str] = Field(description="of the fit")
    seed: int = Field(description="of what was drawn: the same seed gives the same file")
    starts: int = Field(description="other beginnings of the search, each derivative a factor of about 1.6 off")
    reached: int = Field(description="of them ended at the fit's optimum")
    better: int = Field(description="of them ended at a lower chi-square: then the fit stands in a side valley")
    draws: int = Field(description="records drawn from the fitted model for the bootstrap")
    derivatives: dict[str, CheckedDerivative] = Field(description="by name")
    sentences: list[str] = Field(description="in words")


__all__ = ["CheckedDerivative", "ThoroughFile"]
