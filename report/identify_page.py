"""The page of a fit: derivatives, reference, agreement of the runs, and run by run what the fit left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr

from ..record.each import Each, in_turn
from .budget_section import budget_section
from .dynamics_figures import Answer, bode_figure, orbits_figure, spectrum_figure
from .format import NONE, SYMBOLS_TEXT, plus_minus, significant, to_decimals
from .html import FIGURES, Html, bullets, figure, join, number, symbols, table, tag, unit
from .identify_figures import consistency_figure, cross_figure, estimators_figure, white_residuals
from .page import document, write_document
from .run_figures import motion_figure, residuals_figure, whiteness_figure
from .run_section import ORBITS, SPECTRUM, RunPage, frames_of
from .sections import SYMBOLS_HTML, Frames, derivatives_section, failed_box, summary
from .series import residuals
from .strips import REACH, residual_strip

if TYPE_CHECKING:
    import pandas as pd

    from ..identify.consistency import Consistency, Judged, Part
    from ..identify.data import RunData
    from ..identify.fit import Fit
    from ..identify.reference import Comparison
    from ..record.budget_file import BudgetFile
    from ..record.results import DerivativesFile
    from .series import Array

NAMES = tuple(SYMBOLS_TEXT)
ALL_DRAWN = 8
"""Up to so many runs the page holds every picture of each ..."""
STRANGEST = 2
"""... and of more, those of the strangest; of all the others a strip of their residuals."""
FAR = 2.0
"""A difference of more standard deviations is printed bold: about the 95 % interval (1.96)."""
UNLIKELY = 0.01
"""A test less probable than this says that the runs do not agree, or that residuals are not white."""


@dataclass(frozen=True)
class FitPage:
    """Everything the page shows.

    Attributes
    ----------
    result : derivatives.json
    fit, data : the fit and what it was given
    motion : run name -> motion table, in the order of ``data``
    fitted : run name -> t_s, y_cg_m, beta_rad, alpha_rad of the fit, biases included
    agreed, judged : ``identify.consistency`` of the fit
    compared : against a reference set, or None
    budget : budget.json of the same runs, or None
    """

    result: DerivativesFile
    fit: Fit
    data: list[RunData]
    motion: dict[str, pd.DataFrame]
    fitted: dict[str, pd.DataFrame]
    agreed: Consistency
    judged: list[Judged]
    compared: Comparison | None = None
    budget: BudgetFile | None = None


def write_identify_page(path: Path, found: FitPage, each: Each = in_turn) -> None:
    """Write the page atomically; ``each`` draws the pictures, here or by workers.

    Parameters
    ----------
    path : of the file
    found : the fit, whether the runs agree, and what it left
    each : draws, here or by workers
    """
    write_document(path, identify_page(found, each))


def identify_page(found: FitPage, each: Each = in_turn) -> Html:
    """The page as text.

    Parameters
    ----------
    found : the fit, whether the runs agree, and what it left
    each : draws, here or by workers
    """
    agreed, compared = found.agreed, found.compared
    result = found.result
    pages = [RunPage(name, None, None, motion, found.fitted[name], None, None) for name, motion in found.motion.items()]
    shown = _shown(found)
    of_runs = [_drawings(pages[k], found.judged[k], _whitened(found, k)) for k in shown]
    shared = {"agreed": _agreement(found, agreed), "answer": _answered(found)}
    jobs = [job for some in shared.values() for job in some]
    # like pictures of all runs side by side: two who draw by turns are busy to the end
    places = sorted((place, run) for run, some in enumerate(of_runs) for place in range(len(some)))
    rest = each(_made, [*jobs, *(of_runs[run][place].job for place, run in places)])
    pictures = {name: [rest.pop(0) for _ in some] for name, some in shared.items()}
    made = dict(zip(places, rest, strict=True))
    runs = [
        _run(pages[k], result.runs[pages[k].name].tests, k + 1, some, [made[place, run] for place in range(len(some))])
        for run, (k, some) in enumerate(zip(shown, of_runs, strict=True))
    ]
    frames = sum((frames_of(page) for page in pages), Frames())
    title = f"Derivatives: {', '.join(found.fitted)}"
    parts: list[object] = [
        tag("h1", title),
        summary(len(pages) + len(result.failed), len(result.failed), frames, result, None),
        _contents(found, compared),
        derivatives_section(result),
    ]
    if found.budget is not None:
        parts.append(budget_section(found.budget))
    if result.failed:
        parts.append(failed_box("Runs that could not be used", result.failed))
    if compared is not None:
        parts.append(_reference(found, agreed, compared))
    parts.append(_consistency(found, agreed, pictures["agreed"]))
    parts.append(_answer(found, pictures["answer"]))
    if len(shown) < len(pages):
        parts.append(_every_run(found, pages, shown))
    parts += runs
    words = (
        "± is one standard deviation, bars are 95 %; y and angles positive to starboard. "
        f"Written by towline {result.tool}."
    )
    parts.append(tag("footer", words))
    return document(title, tag("main", *parts))


def _made(call: Callable[..., Html], *arguments: Any) -> Html:
    return call(*arguments)


def _contents(found: FitPage, compared: Comparison | None) -> Html:
    links: list[object] = [tag("a", "Derivatives", href="#derivatives")]
    if found.budget is not None:
        links.append(tag("a", "Uncertainty budget", href="#budget"))
    if compared is not None:
        links.append(tag("a", "Reference", href="#reference"))
    links.append(tag("a", "Do the runs agree?", href="#consistency"))
    shown, names = _shown(found), list(found.fitted)
    if len(shown) < len(names):
        links.append(tag("a", f"All {len(names)} runs", href="#runs"))
    links += [tag("a", names[k], href=f"#run-{k + 1}") for k in shown]
    return tag("nav", join(links, " "))


# against a reference ------------------------------------------------------------------------------------------------


def _reference(found: FitPage, agreed: Consistency, compared: Comparison) -> Html:
    """Tables 8.9 and 8.11: this fit, the mean of the runs alone, the reference; dimensional and prime."""
    source = compared.reference
    mean = dict(zip(NAMES, agreed.mean, strict=True))
    rows, primes = [], []
    for row in compared.rows:
        prime = row.value / found.result.derivatives[row.name].prime
        alone = mean[row.name]
        far = abs(row.difference_sd) > FAR
        score = number(f"{row.difference_sd:+.1f}" if np.isfinite(row.difference_sd) else NONE)
        rows.append([
            join([SYMBOLS_HTML[row.name], " ", tag("small", unit(row.unit))]),
            number(plus_minus(row.value, row.std)),
            number(significant(alone, 4)),
            number(plus_minus(row.reference, row.reference_std) if row.reference_std else significant(row.reference, 4)),
            number(f"{row.difference_percent:+.2f}"),
            tag("strong", score) if far else score,
        ])  # fmt: skip
        primes.append([
            SYMBOLS_HTML[row.name],
            *(number(to_decimals(1e3 * x / prime, 3)) for x in (row.value, alone, row.reference)),
        ])  # fmt: skip
    caption = f"{source.name}: {source.source}" if source.source else source.name
    head = ["derivative", "this fit", "mean of runs alone", "reference", "differs, %", "in sd"]
    verdict = (
        f"All {len(rows)} together: chi-square {significant(compared.chi_square, 4)} on {len(rows)}, "
        f"p {_chance(compared.p_value)}: the chance of so large a difference, were the reference the truth."
    )
    values = np.array([[r.value, r.std, r.reference, r.reference_std] for r in compared.rows]).T
    drawn = figure(estimators_figure([r.name for r in compared.rows], *values), "The same in a picture.")
    shown = tag(
        "div",
        table(head, rows, caption=caption),
        table(["in primes × 10³", "this fit", "mean of runs alone", "reference"], primes),
    )
    return tag(
        "section",
        tag("h2", "Against a reference"),
        tag("p", verdict),
        tag("div", shown, drawn, class_="grid"),
        bullets(map(symbols, compared.notes)),
        id="reference",
    )


def _chance(p_value: float) -> str:
    return "below 1e-12" if p_value < 1e-12 else f"= {p_value:.2g}"


# agreement of the runs ----------------------------------------------------------------------------------------------


def _agreement(found: FitPage, agreed: Consistency) -> list[tuple[Any, ...]]:
    """What draws the agreement of the runs; nothing for a single one."""
    if len(agreed.alone) < 2:
        return []
    return [(consistency_figure, found.fit.six, found.fit.covariance, agreed, three) for three, _ in _FIGURES]


def _consistency(found: FitPage, agreed: Consistency, pictures: list[Html]) -> Html:
    """Tables 8.8 and 8.10: each run alone, mean and standard deviation in %; then every run left out, with z."""
    parts: list[object] = [tag("h2", "Do the runs agree?")]
    if agreed.chi_square is not None and agreed.p_value is not None:
        verdict = "agree" if agreed.p_value > UNLIKELY else "do not agree"
        parts.append(
            tag(
                "p", "The runs ", tag("strong", verdict), " on the six derivatives to within their errors: with the joint "
                "values instead of each run's own, chi-square is higher by ",
                f"{agreed.chi_square:.1f} on {agreed.degrees} degrees of freedom, p {_chance(agreed.p_value)}.",
                "" if agreed.p_value > UNLIKELY else " Tension, tow point or speed changed between them (say how much they "
                "may in [priors]), or the model lacks something: towline diagnose looks for it.",
            )
        )  # fmt: skip
    elif len(agreed.alone) > 1:
        parts.append(tag("p", "One of the runs could not be fitted alone; what the others fix stands below."))
    else:
        parts.append(tag("p", "One run only: nothing checks it. A run at another tow point would."))
    if pictures:
        pair = (figure(picture, words) for picture, (_, words) in zip(pictures, _FIGURES, strict=True))
        parts.append(tag("div", *pair, class_="grid"))
    parts.append(_alone(found, agreed))
    if agreed.without:
        rows = [
            [join([str(k), " ", tag("small", part.name)]), *_cells(part, found.fit.six)]
            for k, part in enumerate(agreed.without, 1)
        ]
        parts.append(
            table(
                ["left out", *_heads()], rows, kind="wide",
                caption="All runs but one: difference to the joint fit in % and, in brackets, in its own standard "
                "deviations (z). A run whose absence moves a value by more than two of them pulls.",
            )
        )  # fmt: skip
    problems = [f"{part.name}: {part.problem}" for part in (*agreed.alone, *agreed.without) if part.problem]
    parts.append(bullets(map(symbols, problems)))
    return tag("section", *parts, id="consistency")


_FIGURES = (
    (
        (0, 1, 2),
        "Grey: the joint fit's 95 % interval. Dots: each run alone; squares: all runs without it. Look for bars that miss the "
        "grey band.",
    ),
    ((3, 4, 5), "What a run does not determine alone is left out. Run numbers as in the table."),
)


def _heads() -> list[object]:
    return [SYMBOLS_HTML[name] for name in NAMES]


def _alone(found: FitPage, agreed: Consistency) -> Html:
    factors = _factors(found)
    rows: list[list[object]] = []
    primes: list[list[object]] = []
    for order, (part, data) in enumerate(zip(agreed.alone, found.data, strict=True), 1):
        cells = [number(plus_minus(v, s)) if ok else "not fixed" for v, s, ok in _each(part)]
        first = join([str(order), " ", tag("small", part.name)])
        place = [number(f"{data.tow.tow_point_m:g}"), number(f"{data.tow.speed_m_s:g}")]
        rows.append([first, *place, *cells])
        cells = [
            number(plus_minus(1e3 * v / f, 1e3 * s / f)) if ok else "–"
            for (v, s, ok), f in zip(_each(part), factors, strict=True)
        ]
        primes.append([first, *cells])
    empty: list[object] = ["", ""]
    if np.isfinite(agreed.mean).any():
        rows.append(["mean", *empty, *(number(significant(v, 5)) for v in agreed.mean)])
        share = 100 * agreed.scatter / np.abs(agreed.mean)
        rows.append(["STD, %", *empty, *(number(significant(v, 2)) for v in share)])
        primes.append(["mean", *(number(significant(1e3 * v / f, 4)) for v, f in zip(agreed.mean, factors))])
    sd = np.sqrt(np.diag(found.fit.covariance))
    joint = zip(found.fit.six, sd, factors, strict=True)
    both = [(number(plus_minus(v, s)), number(plus_minus(1e3 * v / f, 1e3 * s / f))) for v, s, f in joint]
    rows.append([tag("strong", "joint"), *empty, *(b[0] for b in both)])
    primes.append([tag("strong", "joint"), *(b[1] for b in both)])
    head = ["run", Html("<i>X</i><sub>T</sub> (m)"), "U (m/s)", *_heads()]
    words = (
        f"Each run by itself, all at U = {found.fit.speed_m_s:g} m/s, SI units; mean and standard deviation over the runs "
        "as in the thesis's tables 8.8 and 8.10."
    )
    if agreed.stepped:
        words += " Of so many runs each alone, and all but each, is one Gauss-Newton step from the joint fit."
    return join([
        table(head, rows, kind="wide", caption=words),
        table(["run", *_heads()], primes, kind="wide", caption="The same in primes × 10³."),
    ])  # fmt: skip


def _factors(found: FitPage) -> Array:
    from ..identify.prime import prime_factors

    result = found.result
    assert result.density_kg_m3 is not None
    return prime_factors(result.density_kg_m3, result.length_pp_m, result.speed_m_s)


def _each(part: Part):
    return zip(part.six, part.sd, part.fixed, strict=True)


def _cells(part: Part, joint: Array) -> list[object]:
    cells: list[object] = []
    for value, middle, z, fixed in zip(part.six, joint, part.z, part.fixed, strict=True):
        if not fixed:
            cells.append("not fixed")
            continue
        share = number(f"{100 * (value - middle) / abs(middle):+.2f}")
        text = join([share, " (", number(f"{z:+.1f}" if np.isfinite(z) else NONE), ")"])
        cells.append(tag("strong", text) if np.isfinite(z) and abs(z) > FAR else text)
    return cells


def _answered(found: FitPage) -> list[tuple[Any, ...]]:
    """What draws how the hull answers; nothing where the record leaves some derivative open."""
    from ..simulate.characteristic import stability
    from ..simulate.model import Hull

    fit, tows = found.fit, [data.tow for data in found.data]
    if found.result.not_identifiable and len(found.result.derivatives) < len(NAMES):
        return []
    hull = Hull(*(float(x) for x in fit.six), speed_m_s=fit.speed_m_s)
    roots = [stability(hull, tow).roots for tow in tows if tow.tension_n is not None]
    swings = tuple(float(np.abs(np.imag(pair[0]))) for r in roots if len(pair := r[np.abs(np.imag(r)) > 1e-12]))
    return [(bode_figure, Answer(hull, fit.covariance, tows[0], swings))]


def _answer(found: FitPage, pictures: list[Html]) -> Html:
    """Figure 8.15: the identified hull's transfer functions, where they are drawn."""
    if not pictures:
        return Html("")
    tow = found.data[0].tow
    words = (
        f"Sway and yaw of the free hull over the line's lateral force at X_T = {tow.tow_point_m:g} m (8.27), U = "
        f"{tow.speed_m_s:g} m/s, with the 95 % bands of the derivatives' errors; dotted: where the runs swing. Towards low "
        "frequencies a hull that nothing holds drifts away, so that the gain grows; bands that open there say how far the runs' "
        "own frequencies carry."
    )
    return tag("section", tag("h2", "How the hull answers"), figure(pictures[0], words), id="answer")


