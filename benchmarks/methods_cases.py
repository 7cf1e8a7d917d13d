"""Every estimator on simulated campaigns with one noise: what each draw gives, beside the truth.

The hull is the ITTC MARINER (Table 8.2) at U 1.28 m/s, L 0.91 m, T 3.96 N, four tow points, 60 s at 64 Hz, white noise of 1 mm and
0.1 degree, released at 0.15 m at rest, linear motion. What differs is said with the case.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from identify_cases import HULL, LENGTH_M, SIGMA_BETA_RAD, SIGMA_Y_M, SIX, TENSION_N, times
from methods_data import (
    RUDDER_RAD,
    SPEED_M_S,
    THINNED,
    coloured_tows,
    difference_equation,
    even_tows,
    free_run,
    full_tows,
    gyro,
    pushed,
    steady_tows,
    still,
    swung,
    tows,
)

from towline.identify import RunData, fit_runs, fit_with_noise
from towline.identify.methods import (
    FreeRecord,
    Record,
    SixEstimate,
    Swing,
    appendix_one,
    arx_of_records,
    calibrate_rate,
    complex_amplitudes,
    derivatives_from_coefficients,
    fit_arx,
    fit_decay,
    fit_free_run,
    fit_frequency_response,
    fit_open_loop,
    fit_steady_hull,
    four_stage_iv,
    measure_response,
    modal_derivatives,
    phase_from_amplitudes,
    regression_on_rates,
    suggested_decimation,
)
from towline.identify.methods.criteria import fit_criterion
from towline.identify.start import weak_form_start
from towline.identify.steady import SteadyState, fit_steady
from towline.record import EstimationError
from towline.simulate import Hull, Tow, linear_system

NAMES = ("m'", "I'", "Y_v", "Y_R", "N_v", "N_r")
K2_M2 = float(SIX[1] / SIX[0])
ENDS = (0, 3)
SINES_RAD_S = (0.4, 0.9, 2.0)


@dataclass(frozen=True)
class Draw:
    """One draw: names, estimates, their stated standard deviations (NaN: none stated) and the truth, (k,) each."""

    names: tuple[str, ...]
    value: np.ndarray
    sd: np.ndarray
    truth: np.ndarray


@dataclass(frozen=True)
class Case:
    """An estimator.

    Attributes
    ----------
    name, data : what it is, what it gets
    call : data -> Draw; EstimationError counts as a refusal
    make : draws the data
    seeds : draws
    """

    name: str
    data: str
    make: Callable[[np.random.Generator], object]
    call: Callable[..., Draw]
    seeds: int = 50


def six(value: np.ndarray, covariance: np.ndarray | None) -> Draw:
    sd = np.full(6, np.nan) if covariance is None else np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Draw(NAMES, np.asarray(value), sd, SIX)


def estimate(found: SixEstimate) -> Draw:
    return six(found.six, found.covariance)


def own_colour(runs: list[RunData]) -> Draw:
    fit = fit_runs([replace(r, still=None) for r in runs], "linear")
    return six(fit.six, fit.covariance)


def as_white(runs: list[RunData]) -> Draw:
    fit = fit_runs(runs, "linear")
    return six(fit.six, fit.naive_covariance)


def joint(runs: list[RunData]) -> Draw:
    fit = fit_runs(runs, "linear")
    return six(fit.six, fit.covariance)


def full(runs: list[RunData]) -> Draw:
    fit = fit_runs(runs, "full")
    return six(fit.six, fit.covariance)


def innovations(runs: list[RunData]) -> Draw:
    fit = fit_with_noise(runs, "linear", noise="innovations")
    return six(fit.six, fit.covariance)


def determinant(runs: list[RunData]) -> Draw:
    found = fit_criterion(runs, "determinant")
    return six(found.six, found.covariance)


def alone(runs: list[RunData]) -> Draw:
    fit = fit_runs(runs[2:3], "linear")
    return six(fit.six, fit.covariance)


def weak(runs: list[RunData]) -> Draw:
    return six(weak_form_start(runs, SPEED_M_S), None)


def decays(runs: list[RunData]):
    return [fit_decay(r.t_s, r.y_m, r.beta_rad) for r in runs]


def decay_pair(runs: list[RunData]) -> Draw:
    """Damping and frequency of the pair at the first tow point."""
    run = runs[0]
    found = fit_decay(run.t_s, run.y_m, run.beta_rad)
    roots = np.linalg.eigvals(linear_system(HULL, run.tow)[0])
    pair = roots[np.argmax(roots.imag)]
    real = np.sort(-roots[np.abs(roots.imag) < 1e-9].real)
    parts = (found.omega_rad_s, found.l3_per_s, found.l2_per_s, found.l1_per_s)
    return Draw(
        ("w", "l3", "l2", "l1"),
        np.array([p.value for p in parts]),
        np.array([p.std for p in parts]),
        np.array([pair.imag, -pair.real, *real]),
    )


def modal(runs: list[RunData]) -> Draw:
    return estimate(modal_derivatives([f.swing(r.tow) for f, r in zip(decays(runs), runs, strict=True)]))


def phase(index: int) -> Callable[[list[RunData]], Draw]:
    def call(runs: list[RunData]) -> Draw:
        run = runs[index]
        found = fit_decay(run.t_s, run.y_m, run.beta_rad)
        sd = found.omega_rad_s.std
        return estimate(phase_from_amplitudes(found.amplitudes(), run.tow, K2_M2, omega_sd_rad_s=sd))

    return call


def four_roots(runs: list[RunData]) -> Draw:
    some = [runs[i] for i in ENDS]
    parts = [f.coefficients() for f in decays(some)]
    covariance = np.zeros((8, 8))
    covariance[:4, :4], covariance[4:, 4:] = parts[0][1], parts[1][1]
    found = derivatives_from_coefficients(parts[0][0], parts[1][0], (some[0].tow, some[1].tow), covariance)
    return estimate(found)


def appendix(runs: list[RunData]) -> Draw:
    found = decays(runs)
    pairs = [f.l3_per_s for f in found], [f.omega_rad_s for f in found]
    sd = np.array([m.std for part in pairs for m in part])
    values = ([m.value for m in part] for part in pairs)
    return estimate(appendix_one(*values, [r.tow for r in runs], float(SIX[1]), sd).derivatives)


def regression(runs: list[RunData]) -> Draw:
    return estimate(regression_on_rates([Record.of(r) for r in runs], 1.5, full_sine=False))


def arx_six(runs: list[RunData]) -> Draw:
    first, second = (Record.of(runs[i]) for i in ENDS)
    return estimate(arx_of_records((first, second), suggested_decimation(first.step_s, 1.1), "iv")[1])


def arx_pair(method: str) -> Callable[[list[RunData]], Draw]:
    def call(runs: list[RunData]) -> Draw:
        run = runs[0]
        found = fit_arx(
            np.column_stack([run.y_m, run.beta_rad]),
            1 / 64,
            decimation=suggested_decimation(1 / 64, 1.1),
            method="iv" if method == "iv" else "ls",
            scale=np.array([SIGMA_Y_M, SIGMA_BETA_RAD]),
        )
        at = int(np.argmax(found.poles.imag))
        roots = np.linalg.eigvals(linear_system(HULL, run.tow)[0])
        pair = roots[np.argmax(roots.imag)]
        return Draw(
            ("w", "l3"),
            np.array([found.poles[at].imag, -found.poles[at].real]),
            found.pole_sd[at][::-1],
            np.array([pair.imag, -pair.real]),
        )

    return call


def stages(which: str) -> Callable[[tuple[np.ndarray, np.ndarray]], Draw]:
    def call(data: tuple[np.ndarray, np.ndarray]) -> Draw:
        found = getattr(four_stage_iv(*data, na=2, nb=2), which)
        value = np.concatenate([found.a[1:], found.b])
        return Draw(("a1", "a2", "b1", "b2"), value, found.sd, np.array([-1.5, 0.7, 1.0, 0.5]))

    return call


def open_loop(runs: list[RunData]) -> Draw:
    records, forces = [], []
    for index in ENDS:
        run, clean = runs[index], still()[index]
        angle = clean.y_m / LENGTH_M + (1 + run.tow.tow_point_m / LENGTH_M) * clean.beta_rad
        take = slice(None, None, 2 * THINNED)
        records.append(Record(run.t_s[take], run.y_m[take], run.beta_rad[take], run.tow))
        forces.append(TENSION_N * angle[take])
    return estimate(fit_open_loop(records, forces))


def forced(data: list[tuple[Tow, np.ndarray]]) -> Draw:
    rate = 2j * np.pi * 0.1
    swings = []
    for tow, columns in data:
        found = complex_amplitudes(times(), columns[:, 1], columns[:, 2], rate)
        swings.append(Swing(tow, rate, found.y_m, found.beta_rad, 0.1, found.covariance))
    return estimate(modal_derivatives(swings))


def transfer(data: list[tuple[Tow, np.ndarray]]) -> Draw:
    t = times()
    measured = [measure_response(t, c[:, 1], c[:, 2], tow, c[:, 0], np.array(SINES_RAD_S)) for tow, c in data]
    return estimate(fit_frequency_response(measured))


def neutral_point(states: list[SteadyState]) -> Draw:
    found = fit_steady(states).x_v_m
    return Draw(("X_v",), np.array([found.value]), np.array([found.std]), np.array([SIX[4] / SIX[2]]))


def steady_hull(states: list[SteadyState]) -> Draw:
    found = fit_steady_hull(states, rudder_rad=RUDDER_RAD)
    assert found.y_delta is not None
    assert found.n_delta is not None
    parts = (found.y_v, found.n_v, found.y_delta, found.n_delta, found.x_v_m, found.x_delta_m)
    return Draw(
        ("Y_v", "N_v", "Y_d", "N_d", "X_v", "X_d"),
        np.array([p.value for p in parts]),
        np.array([p.std for p in parts]),
        np.array([SIX[2], SIX[4], -2.0, 2.4, SIX[4] / SIX[2], -1.2]),
    )


def rudder(data: tuple[FreeRecord, Hull]) -> Draw:
    run, told = data
    found = fit_free_run([run], told, np.diag((0.01 * told.six) ** 2), bias=False)
    parts = (found.y_delta, found.n_delta, found.x_delta_m)
    return Draw(
        ("Y_d", "N_d", "X_d"),
        np.array([p.value for p in parts]),
        np.array([p.std for p in parts]),
        np.array([-18.0, 25.5, -25.5 / 18]),
    )


def calibration(data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Draw:
    found = calibrate_rate(*data, position_sd=float(SIGMA_BETA_RAD), rate_sd=0.002)
    parts = (found.scale_error, found.rate_bias)
    return Draw(
        ("scale", "bias"),
        np.array([p.value for p in parts]),
        np.array([p.std for p in parts]),
        np.array([0.03, 0.002]),
    )


CASES = (
    Case("joint fit, linear form", "4 tows", tows, joint),
    Case("joint fit, full form", "4 tows of the full equations", full_tows, full, 20),
    Case("joint fit, linear form", "the same tows of the full equations", full_tows, joint, 20),
    Case("joint fit, det(Q) (AIV)", "4 tows", tows, determinant),
    Case("Kalman PEM", "4 tows pushed by 0.02 N, 0.02 N m, 0.5 s", pushed, innovations, 20),
    Case("joint fit, output error", "the same pushed tows", pushed, joint, 20),
    Case("joint fit, static records", "4 tows at 16 Hz, noise of the camera that lasts 2 s", coloured_tows, joint),
    Case("joint fit, colour of its residuals", "the same, static records left out", coloured_tows, own_colour),
    Case("joint fit, residuals taken as white", "the same", coloured_tows, as_white),
    Case("SS model, one tow (8.25, 8.26)", "tow point 1.649 m", tows, alone),
    Case("weak form alone", "4 tows", tows, weak),
    Case("decay fit (8.20)", "tow point 1.446 m: the roots", tows, decay_pair, 30),
    Case("pairs of decay fits (9.2)", "4 tows", tows, modal, 20),
    Case("phase analysis (8.2)", "tow point 1.751 m, K^2 known", tows, phase(3), 20),
    Case("phase analysis (8.2)", "tow point 1.446 m, K^2 known", tows, phase(0), 20),
    Case("characteristic equation (9.3)", "four roots at 1.446 and 1.751 m", tows, four_roots, 20),
    Case("appendix I", "pairs at 1.446, 1.5985, 1.751 m, I' known", even_tows, appendix, 20),
    Case("regression on rates (8.43)", "4 tows, 1.5 s window", tows, regression),
    Case("ARX-4, LS", "tow point 1.446 m: the pair, 2 s steps", tows, arx_pair("ls"), 20),
    Case("ARX-4, IV", "tow point 1.446 m: the pair, 2 s steps", tows, arx_pair("iv"), 20),
    Case("ARX-4, IV, then (9.3)", "tow points 1.446 and 1.751 m", tows, arx_six, 20),
    Case("LS (6.17)", "ARX-2 with input, 2000 samples, coloured noise", difference_equation, stages("ls")),
    Case("four-stage IV (6.20)", "the same", difference_equation, stages("iv4")),
    Case("open loop (8.27)", "2 tows at 4 Hz, line force known exactly", tows, open_loop, 20),
    Case("forced oscillation (5.26)", "post 0.10 m at 0.1 Hz, 4 tow points", swung((2 * np.pi * 0.1,), 0.1), forced),
    Case("transfer functions (8.31)", "post 0.06 m at 0.4, 0.9, 2 rad/s", swung(SINES_RAD_S, 0.06), transfer, 30),
    Case("X_v of steady tows (5.4)", "4 tows, rudder -15 degrees", steady_tows, neutral_point),
    Case("steady tows (5.6-5.8)", "the same, T known", steady_tows, steady_hull),
    Case("free run (5.14)", "zigzag of 60 s at 8 Hz, six known to 1 %", free_run, rudder, 20),
    Case("calibration states (8.32)", "gyro 0.002 rad/s beside beta, 8 Hz", gyro, calibration, 30),
)
"""In the order of docs/how-to-choose.md."""

__all__ = ["CASES", "Case", "Draw", "EstimationError"]
