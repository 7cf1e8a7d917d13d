"""The fit's page: agreement of the runs, residuals and input, what it says; self-contained, escaped; the command that writes it."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from towline.cli import main
from towline.identify import derivatives_file, fit_runs, fit_with_noise
from towline.identify.consistency import consistency, judged
from towline.identify.reference import compare_to_reference, reference_set
from towline.pipeline.analysis import Batch, Identified, fit_page, identify_batch
from towline.pipeline.stages import RunMotion
from towline.record import DerivativesFile, Priors, Run, RunFile, read_result
from towline.record.schema import ModelTable, WaterTable
from towline.record.toml import check_tables
from towline.report.identify_page import identify_page
from towline.report.page import csv_text
from towline.report.series import cross_correlation

HOSTILE = "<script>alert('x')</script> & co"


def moved(
    campaigns: ModuleType, point: float, rng: np.random.Generator, folder: Path, name: str, keep: float
) -> RunMotion:
    """A run that came as motion; the first ``1 - keep`` of it cut off."""
    t = campaigns.times(16.0)
    made = campaigns.noisy(campaigns.still_run(point, t, "modal"), rng)
    table = pd.DataFrame(
        {
            "t_s": t,
            "y_cg_m": made.y_m,
            "beta_rad": made.beta_rad,
            "alpha_rad": np.nan,
            "sigma_y_cg_m": campaigns.SIGMA_Y_M,
            "sigma_beta_rad": campaigns.SIGMA_BETA_RAD,
            "status": "measured",
        }
    )
    content = {
        "name": name,
        "source": {"motion": "motion.csv"},
        "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": point, "tension_n": 3.96},
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {"density_kg_m3": 1000.0},
    }
    file = check_tables(content, RunFile, folder / "run.toml")
    table = table[table["t_s"] >= (1 - keep) * t[-1]].reset_index(drop=True)
    return RunMotion(Run(folder, file), table, None, None, None)


@pytest.fixture(scope="module")
def found(campaigns: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Identified:
    """Three runs, the last without its transient."""
    rng = np.random.default_rng(31)
    folder = tmp_path_factory.mktemp("page")
    names = (HOSTILE, "second", "third")
    points = campaigns.POINTS_M[::-1][:3]
    runs = [
        moved(campaigns, x, rng, folder, name, 0.6 if k == 2 else 1.0)
        for k, (x, name) in enumerate(zip(points, names, strict=True))
    ]
    return identify_batch(Batch(runs, {"bad one": "no <motion>"}), "linear", noise="output")


@pytest.fixture(scope="module")
def page(found: Identified) -> str:
    return identify_page(fit_page(found, compare_to_reference(found.result, reference_set("ittc"))))


@pytest.mark.slow
def test_page_is_self_contained_and_escaped(page: str, self_contained: Callable[[str], list[bytes]]) -> None:
    pictures = self_contained(page)
    assert "&lt;script&gt;alert(&#x27;x&#x27;)&lt;/script&gt; &amp; co" in page
    assert "no &lt;motion&gt;" in page
    # reference, agreement 2, Bode; per run motion, residuals, orbits, spectrum, whiteness, cross; one more where coloured
    assert 4 + 6 * 3 <= len(pictures) <= 4 + 7 * 3
    assert all(b"alert" not in svg for svg in pictures)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_no_column_is_cut_in_a_window_of_1280_px(page: str, tmp_path: Path) -> None:
    """Chromium's own widths: no table is wider than its place, nor the page than the window."""
    asked = (
        "<script>const cut = [...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1)"
        ".map(e => e.innerText.slice(0, 40)); document.title = 'cut ' + JSON.stringify(cut) + ' of ' + "
        "document.querySelectorAll('.scroll').length + ' in ' + document.documentElement.scrollWidth;</script></body>"
    )
    shown = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page).replace("</body>", asked)
    (tmp_path / "page.html").write_text(shown, encoding="utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,2000", "--dump-dom"]
    done = subprocess.run(
        [*command, (tmp_path / "page.html").as_uri()], check=False, capture_output=True, text=True, timeout=120
    )
    found = re.search(r"<title>cut (\[.*\]) of (\d+) in (\d+)</title>", done.stdout)
    assert found is not None, done.stderr[-500:]
    assert found[1] == "[]"
    assert int(found[2]) > 5
    assert int(found[3]) <= 1280


@pytest.mark.slow
def test_page_says_the_numbers(page: str, found: Identified) -> None:
    from towline.report.format import plus_minus

    for d in found.result.derivatives.values():
        assert plus_minus(d.value, d.std).replace(" +- ", " ± ").replace("-", "−") in page
    assert "Against a reference" in page
    assert "ITTC MARINER" in page
    assert "not fixed" in page  # the run without its transient does not determine all six alone
    assert "STD, %" in page
    assert "nan" not in re.sub(r'base64,[^"]*', "", page).lower()