# many runs ----------------------------------------------------------------------------------------------------------


def _shown(found: FitPage) -> list[int]:
    """The runs whose pictures the page holds: all of a few, of many the strangest."""
    runs = len(found.data)
    if runs <= ALL_DRAWN:
        return list(range(runs))
    strangest = np.argsort([_chance_of(found, k) for k in range(runs)], kind="stable")[:STRANGEST]
    return sorted(int(k) for k in strangest)


def _chance_of(found: FitPage, index: int) -> float:
    """How probable a run's residuals, and its pull on the joint fit, are beforehand: the least of these p."""
    tests = found.result.runs[found.data[index].name].tests
    chances = [tests["ljung_box_p_y"], tests["ljung_box_p_beta"]]
    for parts in (found.agreed.alone, found.agreed.without):
        if parts and (z := np.abs(parts[index].z[np.isfinite(parts[index].z)])).size:
            chances.append(min(1.0, len(NAMES) * 2 * float(ndtr(-z.max()))))
    return min(chances)


def _every_run(found: FitPage, pages: list[RunPage], shown: list[int]) -> Html:
    """A row of each run: scatter, whiteness, strip of its residuals."""
    rows: list[list[object]] = []
    for k, (page, data) in enumerate(zip(pages, found.data, strict=True)):
        run, rest = found.result.runs[page.name], residuals(page.motion, page.fitted)
        name: object = tag("a", page.name, href=f"#run-{k + 1}") if k in shown else page.name
        chances = [run.tests[key] for key in ("ljung_box_p_y", "ljung_box_p_beta")]
        rows.append([
            join([str(k + 1), " ", tag("small", name)]),
            number(f"{data.tow.tow_point_m:g}"),
            number(str(run.samples)),
            number(f"{1e3 * run.noise['y_m']:.2f}"),
            number(f"{np.degrees(run.noise['beta_rad']):.3f}"),
            *(tag("strong", text) if p < UNLIKELY else text for p in chances for text in [number(f"{p:.2g}")]),
            "" if rest is None else _linked(residual_strip(rest), f"run-{k + 1}"),
        ])  # fmt: skip
    head = ["run", Html("<i>X</i><sub>T</sub> (m)"), "samples", "y (mm)", "β (deg)", "p of y", "p of β", "residuals"]
    words = (
        f"Every run: rms of the residuals, Ljung-Box p after whitening, and the residuals over their sigma against time (y above, "
        f"β below, ±{REACH:g} high, grey ±2). Of these {len(rows)} runs the {len(shown)} strangest by whiteness and agreement are "
        "drawn in full below; towline run RUN draws one by itself."
    )
    return tag("section", tag("h2", "All runs"), table(head, rows, kind="wide", caption=words), id="runs")


