"""A record ends where the model touches the wall or is lost for good; what comes before is used, and it is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.identify import run_data
from towline.identify.added_mass import added_masses
from towline.identify.cut import before_cut, cut_of
from towline.identify.steady import steady_state
from towline.pipeline.analysis import Batch, identify_batch
from towline.pipeline.stages import RunMotion
from towline.record import InputError
from towline.record.results import Derivative
from towline.record.run import Run
from towline.record.schema import ModelTable, RunFile
from towline.record.toml import check_tables
from towline.simulate import Hull, Start, Tow, simulate_full

TABLES = {
    "name": "r",
    "source": {"motion": "motion.csv"},
    "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.649, "tension_n": 3.96},
    "model": {"length_pp_m": 2.66, "mass_kg": 78.0, "beam_m": 0.4},
    "water": {"tank_width_m": 2.0},
}


def run_of(**tables: dict) -> Run:
    """The run with some tables changed."""
    return Run(Path(), check_tables({**TABLES, **tables}, RunFile, Path("run.toml")))


def motion_of(t_s: np.ndarray, y: np.ndarray, beta: np.ndarray | float = 0.0) -> pd.DataFrame:
    """A motion with a side force's angles."""
    return pd.DataFrame({"t_s": t_s, "y_cg_m": y, "beta_rad": beta, "alpha_rad": 0.2, "status": "measured"})


def test_the_side_of_an_ellipse_touches_the_wall() -> None:
    """|y| + sqrt((Lpp/2 sin b)^2 + (B/2 cos b)^2) reaches half the width less a hundredth of Lpp; at the first of three samples."""
    t = np.arange(0, 30, 0.1)
    beta = 0.2
    reach = np.hypot(1.33 * np.sin(beta), 0.2 * np.cos(beta))
    y = 0.04 * t
    first = t[y > 1.0 - 0.0266 - reach][0]
    cut = cut_of(run_of(), motion_of(t, y, beta))
    assert cut is not None
    assert cut.t_s == pytest.approx(first)
    assert f"touches the starboard wall at {first:.2f} s" in cut.words
    port = cut_of(run_of(), motion_of(t, -y, -beta))
    assert port is not None
    assert "port wall" in port.words
    assert before_cut(run_of(), motion_of(t, y, beta)).sum() == (t < first).sum()
    wide = {"model": {"length_pp_m": 2.66, "mass_kg": 78.0}}
    assumed = cut_of(run_of(**wide), motion_of(t, y, beta))
    assert assumed is not None
    assert "beam_m taken as 0.38 m" in assumed.words
    assert cut_of(run_of(water={}), motion_of(t, y, beta)) is None  # no width is given


def test_a_model_let_go_from_the_wall_and_a_single_bad_sample_are_no_touch() -> None:
    t = np.arange(0, 30, 0.1)
    leaves = 0.9 * np.exp(-t / 5)
    assert cut_of(run_of(), motion_of(t, leaves)) is None
    spike = leaves.copy()
    spike[200] = 0.95
    assert cut_of(run_of(), motion_of(t, spike)) is None
    back = leaves.copy()
    back[250:] = 0.9
    cut = cut_of(run_of(), motion_of(t, back))
    assert cut is not None
    assert cut.t_s == pytest.approx(25.0)


def test_a_model_lost_for_good_is_named_and_one_lost_for_a_while_is_not() -> None:
    t = np.arange(0, 30, 0.1)
    motion = motion_of(t, 0.1 + 0 * t)
    motion.loc[100:120, "status"] = "lost"
    assert cut_of(run_of(), motion) is None
    motion.loc[295:, "status"] = "lost"  # half a second at the end
    assert cut_of(run_of(), motion) is None
    motion.loc[200:, "status"] = "lost"
    cut = cut_of(run_of(), motion)
    assert cut is not None
    assert "lost for good at 20.00 s, 9.9 s before the record's end" in cut.words
    assert steady_state(run_of(), motion, None).span_s[1] == pytest.approx(19.9)


def test_what_comes_before_the_touch_identifies_and_the_result_says_so() -> None:
    """A tow that is stopped by the wall at 25 s: the fit takes 25 s, and its notes name run and time."""
    hull = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0)
    t = np.arange(0, 40, 0.1)
    motion = simulate_full(hull, Tow(1.28, 0.91, 1.649, 3.96, line="surge"), Start(alpha_rad=0.15), t)
    motion = motion.drop(columns="tension_n")
    motion["status"] = "measured"
    rng = np.random.default_rng(0)
    motion["y_cg_m"] += rng.normal(0, 1e-3, len(t))
    motion["beta_rad"] += rng.normal(0, 1e-3, len(t))
    motion.loc[250:, "y_cg_m"] = 0.9
    data = run_data(run_of(), motion, None)
    assert data.t_s[-1] == pytest.approx(24.9)
    result = identify_batch(Batch([RunMotion(run_of(), motion, None, None, None)], {}), noise="output").result
    assert any("run 'r': the model touches the starboard wall at 25.00 s" in note for note in result.notes)
    with pytest.raises(InputError, match="measured samples; at least 20"):
        run_data(run_of(), motion_of(t, np.where(t > 1.1, 0.95, 0.0)), None)


def derivative(value: float, std: float) -> Derivative:
    """In its own unit."""
    return Derivative(value=value, std=std, unit="", prime=0.0, prime_std=0.0)


def test_added_mass_and_inertia_stand_alone_with_a_weighed_and_swung_model() -> None:
    """Y_vdot = m - m', N_rdot = I - I'; variances add; I = K^2 m with both errors (8.9b)."""
    six = {"m_minus_y_vdot": derivative(149.2, 0.3), "i_minus_n_rdot": derivative(62.1, 0.06)}
    plain = ModelTable(length_pp_m=2.66, mass_kg=78.0)
    assert added_masses(plain, six) == (None, None)
    weighed = ModelTable(length_pp_m=2.66, mass_kg=78.0, dry_mass_kg=77.5, dry_mass_sd_kg=0.4, yaw_inertia_kg_m2=35.0)
    y_vdot, n_rdot = added_masses(weighed, six)
    assert y_vdot is not None
    assert n_rdot is not None
    assert (y_vdot.value, y_vdot.std) == pytest.approx((-71.7, 0.5))
    assert (n_rdot.value, n_rdot.std) == pytest.approx((-27.1, 0.06))
    ballast = ModelTable(
        length_pp_m=2.5,
        mass_kg=95.76,
        dry_mass_kg=95.76,
        dry_mass_sd_kg=0.1,
        gyration_k2_m2=0.288,
        gyration_k2_sd_m2=0.01,
    )
    _, n_rdot = added_masses(ballast, six)
    assert n_rdot is not None
    assert n_rdot.value == pytest.approx(0.288 * 95.76 - 62.1)
    assert n_rdot.std == pytest.approx(np.sqrt(0.06**2 + (0.01 * 95.76) ** 2 + (0.288 * 0.1) ** 2))
    assert added_masses(weighed, {}) == (None, None)  # the runs do not fix them
    with pytest.raises(ValueError, match="both given; one of them is expected"):
        ModelTable(length_pp_m=2.5, mass_kg=95.76, yaw_inertia_kg_m2=30.0, gyration_k2_m2=0.288)
