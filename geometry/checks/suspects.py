"""Mistakes that people make in a run.toml, each as the change that would take it back.

A suspect knows its key, says what is stated and what was expected, and gives the set-up as it would be without the mistake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from ...record.schema import DatumPoint, Marker, RunFile

UNITS: dict[str, float] = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254, "feet": 0.3048, "km": 1e3}
"""Lengths that are taken for metres; km is a metre that was divided by a thousand once too often."""
FORCES: dict[str, float] = {"kgf": 9.80665, "grams-force": 9.80665e-3, "kN": 1e3, "mN": 1e-3}
"""Forces that are taken for newtons."""
DEGREE = math.pi / 180
"""Radians."""
SIZES_PX = (
    (320, 240), (640, 360), (640, 480), (720, 480), (720, 576), (800, 600), (848, 480), (854, 480), (960, 540), (960, 720),
    (1024, 768), (1280, 720), (1280, 800), (1280, 960), (1280, 1024), (1440, 1080), (1600, 900), (1600, 1200), (1920, 1080),
    (1920, 1200), (2048, 1536), (2304, 1296), (2448, 2048), (2560, 1440), (2704, 1520), (3840, 2160), (4000, 3000), (4096, 2160),
)  # fmt: skip
"""Pictures that cameras make, width and height."""

Change = Callable[[RunFile], RunFile]


@dataclass(frozen=True)
class Suspect:
    """A mistake that may have been made.

    Attributes
    ----------
    kind : y mirrored, wrong sign, exchanged, wrong unit, degrees, other picture
    keys : of run.toml that hold it
    stated : their value, as text; "" where it is long
    words : what it seems to be, and what was expected
    without : the set-up -> the set-up without it
    unit : that stands in the words; None where it is no unit
    """

    kind: str
    keys: tuple[str, ...]
    stated: str
    words: str
    without: Change
    unit: str | None = None


def suspects(file: RunFile, film_size_px: tuple[int, int] | None, seen: bool, points: bool) -> Iterator[Suspect]:
    """All mistakes that are looked for in a set-up.

    Parameters
    ----------
    file : run.toml's content
    film_size_px : of the video's picture, where there is one
    seen : also those of datum, marks and picture; else those of single keys only
    points : also those of single datum points and of the picture
    """
    if seen and file.source.motion is None:
        yield from _datum(file)
        if points:
            yield from _single_points(file)
            yield from _pictures(file, film_size_px)
        yield from _marks(file)
    yield from _lengths(file)
    yield from _forces_and_angles(file)


# the datum -------------------------------------------------------------------------------------------------------------


def _datum(file: RunFile) -> Iterator[Suspect]:
    points = file.datum
    key = "datum.tank_m"

    def place(change: Callable[[tuple[float, float, float]], tuple[float, float, float]]) -> Change:
        return lambda f: _with(f, datum=tuple(p.model_copy(update={"tank_m": change(p.tank_m)}) for p in f.datum))

    yield Suspect(
        "y mirrored", (key,), "", "y seems mirrored; it counts to starboard, to the right of one who looks along x",
        place(lambda t: (t[0], -t[1], t[2])),
    )  # fmt: skip
    yield Suspect(
        "x mirrored", (key,), "", "x seems mirrored; it counts ahead, the way the model is towed",
        place(lambda t: (-t[0], t[1], t[2])),
    )  # fmt: skip
    yield Suspect(
        "turned", (key,), "", "x and y both seem of the wrong sign; x counts ahead, the way of the tow, y to starboard",
        place(lambda t: (-t[0], -t[1], t[2])),
    )  # fmt: skip
    yield Suspect(
        "x for y", (key,), "", "x and y seem exchanged; tank_m is [ahead, to starboard, depth]",
        place(lambda t: (t[1], t[0], t[2])),
    )  # fmt: skip
    deepest = max(p.tank_m[2] for p in points)
    if deepest > 0:
        words = "the depths seem to be heights; the third number counts downwards from the datum plane"
        yield Suspect("wrong sign", (key,), "", words, place(lambda t: (t[0], t[1], -t[2])))
        yield Suspect("wrong sign", (key,), "", words, place(lambda t: (t[0], t[1], deepest - t[2])))
    for unit, metres in UNITS.items():
        yield _unit((key,), "", unit, place(lambda t, k=metres: (k * t[0], k * t[1], k * t[2])))
        if deepest > 0:
            yield _unit((key,), "", unit, place(lambda t, k=metres: (t[0], t[1], k * t[2])), "the depths")
    yield Suspect(
        "u for v", ("datum.pixel_px",), "", "u and v seem exchanged; pixel_px is [to the right, downwards]",
        lambda f: _with(f, datum=tuple(p.model_copy(update={"pixel_px": p.pixel_px[::-1]}) for p in f.datum)),
    )  # fmt: skip


def _single_points(file: RunFile) -> Iterator[Suspect]:
    points = file.datum
    for i, j in combinations(range(len(points)), 2):
        one, two = _point(points, i), _point(points, j)
        yield Suspect(
            "exchanged", (f"{one}.tank_m", f"{two}.tank_m"), "",
            "the two points seem exchanged: each pixel_px belongs to the other's tank_m",
            lambda f, i=i, j=j: _with(f, datum=_swapped(f.datum, i, j, "tank_m")),
        )  # fmt: skip
    for i, point in enumerate(points):
        where = f"{_point(points, i)}.tank_m"
        for axis, value in enumerate(point.tank_m):
            if not value:
                continue
            name = ("x", "y", "depth")[axis]
            yield Suspect(
                "wrong sign", (where,), str(list(point.tank_m)), f"{name} seems to have the wrong sign",
                lambda f, i=i, a=axis: _with(f, datum=_scaled(f.datum, i, "tank_m", a, -1.0)),
            )  # fmt: skip
            for unit, metres in UNITS.items():
                yield _unit(
                    (where,),
                    str(list(point.tank_m)),
                    unit,
                    lambda f, i=i, a=axis, k=metres: _with(f, datum=_scaled(f.datum, i, "tank_m", a, k)),
                    name,
                )


def _point(points: Sequence[DatumPoint | Marker], index: int) -> str:
    point = points[index]
    table = "marker" if isinstance(point, Marker) else "datum"
    return f'{table}[{index + 1} "{point.name}"]' if point.name else f"{table}[{index + 1}]"


def _swapped(rows: Sequence[Any], i: int, j: int, key: str) -> tuple[Any, ...]:
    answer = list(rows)
    answer[i] = rows[i].model_copy(update={key: getattr(rows[j], key)})
    answer[j] = rows[j].model_copy(update={key: getattr(rows[i], key)})
    return tuple(answer)


def _scaled(rows: Sequence[Any], index: int, key: str, axis: int | None, factor: float) -> tuple[Any, ...]:
    """One row's number, or the one at a place of its list, times a factor."""
    value = getattr(rows[index], key)
    if axis is None:
        changed = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    else:
        changed = tuple(v * (factor if a == axis else 1.0) for a, v in enumerate(value))
    return tuple(r.model_copy(update={key: changed}) if k == index else r for k, r in enumerate(rows))


