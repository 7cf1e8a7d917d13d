"""A budget as its file: quantities, lines, what is carried on, repeats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..__version__ import __version__
from ..identify.budget import Budget, Component, Judged, Repeats, judged
from ..identify.budget.carried import CarriedOn
from ..identify.prime import prime_factors
from ..record.budget_file import BudgetFile, BudgetLine, BudgetQuantity, CarriedQuantity, RepeatedDerivative
from ..simulate.model import DERIVATIVE_UNITS
from .analysis import Identified

X_V = "x_v_m"
"""Name of the neutral point among the quantities."""
DENSITY = "density_kg_m3"
"""Name of the density's line."""
UNLIKELY = 0.05
"""Repeats that scatter more than chance does once in twenty are named."""


def budget_file(answer: Identified, budget: Budget, repeats: Repeats, carried: CarriedOn) -> BudgetFile:
    """Put a budget into its file.

    Parameters
    ----------
    answer : the fit
    budget : its lines
    repeats : of its runs
    carried : what is computed from it
    """
    result, size = answer.result, len(budget.names)
    one = {name: judged(budget, np.eye(size)[i], budget.value[i]) for i, name in enumerate(budget.names)}
    y_v, n_v = budget.value[2], budget.value[4]
    gradient = np.zeros(size)
    gradient[[2, 4]] = -n_v / y_v**2, 1 / y_v
    one[X_V] = judged(budget, gradient, n_v / y_v)
    gradients = dict(zip(one, [*np.eye(size), gradient], strict=True))
    rho = result.density_kg_m3 or 1.0
    factors = dict(zip(DERIVATIVE_UNITS, prime_factors(rho, result.length_pp_m, result.speed_m_s), strict=True))
    density = next(c for c in budget.components if c.name == DENSITY)
    water = (density.u or 0.0) / rho
    units = dict(zip(budget.names, budget.units, strict=True)) | {X_V: "m"}
    fit_only = replace(budget, components=tuple(c for c in budget.components if c.status == "fit"))
    return BudgetFile(
        schema="towline/budget",
        tool=__version__,
        inputs=result.inputs,
        runs=[d.name for d in answer.data],
        form=result.form,
        speed_m_s=result.speed_m_s,
        quantities={
            name: _quantity(q, judged(fit_only, gradients[name], q.value).u, units[name], factors.get(name), water)
            for name, q in one.items()
        },
        correlation=budget.correlation.tolist(),
        lines=[_line(c, k, one, gradients) for k, c in enumerate(budget.components)],
        closure=budget.closure,
        stable_probability=carried.stability.probability,
        carried={
            q.name: CarriedQuantity(
                value=q.value if np.isfinite(q.value) else None,
                unit=q.unit,
                combined_std=None if q.judged is None else q.judged.u,
                expanded=None if q.judged is None else q.judged.expanded,
                interval=(q.low, q.high) if np.isfinite(q.low) else None,
                share=q.share,
            )
            for q in carried.quantities
        },
        repeats={
            r.name: RepeatedDerivative(
                pooled_std=r.pooled,
                stated_std=r.stated,
                degrees=r.degrees,
                ratio=r.ratio,
                interval=(r.low, r.high),
                p_value=r.p_value,
            )
            for r in repeats.derivatives
        },
        repeated=[list(group) for group in repeats.groups],
        notes=_notes(budget, repeats),
    )


def _quantity(q: Judged, by_fit: float, unit: str, factor: float | None, water: float) -> BudgetQuantity:
    prime = None if factor is None else q.value / factor
    return BudgetQuantity(
        value=q.value,
        unit=unit,
        fit_std=by_fit,
        combined_std=q.u,
        degrees=_finite(q.degrees),
        coverage_factor=q.k,
        expanded=q.expanded,
        prime=prime,
        prime_std=None if factor is None or prime is None else float(np.hypot(q.u / abs(factor), prime * water)),
    )


def _line(c: Component, k: int, one: Mapping[str, Judged], gradients: Mapping[str, np.ndarray]) -> BudgetLine:
    names = list(one)
    return BudgetLine(
        source=c.source,
        name=c.name,
        run=c.run,
        evaluation=c.evaluation,
        std=c.u,
        unit=c.unit,
        degrees=_finite(c.degrees),
        origin=c.origin,
        status=c.status,
        sensitivity={} if c.sensitivity is None else {n: float(gradients[n] @ c.sensitivity) for n in names},
        contribution={n: float(one[n].parts[k]) for n in names} if c.included else {},
        share={n: float(one[n].shares[k]) for n in names} if c.included else {},
    )


def _finite(degrees: float) -> float | None:
    return float(degrees) if np.isfinite(degrees) else None


def _notes(budget: Budget, repeats: Repeats) -> list[str]:
    out = [c for c in budget.components if not c.included]
    notes = [
        f"the lines of the fit combine to its own standard deviations within {100 * budget.closure:.2g} %",
        "y_b and beta_b of each run are estimated beside the derivatives: without a prior they are no line, and what "
        "they cost is in the noise's",
    ]
    if out:
        seen = ", ".join(dict.fromkeys(f"{c.source} ({c.name})" for c in out))
        notes.append(f"not included: {seen}")
    if repeats.why:
        notes.append(f"repeats: {repeats.why}")
    off = [r.name for r in repeats.derivatives if r.p_value < UNLIKELY]
    if off:
        notes.append(f"repeats scatter more than their lines say: {', '.join(off)}; a source is missing or too small")
    return notes


__all__ = ["DENSITY", "budget_file"]
