"""Export: MATLAB files read back, and the state-space model against the simulator's own equations and published eigenvalues."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

from towline.cli import main
from towline.pipeline.exporting import linear_model, state_space
from towline.record.errors import InputError, TowlineError
from towline.record.exports import read_state_space, to_control
from towline.record.results import DerivativesFile, RunFit, write_result
from towline.simulate import DERIVATIVE_UNITS, Hull, Start, Tow, linear_system, simulate_linear

SIX = {
    "m_minus_y_vdot": 149.19,
    "i_minus_n_rdot": 62.11,
    "y_v": -52.87,
    "y_r_minus_mu": -66.33,
    "n_v": -48.51,
    "n_r": -57.60,
}
"""ITTC MARINER (thesis table 8.2)."""
SPEED, LINE, TENSION = 1.28, 0.91, 3.96
PAIRS = {1.446: (0.0050, 0.3340), 1.548: (0.0035, 0.3493), 1.649: (0.0006, 0.3643), 1.751: (-0.0035, 0.3792)}
"""Oscillatory pair of a tow of this hull per tow point, 1/s, as published with four decimals (theory.md 3)."""
PRINTED = 6e-5
"""Half of the last printed digit, and a little for the derivatives' own rounding."""
STD = 0.01


@pytest.fixture
def derivatives(derivatives_of: Callable[..., DerivativesFile]) -> DerivativesFile:
    correlation = np.eye(6)
    correlation[2, 3] = correlation[3, 2] = 0.5
    values = np.array(list(SIX.values()))
    return derivatives_of(values, STD * np.abs(values), correlation=correlation, form="linear")


RUN = """
name = "{name}"
kind = "tow"
[source]
motion = "motion.csv"
[tow]
speed_m_s = {speed}
line_length_m = 0.91
tow_point_m = {tow_point}
tow_point_offset_m = {offset}
{tension}
[model]
length_pp_m = 2.66
mass_kg = 78.0
[water]
"""


def run_folder(
    folder: Path,
    tow_point: float = 1.548,
    name: str = "mariner-8",
    speed: float = SPEED,
    offset: float = 0.0,
    tension: str = "tension_n = 3.96",
) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.toml").write_text(
        RUN.format(name=name, tow_point=tow_point, speed=speed, offset=offset, tension=tension)
    )
    (folder / "motion.csv").write_text(
        "t_s,y_cg_m,beta_rad,alpha_rad,status\n0,0.1,0.01,0.2,measured\n0.1,,,,lost\n0.2,0.3,0.03,0.4,measured\n"
    )
    return folder


def hull() -> Hull:
    return Hull(**SIX, speed_m_s=SPEED)


@pytest.mark.parametrize("tow_point", PAIRS)
def test_the_exported_matrix_has_the_published_eigenvalues(
    tmp_path: Path, derivatives: DerivativesFile, tow_point: float
) -> None:
    run = run_folder(tmp_path / "run", tow_point)
    write_result(run / "out" / "derivatives.json", derivatives)
    assert main(["export", str(run / "out" / "derivatives.json"), "--state-space", str(tmp_path / "model.json")]) == 0
    model = read_state_space(tmp_path / "model.json")
    roots = np.linalg.eigvals(np.array(model.a))
    pair = roots[np.argmax(roots.imag)]
    assert pair.real == pytest.approx(PAIRS[tow_point][0], abs=PRINTED)
    assert pair.imag == pytest.approx(PAIRS[tow_point][1], abs=PRINTED)
    said = sorted((complex(p.real.value, p.imag.value) for p in model.poles), key=lambda p: (p.real, p.imag))
    assert np.allclose(said, sorted(roots, key=lambda p: (p.real, p.imag)), atol=1e-12)


def test_the_matrices_are_the_simulators_own(tmp_path: Path, derivatives: DerivativesFile) -> None:
    """A, constant: linear_system at the run's speed (damping scales with U); both files hold full precision."""
    run = run_folder(tmp_path / "run", 1.649, speed=0.86, offset=0.02)
    write_result(tmp_path / "d.json", derivatives)
    model = state_space(tmp_path / "d.json", run)
    tow = Tow(0.86, LINE, 1.649, TENSION, tow_point_offset_m=0.02)
    a, constant = linear_system(hull().at_speed(0.86), tow)
    assert np.array_equal(model.a, a)
    assert np.array_equal(model.constant, constant)
    assert any("off the centre line" in note for note in model.notes)


