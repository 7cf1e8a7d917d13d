"""Free runs (a model under its rudder) through the commands: simulated zigzags and random rudders against their truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.identify import fit_free, free_data
from towline.record import DerivativesFile, read_motion, read_result, read_run
from towline.simulate import Histories, Hull, Start, Tow, simulate_full

HULL = Hull(249.6448, 93.9161, -97.17078, -42.7710, -92.5523, -94.0412, speed_m_s=1.30, y_delta=-18.0, n_delta=25.5)
"""Table 3.1's hull (straight-line stable) with a rudder at -1.417 m."""
MARINER = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, y_delta=-10.0, n_delta=12.0)
SIGMA = np.array([1e-3, np.radians(0.1)])
DELAY_S = 3.0
"""The rudder's clock is behind the camera's."""
TOLD = {
    "y_v_over_mass": HULL.y_v / HULL.m_minus_y_vdot,
    "y_r_minus_mu_over_mass": HULL.y_r_minus_mu / HULL.m_minus_y_vdot,
    "n_v_over_inertia": HULL.n_v / HULL.i_minus_n_rdot,
    "n_r_over_inertia": HULL.n_r / HULL.i_minus_n_rdot,
    "y_delta_over_mass": HULL.y_delta / HULL.m_minus_y_vdot,
    "n_delta_over_inertia": HULL.n_delta / HULL.i_minus_n_rdot,
}
Program = tuple[np.ndarray, np.ndarray]


def program(sides: list[float], stays_s: list[float], over_rad: float = 0.17) -> Program:
    """Rudder history: over to each side in turn at 0.2 rad/s, from 1 s on."""
    times, angles, here, before = [0.0, 1.0], [0.0, 0.0], 1.0, 0.0
    for side, stay in zip(sides, stays_s, strict=True):
        angle = side * over_rad
        if angle != before:
            times.append(here + abs(angle - before) / 0.2)
            angles.append(angle)
        here += stay
        times.append(here)
        angles.append(angle)
        before = angle
    return np.array([*times, 200.0]), np.array([*angles, before])


ZIGZAG = program([1, -1] * 4, [6.0] * 8)
RANDOM = program([1, -1, 1, -1, 1, -1, 1, -1, 1], [2, 4, 6, 2, 2, 8, 4, 6, 6])


def seen(history: Program, hull: Hull = HULL, length_s: float = 40.0, rate_hz: float = 5.0) -> pd.DataFrame:
    t_s = np.arange(0, length_s, 1 / rate_hz)
    motion = simulate_full(
        hull,
        Tow(hull.speed_m_s, 1.0, 0.0, None, resistance_n=0.0),
        Start(y_cg_m=0.1, beta_rad=0.01),
        t_s,
        free=True,
        histories=Histories(rudder_rad=lambda t: float(np.interp(t, *history))),
    )
    return motion[["t_s", "y_cg_m", "beta_rad"]]


def write(
    folder: Path,
    motion: pd.DataFrame,
    history: Program | None,
    tow: str = "speed_m_s = 1.3",
    more: str = "",
    model: str = "",
) -> Path:
    """A free run's folder; the rudder's own clock is ``DELAY_S`` behind."""
    folder.mkdir(parents=True, exist_ok=True)
    motion.to_csv(folder / "motion.csv", index=False)
    if history is not None:
        pd.DataFrame({"t_s": history[0] - DELAY_S, "rudder_rad": history[1]}).to_csv(folder / "rudder.csv", index=False)
        tow += f'\nrudder = "rudder.csv"\nrudder_delay_s = {DELAY_S}'
    (folder / "run.toml").write_text(
        f'name = "{folder.name}"\nkind = "free"\n[source]\nmotion = "motion.csv"\n[tow]\n{tow}\n'
        f"[model]\nlength_pp_m = 2.66\nmass_kg = 140.0\n{model}\n{more}"
    )
    return folder


