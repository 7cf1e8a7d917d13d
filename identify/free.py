"""Free runs as a command takes them: a run folder's motion with its rudder, and what comes of it as derivatives.json.

A free run has no line, so that no force in it is known in newtons: it shows forces over masses. What gives the scale decides
what is said: tows of the same hull (``known``), or m' and I' under [priors.derivatives], or nothing (ratios).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from scipy.special import ndtr

from ..record.errors import EstimationError, InputError
from ..record.priors import Priors
from ..record.results import Derivative, DerivativesFile, FreeResult, Measured, RunFit
from ..record.run import RUN_FILE, Run
from ..simulate.model import DERIVATIVE_UNITS, Array, Hull
from .data import check_times, common_key, history_of, lag_key, measured_rows, stated_covariance
from .methods.common import propagate
from .methods.free_run import FreeRecord, FreeRunFit, fit_free_ratios, fit_free_run
from .noise import autocorrelation, ljung_box_p, measured, stated
from .prime import prime_factors

Scale = Literal["tows", "masses", "ratios"]
SHORTEST_LENGTHS = 3.0
"""A ship answers its rudder within one to two lengths of way (Nomoto's T' is 0.5 to 2.5): a shorter run has not begun to turn."""
OPEN_SHARE = 0.5
"""From this relative standard deviation on the 95 % interval holds zero: no number is given."""
SURE = 0.975
"""Probability from which a verdict stands without a remark: the 95 % interval does not hold zero."""
RATIO_UNITS = {
    "y_v_over_mass": "1/s",
    "y_r_minus_mu_over_mass": "m/s",
    "n_v_over_inertia": "1/(m s)",
    "n_r_over_inertia": "1/s",
    "y_delta_over_mass": "m/(s2 rad)",
    "n_delta_over_inertia": "1/(s2 rad)",
}
RUDDER_UNITS = {"y_delta": "N/rad", "n_delta": "N m/rad"}
_LENGTH_POWER, _SPEED_POWER = np.array([-1, 0, -2, -1, -1, -2]), np.array([1, 1, 1, 1, 2, 2])
"""Of the ratios in the order of RATIO_UNITS: their primes are made with L to the first and U to the second."""
WORDS = {
    "y_v_over_mass": "Y_v/m'",
    "y_r_minus_mu_over_mass": "(Y_r - mU)/m'",
    "n_v_over_inertia": "N_v/I'",
    "n_r_over_inertia": "N_r/I'",
    "y_delta_over_mass": "Y_delta/m'",
    "n_delta_over_inertia": "N_delta/I'",
}


@dataclass(frozen=True)
class FreeData:
    """A free run for the fit.

    Attributes
    ----------
    name : of the run
    record : times, y, beta, rudder on the recording's clock, speed, camera modes
    priors : of the run
    assumed_sigma : the motion came without sigma
    trim_rad : of the model, or None
    """

    name: str
    record: FreeRecord
    priors: Priors
    assumed_sigma: bool
    trim_rad: float | None = None


@dataclass(frozen=True)
class FreeFit:
    """What ``fit_free`` found.

    Attributes
    ----------
    scale : what the scale of forces came from
    found : the fit; of "masses" and "ratios" with m' = I' = 1
    names, values, covariance : what is said, in the order of derivatives.json, SI at ``found.speed_m_s``
    fitted : per run t_s, y_cg_m, beta_rad of the fit
    """

    scale: Scale
    found: FreeRunFit
    names: tuple[str, ...]
    values: Array
    covariance: Array
    fitted: list[pd.DataFrame]


def free_data(
    run: Run,
    motion: pd.DataFrame,
    common: Array | None = None,
    priors: Priors | None = None,
    lag: Array | None = None,
) -> FreeData:
    """Prepare a run of kind "free".

    Parameters
    ----------
    run : the run folder as read
    motion : as ``record.read_motion`` gives or ``geometry.motion_from_tracks`` makes
    common, lag : (k, n, 3), (l, n, 3) of ``geometry.Motion``, rows as ``motion``; None = none known
    priors : instead of the run's own

    Raises
    ------
    InputError : another kind, no [tow] or [model], no rudder, no speed, a history that does not cover the record, fewer than
        20 measured samples, or a way of less than ``SHORTEST_LENGTHS`` ship lengths
    """
    where = run.folder / RUN_FILE
    if run.file.kind != "free":
        raise InputError(where, "kind", f'"{run.file.kind}": a free run is expected (no line, under its rudder)')
    table = run.tow
    if table.rudder is None and table.rudder_rad == 0.0:
        raise InputError(
            where,
            "tow.rudder",
            "missing key; nothing but its rudder moves a free model: name the rudder's history (t_s, rudder_rad), or give "
            "rudder_rad where it stands over",
        )
    good = measured_rows(run, motion)
    rows = motion[good]
    times = rows["t_s"].to_numpy()
    check_times(run, times)
    speed = None
    if table.speed is not None:
        speed = history_of(run, table.speed, "speed_m_s", table.speed_delay_s, times)
    mean = table.speed_m_s if speed is None else float(np.interp(times, *speed).mean())
    if mean <= 0:
        raise InputError(where, "tow.speed_m_s", f"{mean:g} m/s; a free run needs a speed above 0")
    way = mean * (times[-1] - times[0]) / run.model.length_pp_m
    if way < SHORTEST_LENGTHS:
        raise InputError(
            run.source_path,
            "t_s",
            f"too short: {times[-1] - times[0]:.3g} s at {mean:g} m/s are {way:.2g} ship lengths; at least "
            f"{SHORTEST_LENGTHS:g} are needed to see the ship answer its rudder",
        )
    rudder = times[[0, -1]], np.full(2, table.rudder_rad)
    if table.rudder is not None:
        rudder = history_of(run, table.rudder, "rudder_rad", table.rudder_delay_s, times)
    covariance, assumed = stated_covariance(rows)
    keyed = ((common_key(run), common), (lag_key(run), lag))
    shared = tuple((key, modes[:, good, :2]) for key, modes in keyed if modes is not None and len(modes))
    priors = run.file.priors if priors is None else priors
    record = FreeRecord(
        times,
        rows["y_cg_m"].to_numpy(),
        rows["beta_rad"].to_numpy(),
        *rudder,
        mean,
        speed,
        covariance,
        shared,
        priors.beta_bias_sd_rad or 0.0,
    )
    return FreeData(run.name, record, priors, assumed, run.model.trim_rad)


def fit_free(
    runs: Sequence[FreeData], speed_m_s: float | None = None, known: tuple[Array, Array, float] | None = None
) -> FreeFit:
    """Joint fit of free runs.

    Parameters
    ----------
    runs : of one hull, from ``free_data``
    speed_m_s : at which all is quoted; None = the known ones' speed, or the runs' mean
    known : the six derivatives of tows of the same hull, (6,), their covariance (6, 6), and the speed of both

    Raises
    ------
    EstimationError : as ``methods.fit_free_run``
    """
    if not runs:
        raise EstimationError("no free run")
    records = [run.record for run in runs]
    if known is not None:
        six, covariance, speed = known
        factor = _to_speed(1.0 if speed_m_s is None else speed_m_s / speed)
        hull = Hull(*map(float, six * factor), speed_m_s=speed if speed_m_s is None else speed_m_s)
        found = fit_free_run(records, hull, covariance * np.outer(factor, factor))
        values = np.array([*found.six.six, found.y_delta.value, found.n_delta.value])
        joint = found.joint[:8, :8]
        return FreeFit("tows", found, (*DERIVATIVE_UNITS, *RUDDER_UNITS), values, joint, _fitted(runs, found))
    speed = float(np.mean([r.speed_m_s for r in records])) if speed_m_s is None else speed_m_s
    found = fit_free_ratios(records, speed)
    ratios = np.array([*found.six.six[2:], found.y_delta.value, found.n_delta.value])
    spread, shown = found.joint[2:8, 2:8], _fitted(runs, found)
    masses = _masses(runs)
    if masses is None:
        return FreeFit("ratios", found, tuple(RATIO_UNITS), ratios, spread, shown)
    whole = np.zeros((8, 8))
    whole[:2, :2], whole[2:, 2:] = masses[1], spread

    def forces(values: Array) -> Array:
        mass, inertia = values[:2]
        return values * np.array([1.0, 1.0, mass, mass, inertia, inertia, mass, inertia])

    values, joint = propagate(forces, np.concatenate([masses[0], ratios]), whole)
    return FreeFit("masses", found, (*DERIVATIVE_UNITS, *RUDDER_UNITS), values, joint, shown)


def _to_speed(ratio: float) -> Array:
    """Of the six, as the speed grows by ``ratio``: masses stay, damping goes with it."""
    return np.array([1.0, 1.0, ratio, ratio, ratio, ratio])


def _masses(runs: Sequence[FreeData]) -> tuple[Array, Array] | None:
    """m' and I' with their covariance, as [priors.derivatives] of the first run that states both gives them, or None."""
    for run in runs:
        said = run.priors.derivatives
        mass, inertia, k2 = said.m_minus_y_vdot, said.i_minus_n_rdot, said.k2_m2
        if mass is not None and inertia is not None:
            return np.array([mass.value, inertia.value]), np.diag([mass.std**2, inertia.std**2])
        if mass is not None and k2 is not None:
            slope = np.array([[1.0, 0.0], [k2.value, mass.value]])
            return np.array([mass.value, k2.value * mass.value]), slope @ np.diag([mass.std**2, k2.std**2]) @ slope.T
    return None


def _fitted(runs: Sequence[FreeData], found: FreeRunFit) -> list[pd.DataFrame]:
    frames = []
    for run, rest in zip(runs, found.fit.residual, strict=True):
        r = run.record
        frames.append(pd.DataFrame({"t_s": r.t_s, "y_cg_m": r.y_m - rest[:, 0], "beta_rad": r.beta_rad - rest[:, 1]}))
    return frames


# the file -----------------------------------------------------------------------------------------------------------


def free_file(
    fit: FreeFit,
    runs: Sequence[FreeData],
    length_pp_m: float,
    mass_kg: float,
    density_kg_m3: float | None,
    tool: str,
    inputs: dict[str, str],
    failed: dict[str, str],
    truth: Hull | None = None,
) -> DerivativesFile:
    """A fit of free runs as derivatives.json, method "free_run".

    Parameters
    ----------
    fit : of ``fit_free_run``
    runs : as fitted
    length_pp_m : LBP, m
    mass_kg : of the model, kg
    density_kg_m3 : None where run.toml does not say it; ratios need none, and primes of forces are then left out
    tool : version of towline, as the file states it
    inputs : name of an input -> its SHA-256, as the file states them
    failed : name of a run -> why it is left out
    truth : the hull that the runs were made from, or None

    Raises
    ------
    EstimationError : forces in newtons are to be given and the water's density is not known
    """
    speed = fit.found.speed_m_s
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    factors = _factors(fit, density_kg_m3, length_pp_m, speed)
    true = None if truth is None else _true_values(fit, truth.at_speed(speed))
    units = RATIO_UNITS if fit.scale == "ratios" else DERIVATIVE_UNITS | RUDDER_UNITS
    with np.errstate(divide="ignore", invalid="ignore"):
        single = [i for i in range(len(sd)) if sd[i] < OPEN_SHARE * abs(fit.values[i])]
    derivatives = {
        fit.names[i]: Derivative(
            value=float(fit.values[i]),
            std=float(sd[i]),
            unit=units[fit.names[i]],
            prime=float(fit.values[i] / factors[i]),
            prime_std=float(sd[i] / factors[i]),
            true_value=None if true is None else float(true[i]),
        )
        for i in single
    }
    size = np.where(sd > 0, sd, 1.0)
    six, joint = fit.found.six.six, fit.found.joint[:8, :8]
    rates = np.array([*six, fit.found.y_delta.value, fit.found.n_delta.value])
    stable, stable_sd = (float(x) for x in propagate(_stable, rates, joint))
    return DerivativesFile(
        schema="towline/derivatives",
        tool=tool,
        inputs=inputs,
        method="free_run",
        form="full",
        speed_m_s=speed,
        density_kg_m3=density_kg_m3,
        length_pp_m=length_pp_m,
        mass_kg=mass_kg,
        derivatives=derivatives,
        correlation=(fit.covariance / size[:, None] / size)[np.ix_(single, single)].tolist(),
        straight_line_stable=stable > 0,
        runs={run.name: _run_fit(fit, run, index) for index, run in enumerate(runs)},
        hull=_asymmetry(fit),
        free=FreeResult(
            scale=fit.scale,
            nomoto=_nomoto(rates, joint),
            rudder_rad={
                run.name: (
                    float(run.record.rudder(run.record.t_s).min()),
                    float(run.record.rudder(run.record.t_s).max()),
                )
                for run in runs
            },
        ),
        failed=failed,
        not_identifiable=_open(fit, sd),
        notes=_notes(fit, runs, float(np.sqrt(max(stable_sd, 0.0))), stable),
    )


def _factors(fit: FreeFit, density: float | None, length: float, speed: float) -> Array:
    if fit.scale == "ratios":
        return length ** _LENGTH_POWER.astype(float) * speed**_SPEED_POWER
    if density is None:
        raise EstimationError("[water] is missing: the primes of forces in newtons need density_kg_m3")
    rudder = 0.5 * density * length ** np.array([2.0, 3.0]) * speed**2
    return np.concatenate([prime_factors(density, length, speed), rudder])


def _true_values(fit: FreeFit, hull: Hull) -> Array:
    values = np.array([*hull.six, hull.y_delta, hull.n_delta])
    if fit.scale != "ratios":
        return values
    mass, inertia = values[:2]
    return values[2:] / np.array([mass, mass, inertia, inertia, mass, inertia])


def _stable(values: Array) -> Array:
    """(Y_v N_r - N_v Y_R)/(m' I'), 1/s2: above 0 a hull is straight-line stable; ``values``: the six, ..."""
    mass, inertia, y_v, y_r, n_v, n_r = values[:6]
    return (y_v * n_r - n_v * y_r) / (mass * inertia)


def _nomoto(rates: Array, covariance: Array) -> dict[str, Measured]:
    """K and the times of r/delta = K (1 + T3 s)/((1 + T1 s)(1 + T2 s)) (5.14), T = T1 + T2 - T3."""

    def numbers(values: Array) -> Array:
        mass, inertia, y_v, _, n_v, n_r, y_d, n_d = values
        low = _stable(values)
        gain = (y_d * n_v - n_d * y_v) / (mass * inertia * low)
        lead = n_d * mass / (y_d * n_v - n_d * y_v)
        both = -(y_v / mass + n_r / inertia) / low
        return np.array([gain, both - lead, both, 1 / low, lead])

    value, spread = propagate(numbers, rates, covariance)
    names = ("gain_1_s", "time_s", "t1_plus_t2_s", "t1_times_t2_s2", "t3_s")
    sd = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return {n: Measured(value=float(v), std=float(s)) for n, v, s in zip(names, value, sd, strict=True)}


def _asymmetry(fit: FreeFit) -> dict[str, Measured]:
    """Y*, N* (over their masses where these are not known) and, in newtons, X_delta; at the fit's own speed."""
    y, n, arm = fit.found.y_bias_n, fit.found.n_bias_n_m, fit.found.x_delta_m
    assert y is not None
    assert n is not None
    if fit.scale == "tows":
        return {"y_bias_n": y, "n_bias_n_m": n, "x_delta_m": arm}
    return {"y_bias_over_mass_m_s2": y, "n_bias_over_inertia_rad_s2": n}


