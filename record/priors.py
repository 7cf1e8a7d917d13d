"""Priors: what is known of a tow beside its recording, as standard deviations. Frozen here, used by ``identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from .toml import Table, read_toml

_Sd = Annotated[float, Field(ge=0)]
"""A standard deviation: 0 or more."""
_Value = float
LINE_LENGTH_SD_M = 7e-4
"""Of a line's length where nobody says: half a millimetre by rule and knots, half by its stretch, which the stated length may or
may not hold and no simulator here knows (4 N on 8 kN/m)."""
DERIVATIVE_NAMES = ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")
"""The six linear derivatives, in the order of every parameter vector: m-Y_vdot, I-N_rdot, Y_v, Y_r-mU, N_v, N_r."""


class ValuePrior(Table):
    """A Gaussian prior on one derivative, dimensional, at the run's speed."""

    value: _Value = Field(description="mean")
    std: Annotated[float, Field(gt=0)] = Field(description="standard deviation; small = fixed")


class DerivativePriors(Table):
    """Priors on derivatives (a captive test's values, a measured inertia)."""

    m_minus_y_vdot: ValuePrior | None = Field(default=None, description="m - Y_vdot, kg")
    i_minus_n_rdot: ValuePrior | None = Field(default=None, description="I - N_rdot, kg m2")
    y_v: ValuePrior | None = Field(default=None, description="Y_v, N s/m")
    y_r_minus_mu: ValuePrior | None = Field(default=None, description="Y_r - mU, N s")
    n_v: ValuePrior | None = Field(default=None, description="N_v, N s")
    n_r: ValuePrior | None = Field(default=None, description="N_r, N m s")
    k2_m2: ValuePrior | None = Field(default=None, description="K^2 = (I - N_rdot)/(m - Y_vdot), m2")
    y_delta: ValuePrior | None = Field(default=None, description="Y_delta, N/rad; absent: free where a rudder is over")
    n_delta: ValuePrior | None = Field(
        default=None, description="N_delta, N m/rad; absent: free where a rudder is over"
    )
    y_bias_n: ValuePrior | None = Field(default=None, description="Y*, N; absent: none")
    n_bias_n_m: ValuePrior | None = Field(default=None, description="N*, N m; absent: none")


class SurgePriors(Table):
    """What is known of the model along its way (line = "surge", theory.md 10); absent: usual for bare models of its mass."""

    x_udot_kg: ValuePrior | None = Field(
        default=None, description="X_udot, negative, kg; absent: -0.05 +- 0.03 of the mass"
    )
    x_vr_kg: ValuePrior | None = Field(
        default=None, description="X_vr, kg, between 0 and -Y_vdot; absent: 0.45 +- 0.26 of the mass"
    )
    x_vv_kg_m: ValuePrior | None = Field(
        default=None, description="X_vv, kg/m, mostly negative; absent: -0.4 +- 1.2 of mass over length_pp_m"
    )
    x_rr_kg_m: ValuePrior | None = Field(
        default=None, description="X_rr, kg m; absent: 0 +- 0.02 of mass times length_pp_m"
    )
    resistance_exponent: ValuePrior | None = Field(default=None, description="n of R ~ u^n; absent: 1.85 +- 0.1")


class Priors(Table):
    """[priors] in run.toml, or a priors.toml of its own. 0 = taken as exact; biases: absent = free."""

    tension_sd_rel: _Sd = Field(default=0.0, description="scatter of T from run to run, relative; 0: T as stated")
    tow_point_sd_m: _Sd = Field(default=0.0, description="scatter of X_T from run to run")
    tension_common_sd_rel: _Sd = Field(
        default=0.0,
        description="error of T common to all runs, relative: moves all derivatives together, unseen by the motion",
    )
    line_length_sd_m: _Sd = Field(
        default=LINE_LENGTH_SD_M,
        description="error of L common to all runs: the rule, the knots, the stretch under the tension",
    )
    speed_sd_rel: _Sd = Field(default=0.0, description="error of U common to all runs, relative")
    y_bias_sd_m: _Sd | None = Field(default=None, description="datum bias y_b of a run; absent: free", examples=[0.002])
    beta_bias_sd_rad: _Sd | None = Field(
        default=None, description="datum bias beta_b of a run; absent: free", examples=[0.003]
    )
    marker_depth_sd_m: _Sd = Field(
        default=0.0, description="error of each marker's depth_m, the same in all runs of a model"
    )
    marker_place_sd_m: _Sd = Field(default=0.0, description="error of each marker's body_m along and across")
    tension_zero_sd_n: _Sd = Field(default=0.0, description="line = surge: zero error of a load cell's history, N")
    tension_delay_sd_s: _Sd = Field(
        default=0.2, description="line = surge: error of tension_delay_s; it costs next to nothing"
    )
    surge: SurgePriors = Field(default_factory=lambda: SurgePriors(), description="of the model along its way")
    derivatives: DerivativePriors = Field(
        default_factory=lambda: DerivativePriors(), description="priors on the derivatives themselves"
    )

    @property
    def line_is_usual(self) -> bool:
        """Nobody said how well the line's length is known: ``LINE_LENGTH_SD_M`` holds."""
        return "line_length_sd_m" not in self.model_fields_set


def read_priors(path: str | Path) -> Priors:
    """A priors.toml.

    Raises
    ------
    InputError : names file, key, value and what was expected
    """
    return read_toml(path, Priors)
