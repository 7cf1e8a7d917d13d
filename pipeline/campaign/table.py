"""One tidy table of a campaign: a row for every quantity of every run and fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ...record.campaigns import Answer
from ...record.files import replacing
from ...record.names import shown
from ...record.tables import for_people

COLUMNS = ("level", "name", "folder", "quantity", "value", "std", "unit", "reason")


def tidy(runs: Sequence[Answer], fits: Sequence[Answer]) -> pd.DataFrame:
    """Rows of runs, then of fits; what failed has one row with its reason and no quantity.

    Parameters
    ----------
    runs : answers of the runs
    fits : answers of the fits
    """
    rows = []
    for level, answers in (("run", runs), ("fit", fits)):
        for a in answers:
            where = a.job if level == "run" else ""
            if a.reason:
                rows.append((level, a.name or a.job, where, "", math.nan, math.nan, "", a.reason))
            for quantity, value, std, unit in a.numbers:
                rows.append((level, a.name, where, quantity, value, math.nan if std is None else std, unit, ""))
    said = [tuple(shown(cell) if isinstance(cell, str) else cell for cell in row) for row in rows]
    return pd.DataFrame(said, columns=list(COLUMNS)).astype({"value": float, "std": float})


def write_tidy(folder: Path, table: pd.DataFrame) -> list[Path]:
    """campaign.csv (texts that a spreadsheet would calculate begin with ') and campaign.parquet (as they are).

    Parameters
    ----------
    folder : where they go
    table : what is written
    """
    paths = [folder / "campaign.csv", folder / "campaign.parquet"]
    with replacing(paths[0]) as temporary:
        for_people(table).to_csv(temporary, index=False, lineterminator="\n")
    with replacing(paths[1]) as temporary, temporary.open("wb") as stream:
        table.to_parquet(stream, index=False)
    return paths


__all__ = ["COLUMNS", "tidy", "write_tidy"]
