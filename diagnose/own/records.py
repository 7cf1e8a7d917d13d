"""Records as a model has them: even samples in its units, with their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...record.errors import InputError
from ...record.own_data import OwnColumn, OwnData, read_columns, read_data_file
from ...record.units import conversion
from ...simulate.model import Array
from ..tow.still import StillNoise, still_noise
from .fmu import FmuModel
from .model import Input, Model, Number, Output, State, System, check_bounds

MOST_SAMPLES = 2000
"""More are taken in means of neighbours first: for time."""
MOST_BLOCKS, USUAL_BLOCKS = 400, 200
"""Blocks of a record (of one or two outputs): where the motion is fast, and else. The engine's time grows with their cube."""
MOVES_WITHIN = 0.02
"""A motion is fast where, of its variance, this share is within blocks."""
FEWEST_BLOCKS = 12
"""A record of fewer samples says too little."""
UNEVEN = 0.25
"""A sample may be this share of a step away from its even time."""
FIRST = 6
"""Samples that say where a record begins, and with which rate."""


@dataclass(frozen=True)
class SampleNoise:
    """Noise of an output.

    Attributes
    ----------
    sd : standard deviation of one sample
    still : colour, from a static record, in units of the variance that ``sd`` gives a block's mean; None: white
    """

    sd: float
    still: StillNoise | None = None

    def covariance(self, size: int, step_s: float, lag_s: Array) -> Array:
        """(n, n) of means of ``size`` samples, ``step_s`` apart, with ``lag_s`` between the means."""
        if self.still is None:
            return self.sd**2 / size * np.eye(len(lag_s))
        white, slow = float(self.still.white[0, 0]), float(self.still.slow[0, 0])
        return self.sd**2 * (
            white / size * np.eye(len(lag_s)) + slow * _of_means(size * step_s, self.still.time_s, lag_s)
        )


def _of_means(length_s: float, time_s: float, lag_s: Array) -> Array:
    """Covariance of means over ``length_s`` of a first-order process of unit variance, ``lag_s`` (0, or a length or more) apart."""
    ratio = length_s / max(time_s, 1e-6 * length_s)
    apart = np.maximum(lag_s / length_s, 1.0) * ratio
    other = np.exp(ratio - apart) * (1 - np.exp(-ratio)) ** 2 / ratio**2
    return np.where(lag_s == 0, 2 / ratio * (1 - (1 - np.exp(-ratio)) / ratio), other)


@dataclass(frozen=True)
class Record:
    """A record.

    Attributes
    ----------
    name : of its table
    step_s : between samples
    inputs : (n, m), in the model's units
    values : (n, c) outputs; NaN where not measured
    noises : of each output
    stays : of each input, whether it stays between samples
    """

    name: str
    step_s: float
    inputs: Array
    values: Array
    noises: tuple[SampleNoise, ...]
    stays: tuple[bool, ...]

    @property
    def length_s(self) -> float:
        """From the first to the last sample."""
        return (len(self.values) - 1) * self.step_s

    def first(self, output: int, order: int) -> float:
        """Value (order 0) or rate (1) of an output at the first sample, from the first few."""
        part = self.values[:FIRST, output]
        good = np.flatnonzero(np.isfinite(part))
        if len(good) < 4:
            return 0.0
        return float(np.polynomial.polynomial.polyfit(good * self.step_s, part[good], 2)[order])


@dataclass(frozen=True)
class Records:
    """All records of a campaign.

    Attributes
    ----------
    records : in their order
    size : samples in a block
    notes : what was done with them
    """

    records: tuple[Record, ...]
    size: int
    notes: tuple[str, ...]


