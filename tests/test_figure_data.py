"""What a page draws stands beside it as CSV: the same numbers, a link that leads there, nothing left over from an earlier page."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest

from towline.blind.page import reliability_figure
from towline.cli import main
from towline.record.results import Measured, SteadyFile, SteadyTow
from towline.report import draw
from towline.report.check_figures import map_figure
from towline.report.dynamics_figures import Answer, bode_figure
from towline.report.html import Drawn, Html, figure, tag
from towline.report.page import document, write_document
from towline.report.series import spectrum
from towline.report.steady_figure import line_figure
from towline.simulate import Hull, Tow

DIGITS = 1e-9  # CSVs carry ten digits
SHIFT = 0.2  # stems that would hide each other are drawn this far aside
THEORY = ("normal", "honest")  # lines that are no data
HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)


@dataclass(frozen=True)
class Pair:
    """A picture as matplotlib holds it, and its data."""

    name: str
    figure: Any
    table: pd.DataFrame


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Pair]:
    """Every picture drawn from here on."""
    from matplotlib.figure import Figure

    pairs: list[Pair] = []
    figures: list[Figure] = []
    save, gather = Figure.savefig, draw.drawn

    def saved(self: Figure, *args: Any, **named: Any) -> None:
        figures.append(self)
        save(self, *args, **named)

    def gathered(what: str, name: str, data: Any) -> Drawn:
        found = gather(what, name, data)
        pairs.append(Pair(name, figures[-1], found.table))
        return found

    monkeypatch.setattr(Figure, "savefig", saved)
    monkeypatch.setattr(draw, "drawn", gathered)
    return pairs


def among(values: Any, table: np.ndarray, by: float = 0.0) -> bool:
    """Each finite value is one of the table's."""
    wanted = np.asarray(values, dtype=float)
    wanted = wanted[np.isfinite(wanted)]
    if not len(wanted):
        return True
    if not len(table):
        return False
    place = np.clip(np.searchsorted(table, wanted), 1, max(1, len(table) - 1))
    near = np.minimum(np.abs(table[place - 1] - wanted), np.abs(table[np.minimum(place, len(table) - 1)] - wanted))
    return bool((near <= by + DIGITS * (1 + np.abs(wanted))).all())


def holds_what_is_drawn(pair: Pair) -> int:
    """Every line's numbers, and every bar's length, stand in the table; how many were looked at."""
    numbers = np.sort(pair.table.select_dtypes("number").to_numpy(dtype=float).ravel())
    numbers = numbers[np.isfinite(numbers)]
    timed = any(re.search(r"\(s\)$", ax.get_xlabel()) for ax in pair.figure.axes)
    count = 0
    for ax in pair.figure.axes:
        caps = {
            cap for bars in ax.containers for cap in (bars[1] if type(bars).__name__ == "ErrorbarContainer" else ())
        }
        for line in ax.lines:
            if line.get_transform() != ax.transData or line.get_label() in THEORY or line in caps:
                continue  # a level, or a curve that is no data
            x, y = np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)
            there = among(x, numbers, SHIFT if pair.name == "whiteness" else 0.0), among(y, numbers)
            assert all(there) if timed else any(there), f"{pair.name}: {line.get_label()}"
            count += len(x)
        for bar in ax.patches:
            if hasattr(bar, "get_width") and ax.get_xlabel().startswith(("probability", "share")):
                assert among([bar.get_width()], numbers), pair.name
                count += 1
    return count


@pytest.fixture(scope="module")
def runs(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], tmp_path_factory: pytest.TempPathFactory
) -> list[Path]:
    """Two filmed tows without any effect, as run folders."""
    made = cases.campaign("none", np.random.default_rng(3)).runs[:2]
    return write_runs(made, tmp_path_factory.mktemp("figures"))


