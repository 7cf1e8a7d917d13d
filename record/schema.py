"""run.toml: every key of the run folder's description, with its unit, its range and what it means.

The field descriptions here are the reference: ``docs/formats/reference.md`` is generated from them.
Ranges are wide; they are there to catch a value in the wrong unit (mm for m, degrees for radians).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from .looks import DATUM_LOOKS, in_words, listed, look_of, named, needing
from .priors import Priors
from .toml import Table, Words

Line = Literal["surge", "constant"]
Kind = Literal["tow", "forced", "free"]
Colour = Literal["red", "green", "blue", "white", "yellow", "bright", "dark"]

BY_CAMERAS = "[[camera]]"
"""Stands in source.video until the first camera's recording is put there."""
SAME_PLACE_M = 1e-3
"""Two markers (or datum points) nearer than this cannot be told apart in any picture."""
COLLINEAR_RATIO = 1e-3
"""Datum points whose spread across their common line is below this share of the spread along it are collinear."""


def _within(low: float, high: float, unit: str, hint: str):
    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"{value:g} is outside {low:g} .. {high:g} {unit} ({hint})")
        return value

    return AfterValidator(check)


Number = float
"""A float; in TOML an integer will do."""
# Ranges, so wide that what lies outside them is a slip of unit: each says which (the sentence after the unit).
Length = Annotated[Number, _within(-100.0, 100.0, "m", "is it in mm?")]
Depth = Annotated[Number, _within(-20.0, 20.0, "m", "is it in mm?")]
PositiveLength = Annotated[Number, _within(1e-4, 1000.0, "m", "a positive length; is it in mm?")]
Speed = Annotated[Number, _within(0.0, 30.0, "m/s", "carriage speed; is it in mm/s?")]
Angle = Annotated[Number, _within(-math.pi / 2, math.pi / 2, "rad", "is it in degrees?")]
Phase = Annotated[Number, _within(-2 * math.pi, 2 * math.pi, "rad", "is it in degrees?")]
Trim = Annotated[Number, _within(-0.2, 0.2, "rad", "bow up is positive; is it in degrees?")]
Delay = Annotated[Number, _within(-3600.0, 3600.0, "s", "is it in ms?")]
Tension = Annotated[Number, _within(0.0, 1e6, "N", "must not be negative")]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Density = Annotated[Number, _within(500.0, 1500.0, "kg/m3", "is it in g/cm3?")]
Sigma = Annotated[Number, Field(gt=0, le=100)]
NineNotNegative = tuple[
    NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative
]
Pixel = tuple[Number, Number]
Span = tuple[Number, Number]
# A name: one that fits a table's cell and a page.
Name = Annotated[str, Field(min_length=1, max_length=200)]
# A camera's name is a folder's as well.
CameraName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]


class SourceTable(Table):
    """What was recorded: exactly one of video, tracks, motion."""

    video: str | None = Field(
        default=None,
        description="the recording: any container ffmpeg reads, a folder of numbered pictures, or a pattern of their names "
        "(img_%04d.png, *.tif; img_{ms}.png: times in the names, in s, ms, us or ns); path from the run folder",
        examples=["video.mp4"],
    )
    tracks: str | None = Field(
        default=None, description="pixel tracks (tracks.csv or .parquet) made elsewhere", examples=["tracks.csv"]
    )
    motion: str | None = Field(
        default=None, description="motion (motion.csv or .parquet) from a tracking system", examples=["motion.csv"]
    )
    span_s: Span | None = Field(
        default=None, description="the part to analyse, in the source's own time", examples=[[2.0, 40.0]]
    )
    frame_rate_hz: Positive | None = Field(
        default=None,
        description="replaces the recording's own timestamps; of numbered pictures the only ones",
        examples=[50.0],
    )
    exposure_s: NotNegative = Field(
        default=0.0,
        description="exposure time of a frame of the video; t_s is shifted by half of it to the exposure's midpoint "
        "(span_s is not)",
    )

    @model_validator(mode="after")
    def _one_source(self) -> SourceTable:
        given = [name for name in ("video", "tracks", "motion") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"exactly one of video, tracks, motion is needed, found {', '.join(given) or 'none'}")
        if self.span_s is not None and not self.span_s[0] < self.span_s[1]:
            raise ValueError(f"span_s = {list(self.span_s)} must rise")
        return self

    @property
    def file(self) -> str:
        """The one path given."""
        return self.video or self.tracks or self.motion or ""