def adapted(system: System, file: OwnData, path: Path) -> System:
    """The model with what a data file says of its numbers, states and stages.

    Parameters
    ----------
    system : the model
    file, path : of the records

    Raises
    ------
    InputError : a name that the model does not have, a unit that does not fit, a start beyond its bounds
    """
    numbers = _changed(system.numbers, file.number, path, "number")
    states = _changed(system.states, file.state, path, "state")
    for number in numbers:
        check_bounds(str(path), number)
    inputs: list[Any] = list(system.inputs)
    outputs: list[Any] = list(system.outputs)
    for told in file.stage:
        for those, field in ((states, "equation"), (inputs, "stage"), (outputs, "stage")):
            for k, one in enumerate(those):
                if one.name == told.name:
                    those[k] = replace(one, **{field: told.stage})
        if told.name not in [one.name for one in (*states, *inputs, *outputs)]:
            raise InputError(
                path, f"stage {told.name}", f"unknown; {system.name} has {_names((*states, *inputs, *outputs))}"
            )
    return replace(system, numbers=numbers, states=states, inputs=inputs, outputs=outputs)  # pyright: ignore


def _changed(those: Sequence[Any], told: Sequence[Any], path: Path, kind: str) -> list[Any]:
    found = list(those)
    names = [one.name for one in those]
    for one in told:
        if one.name not in names:
            raise InputError(path, f"{kind} {one.name}", f"unknown; the model has {', '.join(names) or 'none'}")
        k = names.index(one.name)
        given = {
            key: value for key, value in one.model_dump().items() if value is not None and key not in ("name", "unit")
        }
        if getattr(one, "unit", None) is not None:
            share = converted(path, f"{kind} {one.name}", one.unit, found[k].unit)
            given = {key: value * share if key != "known" else value for key, value in given.items()}
        found[k] = replace(found[k], **given)
    return found


def read_records(system: System, tables: Sequence[Path], given: Path | None = None) -> tuple[System, Records]:
    """Read tables for a model.

    Parameters
    ----------
    system : the model
    tables : CSV, Parquet or MAT
    given : what says what their columns are; None: beside each

    Returns
    -------
    system, records : the model with what the first table's file says of it; all records

    Raises
    ------
    InputError : a table or its file is wrong, does not have what the model asks for, or all do not have one step
    """
    if not tables:
        raise InputError("DATA", "", "no table given, expected at least one")
    files = [read_data_file(table, given) for table in tables]
    if isinstance(system, FmuModel):
        measured = [c.of or c.name for _, file in files for c in file.column if c.role == "output"]
        fitted = [n.name for n in files[0][1].number if not n.known]
        known = [o.name for o in system.outputs]
        if any(name in known for name in measured):
            system = system.measured(measured, fitted)
    adapted_system = adapted(system, files[0][1], files[0][0])
    records = [
        _record(adapted_system, table, path, file, _static(path, file))
        for table, (path, file) in zip(tables, files, strict=True)
    ]
    for output in system.outputs:
        if all(output.name not in [c.of or c.name for c in file.column if c.role == "output"] for _, file in files):
            raise InputError(files[0][0], f"output {output.name}", f"{system.name} has it, and no column is it")
    return adapted_system, together(records)