def test_inputs_and_outputs_move_the_model_as_the_simulator_does() -> None:
    """The post's column and alpha against simulate_linear with an oscillating post; a steady side force by statics."""
    tow = Tow(
        SPEED,
        LINE,
        1.751,
        TENSION,
        tow_point_offset_m=0.03,
        post_amplitude_m=0.05,
        post_frequency_hz=0.07,
        post_phase_rad=0.4,
    )
    model = linear_model(hull(), tow)
    t_s = np.linspace(0.0, 20.0, 2001)
    truth = simulate_linear(hull(), tow, Start(beta_rad=0.05, y_cg_m=0.1, v_m_s=0.01, r_rad_s=0.002), t_s)
    post, _ = tow.post_motion(t_s)
    states = truth[["y_cg_m", "beta_rad", "v_m_s", "r_rad_s"]].to_numpy()
    inputs = np.zeros((len(t_s), 3))
    inputs[:, 2] = post
    rates = states @ model.a.T + inputs @ model.b.T + model.constant
    measured = (states[2:] - states[:-2]) / (t_s[2:] - t_s[:-2])[:, None]
    # central difference at 0.01 s: h^2/6 times a third derivative of at most 0.1/s^3
    assert np.abs(measured - rates[1:-1]).max() < 1e-5
    outputs = states @ model.c.T + inputs @ model.d.T + model.output_constant
    assert np.abs(outputs - truth[["y_cg_m", "beta_rad", "alpha_rad"]].to_numpy()).max() < 1e-12
    # 2 N aside and 3 N m: at rest the line's force balances both, and beta follows from v = -U beta
    at_rest = -np.linalg.solve(model.a, model.b @ np.array([2.0, 3.0, 0.0]))
    y, beta, v, r = at_rest
    s = y / LINE + (1 + tow.tow_point_m / LINE) * beta
    assert r == pytest.approx(0.0, abs=1e-12)
    assert v == pytest.approx(-SPEED * beta, abs=1e-12)
    assert SIX["y_v"] * v - TENSION * s == pytest.approx(-2.0, abs=1e-9)
    assert SIX["n_v"] * v - TENSION * tow.tow_point_m * s == pytest.approx(-3.0, abs=1e-9)


def test_standard_deviations_follow_from_the_covariance(tmp_path: Path, derivatives: DerivativesFile) -> None:
    """Y_v/m' by the formula of a ratio; the poles by drawing derivatives: 4,000 draws give a sd to 1.1 %, tested to 5 %."""
    run = run_folder(tmp_path / "run", 1.548)
    write_result(tmp_path / "d.json", derivatives)
    model = state_space(tmp_path / "d.json", run)
    ratio = SIX["y_v"] / SIX["m_minus_y_vdot"]
    assert model.a[2][2] == pytest.approx(ratio, rel=1e-12)
    assert model.a_std[2][2] == pytest.approx(abs(ratio) * STD * np.sqrt(2), rel=1e-6)
    assert model.a_std[0] == [0.0] * 4
    values = np.array(list(SIX.values()))
    sd = STD * np.abs(values)
    covariance = np.array(derivatives.correlation) * np.outer(sd, sd)
    draws = np.random.default_rng(0).multivariate_normal(values, covariance, 4000)
    tow = Tow(SPEED, LINE, 1.548, TENSION)
    roots = np.array([_pair(linear_system(Hull(*draw, speed_m_s=SPEED), tow)[0]) for draw in draws])
    pole = max(model.poles, key=lambda p: p.imag.value)
    assert pole.real.std == pytest.approx(roots.real.std(), rel=0.05)
    assert pole.imag.std == pytest.approx(roots.imag.std(), rel=0.05)


def _pair(matrix: np.ndarray) -> complex:
    roots = np.linalg.eigvals(matrix)
    return complex(roots[np.argmax(roots.imag)])


