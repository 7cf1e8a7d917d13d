"""Where the day stands, kept beside its tows: the page shows it after a reload and after a crash."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..__version__ import __version__
from ..record.day_file import DayFile, DayNext, DayWish
from ..record.priors import DERIVATIVE_NAMES
from ..record.results import DerivativesFile, Measured, read_result, write_result
from .tows import Standing, percent_of, standing_lines

DAY = "day.json"
"""In the folder of the day's tows."""


def day_file(standing: Standing) -> DayFile:
    """What is kept of it.

    Parameters
    ----------
    standing : of ``Day.after``
    """
    result, wishes = standing.result, {wish.name: wish for wish in standing.wishes}
    table: dict[str, DayWish] = {}
    for name in DERIVATIVE_NAMES:
        known = None if result is None else result.derivatives.get(name)
        wish = wishes.get(name)
        table[name] = DayWish(
            value=None if known is None else known.value,
            std=None if known is None else known.std,
            unit="" if known is None else known.unit,
            percent=None if known is None else percent_of(known.value, known.std),
            wished_percent=None if wish is None else wish.wished,
            met=None if wish is None else wish.met,
        )
    ahead = standing.next_tow
    return DayFile(
        schema="towline/day",
        tool=__version__,
        inputs={} if result is None else result.inputs,
        tows=list(standing.tows),
        repeat=standing.failed,
        named={name: list(words) for name, words in standing.named.items()},
        derivatives=table,
        x_v_m=None if result is None else neutral_point(result),
        enough=standing.enough,
        next_tow=None if ahead is None else DayNext(**vars(ahead.plan), percent=ahead.percent),
        problem=standing.problem,
        words=standing_lines(standing),
    )


def neutral_point(result: DerivativesFile) -> Measured | None:
    """X_v = N_v / Y_v with its standard deviation; None where one of them is not determined.

    Parameters
    ----------
    result : of the joint fit
    """
    names, known = list(result.derivatives), result.derivatives
    if "y_v" not in known or "n_v" not in known:
        return None
    y_v, n_v = known["y_v"], known["n_v"]
    together = result.correlation[names.index("y_v")][names.index("n_v")] * y_v.std * n_v.std
    slope = np.array([-n_v.value / y_v.value**2, 1 / y_v.value])
    covariance = np.array([[y_v.std**2, together], [together, n_v.std**2]])
    return Measured(value=n_v.value / y_v.value, std=float(np.sqrt(max(slope @ covariance @ slope, 0.0))))


def keep_day(day: Path, standing: Standing) -> Path:
    """Write day.json.

    Parameters
    ----------
    day : folder of the day's tows
    standing : of ``Day.after``
    """
    write_result(day / DAY, day_file(standing))
    return day / DAY


def kept_day(day: Path) -> DayFile | None:
    """What was kept; None: nothing yet.

    Parameters
    ----------
    day : folder of the day's tows

    Raises
    ------
    InputError : day.json is damaged
    """
    return read_result(day / DAY, DayFile) if (day / DAY).is_file() else None


__all__ = ["DAY", "day_file", "keep_day", "kept_day", "neutral_point"]