class NoiseTable(Table):
    """Records of the measurement's own noise."""

    static: str = Field(
        description="the same marks while the model is held still: tracks, or a video", examples=["static.csv"]
    )


class CameraTable(Table):
    """The lens; without this table the picture is taken as free of distortion."""

    image_size_px: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] = Field(
        description="width, height", examples=[[1280, 720]]
    )
    fx_px: Positive = Field(description="focal length along u", examples=[1200.0])
    fy_px: Positive = Field(description="focal length along v", examples=[1200.0])
    cx_px: Number = Field(description="principal point, u", examples=[639.5])
    cy_px: Number = Field(description="principal point, v", examples=[359.5])
    distortion: tuple[Number, Number, Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="k1 k2 p1 p2 k3 of OpenCV's model"
    )
    sd: NineNotNegative = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="standard deviations of fx fy cx cy k1 k2 p1 p2 k3; 0: exact",
    )
    calibration: str | None = Field(
        default=None,
        description="lens.json of towline lens: the covariance of these numbers, instead of sd",
        examples=["lens.json"],
    )


def _found_by() -> str:
    return f"what towline datum finds it by: {listed(DATUM_LOOKS)}"


class DatumPoint(Table):
    """A point of known place, picked in the picture."""

    name: Name = Field(default="", description="what the point is called in reports", examples=["far_port"])
    pixel_px: Pixel = Field(
        description="where it was picked, u right and v down, integers at pixel centres", examples=[[640.0, 360.0]]
    )
    tank_m: tuple[Length, Length, Depth] = Field(
        description="x, y and depth below the datum plane (>= 0); points at a second depth make the height exact",
        examples=[[0.0, 0.0, 0.0]],
    )
    sigma_px: Sigma = Field(default=0.5, description="how well it was picked, standard deviation along u and along v")
    tank_sd_m: NotNegative = Field(
        default=0.0, description="how well tank_m is known, standard deviation along each axis; 0: exact"
    )
    track: bool = Field(default=False, description="re-found in every frame (shaken camera); false: stands as picked")
    look: Annotated[str | None, Words(_found_by)] = Field(default=None, description=_found_by(), examples=["mark"])

    @model_validator(mode="after")
    def _below_datum(self) -> DatumPoint:
        if self.tank_m[2] < 0:
            raise ValueError(f"tank_m depth {self.tank_m[2]:g} m lies above the datum plane; depth is >= 0")
        if self.look is not None and look_of(self.look, DATUM_LOOKS) is None:
            raise ValueError(f"look = {self.look!r}; expected {in_words(named(DATUM_LOOKS))}")
        return self


def _seen_at() -> str:
    return f"where it is in the first analysed frame: needed for {in_words(needing('seen_at_px'), ' and ')}, helps the others"


class Marker(Table):
    """A mark to be found in every frame."""

    name: Name = Field(description="its name in tracks.csv", examples=["bow"])
    body_m: tuple[Length, Length] = Field(
        description='ahead of LCG, to starboard (on = "post": from post_m)', examples=[[1.0, 0.0]]
    )
    depth_m: Depth = Field(description="below the datum plane (negative: above)", examples=[0.0])
    look: Annotated[str, Words(listed)] = Field(default="led", description=listed())
    colour: Colour = Field(default="bright", description="red | green | blue | white | yellow | bright | dark")
    seen_at_px: Annotated[Pixel | None, Words(_seen_at)] = Field(
        default=None, description=_seen_at(), examples=[[640.0, 360.0]]
    )
    on: Literal["model", "post"] = Field(
        default="model", description="what it is fixed to; post: camera fixed to the tank"
    )

    @model_validator(mode="after")
    def _look_known(self) -> Marker:
        look = look_of(self.look)
        if look is None:
            raise ValueError(f"look = {self.look!r}; expected {in_words(named())}")
        for key, held in look.needs.items():
            if getattr(self, key) is None:
                raise ValueError(f'look = "{self.look}" needs {key}, {held}')
        return self


