"""Result files: JSON, one object a file, with schema, version, the tool's version and a hash of every input."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .errors import InputError
from .files import JSON_BYTES, read_text, write_text

ResultT = TypeVar("ResultT", bound="ResultFile")


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class ResultFile(_Part):
    """Base of every result file."""

    tool: str = Field(description="version of towline that wrote it")
    inputs: dict[str, str] = Field(description="SHA-256 of every input, by its path")
    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_by_name=True, validate_by_alias=True, defer_build=True
    )


class Derivative(_Part):
    """One derivative with its uncertainty."""

    value: float = Field(description="dimensional, SI, at the file's speed_m_s")
    std: float = Field(description="standard deviation of value")
    unit: str = Field(description="unit of value")
    prime: float = Field(description="non-dimensional value (theory.md 2)")
    prime_std: float = Field(description="standard deviation of prime")
    true_value: float | None = Field(default=None, description="where the run carries its truth (rendered runs)")


class Measured(_Part):
    """A number with its standard deviation."""

    value: float = Field(description="value")
    std: float = Field(description="standard deviation")


class RunFit(_Part):
    """How one run was fitted."""

    start: dict[str, Measured] = Field(description="state at the first sample: y_m, beta_rad, v_m_s, r_rad_s")
    bias: dict[str, Measured] = Field(description="datum biases: y_b_m, beta_b_rad")
    nuisance: dict[str, Measured] = Field(description="tension_n, tow_point_m where priors let them move")
    noise: dict[str, float] = Field(
        description="root mean square residuals y_m, beta_rad; and these over the stated sigmas"
    )
    tests: dict[str, float] = Field(
        description="lag-1 autocorrelation of residuals, order of the noise model, Ljung-Box p of the whitened ones"
    )
    samples: int = Field(description="samples used")
    trim_rad: float | None = Field(
        default=None, description="trim of the model, by the stern positive; null: not stated"
    )


class GaugeResult(_Part):
    """A load cell against the motion."""

    scale: Measured = Field(description="what it reads over what pulls, by the swings")
    zero_n: Measured = Field(description="what it reads more")
    delay_s: Measured = Field(description="how late its clock is beyond tension_delay_s")


class TensionResult(_Part):
    """Tension from the motion and the model's mass (line = "surge")."""

    factor: float = Field(description="R from the motion over R as stated")
    log_std: float = Field(description="standard deviation of the factor's logarithm")
    interval: tuple[float, float] = Field(description="95 % interval of the factor")
    stated_std_rel: float | None = Field(description="of what is stated, all runs together; null: nothing is")
    z: float | None = Field(description="found against stated, in standard deviations")
    resistance_n: dict[str, float] = Field(description="R from the motion, by run")
    gauges: dict[str, GaugeResult] = Field(description="load cells, by run")


class FreeResult(_Part):
    """What free runs give beside the derivatives."""

    scale: Literal["tows", "masses", "ratios"] = Field(
        description="where the scale of forces comes from: tows of the same hull; m' and I' of [priors.derivatives]; ratios: it is "
        "not known, derivatives holds forces over m' = m - Y_vdot and moments over I' = I - N_rdot"
    )
    nomoto: dict[str, Measured] = Field(
        description="of r/delta = K (1 + T3 s)/((1 + T1 s)(1 + T2 s)) at speed_m_s, delta positive to port: gain_1_s (K), time_s "
        "(T1 + T2 - T3), t1_plus_t2_s, t1_times_t2_s2, t3_s; they need no scale"
    )
    rudder_rad: dict[str, tuple[float, float]] = Field(description="least and largest rudder angle, by run")


