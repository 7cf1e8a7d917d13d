"""Records that could be made next: inputs of tables, or of a box of amplitudes and frequencies, and starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from ...record.errors import InputError
from ...record.own_data import OwnData, OwnNext, read_data_file
from ...simulate.model import Array
from .model import System
from .records import Record, Records, converted, inputs_alone, thinned

FASTEST = 0.25
"""Largest frequency of a box, in samples of the records: below, a swing has four samples."""
MOST_DESIGNS = 100
"""More take too long: a choice."""


@dataclass(frozen=True)
class Design:
    """A record that could be made.

    Attributes
    ----------
    name : a table's, or a box's settings in words
    record : its inputs; its values are nothing where something would be measured
    start : state -> value at first; others begin as the records made did
    settings : of a box, input.amplitude and so on, in the units of data.toml
    columns : its table, in the words and units of data.toml; empty: it is a table of the user's
    """

    name: str
    record: Record
    start: dict[str, float]
    settings: dict[str, float]
    columns: dict[str, Array]


def designs_of(
    system: System, records: Records, made: Path, tables: Sequence[Path] = (), given: Path | None = None
) -> list[Design]:
    """Everything that may be made next: the tables, and what [[next]] of the first record's data.toml spans.

    Parameters
    ----------
    system : the model
    records : made
    made : table of the first of them
    tables : of inputs
    given : what says what all tables' columns are; None: beside each

    Raises
    ------
    InputError : a table is wrong or of another step, or a box does not fit the model
    """
    path, file = read_data_file(made, given)
    pattern = max(records.records, key=lambda r: len(r.values))
    found = [_of_table(system, pattern, table, given) for table in tables]
    if file.next:
        found += box_of(system, pattern, file, path)
    if len(found) > MOST_DESIGNS:
        raise InputError(
            path, "next", f"spans {len(found)} records; at most {MOST_DESIGNS} are tried: name fewer inputs"
        )
    return found


def _of_table(system: System, pattern: Record, table: Path, given: Path | None) -> Design:
    if not system.inputs:
        raise InputError(table, "", f"{system.name} has no input that a table could give; name starts in [[next]]")
    record = inputs_alone(system, table, given)
    thin = max(round(pattern.step_s / record.step_s), 1)
    record = thinned(record, thin) if thin > 1 else record
    if abs(record.step_s / pattern.step_s - 1) > 0.01:
        raise InputError(table, "clock", f"a step of {record.step_s:g} s; the records have {pattern.step_s:g} s")
    return Design(table.name, _nothing(pattern, record.name, record.inputs, record.stays), {}, {}, {})


def _nothing(pattern: Record, name: str, inputs: Array, stays: tuple[bool, ...]) -> Record:
    """Measured as nothing, with the noise of the records made."""
    values = np.where(np.isfinite(pattern.values).any(axis=0), 0.0, np.nan) * np.ones((len(inputs), 1))
    return replace(pattern, name=name, inputs=inputs, values=values, stays=stays)


# a box ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Move:
    """What an input does: words, course in its own unit about nothing, settings."""

    words: str
    course: Array
    settings: dict[str, float]


def box_of(system: System, pattern: Record, file: OwnData, path: Path) -> list[Design]:
    """What [[next]] spans: each input alone and all together, by sines of three amplitudes and frequencies and by sweeps, from each
    end and the middle of every start.

    Parameters
    ----------
    system : the model
    pattern : the longest record that was made
    file, path : data.toml

    Raises
    ------
    InputError : a name that the model does not have, a unit that does not fit, a frequency that the samples do not show
    """
    moved = [n for n in file.next if n.input]
    begun = [n for n in file.next if n.state]
    names, states = [i.name for i in system.inputs], [s.name for s in system.states if not s.known]
    for one in file.next:
        _there(path, one.input, names, f"input of {system.name}")
        _there(path, one.state, states, f"state of {system.name} whose start is free")
    starts = [
        [(f"{n.state} from {value:g}{_of_unit(n)}", n, value) for value in _spread(*n.range or (0.0, 0.0))]
        for n in begun
    ]
    found = []
    for moves in _moves(moved, pattern, path) or [{}]:
        inputs = _inputs(system, pattern, moved, moves, path)
        for chosen in product(*starts):
            words = [f"{name} {move.words}" for name, move in moves.items()] + [w for w, _, _ in chosen]
            settings = {f"{name}.{key}": v for name, m in moves.items() for key, v in m.settings.items()}
            settings |= {f"{n.state}.start": value for _, n, value in chosen}
            start = {n.state: value * _share(system, n, path) for _, n, value in chosen}
            record = _nothing(pattern, f"design {len(found) + 1}", inputs, pattern.stays)
            found.append(Design(", ".join(words), record, start, settings, _columns(system, file, path, record)))
    return found


def _moves(moved: Sequence[OwnNext], pattern: Record, path: Path) -> list[dict[str, _Move]]:
    """Each input alone, then all together."""
    own = {n.input: _courses(n, pattern, path) for n in moved}
    alone = [{name: move} for name, those in own.items() for move in those]
    together = [dict(zip(own, those, strict=True)) for those in zip(*own.values(), strict=True)] if len(own) > 1 else []
    return alone + together


def _courses(one: OwnNext, pattern: Record, path: Path) -> list[_Move]:
    """Sines of three amplitudes and frequencies, and sweeps."""
    assert one.amplitude is not None
    assert one.frequency_hz is not None
    slow, fast = one.frequency_hz
    if fast * pattern.step_s > FASTEST:
        raise InputError(
            path,
            f"next {one.input}",
            f"frequency_hz: up to {fast:g} Hz, of which samples {pattern.step_s:g} s apart show less than four a swing",
        )
    t = np.arange(len(pattern.values)) * pattern.step_s
    phases = {f"at {f:.3g} Hz": (2 * np.pi * f * t, f, f) for f in _levels(slow, fast)}
    if fast > slow:
        sweep = 2 * np.pi * (slow * t + 0.5 * (fast - slow) * t**2 / t[-1])
        phases[f"swept from {slow:.3g} to {fast:.3g} Hz"] = (sweep, slow, fast)
    return [
        _Move(
            f"{size:.3g}{_of_unit(one)} {words}",
            size * np.sin(phase),
            {"amplitude": size, "from_hz": first, "to_hz": last},
        )
        for size in _levels(*one.amplitude)
        for words, (phase, first, last) in phases.items()
    ]


def _levels(least: float, most: float) -> list[float]:
    return [least] if least == most else [least, float(np.sqrt(least * most)), most]


def _spread(least: float, most: float) -> list[float]:
    return [least] if least == most else [least, 0.5 * (least + most), most]


def _inputs(system: System, pattern: Record, moved: Sequence[OwnNext], moves: dict[str, _Move], path: Path) -> Array:
    """(n, m) in the model's units; an input that nothing is said of stays where it mostly was."""
    found = np.tile(np.median(pattern.inputs, axis=0), (len(pattern.values), 1))
    at = {i.name: k for k, i in enumerate(system.inputs)}
    for one in moved:
        move = moves.get(one.input)
        course = one.offset + (move.course if move is not None else np.zeros(len(found)))
        found[:, at[one.input]] = course * _share(system, one, path)
    return found


def _columns(system: System, file: OwnData, path: Path, record: Record) -> dict[str, Array]:
    """As a table that data.toml describes."""
    found = {}
    if file.clock.column:
        second = converted(path, "clock.unit", file.clock.unit, "s")
        found[file.clock.column] = np.arange(len(record.inputs)) * record.step_s / second
    for k, one in enumerate(system.inputs):
        for column in file.column:
            if column.role == "input" and (column.of or column.name) == one.name:
                share = converted(path, f'column "{column.name}"', column.unit, one.unit)
                found[column.name] = record.inputs[:, k] / share
    return found


def _there(path: Path, name: str, known: Sequence[str], kind: str) -> None:
    if name and name not in known:
        raise InputError(path, f"next {name}", f"is no {kind}; there are {', '.join(known) or 'none'}")


def _share(system: System, one: OwnNext, path: Path) -> float:
    wanted = next(o.unit for o in (*system.inputs, *system.states) if o.name == (one.input or one.state))
    return converted(path, f"next {one.input or one.state}", one.unit, wanted)


def _of_unit(one: OwnNext) -> str:
    return f" {one.unit}" if one.unit else ""


__all__ = ["Design", "box_of", "designs_of"]
