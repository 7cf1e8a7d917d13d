"""The page's summary and its section on the derivatives; the result table that the steady section shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..record.results import DerivativesFile, SteadyFile
from .format import (
    MEANINGS,
    NONE,
    Row,
    derivative_rows,
    interval_text,
    percent,
    plus_minus,
    significant,
    to_decimals,
)
from .html import Html, bullets, join, number, safe, symbols, table, tag, unit

SYMBOLS_HTML = {
    "m_minus_y_vdot": Html("<i>m</i> − <i>Y</i><sub>v̇</sub>"),
    "i_minus_n_rdot": Html("<i>I</i> − <i>N</i><sub>ṙ</sub>"),
    "y_v": Html("<i>Y</i><sub>v</sub>"),
    "y_r_minus_mu": Html("<i>Y</i><sub>r</sub> − <i>mU</i>"),
    "n_v": Html("<i>N</i><sub>v</sub>"),
    "n_r": Html("<i>N</i><sub>r</sub>"),
    "y_delta": Html("<i>Y</i><sub>δ</sub>"),
    "n_delta": Html("<i>N</i><sub>δ</sub>"),
    "y_v_over_mass": Html("<i>Y</i><sub>v</sub>/<i>m</i>′"),
    "y_r_minus_mu_over_mass": Html("(<i>Y</i><sub>r</sub> − <i>mU</i>)/<i>m</i>′"),
    "n_v_over_inertia": Html("<i>N</i><sub>v</sub>/<i>I</i>′"),
    "n_r_over_inertia": Html("<i>N</i><sub>r</sub>/<i>I</i>′"),
    "y_delta_over_mass": Html("<i>Y</i><sub>δ</sub>/<i>m</i>′"),
    "n_delta_over_inertia": Html("<i>N</i><sub>δ</sub>/<i>I</i>′"),
    "x_v_m": Html("<i>X</i><sub>v</sub>, neutral point ahead of LCG"),
    "slope": Html("<i>k</i> of <i>X</i><sub>T</sub> = <i>X</i><sub>v</sub> + <i>k</i>/<i>F</i>"),
    "y_delta_delta": Html("<i>Y</i><sub>δ</sub>δ, rudder force"),
    "n_delta_delta": Html("<i>N</i><sub>δ</sub>δ, rudder moment"),
}
X_V = Html("<i>X</i><sub>v</sub>")
X_R = Html("<i>X</i><sub>r</sub>")


@dataclass(frozen=True)
class Frames:
    """How many frames of all runs were measured, predicted, lost, and how long they last in s."""

    measured: int = 0
    predicted: int = 0
    lost: int = 0
    duration_s: float = 0.0

    @property
    def total(self) -> int:
        """All frames."""
        return self.measured + self.predicted + self.lost

    def __add__(self, other: Frames) -> Frames:
        return Frames(
            self.measured + other.measured,
            self.predicted + other.predicted,
            self.lost + other.lost,
            self.duration_s + other.duration_s,
        )

    def sentence(self) -> str:
        """Shares in %."""
        if not self.total:
            return "no frames"
        text = (
            f"{self.total} frames over {significant(self.duration_s)} s: {_share(self.measured, self.total)} measured"
        )
        if self.predicted:
            text += f", {_share(self.predicted, self.total)} predicted through short gaps"
        return text + f", {_share(self.lost, self.total)} lost"


def _share(part: int, total: int) -> str:
    return f"{100 * part / total:.1f} %"


def points_of_action(result: DerivativesFile) -> tuple[tuple[float, float], tuple[float, float], float] | None:
    """X_v = N_v/Y_v and X_r = N_r/(Y_r - mU) with their std, and the std of X_r - X_v, m; None if one is missing."""
    keys = list(result.derivatives)
    try:
        y_v, y_r, n_v, n_r = (result.derivatives[k].value for k in ("y_v", "y_r_minus_mu", "n_v", "n_r"))
    except KeyError:
        return None
    correlation = np.array(result.correlation, dtype=float)
    if y_v == 0 or y_r == 0 or correlation.shape != (len(keys), len(keys)):
        return None
    std = np.array([d.std for d in result.derivatives.values()])
    covariance = correlation * np.outer(std, std)
    slopes = np.zeros((2, len(keys)))
    slopes[0, keys.index("n_v")], slopes[0, keys.index("y_v")] = 1 / y_v, -n_v / y_v**2
    slopes[1, keys.index("n_r")], slopes[1, keys.index("y_r_minus_mu")] = 1 / y_r, -n_r / y_r**2
    both = slopes @ covariance @ slopes.T
    gap = both[0, 0] + both[1, 1] - 2 * both[0, 1]
    spread = np.sqrt(np.maximum([both[0, 0], both[1, 1], gap], 0))
    return (n_v / y_v, float(spread[0])), (n_r / y_r, float(spread[1])), float(spread[2])


def stability_sentence(result: DerivativesFile) -> Html:
    """The straight-line verdict with the inequality that decides it."""
    stable = result.straight_line_stable
    if result.free is not None and result.free.scale == "ratios":
        words = "straight-line stable" if stable else "straight-line unstable"
        return join(["The hull is ", tag("strong", words), "; the ratios decide that without any force being known."])
    verdict = tag("strong", "straight-line stable" if stable else "straight-line unstable")
    points = points_of_action(result)
    if points is None or stable != (points[1][0] > points[0][0]):  # Y_r - mU of unusual sign turns the inequality
        product = Html(
            "<i>Y</i><sub>v</sub><i>N</i><sub>r</sub> − <i>N</i><sub>v</sub>(<i>Y</i><sub>r</sub> − <i>mU</i>)"
        )
        return join(["The hull is ", verdict, ": ", product, " > 0." if stable else " is not above 0."])
    (x_v, x_v_std), (x_r, x_r_std), gap_std = points
    sentence = [
        "The hull is ", verdict, ": ", X_R, f" {'>' if x_r > x_v else '<' if x_r < x_v else '='} ", X_V, ", with ", X_R,
        " = ", number(plus_minus(x_r, x_r_std, "m")), " and ", X_V, " = ", number(plus_minus(x_v, x_v_std, "m")),
        " ahead of LCG; they lie ", number(plus_minus(abs(x_r - x_v), gap_std, "m")), " apart",
    ]  # fmt: skip
    if abs(x_r - x_v) < 2 * gap_std:
        sentence.append(" – less than two standard deviations, so the verdict is not certain")
    sentence += [". A tow runs stable only with its tow point ahead of ", X_V, "."]
    return join(sentence)


def summary(
    runs: int, failed: int, frames: Frames, derivatives: DerivativesFile | None, steady: SteadyFile | None
) -> Html:
    """One paragraph in plain words: what was measured and what came out.

    Parameters
    ----------
    runs : how many
    failed : how many failed
    frames : how many, and how many were lost
    derivatives : of the tows, or None
    steady : steady.json, or None
    """
    what = "free" if derivatives is not None and derivatives.method == "free_run" else "towed"
    words: list[object] = [f"{runs} run{'' if runs == 1 else 's'} of the {what} model, {frames.sentence()}."]
    if failed:
        words.append(f" {failed} of them could not be used; the reason stands with the run.")
    if derivatives is not None and derivatives.derivatives:
        words += _derivatives_words(derivatives)
    elif derivatives is not None:
        words.append(" No derivative could be identified.")
    if steady is not None:
        low, high = steady.x_v_interval_m
        words += [
            f" The steady part of {len(steady.tows)} tow{'' if len(steady.tows) == 1 else 's'} puts the neutral point ",
            X_V, " ", tag("strong", number(plus_minus(steady.x_v_m.value, steady.x_v_m.std, "m"))),
            " ahead of LCG (95 %: ", number(interval_text(low, high)), " m).",
        ]  # fmt: skip
    return tag("p", join(words), class_="lead")


def _derivatives_words(result: DerivativesFile) -> list[object]:
    shares = {
        key: d.std / abs(d.value) for key, d in result.derivatives.items() if d.value != 0 and np.isfinite(d.value)
    }
    ratios = result.free is not None and result.free.scale == "ratios"
    words: list[object] = [
        f" From {len(result.runs)} of them came {len(result.derivatives)} "
        f"{'ratios of hydrodynamic derivatives to masses' if ratios else 'hydrodynamic derivatives'} at {result.speed_m_s:g} m/s"
    ]
    if shares:
        best, worst = min(shares, key=lambda k: shares[k]), max(shares, key=lambda k: shares[k])
        words.append(", standard deviation from ")
        for key, between in ((best, " to "), (worst, "")):
            d = result.derivatives[key]
            words += [f"{percent(d.value, d.std)} % (", SYMBOLS_HTML.get(key, key), ")", between]
    words.append(". ")
    words += ["The hull is straight-line ", tag("strong", "stable" if result.straight_line_stable else "unstable"), "."]
    scores = [
        (d.value - d.true_value) / d.std for d in result.derivatives.values() if d.true_value is not None and d.std > 0
    ]
    if scores:
        near = sum(abs(score) <= 2 for score in scores)
        words.append(f" {near} of {len(scores)} lie within two standard deviations of the known truth.")
    return words


def _cells(row: Row, *, primes: bool, known: bool) -> list[object]:
    symbol = SYMBOLS_HTML.get(row.key, row.symbol)
    if row.key.startswith("pairs."):
        symbol = join([X_V, " of ", row.key.removeprefix("pairs.")])
    first = join([symbol, " ", tag("small", MEANINGS[row.key])]) if primes and row.key in MEANINGS else symbol
    cells: list[object] = [first, number(_both(row.value, row.std)), unit(row.unit), number(row.percent)]
    if primes:
        cells.append(number(_both(row.prime, row.prime_std)))
    if known:
        far = row.deviation != NONE and abs(float(row.deviation)) > 2
        score = number(row.deviation)
        cells += [number(row.true), tag("strong", score) if far else score]
    return cells


def _both(value: str, std: str) -> str:
    return value if std == NONE else f"{value} +- {std}"


def result_table(rows: Sequence[Row], first: str, *, primes: bool, caption: object) -> Html:
    """Value ± std, unit, std in %, prime, truth: columns without content are left out.

    Parameters
    ----------
    rows : one a quantity
    first : head of the first column
    primes : with the columns of the prime system
    caption : below it
    """
    known = any(row.true != NONE for row in rows)
    head: list[object] = [first, "value ± std", "unit", "std, %"]
    if primes:
        head.append(Html("prime × 10<sup>3</sup>"))
    if known:
        head += ["true value", "(value − true)/std"]
    return table(head, [_cells(row, primes=primes, known=known) for row in rows], kind="units", caption=caption)


def derivatives_section(
    result: DerivativesFile, title: str = "Hydrodynamic derivatives", of: str = "derivatives"
) -> Html:
    """Table, stability, Nomoto's numbers of free runs, correlation, what is not identifiable, notes; ``of``: its place's name.

    Parameters
    ----------
    result : the derivatives' file
    title : of the section
    of : its id
    """
    water = "" if result.density_kg_m3 is None else f"ρ = {result.density_kg_m3:g} kg/m³, "
    system = (
        f"At U = {result.speed_m_s:g} m/s. Prime system with {water}"
        f"L = {result.length_pp_m:g} m; "
        f"model mass m = {result.mass_kg:g} kg. Estimator: {result.method.replace('_', ' ')}, {result.form} equations."
    )
    if result.free is not None and result.free.scale == "ratios":
        system += " m′ = m − Yv̇ and I′ = I − Nṙ: the masses with the water that moves with the hull."
    parts: list[object] = [
        tag("h2", title),
        result_table(derivative_rows(result), "derivative", primes=True, caption=system),
        tag("p", stability_sentence(result)),
        _nomoto(result),
        _beside(result),
        _trims(result),
    ]
    if result.not_identifiable:
        parts.append(
            tag(
                "div",
                tag("h3", "Not fixed by these runs"),
                bullets(map(symbols, result.not_identifiable)),
                class_="warn",
            )
        )
    parts.append(_correlation(result))
    if result.notes:
        parts += [tag("h3", "Notes on the fit"), bullets(map(symbols, result.notes))]
    return tag("section", *parts, id=of)


_NOMOTO = (
    ("gain_1_s", "K, rate of turn per rudder angle", "1/s"),
    ("time_s", "T = T1 + T2 − T3", "s"),
    ("t1_plus_t2_s", "T1 + T2", "s"),
    ("t1_times_t2_s2", "T1 T2", "s2"),
    ("t3_s", "T3", "s"),
)


def _nomoto(result: DerivativesFile) -> Html:
    """Nomoto's numbers of free runs; nothing for tows."""
    if result.free is None:
        return Html("")
    shown = [(words, result.free.nomoto[key], units) for key, words, units in _NOMOTO if key in result.free.nomoto]
    rows = [[words, number(plus_minus(one.value, one.std)), unit(units)] for words, one, units in shown]
    caption = "Turning under the rudder (Nomoto), at the same speed; δ positive to port. An unstable hull has K and T below 0."
    return table(["number", "value ± std", "unit"], rows, kind="units", caption=caption)


