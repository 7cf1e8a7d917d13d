"""A model's file: Python or FMU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...record.errors import InputError
from ...record.own_code import run_own
from .fmu import FmuModel, read_fmu
from .model import Model, check_model


def read_model(path: str | Path) -> Model | FmuModel:
    """Read a model.

    Parameters
    ----------
    path : a Python file that defines one ``Model`` at its top level (of several the one called MODEL), or an FMU

    Raises
    ------
    InputError : it cannot be run or unpacked, defines none or several, or its lists are wrong
    """
    path = Path(path)
    if path.suffix.lower() == ".fmu":
        return read_fmu(path)
    if path.suffix.lower() != ".py":
        raise InputError(path, "", "is no model: a Python file (.py) or an FMU (.fmu) is expected")
    found = {name: value for name, value in vars(run_own(path)).items() if isinstance(value, Model | FmuModel)}
    if "MODEL" in found:
        found = {"MODEL": found["MODEL"]}
    if len(found) != 1:
        raise InputError(
            path, "", f"defines {len(found) or 'no'} Model at its top level; expected one, or one called MODEL"
        )
    return named_model(next(iter(found.values())), path.name)


def named_model(model: Model | FmuModel, name: str) -> Model | FmuModel:
    """The model with its name, checked.

    Parameters
    ----------
    model : of Python, or an FMU
    name : for what is said of it

    Raises
    ------
    InputError : its lists are wrong
    """
    made = replace(model, name=name)
    check_model(made)
    return made


__all__ = ["named_model", "read_model"]
