"""The hull of another simulator in the diagnosis of tows: an FMU of C, against the equations that stand in towline.

The FMUs are those of the example ``hull_fmu.py``, which ``fmu_of_c.py`` makes.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import hull_fmu
import numpy as np
import pandas as pd
import pendulum_fmu
import pytest
import tomlkit
from fmu_of_c import Variable, make

from towline.cli import main
from towline.record import InputError
from towline.record.gap_file import GapFile
from towline.record.results import read_result
from towline.record.tables import write_table
from towline.simulate import Hull, Start, Tow, simulate_full
from towline.simulate.model import full_state, paid_state, side_by_side

pytest.importorskip("fmpy", reason="fmpy, which reads FMUs, is not installed (the extra fmu)")
pytestmark = pytest.mark.skipif(
    shutil.which("gcc") is None and shutil.which("cc") is None, reason="no C compiler is there to make FMUs with"
)
from towline.diagnose.own.hull import FmuHull, read_hull  # noqa: E402

RNG = np.random.default_rng
HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=40.0)
RUNS, COLUMNS, TIMES = 3, 4, 5
SD = 3e-4, 5e-4
"""Noise of y, m, and heading, rad."""
DRAG_N_S2_M2 = 800.0
"""Side force of drag by the square of the sway velocity."""


@pytest.fixture(scope="module")
def hulls(tmp_path_factory: pytest.TempPathFactory) -> dict[int, FmuHull]:
    folder = tmp_path_factory.mktemp("hulls")
    paths = {version: folder / f"hull_{version}.fmu" for version in (2, 3)}
    for version, path in paths.items():
        hull_fmu.main([str(path), "--version", str(version)])
    return {version: read_hull(path) for version, path in paths.items()}


def drawn(line: str, crossed: float) -> tuple[Hull, Tow, np.ndarray]:
    """Hulls and tows of some runs and columns, and states."""
    rng = RNG(3)
    six = {
        name: getattr(HULL, name) * rng.uniform(0.9, 1.1, (1, COLUMNS))
        for name in ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")
    }
    cross = {"y_rdot": crossed * np.ones((1, COLUMNS)), "n_vdot": -crossed * np.ones((1, COLUMNS))} if crossed else {}
    hull = side_by_side(
        Hull, **six, **cross, speed_m_s=1.28, mass_kg=np.full((RUNS, 1), 78.0), x_udot_kg=-4.0, x_vr_kg=40.0,
        x_vv_kg_m=-9.0, x_rr_kg_m=2.0, y_delta=3.0, n_delta=-3.5, y_bias_n=0.05,
    )  # fmt: skip
    tow = side_by_side(
        Tow, speed_m_s=1.28, line_length_m=0.9, tow_point_m=rng.uniform(1.3, 1.7, (RUNS, COLUMNS)),
        tension_n=rng.uniform(3.5, 4.5, (RUNS, COLUMNS)), tow_point_offset_m=0.01, rudder_rad=0.1, line=line,
    )  # fmt: skip
    return hull, tow, rng.normal(0.0, 0.1, (4, TIMES, RUNS, COLUMNS))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("line", ["surge", "constant"])
@pytest.mark.parametrize("crossed", [0.0, 4.0])
def test_it_moves_as_towlines_own_equations(hulls: dict[int, FmuHull], version: int, line: str, crossed: float) -> None:
    """With rudder, asymmetry, pushes in all three ways and cross added masses; rates to rounding, T as well."""
    hull, tow, state = drawn(line, crossed)
    there = hulls[version](hull, tow, RUNS, COLUMNS)

    def extra(t: Any, y: Any, beta: Any, v: Any, r: Any, alpha: Any) -> tuple[Any, Any, Any]:
        return 0.3 * v, 0.2 * r, 0.1 * v

    one, other = (full_state(0.0, state, h, tow, extra) for h in (hull, there))
    np.testing.assert_allclose(other.rates, one.rates, rtol=0, atol=1e-14)
    np.testing.assert_allclose(other.tension_n, one.tension_n, rtol=1e-12)
    fast = (*state, RNG(4).uniform(1.0, 1.4, state.shape[1:]))
    one, other = (paid_state(0.0, fast, 3.0 + 0.0 * state[0], h, tow, extra) for h in (hull, there))
    np.testing.assert_allclose(other.rates, one.rates, rtol=0, atol=1e-14)


def test_numbers_may_change_between_calls(hulls: dict[int, FmuHull]) -> None:
    """Fewer columns, then other numbers, then the first again: every hull answers with its own."""
    hull, tow, state = drawn("surge", 0.0)
    heavy = side_by_side(Hull, **{**vars(hull), "m_minus_y_vdot": 1.5 * hull.m_minus_y_vdot})
    one, two = hulls[2](hull, tow, RUNS, COLUMNS), hulls[2](heavy, tow, RUNS, COLUMNS)
    for _ in range(2):
        for mine, there in ((hull, one), (heavy, two)):
            own, other = (full_state(0.0, state, h, tow).rates for h in (mine, there))
            np.testing.assert_allclose(other, own, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("variables", "equations", "said"),
    [
        (hull_fmu.VARIABLES[:-4], None, r"input ahead_n: missing; the hull's FMU has none"),
        (
            tuple(v for v in hull_fmu.VARIABLES if v.name != "n_r"),
            None,
            r"parameter n_r: missing; the hull's FMU has m_minus_y_vdot",
        ),
        (
            hull_fmu.VARIABLES,
            hull_fmu.EQUATIONS.replace("/ p[M_Y]", "/ (p[M_Y] * (1 + v * v))"),
            r"its answer to a force changes with its motion",
        ),
        (
            hull_fmu.VARIABLES,
            hull_fmu.EQUATIONS.replace("+ p[SIDE]", ""),
            r"does not answer ahead_n, side_n, moment_n_m",
        ),
    ],
)
def test_what_is_no_hull_is_said(
    variables: tuple[Variable, ...], equations: str | None, said: str, tmp_path: Path
) -> None:
    # without a variable the code's places do not fit; nothing calls it before its description is refused
    path = make(tmp_path / "hull.fmu", "hull", equations or hull_fmu.EQUATIONS, variables, 3)
    with pytest.raises(InputError, match=said):
        read_hull(path)


def test_other_fmus_are_no_hulls(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"state u_m_s: missing; the hull's FMU has angle, rate"):
        read_hull(pendulum_fmu.make(tmp_path / "pendulum.fmu"))
    with pytest.raises(InputError, match=r"runs by itself \(co-simulation\)"):
        read_hull(pendulum_fmu.make(tmp_path / "alone.fmu", 2, "co-simulation"))


def folder_of(folder: Path, tow: dict[str, Any], motion: pd.DataFrame) -> Path:
    """A run that came as motion."""
    folder.mkdir()
    content = {
        "name": folder.name,
        "source": {"motion": "motion.csv"},
        "tow": tow,
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0, "tank_width_m": 4.6},
    }
    (folder / "run.toml").write_text(tomlkit.dumps(content))
    table = motion[["t_s", "y_cg_m", "beta_rad"]].assign(
        alpha_rad=np.nan, sigma_y_cg_m=SD[0], sigma_beta_rad=SD[1], status="measured"
    )
    write_table(folder / "motion.csv", table)
    return folder


@pytest.mark.slow
def test_a_simulator_that_has_the_drag_misses_nothing(tmp_path: Path) -> None:
    """Drag by the square in the tank: towline's own equations miss it; a hull that has it, in C, follows the runs."""

    def drag(t: Any, y: Any, beta: Any, v: Any, *_: Any) -> tuple[Any, Any]:
        return -DRAG_N_S2_M2 * v * np.abs(v), 0.0 * v

    rng, runs, t_s = RNG(1), [], np.arange(0, 26.0, 0.04)
    for point, across in ((1.446, 0.3), (1.649, 0.4)):
        tow = {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": point, "tension_n": 3.96}
        motion = simulate_full(HULL, Tow(**tow, line="surge"), Start(y_cg_m=across), t_s, extra=drag)
        motion["y_cg_m"] += SD[0] * rng.normal(size=len(t_s))
        motion["beta_rad"] += SD[1] * rng.normal(size=len(t_s))
        runs.append(folder_of(tmp_path / f"x{point}", tow, motion))
    folders = [str(folder) for folder in runs]
    with_drag = hull_fmu.EQUATIONS.replace("d[1] = (side", f"d[1] = (side - {DRAG_N_S2_M2} * v * fabs(v)")
    hull = str(make(tmp_path / "hull.fmu", "hull", with_drag, hull_fmu.VARIABLES, len(hull_fmu.STATES)))
    verdicts = {}
    for name, more in (("own", []), ("its", ["--hull", hull])):
        out = tmp_path / name
        assert main(["diagnose", *folders, "--line", "surge", "--no-page", "-o", str(out), *more]) == 0
        verdicts[name] = read_result(out / "gap.json", GapFile)
    assert verdicts["own"].verdict in ("effect", "form_not_exact", "unknown")
    assert verdicts["own"].where.stage == "sway"
    assert verdicts["its"].verdict == "no_gap"
    assert hull in verdicts["its"].inputs
    for name, told in verdicts["its"].derivatives["before"].items():
        if name in vars(HULL) and name in ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "n_v", "n_r"):
            assert abs(told.value - getattr(HULL, name)) < 4 * told.std, name