def _linked(strip: Html, of: str) -> Html:
    """A strip that leads to its numbers."""
    (one,) = strip.drawn
    name = f"{of}-{one.name}"
    return tag("a", Html(strip, (replace(one, name=name),)), href=f"{FIGURES}/{name}.csv")


# one run ------------------------------------------------------------------------------------------------------------


def _whitened(found: FitPage, index: int) -> bool:
    return found.fit.method == "innovations" or bool(found.fit.orders[index].any())


@dataclass(frozen=True)
class _Drawing:
    """A picture of a run that is still to be drawn: by which call, what stands below it, and on which side of the page."""

    job: tuple[Any, ...]
    words: str
    left: bool = True
    of: str = ""


def _drawings(page: RunPage, one: Judged, whitened: bool) -> list[_Drawing]:
    drawings = [_Drawing((motion_figure, page.motion, page.fitted, None), _MOTION)]
    rest = residuals(page.motion, page.fitted)
    if rest is not None:
        drawings += [
            _Drawing((residuals_figure, rest), "Measured minus simulated, with the measurement's own ±2 σ."),
            _Drawing((whiteness_figure, rest), _RAW, left=False),
            _Drawing((orbits_figure, page.motion, page.fitted), ORBITS),
            _Drawing((spectrum_figure, rest), SPECTRUM),
        ]
    if whitened:
        drawings.append(_Drawing((whiteness_figure, white_residuals(one)), _WHITENED, left=False, of="-whitened"))
    return [*drawings, _Drawing((cross_figure, one), _CROSS, left=False)]


