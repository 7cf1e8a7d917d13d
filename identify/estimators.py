"""Ways from tows to the six derivatives: the contract of an estimator, and the table of those that are there.

``towline identify --estimator NAME`` asks the table. The joint fit by prediction error (``fit_with_noise``) is not in it: it is
what ``identify`` does without the option, and gives more than the six. ``register_estimator`` takes in another
(docs/developer/estimator.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..record.errors import EstimationError, TowlineError
from ..record.registry import Registry
from .data import RunData
from .methods import (
    Record,
    SixEstimate,
    arx_of_records,
    fit_criterion,
    fit_decay,
    modal_derivatives,
    regression_on_rates,
    suggested_decimation,
)

Estimate = Callable[[Sequence[RunData], float], SixEstimate]
"""(the runs' motion as ``identify`` prepares it, the speed at which the six are quoted, m/s) -> the six and their covariance."""
ROOT_PER_S = 1.2
"""Size of the fastest root of a towed hull of 2.66 m at 1.28 m/s, that ARX's step is chosen for (theory.md 9.6)."""
RATES_WINDOW_S = 1.5
"""Of the differentiating filter: a choice (docs/methods/rates.md)."""


@dataclass(frozen=True)
class Estimator:
    """A way from towed motion to the six linear derivatives.

    Attributes
    ----------
    name : by which ``--estimator`` asks for it; also part of the file's name
    title : in words
    needs : the runs it needs, in words
    estimate : does it; raises EstimationError where the runs are not what it needs
    page : of docs/methods that describes it; "": none
    form : the equations it fits, as the file states them
    """

    name: str
    title: str
    needs: str
    estimate: Estimate
    page: str = ""
    form: Literal["linear", "full"] = "full"


ESTIMATORS: Registry[Estimator] = Registry("towline.estimators")


def register_estimator(
    name: str, title: str, needs: str, page: str = "", form: Literal["linear", "full"] = "full"
) -> Callable[[Estimate], Estimate]:
    """Take a function in as an estimator; one of its name is replaced.

    Parameters
    ----------
    name : by which ``--estimator`` asks for it
    title : in words
    needs : the runs it needs, in words
    page : of docs/methods that describes it; "": none
    form : the equations it fits, as the file states them

    Examples
    --------
    >>> from towline.identify.estimators import register_estimator
    >>> @register_estimator("guess", "MARINER's own numbers", "any run")
    ... def guess(runs, speed_m_s):
    ...     six = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
    ...     return SixEstimate(six, np.diag((0.2 * six) ** 2))
    """

    def register(estimate: Estimate) -> Estimate:
        ESTIMATORS.add(name, Estimator(name, title, needs, estimate, page, form))
        return estimate

    return register


def estimator_of(name: str) -> Estimator:
    """The estimator of a name, those of installed packages included.

    Raises
    ------
    TowlineError : there is none; says which there are
    """
    known = {one.name: one for one in ESTIMATORS.all()}
    if name not in known:
        raise TowlineError(f"--estimator {name!r}: expected {', '.join(known)}")
    return known[name]


def estimators_table() -> str:
    """The table of docs/methods/README.md, a line an estimator."""
    rows = ["| `--estimator` | what it does | the runs it needs | page |", "|---|---|---|---|"]
    for one in ESTIMATORS.here():
        page = f"[{one.page.removesuffix('.md')}]({one.page})" if one.page else ""
        rows.append(f"| `{one.name}` | {one.title} | {one.needs} | {page} |")
    return "\n".join(rows)


# those of the thesis ------------------------------------------------------------------------------------------------


@register_estimator(
    "decay",
    "decay fit of every tow (8.20), then all swings together (9.2)",
    "small decaying swings at two tow points or more",
    "decay.md",
    "linear",
)
def decay(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
    """Six derivatives from decaying tows; linear, so that swings of 0.1 m shift them by 1 %."""
    swings = []
    for data in runs:
        sigma = np.sqrt(np.median(np.einsum("nii->ni", data.covariance), axis=0))
        fit = fit_decay(data.t_s, data.y_m, data.beta_rad, sigma=(float(sigma[0]), float(sigma[1])))
        swings.append(fit.swing(data.tow))
    return modal_derivatives(swings, speed_m_s)


@register_estimator(
    "arx",
    "ARX-4 by instrumental variables, then the roots' coefficients (9.3)",
    "exactly two evenly sampled tows at two tow points, nearly free of noise",
    "arx-iv.md",
    "linear",
)
def arx(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
    """Six derivatives from two tows of one T, L and U by sampled-data habits."""
    if len(runs) != 2:
        raise EstimationError(f"{len(runs)} runs; ARX-4 goes from exactly two tows to the derivatives")
    first, second = (Record.of(data) for data in runs)
    _, found = arx_of_records((first, second), suggested_decimation(first.step_s, ROOT_PER_S))
    return _at_speed(found, first.tow.speed_m_s, speed_m_s)


@register_estimator(
    "rates",
    "regression of the line's force on smoothed rates (8.43)",
    "evenly sampled tows with little noise; biased by what noise there is",
    "rates.md",
)
def rates(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
    """Six derivatives by least squares on differentiated motion."""
    return regression_on_rates([Record.of(data) for data in runs], RATES_WINDOW_S, reference_speed_m_s=speed_m_s)


@register_estimator(
    "determinant",
    "output error by det(Q), the residuals' covariance left free (Appendix IV)",
    "as the joint fit; no settings are let move",
)
def determinant(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
    """Six derivatives by the thesis's second criterion."""
    return _by_criterion(runs, "determinant", speed_m_s)


@register_estimator(
    "trace",
    "output error by tr(S Q), S from the stated sigmas (Appendix IV)",
    "as the joint fit; no settings are let move",
)
def trace(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
    """Six derivatives by the thesis's first criterion."""
    return _by_criterion(runs, "trace", speed_m_s)


def _by_criterion(runs: Sequence[RunData], criterion: str, speed_m_s: float) -> SixEstimate:
    found = fit_criterion(list(runs), criterion, form="full", speed_m_s=speed_m_s)
    return SixEstimate(found.six, found.covariance)


def _at_speed(found: SixEstimate, from_m_s: float, to_m_s: float) -> SixEstimate:
    """The six at another speed: those that grow with it do, by one set of primes."""
    ratio = np.array([1, 1, *4 * [to_m_s / from_m_s]])
    return SixEstimate(found.six * ratio, found.covariance * np.outer(ratio, ratio), found.notes)


__all__ = ["ESTIMATORS", "Estimate", "Estimator", "estimator_of", "estimators_table", "register_estimator"]