def _run_fit(fit: FreeFit, run: FreeData, index: int) -> RunFit:
    found, record = fit.found, run.record
    rest = found.fit.residual[index]
    assert record.covariance is not None
    colour = measured(rest, stated(record.covariance, record.t_s))
    white, orders = colour(rest), [len(a) for a in colour.regression]
    rms = np.sqrt(np.mean(rest**2, axis=0))

    def pair(value: float, sd: float) -> Measured:
        return Measured(value=float(value), std=float(sd))

    names = ("y_m", "beta_rad", "v_m_s", "r_rad_s")
    return RunFit(
        start={n: pair(*x) for n, x in zip(names, zip(found.starts[index], found.starts_sd[index]), strict=True)},
        bias={"beta_b_rad": pair(found.beta_bias[index], found.beta_bias_sd[index])} if record.beta_bias_sd_rad else {},
        nuisance={},
        noise={
            "y_m": float(rms[0]),
            "beta_rad": float(rms[1]),
            "y_over_sigma": float(colour.scale[0]),
            "beta_over_sigma": float(colour.scale[1]),
        },
        tests={
            "autocorrelation_y_lag1": float(autocorrelation(rest[:, 0], 1)[1]),
            "autocorrelation_beta_lag1": float(autocorrelation(rest[:, 1], 1)[1]),
            "noise_order_y": float(orders[0]),
            "noise_order_beta": float(orders[1]),
            "ljung_box_p_y": ljung_box_p(white[:, 0], orders[0]),
            "ljung_box_p_beta": ljung_box_p(white[:, 1], orders[1]),
        },
        samples=len(record.t_s),
        trim_rad=run.trim_rad,
    )


