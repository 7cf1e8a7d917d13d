"""Rows of the budget's tables, shared by terminal, page and papers: lines of one input over all runs together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..record.budget_file import BudgetFile, BudgetLine, CarriedQuantity
from .format import NONE, interval_text, plus_minus, round_pair, significant

SHORT = {
    "m_minus_y_vdot": "m'",
    "i_minus_n_rdot": "I'",
    "y_v": "Y_v",
    "y_r_minus_mu": "Y_R",
    "n_v": "N_v",
    "n_r": "N_r",
    "y_delta": "Y_delta",
    "n_delta": "N_delta",
    "x_v_m": "X_v",
}
"""Heads of narrow columns; m' = m - Y_vdot, I' = I - N_rdot, Y_R = Y_r - mU."""
MEANT = "m' = m - Y_vdot, I' = I - N_rdot, Y_R = Y_r - mU"
LEAST_SHARE = 5e-4
"""A share of the variance below 0.05 % is printed as 0."""
STEPS = {
    "m": (1e-3, "1 mm"),
    "1": (1e-3, "0.1 %"),
    "m/s": (1e-3, "1 mm/s"),
    "kg": (0.1, "0.1 kg"),
    "N": (0.01, "0.01 N"),
}
"""By what an input that is not included is moved where its effect is shown: (step, in words). A choice."""
INFINITE = "inf"


@dataclass(frozen=True)
class SourceRow:
    """One input, over the runs.

    Attributes
    ----------
    source, name : of the lines
    evaluation : "A" or "B"
    std : standard uncertainty of the input with its unit
    degrees : of freedom
    shares : quantity -> share of its variance
    contributions : quantity -> standard uncertainty by it
    origin : where its standard uncertainty comes from
    """

    source: str
    name: str
    evaluation: str
    std: str
    degrees: str
    shares: dict[str, float]
    contributions: dict[str, float]
    origin: str


def source_rows(file: BudgetFile) -> list[SourceRow]:
    """Inputs that are included, those of one source together, the source with most of the mean share first.

    Parameters
    ----------
    file : budget.json
    """
    groups: dict[tuple[str, str], list[BudgetLine]] = {}
    for line in file.lines:
        if line.status != "not included":
            groups.setdefault((line.source, line.name), []).append(line)
    rows = [_row(source, name, lines, list(file.quantities)) for (source, name), lines in groups.items()]
    weight: dict[str, float] = {}
    for row in rows:
        weight[row.source] = weight.get(row.source, 0.0) + sum(row.shares.values())
    return sorted(rows, key=lambda row: (-weight[row.source], row.source, -sum(row.shares.values())))


def _row(source: str, name: str, lines: Sequence[BudgetLine], names: Sequence[str]) -> SourceRow:
    stds = [line.std for line in lines if line.std is not None]
    unit = lines[0].unit if lines[0].unit != "1" else ""
    shown = NONE
    if stds:
        low, high = significant(min(stds), 2), significant(max(stds), 2)
        shown = f"{low if low == high else f'{low} to {high}'} {unit}".rstrip()
    degrees = {line.degrees for line in lines}
    finite = [d for d in degrees if d is not None]
    return SourceRow(
        source,
        name if len(lines) == 1 or not lines[0].run else f"{name} ({len(lines)})",
        "/".join(sorted({line.evaluation for line in lines})),
        shown,
        INFINITE if not finite else degrees_text(min(finite)),
        {n: sum(line.share[n] for line in lines) for n in names},
        {n: float(np.sqrt(sum(line.contribution[n] ** 2 for line in lines))) for n in names},
        "; ".join(dict.fromkeys(line.origin for line in lines)),
    )


def degrees_text(degrees: float | None) -> str:
    """Degrees of freedom, whole; ``inf`` where they are not finite.

    Parameters
    ----------
    degrees : None: infinite
    """
    if degrees is None:
        return INFINITE
    return f"{degrees:.0f}" if degrees < 1e4 else f"{degrees:.0e}".replace("e+0", "e")


def share_text(share: float) -> str:
    """A share of the variance in %.

    Parameters
    ----------
    share : 0 to 1
    """
    return "0" if share < LEAST_SHARE else f"{100 * share:.1f}"


def quantity_rows(file: BudgetFile) -> list[list[str]]:
    """Symbol, value, u of the fit, u combined, degrees, k, U, U in %, prime.

    Parameters
    ----------
    file : budget.json
    """
    rows = []
    for name, q in file.quantities.items():
        value, u = round_pair(q.value, q.combined_std)
        percent = significant(100 * q.expanded / abs(q.value), 2) if q.value else NONE
        prime = NONE if q.prime is None or q.prime_std is None else plus_minus(1e3 * q.prime, 1e3 * q.prime_std)
        told = [degrees_text(q.degrees), f"{q.coverage_factor:.2f}", significant(q.expanded, 2), percent, prime]
        rows.append([SHORT[name], value, q.unit, significant(q.fit_std, 2), u, *told])
    return rows


QUANTITY_HEAD = ("", "value", "unit", "u fit", "u_c", "nu_eff", "k", "U", "U, %", "prime x1e3")
"""Heads of ``quantity_rows``."""


@dataclass(frozen=True)
class ExactRow:
    """An input that is not included.

    Attributes
    ----------
    source, name : of the line
    step : by what it is moved, in words; empty: it has no sensitivity
    moves : quantity -> change in % of it
    why : it is not included
    """

    source: str
    name: str
    step: str
    moves: dict[str, float]
    why: str


def exact_rows(file: BudgetFile) -> list[ExactRow]:
    """Inputs that are not included, with what an error of theirs would do.

    Parameters
    ----------
    file : budget.json
    """
    rows = []
    for line in (one for one in file.lines if one.status == "not included"):
        step, words = STEPS.get(line.unit, (1.0, f"1 {line.unit}"))
        moves = {n: 100 * c * step / file.quantities[n].value for n, c in line.sensitivity.items()}
        name = f"{line.name} ({line.run})" if line.run else line.name
        rows.append(ExactRow(line.source, name, words if any(moves.values()) else "", moves, line.origin))
    return rows


def moves_text(percent: float) -> str:
    """A change in %, two decimals; ``0`` where they would be zeros.

    Parameters
    ----------
    percent : of the quantity
    """
    return f"{percent:+.2f}" if abs(percent) >= 0.005 else "0"


def carried_text(q: CarriedQuantity) -> tuple[str, str]:
    """Value with its standard uncertainty, and the interval of the draws; angles in degrees.

    Parameters
    ----------
    q : of the budget
    """
    degrees = q.unit == "rad"
    by = float(np.degrees(1.0)) if degrees else 1.0
    unit = "deg" if degrees else "" if q.unit == "1" else q.unit
    if q.value is None:
        value = NONE
    elif q.combined_std is not None:
        value = plus_minus(by * q.value, by * q.combined_std, unit)
    else:
        value = f"{significant(by * q.value, 3)} {unit}".rstrip()
    if q.interval is None:
        return value, f"{NONE} ({100 * q.share:.0f} % of the draws have it)"
    return value, f"{interval_text(by * q.interval[0], by * q.interval[1])} {unit}".rstrip()


def probability_text(p: float) -> str:
    """A probability to three decimals, never a certainty.

    Parameters
    ----------
    p : 0 to 1
    """
    return "above 0.999" if p > 0.999 else "below 0.001" if p < 0.001 else f"{p:.3f}"


__all__ = [
    "MEANT",
    "QUANTITY_HEAD",
    "SHORT",
    "ExactRow",
    "SourceRow",
    "carried_text",
    "degrees_text",
    "exact_rows",
    "moves_text",
    "probability_text",
    "quantity_rows",
    "share_text",
    "source_rows",
]
