"""Old gaps: frequencies, damping and amplitude ratios of two models in the tank against simulators with captive tests' derivatives.

    python examples/thesis_gap.py table_8_6_mariner_fits.csv table_7_1_mariner_runs.csv
    python examples/thesis_gap.py table_8_7_bombardier_fits.csv table_7_2_bombardier_runs.csv --model bombardier

The records are lost; what is left are the fitted oscillations of twelve MARINER tows (Table 8.6, ITTC derivatives) and twelve
BRITISH BOMBARDIER tows (Table 8.7, Southampton's PMM derivatives of Table 8.4). The diagnosis works on them as on a film: the
simulator is an eigenvalue problem, a run is a group of tows, its values are log frequency, damping ratio and log amplitude ratio at
each tow point. Tensions are not printed ("about 4 N at 1.28 m/s"; Table 8.3 follows from about 2.1 N at 0.86 m/s): they are among
the effects.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.gap import Diagnosis, diagnosed
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.identify.reference import reference_set
from towline.record import InputError
from towline.simulate.model import DERIVATIVE_UNITS, Hull, Tow, linear_system

Array = np.ndarray

SURE = 0.05
"""Relative: what captive tests of one hull differ by between tanks."""


@dataclass(frozen=True)
class Model:
    """A model, its simulator and its tows.

    Attributes
    ----------
    six : derivatives at ``speed_m_s``
    tension_n, line_m : at that speed; where a tow's own line is printed, that counts
    low_m_s : tows below this speed may have another tension than U^2 gives
    scatter : of log frequency, damping ratio and log amplitude ratio in each group
    left_out : runs whose printed fit failed
    """

    six: Array
    speed_m_s: float
    tension_n: float
    line_m: float
    low_m_s: float
    scatter: Mapping[int, tuple[float, float, float]]
    left_out: tuple[int, ...] = ()


def mariner() -> Model:
    """Frequency by its repeats (tow point 6 twice; 6 and 4 twice), the rest by how it scatters about a smooth course."""
    scatter = {2: (0.007, 0.012, 0.012), 1: (0.13, 0.06, 0.06)}
    six = np.array(reference_set("ittc").hull(1025.0, 2.66, 1.28).six)
    return Model(six, 1.28, 3.96, 0.91, 0.8, scatter)


def bombardier() -> Model:
    """No tow was repeated: all by how it scatters about a straight course over the tow points (amplitudes: all groups together)."""
    scatter = {1: (0.017, 0.007, 0.036), 2: (0.005, 0.007, 0.036), 3: (0.007, 0.025, 0.036)}
    return Model(np.array([193.44, 49.65, -42.92, -46.28, -51.66, -43.80]), 0.86, 2.08, 0.851, 0.93, scatter, (79,))


MODELS = {"mariner": mariner, "bombardier": bombardier}
EFFECTS = (
    Effect("tension", "line", (Parameter("share", "", 0.1),), "The line pulled otherwise than assumed.", "Weigh it."),
    Effect(
        "tension_at_low_speed", "line", (Parameter("share", "", 0.5),),
        "Resistance does not fall with U^2 (laminar flow, the line's own drag): another tension at the lower speed.",
        "Weigh it at each speed.",
    ),
    Effect("line_length", "line", (Parameter("longer_m", "m", 0.03),), "The line was not as long as stated.", "Measure it."),
    Effect("clock", "clock", (Parameter("rate", "", 0.05),), "The recorder ran at another rate.", "Record a clock."),
    Effect(
        "added_mass_coupling", "yaw", (Parameter("y_rdot", "kg m", 15.0), Parameter("n_vdot", "kg m", 15.0)),
        "Accelerating water couples sway and yaw.", "Add Y_rdot and N_vdot.",
    ),
    Effect(
        "quadratic_drag", "sway", (Parameter("y_vv", "N s2/m2", 200.0), Parameter("n_vv", "N s2/m", 100.0)),
        "Cross-flow drag, linearised at each run's own amplitude (8/(3 pi)).", "Add Y_v|v|; swing less.",
    ),
    Effect(
        "swivel_friction", "line", (Parameter("moment_n_m", "N m", 0.05, one_sided=True),),
        "Dry friction in the swivel, linearised at each run's own amplitude.", "Use a bearing.",
    ),
    Effect(
        "hull_asymmetry", "yaw", (Parameter("side_n", "N", 0.05),), "A crooked hull: no frequency shows it.", "Look at the mean."
    ),
)  # fmt: skip


def table(fits: Path, runs: Path) -> pd.DataFrame:
    """Tows of both tables, one row each."""
    for path in (fits, runs):
        if not path.is_file():
            raise InputError(path, "", "no such file")
    # run 37 is printed with tow point 10's place; its hole is the same in both tables
    left = pd.read_csv(fits, comment="#").drop(columns="x_t_m")
    settings = pd.read_csv(runs, comment="#")
    known = [name for name in ("run", "x_t_m", "speed_m_s", "line_length_m") if name in settings]
    return left.merge(settings[known], on="run").sort_values(["group", "run"])


def as_runs(rows: pd.DataFrame, model: Model) -> tuple[list[UsersRun], dict[str, pd.DataFrame]]:
    """A run for each group: its tows are its "times"."""
    made, conditions = [], {}
    rows = rows[~rows["run"].isin(model.left_out)]
    for group in model.scatter:
        mine = rows[rows["group"] == group]
        ratio = (mine["y_amp_m"] / mine["beta_amp_rad"]).abs()
        values = np.column_stack(
            [np.log(mine["omega_rad_s"]), -mine["lambda_per_s"] / mine["omega_rad_s"], np.log(ratio)]
        )
        n = len(mine)
        covariance = np.array([sd**2 * np.eye(n) for sd in model.scatter[group]])
        name = f"{mine['speed_m_s'].mean():.2f} m/s"
        if "line_length_m" in mine:
            name += f", line {mine['line_length_m'].mean():.3f} m"
        made.append(UsersRun(name, np.arange(n) * 1.0, values, covariance))
        conditions[name] = mine
    return made, conditions


def modes(conditions: dict[str, pd.DataFrame], model: Model) -> Any:
    """The simulator: log frequency, damping ratio, log |y/beta| of the slow oscillation at every tow."""

    def simulate(run: UsersRun, n: dict[str, Array], effects: dict[str, tuple[Array, ...]]) -> Array:
        rows = conditions[run.name]
        columns = len(n["y_v"])
        answer = np.empty((len(rows), 3, columns))
        for k in range(columns):
            given = {name: [float(v[k]) for v in numbers] for name, numbers in effects.items()}
            hull = Hull(*(float(n[name][k]) for name in DERIVATIVE_UNITS), speed_m_s=model.speed_m_s)
            for i, row in enumerate(rows.itertuples()):
                answer[i, :, k] = _mode(hull, row, given, model)
        return answer

    return simulate


def _mode(hull: Hull, row: Any, given: dict[str, list[float]], model: Model) -> tuple[float, float, float]:
    def one(name: str) -> float:
        return given.get(name, [0.0])[0]

    speed = float(row.speed_m_s)
    slow = 1 + one("tension_at_low_speed") if speed < model.low_m_s else 1.0
    tension = model.tension_n * (speed / model.speed_m_s) ** 2 * (1 + one("tension")) * slow
    line = float(getattr(row, "line_length_m", model.line_m))
    tow = Tow(speed, line + one("line_length"), float(row.x_t_m), tension)
    y_rdot, n_vdot = given.get("added_mass_coupling", [0.0, 0.0])
    here = replace(hull, y_rdot=y_rdot, n_vdot=n_vdot).at_speed(speed)
    y_vv, n_vv = given.get("quadratic_drag", [0.0, 0.0])
    sway, turn = _amplitudes(here, tow, abs(float(row.y_amp_m)))
    linear = 8 / (3 * np.pi) * sway
    rub = 4 / np.pi * one("swivel_friction") / max(turn, 1e-6)
    here = replace(here, y_v=here.y_v - y_vv * linear, n_v=here.n_v - n_vv * linear, n_r=here.n_r - rub)
    root, shape = _pair(here, tow)
    return (
        float(np.log(root.imag * (1 + one("clock")))),
        float(-root.real / root.imag),
        float(np.log(abs(shape[0] / shape[1]))),
    )


def _pair(hull: Hull, tow: Tow) -> tuple[complex, Array]:
    values, vectors = np.linalg.eig(linear_system(hull, tow)[0])
    up = np.flatnonzero(values.imag > 1e-9)
    k = up[np.argmin(values[up].imag)] if len(up) else 0
    return complex(values[k]) + (0j if len(up) else 1e-6j), vectors[:, k]


def _amplitudes(hull: Hull, tow: Tow, y_m: float) -> tuple[float, float]:
    """Of sway velocity and of the hull's turning against the line, for that amplitude of y."""
    root, shape = _pair(hull, tow)
    shape = shape / abs(shape[0]) * y_m
    angle = (shape[0] + tow.tow_point_m * shape[1]) / tow.line_length_m + shape[1]
    return float(abs(shape[2])), float(abs(root * angle))