class DerivativesFile(ResultFile):
    """out/derivatives.json."""

    schema_name: Literal["towline/derivatives"] = Field(
        default="towline/derivatives", alias="schema", description="this file"
    )
    version: int = Field(default=1, description="of the schema")
    method: str = Field(description="estimator: output_error, innovations; free_run: runs of kind free")
    form: Literal["linear", "full"] = Field(description="equations fitted: linear or full sine")
    speed_m_s: float = Field(description="speed at which the dimensional values are quoted")
    density_kg_m3: float | None = Field(
        description="rho of the prime system; null: not stated, and not needed (ratios of free runs)"
    )
    length_pp_m: float = Field(description="L of the prime system")
    mass_kg: float = Field(description="m, displacement mass")
    derivatives: dict[str, Derivative] = Field(
        description="m_minus_y_vdot, i_minus_n_rdot, y_v, y_r_minus_mu, n_v, n_r; of free runs also y_delta, n_delta, or without "
        "a scale y_v_over_mass, y_r_minus_mu_over_mass, n_v_over_inertia, n_r_over_inertia, y_delta_over_mass, "
        "n_delta_over_inertia; what is not determined is left out"
    )
    y_vdot_kg: Measured | None = Field(
        default=None, description="Y_vdot alone, with model.dry_mass_kg given and m_minus_y_vdot fixed by the runs"
    )
    n_rdot_kg_m2: Measured | None = Field(
        default=None, description="N_rdot alone, with model.yaw_inertia_kg_m2 or gyration_k2_m2 and i_minus_n_rdot"
    )
    correlation: list[list[float]] = Field(description="of the derivatives, in the order of the keys above")
    straight_line_stable: bool = Field(description="X_r > X_v, that is Y_v N_r - N_v Y_R > 0")
    runs: dict[str, RunFit] = Field(description="per run, by name")
    line: Literal["surge", "constant"] | None = Field(default=None, description="what the tow line keeps, as fitted")
    hull: dict[str, Measured] = Field(
        default_factory=dict,
        description="numbers of the hull beside the six: model along its way, rudder, asymmetry; at speed_m_s",
    )
    tension: TensionResult | None = Field(default=None, description="tension from the motion, where the mass weighs it")
    surge_moves: dict[str, float] | None = Field(
        default=None,
        description='line = "constant": by what share of itself surge in full would move each derivative, computed',
    )
    free: FreeResult | None = Field(default=None, description="free runs: scale, Nomoto's numbers; null: towed runs")
    failed: dict[str, str] = Field(description="runs that could not be used, and why")
    not_identifiable: list[str] = Field(description="what these runs do not fix, in words")
    notes: list[str] = Field(description="what the reader must know")


class SteadyTow(_Part):
    """The steady state of one tow."""

    tow_point_m: float = Field(description="X_T")
    alpha_rad: Annotated[Measured, Field(description="tow line angle")]
    beta_rad: Annotated[Measured, Field(description="heading")]
    force: Measured = Field(description="F = T sin(alpha+beta), in the file's force_unit")
    span_s: tuple[float, float] = Field(description="the part that was taken as steady")
    settled: bool = Field(description="false: the angles still drift within that part")
    trim_rad: float | None = Field(
        default=None, description="trim of the model, by the stern positive; null: not stated"
    )


class TowStability(_Part):
    """What a run's own record says of its stability (3.2.3)."""

    verdict: Literal["settled", "decaying", "swinging", "growing", "drifting", "shearing off"] = Field(
        description="settled: nothing is left that matters; swinging: neither growth nor decay is told"
    )
    lambda_per_s: Measured | None = Field(
        default=None, description="of its swing, or of the real root that shears off; negative = decaying"
    )
    period_s: float | None = Field(default=None, description="of its swing")
    tow_point_m: float = Field(description="X_T")


class NeutralBracket(_Part):
    """X_v between tow points that shear off and tow points that tow stably (4.7.1, 9.2)."""

    above_m: float | None = Field(description="largest X_T that sheared off, X_v lies ahead of it; null: none did")
    below_m: float | None = Field(description="smallest X_T that towed stably, X_v lies aft of it; null: none did")
    sheared_off: list[str] = Field(description="runs that sheared off")
    towed_stably: list[str] = Field(description="runs that settled, off the line behind the post or after a swing")
    agrees: bool | None = Field(description="x_v_interval_m and the bracket overlap; null: nothing to compare")


class SteadySource(_Part):
    """What one source does to X_v of steady tows."""

    source: str = Field(description="what the line is grouped by")
    name: str = Field(description="the input")
    run: str = Field(description="whose it is; empty: common to all tows")
    evaluation: Literal["A", "B"] = Field(description="type of evaluation (JCGM 100, 2.3.2, 2.3.3)")
    contribution_m: float = Field(description="standard uncertainty of X_v by it")
    share: float = Field(description="of the variance of X_v")
    degrees: float | None = Field(description="degrees of freedom; null: infinite")
    origin: str = Field(description="where it comes from")


class SteadySources(_Part):
    """The uncertainty budget of X_v of steady tows."""

    combined_m: float = Field(description="combined standard uncertainty of all lines")
    degrees: float | None = Field(description="effective degrees of freedom (Welch-Satterthwaite); null: infinite")
    coverage_factor: float = Field(description="k of the 95 % interval")
    expanded_m: float = Field(description="U = k times combined_m")
    closure: float = Field(description="relative difference between the lines, combined, and the std of x_v_m")
    lines: list[SteadySource] = Field(description="every source")
    outside: dict[str, str] = Field(description="source that is in no number -> why")