PAGES = {
    "run": ("report.html", ("tracks", "motion", "orbits", "residuals", "whiteness", "spectrum")),
    "identify": ("derivatives.html", ("consistency-1-2-3", "bode", "motion", "cross", "spectrum")),
    "check": ("check.html", ("map", "picture", "run-1-invariants")),
    "diagnose": ("gap.html", ("hypotheses", "where", "run-1")),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", PAGES)
def test_each_page_has_its_numbers_beside_it(
    command: str, runs: list[Path], drawn: list[Pair], self_contained: Callable[[str], list[bytes]]
) -> None:
    page_name, expected = PAGES[command]
    out = runs[0].parent / f"out-{command}"
    quick = ["--form", "linear", "--noise", "output"] if command in ("run", "identify") else []
    assert main([command, *map(str, runs), *quick, "-o", str(out)]) == 0
    path = next(p for p in (out / page_name, out / page_name.replace(".", "-1.")) if p.is_file())
    page = path.read_text(encoding="utf-8")
    pictures = len(self_contained(page))
    links = [unquote(link) for link in re.findall(r'<figcaption>.*?href="([^"]+\.csv)"', page)]
    assert len(links) == len(set(links)) == pictures
    assert all((out / link).is_file() and link.startswith(f"{path.stem}_figures/") for link in links)
    names = {pair.name for pair in drawn}
    assert set(expected) <= names
    assert sum(holds_what_is_drawn(pair) for pair in drawn) > 100
    # what stands in the file is the table, to ten digits
    files = [pd.read_csv(out / link, comment="#") for link in links]
    tables = [pair.table for pair in drawn if len(pair.table)]
    for table in tables:
        assert any(list(f.columns) == list(table.columns) and len(f) == len(table) and same(f, table) for f in files), (
            table.columns
        )
    if command == "run":
        holds_the_measured_motion(runs[0], out)


def holds_the_measured_motion(run: Path, out: Path) -> None:
    """The first run's motion is motion.csv's, its residuals measured minus fitted."""
    motion = pd.read_csv(run / "out" / "motion.csv", comment="#")
    motion = motion[motion["status"] == "measured"]
    table = pd.read_csv(out / "report_figures" / "run-1-motion.csv", comment="#")
    shown = table[table["series"] == "measured"]
    np.testing.assert_allclose(shown["t_s"], motion["t_s"], rtol=1e-9)
    np.testing.assert_allclose(shown["y_cg_m"], motion["y_cg_m"], rtol=1e-8)
    np.testing.assert_allclose(np.radians(shown["beta_deg"]), motion["beta_rad"], rtol=1e-8)
    np.testing.assert_allclose(np.radians(shown["alpha_deg"]), motion["alpha_rad"], rtol=1e-8)
    fitted = table[table["series"] == "fit"]
    rest = pd.read_csv(out / "report_figures" / "run-1-residuals.csv", comment="#").set_index("t_s")
    difference = 1e3 * (shown.set_index("t_s")["y_cg_m"] - fitted.set_index("t_s")["y_cg_m"])
    np.testing.assert_allclose(rest["y_mm"].dropna(), difference.reindex(rest["y_mm"].dropna().index), atol=1e-6)


def same(file: pd.DataFrame, table: pd.DataFrame) -> bool:
    numbers = table.select_dtypes("number").columns
    left, right = (t[numbers].to_numpy(dtype=float) for t in (file, table))
    return bool(np.allclose(left, right, rtol=1e-9, atol=1e-12, equal_nan=True))


def test_steady_line_and_reliability_and_map(drawn: list[Pair]) -> None:
    tows = {
        name: SteadyTow(
            tow_point_m=x, alpha_rad=Measured(value=0.1, std=0.001), beta_rad=Measured(value=0.05, std=0.001),
            force=Measured(value=f, std=0.01), span_s=(20.0, 30.0), settled=True,
        )
        for name, x, f in (("a", 0.5, 0.4), ("b", 0.6, 0.3), ("c", 0.7, 0.25))
    }  # fmt: skip
    result = SteadyFile(
        tool="0", inputs={}, force_unit="N", x_v_m=Measured(value=0.2, std=0.01), x_v_interval_m=(0.18, 0.22),
        slope=Measured(value=0.12, std=0.001), chi2_per_dof=None, pairs={}, y_v=None, y_delta_delta=None,
        n_delta_delta=None, x_v_true_m=None, tows=tows, failed={}, notes=[],
    )  # fmt: skip
    assert line_figure(result) is not None
    table = drawn[-1].table
    tow = table[table["series"] == "tow"]
    np.testing.assert_allclose(tow["one_over_f_per_n"], [2.5, 1 / 0.3, 4.0])
    np.testing.assert_allclose(tow["tow_point_m"], [0.5, 0.6, 0.7])
    assert holds_what_is_drawn(drawn[-1]) >= 6

    class Bin:
        mean, right, count = 0.8, 7, 10

    reliability_figure([Bin(), Bin()])  # pyright: ignore[reportArgumentType]
    assert drawn[-1].table["share_right"].tolist() == [0.7, 0.7]
    assert holds_what_is_drawn(drawn[-1]) > 0

    class Grid:
        x_m, y_m = [0.0, 1.0, 2.0], [-1.0, 1.0]
        x_mm, y_mm = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], [[0.1] * 3, [0.2] * 3]  # a row per y

    class File:
        uncertainty = Grid

    map_figure(File())  # pyright: ignore[reportArgumentType]
    table = drawn[-1].table.set_index(["x_m", "y_m"])
    assert table.loc[(2.0, -1.0), "sd_x_mm"] == 3.0
    assert table.loc[(0.0, 1.0), "sd_x_mm"] == 4.0
    assert table.loc[(1.0, 1.0), "sd_y_mm"] == 0.2


