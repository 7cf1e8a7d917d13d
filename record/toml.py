"""TOML files checked against a pydantic model; the first fault becomes one line that names file and key."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from .errors import InputError
from .files import TOML_BYTES, read_text
from .toml_words import comma_in_list, not_toml

ModelT = TypeVar("ModelT", bound=BaseModel)
TOO_DEEP = "its lists or tables stand too deep in one another"
WHOLE_BITS = 63
"""TOML's whole numbers have 64 bits, one of them the sign."""


class Table(BaseModel):
    """Base of every TOML table: immutable; an unknown key is an error; numbers are finite; no silent conversions."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True, defer_build=True)


@dataclass(frozen=True)
class Words:
    """Beside a field's type: its description, where that grows with what is registered."""

    said: Callable[[], str]


def described(field: FieldInfo) -> str:
    """What the schema says of a key."""
    return next((beside.said() for beside in field.metadata if isinstance(beside, Words)), field.description or "")


def read_toml(path: str | Path, model: type[ModelT]) -> ModelT:
    """Read ``path`` as ``model``.

    Parameters
    ----------
    path : of the file
    model : class of the file

    Raises
    ------
    InputError : the file is missing, is no plain file of at most ``TOML_BYTES``, is no TOML, or a key is unknown, missing, of the
        wrong kind or out of range.
    """
    path = Path(path)
    text = read_text(path, TOML_BYTES)
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise InputError(path, "", TOO_DEEP) from None
    except ValueError as error:  # TOMLDecodeError, and what a whole number of thousands of digits gives
        raise InputError(path, *not_toml(text, error)) from None
    return check_tables(content, model, path, text)


def check_tables(content: dict[str, Any], model: type[ModelT], path: str | Path, text: str = "") -> ModelT:
    """Check already parsed TOML ``content``; ``path`` is only quoted in errors.

    Parameters
    ----------
    content : parsed TOML
    model : class of the file
    path : quoted in errors
    text : that it was parsed from, for what the content no longer shows
    """
    try:
        return model.model_validate(_lists_to_tuples(content))
    except RecursionError:
        raise InputError(path, "", TOO_DEEP) from None
    except OverflowError:
        raise InputError(path, "", "holds a whole number beyond 64 bits") from None
    except ValidationError as error:
        where, message = _describe(error, model, content, text)
        raise InputError(path, where, message) from None


def _lists_to_tuples(value: Any) -> Any:
    """TOML has lists only; the frozen tables hold tuples, which pydantic's strict mode does not take lists for."""
    if isinstance(value, dict):
        return {key: _lists_to_tuples(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return tuple(_lists_to_tuples(inner) for inner in value)
    if isinstance(value, int) and value.bit_length() > WHOLE_BITS:
        raise OverflowError
    return value


def _describe(
    error: ValidationError, model: type[BaseModel], content: dict[str, Any], text: str = ""
) -> tuple[str, str]:
    faults = error.errors(include_url=False)
    # unknown keys first: a misspelt key also leaves its right name missing, and the misspelling is what the user must see
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    where = _key_path(fault["loc"], content)
    kind = fault["type"]
    if kind == "extra_forbidden":
        known = sorted(_fields_at(model, fault["loc"][:-1]))
        elsewhere = _tables_with(model, str(fault["loc"][-1]))
        if elsewhere:
            return where, f"unknown key here; did you mean it {' or '.join(elsewhere)}?"
        close = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1, cutoff=0.6)
        hint = f"did you mean {close[0]!r}?" if close else f"known here: {', '.join(known)}"
        return where, f"unknown key; {hint}"
    if kind == "missing":
        return where, "missing key"
    if kind == "tuple_type" and isinstance(fault["input"], dict):
        return where, f"there are several: write [[{where}]] with two brackets, once for each"
    if kind in ("model_type", "model_attributes_type") and isinstance(fault["input"], tuple) and len(fault["loc"]) == 1:
        return where, f"there is one: write [{where}] with one bracket"
    listed = comma_in_list(text, str(fault["loc"][-1])) if kind in ("too_long", "tuple_type") else None
    if listed is not None:
        return where, listed
    message = fault["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return where, message
    return where, f"{_short(fault['input'])}: {message[0].lower()}{message[1:]}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _key_path(location: tuple[int | str, ...], content: Any) -> str:
    """``("datum", 2, "pixel_px", 0)`` -> ``datum[3 "near_port"].pixel_px[1]`` (numbers counted from one)."""
    text = ""
    here: Any = content
    for part in location:
        if isinstance(part, int):
            here = here[part] if isinstance(here, (list, tuple)) and part < len(here) else None
            name = here.get("name") if isinstance(here, dict) else None
            text += f'[{part + 1} "{name}"]' if isinstance(name, str) else f"[{part + 1}]"
        elif isinstance(here, dict) or here is None:
            here = here.get(part) if isinstance(here, dict) else None
            text += f".{part}" if text else part
    return text


def _fields_at(model: type[BaseModel], location: tuple[int | str, ...]) -> set[str]:
    current: Any = model
    for place, part in enumerate(location):
        if isinstance(part, int) or not hasattr(current, "model_fields"):
            continue
        field = current.model_fields.get(part)
        if isinstance(
            next(iter(location[place + 1 :]), None), int
        ):  # one of several, under a key that may be a table as well
            several = (f for f in current.model_fields.values() if f.validation_alias == part and not f.alias)
            field = next(several, field)
        if field is None:
            break
        current = _inner_model(field.annotation)
    return set(current.model_fields) if hasattr(current, "model_fields") else set()


def _tables_with(model: type[BaseModel], key: str) -> list[str]:
    """Where a key of this very name stands: "in [tow]", "in [[datum]]", "at the top, before the first table"."""
    found = ["at the top, before the first table"] if key in model.model_fields and not _table_of(model, key) else []
    for name in model.model_fields:
        inner, many = _table_of(model, name), "tuple" in str(model.model_fields[name].annotation)
        if inner is not None and key in inner.model_fields:
            found.append(f"in [[{name}]]" if many else f"in [{name}]")
    return found


def _table_of(model: type[BaseModel], name: str) -> Any:
    """The class of a table; None where the field is none."""
    inner = _inner_model(model.model_fields[name].annotation)
    return inner if hasattr(inner, "model_fields") else None


def _inner_model(annotation: Any) -> Any:
    if hasattr(annotation, "model_fields"):
        return annotation
    for inner in get_args(annotation):
        found = _inner_model(inner)
        if hasattr(found, "model_fields"):
            return found
    return annotation
