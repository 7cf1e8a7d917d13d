"""scenario.toml: what to simulate and, with [film], how to film it. The mirror image of run.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema import (
    Angle,
    CameraTable,
    Colour,
    Depth,
    Kind,
    Length,
    Line,
    ModelTable,
    Name,
    NotNegative,
    Number,
    Positive,
    PositiveLength,
    Tension,
    TowTable,
    WaterTable,
    check_markers,
)
from .schema import Marker as RunMarker
from .toml import Table

LevelDn = Annotated[float, Field(ge=0, le=4095)]
"""A level in DN: up to what a sensor of 12 bits gives."""


class TimeTable(Table):
    """How long, how often."""

    duration_s: Positive = Field(description="length of the record")
    rate_hz: Positive = Field(description="samples (and frames) per second")


class HullTable(Table):
    """The linear hull, dimensional at speed_m_s, in SI units (theory.md 2)."""

    speed_m_s: Positive = Field(description="speed at which the damping derivatives are quoted; they grow with U")
    m_minus_y_vdot: Positive = Field(description="m - Y_vdot, kg")
    i_minus_n_rdot: Positive = Field(description="I - N_rdot, kg m2")
    y_v: Number = Field(description="Y_v, N s/m")
    y_r_minus_mu: Number = Field(description="Y_r - mU, N s")
    n_v: Number = Field(description="N_v, N s")
    n_r: Number = Field(description="N_r, N m s")
    y_rdot: Number = Field(default=0.0, description="Y_rdot, kg m (cross added mass)")
    n_vdot: Number = Field(default=0.0, description="N_vdot, kg m (cross added mass)")
    y_delta: Number = Field(default=0.0, description="Y_delta, N/rad at speed_m_s; grows with U^2")
    n_delta: Number = Field(default=0.0, description="N_delta, N m/rad at speed_m_s; grows with U^2")
    y_bias_n: Number = Field(default=0.0, description="Y*, constant sway force of an asymmetric hull at speed_m_s, N")
    n_bias_n_m: Number = Field(
        default=0.0, description="N*, constant yaw moment of an asymmetric hull at speed_m_s, N m"
    )
    x_udot_kg: Number | None = Field(default=None, description="X_udot, kg, negative; absent: -0.05 of model.mass_kg")
    x_vr_kg: Number | None = Field(
        default=None, description="X_vr, kg; absent: half of -Y_vdot = m_minus_y_vdot - mass_kg"
    )
    x_vv_kg_m: Number = Field(default=0.0, description="X_vv, kg/m")
    x_rr_kg_m: Number = Field(default=0.0, description="X_rr, kg m")
    resistance_exponent: Annotated[float, Field(ge=0.5, le=4)] = Field(default=1.85, description="n of R ~ u^n")


class ScenarioTow(TowTable):
    """[tow] as in run.toml; in addition a line = constant may carry the resistance, and a line = surge may be a spring."""

    resistance_n: Tension | None = Field(
        default=None,
        description='R: the line carries T = R/cos(alpha) instead of tension_n (line = "constant"); the same as tension_n '
        '(line = "surge")',
    )
    line_stiffness_n_m: Positive | None = Field(
        default=None,
        description='line = "surge": the line is a spring, line_length_m long without load; absent: it does not stretch',
    )
    line_damping_n_s_m: NotNegative = Field(default=0.0, description="of that spring")

    @model_validator(mode="after")
    def _one_line(self) -> ScenarioTow:
        if self.resistance_n is not None and (self.tension_n is not None or self.tension is not None):
            raise ValueError("resistance_n and tension are both given; one of them is expected")
        if self.line == "constant" and self.line_stiffness_n_m is not None:
            raise ValueError('line_stiffness_n_m: a line = "constant" keeps its tension whatever its length')
        return self


class StartTable(Table):
    """The state at t = 0. The tow point's side (alpha) or y_cg, not both."""

    alpha_rad: Angle | None = Field(default=None, description="tow line angle")
    y_cg_m: Length | None = Field(default=None, description="lateral place of the LCG in tank axes")
    beta_rad: Angle = Field(default=0.0, description="heading")
    v_m_s: Number = Field(default=0.0, description="sway velocity")
    r_rad_s: Number = Field(default=0.0, description="yaw rate")

    @model_validator(mode="after")
    def _one_side(self) -> StartTable:
        if self.alpha_rad is not None and self.y_cg_m is not None:
            raise ValueError("alpha_rad and y_cg_m are both given; one of them is expected")
        return self


class FilmMarker(RunMarker):
    """A mark to draw: [[marker]] as in run.toml, with its light."""

    peak_dn: Positive = Field(default=190.0, description="height of its image above the ground at exposure 1, of 255")
    width_px: Positive = Field(default=1.8, description="standard deviation of the Gaussian point spread")


class PoseTable(Table):
    """Where the camera stands and looks, in tank axes (z down: negative is above the tank top)."""

    place_m: tuple[Length, Length, Length] = Field(description="x, y, z of the lens")
    look_at_m: tuple[Length, Length, Length] = Field(description="the point in the middle of the picture")
    roll_rad: Angle = Field(default=0.0, description="turned about its axis, clockwise as seen from behind")


class FilmDatum(Table):
    """A datum point to mark and to pick."""

    name: Name = Field(description="its name")
    tank_m: tuple[Length, Length, Depth] = Field(description="x, y, depth")