def test_the_spectrum_of_white_noise_is_level_and_a_wave_stands_where_it_is() -> None:
    """White noise of sd s at f Hz: 2 s^2/f at all frequencies; each of 40 stretches that averages n lines scatters by n^-1/2."""
    rng = np.random.default_rng(1)
    t_s = np.arange(40_000) / 20
    white = rng.normal(0, 0.3, len(t_s))
    white[500:4000] = np.nan  # holes do no harm
    frequency, density, level = spectrum(t_s, white)
    assert level == pytest.approx(2 * 0.3**2 / 20, rel=0.03)
    upper = density[frequency > 0.2]
    np.testing.assert_allclose(upper, level, rtol=0.15)
    wave = spectrum(t_s, np.sin(2 * np.pi * 0.5 * t_s))
    assert wave[0][np.argmax(wave[1])] == pytest.approx(0.5, rel=0.2)
    assert len(spectrum(t_s[:4], white[:4])[0]) == 0


def test_the_bode_diagram_s_numbers_and_band(drawn: list[Pair]) -> None:
    """Gain and phase are those of the transfer function; the band is that of derivatives drawn from their covariance."""
    from towline.identify.methods import bode, open_loop_transfer

    tow = Tow(1.28, 0.91, 1.55, 3.96)
    six = np.array(HULL.six)
    sd = 0.01 * np.abs(six)
    bode_figure(Answer(HULL, np.diag(sd**2), tow, (0.35,)))
    table = drawn[-1].table
    shown = table[table["series"] == "beta"]
    exact = bode(open_loop_transfer(HULL, tow)["beta"], shown["omega_rad_s"].to_numpy())
    np.testing.assert_allclose(shown["gain_db"], exact.gain_db)
    np.testing.assert_allclose(shown["phase_deg"], exact.phase_deg)
    rng = np.random.default_rng(2)
    at = int(np.argmin(np.abs(shown["omega_rad_s"].to_numpy() - 1.0)))
    omega = shown["omega_rad_s"].to_numpy()[[at]]
    gains = [
        bode(
            open_loop_transfer(Hull(*(float(v) for v in rng.normal(six, sd)), speed_m_s=1.28), tow)["beta"], omega
        ).gain_db[0]
        for _ in range(2000)
    ]
    # sd of 2000 draws is known to 1.6 %; the answer is not quite linear in the derivatives
    assert shown["gain_half_95_db"].iloc[at] == pytest.approx(1.96 * np.std(gains), rel=0.08)


def test_a_page_of_the_same_name_leaves_no_old_numbers_and_nothing_else_is_touched(tmp_path: Path) -> None:
    def page(*names: str) -> Html:
        table = pd.DataFrame({"t_s": [0.0, 1.0]})
        images = [Html("<img>", (Drawn(name, "in words", table),)) for name in names]
        return document("title", tag("main", *(figure(image, "caption", of="run-1") for image in images)))

    path = tmp_path / "a page.html"
    write_document(path, page("one", "two"))
    folder = tmp_path / "a page_figures"
    (folder / "mine.csv").write_text("t_s\n1\n")
    assert sorted(p.name for p in folder.iterdir()) == ["mine.csv", "run-1-one.csv", "run-1-two.csv"]
    assert 'href="a%20page_figures/run-1-one.csv"' in path.read_text(encoding="utf-8")
    assert (folder / "run-1-one.csv").read_text(encoding="utf-8").splitlines() == [
        "# drawn in a page.html: in words", "t_s", "0", "1",
    ]  # fmt: skip
    write_document(path, page("two"))
    assert sorted(p.name for p in folder.iterdir()) == ["mine.csv", "run-1-two.csv"]
    with pytest.raises(ValueError, match="one name"):
        page("one", "one")


def test_a_number_that_is_not_in_the_table_would_be_seen(drawn: list[Pair]) -> None:
    drawing, (ax,) = draw.new_figure(2.0)
    ax.plot([0.0, 1.0, 2.0], [1.0, 2.0, 3.5], label="a")
    draw.label(ax, x="time (s)")
    draw.svg_image(drawing, "in words", "a", {"": {"t_s": [0.0, 1.0, 2.0], "y_m": [1.0, 2.0, 3.0]}})
    with pytest.raises(AssertionError, match="a: a"):
        holds_what_is_drawn(drawn[-1])