# marks -----------------------------------------------------------------------------------------------------------------


def _marks(file: RunFile) -> Iterator[Suspect]:
    marks = file.marker

    def every(key: str, change: Callable[[Any], Any]) -> Change:
        return lambda f: _with(f, marker=tuple(m.model_copy(update={key: change(getattr(m, key))}) for m in f.marker))

    sign = "seems to have the wrong sign; depth_m counts downwards from the datum plane, above it is negative"
    yield Suspect(
        "wrong sign", ("marker.depth_m",), _list(m.depth_m for m in marks), sign, every("depth_m", lambda d: -d)
    )
    yield Suspect(
        "y mirrored", ("marker.body_m",), "", "y seems mirrored; the second number counts to starboard",
        every("body_m", lambda b: (b[0], -b[1])),
    )  # fmt: skip
    for unit, metres in UNITS.items():
        yield _unit(
            ("marker.body_m",),
            _list(list(m.body_m) for m in marks),
            unit,
            every("body_m", lambda b, k=metres: (k * b[0], k * b[1])),
        )
        yield _unit(
            ("marker.depth_m",), _list(m.depth_m for m in marks), unit, every("depth_m", lambda d, k=metres: k * d)
        )
    for i, j in combinations(range(len(marks)), 2):
        if marks[i].on == marks[j].on:
            keys = (f"{_point(marks, i)}.body_m", f"{_point(marks, j)}.body_m")
            yield Suspect(
                "exchanged", keys, "", "the two marks seem exchanged: each name stands at the other's place",
                lambda f, i=i, j=j: _with(f, marker=_swapped(f.marker, i, j, "body_m")),
            )  # fmt: skip
    for i, mark in enumerate(marks):
        where = _point(marks, i)
        if len(marks) > 1 and mark.depth_m:
            yield Suspect(
                "wrong sign", (f"{where}.depth_m",), f"{mark.depth_m:g}", sign,
                lambda f, i=i: _with(f, marker=_scaled(f.marker, i, "depth_m", None, -1.0)),
            )  # fmt: skip
        for unit, metres in UNITS.items():
            yield _unit(
                (f"{where}.body_m",),
                str(list(mark.body_m)),
                unit,
                lambda f, i=i, k=metres: _with(f, marker=_scaled(f.marker, i, "body_m", None, k)),
            )
            yield _unit(
                (f"{where}.depth_m",),
                f"{mark.depth_m:g}",
                unit,
                lambda f, i=i, k=metres: _with(f, marker=_scaled(f.marker, i, "depth_m", None, k)),
            )
        for axis, value in enumerate(mark.body_m):
            if not value or not all(mark.body_m):
                continue
            name = ("ahead", "to starboard")[axis]
            for unit, metres in UNITS.items():
                yield _unit(
                    (f"{where}.body_m",),
                    str(list(mark.body_m)),
                    unit,
                    lambda f, i=i, a=axis, k=metres: _with(f, marker=_scaled(f.marker, i, "body_m", a, k)),
                    name,
                )
        for axis, value in enumerate(mark.body_m):
            if value:
                yield Suspect(
                    "wrong sign", (f"{where}.body_m",), str(list(mark.body_m)),
                    f"its {('first', 'second')[axis]} number seems to have the wrong sign; body_m is [ahead, to starboard] of LCG",
                    lambda f, i=i, a=axis: _with(f, marker=_scaled(f.marker, i, "body_m", a, -1.0)),
                )  # fmt: skip