def _open(fit: FreeFit, sd: Array) -> list[str]:
    """What the runs do not fix, in words."""
    lines = []
    for name, value, spread in zip(fit.names, fit.values, sd, strict=True):
        if not spread < OPEN_SHARE * abs(value):
            words = WORDS.get(name, name)
            lines.append(
                f"{words} = {value:.2g} +- {spread:.1g}: its 95 % interval holds 0, no single number is given; a longer run, "
                "or a rudder that goes over faster and at other rhythms, would fix it"
            )
    if fit.scale == "ratios":
        lines += [
            "the scale of forces: nothing in a free run is measured in newtons. It gives Y_v, Y_r - mU and Y_delta over "
            "m' = m - Y_vdot, and N_v, N_r and N_delta over I' = I - N_rdot, not m', I' and the six themselves. Tows of the same "
            "hull in the same command give them, or m' and I' under [priors.derivatives]",
            "X_v and X_delta: they need K^2 = I'/m' as well; the stability verdict and Nomoto's K and T need neither",
        ]
    elif fit.scale == "masses":
        lines.append(
            "m' and I': they are those of [priors.derivatives], not of the runs; k % in m' are k % in Y_v, Y_r - mU and Y_delta, "
            "k % in I' are k % in N_v, N_r and N_delta"
        )
    else:
        lines.append(
            "the scale of forces: it is the tows', with their error; the free runs give the rudder and a second opinion on ratios"
        )
    return lines


