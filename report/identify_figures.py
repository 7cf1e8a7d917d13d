"""Pictures of a fit: do the runs agree, and does anything of the input stay in the residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .draw import BLACK, BLUE, GREEN, GREY, ORANGE, SHADE, Columns, label, legend, new_figure, svg_image
from .html import Html
from .series import Array, Residuals, cross_correlation, usual_step

if TYPE_CHECKING:
    from ..identify.consistency import Consistency, Judged

SYMBOLS = (
    r"$m-Y_{\dot v}$", r"$I-N_{\dot r}$", r"$Y_v$", r"$Y_r-mU$", r"$N_v$", r"$N_r$",
)  # fmt: skip
LARGEST_PERCENT = 60.0
"""A run that knows a derivative worse than this alone is not drawn: its bar would hide the others."""
ROOMY = 12
"""Of more runs each gets less height, and every fourth its number."""
LAG_S = 6.0
"""Cross-correlation with the input is drawn up to so many seconds either way ..."""
LAGS = 30
"""... at so many lags."""


def consistency_figure(six: Array, covariance: Array, found: Consistency, shown: tuple[int, ...]) -> Html:
    """Derivatives ``shown``, run by run, in % of the joint value: alone (dots) and left out (squares) with 95 % bars.

    Parameters
    ----------
    six, covariance : of the joint fit, (6,) and (6, 6)
    found : each run alone, and all but each
    shown : places of the derivatives in ``DERIVATIVE_UNITS``
    """
    from matplotlib.gridspec import GridSpec

    height = 0.42 * min(len(found.alone), ROOMY) + 0.16 * max(len(found.alone) - ROOMY, 0) + 1.6
    drawing, axes = new_figure(height, columns=len(shown))
    rows = np.arange(len(found.alone))[::-1]
    bars: dict[str, list[tuple[str, float, float, float]]] = {}
    for place, (i, ax) in enumerate(zip(shown, axes, strict=True)):
        joint = 196 * float(np.sqrt(covariance[i, i]) / abs(six[i]))
        ax.axvspan(-joint, joint, color=SHADE, zorder=0.5, label="joint")
        ax.axvline(0, color=BLACK, linewidth=0.8)
        reach = 2 * joint
        for parts, colour, shape, shift, name in (
            (found.alone, BLUE, "o", 0.14, "run alone"), (found.without, ORANGE, "s", -0.14, "all without it"),
        ):  # fmt: skip
            if not parts:
                continue
            value, bar = (
                100 * np.array(some) / abs(six[i])
                for some in ([p.six[i] - six[i] for p in parts], [1.96 * p.sd[i] for p in parts])
            )
            known = np.array([p.fixed[i] for p in parts]) & ~(bar > 1.96 * LARGEST_PERCENT)
            if not known.any():
                continue
            ax.errorbar(
                value[known], (rows + shift)[known], xerr=bar[known], color=colour, marker=shape, markersize=4, capsize=2,
                linewidth=1.3, linestyle="", label=name,
            )  # fmt: skip
            reach = max(reach, float((np.abs(value) + bar)[known].max()))
            kept = zip(len(rows) - rows[known], value[known], bar[known], strict=True)
            bars.setdefault(name, []).extend((_ORDER[i], float(k), float(x), float(half)) for k, x, half in kept)
        bars.setdefault("joint", []).append((_ORDER[i], np.nan, 0.0, joint))
        tick = _round_below(0.85 * reach)
        ax.set_xlim(-1.08 * reach, 1.08 * reach)
        ax.set_xticks([-tick, 0, tick], [f"−{tick:g}", "0", f"{tick:g}"])
        ax.set_ylim(-0.6, len(rows) - 0.4)
        every = 1 if len(rows) <= ROOMY else 4
        ax.set_yticks(rows[::every], [str(k + 1) if place == 0 else "" for k in range(len(rows))][::every])
        ax.set_title(SYMBOLS[i], fontsize=10.5, color=BLACK)
    label(axes[0], y="run")
    label(axes[len(axes) // 2], "difference to the joint value (%)")
    grid = axes[0].get_gridspec()
    assert isinstance(grid, GridSpec)
    grid.update(left=0.08, right=0.99, wspace=0.14, bottom=0.52 / height, top=1 - 0.36 / height)
    for place, ax in enumerate(axes):  # room for the titles
        ax.set_position(grid[0, place].get_position(drawing))
    head = ("derivative", "run", "difference_percent", "half_95_percent")
    data: dict[str, Columns] = {
        name: dict(zip(head, (list(c) for c in zip(*some)), strict=True)) for name, some in bars.items()
    }
    words = "estimates of each run alone and of all runs without it, against the joint fit"
    return svg_image(drawing, words, "consistency-" + "-".join(str(i + 1) for i in shown), data)


def _round_below(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(n for n in (1, 2, 5) if n * power <= value * (1 + 1e-9)))


def white_residuals(one: Judged) -> Residuals:
    """The whitened residuals in the form that the whiteness picture takes; unit sigma."""
    ones = np.ones(len(one.t_s))
    return Residuals(one.t_s, one.white[:, 0], one.white[:, 1], ones, ones, True)


def cross_figure(one: Judged) -> Html:
    """Cross-correlation of the whitened residuals with the line's force, with the 95 % band of independence."""
    drawing, axes = new_figure(2.7, columns=2)
    step = usual_step(one.t_s)
    every = max(1, round(LAG_S / LAGS / step)) if step > 0 else 1
    lags = every * np.arange(-LAGS, LAGS + 1)
    data: dict[str, Columns] = {}
    for ax, channel, colour, name in ((axes[0], 0, BLUE, "y"), (axes[1], 1, ORANGE, "β")):
        rho, bound = cross_correlation(one.white[:, channel], one.force_n, lags)
        data["y" if channel == 0 else "beta"] = {"lag_s": lags * step, "correlation": rho, "independent_95": bound}
        ax.vlines(lags * step, 0, rho, color=colour, linewidth=1.4)
        ax.plot(lags * step, rho, linestyle="", marker="o", markersize=2.5, color=colour)
        ax.axhline(0, color=BLACK, linewidth=0.8)
        ax.axvline(0, color=GREY, linewidth=0.6)
        for level in (-bound, bound):
            ax.axhline(level, color=BLACK, linestyle="--", linewidth=1)
        low, high = ax.get_ylim()
        ends = max(1.6 * bound, -1.1 * low, 1.1 * high)
        ax.set_ylim(-ends, ends)
        label(ax, "lag of the residual (s)", f"correlation, {name} (–)")
    return svg_image(drawing, "cross-correlation of the residuals with the line force", "cross", data)