@pytest.mark.slow
def test_the_agreement_of_runs_is_chi_square(campaigns: ModuleType) -> None:
    """12 campaigns of three runs: mean 12 within 4 standard errors; a run towed at 2 % more tension than said stands out."""
    t = campaigns.times(8.0)
    still = [campaigns.still_run(x, t, "modal", priors=Priors()) for x in campaigns.POINTS_M[::-1][:3]]
    squares, z = [], []
    for seed in range(12):
        runs = campaigns.campaign(still, np.random.default_rng([32, seed]))
        agreed = consistency(fit_runs(runs, "linear"), runs)
        assert agreed.degrees == 12
        squares.append(agreed.chi_square)
        z += [part.z for part in agreed.without]
    assert abs(np.mean(squares) - 12) < 4 * np.sqrt(24 / len(squares)), np.mean(squares)
    rms = np.sqrt(np.nanmean(np.square(z)))
    # 36 sets of six correlated z, each campaign counted as one
    assert abs(rms - 1) < 4 / np.sqrt(2 * 12), rms
    wrong = replace(still[1], tow=replace(still[1].tow, tension_n=0.98 * still[1].tow.tension_n))
    runs = campaigns.campaign([still[0], wrong, still[2]], np.random.default_rng(33))
    agreed = consistency(fit_runs(runs, "linear"), runs)
    assert agreed.p_value is not None
    assert agreed.p_value < 1e-6
    assert max(np.nanmax(np.abs(p.z)) for p in agreed.without) > 4


def test_one_run_and_one_that_cannot_be_fitted(campaigns: ModuleType) -> None:
    t = campaigns.times(8.0)
    runs = campaigns.campaign([campaigns.still_run(1.649, t, "modal")], np.random.default_rng(34))
    agreed = consistency(fit_runs(runs, "linear"), runs)
    assert agreed.without == ()
    assert agreed.chi_square is None
    assert np.isnan(agreed.mean).all()


def test_what_is_left_does_not_hang_on_the_force(campaigns: ModuleType) -> None:
    """Of white residuals 5 % of the stems lie beyond the band; a delayed answer to the force does not stay within it."""
    rng = np.random.default_rng(35)
    n, lags = 2000, np.arange(-20, 21)
    force = np.cumsum(rng.normal(size=n))
    inside = []
    for _ in range(40):
        rho, bound = cross_correlation(rng.normal(size=n), force, lags)
        inside.append(np.abs(rho) < bound)
    # stems of a slow force hang together: 40 records count as 40
    assert abs(np.mean(inside) - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 40)
    quick = rng.normal(size=n)
    rho, bound = cross_correlation(0.5 * np.roll(quick, 7) + rng.normal(size=n), quick, lags)
    assert lags[np.argmax(np.abs(rho))] == 7
    assert rho.max() > 5 * bound
    fit = fit_runs([campaigns.noisy(campaigns.still_run(1.649, campaigns.times(8.0), "modal"), rng)], "linear")
    run = campaigns.still_run(1.649, campaigns.times(8.0), "modal")
    one = judged(fit, [run])[0]
    linear = 3.96 * (run.y_m / 0.91 + (1 + 1.649 / 0.91) * run.beta_rad)
    # sin of up to 0.3 rad, and the fit's own error
    assert np.abs(one.force_n - linear).max() < 0.03 * np.abs(linear).max()
    assert one.white.shape == (len(run.t_s), 2)


def test_a_reference_beside_a_refused_derivative(found: Identified) -> None:
    """What the record does not determine is left out of the comparison; the rest counts with its own degrees of freedom."""
    keys = list(found.result.derivatives)
    some = {k: found.result.derivatives[k] for k in keys[2:]}
    correlation = np.array(found.result.correlation)[2:, 2:].tolist()
    part = found.result.model_copy(update={"derivatives": some, "correlation": correlation})
    compared = compare_to_reference(part, reference_set("ittc"))
    assert [row.name for row in compared.rows] == keys[2:]
    assert compared.p_value == pytest.approx(chi2.sf(compared.chi_square, len(keys) - 2))


