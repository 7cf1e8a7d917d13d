"""The identification benchmark's own tows with surge: against motions of another program, closed forms, and what is drawn."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import cumulative_simpson

STEP_M = 1e-8
"""Runge-Kutta at 25 ms against 1 ms; the files print ten digits. Measured: 2e-9 m."""
STEP_N = 1e-7
"""Of the pull: 82 kg times an acceleration whose error is the step's; measured: 5e-9 N."""
GOLDEN = {
    "surge_xT1.446_y0.25_xvr_xvv": {"tow_point_m": 1.446, "x_vr": 40.0, "x_vv": -25.0},
    "surge_xT1.548_y0.30": {"tow_point_m": 1.548},
    "surge_xT1.649_y0.20_offset": {"tow_point_m": 1.649, "offset_m": 0.02},
    "surge_xT1.751_y0.15": {"tow_point_m": 1.751},
}
TOW = {
    "speed_ref": 1.28,
    "mass_kg": 78.0,
    "x_udot": -4.0,
    "x_vr": 0.0,
    "x_vv": 0.0,
    "x_rr": 0.0,
    "power": 1.85,
    "resistance_n": 3.96,
    "speed_m_s": 1.28,
    "line_m": 0.91,
    "tow_point_m": 1.548,
    "release_rad": 0.0,
    "offset_m": 0.0,
    "y_delta": 0.0,
    "n_delta": 0.0,
}


def _numbers(module: ModuleType, *lanes: dict[str, float]) -> dict[str, np.ndarray]:
    full = [{**module.MARINER, **TOW, **lane} for lane in lanes]
    return {name: np.array([lane[name] for lane in full]) for name in full[0]}


@pytest.mark.once
@pytest.mark.parametrize("name", GOLDEN)
def test_tows_are_those_of_another_program(surge_cases: ModuleType, shared: Path, name: str) -> None:
    golden = pd.read_csv(shared / "golden" / f"{name}.csv")
    released = float(name.split("_y")[1][:4])
    numbers = _numbers(surge_cases, {**GOLDEN[name], "release_rad": np.arcsin(released / 0.91)})
    found = surge_cases.rigid_tows(numbers, golden["t_s"].to_numpy())
    for column in ("x_cg_m", "y_cg_m", "beta_rad", "v_m_s", "r_rad_s"):
        own = getattr(found, column.replace("_cg", ""))[0]
        assert np.abs(own - golden[column]).max() < STEP_M, column
    assert np.abs(found.tension_n[0] - golden["tension_n"]).max() < STEP_N


def test_a_straight_tow_pulls_with_resistance_and_inertia(surge_cases: ModuleType) -> None:
    times = np.arange(500) / 25
    halves = np.arange(2 * 499 * surge_cases.SUBSTEPS + 1) / (50 * surge_cases.SUBSTEPS)
    speed = 1.28 * (1 + 0.02 * np.sin(0.9 * halves))
    rate = 1.28 * 0.02 * 0.9 * np.cos(0.9 * halves)
    found = surge_cases.rigid_tows(_numbers(surge_cases, {}), times, None, speed[None], rate[None])
    every = 2 * surge_cases.SUBSTEPS
    wanted = 82.0 * rate[::every] + 3.96 * (speed[::every] / 1.28) ** 1.85
    assert np.abs(found.tension_n[0] - wanted).max() < STEP_N
    assert np.abs(found.beta_rad).max() == 0.0


@pytest.mark.slow
def test_a_rudder_held_long_ends_in_the_steady_tow(surge_cases: ModuleType) -> None:
    """Thesis (4.9): both balances, with u, v, S and T read from the motion."""
    numbers = _numbers(
        surge_cases, {"y_delta": 20.0, "n_delta": -0.45 * 2.66 * 20.0, "tow_point_m": 1.9, "line_m": 0.5}
    )
    times = np.arange(6000) / 10
    over = np.full((1, len(times)), np.radians(1.5))
    found = surge_cases.rigid_tows(numbers, times, over)
    beta, v, pull = found.beta_rad[0, -1], found.v_m_s[0, -1], found.tension_n[0, -1]
    alpha = np.arcsin((found.y_m[0, -1] + 1.9 * np.sin(beta)) / 0.5)
    share = np.cos(beta)  # u/U_0
    side = pull * np.sin(alpha + beta)
    # what the swing has left after 600 s
    assert v == pytest.approx(-1.28 * np.sin(beta), abs=1e-6)
    assert side == pytest.approx(share * -52.87 * v + share**2 * 20.0 * over[0, 0], rel=1e-5)
    assert side * 1.9 == pytest.approx(share * -48.51 * v - share**2 * 0.45 * 2.66 * 20.0 * over[0, 0], rel=1e-5)
    assert np.sign(alpha) == -1.0  # the side opposite to the stern force


