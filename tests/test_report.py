"""The page and the terminal tables: numbers, escaping, self-containment, gaps that no line bridges."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from towline.record.results import (
    CameraFile,
    DatumResidual,
    DerivativesFile,
    Measured,
    RunFit,
    SteadyFile,
    SteadyTow,
)
from towline.report import RunPage, derivatives_table, steady_table, write_page
from towline.report.format import (
    deviation,
    interval_text,
    percent,
    plus_minus,
    round_pair,
    significant,
)
from towline.report.html import Html, number, safe, tag
from towline.report.run_figures import motion_figure
from towline.report.run_section import frames_of
from towline.report.sections import points_of_action
from towline.report.series import (
    autocorrelation,
    lost_spans,
    measured_rows,
    pieces,
    residuals,
    with_gaps,
)
from towline.simulate import Hull, Start, Tow, simulate_full

HOSTILE = "<script>alert('\"$x_y$')</script>"
HULL = Hull(
    m_minus_y_vdot=150.0,
    i_minus_n_rdot=58.0,
    y_v=-60.0,
    y_r_minus_mu=-65.0,
    n_v=-54.0,
    n_r=-65.0,
    speed_m_s=1.28,
)
STDS = (0.57, 0.21, 0.21, 0.058, 0.19, 0.062)
LOST = slice(60, 80)


def _run(name: str, rng: np.random.Generator) -> RunPage:
    t_s = np.arange(300) / 10
    truth = simulate_full(HULL, Tow(1.28, 0.91, 1.55, 3.96), Start(alpha_rad=-0.1, beta_rad=0.06), t_s)
    fitted = truth[["t_s", "y_cg_m", "beta_rad"]].copy()
    fitted["y_cg_m"] += 0.003
    motion = fitted.assign(alpha_rad=truth["alpha_rad"])
    motion["y_cg_m"] += rng.normal(0, 0.001, 300)
    motion["beta_rad"] += rng.normal(0, 0.002, 300)
    motion["sigma_y_cg_m"], motion["sigma_beta_rad"], motion["sigma_alpha_rad"] = 0.001, 0.002, 0.002
    motion["status"] = "measured"
    motion.loc[LOST.start : LOST.stop - 1, "status"] = "lost"
    motion.loc[LOST.start : LOST.stop - 1, ["y_cg_m", "beta_rad", "alpha_rad"]] = np.nan
    tracks = pd.DataFrame(
        {
            "frame": np.repeat(np.arange(300), 2),
            "t_s": np.repeat(t_s, 2),
            "marker": np.tile(["bow", HOSTILE], 300),
            "u_px": rng.normal(600, 1, 600),
            "v_px": rng.normal(300, 1, 600),
            "sigma_u_px": 0.3,
            "sigma_v_px": 0.3,
            "status": np.tile(["measured", "predicted"], 300),
        }
    )
    camera = CameraFile(
        tool="0",
        inputs={},
        method="pose",
        homographies={},
        rms_px=0.341,
        datum=[DatumResidual(name="far & port", residual_px=(1.5, -0.2), sigma_px=0.3)],
        uncertainty_mm={"x_largest": 1.23},
        invariants={"taut line": Measured(value=-0.0012, std=0.0021)},
        notes=["square pixels <assumed>"],
    )
    picture = np.full((90, 160, 3), 128, np.uint8)
    return RunPage(name, picture, tracks, motion, fitted, truth, camera)


def _derivatives(names: list[str], derivatives_of: Callable[..., DerivativesFile]) -> DerivativesFile:
    fit = RunFit(
        start={"y_m": Measured(value=-0.1742, std=0.0003), "r_rad_s": Measured(value=np.radians(0.5), std=0.001)},
        bias={"y_b_m": Measured(value=0.0031, std=0.00012)},
        nuisance={},
        noise={"y_m": 0.00101, "beta_rad": 0.00201, "chi2_per_dof": 1.02},
        tests={"ljung_box_p_y": 0.43},
        samples=280,
    )
    file = derivatives_of(
        HULL.six + 2 * np.array(STDS),
        np.array(STDS),
        tool="0",
        straight_line_stable=True,
        runs=dict.fromkeys(names, fit),
        failed={"short one": "only 3 s of <motion>"},
        not_identifiable=["a common factor of T"],
    )
    true = dict(zip(file.derivatives, HULL.six, strict=True))
    told = {key: d.model_copy(update={"true_value": float(true[key])}) for key, d in file.derivatives.items()}
    return file.model_copy(update={"derivatives": told})


def _steady(names: list[str]) -> SteadyFile:
    tows = {
        name: SteadyTow(
            tow_point_m=1.45 + 0.2 * k,
            alpha_rad=Measured(value=0.08, std=0.0007),
            beta_rad=Measured(value=-0.05, std=0.0006),
            force=Measured(value=0.2 - 0.05 * k, std=0.002),
            span_s=(20.0, 30.0),
            settled=k == 0,
        )
        for k, name in enumerate(names)
    }
    return SteadyFile(
        tool="0",
        inputs={},
        force_unit="F/R",
        x_v_m=Measured(value=0.9254, std=0.0111),
        x_v_interval_m=(0.9032, 0.9476),
        slope=Measured(value=0.1187, std=0.0021),
        chi2_per_dof=None,
        pairs={" and ".join(names): Measured(value=0.93, std=0.02)},
        y_v=None,
        y_delta_delta=None,
        n_delta_delta=None,
        x_v_true_m=0.9,
        tows=tows,
        failed={},
        notes=[],
    )


@pytest.fixture(scope="module")
def inputs(derivatives_of: Callable[..., DerivativesFile]):
    rng = np.random.default_rng(7)
    runs = [_run(HOSTILE, rng), _run("second", rng)]
    nothing = pd.DataFrame({"t_s": [], "y_cg_m": [], "beta_rad": [], "alpha_rad": []})
    runs.append(RunPage("third", None, None, nothing, None, None, None, problem="no frame could be read"))
    names = [run.name for run in runs[:2]]
    return runs, _derivatives(names, derivatives_of), _steady(names)


@pytest.fixture(scope="module")
def page(inputs, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_page(path, "Tank <1> & tests", *inputs, ["a note with </main>"])
    return path.read_text(encoding="utf-8")


def test_page_contains_the_numbers(page):
    # -60 + 2 x 0.21 and so on: value and std to two digits of the std, truth to the same decimal
    for text in ("−59.58 ± 0.21", "151.14 ± 0.57", "−64.884 ± 0.058", "−65.000", "+2.0", "0.925 ± 0.011"):
        assert text in page
    assert "0.903 to 0.948" in page
    assert "straight-line stable</strong>" in page
    assert "3.10 ± 0.12" in page  # datum bias in mm
    assert "0.500 ± 0.057" in page  # yaw rate in deg/s
    assert "no frame could be read" in page
    assert "only 3 s of &lt;motion&gt;" in page
    assert "no, still drifting" in page
    assert "F/R" in page  # the tension was not measured
    assert "600 frames over 59.8 s: 93.3 % measured, 6.7 % lost" in page
    assert "<strong>5.0</strong>" in page  # datum point beyond 3 sigma: hypot(1.5, 0.2)/0.3
    assert "−1.2" in page


def test_user_strings_are_escaped(page):
    assert "<script" not in page
    assert "&lt;script&gt;alert(&#x27;&quot;$x_y$&#x27;)&lt;/script&gt;" in page
    assert "<title>Tank &lt;1&gt; &amp; tests</title>" in page
    assert "a note with &lt;/main&gt;" in page
    assert "far &amp; port" in page
    assert "square pixels &lt;assumed&gt;" in page


def test_page_is_well_formed_and_asks_nothing_of_the_outside(page, self_contained):
    assert len(self_contained(page)) == 1 + 2 * 6  # the line, six pictures a run


def test_pictures_are_the_same_for_the_same_data(inputs):
    motion = inputs[0][1].motion
    assert motion_figure(motion, None, None) == motion_figure(motion, None, None)


@pytest.mark.slow
def test_poor_runs_still_give_a_page(inputs, tmp_path):
    run = inputs[0][1]
    bare = run.motion[["t_s", "y_cg_m", "beta_rad"]]
    poor = [
        replace(run, picture=None, tracks=None, truth=None, camera=None, motion=bare),
        replace(run, motion=bare.iloc[:1], fitted=None, tracks=run.tracks.iloc[:1]),
        replace(run, motion=bare.assign(y_cg_m=np.nan)),
        replace(run, tracks=run.tracks.assign(status="lost", u_px=np.nan)),
        replace(run, fitted=run.fitted.iloc[:1]),
    ]
    write_page(tmp_path / "poor.html", "poor", poor, None, None, [])
    text = (tmp_path / "poor.html").read_text(encoding="utf-8")
    assert "no noise was stated" in text
    assert "nan" not in re.sub(r'base64,[^"]*', "", text).lower()


def test_lost_spans_are_not_bridged(inputs):
    motion = inputs[0][1].motion
    t_s, y = motion["t_s"].to_numpy(), motion["y_cg_m"].to_numpy()
    good = measured_rows(motion)
    assert pieces(t_s, good) == [slice(0, LOST.start), slice(LOST.stop, 300)]
    t, x = with_gaps(t_s, y, good)
    assert np.isnan(x).sum() == 1
    assert np.isnan(x[LOST.start])
    assert len(t) == 300 - 20 + 1
    # a "lost" row that still carries a number is not drawn either, nor is a hole of missing rows bridged
    t, x = with_gaps(t_s, np.zeros(300), good)
    assert np.isnan(x[LOST.start])
    assert pieces(np.array([0.0, 1, 2, 6, 7]), np.ones(5, dtype=bool)) == [slice(0, 3), slice(3, 5)]
    assert with_gaps(t_s, np.full(300, np.nan))[0].size == 0


def test_lost_spans_reach_half_a_step_beyond_the_lost_samples():
    t_s = np.array([0.0, 1, 2, 3, 4, 9, 10])
    good = np.array([True, True, False, False, True, True, True])
    assert lost_spans(t_s, good) == [(1.5, 3.5), (4.5, 8.5)]
    assert lost_spans(t_s[:2], good[:2]) == []


def test_frames_count_missing_rows_as_lost(inputs):
    run = inputs[0][1]
    frames = frames_of(run)
    assert (frames.measured, frames.predicted, frames.lost) == (280, 0, 20)
    holed = frames_of(replace(run, motion=run.motion.drop(index=range(100, 130))))
    assert (holed.measured, holed.lost, holed.total) == (250, 50, 300)


def test_residuals_pair_equal_times(inputs):
    run = inputs[0][1]
    rest = residuals(run.motion, run.fitted.iloc[::2])
    assert rest is not None
    assert rest.samples == 140
    assert rest.stated
    expected = (run.motion["y_cg_m"] - run.fitted["y_cg_m"]).to_numpy()[::2]
    np.testing.assert_array_equal(rest.y_m[::2], expected)
    assert np.isnan(rest.y_m[1::2]).all()


def test_autocorrelation_of_known_series():
    t_s = np.arange(4000) / 20
    white = np.random.default_rng(3).normal(size=4000)
    rho, bound = autocorrelation(t_s, white, 40)
    assert rho[0] == pytest.approx(1)
    assert bound == pytest.approx(1.96 / np.sqrt(4000))
    assert np.mean(np.abs(rho[1:]) > bound) < 0.2
    # a wave of period 20 samples with a third of it lost: cos(2 pi k/20) all the same
    wave = np.sin(2 * np.pi * np.arange(4000) / 20)
    wave[1000:2300] = np.nan
    rho, _ = autocorrelation(t_s, wave, 40)
    np.testing.assert_allclose(rho, np.cos(2 * np.pi * np.arange(41) / 20), atol=1e-2)
    assert np.isnan(autocorrelation(t_s[:1], white[:1], 3)[0]).all()


@pytest.mark.parametrize(
    ("value", "std", "texts"),
    [
        (-51.2345, 0.4567, ("-51.23", "0.46")),
        (1.0, 0.0996, ("1.00", "0.10")),  # rounding carries into the next power
        (1.0, 0.996, ("1.0", "1.0")),
        (1234.0, 123.0, ("1230", "120")),
        (-0.001, 0.12, ("0.00", "0.12")),  # no minus zero
        (3.0, 120.0, ("0", "120")),
        (2.0, 0.0, ("2.000", "0")),
        (1.23456e-9, 4.5e-11, ("1.235e-09", "4.5e-11")),
        (float("nan"), 1.0, ("-", "-")),
        (2.0, float("inf"), ("2.000", "-")),
    ],
)
def test_rounding(value, std, texts):
    assert round_pair(value, std) == texts


def test_small_formats():
    assert percent(-60.0, 0.21) == "0.35"
    assert percent(0.0, 1.0) == "-"
    assert percent(1.0, 25.0) == "2500"
    assert deviation(-59.5, 0.25, -60.0) == "+2.0"
    assert deviation(1.0, 0.1, None) == "-"
    assert significant(0.000123456) == "0.000123"
    assert significant(0) == "0"
    assert plus_minus(1.234, 0.1, "m") == "1.23 +- 0.10 m"
    assert interval_text(0.9032, 0.9476) == "0.903 to 0.948"
    assert number("-1.2 +- 0.3") == "−1.2 ± 0.3"
    assert number("1.2e-09") == "1.2·10<sup>−9</sup>"
    assert number("0.9 to -0.4") == "0.9 to −0.4"
    assert number("-") == "–"


def test_html_escapes_by_default():
    assert safe("<a&'\">") == "&lt;a&amp;&#x27;&quot;&gt;"
    assert tag("b", Html("<i>"), "<i>", title='"') == '<b title="&quot;"><i>&lt;i&gt;</b>'


def test_points_of_action_of_the_known_hull(inputs):
    # X_v = N_v/Y_v; its std without correlation: X_v sqrt((s_N/N)^2 + (s_Y/Y)^2)
    points = points_of_action(inputs[1])
    assert points is not None
    (x_v, spread), (x_r, other), apart = points
    y, n = -60 + 2 * 0.21, -54 + 2 * 0.19
    assert x_v == pytest.approx(n / y)
    assert spread == pytest.approx(abs(n / y) * np.hypot(0.19 / n, 0.21 / y))
    assert x_r == pytest.approx((-65 + 2 * 0.062) / (-65 + 2 * 0.058))
    assert apart == pytest.approx(np.hypot(spread, other))


def test_terminal_tables_round_as_the_page_does(inputs):
    from rich.console import Console

    console = Console(width=140, record=True, file=io.StringIO())
    console.print(derivatives_table(inputs[1]))
    console.print(steady_table(inputs[2]))
    text = console.export_text()
    for cell in ("m - Y_vdot", "-59.58", "0.21", "+2.0", "prime x1e3", "0.925", "0.903 to 0.948", HOSTILE):
        assert cell in text


def test_importing_the_room_leaves_matplotlib_out():
    code = "import sys, towline.report; sys.exit('matplotlib' in sys.modules or 'rich' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
