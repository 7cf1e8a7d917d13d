"""plan.toml, what a campaign of tows is to reach and with which tank, and plan.json, what ``towline plan`` answers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .priors import DERIVATIVE_NAMES, Priors
from .results import ResultFile, _Part
from .scenario import HullTable
from .schema import (
    Angle,
    Length,
    Line,
    ModelTable,
    NotNegative,
    Number,
    Positive,
    PositiveLength,
    Speed,
    Tension,
    WaterTable,
)
from .toml import Table

_Several = Annotated[tuple[PositiveLength, ...], Field(max_length=100)]
"""A list of lengths that is tried one by one: not too many."""
TENSION_SD_REL = 0.01
"""Scatter of T and X_T from run to run where the plan states none: choices."""
TOW_POINT_SD_M = 0.001
"""The same of the tow point."""


class TankTable(Table):
    """The tank and its carriage."""

    length_m: PositiveLength = Field(description="way of the carriage")
    lost_m: NotNegative = Field(
        default=0.0, description="of it for starting, settling and braking: no steady speed there"
    )
    width_m: PositiveLength = Field(description="between the walls, the post midway")
    speeds_m_s: Annotated[tuple[Speed, ...], Field(min_length=1, max_length=20)] = Field(
        description="carriage speeds to choose from"
    )

    @model_validator(mode="after")
    def _way_left(self) -> TankTable:
        if self.lost_m >= self.length_m:
            raise ValueError(f"lost_m = {self.lost_m:g} leaves nothing of length_m = {self.length_m:g}")
        if min(self.speeds_m_s) <= 0:
            raise ValueError(f"speeds_m_s: {min(self.speeds_m_s):g}; speeds above 0 are expected")
        return self


class PrimeTable(Table):
    """Six prime derivatives (theory.md 2), not times 1e3."""

    m_minus_y_vdot: Positive = Field(description="(m - Y_vdot)'")
    i_minus_n_rdot: Positive = Field(description="(I - N_rdot)'")
    y_v: Number = Field(description="Y_v'")
    y_r_minus_mu: Number = Field(description="(Y_r - mU)'")
    n_v: Number = Field(description="N_v'")
    n_r: Number = Field(description="N_r'")


class GuessTable(Table):
    """What is thought of the hull: exactly one of these. Sets of another size are scaled by their primes."""

    reference: str | None = Field(default=None, description="ittc | southampton | a CSV of primes (name,value)")
    derivatives: str | None = Field(default=None, description="a derivatives.json")
    prime: PrimeTable | None = Field(default=None, description="prime values")
    dimensional: HullTable | None = Field(default=None, description="as scenario.toml's [hull]")

    @model_validator(mode="after")
    def _one(self) -> GuessTable:
        given = [k for k in ("reference", "derivatives", "prime", "dimensional") if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(
                f"{' and '.join(given) or 'nothing'} given; exactly one of reference, derivatives, prime, dimensional is expected"
            )
        return self


class PlanModel(ModelTable):
    """The ship model; hull_length_m and breadth_m are for the walls."""

    hull_length_m: PositiveLength | None = Field(
        default=None, description="over all, LCG midway; default 1.05 length_pp_m"
    )
    breadth_m: PositiveLength | None = Field(default=None, description="default 0.15 length_pp_m")


class ChoicesTable(Table):
    """What may be set in the tank. Absent lists are filled from the hull's length and X_v."""

    tension_n: Tension | None = Field(
        default=None,
        description="line tension (the resistance) at tension_speed_m_s; taken as growing with U^2; may be left out where "
        "tow.gauge = false: then a bare hull's of this size",
    )
    tension_speed_m_s: Positive = Field(description="speed at which tension_n was measured or estimated")
    tow_points_m: Annotated[tuple[Length, ...], Field(max_length=100)] = Field(
        default=(), description="X_T ahead of LCG; absent: 8 from X_v + 0.05 LBP to X_v + 0.35 LBP"
    )
    line_lengths_m: _Several = Field(default=(), description="L; absent: 0.2, 0.35, 0.5, 0.75 and 1 LBP")
    releases_y_m: Annotated[tuple[Length, ...], Field(max_length=20)] = Field(
        default=(),
        description="y_CG of the release at rest; absent: the farthest that [limits] allow, for every heading",
    )
    releases_beta_rad: Annotated[tuple[Angle, ...], Field(min_length=1, max_length=20)] = Field(
        default=(-0.05, 0.0, 0.05), description="heading of the release, positive bow to starboard"
    )


