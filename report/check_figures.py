"""Pictures of the camera check."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .draw import BLACK, BLUE, GREY, VERMILION, Columns, label, legend, new_figure, svg_image, time_limits
from .html import Html, figure, join
from .series import Array

if TYPE_CHECKING:
    from ..geometry.checks.checked import Checked
    from ..record.check_file import CheckFile

ARROW_PX = 60.0
"""The longest residual is drawn about as long as this."""


def _residuals(found: Checked, run: int) -> tuple[Array, dict[str, Array]]:
    """Marker distances and taut line of a run over time, minus stated, mm."""
    from ..geometry.motion import invariant_series

    poses = found.poses[run]
    return poses.t_s, invariant_series(found.runs[run], poses)


def invariants_figure(found: Checked) -> Html:
    """Invariants over time, a picture per run."""
    parts = []
    for index, run in enumerate(found.runs):
        t_s, series = _residuals(found, index)
        data: dict[str, Columns] = {name: {"t_s": t_s, "off_mm": 1e3 * values} for name, values in series.items()}
        drawing, axes = new_figure(1.7 * len(series) + 0.5, tuple([1.0] * len(series)))
        for ax, (name, values) in zip(axes, series.items(), strict=True):
            ax.plot(t_s, 1e3 * values, color=BLUE, linewidth=0.6, rasterized=True)
            ax.axhline(0.0, color=BLACK, linewidth=0.8)
            low, high = np.nanpercentile(1e3 * values, [0.3, 99.7])
            margin = 0.25 * max(high - low, 0.2)
            ax.set_ylim(min(low - margin, -margin), max(high + margin, margin))
            label(ax, y="mm")
            what = "taut line" if name == "taut line" else "marker distance"
            ax.text(0.01, 0.94, what, transform=ax.transAxes, fontsize=9, va="top", color=GREY)
        for scored in found.check.named[:1]:
            extra = scored.fault.extra
            if extra is not None and extra.kind != "point" and extra.index == index:
                begin, end = extra.span_s
                for ax in axes:
                    if np.isfinite(end):
                        ax.axvspan(begin, end, color=VERMILION, alpha=0.18)
                    else:
                        ax.axvline(begin, color=VERMILION, linewidth=1.5)
        label(axes[-1], x="t (s)")
        time_limits(axes, t_s)
        words = f"{run.name}: {', '.join(series)}: measured minus stated. They should lie on 0 whatever the hull does."
        shown = svg_image(drawing, f"invariants of {run.name} over time", f"run-{index + 1}-invariants", data)
        parts.append(figure(shown, words))
    return join(parts)


def map_figure(file: CheckFile) -> Html:
    """Common error over the working area."""
    from matplotlib.gridspec import GridSpec

    grid = file.uncertainty
    drawing, axes = new_figure(3.5, columns=2)
    grid_of_axes = axes[0].get_gridspec()
    assert isinstance(grid_of_axes, GridSpec)
    grid_of_axes.update(right=0.92, top=0.9)  # room for the numbers beside the bars and the titles
    for ax, values, name in zip(axes, (grid.x_mm, grid.y_mm), ("x", "y"), strict=True):
        lines = ax.contourf(grid.y_m, grid.x_m, np.array(values).T, levels=8, cmap="cividis")
        bar = drawing.colorbar(lines, ax=ax, format="{x:.3g}")
        bar.ax.tick_params(labelsize=8)
        ax.set_title(f"sd of {name} (mm)", fontsize=9.5, color=BLACK, pad=3)
        label(ax, x="y (m)", y="x (m)" if name == "x" else "")
    words = (
        "What camera, datum picks and heights leave open about a place, common to the whole run: it does not average away. "
        "Datum picks nearer to the working area, or finer ones, make it smaller."
    )
    y_m, x_m = (part.ravel() for part in np.meshgrid(grid.y_m, grid.x_m, indexing="ij"))
    data = {"x_m": x_m, "y_m": y_m, "sd_x_mm": np.ravel(grid.x_mm), "sd_y_mm": np.ravel(grid.y_mm)}
    return figure(svg_image(drawing, "map of the common error of places", "map", {"": data}), words)


def picture_figure(found: Checked) -> Html | None:
    """Datum residuals and the marks' paths, coloured by what the distance is off by, in the picture's own coordinates."""
    run = found.runs[0]
    points = run.file.datum
    pixel = np.array([p.pixel_px for p in points])
    residual = found.datum.residual_px
    drawing, (ax,) = new_figure(4.0)
    drawn = None
    data: dict[str, Columns] = {
        "datum": {
            "name": [p.name for p in points],
            "u_px": pixel[:, 0],
            "v_px": pixel[:, 1],
            "picked_minus_projected_u_px": residual[:, 0],
            "picked_minus_projected_v_px": residual[:, 1],
        }
    }
    for index, film in enumerate(found.check.bundle.films):
        left = found.check.null.normal.left[index]
        off = np.sqrt((left**2).sum(axis=1))
        for mark in range(film.pixel_px.shape[1]):
            u_px, v_px = film.pixel_px[:, mark].T
            name = f"run {index + 1}, mark {mark + 1}"
            data[name] = {"name": name, "u_px": u_px, "v_px": v_px, "misfit_sigma": off}
            drawn = ax.scatter(
                u_px, v_px, c=off, s=4, cmap="cividis", vmin=0, vmax=max(3.0, np.nanmax(off)), rasterized=True
            )
    if drawn is not None:
        bar = drawing.colorbar(drawn, ax=ax)
        bar.set_label("misfit of the frame, in sigma", fontsize=8)
    longest = np.hypot(*residual.T).max()
    times = 10.0 ** np.floor(np.log10(ARROW_PX / max(longest, 1e-3)))
    times = times * max(n for n in (1, 2, 5) if n * times * longest <= ARROW_PX)
    ax.quiver(*pixel.T, *(times * residual).T, angles="xy", scale_units="xy", scale=1, color=VERMILION, width=0.004)
    ax.plot(*pixel.T, "s", color=BLUE, markersize=5, label="datum points")
    for k, (u, v) in enumerate(pixel):
        ax.annotate(str(k + 1), (u, v), textcoords="offset points", xytext=(5, 4), fontsize=8)
    ax.set_aspect("equal")
    ax.invert_yaxis()
    label(ax, x="u (px)", y="v (px)")
    legend(ax, place="best")
    names = ", ".join(f"{k + 1} {p.name}" for k, p in enumerate(points))
    words = (
        f"Arrows: picked minus projected, {times:g} times enlarged; dots: marks, by how badly their frame fits. {names}"
    )
    return figure(svg_image(drawing, "datum residuals and marks in the picture", "picture", data), words)
