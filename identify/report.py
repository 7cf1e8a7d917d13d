"""Fits and steady states as result files: primes, truth, what is not determined, in words."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ..record.errors import EstimationError
from ..record.results import (
    Derivative,
    DerivativesFile,
    Measured,
    RunFit,
    SteadyFile,
    SteadySource,
    SteadySources,
    TensionResult,
    TowStability,
)
from ..record.run import Run
from ..record.schema import ModelTable, WaterTable
from ..simulate.model import DERIVATIVE_UNITS, Hull
from .added_mass import added_masses
from .bracket import bracket_words, neutral_bracket
from .budget.steady_lines import SteadyBudget, steady_budget
from .data import RunData
from .estimators import Estimator
from .fit import OWN, Fit, fit_runs
from .limits.cure import cure
from .limits.identifiability import Identifiability, examine
from .limits.words import correlation_lines, refusal_lines, transient_line
from .methods import SixEstimate
from .noise import autocorrelation, ljung_box_p
from .prime import prime_factors
from .settled import Stability
from .steady import SteadyFit, SteadyState, stands_off, steady_tow_result
from .surge import along_lines, surge_moves
from .tension import TensionFromMotion, refuse_impossible, tension_from_motion

SURE = 0.975
"""Probability from which a verdict stands without a remark: the 95 % interval does not hold zero."""
OPTIMISTIC = 1.25
"""The naive standard deviations are named where one of them is smaller by more than this factor: a choice."""
REMARKABLE = 2.0
"""An error that every fit carries unasked is told from so many of its standard deviations."""
TRANSIENT_SD_SHARE = 0.05
"""From this relative standard deviation on the transient's size is said: it is what tells the derivatives apart."""


def derivatives_file(
    fit: Fit,
    runs: list[RunData],
    model: ModelTable,
    water: WaterTable,
    tool: str,
    inputs: dict[str, str],
    failed: dict[str, str],
    truth: dict[str, float] | None,
) -> DerivativesFile:
    """Put a fit into its file.

    Parameters
    ----------
    fit : of ``fit_runs`` or ``fit_with_noise``
    runs : as fitted
    model, water : of the hull, for the prime system
    tool : version of towline, as the file states it
    inputs : name of an input -> its SHA-256, as the file states them
    failed : name of a run -> why it is left out
    truth : the six true values at the fit's speed, or None
    """
    weighed = tension_from_motion(fit, runs)
    refuse_impossible(fit, runs, weighed)
    moved = surge_moves(fit, runs)
    found = examined(fit, runs)
    fit, covariance, single = found.fit, found.covariance, found.parts.single
    sd = np.sqrt(np.diag(covariance))
    factors = prime_factors(water.density_kg_m3, model.length_pp_m, fit.speed_m_s)
    names = list(DERIVATIVE_UNITS)
    derivatives = {names[i]: _derivative(names[i], fit.six[i], sd[i], factors[i], truth) for i in single}
    y_vdot, n_rdot = added_masses(model, derivatives)
    correlation = (covariance / sd[:, None] / sd[None, :])[np.ix_(single, single)]
    hull = Hull(*(float(x) for x in fit.six), speed_m_s=fit.speed_m_s)
    return DerivativesFile(
        schema="towline/derivatives",
        tool=tool,
        inputs=inputs,
        method=fit.method,
        form="full" if fit.form == "full" else "linear",
        speed_m_s=fit.speed_m_s,
        density_kg_m3=water.density_kg_m3,
        length_pp_m=model.length_pp_m,
        mass_kg=model.mass_kg,
        derivatives=derivatives,
        y_vdot_kg=y_vdot,
        n_rdot_kg_m2=n_rdot,
        correlation=correlation.tolist(),
        straight_line_stable=hull.straight_line_stable,
        runs={data.name: _run_fit(fit, data, index) for index, data in enumerate(runs)},
        line=runs[0].tow.line,
        hull={name: Measured(value=value, std=sd) for name, (value, sd) in fit.beside.items()},
        tension=None if weighed is None else _tension_result(weighed),
        surge_moves=moved,
        failed=failed,
        not_identifiable=_not_identifiable(found, runs, weighed),
        notes=_notes(fit, runs) + along_lines(fit, runs, weighed, moved) + _stability(fit, covariance),
    )


