"""The text of a new run.toml: values with the schema's own words beside them, and every key left out as a comment."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any

import tomlkit
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from .reference import _model_in
from .schema import RunFile
from .toml import described

COMMENT_AT = 36
"""Column at which the words beside a value begin."""
ASSUMED = "TODO a default, nobody gave it: "
EXAMPLE = "example: "
"""Before the words of a key whose commented value only shows how it is written; the other commented values are defaults."""
PLACEHOLDER = "TODO_"
"""Begins the names of datum points that nobody picked."""
UNKNOWN_PX, UNKNOWN_M = 100.0, 1.0
"""Standard deviations of such points: what is worked out from them is as uncertain as they are."""
# Words alone have two #, so that all keys together can be put in force by taking one # off every line.
_HEAD = f"""\
## A run of towline: what was filmed, how the camera saw it, how the model was towed. Paths start at this folder.
## Axes: x ahead, y to starboard, depth downwards; pixels: u right, v down. m, s, kg, N, rad.
## `# key = value` may be left out: the value is the default, or, under "{EXAMPLE.strip()}", shows how it is written.
"""
_DATUM_HEAD = f"""\
## TODO datum: at least 4 points of known place, not on one line. These are an EXAMPLE that nobody picked; nothing is computed
## from them. Put in what the points are, where they lie in the picture and in the tank; then rename them and take out
## sigma_px = {UNKNOWN_PX:g} and tank_sd_m = {UNKNOWN_M:g}.
"""


def field_of(key: str) -> FieldInfo:
    """The schema's field of a key of run.toml ("tow.speed_m_s"; "marker.depth_m" for those of an array's tables).

    Raises
    ------
    KeyError : no such key
    """
    model: Any = RunFile
    *tables, last = key.split(".")
    for table in tables:
        model = _model_in(model.model_fields[table].annotation)
    return model.model_fields[last]


def checked_value(key: str, value: Any) -> Any:
    """``value`` if the schema takes it for ``key``.

    Parameters
    ----------
    key : dotted, as "tow.speed_m_s"
    value : to be checked

    Raises
    ------
    ValueError : says what is wrong with it ("1280 is outside 0 .. 30 m/s (carriage speed; is it in mm/s?)")
    """
    field = field_of(key)
    kind: Any = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        message = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise ValueError(f"{message[0].lower()}{message[1:]}") from None


def example_datum(size_px: tuple[int, int], ahead_m: float, behind_m: float, beside_m: float) -> list[dict[str, Any]]:
    """Four datum points that stand in for those to be picked, with standard deviations that say so.

    Parameters
    ----------
    size_px : of the picture; the points are drawn together towards its top, as a camera that looks down at an angle sees them
    ahead_m, behind_m : x of the far and the near ones
    beside_m : how far from the middle of the tank
    """
    width, height = size_px
    points: list[dict[str, Any]] = []
    for far, inwards, v, x in (("far", 0.3, 0.2, ahead_m), ("near", 0.1, 0.9, behind_m)):
        for side, u, y in (("port", inwards, -beside_m), ("starboard", 1.0 - inwards, beside_m)):
            points.append(
                {
                    "name": f"{PLACEHOLDER}{far}_{side}",
                    "pixel_px": [round(u * width, 1), round(v * height, 1)],
                    "tank_m": [round(x, 3), round(y, 3), 0.0],
                    "sigma_px": UNKNOWN_PX,
                    "tank_sd_m": UNKNOWN_M,
                }
            )
    return points


def left_of_template(file: RunFile, size_px: tuple[int, int] | None) -> tuple[str, str] | None:
    """Datum points that are still the example of ``towline init``: the key and words; None where they were picked.

    Parameters
    ----------
    file : run.toml's content
    size_px : of the video's picture, where there is one
    """
    for index, point in enumerate(file.datum, 1):
        where = f'datum[{index} "{point.name}"]'
        if point.name.startswith(PLACEHOLDER):
            return (
                f"{where}.name",
                f"is still the example of towline init, which nobody picked; expected: the point's own name, pixel_px picked in "
                f"the picture and tank_m measured in the tank, without sigma_px = {UNKNOWN_PX:g} and tank_sd_m = {UNKNOWN_M:g}",
            )
        if point.sigma_px == UNKNOWN_PX and point.tank_sd_m == UNKNOWN_M:
            return (
                f"{where}.sigma_px",
                f"{UNKNOWN_PX:g}, and tank_sd_m = {UNKNOWN_M:g}, are still those of towline init's example; expected: how well the "
                "point was picked and is known, or neither key",
            )
    size = size_px or (file.camera.image_size_px if file.camera else None)
    if size is None:
        return None
    example = {tuple(point["pixel_px"]) for point in example_datum(size, 0.0, -1.0, 1.0)}
    same = [i for i, p in enumerate(file.datum, 1) if tuple(p.pixel_px) in example]
    if len(same) < len(example):
        return None
    return (
        "datum.pixel_px",
        "the points lie where towline init's example has them; expected: places picked in the picture",
    )


def run_text(content: Mapping[str, Any], assumed: Collection[str], size_px: tuple[int, int] | None = None) -> str:
    """The text of a run.toml.

    Parameters
    ----------
    content : the tables, as TOML holds them
    assumed : keys ("tow.speed_m_s") whose value is a default; they are marked
    size_px : of the picture, for the example of a [camera]
    """
    parts = [_HEAD]
    scalars = [name for name, field in RunFile.model_fields.items() if _model_in(field.annotation) is None]
    parts.append("\n".join(_line(name, RunFile.model_fields[name], content, "", assumed) for name in scalars) + "\n")
    for name, field in RunFile.model_fields.items():
        model = _model_in(field.annotation)
        if model is None or name == "cameras":  # a new run has one camera, and [camera] is its lens
            continue
        value = content.get(name)
        if isinstance(value, Sequence):
            parts.append(_array(name, model, value, assumed))
        elif value is not None:
            parts.append(f"[{name}]  # {field.description}\n" + _lines(model, value, f"{name}.", assumed))
        elif name == "camera":
            parts.append(_left_out(name, field, model, {} if size_px is None else {"image_size_px": list(size_px)}))
        else:
            parts.append(_left_out(name, field, model, {}))
    return "\n".join(parts)


def _array(name: str, model: type[BaseModel], rows: Sequence[Mapping[str, Any]], assumed: Collection[str]) -> str:
    """The tables of an array; what may be left out is said once, with the first."""
    unpicked = name == "datum" and any(str(row.get("name", "")).startswith(PLACEHOLDER) for row in rows)
    texts = [
        f"[[{name}]]\n" + _lines(model, row, f"{name}.{number}.", assumed, first=number == 1)
        for number, row in enumerate(rows, 1)
    ]
    return (_DATUM_HEAD if unpicked else "") + "\n".join(texts)


def _lines(
    model: type[BaseModel], row: Mapping[str, Any], prefix: str, assumed: Collection[str], first: bool = True
) -> str:
    if not first:
        guessed = {name: f"  # {ASSUMED.rstrip(': ')}" if prefix + name in assumed else "" for name in row}
        return "".join(
            f"{f'{name} = {_toml(value)}':{COMMENT_AT}}{guessed[name]}".rstrip() + "\n" for name, value in row.items()
        )
    return "".join(_line(name, field, row, prefix, assumed) + "\n" for name, field in model.model_fields.items())


def _line(name: str, field: FieldInfo, row: Mapping[str, Any], prefix: str, assumed: Collection[str]) -> str:
    if name in row:
        words = (ASSUMED if prefix + name in assumed else "") + described(field)
        return f"{f'{name} = {_toml(row[name])}':{COMMENT_AT}}  # {words}"
    if _model_in(field.annotation) is not None:
        return f"# [{prefix}{name}]  # {described(field)}"
    return _commented(name, field)


def _left_out(name: str, field: FieldInfo, model: type[BaseModel], known: Mapping[str, Any]) -> str:
    """A table, or the first of an array's, as a comment; tables within it are only named."""
    header = f"[[{name}]]" if field.default == () else f"[{name}]"
    lines = [f"# {header}  # {field.description}; optional"]
    for key, inner in model.model_fields.items():
        if _model_in(inner.annotation) is None:
            lines.append(_commented(key, inner, known.get(key)))
        else:
            lines.append(f"# [{name}.{key}]  # {described(inner)}")
    return "\n".join(lines) + "\n"


def _commented(name: str, field: FieldInfo, known: Any = None) -> str:
    """A key as a comment: with what is known, else the schema's example of it, which is marked, else its default."""
    words, value = described(field), field.default if known is None else known
    if known is None and field.examples:
        words, value = EXAMPLE + words, field.examples[0]
    return f"{f'# {name} = {_toml(value)}':{COMMENT_AT}}  # {words}"


def _toml(value: Any) -> str:
    return tomlkit.item(list(value) if isinstance(value, tuple) else value).as_string()