def test_python_control_takes_the_model(tmp_path: Path, derivatives: DerivativesFile) -> None:
    control = pytest.importorskip("control", reason="python-control is not installed (pip install towline[control])")
    run = run_folder(tmp_path / "run", 1.751, name="mariner 1.5")
    write_result(tmp_path / "d.json", derivatives)
    write_result(tmp_path / "m.json", state_space(tmp_path / "d.json", run))
    system = to_control(tmp_path / "m.json")
    assert system.state_labels == ["y_m", "beta_rad", "v_m_s", "r_rad_s"]
    assert system.input_labels == ["side_force_n", "yaw_moment_n_m", "post_y_m"]
    assert system.output_labels == ["y_cg_m", "beta_rad", "alpha_rad"]
    assert system.isctime()
    # initial response against the exact propagation
    t_s = np.linspace(0.0, 10.0, 101)
    start = Start(beta_rad=0.05, y_cg_m=0.1, v_m_s=0.01, r_rad_s=0.002)
    truth = simulate_linear(hull(), Tow(SPEED, LINE, 1.751, TENSION), start, t_s)
    response = control.initial_response(system, t_s, [0.1, 0.05, 0.01, 0.002])
    assert np.abs(response.outputs.squeeze() - truth[["y_cg_m", "beta_rad", "alpha_rad"]].to_numpy().T).max() < 1e-9


def test_without_a_run_or_a_tension_one_sentence_says_what_is_needed(
    tmp_path: Path, derivatives: DerivativesFile, capsys: pytest.CaptureFixture[str]
) -> None:
    write_result(tmp_path / "a" / "b" / "derivatives.json", derivatives)
    with pytest.raises(InputError, match="--run RUN"):
        state_space(tmp_path / "a" / "b" / "derivatives.json")
    run = run_folder(tmp_path / "bare", tension="")
    with pytest.raises(InputError, match=r"tow.tension_n: missing key"):
        state_space(tmp_path / "a" / "b" / "derivatives.json", run)
    assert main(["export", str(tmp_path / "none.json"), "--state-space", str(tmp_path / "m.json")]) == 1
    assert "none.json: no such file" in capsys.readouterr().err
    assert not (tmp_path / "m.json").exists()


def test_a_tension_history_gives_its_mean(tmp_path: Path, derivatives: DerivativesFile) -> None:
    run = run_folder(tmp_path / "run", tension='tension = "tension.csv"')
    (run / "tension.csv").write_text("t_s,tension_n\n0,3.0\n1,4.0\n2,5.0\n")
    write_result(tmp_path / "d.json", derivatives)
    model = state_space(tmp_path / "d.json", run)
    assert model.settings["tension_n"] == 4.0
    assert any("mean of tension.csv" in note for note in model.notes)


def test_matrices_that_do_not_fit_their_names_are_refused(tmp_path: Path, derivatives: DerivativesFile) -> None:
    write_result(tmp_path / "d.json", derivatives)
    write_result(tmp_path / "m.json", state_space(tmp_path / "d.json", run_folder(tmp_path / "run")))
    content = json.loads((tmp_path / "m.json").read_text())
    content["b"] = content["b"][:3]
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="b: is not 4 x 3"):
        read_state_space(tmp_path / "m.json")


# MATLAB ------------------------------------------------------------------------------------------------------------


