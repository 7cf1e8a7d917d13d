"""out/check.json: is the camera geometry right?"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import GaugeResult, Measured, ResultFile, _Part


class FoundFault(_Part):
    """A fault that the recording shows, or one that was tried."""

    kind: str = Field(
        description="lens, deck height, datum point, datum width, camera turned, line length, slack line, ..."
    )
    item: str = Field(description="datum point, mark or run it concerns; empty: the whole set-up")
    evidence: float = Field(description="log Bayes factor against nothing being wrong")
    sizes: dict[str, Measured] = Field(
        description="how large it is, SI, px or relative; empty where it is only screened"
    )
    span_s: tuple[float, float] | None = Field(default=None, description="when: turned between, slack from to")
    sentence: str = Field(description="in words")


class FoundMistake(_Part):
    """A gross mistake that run.toml seems to hold."""

    kind: str = Field(
        description="y mirrored, wrong sign, exchanged, wrong unit, degrees, template, other picture, ..."
    )
    keys: list[str] = Field(
        description="of run.toml that hold it; empty: something cannot be and no single mistake explains it"
    )
    sentence: str = Field(description="in words, with what explains the set-up as well")


class PointCheck(_Part):
    """A datum point."""

    name: str = Field(description="datum point")
    residual_px: tuple[float, float] = Field(description="picked minus projected")
    residual_mm: tuple[float, float] = Field(description="where the pick says it is minus tank_m, x and y")
    sigma_px: float = Field(description="stated picking error")
    used: bool = Field(description="false: left out, the others contradict it")


class MapOfUncertainty(_Part):
    """Common error of places over the working area, at the marks' mean depth."""

    x_m: list[float] = Field(description="grid")
    y_m: list[float] = Field(description="grid")
    x_mm: list[list[float]] = Field(description="standard deviation of x, a row per y_m")
    y_mm: list[list[float]] = Field(description="standard deviation of y, a row per y_m")


class Refined(_Part):
    """A camera parameter estimated from the invariants of all runs."""

    parameter: str = Field(description="name; marks by name")
    stated: float = Field(description="as in run.toml")
    value: float = Field(description="estimate")
    std: float = Field(description="standard deviation")
    unit: str = Field(description="of the three")
    observable: bool = Field(description="false: these runs do not tell it")


class CheckFile(ResultFile):
    """out/check.json."""

    schema_name: Literal["towline/check"] = Field(default="towline/check", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    runs: list[str] = Field(description="runs of this camera set-up")
    verdict: Literal["sound", "fault", "unknown", "mistake"] = Field(
        description="mistake: run.toml holds a gross mistake, no number here means anything until it is mended; sound: nothing is "
        "wrong beyond the tolerances; fault: the first of faults explains it; unknown: something does not fit and nothing tried "
        "explains it"
    )
    sentences: list[str] = Field(description="the verdict in words, what it rests on, what would tell more")
    faults: list[FoundFault] = Field(description="named: the fault and those that cannot be told from it")
    tried: list[FoundFault] = Field(description="every fault tried in full, best first")
    chi_square: float = Field(description="of the joint fit with nothing wrong")
    degrees: int = Field(description="its degrees of freedom")
    inflation: float = Field(description="factor on the marks' variances that their own scatter over time asked for")
    datum: list[PointCheck] = Field(description="per datum point")
    invariants: dict[str, dict[str, Measured]] = Field(
        description="per run: marker distances, taut line; mean minus stated, m"
    )
    tolerances: dict[str, float] = Field(description="standard deviations taken for what is stated, SI, px or relative")
    uncertainty: MapOfUncertainty = Field(description="over the working area")
    effects_percent: dict[str, dict[str, float]] = Field(
        description="per derivative: change by one standard deviation of each camera parameter, %"
    )
    refined: list[Refined] = Field(description="only where asked for")
    refined_words: list[str] = Field(description="what the runs tell of these and what they do not")
    notes: list[str] = Field(description="assumptions and warnings")
    mistakes: list[FoundMistake] = Field(
        default_factory=list, description="gross mistakes of run.toml; where one is named, no fault is"
    )
    gauges: dict[str, GaugeResult] = Field(
        default_factory=dict, description="load cells of lines that keep their length, against the motion, by run"
    )