@pytest.mark.slow
def test_the_command_writes_the_page(samples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import shutil

    run = shutil.copytree(samples / "mariner" / "x1751", tmp_path / "run", ignore=shutil.ignore_patterns("out"))
    text = (run / "run.toml").read_text()
    (run / "run.toml").write_text(text.replace('video = "video.mp4"', 'video = "video.mp4"\nspan_s = [0.0, 20.0]'))
    command = ["identify", str(run), "--form", "linear", "--noise", "output"]
    assert main([*command, "--reference", "nowhere.csv"]) == 1
    assert "no built-in reference set" in capsys.readouterr().err
    assert not (run / "out").exists()
    assert main([*command, "--no-page"]) == 0
    assert not (run / "out" / "derivatives.html").exists()
    assert main([*command, "--reference", "ittc"]) == 0
    said = capsys.readouterr().out
    assert f"page: {run / 'out' / 'derivatives.html'}" in said
    assert "against ittc" in said
    page = (run / "out" / "derivatives.html").read_text(encoding="utf-8")
    result = read_result(run / "out" / "derivatives.json", DerivativesFile)
    assert next(iter(result.runs)) in page
    assert "One run only" in page


@pytest.mark.slow
def test_the_agreement_of_runs_under_a_force_is_by_the_innovations(campaigns: ModuleType) -> None:
    """Each run alone is fitted with its own force; the drop of the deviance is a chi-square of 6, and of 3 more numbers of noise
    that a run alone has for itself; one towed at a tenth more tension than said stands out."""
    rng, t = np.random.default_rng(41), campaigns.times(4.0, 40.0)
    points = campaigns.POINTS_M[::3]
    runs = [campaigns.noisy(campaigns.pushed_run(x, rng, t, priors=Priors()), rng) for x in points]
    squares = []
    for tension in (1.0, 0.9):
        told = [replace(runs[0], tow=replace(runs[0].tow, tension_n=tension * runs[0].tow.tension_n)), runs[1]]
        fit = fit_with_noise(told, "linear", noise="innovations")
        assert fit.method == "innovations"
        agreed = consistency(fit, told)
        assert agreed.degrees == 6
        assert agreed.chi_square is not None
        assert all(p.problem == "" for p in (*agreed.alone, *agreed.without))
        squares.append(agreed.chi_square)
    assert squares[0] < chi2.isf(1e-4, 6 + 3)
    assert squares[1] > squares[0] + 25


def test_a_motion_without_sigmas_is_noted_and_one_with_them_is_not(campaigns: ModuleType) -> None:
    t = campaigns.times(8.0, 40.0)
    runs = campaigns.campaign(
        [campaigns.still_run(x, t, "modal") for x in campaigns.POINTS_M[::3]], np.random.default_rng(6)
    )
    for assumed in (False, True):
        told = [runs[0], replace(runs[1], assumed_sigma=assumed)]
        file = derivatives_file(
            fit_runs(told, "linear"), told, ModelTable(length_pp_m=2.66, mass_kg=78.0), WaterTable(), "t", {}, {}, None
        )
        assert ("the motion states no sigma; the noise was measured from the residuals" in file.notes) is assumed


def test_a_step_from_the_joint_fit_is_near_what_a_refit_finds(
    campaigns: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six runs: left out within 0.02 sd, alone within half; the chi-square of their agreement to a tenth."""
    rng = np.random.default_rng(46)
    points = (*campaigns.POINTS_M[::-1], 1.6, 1.7)
    runs = [campaigns.noisy(campaigns.still_run(x, campaigns.times(16.0), "modal"), rng) for x in points]
    fit = fit_runs(runs, "linear")
    stepped = consistency(fit, runs)
    monkeypatch.setattr("towline.identify.consistency.REFITTED", len(runs))
    refitted = consistency(fit, runs)
    for parts, others, most in ((refitted.alone, stepped.alone, 0.5), (refitted.without, stepped.without, 0.02)):
        for part, other in zip(parts, others, strict=True):
            assert np.abs((part.six - other.six) / part.sd).max() < most
            np.testing.assert_allclose(other.sd / part.sd, 1, atol=most)
    assert stepped.chi_square == pytest.approx(refitted.chi_square, rel=0.1)


@pytest.mark.slow
def test_of_many_runs_only_the_strangest_are_drawn(
    campaigns: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, self_contained: Callable[[str], list[bytes]]
) -> None:
    """Two of three in full, the one with a planted drift among them; a strip of each."""
    rng = np.random.default_rng(47)
    runs = [moved(campaigns, x, rng, tmp_path, f"r{k}", 1.0) for k, x in enumerate(campaigns.POINTS_M[:3])]
    drift = runs[1].motion.copy()
    drift["y_cg_m"] += 3e-3 * np.sin(drift["t_s"] / 2)
    runs[1] = replace(runs[1], motion=drift)
    made = identify_batch(Batch(runs, {}), "linear", noise="output")
    monkeypatch.setattr("towline.report.identify_page.ALL_DRAWN", 2)
    text = identify_page(fit_page(made))
    pictures = self_contained(text)
    assert len([p for p in pictures if b'width="420"' in p]) == 3
    assert 'id="run-2"' in text
    assert text.count('class="run"') == 2
    names = {one.name for one in text.drawn}
    assert {"run-1-strip", "run-2-strip", "run-3-strip", "run-2-motion"} <= names


def test_a_single_run_alone_is_the_fit_itself(campaigns: ModuleType) -> None:
    t = campaigns.times(16.0)
    run = campaigns.noisy(campaigns.still_run(1.548, t, "modal"), np.random.default_rng(48))
    fit = fit_runs([run], "linear")
    agreed = consistency(fit, [run])
    (alone,) = agreed.alone
    np.testing.assert_array_equal(alone.six, fit.six)
    assert not agreed.without
    assert agreed.p_value is None


def test_data_of_pictures_are_written_as_pandas_does() -> None:
    table = pd.DataFrame(
        {
            "series": ["a", 'b,"c"', "", "d"],
            "t_s": [0.0, 1 / 3, np.nan, -1e-17],
            "count": [1, 2, 3, 4],
            "far": [np.inf, -np.inf, 1e300, 5e-324],
        }
    )
    for part in (table, table.iloc[:0], table[["t_s"]], table[["series", "far"]], pd.DataFrame()):
        assert csv_text(part) == part.to_csv(index=False, float_format="%.10g", lineterminator="\n")