def six_file(
    estimator: Estimator,
    found: SixEstimate,
    speed_m_s: float,
    model: ModelTable,
    water: WaterTable,
    tool: str,
    inputs: dict[str, str],
    failed: dict[str, str],
    truth: dict[str, float] | None,
) -> DerivativesFile:
    """Put what another estimator gives into the file of the joint fit.

    Parameters
    ----------
    estimator : by which the six were found
    found : the six and their covariance
    speed_m_s : at which they are quoted
    model, water : of the hull, for the prime system
    tool : version of towline, as the file states it
    inputs : name of an input -> its SHA-256, as the file states them
    failed : name of a run -> why it is left out
    truth : the six true values at that speed, or None

    Raises
    ------
    EstimationError : what was found is not finite
    """
    if not (np.isfinite(found.six).all() and np.isfinite(found.sd).all()):
        raise EstimationError(
            f"--estimator {estimator.name}: no finite answer from these runs; it needs {estimator.needs}"
        )
    factors = prime_factors(water.density_kg_m3, model.length_pp_m, speed_m_s)
    scale = np.where(found.sd > 0, found.sd, 1.0)
    derivatives = {
        name: _derivative(name, six, sd, factor, truth)
        for name, six, sd, factor in zip(DERIVATIVE_UNITS, found.six, found.sd, factors, strict=True)
    }
    hull = Hull(*(float(x) for x in found.six), speed_m_s=speed_m_s)
    return DerivativesFile(
        schema="towline/derivatives",
        tool=tool,
        inputs=inputs,
        method=estimator.name,
        form=estimator.form,
        speed_m_s=speed_m_s,
        density_kg_m3=water.density_kg_m3,
        length_pp_m=model.length_pp_m,
        mass_kg=model.mass_kg,
        derivatives=derivatives,
        correlation=(found.covariance / scale[:, None] / scale[None, :]).tolist(),
        straight_line_stable=hull.straight_line_stable,
        runs={},
        failed=failed,
        not_identifiable=[],
        notes=[f"by {estimator.title}; the joint fit (without --estimator) is the one to believe", *found.notes],
    )


def _derivative(name: str, value: float, sd: float, factor: float, truth: dict[str, float] | None) -> Derivative:
    """One of the six, in its unit and as a prime (``factor`` apart)."""
    return Derivative(
        value=float(value),
        std=float(sd),
        unit=DERIVATIVE_UNITS[name],
        prime=float(value / factor),
        prime_std=float(sd / factor),
        true_value=None if truth is None else truth[name],
    )


def _tension_result(found: TensionFromMotion) -> TensionResult:
    return TensionResult(
        factor=found.factor,
        log_std=found.log_sd,
        interval=found.interval,
        stated_std_rel=found.stated_sd,
        z=found.z,
        resistance_n=found.resistance_n,
        gauges={name: gauge.result for name, gauge in found.gauges.items()},
    )


def examined(fit: Fit, runs: list[RunData]) -> Identifiability:
    """Which derivatives the runs fix; a weak fit is done again with an anchor (``limits.identifiability``).

    Parameters
    ----------
    fit : of ``runs``
    runs : the runs, in their order
    """

    def refit(start: np.ndarray, extra: tuple[tuple[int, float, float], ...]) -> Fit:
        return fit_runs(runs, fit.form, fit.speed_m_s, start=start, extra=extra)

    return examine(fit, runs, refit if fit.method == "output_error" else None)