# pictures --------------------------------------------------------------------------------------------------------------


def _pictures(file: RunFile, film_size_px: tuple[int, int] | None) -> Iterator[Suspect]:
    camera = file.camera
    stated = camera.image_size_px if camera else None
    size = film_size_px or stated
    if size is None:
        return
    for wide, high in SIZES_PX:
        for other in ((wide, high), (high, wide)):
            if other == size:
                continue
            across, down = other[0] / size[0], other[1] / size[1]
            yield Suspect(
                "other picture", ("datum.pixel_px",), "",
                f"the points seem to be picked in a picture of {other[0]} x {other[1]}, not in this one of {size[0]} x {size[1]}",
                lambda f, a=across, d=down: _with(
                    f,
                    datum=tuple(
                        p.model_copy(update={"pixel_px": ((p.pixel_px[0] + 0.5) / a - 0.5, (p.pixel_px[1] + 0.5) / d - 0.5)})
                        for p in f.datum
                    ),
                ),
            )  # fmt: skip
            if camera is not None:
                yield Suspect(
                    "other picture", ("camera.image_size_px",), str(list(camera.image_size_px)),
                    f"the lens is of {size[0]} x {size[1]}, the points seem to be of a picture of {other[0]} x {other[1]}",
                    lambda f, a=across, d=down, o=other: _with(f, camera=_resized(f.camera, a, d, o)),
                )  # fmt: skip
                if film_size_px is None:
                    yield Suspect(
                        "other picture", ("camera.image_size_px",), str(list(camera.image_size_px)),
                        f"the lens and the points seem to be of a picture of {other[0]} x {other[1]}",
                        lambda f, o=other: _with(f, camera=f.camera.model_copy(update={"image_size_px": o})) if f.camera else f,
                    )  # fmt: skip


def _resized(camera: Any, across: float, down: float, size: tuple[int, int]) -> Any:
    return camera.model_copy(
        update={
            "image_size_px": size,
            "fx_px": camera.fx_px * across,
            "fy_px": camera.fy_px * down,
            "cx_px": (camera.cx_px + 0.5) * across - 0.5,
            "cy_px": (camera.cy_px + 0.5) * down - 0.5,
        }
    )


# single keys -----------------------------------------------------------------------------------------------------------

LENGTHS = (
    ("tow", "line_length_m"), ("tow", "tow_point_m"), ("tow", "tow_point_offset_m"), ("tow", "post_m"),
    ("tow", "post_amplitude_m"), ("model", "length_pp_m"), ("model", "beam_m"), ("model", "rudder_arm_m"),
    ("water", "tank_width_m"), ("priors", "tow_point_sd_m"), ("priors", "line_length_sd_m"), ("priors", "y_bias_sd_m"),
    ("priors", "marker_depth_sd_m"), ("priors", "marker_place_sd_m"),
)  # fmt: skip
"""Keys that hold a length."""
SIGNED = (
    ("tow_point_m", "it counts ahead of LCG"), ("tow_point_offset_m", "it counts to starboard"),
    ("post_m", "it is [ahead, to starboard] in tank axes"),
)  # fmt: skip
"""Lengths of [tow] that have a side."""


