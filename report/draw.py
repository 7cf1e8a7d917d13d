"""What every picture shares: palette, figure, shading of lost spans, the way to inline SVG. No pyplot, no global state.

Text from users never enters a picture (it stands in the page's own HTML), so no name can break one.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .html import Drawn, Html, image
from .series import Array, Mask, with_gaps

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Columns = Mapping[str, ArrayLike]
# Okabe and Ito's colour-blind-safe palette, without its yellow (too pale for a bright hall)
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
BLACK, GREY, SHADE = "#1A1A1A", "#595959", "#DADADA"
MEASURED = "#A9CCE3"
"""Of measured curves: pale, wide dots, on which the thin line of a fit that passes through them is still seen."""
MARKER_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, BLACK, SKY)
MARKER_SHAPES = ("o", "s", "^", "D", "v", "P", "X")

WIDTH_IN = 6.6
"""Width of every figure, inches: the page's column."""
DOTS_PER_INCH = 140  # of the rasterised clouds inside an SVG
VECTOR_LIMIT = 300  # more points than this are drawn as pixels
TEXT_PT = 9.5
"""Letters in a figure, points; labels half a point more, legends one less."""
_MARGINS_IN = (0.82, 0.14, 0.48, 0.16)  # left, right, bottom, top


def new_figure(height_in: float, ratios: tuple[float, ...] = (1.0,), *, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure of stacked axes (heights by ``ratios``, time axis shared) or of ``columns`` axes side by side.

    Parameters
    ----------
    height_in : of the figure, inches
    ratios : of the heights of axes one below the other
    columns : side by side
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in))
    left, right, bottom, top = _MARGINS_IN
    edges = {
        "left": left / WIDTH_IN,
        "right": 1 - right / WIDTH_IN,
        "bottom": bottom / height_in,
        "top": 1 - top / height_in,
    }
    if columns > 1:
        grid = figure.add_gridspec(1, columns, wspace=0.36, **edges)
        axes = [figure.add_subplot(grid[0, k]) for k in range(columns)]
    else:
        grid = figure.add_gridspec(len(ratios), 1, height_ratios=ratios, hspace=0.1, **edges)
        axes = []
        for k in range(len(ratios)):
            axes.append(figure.add_subplot(grid[k, 0], sharex=axes[0] if axes else None))
        for ax in axes[:-1]:
            ax.tick_params(labelbottom=False)
    for ax in axes:
        _dress(ax)
    figure.align_ylabels(axes)
    return figure, axes


def _dress(ax: Axes) -> None:
    ax.grid(True, color="#E4E4E4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=TEXT_PT, colors=BLACK, width=0.8)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.yaxis.get_major_formatter().set_useOffset(False)  # pyright: ignore[reportAttributeAccessIssue]


def label(ax: Axes, x: str = "", y: str = "") -> None:
    """Name the axes, unit included.

    Parameters
    ----------
    ax : axes that are drawn on
    x : of the abscissa
    y : of the ordinate
    """
    if x:
        ax.set_xlabel(x, fontsize=TEXT_PT + 0.5, color=BLACK)
    if y:
        ax.set_ylabel(y, fontsize=TEXT_PT + 0.5, color=BLACK)


def legend(ax: Axes, *, place: Literal["upper right", "best"] = "upper right", columns: int = 4) -> None:
    """A legend on an opaque ground; nothing where nothing is labelled.

    Parameters
    ----------
    ax : axes that are drawn on
    place : of the legend
    columns : side by side
    """
    if ax.get_legend_handles_labels()[1]:
        drawn = ax.legend(
            loc=place, ncols=columns, fontsize=TEXT_PT - 1, framealpha=0.9, borderpad=0.3, handlelength=1.8,
            columnspacing=1.2, edgecolor="#CCCCCC",
        )  # fmt: skip
        drawn.set_zorder(10)


def headroom(ax: Axes, share: float = 0.28) -> None:
    """Raise the upper limit so that a legend does not lie on the data.

    Parameters
    ----------
    ax : axes that are drawn on
    share : of the range that stays free above
    """
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + share * (high - low))


def shade(axes: list[Axes], found: list[tuple[float, float]]) -> None:
    """Shade time spans without a measurement.

    Parameters
    ----------
    axes : axes that are drawn on
    found : begin and end of each, s
    """
    for ax in axes:
        for k, (start, stop) in enumerate(found):
            text = "not measured" if k == 0 else None
            ax.axvspan(
                start, stop, facecolor=SHADE, edgecolor="#BDBDBD", hatch="///", linewidth=0, zorder=0.5, label=text
            )