class FilmingTable(Table):
    """[[camera]]: one of two cameras that film the same tow: its recording, on its own clock, its lens and its datum picks."""

    name: CameraName = Field(
        description="what it is called in tables and reports, and its folder in out/", examples=["port"]
    )
    video: str | None = Field(default=None, description="its recording, as source.video", examples=["port.mp4"])
    tracks: str | None = Field(
        default=None, description="its pixel tracks, as source.tracks", examples=["port/tracks.csv"]
    )
    span_s: Span | None = Field(
        default=None, description="the part of it to analyse, in its own time", examples=[[2.0, 40.0]]
    )
    frame_rate_hz: Positive | None = Field(default=None, description="as source.frame_rate_hz", examples=[50.0])
    exposure_s: NotNegative = Field(default=0.0, description="as source.exposure_s")
    offset_s: Delay | None = Field(
        default=None,
        description="of the second camera: what the first one's clock shows when its own shows 0, where that is known (a flash, a "
        "common trigger); absent: found from the motion",
        examples=[1.2],
    )
    offset_sd_s: Positive = Field(default=0.5, description="standard deviation of offset_s")
    seen_at_px: dict[str, Pixel] = Field(
        default_factory=dict,
        description="[camera.seen_at_px] NAME = [u, v]: marker.seen_at_px in this camera's picture",
    )
    lens: CameraTable | None = Field(default=None, description="[camera.lens]: the keys of [camera] of a single camera")
    datum: tuple[DatumPoint, ...] = Field(
        default=(), description="[[camera.datum]]: as [[datum]], picked in this camera's picture"
    )

    @model_validator(mode="after")
    def _whole(self) -> FilmingTable:
        given = [name for name in ("video", "tracks") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"exactly one of video, tracks is needed, found {', '.join(given) or 'none'}")
        if self.span_s is not None and not self.span_s[0] < self.span_s[1]:
            raise ValueError(f"span_s = {list(self.span_s)} must rise")
        check_datum(self.datum)
        return self

    @property
    def source(self) -> SourceTable:
        """Its recording, as [source] of a single camera says it."""
        return SourceTable(
            video=self.video,
            tracks=self.tracks,
            span_s=self.span_s,
            frame_rate_hz=self.frame_rate_hz,
            exposure_s=self.exposure_s,
        )


