"""The corrected model back: what was missing put into a model; as Python, as JSON."""

from __future__ import annotations

import ast
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...record.corrected_file import CorrectedFile, PutIn
from ...record.errors import InputError
from ...record.results import Measured
from ...simulate.model import Array
from ..effects import Parameter
from .course import Grid, held, simulated
from .gap import OwnGap
from .model import Missing, System

ARGUMENTS = {"equation": "t, x, u, p", "input": "t, u", "output": "t, y", "clock": "t"}
"""What ``Missing.changes`` is given first, by where it acts."""
OF_MEMORY = ("m", "rate")
"""What it is given behind them where it has a state of its own: that, and its rate."""
INNER = 4
"""Steps of integration between two samples of a corrected model, where nobody says how many."""
USED = ("delayed", "lagged", "limited", "played")
"""Functions of ``library`` that an effect's code may call."""
NUMPY = ("tanh", "exp", "abs", "maximum", "newaxis")
"""Of numpy's."""
ALLOWED = (
    ast.Expression, ast.Lambda, ast.arguments, ast.arg, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop, ast.Call, ast.Name,
    ast.Load, ast.Constant, ast.Attribute, ast.Subscript, ast.Tuple, ast.Slice,
)  # fmt: skip
"""What arithmetic is made of."""


def put_in(
    system: System, numbers: Mapping[str, float], missing: Sequence[tuple[Missing, Sequence[float]]] = ()
) -> System:
    """A model with other numbers and with what was missing.

    Parameters
    ----------
    system : the model
    numbers : name -> value, where its fit would begin now
    missing : what, and its numbers

    Raises
    ------
    InputError : a number that the model does not have

    Examples
    --------
    >>> from .model import Model, Number, Output, State
    >>> tank = Model([State("h", "m")], [], [Number("a", "1/s", 1.0)], [Output("h", "m")], lambda t, x, u, p: [-p.a * x.h])
    >>> put_in(tank, {"a": 0.5}).numbers[0].start
    0.5
    """
    known = [n.name for n in system.numbers]
    for name in numbers:
        if name not in known:
            raise InputError(system.name, f"number {name}", f"unknown; it has {', '.join(known) or 'none'}")
    own = [replace(n, start=numbers.get(n.name, n.start)) for n in system.numbers]
    built = [*system.built_in, *((m, tuple(float(v) for v in values)) for m, values in missing)]
    return replace(system, numbers=own, built_in=built)  # pyright: ignore[reportCallIssue, reportArgumentType, reportUnknownVariableType]


def run_model(
    system: System,
    step_s: float,
    count: int,
    start: Mapping[str, float] | None = None,
    inputs: Mapping[str, Array] | None = None,
    inner: int = INNER,
) -> dict[str, Array]:
    """A model's outputs, with its numbers where they begin.

    Parameters
    ----------
    system : the model
    step_s, count : of the samples
    start : state -> value at first; absent: the model's own
    inputs : name -> (count,) at the samples; absent: 0
    inner : steps of integration between two samples

    Returns
    -------
    outputs : name -> (count,)
    """
    grid = Grid(step_s, count, inner)
    given = start or {}
    begin = np.array([given.get(s.name, s.start) for s in system.states], dtype=float).reshape(-1, 1)
    told = inputs or {}
    values = (
        np.stack([np.asarray(told.get(i.name, np.zeros(count)), dtype=float) for i in system.inputs], axis=1)
        if system.inputs
        else np.zeros((count, 0))
    )
    p = np.array([n.start for n in system.numbers], dtype=float).reshape(-1, 1)
    found = simulated(system, grid, begin, held(values, grid)[..., None], p)
    return {o.name: found[:, k, 0] for k, o in enumerate(system.outputs)}


def corrected(gap: OwnGap) -> System:
    """The model with the headline put in; as fitted where nothing is missing.

    Parameters
    ----------
    gap : what was found
    """
    return put_in(gap.system, _values(gap), gap.put_in)


def _values(gap: OwnGap) -> dict[str, float]:
    """As fitted; those that were known as data.toml says them."""
    known = {n.name: float(n.start) for n in gap.system.numbers if n.known}
    names = gap.simulator.shared_names
    return known | {name: float(v) for name, v in zip(names, gap.fitted.hypothesis.shared, strict=True)}


def corrected_file(gap: OwnGap) -> CorrectedFile:
    """corrected.json.

    Parameters
    ----------
    gap : what was found
    """
    file = gap.file
    fitted = file.derivatives.get("after") or file.derivatives["before"]
    sd = {name: number.std for name, number in fitted.items()}
    numbers = {name: Measured(value=value, std=sd.get(name, 0.0)) for name, value in _values(gap).items()}
    row = file.ranking[0].parameters if gap.put_in else {}
    put = []
    for m, values in gap.put_in:
        own = {
            q.name: Measured(value=v, std=row[f"{m.name}.{q.name}"].std)
            for q, v in zip(m.parameters, values, strict=True)
        }
        acts: Literal["equation", "input", "output", "clock"] = "clock"
        acts = "equation" if m.equation else "input" if m.input else "output" if m.output else acts
        on = m.equation or m.input or m.output
        put.append(PutIn(effect=m.name, acts=acts, on=on, code=m.code, memory=m.memory_code, numbers=own))
    return CorrectedFile(
        schema="towline/corrected",
        tool=file.tool,
        inputs=file.inputs,
        model=gap.system.name,
        numbers=numbers,
        effects=put,
    )