BESIDE = {
    "x_udot_kg": ("<i>X</i><sub>u̇</sub>", "kg", "water that surges along"),
    "x_vr_kg": ("<i>X</i><sub>vr</sub>", "kg", "surge force as the hull drifts and turns"),
    "x_vv_kg_m": ("<i>X</i><sub>vv</sub>", "kg/m", "surge force as it drifts"),
    "x_rr_kg_m": ("<i>X</i><sub>rr</sub>", "kg m", "surge force as it turns"),
    "resistance_exponent": ("<i>n</i>", "", "resistance ~ <i>u</i><sup>n</sup>"),
    "y_delta": ("<i>Y</i><sub>δ</sub>", "N/rad", "side force per radian of rudder"),
    "n_delta": ("<i>N</i><sub>δ</sub>", "N m/rad", "yaw moment per radian of rudder"),
    "y_bias_n": ("<i>Y</i>*", "N", "side force of an asymmetric hull"),
    "n_bias_n_m": ("<i>N</i>*", "N m", "yaw moment of an asymmetric hull"),
}
"""Numbers of the hull beside the six: symbol, unit, meaning."""


FEW_RUNS = 4
"""Each of them has its own R on the page; of more, the least and the largest."""


def _beside(result: DerivativesFile) -> Html:
    """Numbers of the hull beside the six, and the tension that the motion asks for; nothing where the line's tension is given."""
    if result.free is not None or (not result.hull and result.tension is None):
        return Html("")
    rows: list[list[object]] = []
    for key, one in result.hull.items():
        symbol, units, words = BESIDE[key]
        rows.append([_named(symbol, Html(words)), number(plus_minus(one.value, one.std)), unit(units)])
    found = result.tension
    if found is not None:
        low, high = found.interval
        said = "what is stated" if found.stated_std_rel is not None else "a bare hull's guess"
        words = f"{significant(found.factor, 3)} ({significant(low, 3)} to {significant(high, 3)}) of {said}"
        if found.z is not None:
            words += f": {to_decimals(abs(found.z), 1)} standard deviations apart"
        each = found.resistance_n
        forces = ", ".join(f"{name} {significant(value, 3)}" for name, value in each.items())
        if len(each) > FEW_RUNS:
            least, most = min(each.values()), max(each.values())
            forces = f"{significant(least, 3)} to {significant(most, 3)}, {len(each)} runs"
        rows.append([_named("<i>R</i>, by the mass alone", words), number(forces), unit("N")])
        for name, gauge in found.gauges.items():
            parts = ((gauge.scale, "of what pulls"), (gauge.zero_n, "N more"), (gauge.delay_s, "s late"))
            said = "; ".join(f"{plus_minus(one.value, one.std)} {words}" for one, words in parts)
            rows.append([_named(f"load cell of {safe(name)}", "against the motion"), number(said), ""])
    return table(
        ["beside the six", "value ± std", "unit"], rows, kind="units", caption="What the fit holds beside the six."
    )