def _lengths(file: RunFile) -> Iterator[Suspect]:
    for table, key in LENGTHS:
        value = _value(file, table, key)
        if not value or value == (0.0, 0.0):
            continue
        for unit, metres in UNITS.items():
            yield _unit((f"{table}.{key}",), _text(value), unit, lambda f, t=table, n=key, k=metres: _times(f, t, n, k))
    for key, side in SIGNED:
        value = _value(file, "tow", key)
        if value and value != (0.0, 0.0):
            yield Suspect(
                "wrong sign", (f"tow.{key}",), _text(value), f"it seems to have the wrong sign; {side}",
                lambda f, n=key: _times(f, "tow", n, -1.0),
            )  # fmt: skip
    for unit, metres in UNITS.items():
        yield _unit(
            ("datum.tank_m", "marker", "tow", "model", "water"),
            "",
            unit,
            lambda f, k=metres: _all(f, k, True),
            "all lengths",
        )
        yield _unit(
            ("marker", "tow", "model"), "", unit, lambda f, k=metres: _all(f, k, False), "all lengths of the model"
        )
    mass = _value(file, "model", "mass_kg")
    if mass:
        for unit, kilograms in (("g", 1e-3), ("tonnes", 1e3)):
            yield Suspect(
                "wrong unit", ("model.mass_kg",), f"{mass:g}", f"it seems to be in {unit}; kg are expected",
                lambda f, k=kilograms: _times(f, "model", "mass_kg", k),
            )  # fmt: skip


def _forces_and_angles(file: RunFile) -> Iterator[Suspect]:
    tow = file.tow
    if tow is not None:
        key = "tension_n" if tow.tension is None else "tension"
        stated = f"{tow.tension_n:g}" if tow.tension is None and tow.tension_n is not None else tow.tension or ""
        for unit, newtons in FORCES.items():
            yield Suspect(
                "wrong unit", (f"tow.{key}",), stated, f"it seems to be in {unit}; newtons are expected",
                lambda f, k=newtons: _times(f, "tow", "tension_n", k), unit,
            )  # fmt: skip
    for table, key in (("tow", "rudder_rad"), ("model", "trim_rad"), ("priors", "beta_bias_sd_rad")):
        value = _value(file, table, key)
        if value:
            history = tow.rudder if tow is not None and key == "rudder_rad" else None
            yield Suspect(
                "degrees", (f"{table}.{key}" if history is None else "tow.rudder",), history or f"{value:g}",
                "it seems to be in degrees; radians are expected",
                lambda f, t=table, n=key: _times(f, t, n, DEGREE),
            )  # fmt: skip


# small pieces ----------------------------------------------------------------------------------------------------------


def _unit(keys: tuple[str, ...], stated: str, unit: str, without: Change, what: str = "it") -> Suspect:
    seem = "seem" if what.endswith("s") and what != "it" else "seems"
    return Suspect("wrong unit", keys, stated, f"{what} {seem} to be in {unit}; metres are expected", without, unit)


def _with(file: RunFile, **tables: Any) -> RunFile:
    return file.model_copy(update=tables)


def _value(file: RunFile, table: str, key: str) -> Any:
    held = getattr(file, table)
    return None if held is None else getattr(held, key)


def _times(file: RunFile, table: str, key: str, factor: float) -> RunFile:
    held: Any = getattr(file, table)
    value: Any = None if held is None else getattr(held, key)
    if value is None:
        return file
    changed = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    return _with(file, **{table: held.model_copy(update={key: changed})})  # pyright: ignore[reportOptionalMemberAccess]


def _all(file: RunFile, factor: float, tank: bool) -> RunFile:
    """Every length times a factor; the tank's too, or only the model's and its line's."""
    for table, key in LENGTHS:
        if table != "priors" and (tank or (table, key) not in (("water", "tank_width_m"), ("tow", "post_m"))):
            file = _times(file, table, key, factor)
    for index in range(len(file.marker)):
        for key in ("body_m", "depth_m") if tank else ("body_m",):
            file = _with(file, marker=_scaled(file.marker, index, key, None, factor))
    if tank:
        for index in range(len(file.datum)):
            file = _with(file, datum=_scaled(file.datum, index, "tank_m", None, factor))
    return file


def _list(values: Any) -> str:
    return ", ".join(str(v) if isinstance(v, list) else f"{v:g}" for v in values)


def _text(value: Any) -> str:
    return str(list(value)) if isinstance(value, tuple) else f"{value:g}"


__all__ = ["Suspect", "suspects"]
