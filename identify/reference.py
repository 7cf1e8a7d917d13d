"""Reference sets of the six derivatives, in primes: the thesis's two, or any CSV; and a result set against one.

A CSV has a header with ``name`` and ``value`` and, optionally, ``std``; lines that start with ``#`` before the header are
its source. Names: the six of ``DERIVATIVE_UNITS`` (all needed), and, where known, ``mass`` (m over rho/2 L^3) and
``yaw_inertia`` (I over rho/2 L^5). Values are non-dimensional (theory.md 2), not times 1e3.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import chdtrc

from ..record.errors import EstimationError, InputError
from ..record.files import TABLE_BYTES, read_text
from ..record.results import DerivativesFile
from ..simulate.model import DERIVATIVE_UNITS, Array, Hull
from .prime import prime_factors

BUILT_IN = ("ittc", "southampton")
FOLDER = Path(__file__).with_name("references")
EXTRA = ("mass", "yaw_inertia")
LARGEST_PRIME = 1.0
"""No prime derivative of a ship is as large; one that is was given times 1e3 or with its dimension."""
MASS_DIFFERS = 0.01
"""Masses that differ by more than this share are said: m' and Y_R hold the hull's own mass."""


@dataclass(frozen=True)
class ReferenceSet:
    """Six prime derivatives.

    Attributes
    ----------
    name, source : of the set; the source is the file's leading comment
    prime : (6,), in the order of ``DERIVATIVE_UNITS``
    prime_std : (6,), 0 where the file states none
    mass_prime, inertia_prime : m' and I' of the hull they were measured on, or None
    """

    name: str
    source: str
    prime: Array
    prime_std: Array
    mass_prime: float | None = None
    inertia_prime: float | None = None

    def dimensional(self, density_kg_m3: float, length_pp_m: float, speed_m_s: float) -> tuple[Array, Array]:
        """Values and standard deviations, (6,) each, SI, at that water, length and speed."""
        factors = prime_factors(density_kg_m3, length_pp_m, speed_m_s)
        return self.prime * factors, self.prime_std * factors

    def hull(
        self,
        density_kg_m3: float,
        length_pp_m: float,
        speed_m_s: float,
        mass_kg: float | None = None,
        yaw_inertia_kg_m2: float | None = None,
    ) -> Hull:
        """The hull of a model of that size, and of that mass and dry inertia where the set knows its own.

        m - Y_vdot and Y_r - mU take the difference in m, I - N_rdot that in I; the water's own parts keep their primes.
        """
        mass, inertia, *damping = self.dimensional(density_kg_m3, length_pp_m, speed_m_s)[0]
        y_v, y_r, n_v, n_r = damping
        if mass_kg is not None and self.mass_prime is not None:
            more = mass_kg - self.mass_prime * 0.5 * density_kg_m3 * length_pp_m**3
            mass, y_r = mass + more, y_r - more * speed_m_s
        if yaw_inertia_kg_m2 is not None and self.inertia_prime is not None:
            inertia += yaw_inertia_kg_m2 - self.inertia_prime * 0.5 * density_kg_m3 * length_pp_m**5
        return Hull(float(mass), float(inertia), float(y_v), float(y_r), float(n_v), float(n_r), speed_m_s)


@dataclass(frozen=True)
class ReferenceRow:
    """One derivative against its reference; dimensional, at the result's own speed, water and length.

    Attributes
    ----------
    name, unit
    value, std : of the result
    reference, reference_std : of the set; std 0 = none stated
    difference_percent : (value - reference)/|reference|, %
    difference_sd : (value - reference) over both standard deviations together
    """

    name: str
    unit: str
    value: float
    std: float
    reference: float
    reference_std: float
    difference_percent: float
    difference_sd: float


@dataclass(frozen=True)
class Comparison:
    """A result against a reference set.

    Attributes
    ----------
    rows : per derivative that the result holds
    chi_square, p_value : of all differences with their correlations, on as many degrees of freedom: were the reference
        the truth, a difference as large or larger would have this probability
    notes : what the reader must know
    """

    reference: ReferenceSet
    rows: tuple[ReferenceRow, ...]
    chi_square: float
    p_value: float
    notes: tuple[str, ...]


def reference_set(name: str, folder: Path | None = None) -> ReferenceSet:
    """A built-in set by its name, or a CSV by its path (from ``folder`` where relative).

    Parameters
    ----------
    name : of the set, or a path
    folder : where relative paths begin

    Raises
    ------
    InputError : no such set or file, or a row that cannot be used, with its number and content
    """
    if name in BUILT_IN:
        return read_reference(FOLDER / f"{name}.csv")
    path = Path(name) if folder is None else folder / name
    if not path.exists():
        raise InputError(path, "", f"no such file, and no built-in reference set; known: {', '.join(BUILT_IN)}")
    return read_reference(path)


def read_reference(path: str | Path) -> ReferenceSet:
    """Read a reference CSV (this module's docstring says how it looks).

    Raises
    ------
    InputError : names the row (counted from 1, comments and header included) and the value
    """
    path = Path(path)
    lines = read_text(path, TABLE_BYTES).splitlines()
    source: list[str] = []
    while len(source) < len(lines) and lines[len(source)].lstrip().startswith("#"):
        source.append(lines[len(source)].lstrip("# ").strip())
    begin = len(source)
    if begin == len(lines):
        raise InputError(path, f"row {begin + 1}", "nothing here; a header with name and value is expected")
    header = [cell.strip() for cell in next(csv.reader([lines[begin]]))]
    unknown = [cell for cell in header if cell not in ("name", "value", "std")]
    if unknown or "name" not in header or "value" not in header:
        raise InputError(
            path, f"row {begin + 1}", f"{lines[begin]!r}: a header of name, value and optionally std is expected"
        )
    found: dict[str, tuple[float, float]] = {}
    for number, line in enumerate(lines[begin + 1 :], begin + 2):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in next(csv.reader([line]))]
        if len(cells) != len(header):
            raise InputError(path, f"row {number}", f"{line!r}: {len(cells)} fields; {len(header)} are expected")
        row = dict(zip(header, cells, strict=True))
        name = row["name"]
        if name not in (*DERIVATIVE_UNITS, *EXTRA):
            raise InputError(
                path, f"row {number}", f"name {name!r}: one of {', '.join((*DERIVATIVE_UNITS, *EXTRA))} is expected"
            )
        if name in found:
            raise InputError(path, f"row {number}", f"{name!r} stands here a second time")
        found[name] = _number(path, number, name, row["value"]), _std(path, number, name, row.get("std", ""))
    missing = [name for name in DERIVATIVE_UNITS if name not in found]
    if missing:
        raise InputError(path, f"row {len(lines)}", f"the file ends without {', '.join(missing)}; all six are needed")
    six = np.array([found[name] for name in DERIVATIVE_UNITS])
    mass, inertia = (found[name][0] if name in found else None for name in EXTRA)
    return ReferenceSet(path.stem, " ".join(source), six[:, 0], six[:, 1], mass, inertia)


def _number(path: Path, row: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(path, f"row {row}", f"value of {name} is {text!r}; a number is expected") from None
    if not np.isfinite(value) or value == 0 or abs(value) >= LARGEST_PRIME:
        raise InputError(
            path,
            f"row {row}",
            f"value of {name} is {text}; a prime value, not 0 and below {LARGEST_PRIME:g}, is expected (not times 1e3)",
        )
    if name in ("m_minus_y_vdot", "i_minus_n_rdot", *EXTRA) and value < 0:
        raise InputError(path, f"row {row}", f"value of {name} is {text}; a mass or inertia above 0 is expected")
    return value


def _std(path: Path, row: int, name: str, text: str) -> float:
    if not text:
        return 0.0
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or value < 0:
        raise InputError(path, f"row {row}", f"std of {name} is {text!r}; a number not below 0 is expected")
    return value


def set_of_result(result: DerivativesFile, name: str = "derivatives.json") -> ReferenceSet:
    """A result as a set, to be scaled to another model or speed; the mass is the model's.

    Parameters
    ----------
    result : derivatives.json
    name : of the set

    Raises
    ------
    EstimationError : the result does not hold all six derivatives (free runs alone give ratios)
    """
    absent = [key for key in DERIVATIVE_UNITS if key not in result.derivatives]
    if absent or result.density_kg_m3 is None:
        raise EstimationError(
            f"{name} does not hold {', '.join(absent) or 'density_kg_m3'}; all six derivatives are needed"
        )
    prime = np.array([result.derivatives[key].prime for key in DERIVATIVE_UNITS])
    std = np.array([result.derivatives[key].prime_std for key in DERIVATIVE_UNITS])
    mass = result.mass_kg / (0.5 * result.density_kg_m3 * result.length_pp_m**3)
    return ReferenceSet(name, name, prime, std, mass)


def compare_to_reference(result: DerivativesFile, reference: ReferenceSet) -> Comparison:
    """Each derivative of ``result`` against ``reference`` at the result's own water, length and speed.

    Parameters
    ----------
    result : derivatives.json
    reference : the set

    Raises
    ------
    EstimationError : the result determines none
    """
    if not set(DERIVATIVE_UNITS) & set(result.derivatives) or result.density_kg_m3 is None:
        raise EstimationError("the result holds no derivative of the six; there is nothing to compare")
    size = (result.density_kg_m3, result.length_pp_m, result.speed_m_s)
    values, stds = reference.dimensional(*size)
    rows = []
    for i, (name, unit) in enumerate(DERIVATIVE_UNITS.items()):
        if name not in result.derivatives:  # the record did not determine it
            continue
        mine = result.derivatives[name]
        gap = mine.value - values[i]
        both = float(np.hypot(mine.std, stds[i]))
        rows.append(
            ReferenceRow(
                name=name,
                unit=unit,
                value=mine.value,
                std=mine.std,
                reference=float(values[i]),
                reference_std=float(stds[i]),
                difference_percent=100 * gap / abs(float(values[i])),
                difference_sd=gap / both if both > 0 else float(np.copysign(np.inf, gap)) if gap else 0.0,
            )
        )
    # in standard deviations first: a result without scatter gives an infinite chi-square, not a singular matrix
    own, gaps = np.array([r.std for r in rows]), np.array([r.value - r.reference for r in rows])
    known = np.diag([r.reference_std**2 for r in rows])
    order = [list(result.derivatives).index(r.name) for r in rows]
    covariance = np.array(result.correlation)[np.ix_(order, order)] * own[:, None] * own[None, :] + known
    scale = np.sqrt(np.diag(covariance))
    if (scale > 0).all():
        z = gaps / scale
        square = float(
            z @ np.linalg.pinv(covariance / scale[:, None] / scale[None, :], rcond=1e-12, hermitian=True) @ z
        )
    else:
        square = float("inf")
    p_value = float(chdtrc(len(rows), square))
    return Comparison(reference, tuple(rows), square, p_value, tuple(_notes(result, reference)))


def _notes(result: DerivativesFile, reference: ReferenceSet) -> list[str]:
    notes = []
    if not reference.prime_std.any():
        notes.append("the reference states no uncertainty: differences in sd count the result's own only")
    if reference.mass_prime is not None and result.density_kg_m3 is not None:
        mine = result.mass_kg / (0.5 * result.density_kg_m3 * result.length_pp_m**3)
        if abs(mine / reference.mass_prime - 1) > MASS_DIFFERS:
            share = 100 * (mine - reference.mass_prime)
            m, y_r = share / reference.prime[0], -share / abs(reference.prime[3])
            notes.append(
                f"the model's mass is {1e3 * mine:.3f}e-3 in primes, the reference hull's {1e3 * reference.mass_prime:.3f}e-3: "
                f"that alone makes {m:+.1f} % in m - Y_vdot and {y_r:+.1f} % in Y_r - mU"
            )
    return notes


def comparison_lines(comparison: Comparison, symbols: dict[str, str] | None = None) -> list[str]:
    """The comparison as a table of plain text lines for a terminal.

    Parameters
    ----------
    comparison : of each derivative
    symbols : name -> how it is written; None: plain
    """
    names = symbols or {row.name: row.name for row in comparison.rows}
    wide = max(len(name) for name in names.values())
    lines = [
        f"against {comparison.reference.name}: {comparison.reference.source}" if comparison.reference.source else "",
        f"{'':{wide}} {'value':>11} {'+- sd':>9} {'reference':>11} {'+- sd':>9}  {'unit':<6} {'differs %':>9} {'in sd':>8}",
    ]
    for row in comparison.rows:
        spread = f"{row.reference_std:9.3g}" if row.reference_std else f"{'-':>9}"
        lines.append(
            f"{names[row.name]:{wide}} {row.value:11.3f} {row.std:9.3g} {row.reference:11.3f} {spread}  {row.unit:<6} "
            f"{row.difference_percent:+9.2f} {row.difference_sd:+8.1f}"
        )
    count = len(comparison.rows)
    lines.append(
        f"all {count} together: chi-square {comparison.chi_square:.1f} on {count}, p = {comparison.p_value:.2g}"
        " (the chance of so large a difference, were the reference the truth)"
    )
    return [line for line in lines if line]