def _run_fit(fit: Fit, data: RunData, index: int) -> RunFit:
    own: dict[str, tuple[float, float]] = dict(
        zip(OWN, zip(fit.own[index], fit.own_sd[index], strict=True), strict=True)
    )

    def measured(name: str) -> Measured:
        value, sd = own[name]
        return Measured(value=float(value), std=float(sd))

    side = "y_m" if fit.form == "linear" else "alpha_rad"
    residual = fit.residual[index]
    white = fit.innovation[index]
    orders = fit.orders[index]
    nuisance = {}
    if data.priors.tension_sd_rel:
        nuisance["tension_n"] = measured("tension")
    if data.priors.tow_point_sd_m:
        nuisance["tow_point_m"] = measured("tow_point")
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return RunFit(
        start={
            side: measured("side"),
            "beta_rad": measured("beta"),
            "v_m_s": measured("v"),
            "r_rad_s": measured("r"),
        },
        bias={"y_b_m": measured("y_b"), "beta_b_rad": measured("beta_b")},
        nuisance=nuisance,
        noise={
            "y_m": float(rms[0]),
            "beta_rad": float(rms[1]),
            "y_over_sigma": float(fit.scale[index, 0]),
            "beta_over_sigma": float(fit.scale[index, 1]),
            **_disturbance(fit),
        },
        tests={
            "autocorrelation_y_lag1": float(autocorrelation(residual[:, 0], 1)[1]),
            "autocorrelation_beta_lag1": float(autocorrelation(residual[:, 1], 1)[1]),
            "noise_order_y": float(orders[0]),
            "noise_order_beta": float(orders[1]),
            "ljung_box_p_y": ljung_box_p(white[:, 0], int(orders[0])),
            "ljung_box_p_beta": ljung_box_p(white[:, 1], int(orders[1])),
        },
        samples=len(data.t_s),
        trim_rad=data.trim_rad,
    )


def _disturbance(fit: Fit) -> dict[str, float]:
    if fit.disturbance is None:
        return {}
    d = fit.disturbance
    return {"disturbance_force_n": d.force_n, "disturbance_moment_n_m": d.moment_n_m, "disturbance_time_s": d.time_s}


def _not_identifiable(found: Identifiability, runs: list[RunData], weighed: TensionFromMotion | None) -> list[str]:
    cures = cure(found.fit, found.fit.six, found.covariance, runs) if found.parts.refused else []
    lines = refusal_lines(found, cures, runs) + correlation_lines(found.covariance, found.parts.single)
    share = np.sqrt(np.diag(found.covariance)) / np.abs(found.fit.six)
    if share.max() > TRANSIENT_SD_SHARE and (transient := transient_line(found.fit, runs)):
        lines.append(transient)
    if weighed is None or not weighed.weighed:
        lines.append(
            "the scale of T: an error of k % in the tension is an error of k % in every derivative and no motion shows it"
            if weighed is None
            else "the scale of T: an error of k % in the tension is an error of k % in every derivative, and swings this small "
            f"tell it from the model's mass to {100 * weighed.log_sd:.0f} % only"
        )
    return lines


def _stability(fit: Fit, covariance: np.ndarray) -> list[str]:
    """The straight-line verdict's probability where it is not sure: Y_v N_r - N_v Y_R against its own error."""
    _, _, y_v, y_r, n_v, n_r = fit.six
    slope = np.array([0, 0, n_r, -n_v, -y_r, y_v])
    value, sd = y_v * n_r - n_v * y_r, float(np.sqrt(slope @ covariance @ slope))
    sure = float(ndtr(abs(value) / sd)) if sd > 0 else 1.0
    if sure > SURE:
        return []
    verdict = "stable" if value > 0 else "unstable"
    return [f"straight-line {verdict} with a probability of {100 * sure:.0f} % only"]


