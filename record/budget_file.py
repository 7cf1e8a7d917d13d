"""out/budget.json: the uncertainty budget of a fit; and the inputs file that says more of its sources than run.toml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from .errors import InputError
from .results import ResultFile, _Part, read_result
from .toml import Table

BUDGET = "budget.json"

Positive = Annotated[float, Field(gt=0)]
"""Above 0."""


class BudgetInput(Table):
    """[[input]]: what is known of lines of the budget."""

    source: str = Field(description="of the lines, as the budget calls it")
    name: str | None = Field(default=None, description="of the line; absent: every line of the source")
    std: Positive | None = Field(
        default=None, description="standard uncertainty in the line's unit, of an input that the fit takes as exact"
    )
    evaluation: Literal["A", "B"] = Field(default="B", description="type of evaluation of std (JCGM 100)")
    degrees: Positive | None = Field(default=None, description="degrees of freedom of std; absent: infinite")
    origin: str = Field(default="", description="where std comes from, in words")


class BudgetWater(Table):
    """[water]: fresh water by its temperature; the density's line is then known."""

    temperature_deg_c: Annotated[float, Field(ge=0, le=40)] = Field(description="of the water, degrees Celsius")
    temperature_sd_deg_c: Positive = Field(description="its standard uncertainty, thermometer and tank together")


class BudgetInputs(Table):
    """The file of `towline budget --inputs`."""

    water: BudgetWater | None = Field(default=None, description="temperature of the tank's fresh water")
    input: tuple[BudgetInput, ...] = Field(default=(), description="lines of the budget")


class BudgetQuantity(_Part):
    """A derivative or the neutral point with its combined and expanded uncertainty."""

    value: float = Field(description="as estimated, SI, at the file's speed_m_s")
    unit: str = Field(description="of value")
    fit_std: float = Field(description="standard uncertainty by the fit alone, as derivatives.json has it")
    combined_std: float = Field(description="combined standard uncertainty of all lines that are included")
    degrees: float | None = Field(description="effective degrees of freedom (Welch-Satterthwaite); null: infinite")
    coverage_factor: float = Field(description="k of the 95 % interval")
    expanded: float = Field(description="U = k times combined_std")
    prime: float | None = Field(default=None, description="non-dimensional value; of derivatives")
    prime_std: float | None = Field(default=None, description="of prime, the density's own uncertainty in it")


class BudgetLine(_Part):
    """A source of uncertainty."""

    source: str = Field(description="what the line is grouped by")
    name: str = Field(description="the input")
    run: str = Field(default="", description="whose it is; empty: common to all runs")
    evaluation: Literal["A", "B"] = Field(description="type of evaluation (JCGM 100, 2.3.2, 2.3.3)")
    std: float | None = Field(description="standard uncertainty of the input; null: of many inputs, or not stated")
    unit: str = Field(default="", description="of std")
    degrees: float | None = Field(description="degrees of freedom of std; null: infinite")
    origin: str = Field(description="where std comes from; of a line that is not included: why")
    status: Literal["fit", "added", "not included"] = Field(
        description="fit: in the fit's own standard deviation; added: beside it; not included: in no number of this file"
    )
    sensitivity: dict[str, float] = Field(
        default_factory=dict, description="quantity -> its change with one unit more of what is stated"
    )
    contribution: dict[str, float] = Field(
        default_factory=dict, description="quantity -> its standard uncertainty by this"
    )
    share: dict[str, float] = Field(default_factory=dict, description="quantity -> share of its variance")


class CarriedQuantity(_Part):
    """What is computed from the derivatives."""

    value: float | None = Field(description="at the estimate; null: it has none")
    unit: str = Field(description="of value; rad of angles")
    combined_std: float | None = Field(default=None, description="to first order; null: by draws only")
    expanded: float | None = Field(default=None, description="U of the 95 % interval, to first order")
    interval: tuple[float, float] | None = Field(
        description="95 % of draws from the combined covariance (JCGM 101); null: fewer than 95 % of them have it"
    )
    share: float = Field(description="of the draws that have it")


class RepeatedDerivative(_Part):
    """A derivative over repeats of a run."""

    pooled_std: float = Field(description="scatter of single runs about the mean of their set-up, pooled")
    stated_std: float = Field(description="what the lines of a single run say of it")
    degrees: int = Field(description="runs less set-ups")
    ratio: float = Field(description="pooled over stated")
    interval: tuple[float, float] = Field(description="95 % interval of ratio")
    p_value: float = Field(description="chance of a larger scatter, were the lines right")


class BudgetFile(ResultFile):
    """out/budget.json."""

    schema_name: Literal["towline/budget"] = Field(default="towline/budget", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    runs: list[str] = Field(description="their names")
    form: Literal["linear", "full"] = Field(description="equations fitted")
    speed_m_s: float = Field(description="speed at which the values are quoted")
    quantities: dict[str, BudgetQuantity] = Field(
        description="the six derivatives, y_delta and n_delta where the fit has them, and x_v_m"
    )
    correlation: list[list[float]] = Field(description="of the quantities but x_v_m, in their order")
    lines: list[BudgetLine] = Field(description="every source")
    closure: float = Field(
        description="largest relative difference between the lines of the fit, combined, and its own standard deviation"
    )
    stable_probability: float = Field(description="that the hull keeps a straight line, Y_v N_r - N_v Y_R > 0")
    carried: dict[str, CarriedQuantity] = Field(
        description="straight-line stability, turning, zigzag of the linear model"
    )
    repeats: dict[str, RepeatedDerivative] = Field(description="type A check of the whole, by derivative")
    repeated: list[list[str]] = Field(description="names of runs that repeat each other")
    notes: list[str] = Field(description="what the reader must know")


def budget_beside(folder: Path, inputs: Mapping[str, str]) -> BudgetFile | None:
    """budget.json in a folder of results; None where there is none, or it is of other inputs.

    Parameters
    ----------
    folder : where it would lie
    inputs : name of an input -> its SHA-256, as the results beside it state them
    """
    try:
        found = read_result(folder / BUDGET, BudgetFile)
    except InputError:
        return None
    return found if found.inputs == dict(inputs) else None


__all__ = [
    "BUDGET",
    "BudgetFile",
    "BudgetInput",
    "BudgetInputs",
    "BudgetLine",
    "BudgetQuantity",
    "CarriedQuantity",
    "RepeatedDerivative",
    "budget_beside",
]
