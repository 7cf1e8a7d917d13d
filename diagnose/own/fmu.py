"""An FMU as a model: FMI 2.0 and 3.0, model exchange and co-simulation, through fmpy.

With model exchange its equations are had, and what is missing can be put into them. With co-simulation it runs by itself:
effects of inputs, outputs and the clock are offered, and none inside an equation.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...record.errors import InputError
from ...record.files import refusal
from ...simulate.model import Array
from .fmu_calls import Calls, Library
from .model import Input, Missing, Named, Number, Output, State, check_model

REAL = ("Real", "Float64")
FMU_BYTES = 1 << 30
"""Largest FMU that is read: far above any of their kind."""


@dataclass(frozen=True)
class FmuModel(Named):
    """An FMU.

    Attributes
    ----------
    states, inputs, numbers, outputs : by name from modelDescription.xml; letters that Python's names do not have are _
    missing, built_in : as of ``Model``
    name : of its file
    whole : of co-simulation
    calls : into it
    places : of each output, which state it is, or None
    """

    states: Sequence[State]
    inputs: Sequence[Input]
    numbers: Sequence[Number]
    outputs: Sequence[Output]
    calls: Calls
    places: tuple[int | None, ...]
    name: str
    whole: bool
    missing: Sequence[Missing] = ()
    built_in: Sequence[tuple[Missing, tuple[float, ...]]] = ()
    kept: Any = field(default=None, repr=False)

    def derivatives(self, t: float, x: Array, u: Array, p: Array) -> Array:
        """Of ``System``."""
        return self.calls.rates(float(t), x, np.broadcast_to(u, (len(u), x.shape[1])), p)

    def seen(self, t: Array, x: Array, u: Array, p: Array) -> Array:
        """Of ``System``."""
        if all(place is not None for place in self.places):
            return np.array([x[place] for place in self.places if place is not None])
        numbers = np.ascontiguousarray(p[:, 0])
        wide = np.broadcast_to(u, (len(u), *x.shape[1:]))
        return np.stack(
            [self.calls.taken(float(t[n, 0]), x[:, n], wide[:, n], numbers) for n in range(x.shape[1])], axis=1
        )

    def course(self, t: Array, start: Array, u: Array, p: Array) -> Array:
        """Of ``System``."""
        return self.calls.course(t, start, u, p)

    def measured(self, outputs: Sequence[str], numbers: Sequence[str]) -> FmuModel:
        """With those outputs alone that are measured, and those numbers fitted that are named; none: all."""
        kept = [k for k, one in enumerate(self.outputs) if one.name in outputs]
        library = self.calls.library
        chosen = replace(library, outputs=tuple(library.outputs[k] for k in kept))
        own = [replace(n, known=bool(numbers) and n.name not in numbers) for n in self.numbers]
        return replace(
            self,
            outputs=[self.outputs[k] for k in kept],
            places=tuple(self.places[k] for k in kept),
            numbers=own,
            calls=Calls(chosen),
        )


def read_fmu(path: Path) -> FmuModel:
    """Unpack and read an FMU.

    Parameters
    ----------
    path : of the FMU

    Raises
    ------
    InputError : it is none, is for another platform, of another version, has events that only its own solver can follow, or fmpy is
        not installed
    """
    try:
        import fmpy
    except ImportError:
        raise InputError(path, "", "an FMU needs fmpy: pip install 'towline[fmu]'") from None
    wrong = refusal(path, FMU_BYTES)
    if wrong is not None:
        raise InputError(path, "", wrong)
    folder = Path(tempfile.mkdtemp(prefix="towline_fmu_"))
    try:
        fmpy.extract(str(path), str(folder))
        description = fmpy.read_model_description(str(folder), validate=False)
    except Exception as error:  # no zip file, paths that lead out of it, a description that is none
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(
            path, "", f"is no FMU ({' '.join(str(error).split())[:120] or type(error).__name__})"
        ) from None
    try:
        made = _made(path, folder, description)
    except InputError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(made.kept, shutil.rmtree, str(folder), True)
    return made


class _Kept:
    """Lives as long as any copy of the model: the unpacked folder goes with it."""


def _made(path: Path, folder: Path, description: Any) -> FmuModel:
    version = {"2": 2, "3": 3}.get(str(description.fmiVersion)[:1])
    if version is None:
        raise InputError(path, "", f"is of FMI {description.fmiVersion}; 2.0 and 3.0 are read")
    exchange = description.modelExchange is not None
    if exchange and description.numberOfEventIndicators:
        exchange = False
    kind = description.modelExchange if exchange else description.coSimulation
    if kind is None:
        what = (
            f"has {description.numberOfEventIndicators} event indicators; export it for co-simulation, which follows its events"
            if description.modelExchange is not None
            else "is neither for model exchange nor for co-simulation"
        )
        raise InputError(path, "", what)
    if exchange and kind.canBeInstantiatedOnlyOncePerProcess:
        raise InputError(path, "", "can be instantiated once only; export it for co-simulation, or without that limit")
    _platform(path, folder, kind.modelIdentifier)
    real = [v for v in description.modelVariables if v.type in REAL and not v.dimensions]
    numbers = [v for v in real if v.causality == "parameter" and v.variability in ("fixed", "tunable", None)]
    inputs = [v for v in real if v.causality == "input"]
    outputs = [v for v in real if v.causality == "output"]
    states = [u.variable.derivative for u in description.derivatives if u.variable.derivative is not None]
    if not exchange:
        # what runs by itself can be given those starts only that it lets one set
        states = [v for v in states if v.initial == "exact"]
    at = {v.valueReference: k for k, v in enumerate(states)}
    references = [tuple(int(v.valueReference) for v in those) for those in (numbers, inputs, outputs, states)]
    token = description.instantiationToken or getattr(description, "guid", "")
    library = Library(str(path), folder, version, exchange, token, kind.modelIdentifier, *references)
    model = FmuModel(
        states=[State(_name(v), _unit(v), _value(v.start, 0.0), _size(v)) for v in states],
        inputs=[Input(_name(v), _unit(v)) for v in inputs],
        numbers=[_number(v) for v in numbers],
        outputs=[Output(_name(v), _unit(v)) for v in outputs],
        calls=Calls(library),
        places=tuple(at.get(v.valueReference) if exchange else None for v in outputs),
        name=path.name,
        whole=not exchange,
        kept=_Kept(),
    )
    check_model(model)
    return model


def _platform(path: Path, folder: Path, identifier: str) -> None:
    import fmpy

    there = sorted(p.name for p in (folder / "binaries").glob("*") if p.is_dir())
    if not {fmpy.platform, fmpy.platform_tuple} & set(there):
        raise InputError(
            path,
            "",
            f"has no binary for {fmpy.platform} (it has {', '.join(there) or 'none'}); export it for this platform",
        )
    # an FMI 3.0 folder is named by its own tuple; fmpy's classes look there for both
    if not any((folder / "binaries" / p).glob(f"{identifier}.*") for p in (fmpy.platform, fmpy.platform_tuple)):
        raise InputError(path, "", f"has no {identifier} in its binaries")


def _name(variable: Any) -> str:
    name = re.sub(r"\W", "_", variable.name).strip("_")
    return name if name.isidentifier() else f"v_{name}"


def _unit(variable: Any) -> str:
    own = variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None)
    return own or ""


def _value(text: Any, other: float) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        return other


def _size(variable: Any) -> float | None:
    size = abs(_value(variable.nominal, 0.0))
    return size if size > 0 else None


def _number(variable: Any) -> Number:
    least, most = _value(variable.min, -np.inf), _value(variable.max, np.inf)
    return Number(_name(variable), _unit(variable), _value(variable.start, 0.0), _size(variable), least, most)


__all__ = ["FmuModel", "read_fmu"]