class WishTable(Table):
    """What is to be reached: half-width of the 95 % interval in % of the derivative."""

    percent: Positive = Field(default=2.0, description="of every derivative not named below")
    m_minus_y_vdot: Positive | None = Field(default=None, description="of m - Y_vdot")
    i_minus_n_rdot: Positive | None = Field(default=None, description="of I - N_rdot")
    y_v: Positive | None = Field(default=None, description="of Y_v")
    y_r_minus_mu: Positive | None = Field(default=None, description="of Y_r - mU")
    n_v: Positive | None = Field(default=None, description="of N_v")
    n_r: Positive | None = Field(default=None, description="of N_r")
    x_v_m: Positive | None = Field(
        default=None,
        description="of X_v by steady tows, half-width in m: what `towline live` waits for while one settles",
    )
    max_runs: Annotated[int, Field(ge=1, le=40)] = Field(default=8, description="runs that may be spent")
    criterion: Literal["A", "D"] = Field(
        default="A", description="A: mean square of sd over wish; D: volume of the joint interval"
    )

    @property
    def percents(self) -> tuple[float, ...]:
        """Per derivative, in the order of ``DERIVATIVE_NAMES``."""
        return tuple(self.percent if getattr(self, n) is None else getattr(self, n) for n in DERIVATIVE_NAMES)


class PlanNoise(Table):
    """Noise of a sample of the motion, white."""

    sigma_y_m: Positive = Field(default=0.001, description="of y_CG")
    sigma_beta_rad: Positive = Field(default=0.00175, description="of beta (0.1 degree)")
    rate_hz: Positive = Field(default=30.0, description="samples per second")
    tension_sd_n: NotNegative = Field(
        default=0.0,
        description="part of T's scatter from run to run that does not shrink with U, beside priors.tension_sd_rel",
    )


class LimitsTable(Table):
    """What a run may not do."""

    wall_m: NotNegative = Field(default=0.05, description="least room between the hull's corner and the wall")
    angle_rad: Positive = Field(
        default=0.26,
        description="largest alpha + beta: at 0.26 (15 degrees) the linear form's line force is 1.1 % too large, and larger "
        "swings drag as no linear hull does",
    )
    cycles: NotNegative = Field(
        default=2.0,
        description="runs with no more are warned of, and not chosen while others remain (the thesis: two are too few)",
    )
    line_share: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.2, description="least line force in the run over its mean; at 0 the line is slack"
    )


class PlanTow(Table):
    """How the runs will be towed and identified."""

    line: Line = Field(
        default="surge",
        description="as run.toml's tow.line. surge: the line keeps its length, larger swings weigh the model; constant: it keeps "
        "its tension (the thesis's approximation): the swing's size only scales the noise",
    )
    gauge: bool = Field(
        default=True,
        description="the tension is measured, to what [priors] and noise.tension_sd_n say; false: no gauge at all, the scale is "
        "free and the model's mass weighs it (line = surge only)",
    )


class PlanRun(Table):
    """One tow."""

    tow_point_m: Length = Field(description="X_T ahead of LCG")
    line_length_m: PositiveLength = Field(description="L")
    speed_m_s: Speed = Field(description="U")
    release_y_m: Length = Field(description="y_CG at the release, at rest")
    release_beta_rad: Angle = Field(default=0.0, description="heading at the release")


class PlanRequest(Table):
    """plan.toml."""

    tank: TankTable = Field(description="the tank and its carriage")
    model: PlanModel = Field(description="the ship model")
    guess: GuessTable = Field(description="what is thought of the hull")
    choices: ChoicesTable = Field(description="what may be set")
    water: WaterTable = Field(default_factory=lambda: WaterTable(), description="the water")
    wish: WishTable = Field(default_factory=lambda: WishTable(), description="what is to be reached")
    noise: PlanNoise = Field(default_factory=lambda: PlanNoise(), description="of the measurement")
    limits: LimitsTable = Field(default_factory=lambda: LimitsTable(), description="what a run may not do")
    priors: Priors = Field(
        default_factory=lambda: Priors(tension_sd_rel=TENSION_SD_REL, tow_point_sd_m=TOW_POINT_SD_M),
        description="as run.toml's; absent altogether: T known to 1 % and X_T to 1 mm in each run, datum biases free",
    )
    tow: PlanTow = Field(default_factory=lambda: PlanTow(), description="the line, and whether its tension is measured")
    run: tuple[PlanRun, ...] = Field(default=(), description="a campaign of your own, judged beside the chosen one")

    @model_validator(mode="after")
    def _scale_told(self) -> PlanRequest:
        if self.tow.gauge and self.choices.tension_n is None:
            raise ValueError("choices.tension_n: missing key; give it, or say tow.gauge = false")
        if self.tow.line == "constant" and not self.tow.gauge:
            raise ValueError(
                'tow.gauge = false: a line = "constant" hides the scale of all forces; a gauge, or line = "surge", is expected'
            )
        return self


