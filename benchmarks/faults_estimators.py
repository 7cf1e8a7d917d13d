"""The estimators on damaged records: nothing, one sample, constant, NaN, inf, times twice or backwards, 1e9 times too large."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import faults_bases as base
import numpy as np
import pandas as pd
from faults_cases import Draw, pick
from hypothesis import strategies as st

from towline.geometry import fit_datum, motion_from_tracks, run_datum
from towline.identify import fit_runs, fit_steady, run_data, steady_state
from towline.identify.methods import FreeRecord, Record, arx_of_records, fit_arx, fit_decay, fit_free_run
from towline.record import Run, RunFile, TowlineError
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, simulate_linear

HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
STEP_S, SAMPLES = 0.25, 160
POINTS_M = (1.446, 1.649)


@dataclass(frozen=True)
class Estimator:
    """An estimator under test.

    Attributes
    ----------
    name : in the table
    cases : damaged records
    answer : a record -> the numbers that must be finite
    share : of the cases asked for (slow ones take fewer)
    """

    name: str
    cases: st.SearchStrategy[Any]
    answer: Callable[[Any], Sequence[Any]]
    share: float = 1.0


def estimated(estimator: Estimator, case: Any) -> str:
    """accepted | refused; anything else is raised."""
    try:
        found = estimator.answer(case)
    except TowlineError as error:
        said = str(error)
        assert len(said.splitlines()) == 1, f"the message is not one line: {said!r}"
        return "refused"
    for k, values in enumerate(found):
        assert np.isfinite(np.asarray(values, dtype=complex)).all(), f"accepted, but answer {k} is {values}"
    return "accepted"


# records -------------------------------------------------------------------------------------------------------------


@cache
def _tow(point_m: float) -> np.ndarray:
    motion = simulate_linear(HULL, _line(point_m), Start(y_cg_m=0.2, beta_rad=0.03), STEP_S * np.arange(SAMPLES))
    noise = np.random.default_rng(1).normal(0, (1e-4, 1e-4), (SAMPLES, 2))
    values = motion[["t_s", "y_cg_m", "beta_rad", "alpha_rad"]].to_numpy(copy=True)
    values[:, 1:3] += noise
    return values


def _line(point_m: float) -> Tow:
    return Tow(1.28, 0.91, point_m, 3.96)


@st.composite
def records(draw: Draw, point_m: float = POINTS_M[0]) -> np.ndarray:
    """(n, 4): t_s, y_cg_m, beta_rad, alpha_rad."""
    values = _tow(point_m).copy()
    for _ in range(draw(st.integers(1, 2))):
        if not len(values):
            break
        column = draw(st.integers(0, 3))
        rows = slice(draw(st.integers(0, len(values) - 1)), None, pick(draw, (1, 2, 50, SAMPLES)))
        match draw(st.integers(0, 8)):
            case 0:
                values = values[: pick(draw, (0, 1, 2, 5, 19, 25, 60))]
            case 1:
                values[rows, column] = pick(draw, (np.nan, np.inf, -np.inf, 1e300))
            case 2:
                values[:, column] = pick(draw, (0.0, 1.0, -1e9))
            case 3:
                values[:, column] *= pick(draw, (1e9, -1e9, 1e-9, 0.0, -1.0))
            case 4:
                values = np.repeat(values, 2, axis=0)
            case 5:
                values[:, 0] = values[::-1, 0]
            case 6:
                values[rows, column] += pick(draw, (1e9, -1.0, 1e-3))
            case 7:
                values[:, 1:] = np.round(values[:, 1:], pick(draw, (0, 1)))
            case _:
                values[:, 1:] = 0.0
    return values


def _run(text: str) -> Run:
    return Run(Path("run"), check_tables(base.tree_of(text), RunFile, "run.toml"))


def _towed(point_m: float) -> Run:
    text = base.RUN.replace('tracks = "tracks.csv"\nspan_s = [0.0, 9.0]', 'motion = "motion.csv"')
    return _run(text.replace('tension = "tension.csv"', "tension_n = 3.96").replace("1.548", str(point_m)))


def _frame(values: np.ndarray) -> pd.DataFrame:
    motion = pd.DataFrame(values, columns=["t_s", "y_cg_m", "beta_rad", "alpha_rad"])
    motion["status"] = "measured"
    return motion


# estimators ----------------------------------------------------------------------------------------------------------


def _fit(form: str) -> Callable[[Any], Sequence[Any]]:
    def answer(values: np.ndarray) -> Sequence[Any]:
        data = [
            run_data(_towed(p), _frame(v), None) for p, v in zip(POINTS_M, (values, _tow(POINTS_M[1])), strict=True)
        ]
        fit = fit_runs(data, form)
        return fit.six, fit.covariance

    return answer


def _steady(values: np.ndarray) -> Sequence[Any]:
    tows = [
        steady_state(_towed(p), _frame(v), None) for p, v in zip(POINTS_M, (values, _tow(POINTS_M[1])), strict=True)
    ]
    fit = fit_steady(tows)
    return fit.x_v_m.value, fit.x_v_m.std


def _decay(values: np.ndarray) -> Sequence[Any]:
    fit = fit_decay(*values[:, :3].T)
    return fit.roots, fit.theta


def _arx(values: np.ndarray) -> Sequence[Any]:
    fit = fit_arx(values[:, 1:3], STEP_S, decimation=8, method="iv")
    return fit.a, fit.covariance, fit.poles


def _arx_pair(values: np.ndarray) -> Sequence[Any]:
    pair = [
        Record(v[:, 0], v[:, 1], v[:, 2], _line(p)) for p, v in zip(POINTS_M, (values, _tow(POINTS_M[1])), strict=True)
    ]
    fits, six = arx_of_records((pair[0], pair[1]), 8)
    return *(fit.a for fit in fits), six.six, six.covariance


def _free(values: np.ndarray) -> Sequence[Any]:
    times = STEP_S * np.arange(SAMPLES)
    record = FreeRecord(*values[:, :3].T, times, 0.2 * np.sin(times), 1.28)
    fit = fit_free_run([record], HULL, np.zeros((6, 6)))
    return fit.y_delta.value, fit.n_delta.value, fit.covariance


@st.composite
def _datums(draw: Draw) -> dict[str, Any]:
    tree = base.tree_of(base.RUN)
    tree["camera"] = pick(draw, (tree["camera"], None))
    for _ in range(draw(st.integers(1, 3))):
        point = pick(draw, tree["datum"])
        other = pick(draw, tree["datum"])
        match draw(st.integers(0, 5)):
            case 0:
                point["pixel_px"] = [pick(draw, (0.0, 1e9, -1e9, 1e300, 639.5)), pick(draw, (0.0, 1e9, -1e6, 120.5))]
            case 1:
                point["tank_m"] = [
                    pick(draw, (0.0, 100.0, -3.0)),
                    pick(draw, (0.0, -0.7, 99.0)),
                    pick(draw, (0.0, 0.5, 20.0)),
                ]
            case 2:
                point["sigma_px"] = pick(draw, (1e-300, 1e-6, 100.0))
            case 3:
                point["tank_sd_m"] = pick(draw, (0.0, 1e9, 1e300))
            case 4:
                point["pixel_px"] = [p + 1e-7 for p in other["pixel_px"]]
            case _:
                point["tank_m"], other["tank_m"] = other["tank_m"], point["tank_m"]
    return {key: value for key, value in tree.items() if value is not None}


def _datum(tree: dict[str, Any]) -> Sequence[Any]:
    file = check_tables(tree, RunFile, "run.toml")
    fit = fit_datum(file.datum, file.camera, [m.depth_m for m in file.marker], (1280, 720))
    return (fit.rms_px,)


def _tracks(values: np.ndarray) -> pd.DataFrame:
    count = len(values)
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(count), 2),
            "t_s": np.repeat(values[:, 0], 2),
            "marker": ["bow", "stern"] * count,
            "u_px": np.stack([640 + 300 * values[:, 1], 640 + 280 * values[:, 1]], 1).ravel(),
            "v_px": np.stack([300 + 0 * values[:, 2], 500 + 200 * values[:, 2]], 1).ravel(),
            "sigma_u_px": 0.1,
            "sigma_v_px": 0.1,
            "status": "measured",
        }
    )


def _poses(values: np.ndarray) -> Sequence[Any]:
    run = _run(base.RUN)
    found = motion_from_tracks(run, _tracks(values), run_datum(run, (1280, 720))).motion
    rows = found[found["status"] == "measured"]
    return rows["y_cg_m"], rows["beta_rad"]


def estimators() -> list[Estimator]:
    """All of them, in the order of the table."""
    return [
        Estimator("fit_runs, linear", records(), _fit("linear")),
        Estimator("fit_runs, full", records(), _fit("full"), 0.2),
        Estimator("steady_state, fit_steady", records(), _steady),
        Estimator("fit_decay", records(), _decay),
        Estimator("fit_arx", records(), _arx),
        Estimator("arx_of_records", records(), _arx_pair),
        Estimator("fit_free_run", records(), _free),
        Estimator("fit_datum", _datums(), _datum),
        Estimator("motion_from_tracks", records(), _poses),
    ]