def _notes(fit: Fit, runs: list[RunData]) -> list[str]:
    notes = []
    if not fit.converged:
        notes.append(f"the fit stopped after {fit.steps} steps without settling; its numbers are not an optimum")
    if any(d.assumed_sigma for d in runs):
        notes.append("the motion states no sigma; the noise was measured from the residuals")
    for d in runs:
        why = d.still.useless(float(np.median(np.diff(d.t_s)))) if d.still is not None else ""
        if why:
            notes.append(f"the static record of {d.name!r} is not used: {why}")
    if fit.orders.any():
        notes.append(
            "what colour each channel's noise shows (a codec, for one, repeats its errors) is whitened by an autoregression, of "
            f"order {fit.orders.min()} to {fit.orders.max()}"
        )
    notes += fit.notes
    if fit.naive_covariance is not None:
        naive = np.sqrt(np.diag(fit.covariance) / np.maximum(np.diag(fit.naive_covariance), 1e-300))
        if naive.max() > OPTIMISTIC:
            notes.append(
                "naive covariance (residuals of the output error taken as white): its standard deviations would be "
                f"{naive.min():.1f} to {naive.max():.1f} times smaller, and wrong"
            )
    rest = np.sqrt(np.diag(fit.covariance) / np.diag(fit.filtered_covariance))
    if rest.max() > 1.25:
        notes.append(
            f"autocorrelation left after whitening widens the standard deviations up to {rest.max():.1f} times"
        )
    for name, (value, sd) in fit.common.items():
        if name == "line_length" and runs[0].priors.line_is_usual and abs(value) < REMARKABLE:
            continue
        what = name.replace("_", " ")
        notes.append(
            f"an error of the {what} common to all runs is carried: {value:+.2f} +- {sd:.2f} of its prior's sd"
        )
    for key, sizes in fit.modes.items():
        if np.abs(sizes).max() > 3:
            notes.append(
                f"the fit moves a common camera error by {np.abs(sizes).max():.1f} of its standard deviations "
                f"(camera {key[:8]}): check the datum, the heights and the lens"
            )
    if fit.form == "full" and len(runs) == 1:
        notes.append("one run only: nothing checks the derivatives; runs at other tow points would")
    return notes


def _sources(budget: SteadyBudget) -> SteadySources:
    def finite(degrees: float) -> float | None:
        return degrees if np.isfinite(degrees) else None

    return SteadySources(
        combined_m=budget.combined_m,
        degrees=finite(budget.degrees),
        coverage_factor=budget.factor,
        expanded_m=budget.expanded_m,
        closure=budget.closure,
        lines=[
            SteadySource(
                source=line.source,
                name=line.name,
                run=line.run,
                evaluation="A" if line.evaluation == "A" else "B",
                contribution_m=line.contribution_m,
                share=line.contribution_m**2 / max(budget.combined_m**2, 1e-300),
                degrees=finite(line.degrees),
                origin=line.origin,
            )
            for line in budget.lines
        ],
        outside=budget.outside,
    )


def steady_file(
    fit: SteadyFit,
    tows: list[SteadyState],
    tool: str,
    inputs: dict[str, str],
    failed: dict[str, str],
    x_v_true_m: float | None,
    stability: dict[str, TowStability] | None = None,
) -> SteadyFile:
    """Put a steady analysis into its file.

    Parameters
    ----------
    fit : of ``fit_steady``
    tows : as fitted
    tool : version of towline, as the file states it
    inputs : name of an input -> its SHA-256, as the file states them
    failed : name of a run -> why it is left out
    x_v_true_m : true X_v, m, or None
    stability : of every tow that was judged, settled or not; None: not judged
    """
    seen = stability or {}
    bracket = neutral_bracket(seen, fit.interval_m, [tow.name for tow in tows if stands_off(tow)])
    said = bracket_words(bracket) if bracket is not None else ""
    return SteadyFile(
        schema="towline/steady",
        tool=tool,
        inputs=inputs,
        force_unit="N" if tows[0].tension_n is not None else "F/R",
        x_v_m=fit.x_v_m,
        x_v_interval_m=fit.interval_m,
        slope=fit.slope,
        chi2_per_dof=fit.chi2_per_dof,
        pairs=fit.pairs,
        y_v=fit.y_v,
        n_v=fit.n_v,
        y_delta_delta=fit.y_delta_delta,
        n_delta_delta=fit.n_delta_delta,
        x_v_true_m=x_v_true_m,
        tows={t.name: steady_tow_result(t) for t in tows},
        stability=seen,
        x_v_bracket=bracket,
        x_v_budget=_sources(steady_budget(tows, fit)),
        failed=failed,
        notes=[*fit.notes, *([said] if said else [])],
    )


def tow_stability(run: Run, stability: Stability) -> TowStability:
    """The verdict on a run as it stands in steady.json.

    Parameters
    ----------
    run : the run folder as read
    stability : the verdict
    """
    rate, sd = stability.lambda_per_s, stability.lambda_sd_per_s
    return TowStability(
        verdict=stability.verdict,
        lambda_per_s=None if rate is None or sd is None else Measured(value=rate, std=sd),
        period_s=stability.period_s,
        tow_point_m=run.need(run.tow.tow_point_m, "tow.tow_point_m"),
    )