class RunForecast(_Part):
    """One tow of a campaign and what it will do."""

    tow_point_m: float = Field(description="X_T")
    line_length_m: float = Field(description="L")
    speed_m_s: float = Field(description="U")
    tension_n: float = Field(description="T taken")
    release_y_m: float = Field(description="y_CG at the release")
    release_beta_rad: float = Field(description="heading at the release")
    duration_s: float = Field(description="usable way over U")
    omega_rad_s: float | None = Field(description="frequency of the swing; null: it does not swing")
    damping_per_s: float = Field(description="of the swing (or of the slowest root), positive = decaying")
    cycles: float = Field(description="in the usable way")
    largest_angle_rad: float = Field(description="of |alpha + beta|")
    wall_room_m: float = Field(description="least room between a corner of the hull and the wall")
    line_share: float = Field(
        description="least line force over T taken; line = constant: from surge of the mass alone"
    )
    warnings: list[str] = Field(description="with both numbers")


class Campaign(_Part):
    """A set of runs and what it is expected to give."""

    runs: list[RunForecast] = Field(description="its tows")
    percent: dict[str, float] = Field(description="per derivative: half-width of its 95 % interval, %")
    sd_percent: dict[str, float] = Field(description="per derivative: standard deviation, %")
    reached: bool = Field(description="every wish")
    correlation: list[list[float]] = Field(description="of the six, in the order of the keys above")


class RuleTable(_Part):
    """A rule of the thesis with this hull's numbers."""

    rule: str = Field(description="in words")
    rows: list[dict[str, float]] = Field(description="its numbers")


class ReleaseRow(_Part):
    """What the chosen tows tell when all are released at one angle of the line, heading 0, at rest (line = surge)."""

    release_deg: float | None = Field(description="alpha at the release; null: as planned")
    scale_sd_percent: float | None = Field(
        description="standard deviation of the scale of all forces (T, and with it the six) without a gauge; null: a run goes "
        "broadside or slackens its line"
    )
    gauged_scale_sd_percent: float | None = Field(description="the same with the gauge of [priors]")
    sd_percent: dict[str, float] | None = Field(description="of the six, with the gauge of [priors]")
    ungauged_sd_percent: dict[str, float] | None = Field(description="of the six, without a gauge")
    least_line_share: float | None = Field(description="least T over R in any of the runs")
    limits: list[str] = Field(description="runs that [limits] forbid there, one sentence each")


class PlanFile(ResultFile):
    """plan.json."""

    schema_name: Literal["towline/plan"] = Field(default="towline/plan", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    speed_m_s: float = Field(description="at which the guess is quoted below")
    guess: dict[str, float] = Field(description="the six derivatives the plan rests on, SI")
    wished_percent: dict[str, float] = Field(description="per derivative")
    candidates: int = Field(description="runs that could be chosen")
    excluded: dict[str, int] = Field(description="runs that could not, by reason")
    excluded_example: dict[str, str] = Field(description="one of each, with both numbers")
    a_optimal: list[Campaign] = Field(description="best campaign of 1, 2, ... runs by the A criterion")
    d_optimal: list[Campaign] = Field(description="the same by the D criterion")
    chosen: Campaign = Field(description="the smallest that reaches every wish; else the largest")
    runs_needed: dict[str, int | None] = Field(
        description="per derivative: runs of the chosen criterion; null: not within max_runs"
    )
    own: Campaign | None = Field(default=None, description="the campaign of [[run]]")
    rules: list[RuleTable] = Field(description="two cycles; L, X_T and U; the transient")
    line: Line = Field(default="constant", description="what the runs' lines keep; files before surge: constant")
    gauge: bool = Field(default=True, description="the tension is measured")
    releases: list[ReleaseRow] = Field(
        default=[],
        description="release against what the scale and the six gain, of the tows of own or chosen; line = surge",
    )
    release_rule: str | None = Field(
        default=None, description="from which release on the model's mass tells T, in words"
    )
    notes: list[str] = Field(description="what the reader must know")