def _notes(fit: FreeFit, runs: Sequence[FreeData], stable_sd: float, stable: float) -> list[str]:
    notes = list(fit.found.notes)
    if any(run.assumed_sigma for run in runs):
        notes.append("the motion states no sigma; the noise was measured from the residuals")
    notes.append(
        "speed is taken as " + ("its history says" if any(r.record.speed is not None for r in runs) else "constant")
        + ": loss of speed in a turn is not modelled"
    )  # fmt: skip
    if not any(run.record.beta_bias_sd_rad for run in runs):
        notes.append(
            "an error of the heading that is common to the runs goes into Y* and N*; one of each run's own is not modelled unless "
            "beta_bias_sd_rad in [priors] says how large it may be"
        )
    largest = max((np.abs(sizes).max() for sizes in fit.found.modes.values()), default=0.0)
    if largest > 3:
        notes.append(
            f"the fit moves a common camera error by {largest:.1f} of its standard deviations: check the datum, the heights and "
            "the lens"
        )
    sure = float(ndtr(abs(stable) / stable_sd)) if stable_sd > 0 else 1.0
    if sure <= SURE:
        notes.append(
            f"straight-line {'stable' if stable > 0 else 'unstable'} with a probability of {100 * sure:.0f} % only"
        )
    if len(runs) == 1:
        notes.append("one free run only: nothing checks it; a run with another rudder programme would")
    return notes


__all__ = ["RATIO_UNITS", "FreeData", "FreeFit", "fit_free", "free_data", "free_file"]
