"""Fits and steady states as result files: primes, truth, what is not determined, in words."""

from __future__ import annotations

import numpy as np

from ..record.results import Derivative, DerivativesFile, Measured, RunFit, SteadyFile
from ..record.schema import ModelTable, WaterTable
from ..simulate.model import DERIVATIVE_UNITS, Hull
from .data import RunData
from .fit import OWN, Fit
from .noise import autocorrelation, ljung_box_p
from .prime import prime_factors
from .steady import SteadyFit, SteadyState, steady_tow_result

UNDETERMINED_SHARE = 0.5
"""A derivative whose standard deviation exceeds this share of its value is not determined."""
CORRELATED = 0.95
SYMBOLS = dict(zip(DERIVATIVE_UNITS, ("m - Y_vdot", "I - N_rdot", "Y_v", "Y_r - mU", "N_v", "N_r"), strict=True))


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
    runs : as fitted
    model, water : of the hull, for the prime system
    truth : the six true values at the fit's speed, or None
    """
    sd = np.sqrt(np.diag(fit.covariance))
    factors = prime_factors(water.density_kg_m3, model.length_pp_m, fit.speed_m_s)
    derivatives = {
        name: Derivative(
            value=float(fit.six[i]),
            std=float(sd[i]),
            unit=unit,
            prime=float(fit.six[i] / factors[i]),
            prime_std=float(sd[i] / factors[i]),
            true_value=None if truth is None else truth[name],
        )
        for i, (name, unit) in enumerate(DERIVATIVE_UNITS.items())
    }
    correlation = fit.covariance / sd[:, None] / sd[None, :]
    hull = Hull(*(float(x) for x in fit.six), speed_m_s=fit.speed_m_s)
    return DerivativesFile(
        schema="towline/derivatives",
        tool=tool,
        inputs=inputs,
        method="output_error",
        form="full" if fit.form == "full" else "linear",
        speed_m_s=fit.speed_m_s,
        density_kg_m3=water.density_kg_m3,
        length_pp_m=model.length_pp_m,
        mass_kg=model.mass_kg,
        derivatives=derivatives,
        correlation=correlation.tolist(),
        straight_line_stable=hull.straight_line_stable,
        runs={data.name: _run_fit(fit, data, index) for index, data in enumerate(runs)},
        failed=failed,
        not_identifiable=_not_identifiable(fit, sd, correlation),
        notes=_notes(fit, runs),
    )


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
    )


def _not_identifiable(fit: Fit, sd: np.ndarray, correlation: np.ndarray) -> list[str]:
    names = list(DERIVATIVE_UNITS)
    lines = []
    for i, name in enumerate(names):
        share = sd[i] / abs(fit.six[i]) if fit.six[i] else np.inf
        if share > UNDETERMINED_SHARE:
            lines.append(
                f"{SYMBOLS[name]} is not determined by these runs (standard deviation {100 * share:.0f} % of its value); "
                "a run that holds the release, or one at a second tow point, would determine it"
            )
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > CORRELATED:
                ratio = correlation[i, j] * sd[i] / sd[j]
                lines.append(
                    f"{SYMBOLS[names[i]]} and {SYMBOLS[names[j]]} are seen mostly as one combination "
                    f"({SYMBOLS[names[i]]} {'-' if ratio > 0 else '+'} {abs(ratio):.3g} ({SYMBOLS[names[j]]}); "
                    f"correlation {correlation[i, j]:+.3f})"
                )
    lines.append(
        "the scale of T: an error of k % in the tension is an error of k % in every derivative and no motion shows it"
    )
    return lines


def _notes(fit: Fit, runs: list[RunData]) -> list[str]:
    notes = []
    if not fit.converged:
        notes.append(f"the fit stopped after {fit.steps} steps without settling; its numbers are not an optimum")
    if any(d.assumed_sigma for d in runs):
        notes.append("the motion states no sigma; the noise was measured from the residuals")
    if fit.orders.any():
        notes.append(
            "the noise is coloured (a codec, for one, repeats its errors): it is whitened by an autoregression of order "
            f"{fit.orders.min()} to {fit.orders.max()}"
        )
    rest = np.sqrt(np.diag(fit.covariance) / np.diag(fit.filtered_covariance))
    if rest.max() > 1.25:
        notes.append(
            f"autocorrelation left after whitening widens the standard deviations up to {rest.max():.1f} times"
        )
    for name, (value, sd) in fit.common.items():
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


def steady_file(
    fit: SteadyFit,
    tows: list[SteadyState],
    tool: str,
    inputs: dict[str, str],
    failed: dict[str, str],
    x_v_true_m: float | None,
) -> SteadyFile:
    """Put a steady analysis into its file."""
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
        y_delta_delta=fit.y_delta_delta,
        n_delta_delta=fit.n_delta_delta,
        x_v_true_m=x_v_true_m,
        tows={t.name: steady_tow_result(t) for t in tows},
        failed=failed,
        notes=list(fit.notes),
    )