def together(records: Sequence[Record]) -> Records:
    """Records of one step, thinned where they are long, and the size of their blocks.

    Parameters
    ----------
    records : at least one

    Raises
    ------
    InputError : they have different steps, or too few samples
    """
    notes: list[str] = []
    step = records[0].step_s
    for record in records:
        if abs(record.step_s / step - 1) > 0.01:
            raise InputError(
                record.name,
                "clock",
                f"a step of {record.step_s:g} s; {records[0].name} has {step:g} s: bring all to one step",
            )
        if len(record.values) < FEWEST_BLOCKS:
            raise InputError(record.name, "", f"holds {len(record.values)} rows; at least {FEWEST_BLOCKS} are needed")
    longest = max(len(r.values) for r in records)
    thin = -(-longest // MOST_SAMPLES)
    if thin > 1:
        records = [thinned(record, thin) for record in records]
        notes.append(f"means of {thin} neighbouring rows are taken: {longest} rows are more than {MOST_SAMPLES}")
        longest = max(len(r.values) for r in records)
    channels = max(records[0].values.shape[1], 2)
    usual, most = 2 * USUAL_BLOCKS // channels, 2 * MOST_BLOCKS // channels
    size = -(-longest // usual)
    if size > 1 and max(_within(record, size) for record in records) > MOVES_WITHIN:
        size = -(-longest // most)
    if size > 1 and max(_within(record, size) for record in records) > MOVES_WITHIN:
        notes.append(
            "the motion is fast for the length of the records: cut them, so that what is compared is not means over it"
        )
    return Records(tuple(records), size, tuple(notes))


def _within(record: Record, size: int) -> float:
    """Share of the outputs' variance, noise apart, that is within blocks; the largest."""
    count = len(record.values) // size
    whole = record.values[: count * size].reshape(count, size, -1)
    shares = []
    for k, noise in enumerate(record.noises):
        values = whole[:, :, k]
        good = np.isfinite(values).all(axis=1)
        # between neighbours of blocks a slow motion goes straight: what is within them is a twelfth of that square
        inner = values[good].var(axis=1, ddof=1).mean() - noise.sd**2 if good.any() else 0.0
        everything = np.nanvar(record.values[:, k])
        shares.append(inner / everything if everything > 0 else 0.0)
    return max(shares)


def thinned(record: Record, size: int) -> Record:
    """A record of means of neighbours.

    Parameters
    ----------
    record : with its samples
    size : of so many each
    """
    count = len(record.values) // size

    def means(values: Array) -> Array:
        return values[: count * size].reshape(count, size, values.shape[1]).mean(axis=1)

    noises = tuple(replace(noise, sd=noise.sd / np.sqrt(size)) for noise in record.noises)
    return replace(
        record, step_s=record.step_s * size, inputs=means(record.inputs), values=means(record.values), noises=noises
    )


# one table -----------------------------------------------------------------------------------------------------------


def inputs_alone(system: System, table: Path, given: Path | None = None) -> Record:
    """A table of inputs, of a record that is not made yet: nothing is measured in it.

    Parameters
    ----------
    system : the model
    table : with the columns of the inputs, and of the clock
    given : what says what they are; None: beside it

    Raises
    ------
    InputError : as of ``read_records``
    """
    path, file = read_data_file(table, given)
    columns = tuple(c for c in file.column if c.role == "input")
    return _record(system, table, path, file.model_copy(update={"column": columns}), None)


def _record(system: System, table: Path, path: Path, file: OwnData, static: dict[str, Array] | None) -> Record:
    outputs = {(c.of or c.name): c for c in file.column if c.role == "output"}
    inputs = {(c.of or c.name): c for c in file.column if c.role == "input"}
    _known(outputs, system.outputs, "output", path, system)
    _known(inputs, system.inputs, "input", path, system)
    for one in system.inputs:
        if one.name not in inputs:
            raise InputError(path, f"input {one.name}", f"{system.name} needs it, and no column is it")
    time = (file.clock.column,) if file.clock.column else ()
    columns = read_columns(table, (*time, *(c.name for c in (*outputs.values(), *inputs.values()))), file)
    count = len(next(iter(columns.values())))
    if time:
        t_s = columns[time[0]] * converted(path, "clock.unit", file.clock.unit, "s")
    else:
        t_s = np.arange(count) / (file.clock.rate_hz or 1.0)
    at, step_s = _even(table, t_s)
    values = np.full((at[-1] + 1, len(system.outputs)), np.nan)
    noises = []
    for k, output in enumerate(system.outputs):
        column = outputs.get(output.name)
        if column is None:
            noises.append(SampleNoise(1.0))
            continue
        share = _share(path, column, output)
        values[at, k] = columns[column.name] * share
        noises.append(_noise(path, column, share, static, step_s))
    given = np.zeros((at[-1] + 1, len(system.inputs)))
    for k, one in enumerate(system.inputs):
        column = inputs[one.name]
        own = columns[column.name] * _share(path, column, one)
        if np.isnan(own).any():
            raise InputError(
                table,
                f"column {column.name}",
                f"row {int(np.flatnonzero(np.isnan(own))[0]) + 1}: no value; an input must be known",
            )
        given[:, k] = np.interp(np.arange(at[-1] + 1), at, own)
    stays = tuple(inputs[one.name].hold == "step" for one in system.inputs)
    return Record(table.stem, step_s, given, values, tuple(noises), stays)


def _known(told: dict[str, OwnColumn], those: Sequence[Input | Output], kind: str, path: Path, system: System) -> None:
    names = [one.name for one in those]
    for name, column in told.items():
        if name not in names:
            known = ", ".join(names) or "none"
            raise InputError(
                path, f'column "{column.name}"', f"{name!r} is no {kind} of {system.name}, which has {known}"
            )


def _even(table: Path, t_s: Array) -> tuple[np.ndarray, float]:
    """(n,) place of each row on an even clock, and its step."""
    if len(t_s) < FEWEST_BLOCKS:
        raise InputError(table, "", f"holds {len(t_s)} rows; at least {FEWEST_BLOCKS} are needed")
    if not np.isfinite(t_s).all():
        raise InputError(table, f"row {int(np.flatnonzero(~np.isfinite(t_s))[0]) + 1}", "has no time")
    gaps = np.diff(t_s)
    if not (gaps > 0).all():
        raise InputError(
            table, f"row {int(np.flatnonzero(gaps <= 0)[0]) + 2}", "its time does not come after the row before"
        )
    usual = float(np.median(gaps))
    at = np.round((t_s - t_s[0]) / usual).astype(int)
    # rounded times of a file make a median that is a little off: the whole record has the step
    step = float((t_s[-1] - t_s[0]) / at[-1])
    off = np.abs((t_s - t_s[0]) / step - at)
    if off.max() > UNEVEN or len(np.unique(at)) < len(at):
        worst = int(np.argmax(off)) + 1
        raise InputError(
            table,
            f"row {worst}",
            f"the times are not even: about {step:g} s apart, here {off.max():.2f} of that beside",
        )
    return at, step


def _share(path: Path, column: OwnColumn, one: Input | Output) -> float:
    return converted(path, f'column "{column.name}"', column.unit, one.unit)


def converted(path: Path, where: str, given: str | None, wanted: str) -> float:
    """What a number in one unit is in another; without a unit it is in the other already.

    Parameters
    ----------
    path, where : of the number
    given, wanted : units

    Raises
    ------
    InputError : they do not fit
    """
    if given is None:
        return 1.0
    try:
        return conversion(given, wanted)
    except ValueError as error:
        raise InputError(path, where, f"unit: {error}") from None


def _static(path: Path, file: OwnData) -> dict[str, Array] | None:
    if not file.static:
        return None
    names = tuple(c.name for c in file.column if c.role == "output" and c.noise_sd is None)
    return read_columns(path.parent / file.static, names, file) if names else None


def _noise(path: Path, column: OwnColumn, share: float, static: dict[str, Array] | None, step_s: float) -> SampleNoise:
    if column.noise_sd is not None:
        return SampleNoise(abs(share) * column.noise_sd)
    if static is None:
        raise InputError(
            path, f'column "{column.name}"', "noise_sd: missing, and there is no static record that would tell it"
        )
    values = static[column.name] * share
    # what goes slowly is not in the differences of neighbours
    values = values[np.isfinite(values)][:MOST_SAMPLES]
    sd = float(np.std(np.diff(values)) / np.sqrt(2)) if len(values) > 2 else 0.0
    if not sd > 0:
        raise InputError(path, f'column "{column.name}"', "the static record does not scatter; give noise_sd")
    (still,) = still_noise([(values / sd)[:, None]], step_s)
    return SampleNoise(sd, still)


def _names(those: Sequence[State | Input | Output | Number]) -> str:
    return ", ".join(one.name for one in those)


__all__ = [
    "Model",
    "Record",
    "Records",
    "SampleNoise",
    "adapted",
    "converted",
    "inputs_alone",
    "read_records",
    "thinned",
    "together",
]