def diagnose(fits: Path, runs: Path, model: Model) -> Diagnosis:
    """Which effect could make the gap."""
    made, conditions = as_runs(table(fits, runs), model)
    shared = [
        UsersNumber(name, float(v), sd=SURE * abs(float(v)), size=abs(float(v)))
        for name, v in zip(DERIVATIVE_UNITS, model.six, strict=True)
    ]
    # the noise is the scatter of a few tows: whether groups disagree beyond it, it does not say
    simulator = UsersSimulator(
        made, modes(conditions, model), shared, [], usual_force=0.01, most_force=0.04, noise_known=False
    )
    return diagnosed(simulator, EFFECTS, "example", {}, rng=np.random.default_rng(0))


def main() -> None:
    """Print the ranking and what it rests on."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("fits", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--model", choices=MODELS, default="mariner")
    given = parser.parse_args()
    found = diagnose(given.fits, given.runs, MODELS[given.model]())
    file = found.file
    print(
        f"{file.verdict}; no gap {file.p_no_gap:.3f}, unknown {file.p_unknown:.3f}; scatter left {file.noise['side_n']:.3f}"
    )
    for row in file.ranking:
        numbers = ", ".join(f"{k} {v.value:.3g} +- {v.std:.2g}" for k, v in row.parameters.items())
        print(
            f"  {' + '.join(row.effects):44} p {row.probability:5.2f}  log evidence {row.log_evidence:6.1f}  {numbers}"
        )
    print("base:")
    base = found.ranking.base
    for run, (residual, _) in zip(found.inference.simulator.runs, base.linear.rows, strict=True):
        print(f"  {run.name}: left over in log frequency {np.round(residual[:, 0], 3)}")
    print({k: f"{v.value:.2f} +- {v.std:.2f}" for k, v in file.derivatives["before"].items()})


if __name__ == "__main__":
    main()
