"""A user's own Python file, run as a module: effects and estimators of one's own."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from .errors import InputError
from .files import PYTHON_BYTES, refusal


def run_own(path: str | Path) -> ModuleType:
    """Run a Python file and give its module.

    Parameters
    ----------
    path : of the Python file

    Raises
    ------
    InputError : it is no plain file, or cannot be run
    """
    path = Path(path)
    wrong = refusal(path, PYTHON_BYTES)
    spec = importlib.util.spec_from_file_location(f"towline_own_{path.stem}", path)
    if wrong is not None or spec is None or spec.loader is None:
        raise InputError(path, "", wrong or "no such Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(path, "", f"{type(error).__name__}: {error}") from None
    return module


__all__ = ["run_own"]
