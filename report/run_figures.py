"""The pictures of one run: pixel tracks, motion, residuals, whiteness."""

from __future__ import annotations

import numpy as np
import pandas as pd

from .draw import (
    BLACK,
    BLUE,
    GREY,
    MARKER_COLOURS,
    MARKER_SHAPES,
    MEASURED,
    ORANGE,
    PURPLE,
    SKY,
    VECTOR_LIMIT,
    VERMILION,
    Columns,
    cloud,
    curve,
    headroom,
    label,
    legend,
    new_figure,
    shade,
    svg_image,
    time_limits,
)
from .html import Html, join, tag
from .series import (
    Array,
    Mask,
    Residuals,
    autocorrelation,
    column,
    lost_spans,
    measured_rows,
    pieces,
    rms,
    status_is,
    usual_step,
)

LAGS = 40
"""Of the residuals' autocorrelation, in samples: a choice."""
BINS = np.arange(-4.0, 4.01, 0.5)
"""Of the residuals' histogram, in their own root mean square."""


def markers_of(tracks: pd.DataFrame) -> list[str]:
    """Marker names in the order of their appearance."""
    return [str(name) for name in tracks["marker"].drop_duplicates()]


def marker_key(tracks: pd.DataFrame) -> Html:
    """The legend of the tracks, as page text: names are a user's and stay out of the picture."""
    rows = [
        tag("span", tag("i", "", style=f"background:{MARKER_COLOURS[k % len(MARKER_COLOURS)]}"), name, class_="swatch")
        for k, name in enumerate(markers_of(tracks))
    ]
    return tag("p", join(rows, " "), class_="key")


def tracks_figure(tracks: pd.DataFrame) -> Html:
    """u and v over time per marker; below, one lane per marker that is open where the marker was lost."""
    names = markers_of(tracks)
    lanes = 0.32 + 0.17 * len(names)
    figure, axes = new_figure(3.9 + lanes, (1.7, 1.7, lanes))
    times = np.unique(column(tracks, "t_s"))
    everywhere = np.ones(len(times), dtype=bool)
    data: dict[str, Columns] = {}
    for k, name in enumerate(names):
        rows = tracks[tracks["marker"].astype(str) == name]
        t_s = column(rows, "t_s")
        good = np.isfinite(column(rows, "u_px")) & ~status_is(rows, "lost")
        predicted = good & status_is(rows, "predicted")
        seen = np.isin(times, t_s[good])
        everywhere &= seen
        by_hand = good & status_is(rows, "by_hand")
        state = np.select([predicted, by_hand, good], ["predicted", "by_hand", "measured"], "lost")
        u_px, v_px = (np.where(good, column(rows, key), np.nan) for key in ("u_px", "v_px"))
        data[name] = {"t_s": t_s, "u_px": u_px, "v_px": v_px, "status": state}
        colour, shape = MARKER_COLOURS[k % len(MARKER_COLOURS)], MARKER_SHAPES[k % len(MARKER_SHAPES)]
        for ax, values in zip(axes, (u_px, v_px), strict=False):
            cloud(ax, t_s, values, good & ~predicted, colour=colour, shape=shape)
            cloud(ax, t_s, values, predicted, colour=colour, shape=shape, joined=False, size=3, alpha=0.25)
        _lane(axes[2], t_s, good & ~predicted, len(names) - k, colour, 0.7)
        _lane(axes[2], t_s, predicted, len(names) - k, colour, 0.25)
    shade(axes[:2], lost_spans(times, everywhere))
    axes[1].invert_yaxis()
    axes[2].set_ylim(0.4, len(names) + 0.6)
    axes[2].set_yticks([])
    axes[2].grid(False, axis="y")
    label(axes[0], y="u, right (px)")
    label(axes[1], y="v, down (px)")
    label(axes[2], x="time (s)", y="seen")
    time_limits(axes, times)
    return svg_image(figure, "pixel coordinates u and v of every marker over time", "tracks", data)


def _lane(ax, t_s, mask, level: int, colour: str, height: float) -> None:
    if not mask.any():
        return
    half = usual_step(t_s) / 2
    bars = [(t_s[s.start] - half, t_s[s.stop - 1] - t_s[s.start] + 2 * half) for s in pieces(t_s, mask)]
    ax.broken_barh(bars, (level - height / 2, height), facecolors=colour, linewidth=0)


def motion_figure(motion: pd.DataFrame, fitted: pd.DataFrame | None, truth: pd.DataFrame | None) -> Html:
    """alpha, beta and y_CG over time: measured, simulated with the fitted derivatives, truth.

    Parameters
    ----------
    motion : motion table
    fitted : the fit's motion, or None
    truth : true motion, or None
    """
    figure, axes = new_figure(5.2, (1, 1, 1))
    good, predicted = measured_rows(motion), status_is(motion, "predicted")
    t_s = column(motion, "t_s")
    data = {"measured": in_degrees(motion, good), "predicted": in_degrees(motion, predicted & ~good)}
    data |= {name: in_degrees(table) for name, table in (("fit", fitted), ("truth", truth)) if table is not None}
    rows = (("alpha_deg", "α, tow line (deg)"), ("beta_deg", "β, heading (deg)"), ("y_cg_m", r"$y_{CG}$ (m)"))
    for ax, (key, text) in zip(axes, rows, strict=True):
        for name, part in data.items():
            if name in ("measured", "predicted"):
                colour = MEASURED if name == "measured" else PURPLE
                if name == "measured" or np.isfinite(part[key]).any():
                    cloud(
                        ax,
                        part["t_s"],
                        part[key],
                        colour=colour,
                        text=name,
                        joined=name == "measured",
                        size=6.5,
                        alpha=1,
                    )
            elif name == "fit":
                curve(ax, part["t_s"], part[key], colour=VERMILION, text="simulated fit", width=1.1)
            else:
                curve(ax, part["t_s"], part[key], colour=BLACK, text="truth", dashed=True, width=1.0)
        label(ax, y=text)
    shade(axes, lost_spans(t_s, good))
    headroom(axes[1], 0.3)
    legend(axes[1], columns=5)
    label(axes[2], x="time (s)")
    time_limits(axes, t_s)
    words = "tow line angle, heading and sideways place over time: measured and simulated"
    return svg_image(figure, words, "motion", {name: held(part) for name, part in data.items()})