def _named(symbol: str, words: object) -> Html:
    return join([Html(symbol), " ", tag("small", words)])


def _trims(result: DerivativesFile) -> Html:
    said = sorted({run.trim_rad for run in result.runs.values() if run.trim_rad is not None})
    if not said:
        return Html("")
    degrees = " to ".join(f"{np.degrees(trim):.2f}" for trim in ([said[0]] if len(said) == 1 else [said[0], said[-1]]))
    return tag("p", number(f"Trim {degrees}"), "°, positive by the stern.")


def _correlation(result: DerivativesFile) -> Html:
    keys = list(result.derivatives)
    if len(result.correlation) != len(keys) or not keys:
        return Html("")
    names = [SYMBOLS_HTML.get(key, safe(key)) for key in keys]
    head = tag("tr", tag("td", ""), *(tag("th", name, scope="col") for name in names))
    rows = []
    for name, values in zip(names, result.correlation, strict=True):
        cells = [tag("td", number(to_decimals(rho, 2)), style=_heat(rho)) for rho in values]
        rows.append(tag("tr", tag("th", name, scope="row"), *cells))
    words = (
        "How the errors hang together. Look for entries beyond ±0.95: those two derivatives are known much better in "
        "combination than each alone; another tow point or speed separates them."
    )
    matrix = tag("table", tag("caption", "Correlation of the derivatives' errors"), head, *rows, class_="heat")
    return tag("div", tag("div", matrix, class_="scroll"), tag("p", words, class_="caption"), class_="heatbox")


def _heat(rho: float) -> str:
    """Blue for positive, vermilion for negative, paler towards zero; the figures carry the sign as well."""
    red, green, blue = (0, 114, 178) if rho > 0 else (213, 94, 0)
    return f"background:rgba({red},{green},{blue},{min(abs(rho), 1.0) * 0.6:.2f})"


def failed_box(title: str, failed: dict[str, str]) -> Html:
    """Runs that could not be used, with why.

    Parameters
    ----------
    title : of the box
    failed : name of a run -> why it is left out
    """
    rows = [join([tag("strong", name), ": ", reason]) for name, reason in failed.items()]
    return tag("div", tag("h3", title), bullets(rows), class_="warn")