def cloud(
    ax: Axes, t_s: Array, values: Array, good: Mask | None = None, *, colour: str = BLACK, text: str | None = None,
    joined: bool = True, size: float = 2.2, shape: str = "o", alpha: float = 0.75,
) -> None:  # fmt: skip
    """Measured samples: dots, and a thin line that stops at every gap; pixels rather than paths when they are many.

    Parameters
    ----------
    ax : axes that are drawn on
    t_s : (n,) times, s
    values : (n,) what is drawn
    good : (n,) of bool, those that were measured; None: all
    colour : of palette
    text : in the legend; None: none
    joined : by lines
    size : of the markers, points
    shape : of the markers, as matplotlib names it
    alpha : opacity
    """
    t, x = with_gaps(t_s, values, good)
    ax.plot(
        t, x, color=colour, linewidth=0.6 if joined else 0, marker=shape, markersize=size, markeredgewidth=0,
        alpha=alpha, rasterized=len(t) > VECTOR_LIMIT, label=text, zorder=2,
    )  # fmt: skip


def curve(
    ax: Axes, t_s: Array, values: Array, *, colour: str, text: str, dashed: bool = False, width: float = 1.7
) -> None:
    """A computed line; it stops where it has no value.

    Parameters
    ----------
    ax : axes that are drawn on
    t_s : (n,) times, s
    values : (n,) what is drawn
    colour : of palette
    text : in the legend; None: none
    dashed : a dashed line
    width : of the line, points
    """
    t, x = with_gaps(t_s, values)
    if len(t):
        style = (0, (5, 3)) if dashed else "-"
        ax.plot(t, x, color=colour, linewidth=width, linestyle=style, label=text, zorder=4 if dashed else 3)


def time_limits(axes: list[Axes], t_s: Array) -> None:
    """The time axis spans the record, no more.

    Parameters
    ----------
    axes : axes that are drawn on
    t_s : (n,) times, s
    """
    if len(t_s) > 1:
        axes[0].set_xlim(float(t_s[0]), float(t_s[-1]))


def svg_image(figure: Figure, alternative: str, name: str, data: Mapping[str, Columns]) -> Html:
    """The figure as an inline SVG image, the same bytes for the same data, with what was drawn in it.

    Parameters
    ----------
    figure : that becomes SVG
    alternative : what a screen reader says
    name : of the picture in its page
    data : part of the picture -> its columns, arrays of one length or one value for all, units in their names; the table's column
        ``series`` says which part a row is of, but of a picture of one nameless part
    """
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", dpi=DOTS_PER_INCH, metadata={"Date": None, "Creator": None})
    return image(_renumbered(stream.getvalue()), "image/svg+xml", alternative, (drawn(alternative, name, data),))


def drawn(what: str, name: str, data: Mapping[str, Columns]) -> Drawn:
    """Parts of a picture as one table; parameters as ``svg_image``.

    Parameters
    ----------
    what : text for those who do not see the picture
    name : of the picture in its page
    data : part of the picture -> its columns
    """
    import pandas as pd

    parts = []
    for series, columns in data.items():
        size = next((np.size(values) for values in columns.values() if np.ndim(values)), 1)
        part = {key: np.broadcast_to(np.asarray(values), size) for key, values in columns.items()}
        parts.append(pd.DataFrame({"series": np.full(size, series, dtype=object), **part} if series else part))
    return Drawn(name, what, pd.concat(parts, ignore_index=True) if parts else pd.DataFrame())


def _renumbered(svg: bytes) -> bytes:
    """Matplotlib's random identifiers replaced by their order of appearance."""
    names: dict[bytes, bytes] = {}
    for name in re.findall(rb'id="([a-z]+[0-9a-f]{10})"', svg):
        names.setdefault(name, b"i%d" % len(names))
    return re.sub(rb"\b([a-z]+[0-9a-f]{10})\b", lambda m: names.get(m[1], m[1]), svg) if names else svg


def picture_image(frame_bgr: NDArray, alternative: str, largest_px: int = 1280) -> Html:
    """A video frame ``(h, w, 3)`` BGR as an inline JPEG, at most ``largest_px`` wide.

    Parameters
    ----------
    frame_bgr : (h, w, 3) uint8
    alternative : text for those who do not see the picture
    largest_px : the longer side is scaled down to this
    """
    import cv2

    height, width = frame_bgr.shape[:2]
    if width > largest_px:
        frame_bgr = cv2.resize(
            frame_bgr, (largest_px, round(height * largest_px / width)), interpolation=cv2.INTER_AREA
        )
    whole = [cv2.IMWRITE_JPEG_QUALITY, 84, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", frame_bgr, whole)
    if not done:
        raise ValueError("the frame could not be encoded as JPEG")
    return image(data.tobytes(), "image/jpeg", alternative)