class TowTable(Table):
    """How the model was towed."""

    speed_m_s: Speed = Field(description="carriage speed U", examples=[1.0])
    speed: str | None = Field(
        default=None,
        description="history of U (t_s, speed_m_s); speed_m_s stays the nominal value",
        examples=["speed.csv"],
    )
    speed_delay_s: Delay = Field(default=0.0, description="t_video = t_speed + speed_delay_s")
    line_length_m: PositiveLength | None = Field(
        default=None, description="L; needed unless kind is free", examples=[1.0]
    )
    tow_point_m: Length | None = Field(
        default=None, description="X_T, ahead of LCG; needed unless kind is free", examples=[1.2]
    )
    tow_point_offset_m: Length = Field(default=0.0, description="Y_T, to starboard")
    post_m: tuple[Length, Length] = Field(default=(0.0, 0.0), description="tow post in tank axes")
    line: Line = Field(
        default="surge",
        description="surge: the line keeps its length, its tension is what the model's own inertia makes it (theory.md 10); "
        "constant: a falling weight or a winch keeps its tension (the thesis's approximation)",
    )
    tension_n: Tension | None = Field(
        default=None,
        description="line = surge: R, the force of a straight tow at speed_m_s (may be left out where the model swings far "
        "enough to be weighed); constant: T (or tension, not both)",
        examples=[4.0],
    )
    tension: str | None = Field(
        default=None,
        description="history of T (t_s, tension_n) on the load cell's own clock; line = surge: an observation, constant: what "
        "moves the model",
        examples=["tension.csv"],
    )
    tension_delay_s: Delay = Field(default=0.0, description="t_video = t_tension + tension_delay_s")
    rudder_rad: Angle = Field(default=0.0, description="rudder angle, positive to port")
    rudder: str | None = Field(
        default=None,
        description="history of the rudder (t_s, rudder_rad) instead of rudder_rad; kind = free: it or rudder_rad is needed to "
        "identify the run",
        examples=["rudder.csv"],
    )
    rudder_delay_s: Delay = Field(default=0.0, description="t_video = t_rudder + rudder_delay_s")
    post_amplitude_m: NotNegative = Field(default=0.0, description="forced: y_o = amplitude sin(2 pi f t + phase)")
    post_frequency_hz: NotNegative = Field(default=0.0, description="forced: f")
    post_phase_rad: Phase = Field(default=0.0, description="forced: phase")

    @model_validator(mode="after")
    def _one_of_each(self) -> TowTable:
        if self.tension_n is not None and self.tension is not None:
            raise ValueError("tension_n and tension are both given; one of them is expected")
        if self.rudder is not None and self.rudder_rad != 0.0:
            raise ValueError("rudder_rad and rudder are both given; one of them is expected")
        return self


class ModelTable(Table):
    """The ship model."""

    length_pp_m: PositiveLength = Field(description="LBP, the length of the prime system", examples=[2.5])
    mass_kg: Positive = Field(description="displacement mass m", examples=[75.0])
    dry_mass_kg: Positive | None = Field(
        default=None,
        description="m of the ballasted model as weighed; with it Y_vdot stands alone in derivatives.json",
        examples=[75.0],
    )
    dry_mass_sd_kg: NotNegative = Field(default=0.0, description="standard deviation of dry_mass_kg")
    yaw_inertia_kg_m2: Positive | None = Field(
        default=None,
        description="I, dry, about the LCG; with it N_rdot stands alone in derivatives.json",
        examples=[30.0],
    )
    yaw_inertia_sd_kg_m2: NotNegative = Field(default=0.0, description="standard deviation of yaw_inertia_kg_m2")
    gyration_k2_m2: Positive | None = Field(
        default=None,
        description="K^2 = I/m of the dry model from its ballast's places; instead of yaw_inertia_kg_m2, not beside it",
        examples=[0.4],
    )
    gyration_k2_sd_m2: NotNegative = Field(default=0.0, description="standard deviation of gyration_k2_m2")
    beam_m: PositiveLength | None = Field(
        default=None, description="beam, by which a touch of the wall is seen; default length_pp_m / 7", examples=[0.36]
    )
    rudder_arm_m: Length | None = Field(
        default=None, description="X_delta ahead of LCG; default -0.45 length_pp_m", examples=[-1.1]
    )
    trim_rad: Trim | None = Field(
        default=None,
        description="trim by the stern (bow up) positive: (draught aft - draught forward)/length_pp_m; absent: not stated. "
        "The derivatives change with it: runs of unlike trim are not fitted together",
        examples=[0.0],
    )

    @model_validator(mode="after")
    def _one_inertia(self) -> ModelTable:
        if self.yaw_inertia_kg_m2 is not None and self.gyration_k2_m2 is not None:
            raise ValueError("yaw_inertia_kg_m2 and gyration_k2_m2 are both given; one of them is expected")
        return self

    @property
    def x_delta_m(self) -> float:
        """X_delta, the rudder's point of action (theory.md 5)."""
        return -0.45 * self.length_pp_m if self.rudder_arm_m is None else self.rudder_arm_m


