"""The fit as a linear estimator at its optimum: what the quantities do where an input is another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...record.errors import EstimationError
from ...record.priors import DERIVATIVE_NAMES
from ...simulate.model import DERIVATIVE_UNITS, Array
from ..data import RunData
from ..fit import Fit, modes_along
from ..informed import Informed, informed
from ..joint.problem import Answer, Problem
from ..noise import Whitener
from ..static_records import colours

RUDDER_UNITS = {"y_delta": "N/rad", "n_delta": "N m/rad"}
"""Quantities beside the six, of fits that hold a rudder's forces."""


@dataclass(frozen=True)
class Gains:
    """A fit, linear about its optimum.

    Attributes
    ----------
    names, units : of the q quantities: the six derivatives, then Y_delta and N_delta where the fit has them
    value : (q,)
    runs : as fitted, common modes along the fitted path
    problem, theta, answers, weights : of the fit
    informed : information there
    rows : (q, size), covariance of the quantities with every parameter, the noise having been what the whitening takes it for
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    runs: tuple[RunData, ...]
    problem: Problem
    theta: Array
    answers: tuple[Answer, ...]
    weights: tuple[Whitener, ...]
    informed: Informed
    rows: Array

    def of_score(self, columns: NDArray[np.int_]) -> Array:
        """(q, k): what a score of the parameters ``columns`` does to the quantities."""
        return self.rows[:, columns]

    def shift(self, data: Sequence[Array | None], gauges: Sequence[Array | None] = ()) -> Array:
        """How far the quantities move (q,) where the records are other by ``data``, (2, n) of each run.

        Parameters
        ----------
        data : change of y and beta of each run, m and rad; None: this run's stays
        gauges : change of the whitened residual of each load cell, or None
        """
        found = np.zeros(len(self.rows))
        for index, (answer, weight, white) in enumerate(
            zip(self.answers, self.weights, self.informed.white, strict=True)
        ):
            change = data[index]
            rows = self.of_score(answer.columns)
            if change is not None:
                e = weight.along(change)
                found += rows @ (white.slope[0] @ e[0] + white.slope[1] @ e[1])
            if gauges and gauges[index] is not None and answer.gauge is not None:
                found += rows @ (answer.gauge[1] @ gauges[index])
        return found


def gains_of(fit: Fit, runs: Sequence[RunData]) -> Gains:
    """The fit's optimum as a linear estimator.

    Parameters
    ----------
    fit : by output error
    runs : as fitted

    Raises
    ------
    EstimationError : the fit is of another kind
    """
    if fit.method != "output_error":
        raise EstimationError(
            "a force pushes the hull about in these runs (innovations form), whose gain changes from sample to sample: a budget is "
            "worked out for the output error only (--noise output; its intervals leave that force out)"
        )
    along = tuple(modes_along(d, path) for d, path in zip(runs, fit.response, strict=True))
    problem = Problem(list(along), fit.form, fit.speed_m_s, path=fit.path)
    answers = problem.evaluate(fit.theta)
    found = informed(problem, fit.theta, answers, fit.weights, colours(list(along)))
    names: list[str] = list(DERIVATIVE_NAMES)
    units, places, size = list(DERIVATIVE_UNITS.values()), list(range(6)), [1.0] * 6
    value = list(fit.six)
    if set(RUDDER_UNITS) <= set(fit.beside):
        for common in problem.commons:
            if common.name in RUDDER_UNITS:
                names.append(common.name)
                units.append(RUDDER_UNITS[common.name])
                places.append(problem.common_at[common.name])
                size.append(float(common.sd[0]))
                value.append(fit.beside[common.name][0])
    inverse, layout = found.inverse, problem.layout
    shared = np.searchsorted(layout.shared, places)
    own = -np.einsum("ros,sq->qro", inverse.towards, inverse.shared[:, shared])
    whole = np.array([layout.whole(inverse.shared[k], own[i]) for i, k in enumerate(shared)])
    return Gains(
        tuple(names),
        tuple(units),
        np.array(value),
        along,
        problem,
        fit.theta,
        tuple(answers),
        tuple(fit.weights),
        found,
        whole * np.array(size)[:, None],
    )


__all__ = ["RUDDER_UNITS", "Gains", "gains_of"]
