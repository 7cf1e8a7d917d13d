"""Channels as the instruments recorded them: own times, own rates, holes; and their values at other times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..tables import first_fall, numbers_of, read_table
from .setup import ChannelTable, SetupFile

Array = NDArray[Any]
GAP = 1.5
"""Two samples are neighbours up to this many usual steps apart; over more nothing is interpolated."""
SAME = 1e-6
"""A time this share of a step beside a sample is that sample's."""


@dataclass(frozen=True)
class Channel:
    """One channel.

    Attributes
    ----------
    table : what it measures
    t_s : (n,) rising, s, on its clock (or on the reference, once changed)
    value : (n,) m, rad or N; NaN is a hole
    """

    table: ChannelTable
    t_s: Array
    value: Array

    @property
    def step_s(self) -> float:
        """Its usual step."""
        return float(np.median(np.diff(self.t_s)))

    def at(self, times: Array) -> tuple[Array, Array]:
        """Value and standard deviation at other times (n,), by the cubic through the four samples around each.

        NaN outside the record, in holes, and between samples more than 1.5 usual steps apart; a straight line where one of the
        outer two samples is missing. The deviation is that of the weighted sum of independent readings.
        """
        times = np.asarray(times, dtype=float)
        t, y, step = self.t_s, self.value, self.step_s
        left = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
        index = left[:, None] + np.arange(-1, 3)
        there = (index >= 0) & (index < len(t))
        index = np.clip(index, 0, len(t) - 1)
        nodes, values = t[index], y[index]
        near = np.abs(np.diff(nodes, axis=1)) <= GAP * step
        good = there & np.isfinite(values)
        inner = good[:, 1] & good[:, 2] & near[:, 1]
        cubic = inner & good[:, 0] & good[:, 3] & near[:, 0] & near[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (times - nodes[:, 1]) / (nodes[:, 2] - nodes[:, 1])
            line = np.stack([np.zeros_like(share), 1 - share, share, np.zeros_like(share)], axis=1)
            curve = np.ones_like(line)
            for i in range(4):
                for j in range(4):
                    if i != j:
                        curve[:, i] *= (times - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
        weights = np.where(cubic[:, None], curve, line)
        inside = inner & (times >= t[0]) & (times <= t[-1])
        with np.errstate(invalid="ignore"):
            found = np.where(weights != 0, weights * values, 0.0).sum(axis=1)
            sd = self.table.sd * np.sqrt((weights**2).sum(axis=1))
        found, sd = np.where(inside, found, np.nan), np.where(inside, sd, np.nan)
        for offset in (1, 2):
            exact = np.abs(times - nodes[:, offset]) <= SAME * step
            found = np.where(exact, values[:, offset], found)
            sd = np.where(exact, np.where(np.isfinite(values[:, offset]), self.table.sd, np.nan), sd)
        return found, sd

    def on(self, times: Array) -> Channel:
        """The same readings at other times."""
        return replace(self, t_s=times)


def read_channels(path: str | Path, setup: SetupFile, setup_path: str | Path = "setup.toml") -> dict[str, Channel]:
    """Read every channel of the set-up.

    Channels of different rates stand side by side with a column of times each; rows that a shorter channel does not fill are empty.
    A value missing beside its time is a hole.

    Parameters
    ----------
    path : of the table
    setup : which columns are wanted
    setup_path : its file, for messages

    Returns
    -------
    name -> channel

    Raises
    ------
    InputError : names file, row and column: no such column, no number, a value without a time, times that do not rise
    """
    found: dict[str, Channel] = {}
    for table in setup.channel:
        source = Path(path) if table.file is None else Path(setup_path).parent / table.file
        column = table.column or table.name
        frame = read_table(source, (table.time, column))
        numbers: dict[str, Array] = {}
        for name in (table.time, column):
            values = numbers_of(frame[name])
            wrong = np.isinf(values) | (np.isnan(values) & frame[name].notna().to_numpy())
            if wrong.any():
                row = int(np.flatnonzero(wrong)[0])
                raise InputError(source, f"row {row + 1}, {name}", f"{frame[name].iloc[row]!r} is not a finite number")
            numbers[name] = values
        t_s, value = numbers[table.time], table.scale * (numbers[column] - table.zero)
        lonely = np.isnan(t_s) & np.isfinite(value)
        if lonely.any():
            row = int(np.flatnonzero(lonely)[0])
            raise InputError(source, f"row {row + 1}, {table.time}", f"is empty beside a value of {column}")
        rows = np.flatnonzero(np.isfinite(t_s))
        t_s, value = t_s[rows], value[rows]
        at = first_fall(t_s)
        if at is not None:
            raise InputError(
                source,
                f"row {rows[at] + 1}, {table.time}",
                f"{t_s[at]:g} after {t_s[at - 1]:g}; times must rise strictly",
            )
        if np.isfinite(value).sum() < 4:
            raise InputError(
                source, f"column {column}", f"{int(np.isfinite(value).sum())} values; at least 4 are needed"
            )
        found[table.name] = Channel(table, t_s, value)
    return found