class WaterTable(Table):
    """The water and the tank."""

    density_kg_m3: Density = Field(default=1000.0, description="rho of the prime system")
    tank_width_m: PositiveLength | None = Field(
        default=None, description="between the walls, which stand at y = +- half of it", examples=[4.0]
    )


class ApartTable(Table):
    """[[measured]]: a number of something the simulator does not know, measured apart: data for `diagnose`."""

    number: Name = Field(
        description="effect.number, as gap.json names it: `frame_rate.rate`", examples=["frame_rate.rate"]
    )
    value: Number = Field(description="what was measured; SI", examples=[0.0])
    sd: Positive = Field(description="its standard deviation", examples=[1e-4])


def _of_one(camera: Any) -> Any:
    """[camera] is the lens of the only camera; [[camera]] are several cameras, which ``cameras`` holds."""
    return None if isinstance(camera, tuple) else camera


def _of_several(camera: Any) -> Any:
    return camera if isinstance(camera, tuple) else ()


class RunFile(Table):
    """run.toml."""

    name: Name = Field(description="name of the run in tables and reports", examples=["run"])
    kind: Kind = Field(default="tow", description="tow | forced (post oscillates) | free (no line)")
    notes: str = Field(default="", description="free text")
    outside: bool = Field(
        default=False,
        description="true: files may be named outside this folder (../x, absolute); else they are refused",
    )
    source: SourceTable = Field(description="what was recorded")
    noise: NoiseTable | None = Field(default=None, description="records of the measurement's own noise")
    camera: Annotated[CameraTable | None, BeforeValidator(_of_one)] = Field(default=None, description="the lens")
    datum: tuple[DatumPoint, ...] = Field(
        default=(), description="at least 4 points, not collinear (none if source.motion)"
    )
    marker: tuple[Marker, ...] = Field(
        default=(), description="at least 2; 1 can be tracked, but gives no motion (none if source.motion)"
    )
    tow: TowTable | None = Field(
        default=None, description="needed unless kind is free; of a free run identify takes speed and rudder"
    )
    model: ModelTable | None = Field(
        default=None, description="needed unless kind is free; identify needs it of free runs too"
    )
    water: WaterTable | None = Field(default=None, description="needed unless kind is free")
    priors: Priors = Field(default_factory=lambda: Priors(), description="what is known beside the recording")
    measured: tuple[ApartTable, ...] = Field(
        default=(), description="numbers of unmodelled effects measured apart (a filmed clock, a tape along the datum)"
    )
    cameras: Annotated[tuple[FilmingTable, ...], BeforeValidator(_of_several)] = Field(
        default=(),
        validation_alias="camera",
        description="two cameras that film the same tow, instead of [source], [camera] and [[datum]]; the first one's clock is the "
        "run's",
    )

    @model_validator(mode="before")
    @classmethod
    def _recorded_by_cameras(cls, content: Any) -> Any:
        """Of several cameras each names its own recording and datum: [source] is the first one's, put in by ``_whole``."""
        if not (isinstance(content, dict) and isinstance(content.get("camera"), tuple)):
            return content
        for key, written in (("source", "[source]"), ("datum", "[[datum]]")):
            if key in content:
                raise ValueError(
                    f"{key}: with [[camera]] each camera has its own; {written} is not expected beside them"
                )
        return {**content, "source": {"video": BY_CAMERAS}}

    @model_validator(mode="after")
    def _whole(self) -> RunFile:
        file = _first_of(self) if self.source.video == BY_CAMERAS else self
        file._check()
        return file

    def _check(self) -> None:
        """Raise ValueError unless the tables are those that a run of this kind and source needs."""
        if self.kind != "free":
            for table in ("tow", "model", "water"):
                if getattr(self, table) is None:
                    raise ValueError(f"{table}: missing table; kind = {self.kind!r} needs it")
            assert self.tow is not None
            for key in ("line_length_m", "tow_point_m"):
                if getattr(self.tow, key) is None:
                    raise ValueError(f"tow.{key}: missing key; kind = {self.kind!r} needs it")
            if self.kind == "forced" and not (self.tow.post_amplitude_m > 0 and self.tow.post_frequency_hz > 0):
                raise ValueError('tow.post_amplitude_m: kind = "forced" needs an amplitude and a frequency above 0')
        if self.source.motion is None:
            check_datum(self.datum)
            check_markers(self.marker)