def in_degrees(motion: pd.DataFrame, rows: Mask | None = None) -> dict[str, Array]:
    """Times, angles in degrees and place of a motion; NaN for what it does not hold, and outside of ``rows``.

    Parameters
    ----------
    motion : motion table
    rows : which rows; None: all
    """
    found = {f"{name}_deg": np.degrees(column(motion, f"{name}_rad")) for name in ("alpha", "beta")}
    found["y_cg_m"] = column(motion, "y_cg_m")
    if rows is not None:
        found = {key: np.where(rows, values, np.nan) for key, values in found.items()}
    return {"t_s": column(motion, "t_s"), **found}


def held(part: dict[str, Array]) -> dict[str, Array]:
    """Rows that hold more than their time."""
    known = np.isfinite(np.array([values for key, values in part.items() if key != "t_s"])).any(axis=0)
    return {key: values[known] for key, values in part.items()}


def residuals_figure(rest: Residuals) -> Html:
    """Measured minus simulated over time, with the band of +-2 sigma."""
    figure, axes = new_figure(3.9, (1, 1))
    rows = (
        (1e3 * rest.y_m, 1e3 * rest.sigma_y_m, r"$y_{CG}$ residual (mm)"),
        (np.degrees(rest.beta_rad), np.degrees(rest.sigma_beta_rad), "β residual (deg)"),
    )
    good = np.isfinite(rest.y_m)
    for ax, (values, sigma, text) in zip(axes, rows, strict=True):
        known = np.isfinite(sigma)
        ax.fill_between(
            rest.t_s, -2 * sigma, 2 * sigma, where=known.tolist(), facecolor=SKY, alpha=0.35, linewidth=0,
            label="±2 σ", rasterized=len(sigma) > VECTOR_LIMIT,
        )  # fmt: skip
        ax.axhline(0, color="#1A1A1A", linewidth=0.8)
        cloud(ax, rest.t_s, values, good, colour=GREY, joined=False, text="measured − simulated")
        label(ax, y=text)
        ends = 1.15 * max(float(np.nanmax(np.abs(values), initial=0.0)), 2 * float(np.nanmedian(sigma)), 1e-9)
        ax.set_ylim(-ends, ends)
    shade(axes, lost_spans(rest.t_s, good))
    headroom(axes[0], 0.2)
    legend(axes[0])
    label(axes[1], x="time (s)")
    time_limits(axes, rest.t_s)
    names = ("y_mm", "sigma_y_mm", "beta_deg", "sigma_beta_deg")
    columns = dict(zip(names, (*rows[0][:2], *rows[1][:2]), strict=True))
    words = "residuals of sideways place and heading over time with the two sigma band"
    return svg_image(figure, words, "residuals", {"": held({"t_s": rest.t_s, **columns})})


def whiteness_figure(rest: Residuals) -> Html:
    """Autocorrelation of the residuals to lag 40 with the bound of white noise, and their histogram."""
    figure, axes = new_figure(3.1, columns=2)
    left, right = axes
    lags = np.arange(LAGS + 1)
    grid = np.linspace(-4, 4, 81)
    bound = np.nan
    data: dict[str, Columns] = {}
    for values, colour, shape, text in ((rest.y_m, BLUE, "o", "y"), (rest.beta_rad, ORANGE, "s", "β")):
        rho, bound = autocorrelation(rest.t_s, values, LAGS)
        shift = -0.18 if text == "y" else 0.18
        left.vlines(lags[1:] + shift, 0, rho[1:], color=colour, linewidth=1.2)
        left.plot(lags[1:] + shift, rho[1:], linestyle="", marker=shape, markersize=3, color=colour, label=text)
        finite, spread = values[np.isfinite(values)], rms(values)
        if spread > 0:
            inside = np.clip(finite / spread, BINS[0], BINS[-1] - 1e-9)
            density, _ = np.histogram(inside, BINS, density=True)
            key = "y" if text == "y" else "beta"
            data[f"autocorrelation of {key}"] = {"lag_samples": lags[1:], "correlation": rho[1:], "white_95": bound}
            data[f"histogram of {key}"] = {"from_rms": BINS[:-1], "to_rms": BINS[1:], "density": density}
            right.hist(
                inside, bins=BINS.tolist(), density=True, histtype="step", color=colour, linewidth=1.7, label=text,
                linestyle="-" if text == "y" else "--",
            )  # fmt: skip
    right.plot(grid, np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), color=GREY, linewidth=1, label="normal")
    left.axhline(0, color="#1A1A1A", linewidth=0.8)
    if np.isfinite(bound):
        for level in (-bound, bound):
            left.axhline(level, color="#1A1A1A", linestyle="--", linewidth=1, label="white" if level > 0 else None)
    low, high = left.get_ylim()
    left.set_ylim(min(low, -0.25), max(high, 0.4))
    left.set_xlim(0, LAGS + 1)
    legend(left, columns=3)
    right.set_ylim(0, 0.62)
    legend(right, columns=3)
    label(left, "lag (samples)", "autocorrelation (–)")
    label(right, "residual / its own rms (–)", "density (–)")
    return svg_image(figure, "autocorrelation and histogram of the residuals", "whiteness", data)
