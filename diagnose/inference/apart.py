"""What can be told without a tow: a filmed clock, a tape along the datum, the marks' height by rule."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ...record.errors import InputError
from ...record.run import RUN_FILE, Run
from ..effects import Effect
from .hypothesis import Hypothesis


@dataclass(frozen=True)
class Apart:
    """A number of an effect, measured apart from the runs.

    Attributes
    ----------
    value, sd : what was measured, SI
    none : value at which the effect is absent
    """

    value: float
    sd: float
    none: float = 0.0


def measured_apart(runs: Iterable[Run], library: Sequence[Effect]) -> dict[str, Apart]:
    """The runs' [[measured]] tables, effect.number -> value; what several runs state is one measurement.

    Parameters
    ----------
    runs : their folders as read
    library : effects that may be named

    Raises
    ------
    InputError : no effect has such a number, or two runs state it differently
    """
    absent = {f"{e.name}.{q.name}": q.none for e in library for q in e.parameters}
    found: dict[str, Apart] = {}
    for run in runs:
        for k, table in enumerate(run.file.measured):
            where = f"measured[{k}].number"
            if table.number not in absent:
                known = ", ".join(sorted(absent))
                raise InputError(run.folder / RUN_FILE, where, f"{table.number!r}: expected one of {known}")
            one = Apart(table.value, table.sd, absent[table.number])
            if found.setdefault(table.number, one) != one:
                raise InputError(
                    run.folder / RUN_FILE,
                    where,
                    f"{table.number!r} is {one.value:g} +- {one.sd:g} here and {found[table.number].value:g} +- "
                    f"{found[table.number].sd:g} in another run; it is one measurement",
                )
    return found


def measurement(hypothesis: Hypothesis, known: Mapping[str, Apart]) -> list[tuple[float, Effect, dict[str, float]]]:
    """For each effect of a hypothesis that can be measured without a tow: expected D from its absence, the effect, how well its
    numbers can be measured (``Parameter.apart``).

    Parameters
    ----------
    hypothesis : with its numbers
    known : measured already
    """
    found = []
    for effect, numbers in zip(hypothesis.effects, hypothesis.numbers, strict=True):
        here = [
            (q, float(number))
            for q, number in zip(effect.parameters, numbers, strict=True)
            if q.apart > 0 and f"{effect.name}.{q.name}" not in known
        ]
        if here:
            distance = sum(((number - q.none) / q.apart) ** 2 for q, number in here)
            found.append((distance, effect, {f"{effect.name}.{q.name}": q.apart for q, _ in here}))
    return found


__all__ = ["Apart", "measured_apart", "measurement"]
