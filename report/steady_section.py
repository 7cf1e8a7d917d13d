"""The page's section on the steady tows."""

from __future__ import annotations

import numpy as np

from ..record.results import SteadyFile
from .format import interval_text, plus_minus, significant, steady_rows, tension_measured
from .html import Html, bullets, figure, join, number, table, tag
from .sections import X_V, failed_box, result_table
from .steady_figure import line_figure


def steady_section(result: SteadyFile) -> Html:
    """X_v with its interval, the line X_T over 1/F, the tows, what failed, notes of the file."""
    low, high = result.x_v_interval_m
    words: list[object] = [
        "The neutral point ", X_V, " lies ",
        tag("strong", number(plus_minus(result.x_v_m.value, result.x_v_m.std, "m"))), " ahead of LCG; 95 % interval ",
        number(interval_text(low, high)), " m",
    ]  # fmt: skip
    if result.x_v_true_m is not None:
        inside = low <= result.x_v_true_m <= high
        words.append(f"; the true {significant(result.x_v_true_m, 4)} m lies {'inside' if inside else 'outside'} it")
    words.append(". A tow can be stable only with its tow point ahead of it.")
    bracket = result.x_v_bracket
    if bracket is not None and bracket.above_m is not None and bracket.below_m is not None:
        words.append(
            f" By which tows shear off and which settle it lies from {bracket.above_m:g} to {bracket.below_m:g} m."
        )
    if result.chi2_per_dof is not None:
        words.append(
            f" Scatter of the tows about the line: chi²/dof = {significant(result.chi2_per_dof)} (about 1 fits)."
        )
    parts: list[object] = [
        tag("h2", "Steady tows"),
        tag("p", join(words)),
    ]
    drawn = line_figure(result)
    caption = join([
        "Every tow by its steady line force F. Look for points on one straight line: the place where it meets 1/F = 0 "
        "is ", X_V, ". Numbers are those of the table of tows.",
    ])  # fmt: skip
    title = "From the steady part of every tow; pairs of tows by the thesis's (4.9)."
    numbers = result_table(steady_rows(result), "quantity", primes=False, caption=title)
    numbers = tag("div", numbers, class_="numbers")
    parts.append(tag("div", figure(drawn, caption) if drawn else "", numbers, class_="grid"))
    parts.append(_tows_table(result))
    if result.stability:
        parts.append(_stability_table(result))
    if result.failed:
        parts.append(failed_box("Tows without a steady state", result.failed))
    if result.notes:
        parts += [tag("h3", "Notes on the steady tows"), bullets(result.notes)]
    return tag("section", *parts, id="steady")


def _stability_table(result: SteadyFile) -> Html:
    head: list[object] = ["run", Html("<i>X</i><sub>T</sub> (m)"), "motion", "λ (1/s)", "period (s)"]
    rows = [
        [
            name,
            f"{seen.tow_point_m:g}",
            seen.verdict,
            "-" if seen.lambda_per_s is None else number(plus_minus(seen.lambda_per_s.value, seen.lambda_per_s.std)),
            "-" if seen.period_s is None else f"{seen.period_s:.1f}",
        ]
        for name, seen in sorted(result.stability.items(), key=lambda item: item[1].tow_point_m)
    ]
    return table(head, rows, kind="tows", caption="What each record says of its stability; λ below 0 decays")


def _tows_table(result: SteadyFile) -> Html:
    force = "F (N)" if tension_measured(result) else "F/R"
    head = ["no.", "run", "X_T (m)", "α (deg)", "β (deg)", force, "steady part (s)", "settled"]
    head[2] = Html("<i>X</i><sub>T</sub> (m)")
    rows = []
    for k, (name, tow) in enumerate(result.tows.items()):
        angles = [np.degrees([angle.value, angle.std]) for angle in (tow.alpha_rad, tow.beta_rad)]
        rows.append([
            str(k + 1), name, f"{tow.tow_point_m:g}",
            *(number(plus_minus(float(value), float(std))) for value, std in angles),
            number(plus_minus(tow.force.value, tow.force.std)),
            f"{tow.span_s[0]:.1f} to {tow.span_s[1]:.1f}",
            "yes" if tow.settled else tag("strong", "no, still drifting"),
        ])  # fmt: skip
    if any(tow.trim_rad is not None for tow in result.tows.values()):
        head.append("trim by the stern (deg)")
        for row, tow in zip(rows, result.tows.values(), strict=True):
            row.append("" if tow.trim_rad is None else number(f"{np.degrees(tow.trim_rad):.2f}"))
    return table(head, rows, kind="tows", caption="The tows")