def test_a_mat_file_holds_runs_and_derivatives_as_they_are(tmp_path: Path, derivatives: DerivativesFile) -> None:
    runs = [run_folder(tmp_path / name, x, name=name) for name, x in (("one", 1.446), ("two", 1.751))]
    write_result(tmp_path / "out" / "derivatives.json", derivatives)
    assert main(["export", *map(str, runs), "--mat", str(tmp_path / "all.mat")]) == 0
    content = loadmat(tmp_path / "all.mat", squeeze_me=True, struct_as_record=False)
    assert content["schema"] == "towline/mat"
    assert [run.name for run in content["runs"]] == ["one", "two"]
    assert [run.settings.tow_point_m for run in content["runs"]] == [1.446, 1.751]
    assert content["runs"][0].settings.post_x_m == 0.0
    motion = content["runs"][1].motion
    assert motion.t_s.tolist() == [0.0, 0.1, 0.2]
    assert np.array_equal(motion.y_cg_m, [0.1, np.nan, 0.3], equal_nan=True)
    assert motion.status_code.tolist() == [2.0, 0.0, 2.0]
    found = content["derivatives"]
    assert found.y_v_n_s_per_m == SIX["y_v"]
    assert found.std.n_r_n_m_s == pytest.approx(STD * 57.60, rel=1e-15)
    assert found.names.tolist() == list(SIX)
    assert found.units.tolist() == [DERIVATIVE_UNITS[name] for name in SIX]
    sd = STD * np.abs(list(SIX.values()))
    assert np.allclose(found.covariance, np.array(derivatives.correlation) * np.outer(sd, sd), rtol=1e-15, atol=0)


def test_a_mat_file_holds_the_tracks_of_a_filmed_run(tmp_path: Path, samples: Path) -> None:
    """A run made from tracks: every value of the table comes back bit for bit, lost points as NaN."""
    source = samples / "mariner" / "x1446"
    if not (source / "run.toml").is_file():
        pytest.skip("the sample videos are not in this checkout")
    times = np.arange(20) / 30
    rows = [
        {
            "frame": frame,
            "t_s": t,
            "marker": marker,
            "u_px": u + 0.1 * frame,
            "v_px": np.nan if frame == 5 else 200.0,
            "sigma_u_px": 0.02,
            "sigma_v_px": 0.03,
            "status": "lost" if frame == 5 else "measured",
        }
        for frame, t in enumerate(times)
        for marker, u in _first_places(source).items()
    ]
    run = tmp_path / "run"
    run.mkdir()
    text = (source / "run.toml").read_text(encoding="utf-8")
    (run / "run.toml").write_text(text.replace('video = "video.mp4"', 'tracks = "tracks.csv"'), encoding="utf-8")
    for extra in source.glob("*.csv"):
        shutil.copy(extra, run)
    table = pd.DataFrame(rows)
    table.to_csv(run / "tracks.csv", index=False)
    assert main(["export", str(run), "--mat", str(tmp_path / "run.mat")]) == 0
    content = loadmat(tmp_path / "run.mat", squeeze_me=True, struct_as_record=False)
    tracks = {one.marker: one for one in content["runs"].tracks}
    for marker, part in table.groupby("marker"):
        assert np.array_equal(tracks[marker].u_px, part["u_px"].to_numpy())
        assert np.array_equal(tracks[marker].v_px, part["v_px"].to_numpy(), equal_nan=True)
        assert tracks[marker].status_code.tolist() == [0.0 if frame == 5 else 2.0 for frame in range(20)]
    assert len(content["runs"].motion.t_s) == 20
    assert "derivatives" not in content


def _first_places(source: Path) -> dict[str, float]:
    import tomllib

    file = tomllib.loads((source / "run.toml").read_text(encoding="utf-8"))
    return {marker["name"]: 300.0 + 80 * index for index, marker in enumerate(file["marker"])}


def test_no_usable_run_is_an_error_and_writes_nothing(tmp_path: Path) -> None:
    from towline.pipeline.exporting import export_mat

    with pytest.raises(TowlineError, match="no such run folder"):
        export_mat(tmp_path / "a.mat", [tmp_path / "none"])
    assert not (tmp_path / "a.mat").exists()


def test_the_fits_own_settings_are_mentioned(tmp_path: Path, derivatives: DerivativesFile) -> None:
    fit = RunFit(start={}, bias={}, nuisance={"tension_n": {"value": 4.0, "std": 0.1}}, noise={}, tests={}, samples=10)  # pyright: ignore[reportArgumentType]
    write_result(tmp_path / "d.json", derivatives.model_copy(update={"runs": {"mariner-8": fit}}))
    model = state_space(tmp_path / "d.json", run_folder(tmp_path / "run"))
    assert any("the fit moved tension_n" in note for note in model.notes)
    assert model.settings["tension_n"] == TENSION