class SteadyFile(ResultFile):
    """out/steady.json."""

    schema_name: Literal["towline/steady"] = Field(default="towline/steady", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    force_unit: Literal["N", "F/R"] = Field(description="of every force: N, or F/R where T was not measured")
    x_v_m: Measured = Field(description="neutral point ahead of LCG, intercept of X_T over 1/F (5.4)")
    x_v_interval_m: tuple[float, float] = Field(description="95 % interval of x_v_m")
    slope: Measured = Field(description="k of X_T = X_v + k/F, in force_unit times m")
    chi2_per_dof: float | None = Field(description="of the line; null for two tows")
    pairs: dict[str, Measured] = Field(description="X_v of every two tows (4.9), by their names")
    y_v: Measured | None = Field(description="Y_v, N s/m, with X_delta known and T measured (5.6)")
    n_v: Measured | None = Field(default=None, description="N_v = X_v Y_v, N s, where Y_v is given")
    y_delta_delta: Measured | None = Field(description="Y_delta delta, N (5.7)")
    n_delta_delta: Measured | None = Field(description="N_delta delta, N m")
    x_v_true_m: float | None = Field(default=None, description="where the runs carry their truth (rendered runs)")
    tows: dict[str, SteadyTow] = Field(description="per run, by name")
    stability: dict[str, TowStability] = Field(
        default={}, description="per run, settled or not: what its own record says"
    )
    x_v_bracket: NeutralBracket | None = Field(
        default=None, description="X_v from which tow points tow stably and which shear off"
    )
    x_v_budget: SteadySources | None = Field(
        default=None, description="what every source does to x_v_m; null: of a file of before"
    )
    failed: dict[str, str] = Field(description="runs that could not be used, and why")
    notes: list[str] = Field(description="what the reader must know")


class DatumResidual(_Part):
    """How one datum point fits."""

    name: str = Field(description="datum point")
    residual_px: tuple[float, float] = Field(description="picked minus projected")
    sigma_px: float = Field(description="stated picking error")


class CameraFile(ResultFile):
    """out/camera.json."""

    schema_name: Literal["towline/camera"] = Field(default="towline/camera", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    method: str = Field(description="pose | two_planes | homography | square_pixels | trapezoid")
    homographies: dict[str, list[list[float]]] = Field(
        description="per marker: undistorted pixel -> tank at its depth, 3 x 3"
    )
    rms_px: float = Field(description="root mean square of the datum residuals")
    datum: list[DatumResidual] = Field(description="per datum point")
    uncertainty_mm: dict[str, float] = Field(description="common error of x, y in the working area: largest, median")
    invariants: dict[str, Measured] = Field(
        description="marker distances and taut-line radius: mean minus stated, in m, with their scatter"
    )
    notes: list[str] = Field(description="assumptions and warnings")


class TruthFile(ResultFile):
    """truth/derivatives.json of a rendered run: what it was made from."""

    schema_name: Literal["towline/truth"] = Field(default="towline/truth", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    speed_m_s: float = Field(description="speed at which the damping derivatives are quoted")
    derivatives: dict[str, float] = Field(description="the six linear derivatives and the rest of the hull")
    x_v_m: float = Field(description="neutral point N_v/Y_v")


def write_result(path: str | Path, result: ResultFile) -> None:
    """Write a result file atomically.

    Parameters
    ----------
    path : of the file
    result : what is written
    """
    content = result.model_dump(mode="json", by_alias=True)
    write_text(path, json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_result(path: str | Path, kind: type[ResultT]) -> ResultT:
    """Read a result file; InputError if it is absent, no JSON, or another schema.

    Parameters
    ----------
    path : of the file
    kind : class of the result that is expected
    """
    path = Path(path)
    text = read_text(path, JSON_BYTES)
    try:
        result = kind.model_validate_json(text)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in fault["loc"])
        raise InputError(path, where, fault["msg"].lower()) from None
    where = _not_finite(result.model_dump(by_alias=True))
    if where is not None:
        raise InputError(path, where, "is not a finite number")
    return result


def _not_finite(value: Any) -> str | None:
    """Where a number that is not finite stands; None: nowhere."""
    if isinstance(value, float):
        return None if math.isfinite(value) else ""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, (list, tuple)) else ()
    for key, one in inner:
        where = _not_finite(one)
        if where is not None:
            return f"{key}.{where}".rstrip(".")
    return None
