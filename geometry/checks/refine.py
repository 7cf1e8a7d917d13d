"""Self-calibration: chosen camera parameters estimated from the invariants over all runs of one set-up. Never silent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...record.check_file import Refined
from ...record.errors import GeometryError
from .check import Check

CHOICES = {
    "deck_height": ("deck height",),
    "k1": ("k1",),
    "k2": ("k2",),
    "focal": ("fx", "fy"),
    "centre": ("cx", "cy"),
    "datum_width": ("datum width",),
    "datum_length": ("datum length",),
    "datum_scale": ("datum width", "datum length"),
    "line_length": ("line length",),
    "tow_point": ("tow point",),
    "post_ahead": ("post ahead",),
}
"""Names on the command line -> parameters. The camera's tilt and place are always estimated, from datum and invariants together."""
WIDE = {"k1": 0.3, "k2": 0.3, "fx": 0.2, "fy": 0.2, "cx": 100.0, "cy": 100.0, "datum width": 0.1, "datum length": 0.1}
"""Standard deviations of the priors of a refinement (fx, fy and the datum's sides as shares; cx, cy in px): wide on
purpose."""
WIDE_M = 0.2
"""The same for lengths, m."""
OBSERVABLE = 0.3
"""A parameter whose standard deviation is below this share of what was thought possible is told by the runs."""
TIED = 0.95
"""Correlation from which two parameters are said to be told only together."""


def refined(check: Check, wanted: Sequence[str]) -> tuple[list[Refined], list[str]]:
    """Estimate parameters with wide priors.

    Parameters
    ----------
    check : of the set-up
    wanted : of CHOICES

    Returns
    -------
    values, and sentences on what these runs do not tell

    Raises
    ------
    GeometryError : an unknown name
    """
    unknown = [name for name in wanted if name not in CHOICES]
    if unknown:
        raise GeometryError(f"--refine {unknown[0]}; expected one of {', '.join(CHOICES)}")
    bundle = check.bundle
    names = list(bundle.names)
    chosen = list(dict.fromkeys(name for key in wanted for name in CHOICES[key]))
    columns = [names.index(name) for name in chosen]
    focal = {"fx": bundle.rig.lens.fx_px, "fy": bundle.rig.lens.fy_px}
    wide = np.array([WIDE.get(name, WIDE_M) * focal.get(name, 1.0) for name in chosen])
    sd = check.sd.copy()
    sd[columns] = wide
    solution = bundle.solve(sd, first=check.null)
    covariance = solution.covariance[np.ix_(columns, columns)]
    spread = np.sqrt(np.diag(covariance))
    values: list[Refined] = []
    for name, column, std, loose in zip(chosen, columns, spread, wide, strict=True):
        stated, unit = _stated(check, name)
        values.append(
            Refined(
                parameter=name,
                stated=stated,
                value=stated + float(solution.theta[column]),
                std=float(std),
                unit=unit,
                observable=bool(std < OBSERVABLE * loose),
            )
        )
    return values, open_words(chosen, covariance, wide, values)


def _stated(check: Check, name: str) -> tuple[float, str]:
    lens = check.bundle.rig.lens
    numbers = dict(zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), lens.vector, strict=True))
    if name in numbers:
        return float(numbers[name]), "px" if name in ("fx", "fy", "cx", "cy") else ""
    if name in ("datum width", "datum length"):
        return 1.0, ""
    if name == "line length":
        lines = [film.line_m for film in check.bundle.films if film.line_m is not None]
        return float(lines[0]) if lines else 0.0, "m"
    if name == "tow point":
        return float(check.bundle.films[0].tow_point_m[0]), "m"
    if name == "post ahead":
        return float(check.bundle.films[0].post_m[0]), "m"
    return 0.0, "m"


def open_words(names: Sequence[str], covariance: np.ndarray, wide: np.ndarray, values: Sequence[Refined]) -> list[str]:
    """Say which numbers the runs do not tell, alone or apart from another.

    Parameters
    ----------
    names : of the k numbers
    covariance : (k, k) as fitted
    wide : (k,) how far each may be off at most
    values : the numbers as refined

    Returns
    -------
    said : one sentence for each number that is left as stated, each pair known only together, and each open direction
    """
    said = [
        f"{v.parameter} is not told by these runs (+- {v.std:.3g} {v.unit}".rstrip() + "); it is left as stated"
        for v in values
        if not v.observable
    ]
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale)
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > TIED:
                slope = correlation[i, j] * scale[i] / scale[j]
                said.append(
                    f"{names[j]} and {names[i]} are told only together (correlation {correlation[i, j]:+.3f}): these runs fix "
                    f"{names[i]} {-slope:+.3g} {names[j]}, not both"
                )
    share, directions = np.linalg.eigh(covariance / np.outer(wide, wide))
    for value, direction in zip(share, directions.T, strict=True):
        if np.sqrt(value) > OBSERVABLE and np.count_nonzero(np.abs(direction) > 0.2) > 1:
            mix = " ".join(f"{c:+.2f} {n}" for c, n in zip(direction, names, strict=True) if abs(c) > 0.2)
            said.append(f"null direction, in shares of what is possible: {mix}")
    return said