def from_file(file: CorrectedFile, system: System, path: str | Path = "corrected.json") -> System:
    """The corrected model from corrected.json and the model that was corrected.

    Parameters
    ----------
    file : as read
    system : the model
    path : of the file, for errors

    Raises
    ------
    InputError : an effect of the user's own, whose code is in no file of towline's, that the model does not have
    """
    own = {m.name: m for m in system.missing}
    missing = []
    for put in file.effects:
        parameters = tuple(Parameter(name, "", 1.0) for name in put.numbers)
        if put.code:
            on = {place: put.on if place == put.acts else "" for place in ("equation", "input", "output")}
            made = Missing(
                put.effect,
                parameters,
                "",
                "",
                _compiled(put, _lambda(put), path),
                on["equation"],
                on["input"],
                on["output"],
                code=put.code,
                memory=_compiled(put, _of_memory(put), path) if put.memory else None,
                memory_code=put.memory,
            )
        elif put.effect in own:
            made = own[put.effect]
        else:
            raise InputError(path, f"effects {put.effect}", f"{system.name} has none of that name")
        missing.append((made, [number.value for number in put.numbers.values()]))
    return put_in(system, {name: n.value for name, n in file.numbers.items()}, missing)


def _compiled(put: PutIn, text: str, path: str | Path) -> Any:
    """An effect's code as a function: arithmetic of its arguments and numbers, and what towline calls in it; nothing else."""
    from . import library

    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError:
        raise InputError(path, f"effects {put.effect}", "its code is no Python expression") from None
    known = {*ARGUMENTS[put.acts].split(", "), *OF_MEMORY, *put.numbers, *USED, "np"}
    for node in ast.walk(tree):
        name = node.id if isinstance(node, ast.Name) else ""
        attribute = isinstance(node, ast.Attribute)
        of = node.value.id if attribute and isinstance(node.value, ast.Name) else ""
        fits = not attribute or (node.attr in NUMPY if of == "np" else of in ("x", "u", "p") and node.attr[0] != "_")
        fits = fits and not (isinstance(node, ast.Call) and not isinstance(node.func, ast.Name | ast.Attribute))
        if not isinstance(node, ALLOWED) or (name and name not in known) or not fits:
            raise InputError(path, f"effects {put.effect}", "its code is none that towline writes")
    names = {"np": np, "__builtins__": {}, **{name: getattr(library, name) for name in USED}}
    return eval(compile(tree, "corrected.json", "eval"), names)  # of what was looked through above


def _lambda(put: PutIn) -> str:
    memory = OF_MEMORY if put.memory else ()
    return f"lambda {', '.join((ARGUMENTS[put.acts], *memory, *put.numbers))}: {put.code}"


def _of_memory(put: PutIn) -> str:
    return f"lambda {', '.join((ARGUMENTS[put.acts], *put.numbers))}: {put.memory}"


def corrected_python(gap: OwnGap, model: Path, out: Path) -> str:
    """corrected.py: a model file that builds on the old one.

    Parameters
    ----------
    gap : what was found
    model : the old model's file
    out : where this is written, for the way between
    """
    file = corrected_file(gap)
    way = os.path.relpath(model.resolve(), out.resolve().parent)
    lines = [
        f'"""{model.name}, corrected by towline {file.tool}: numbers as fitted'
        + (", and what was missing." if file.effects else ".")
        + '"""',
        "",
        "from pathlib import Path",
        "",
    ]
    used = sorted({name for put in file.effects for name in USED if f"{name}(" in put.code})
    if any("np." in put.code + put.memory for put in file.effects):
        lines += ["import numpy as np", ""]
    if file.effects:
        lines += ["from towline.diagnose.effects import Parameter", "from towline.diagnose.own import Missing"]
    lines += [
        "from towline.diagnose.own.back import put_in",
        *([f"from towline.diagnose.own.library import {', '.join(used)}"] if used else []),
    ]
    lines += [
        "from towline.diagnose.own.read import read_model",
        "",
        f"OLD = read_model(Path(__file__).parent / {way!r})",
    ]
    lines += [
        "NUMBERS = {",
        *(f"    {name!r}: {n.value!r},  # +- {n.std:.2g}" for name, n in file.numbers.items()),
        "}",
        "MISSING = [",
    ]
    for put, (m, _) in zip(file.effects, gap.put_in, strict=True):
        place = "" if put.acts == "clock" else f"\n            {put.acts}={put.on!r},"
        if not put.code:
            lines.append(
                f"    (next(m for m in OLD.missing if m.name == {put.effect!r}), {tuple(n.value for n in put.numbers.values())!r}),"
            )
            continue
        parameters = "".join(f"Parameter({q.name!r}, {q.unit!r}, {q.sd!r}), " for q in m.parameters)
        lines += [
            "    (",
            "        Missing(",
            f"            {put.effect!r},",
            f"            ({parameters.rstrip()}),",
            f"            {m.physics!r},",
            f"            {m.cure!r},",
            f"            {_lambda(put)},{place}",
            *([f"            memory={_of_memory(put)},"] if put.memory else []),
            "        ),",
            f"        ({', '.join(repr(n.value) for n in put.numbers.values())},),",
            "    ),",
        ]
    lines += ["]", "MODEL = put_in(OLD, NUMBERS, MISSING)", ""]
    return "\n".join(lines)


__all__ = ["corrected", "corrected_file", "corrected_python", "from_file", "put_in", "run_model"]