def _first_of(file: RunFile) -> RunFile:
    """The file as the first of its cameras has it; the joint motion is on that one's clock, whatever span it films."""
    cameras = file.cameras
    if len(cameras) != 2:
        raise ValueError(
            f"camera: {len(cameras)} [[camera]] tables; two are expected ([camera], one bracket, is a lens)"
        )
    if cameras[0].name == cameras[1].name:
        raise ValueError(f"camera: both are called {cameras[0].name!r}")
    if cameras[0].offset_s is not None:
        raise ValueError("camera[1].offset_s: the first camera's clock is the run's; offset_s stands with the second")
    if file.noise is not None:
        raise ValueError("noise: a static record of two cameras cannot be used yet; leave [noise] out")
    for index, camera in enumerate(cameras, 1):
        if unknown := camera.seen_at_px.keys() - {m.name for m in file.marker}:
            raise ValueError(f"camera[{index}].seen_at_px: no [[marker]] is called {sorted(unknown)[0]!r}")
    source = cameras[0].source.model_copy(update={"span_s": None})
    update = {"source": source, "camera": cameras[0].lens, "datum": cameras[0].datum}
    return file.model_copy(update=update)


def check_datum(points: tuple[DatumPoint, ...]) -> None:
    """Raise ValueError unless there are 4 points whose places in the tank span a plane and are all different."""
    if len(points) < 4:
        raise ValueError(f"datum: {len(points)} points, at least 4 are needed")
    tank = np.array([point.tank_m for point in points], dtype=float)
    for i in range(len(points)):
        for j in range(i):
            if np.linalg.norm(tank[i] - tank[j]) < SAME_PLACE_M:
                raise ValueError(f"datum: {_label(points, j)} and {_label(points, i)} stand at one place in tank_m")
            if points[i].pixel_px == points[j].pixel_px:
                raise ValueError(f"datum: {_label(points, j)} and {_label(points, i)} stand at one place in pixel_px")
    for depth in np.unique(tank[:, 2]):
        level = tank[tank[:, 2] == depth, :2]
        if len(level) < 4:
            continue
        spread = np.linalg.svd(level - level.mean(axis=0), compute_uv=False)
        if spread[1] > COLLINEAR_RATIO * spread[0]:
            return
    spread = np.linalg.svd(tank[:, :2] - tank[:, :2].mean(axis=0), compute_uv=False)
    if spread[1] <= COLLINEAR_RATIO * spread[0]:
        raise ValueError("datum: the points are collinear in tank_m; they must span the tank's width and length")


def check_markers(markers: tuple[Marker, ...]) -> None:
    """Raise ValueError unless markers stand at different places under different names, and at least 1 on the model.

    One alone can be tracked; what a motion needs, ``geometry.poses`` asks for.
    """
    if not any(m.on == "model" for m in markers):
        raise ValueError("marker: none on the model; a motion needs at least 2, tracks alone 1")
    for i in range(len(markers)):
        for j in range(i):
            a, b = markers[j], markers[i]
            if a.name == b.name:
                raise ValueError(f"marker: two are called {a.name!r}")
            apart = np.hypot(a.body_m[0] - b.body_m[0], a.body_m[1] - b.body_m[1])
            if a.on == b.on and apart < SAME_PLACE_M:
                raise ValueError(f"marker: {a.name!r} and {b.name!r} stand at one place in body_m {list(a.body_m)}")


def _label(points: tuple[DatumPoint, ...], index: int) -> str:
    return repr(points[index].name) if points[index].name else f"point {index + 1}"