def test_the_carriage_pays_for_every_joule(surge_cases: ModuleType) -> None:
    """Without damping: kinetic energy through the water = work of the line's end on the post less the resistance's."""
    bare = {"y_v": 0.0, "y_r_minus_mu": -78.0 * 1.28, "n_v": 0.0, "n_r": 0.0, "release_rad": 0.3, "offset_m": 0.01}
    times = np.arange(1500) / 100
    found = surge_cases.rigid_tows(_numbers(surge_cases, bare), times)
    x, y, b, v, r = (getattr(found, name)[0] for name in ("x_m", "y_m", "beta_rad", "v_m_s", "r_rad_s"))
    px = x + 1.548 * np.cos(b) - 0.01 * np.sin(b)
    assert np.hypot(px, y + 1.548 * np.sin(b) + 0.01 * np.cos(b)) == pytest.approx(0.91, abs=STEP_M)
    # x' = u cos(beta) - v sin(beta) - U, by a polynomial through the samples: 1e-8 m/s
    u = (np.gradient(x, times, edge_order=2) + v * np.sin(b) + 1.28) / np.cos(b)
    energy = 0.5 * (82.0 * u**2 + 149.19 * v**2 + 62.11 * r**2)
    power = found.tension_n[0] * -px / 0.91 * 1.28 - 3.96 * (u / 1.28) ** 1.85 * u
    gained = cumulative_simpson(power, x=times, initial=0.0)
    # central differences of x at 10 ms: h^2/6 times a third derivative of 0.02 m/s3 makes 3e-7 m/s, 105 kg m/s of momentum 4e-5 J
    assert np.abs((energy - gained)[2:-2] - (energy - gained)[2]).max() < 2e-4
    assert np.ptp(energy) > 2.0


@pytest.mark.slow
def test_campaigns_hold_what_their_options_say(surge_cases: ModuleType, tmp_path: Path) -> None:
    options = surge_cases.SurgeOptions(rudder="mixed", speed="history", gauge=False, span_s=8.0)
    kept = tmp_path / "kept.npz"
    first = surge_cases.surge_campaigns(5, 3, options, kept)
    again = surge_cases.surge_campaigns(5, 3, options, kept)
    fewer = surge_cases.surge_campaigns(5, 2, options)
    for one, two in [*zip(first, again, strict=True), *zip(first, fewer, strict=False)]:
        assert one.stated == two.stated
        assert one.truth == two.truth
        assert np.array_equal(one.y_m, two.y_m)
        assert np.array_equal(one.rudder_rad, two.rudder_rad)
    with pytest.raises(ValueError, match=r"kept\.npz holds"):
        surge_cases.surge_campaigns(6, 3, options, kept)
    for k, one in enumerate(first):
        assert "tension_n" not in one.stated
        assert one.y_m.shape == one.rudder_rad.shape == one.speed_m_s.shape == (4, 200)
        assert one.tension_n.min() > 0
        assert bool(np.ptp(one.rudder_rad, axis=1).any()) == bool(k % 2)
        # 800 values of 1 mm: their standard deviation scatters by 2.5 %
        assert (one.y_m - one.clean_y_m).std() == pytest.approx(1e-3, rel=0.1)
    plain = surge_cases.surge_campaigns(5, 3, surge_cases.SurgeOptions(span_s=8.0))
    assert all(one.rudder_rad is None and one.speed_m_s is None for one in plain)
    assert all(len(one.stated["tension_n"]) == 4 for one in plain)
    with pytest.raises(ValueError, match="no such kind"):
        surge_cases.surge_campaigns(5, 1, surge_cases.SurgeOptions(rudder="hard"))


def test_nuisances_scatter_as_the_priors_say(surge_cases: ModuleType) -> None:
    found = surge_cases.surge_campaigns(8, 300, surge_cases.SurgeOptions(span_s=0.2))
    priors = found[0].stated["priors"]
    for name in ("x_vr", "x_vv", "x_rr", "power"):
        key = {"x_vr": "x_vr_kg", "x_vv": "x_vv_kg_m", "x_rr": "x_rr_kg_m", "power": "power"}[name]
        mean, sd = priors[key]
        values = np.array([one.truth[name] for one in found])
        # four standard errors of a mean and of a standard deviation of 300
        assert values.mean() == pytest.approx(mean, abs=4 * sd / np.sqrt(300)), name
        assert values.std() == pytest.approx(sd, rel=4 / np.sqrt(600)), name
    assert all(one.truth["x_udot"] < 0 for one in found)
    release = np.degrees(np.abs([one.truth["release_rad"] for one in found]))
    assert release.min() > 3
    assert release.max() < 20
    read = np.array([np.array(one.stated["tension_n"]) / one.truth["resistance_n"] for one in found])
    assert read.mean(axis=1).std() == pytest.approx(np.hypot(0.005, 0.001 * 1.85), rel=4 / np.sqrt(600))
    assert (read - read.mean(axis=1, keepdims=True)).std() == pytest.approx(
        0.002 * np.sqrt(3 / 4), rel=4 / np.sqrt(1800)
    )


def test_the_tows_share_no_code_with_the_program(root: Path) -> None:
    tree = ast.parse((root / "benchmarks" / "surge_cases.py").read_text(encoding="utf-8"))
    names = [a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names]
    names += [node.module or "." for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {name.split(".")[0] for name in names} == {
        "__future__",
        "collections",
        "dataclasses",
        "json",
        "numpy",
        "pathlib",
        "typing",
    }