def noisy(motion: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    values = motion[["y_cg_m", "beta_rad"]].to_numpy() + SIGMA * rng.normal(size=(len(motion), 2))
    return motion.assign(y_cg_m=values[:, 0], beta_rad=values[:, 1])


@pytest.fixture(scope="module")
def clean() -> dict[str, tuple[pd.DataFrame, Program]]:
    return {"zigzag": (seen(ZIGZAG), ZIGZAG), "random": (seen(RANDOM), RANDOM)}


@pytest.mark.slow
def test_identify_gives_the_ratios_within_their_intervals(tmp_path: Path, clean, capsys) -> None:
    """20 campaigns of two runs: z of the six ratios has rms 0.8-1.25, K's too; no run.toml says anything of forces or water."""
    scores, gains = [], []
    low = TOLD["y_v_over_mass"] * TOLD["n_r_over_inertia"] - TOLD["n_v_over_inertia"] * TOLD["y_r_minus_mu_over_mass"]
    gain = TOLD["y_delta_over_mass"] * TOLD["n_v_over_inertia"] - TOLD["n_delta_over_inertia"] * TOLD["y_v_over_mass"]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        folders = [str(write(tmp_path / name, noisy(m, rng), h)) for name, (m, h) in clean.items()]
        assert main(["identify", *folders, "--no-page"]) == 0
        found = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
        assert list(found.derivatives) == list(TOLD)
        scores.append([(d.value - TOLD[name]) / d.std for name, d in found.derivatives.items()])
        assert found.free is not None
        k = found.free.nomoto["gain_1_s"]
        gains.append((k.value - gain / low) / k.std)
    z = np.array(scores)
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.25
    assert 1 - 4 * 0.16 < np.sqrt(np.mean(np.square(gains))) < 1 + 4 * 0.16  # 20 numbers: 1 +- 0.16
    assert (np.sqrt(np.mean(z**2, axis=0)) < 1 + 4 * 0.16).all()
    assert found.method == "free_run"
    assert found.straight_line_stable
    assert (found.density_kg_m3, found.line, found.tension) == (None, None, None)
    assert any("scale of forces" in line for line in found.not_identifiable)
    assert found.derivatives["y_v_over_mass"].prime == pytest.approx(
        found.derivatives["y_v_over_mass"].value * 2.66 / 1.3
    )
    assert "Y_v/(m - Y_vdot)" in capsys.readouterr().out


@pytest.mark.slow
def test_page_json_and_masses_that_are_stated(tmp_path: Path, clean, capsys: pytest.CaptureFixture[str]) -> None:
    """m' and I' under [priors.derivatives] (here to 1 %) give the rest in newtons, with their error."""
    rng = np.random.default_rng(1)
    said = (
        "[water]\n[priors.derivatives]\nm_minus_y_vdot = { value = 249.6448, std = 2.5 }\n"
        "i_minus_n_rdot = { value = 93.9161, std = 0.94 }\n"
    )
    folders = [str(write(tmp_path / name, noisy(m, rng), h, more=said)) for name, (m, h) in clean.items()]
    assert main(["identify", *folders, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["result"]["derivatives"]
    assert answer["free"]["scale"] == "masses"
    for name in ("y_v", "y_r_minus_mu", "n_v", "n_r", "y_delta", "n_delta"):
        one = answer["derivatives"][name]
        assert abs(one["value"] - getattr(HULL, name)) < 3.5 * one["std"]
        assert one["std"] > 0.0099 * abs(one["value"])
    page = (tmp_path / "out" / "derivatives.html").read_text(encoding="utf-8")
    for words in ("Nomoto", "of the free model", "priors.derivatives"):
        assert words in page
    assert (tmp_path / "out" / "derivatives_figures").is_dir()


def towed(folder: Path, x_t: float, y_0: float, rng: np.random.Generator, model: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    t_s = np.arange(0, 40, 0.1)
    motion = simulate_full(MARINER, Tow(1.28, 0.91, x_t, 3.96), Start(y_cg_m=y_0), t_s)[["t_s", "y_cg_m", "beta_rad"]]
    noisy(motion, rng).to_csv(folder / "motion.csv", index=False)
    (folder / "run.toml").write_text(
        f'name = "{folder.name}"\n[source]\nmotion = "motion.csv"\n[tow]\nspeed_m_s = 1.28\nline_length_m = 0.91\n'
        f'tow_point_m = {x_t}\ntension_n = 3.96\nline = "constant"\n'
        f"[model]\nlength_pp_m = 2.66\nmass_kg = 140.0\n{model}\n[water]\n"
    )
    return folder


@pytest.mark.slow
def test_with_tows_in_the_same_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each kind is fitted apart and that is said; the tows' six and covariance give the rudder in newtons."""
    rng = np.random.default_rng(2)
    folders = [
        towed(tmp_path / f"tow{k}", x, y, rng)
        for k, (x, y) in enumerate([(1.446, 0.2), (1.548, -0.22), (1.751, -0.24)])
    ]
    free = write(tmp_path / "zigzag", noisy(seen(ZIGZAG, MARINER), rng), ZIGZAG, "speed_m_s = 1.28")
    assert main(["run", *map(str, [*folders, free])]) == 0
    said = capsys.readouterr().out
    assert "the free runs (zigzag) were fitted apart, with the tows' derivatives and their covariance" in said
    tows = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
    found = read_result(tmp_path / "out" / "free_run.json", DerivativesFile)
    assert (tows.free, set(tows.runs), set(found.runs)) == (None, {"tow0", "tow1", "tow2"}, {"zigzag"})
    assert found.free is not None
    assert found.free.scale == "tows"
    for name in ("y_delta", "n_delta", "n_r"):
        one = found.derivatives[name]
        assert abs(one.value - getattr(MARINER, name)) < 4 * one.std
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Free runs" in page


@pytest.mark.parametrize(
    ("tow", "history", "length_s", "words"),
    [
        ("speed_m_s = 1.3", None, 40.0, "tow.rudder: missing key; nothing but its rudder moves a free model"),
        (
            "speed_m_s = 1.3\nrudder_rad = 0.1",
            None,
            40.0,
            "the rudder never moves (it stands at 5.73 degrees throughout)",
        ),
        (
            "speed_m_s = 1.3",
            (np.array([0.0, 100.0]), np.zeros(2)),
            40.0,
            "the rudder never moves (it stands at 0 degrees",
        ),
        ("speed_m_s = 1.3", ZIGZAG, 5.0, "too short: 4.8 s at 1.3 m/s are 2.3 ship lengths; at least 3 are needed"),
        ("speed_m_s = 0.0", ZIGZAG, 40.0, "a free run needs a speed above 0"),
        (
            "speed_m_s = 1.3",
            (ZIGZAG[0] + 20, ZIGZAG[1]),
            40.0,
            "40.00 s of the recording's clock; 0.00 .. 39.80 s is needed",
        ),
    ],
)
def test_what_cannot_be_used_is_said(
    tmp_path: Path, tow: str, history: Program | None, length_s: float, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write(tmp_path / "run", seen(ZIGZAG, length_s=length_s), history, tow)
    assert main(["identify", str(run)]) == 1
    said = capsys.readouterr().err
    assert words.split("40.00 s")[-1] in said


def test_run_without_a_rudder_gives_the_motion_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write(tmp_path / "run", seen(ZIGZAG), None)
    assert main(["run", str(run)]) == 0
    assert "no derivatives from run" in capsys.readouterr().err
    assert main(["identify", str(run), "--form", "linear"]) == 1
    assert "--form" in capsys.readouterr().err


@pytest.mark.slow
def test_gaps_a_speed_history_and_a_heading_error(tmp_path: Path) -> None:
    """A third of the samples lost, U grown by 5 % in the run, 0.5 degrees of heading error in one of two runs, with a prior."""
    rng = np.random.default_rng(6)
    t_s = np.arange(0, 40, 0.2)
    grown = np.array([0.0, 40.0]), np.array([1.27, 1.335])
    data = []
    for name, history, off in (("a", ZIGZAG, 0.0), ("b", RANDOM, np.radians(0.5))):
        histories = Histories(
            rudder_rad=lambda t, h=history: float(np.interp(t, *h)), speed_m_s=lambda t: float(np.interp(t, *grown))
        )
        tow = Tow(1.27, 1.0, 0.0, None, resistance_n=0.0)
        motion = simulate_full(HULL, tow, Start(y_cg_m=0.0), t_s, free=True, histories=histories)
        motion = noisy(motion[["t_s", "y_cg_m", "beta_rad"]], rng).assign(beta_rad=lambda m, o=off: m.beta_rad + o)
        kept = motion[rng.random(len(motion)) > 1 / 3]
        run = write(
            tmp_path / name,
            kept,
            history,
            'speed_m_s = 1.3\nspeed = "speed.csv"',
            "[priors]\nbeta_bias_sd_rad = 0.0087\n",
        )
        pd.DataFrame({"t_s": grown[0], "speed_m_s": grown[1]}).to_csv(run / "speed.csv", index=False)
        data.append(free_data(read_run(run), read_motion(run / "motion.csv")))
    fit = fit_free(data, 1.30)
    z = (fit.values - np.array(list(TOLD.values()))) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(z).max() < 3.5
    assert (np.sqrt(np.diag(fit.covariance)) / np.abs(fit.values)).max() < 0.15
    apart = fit.found.beta_bias[1] - fit.found.beta_bias[0]
    assert apart == pytest.approx(np.radians(0.5), abs=4 * np.hypot(*fit.found.beta_bias_sd))


@pytest.mark.slow
def test_camera_modes_are_carried(tmp_path: Path, clean) -> None:
    """A heading error of the camera, common to both runs, as a mode: found in Y* and N* or in the mode, never in the ratios."""
    data = []
    for name, (motion, history) in clean.items():
        run = write(tmp_path / name, noisy(motion, np.random.default_rng(9)), history)
        common = np.zeros((1, len(motion), 3))
        common[0, :, 0] = 0.002 * np.arange(len(motion)) / len(motion)
        data.append(free_data(read_run(run), read_motion(run / "motion.csv"), common))
    fit = fit_free(data)
    assert [len(sizes) for sizes in fit.found.modes.values()] == [1]
    plain = fit_free([free_data(read_run(tmp_path / n), read_motion(tmp_path / n / "motion.csv")) for n in clean])
    assert (np.diag(fit.covariance) >= 0.99 * np.diag(plain.covariance)).all()
    np.testing.assert_allclose(fit.values, plain.values, rtol=0.1)


@pytest.mark.slow
def test_a_campaign_fits_free_runs_too(tmp_path: Path, clean) -> None:
    for name, (motion, history) in clean.items():
        write(tmp_path / name, motion, history, model="trim_rad = 0.0075")
    assert main(["campaign", str(tmp_path), "--workers", "1"]) == 0
    table = pd.read_csv(tmp_path / "out" / "campaign.csv").set_index(["level", "name", "quantity"])["value"]
    assert table["fit", "free_run", "y_v_over_mass"] == pytest.approx(TOLD["y_v_over_mass"], rel=1e-3)
    assert table["run", "zigzag", "trim"] == 0.0075
    assert "trim by the stern" in (tmp_path / "out" / "campaign.html").read_text(encoding="utf-8")


# trim ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_trim_goes_with_the_run_and_unlike_trims_are_not_pooled(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(3)
    level = towed(tmp_path / "level", 1.446, 0.2, rng, "trim_rad = 0.0")
    near = towed(tmp_path / "near", 1.751, -0.2, rng, "trim_rad = 0.0003")
    stern = towed(tmp_path / "stern", 1.548, 0.2, rng, "trim_rad = 0.0175")
    silent = towed(tmp_path / "silent", 1.649, -0.2, rng)
    assert main(["identify", str(level), str(near), str(silent), "--no-page"]) == 0
    found = read_result(tmp_path / "out" / "derivatives.json", DerivativesFile)
    assert [run.trim_rad for run in found.runs.values()] == [0.0, 0.0003, None]
    assert any("silent is taken to float alike" in note for note in found.notes)
    capsys.readouterr()
    assert main(["identify", str(level), str(near), str(stern)]) == 1
    said = capsys.readouterr().err
    assert "trims differ by 1 degrees" in said
    assert "level: level, near; 1.00 degrees by the stern: stern" in said


def test_a_trim_in_degrees_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = towed(tmp_path / "run", 1.446, 0.2, np.random.default_rng(0), "trim_rad = 0.43")
    assert main(["identify", str(run)]) == 1
    assert (
        "model.trim_rad: 0.43 is outside -0.2 .. 0.2 rad (bow up is positive; is it in degrees?)"
        in capsys.readouterr().err
    )