def _run(page: RunPage, tests: dict[str, float], order: int, drawings: list[_Drawing], made: list[Html]) -> Html:
    sides: dict[bool, list[object]] = {True: [], False: []}
    for drawing, picture in zip(drawings, made, strict=True):
        sides[drawing.left].append(figure(picture, drawing.words, of=f"run-{order}{drawing.of}"))
    words = [f"{key.replace('_', ' ').replace('ljung box', 'Ljung-Box')} {value:.3g}" for key, value in tests.items()]
    return tag(
        "section",
        tag("h2", "Run ", tag("span", page.name, class_="name")),
        tag("p", f"{frames_of(page).sentence().capitalize()}. Tests: {', '.join(words)}."),
        tag("div", *(tag("div", *sides[left], class_="stack") for left in (True, False)), class_="grid"),
        id=f"run-{order}",
        class_="run",
    )


_MOTION = (
    "Measured against simulated with the joint derivatives (table 8.8's check, figures 8.10 to 8.14 of the thesis)."
)
_RAW = (
    "Residuals as measured: autocorrelation with the 95 % band of white noise, and histogram against the normal curve. "
    "Stems that swing are a motion that the equations do not know; short ones above the band are the camera's or codec's colour."
)
_WHITENED = (
    "The same after the fit's whitening: what its weights and errors rest on. Stems belong within the band here."
)
_CROSS = (
    "Cross-correlation of the whitened residuals with the line's force in the simulated tow (the input of the hull), with the "
    "95 % band of independence. Stems beyond it at positive lags: the residuals still hold an answer to the force."
)

__all__ = ["identify_page", "write_identify_page"]