def estimators_figure(names: list[str], values: Array, sds: Array, reference: Array, reference_sd: Array) -> Html:
    """Values in % of the reference, one row a derivative, with 95 % bars.

    Parameters
    ----------
    names : keys of the derivatives, for the screen reader only
    values, sds, reference, reference_sd : (k,)
    """
    drawing, (ax,) = new_figure(0.34 * len(names) + 0.9)
    rows = np.arange(len(names))[::-1]
    size = np.abs(reference)
    columns = {
        "derivative": names,
        "difference_percent": 100 * (values - reference) / size,
        "half_95_percent": 196 * sds / size,
        "reference_half_95_percent": 196 * reference_sd / size,
    }
    known = reference_sd > 0
    if known.any():
        ax.errorbar(
            np.zeros(len(names))[known], rows[known], xerr=columns["reference_half_95_percent"][known], color=GREEN, linestyle="",
            marker="D", markersize=5, capsize=3, label="reference, 95 %",
        )  # fmt: skip
    ax.axvline(0, color=GREEN, linewidth=1.4, label=None if known.any() else "reference")
    ax.errorbar(
        columns["difference_percent"], rows, xerr=columns["half_95_percent"], color=BLUE, linestyle="", marker="o",
        markersize=5, capsize=3, label="this fit, 95 %",
    )  # fmt: skip
    low, high = ax.get_xlim()
    ends = max(-low, high)
    ax.set_xlim(-ends, ends)
    ax.set_ylim(-0.6, len(names) - 0.4)
    ax.set_yticks(rows, [SYMBOLS[_ORDER.index(name)] for name in names])
    legend(ax, place="best", columns=1)
    label(ax, "difference to the reference (% of its size)")
    return svg_image(drawing, "the fit against the reference", "reference", {"": columns})


_ORDER = ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")
