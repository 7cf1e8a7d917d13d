"""The keys of run.toml as fields of a form: unit, words, kind of value, and what the schema says of a typed text."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from ..record.reference import _model_in, _type_name
from ..record.schema import RunFile
from ..record.template import checked_value
from ..record.toml import described
from .toml_text import Where

UNITS = {
    "kg_m3": "kg/m³",
    "kg_m2": "kg m²",
    "m_s": "m/s",
    "kg": "kg",
    "px": "px",
    "hz": "Hz",
    "rad": "rad",
    "rel": "of 1",
    "m": "m",
    "s": "s",
    "n": "N",
}
ARRAYS = ("datum", "marker")
DERIVATIVE_UNIT = re.compile(r", (kg m2|N s/m|N m s|N s|kg|m2)$")


@dataclass(frozen=True)
class FormField:
    """One key of run.toml.

    Attributes
    ----------
    where : its place, ("tow", "speed_m_s")
    unit : of its number; "" = none
    words : the schema's sentence
    kind : number | integer | text | truth | choice | numbers
    needed : the table cannot be without it
    default : as text; "" = none
    choices : of kind choice
    count : numbers expected, of kind numbers
    """

    where: Where
    unit: str
    words: str
    kind: str
    needed: bool
    default: str
    choices: tuple[str, ...] = ()
    count: int = 1
    whole: bool = False

    @property
    def key(self) -> str:
        """As errors name it: "tow.speed_m_s"."""
        return ".".join(str(p) for p in self.where if not isinstance(p, int))


@dataclass(frozen=True)
class FormTable:
    """One table of run.toml: its key ("" = the top), what it is for, its fields."""

    name: str
    words: str
    fields: tuple[FormField, ...]


def tables() -> list[FormTable]:
    """All tables but the datum and the markers, in the schema's order."""
    scalars = {name: f for name, f in RunFile.model_fields.items() if _model_in(f.annotation) is None}
    found = [FormTable("", "the run", tuple(_field((name,), f) for name, f in scalars.items()))]
    for name, field in RunFile.model_fields.items():
        model = _model_in(field.annotation)
        if model is None or name in ARRAYS:
            continue
        found += _tables_of(model, (name,), field.description or "")
    return found


def _tables_of(model: type[BaseModel], where: Where, words: str) -> list[FormTable]:
    own, inner = [], []
    for name, field in model.model_fields.items():
        deeper = _model_in(field.annotation)
        if deeper is None:
            own.append(_field((*where, name), field))
        else:
            inner += _tables_of(deeper, (*where, name), field.description or "")
    label = ".".join(str(p) for p in where)
    if own and where[:2] == ("priors", "derivatives"):
        unit = DERIVATIVE_UNIT.search(words)
        own = [_with_unit(f, unit.group(1)) if unit else f for f in own]
    return [FormTable(label, words, tuple(own)), *inner] if own else inner


def _with_unit(field: FormField, unit: str) -> FormField:
    return FormField(field.where, unit, field.words, field.kind, field.needed, field.default)


def row_fields(array: str) -> list[FormField]:
    """The keys of a datum point or a marker; ``where`` begins with the array's name, without a number."""
    model = _model_in(RunFile.model_fields[array].annotation)
    assert model is not None
    return [_field((array, name), f) for name, f in model.model_fields.items()]


def _field(where: Where, field: Any) -> FormField:
    kind, choices, count = _kind(field.annotation)
    default = "" if field.default in (PydanticUndefined, None, ()) else shown(field.default)
    return FormField(
        where,
        unit_of(str(where[-1])),
        described(field),
        kind,
        field.default is PydanticUndefined and field.default_factory is None,
        default,
        choices,
        count,
        "integer" in _type_name(field.annotation),
    )


def unit_of(name: str) -> str:
    """The unit that a key's name ends in."""
    for ending, unit in UNITS.items():
        if name.endswith("_" + ending):
            return unit
    return ""


def _kind(annotation: Any) -> tuple[str, tuple[str, ...], int]:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _kind(get_args(annotation)[0])
    if origin is Literal:
        return "choice", tuple(str(v) for v in get_args(annotation)), 1
    if origin is tuple:
        return "numbers", (), len(get_args(annotation))
    if annotation in (float, int, bool, str):
        return {float: "number", int: "integer", bool: "truth", str: "text"}[annotation], (), 1
    inner = [part for part in get_args(annotation) if part is not type(None)]
    return _kind(inner[0]) if inner else ("text", (), 1)


def shown(value: Any) -> str:
    """A value as it stands in its field."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(shown(v) for v in value)
    return str(value)


def parsed(field: FormField, text: str) -> Any:
    """The value that a text means; None where it is empty (the key is left out).

    Parameters
    ----------
    field : of the form
    text : as it was typed

    Raises
    ------
    ValueError : what is wrong with it, in the schema's words
    """
    text = text.strip()
    if not text:
        return None
    value: Any = text
    if field.kind == "truth":
        if text.lower() not in ("true", "false"):
            raise ValueError(f"{text!r}: true or false is expected")
        return text.lower() == "true"
    if field.kind in ("number", "integer"):
        value = _number(text, field.whole)
    elif field.kind == "numbers":
        parts = [part for part in re.split(r"[\s,;]+", text.strip("[]() ")) if part]
        if len(parts) != field.count:
            raise ValueError(f"{len(parts)} numbers; {field.count} are expected, with commas between")
        value = tuple(_number(part, field.whole) for part in parts)
    checked_value(field.key, value)
    return list(value) if isinstance(value, tuple) else value


def _number(text: str, whole: bool) -> float | int:
    try:
        value = float(text.replace("−", "-"))
    except ValueError:
        hint = " (a point stands before the decimals)" if re.fullmatch(r"[-+]?\d+,\d+", text) else ""
        raise ValueError(f"{text!r} is no number{hint}") from None
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not a finite number")
    if whole:
        if value != int(value):
            raise ValueError(f"{text!r}: a whole number is expected")
        return int(value)
    return value


__all__ = ["ARRAYS", "FormField", "FormTable", "parsed", "row_fields", "shown", "tables", "unit_of"]