class FilmTable(Table):
    """How the tow is filmed."""

    camera: CameraTable = Field(description="the lens")
    pose: PoseTable = Field(description="where the camera stands")
    datum: tuple[FilmDatum, ...] = Field(description="points of known place, drawn as marks on the strings or walls")
    pick_sigma_px: NotNegative = Field(default=0.15, description="scatter of the picks written into run.toml")
    lens_known: bool = Field(default=True, description="write [camera] into run.toml")
    exposure: Positive = Field(default=1.0, description="brightness of the whole picture")
    read_noise_dn: NotNegative = Field(default=2.0, description="sensor read noise, standard deviation")
    electrons_per_dn: Positive = Field(default=40.0, description="shot noise variance = signal/electrons_per_dn")
    codec: Literal["h264", "hevc", "hevc10", "ffv1"] = Field(
        default="h264", description="H.264, HEVC of 8 or of 10 bits (lossy) or FFV1 (lossless, in .mkv)"
    )
    crf: Annotated[int, Field(ge=0, le=51)] = Field(default=20, description="quality of H.264 or HEVC, lower is better")
    b_frames: Annotated[int, Field(ge=0, le=16)] = Field(
        default=0,
        description="frames of H.264 or HEVC predicted from both sides; they average a mark's motion (cameras write none)",
    )
    water_depth_m: Depth = Field(default=0.25, description="depth of the water line below the tank top")
    ripple: NotNegative = Field(default=1.0, description="height of the ripples' light and shade; 0 = mirror")
    reflection: NotNegative = Field(default=0.25, description="brightness of the marks' mirror images in the water")
    hull_length_m: PositiveLength | None = Field(default=None, description="drawn length; default model.length_pp_m")
    hull_beam_m: PositiveLength | None = Field(default=None, description="drawn beam; default 0.135 of the length")
    hull_colour: Colour = Field(default="red", description="colour of the hull")
    occlusion: tuple[tuple[Number, Number, Name], ...] = Field(
        default=(), description="[from_s, to_s, marker]: spans in which a mark is hidden"
    )


class EffectTable(Table):
    """Something the linear tow does not know (formats.md), as towline diagnose --write-model saves it."""

    name: Name = Field(description="crossflow_drag, cubic_damping, ...")
    numbers: dict[str, Number] = Field(
        default_factory=dict, description="the effect's numbers, SI; absent: without effect"
    )
    form: str = Field(
        default="",
        description="which of the effect's forms, as gap.json names it; empty: the first that has these numbers",
    )


class LawTow(Table):
    """What the line of a law's runs keeps."""

    line: Line | None = Field(default=None, description='"surge": its length; "constant": its tension')


class LawScenario(Table):
    """law.toml: derivatives and law as tables of a scenario (towline diagnose --law)."""

    hull: HullTable | None = Field(default=None, description="the derivatives beside the law")
    tow: LawTow | None = Field(default=None, description="what the line keeps")
    effect: Annotated[tuple[EffectTable, ...], Field(min_length=1)] = Field(description="the law's terms")


class ScenarioFile(Table):
    """scenario.toml."""

    name: Name = Field(description="name of the run")
    kind: Kind = Field(default="tow", description="tow | forced | free")
    notes: str = Field(default="", description="free text, copied into run.toml")
    form: Literal["full", "linear"] = Field(default="full", description="full sine and kinematics, or the linear model")
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="of the picture's noise and of the picks")
    time: TimeTable = Field(description="how long, how often")
    hull: HullTable = Field(description="the hull's derivatives")
    tow: ScenarioTow = Field(description="how the model is towed")
    effect: tuple[EffectTable, ...] = Field(default=(), description="unmodelled effects to add; full form")
    start: StartTable = Field(default_factory=lambda: StartTable(), description="the state at t = 0")
    model: ModelTable = Field(description="the ship model")
    water: WaterTable = Field(default_factory=lambda: WaterTable(), description="water and tank")
    marker: tuple[FilmMarker, ...] = Field(default=(), description="marks to draw; needed to render")
    film: FilmTable | None = Field(default=None, description="needed to render")

    @model_validator(mode="after")
    def _whole(self) -> ScenarioFile:
        if self.kind != "free":
            for key in ("line_length_m", "tow_point_m"):
                if getattr(self.tow, key) is None:
                    raise ValueError(f"tow.{key}: missing key; kind = {self.kind!r} needs it")
            tow = self.tow
            if tow.tension_n is None and tow.tension is None and tow.resistance_n is None:
                raise ValueError("tow.tension_n: missing key (or tension, or resistance_n)")
            if tow.tension is not None and tow.line == "surge":
                raise ValueError(
                    'tow.tension: with line = "surge" the tension follows from the motion; give tension_n (R), or line = '
                    '"constant" to move the model with this history'
                )
        elif self.start.alpha_rad is not None:
            raise ValueError("start.alpha_rad: a free model has no tow line; give start.y_cg_m")
        if self.form == "linear" and self.tow.resistance_n is not None:
            raise ValueError('tow.resistance_n: form = "linear" knows a constant tension only; give tow.tension_n')
        if self.film is not None:
            check_markers(self.marker)
            if len(self.film.datum) < 4:
                raise ValueError(f"film.datum: {len(self.film.datum)} points, at least 4 are needed")
        return self
