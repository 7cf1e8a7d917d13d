"""The pictures of the gap and check pages, and what the pages write: nothing cut, nothing over anything else, symbols for keys."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towline.record.gap_file import GapFile, RankedEffects, Where
from towline.record.results import Measured
from towline.report import check_figures, gap_figures, run_figures
from towline.report.gap_page import gap_page
from towline.report.html import Html, symbols


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The figures that are drawn, as matplotlib has them."""
    found: list[Any] = []

    def kept(drawing: Any, *_: object) -> Html:
        found.append(drawing)
        return Html("")

    for module in (check_figures, gap_figures, run_figures):
        monkeypatch.setattr(module, "svg_image", kept)
    return found


def boxes(drawing: Any) -> list[tuple[str, Any]]:
    """Every text that is seen, and where it stands, in dots."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    canvas = FigureCanvasAgg(drawing)
    canvas.draw()
    ticks = {
        id(text): (ax, along)
        for ax in drawing.axes
        for along, axis in enumerate((ax.xaxis, ax.yaxis))
        for text in axis.get_ticklabels(which="both")
    }
    shown = []
    for text in drawing.findobj(Text):
        if not (text.get_visible() and text.get_text().strip()):
            continue
        box = text.get_window_extent(canvas.get_renderer())
        if id(text) in ticks:  # one beyond the axis' ends is not drawn
            ax, along = ticks[id(text)]
            middle = ((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2)
            if not -0.05 <= ax.transAxes.inverted().transform(middle)[along] <= 1.05:
                continue
        shown.append((text.get_text(), box))
    return shown


def assert_legible(drawing: Any) -> None:
    """No text leaves the picture, none stands on another."""
    width, height = drawing.get_size_inches() * drawing.dpi
    found = boxes(drawing)
    assert len(found) > 5
    for name, box in found:
        assert box.x0 >= 0, name
        assert box.x1 <= width, name
        assert box.y0 >= 0, name
        assert box.y1 <= height, name
    for k, (name, box) in enumerate(found):
        for other, its in found[:k]:
            apart = box.x0 >= its.x1 or its.x0 >= box.x1 or box.y0 >= its.y1 or its.y0 >= box.y1
            assert apart, f"{name!r} stands on {other!r}"


@pytest.mark.parametrize("size", [1.0, 0.5, 0.00012, 130.0])
def test_the_map_of_places_is_legible(drawn: list[Any], size: float) -> None:
    x, y = np.linspace(-3.6, -1.0, 9), np.linspace(-0.25, 0.25, 9)
    rows = size * (0.3 + np.add.outer(y**2, 0.1 * x**2))
    grid = SimpleNamespace(x_m=x.tolist(), y_m=y.tolist(), x_mm=rows.tolist(), y_mm=(0.61 * rows).tolist())
    file: Any = SimpleNamespace(uncertainty=grid)
    check_figures.map_figure(file)
    assert_legible(drawn[0])


def gap_file(**more: Any) -> GapFile:
    one = RankedEffects(
        effects=["elastic_line", "crossflow_drag"],
        titles=["a line that stretches", "quadratic cross-flow drag"],
        probability=0.9,
        parameters={"elastic_line.compliance_m_n": Measured(value=0.00242, std=0.00015)},
        units={"elastic_line.compliance_m_n": "m/N"},
        gap_before=4.0,
        gap_after=1.0,
        shrink=0.9,
        shrink_interval=(0.8, 1.0),
    )
    return GapFile(
        schema="towline/gap", tool="t", inputs={}, verdict="effect",
        where=Where(stage="line", share={"line": 0.9, "sway": 0.1}, runs={"a": 0.4, "b": 0.6}, span_s=[], band_hz=[]),
        ranking=[one, one.model_copy(update={"effects": ["own_$effect$"], "titles": []})],
        indistinguishable=[], p_no_gap=0.05, p_unknown=0.05, set95=[], next_run=None, runs=["a", "b"],
        **{"noise": {"side_n": 0.01, "moment_n_m": 0.01, "time_s": 2.0}, **more},
    )  # fmt: skip


@pytest.mark.parametrize("draw", [gap_figures.ladder_figure, gap_figures.stage_figure])
def test_hypotheses_and_places_are_legible(drawn: list[Any], draw: Callable[[GapFile], Html]) -> None:
    """A title wraps; a dollar in a user's name sets no formula."""
    draw(gap_file())
    assert_legible(drawn[0])


@pytest.mark.parametrize("most", [0.2, 3.0, 812.0])
@pytest.mark.parametrize("runs", [1, 2, 5])
def test_when_it_shows_is_legible(drawn: list[Any], most: float, runs: int) -> None:
    drop = {f"r{k}": most * np.linspace(0, 1, 40) for k in range(runs)}
    found: Any = SimpleNamespace(
        place=SimpleNamespace(drop=drop), inference=SimpleNamespace(simulator=SimpleNamespace(step_s=1.0))
    )
    gap_figures.drop_figure(found)
    assert_legible(drawn[0])


def test_a_fit_on_top_of_what_was_measured_leaves_both_to_be_seen(drawn: list[Any]) -> None:
    """The measured dots are wider than the fit's line by more than it is itself, and far from it in lightness."""
    import pandas as pd
    from matplotlib.colors import to_rgb

    t_s = np.arange(200) / 20
    angle = 0.1 * np.sin(t_s)
    motion = pd.DataFrame({"t_s": t_s, "y_cg_m": angle, "beta_rad": angle, "alpha_rad": angle, "status": "measured"})
    run_figures.motion_figure(motion, motion.drop(columns="status"), None)
    for ax in drawn[0].axes:
        measured, fit = ax.get_lines()
        assert measured.get_markersize() > 3 * fit.get_linewidth()
        assert measured.get_zorder() < fit.get_zorder()
        light, dark = (float(np.dot(to_rgb(line.get_color()), (0.299, 0.587, 0.114))) for line in (measured, fit))
        assert light - dark > 0.25


def test_the_gap_page_says_symbols_and_millimetres() -> None:
    hull = {"y_v": Measured(value=-52.9, std=0.4), "compliance_m_n": Measured(value=0.0002, std=0.0001)}
    page = gap_page(found_of(gap_file(derivatives={"before": hull, "after": hull}, sentences=["It biases N_rdot."])))
    assert "compliance 2.42\u2009± 0.15 mm/N" in page or "compliance 2.42 ± 0.15 mm/N" in page
    assert "a line that stretches + quadratic cross-flow drag" in page
    for key in ("compliance_m_n", "elastic_line", "y_v<", "N_rdot"):
        assert key not in page, key
    assert "<i>N</i><sub>r\u0307</sub>" in page
    assert "0.20 ± 0.10" in page  # of the line that the simulator has, mm/N


def found_of(file: GapFile) -> Any:
    linear = SimpleNamespace(rows=[np.zeros((1, 40, 4))] * 2)
    run = SimpleNamespace(name="a", centre_s=np.arange(40.0), covariance=np.array([np.eye(40)] * 4))
    simulator = SimpleNamespace(runs=[run, run], step_s=1.0)
    fitted = SimpleNamespace(fitted=SimpleNamespace(linear=linear))
    diagnosis = SimpleNamespace(
        file=file,
        inference=SimpleNamespace(simulator=simulator),
        ranking=SimpleNamespace(base=fitted.fitted),
        best=fitted,
        place=SimpleNamespace(drop={}),
    )
    return SimpleNamespace(diagnosis=diagnosis)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Y_v", "<i>Y</i><sub>v</sub>"),
        ("N_rdot -3", "<i>N</i><sub>r\u0307</sub> −3"),
        ("Y_v|r|", "<i>Y</i><sub>v|r|</sub>"),
        ("run_Y_v my_run X_T = 1", "run_Y_v my_run <i>X</i><sub>T</sub> = 1"),
        ("<b>N_v", "&lt;b&gt;<i>N</i><sub>v</sub>"),
    ],
)
def test_symbols_in_a_sentence(text: str, shown: str) -> None:
    assert symbols(text) == shown
