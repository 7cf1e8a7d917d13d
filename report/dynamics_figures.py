"""Pictures of how a tow moves, without time: angle against angle, what is left by frequency, the hull's answer by frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from .draw import (
    BLACK,
    BLUE,
    GREY,
    MEASURED,
    ORANGE,
    SKY,
    VECTOR_LIMIT,
    VERMILION,
    Columns,
    headroom,
    label,
    legend,
    new_figure,
    svg_image,
)
from .html import Html
from .run_figures import held, in_degrees
from .series import Array, Residuals, measured_rows, spectrum

if TYPE_CHECKING:
    from ..simulate.model import Hull, Tow

LOWEST_RAD_S, HIGHEST_RAD_S, POINTS = 0.05, 5.0, 200
"""Range and number of the frequencies drawn: a choice about a towed model's swing."""
STEP = 1e-5
"""Relative step of the central differences behind the Bode diagram's band."""


def orbits_figure(motion: pd.DataFrame, fitted: pd.DataFrame | None) -> Html:
    """alpha against beta, and beta against y_CG: measured, and simulated with the fitted derivatives.

    Parameters
    ----------
    motion : motion table
    fitted : the fit's motion, or None
    """
    drawing, axes = new_figure(3.3, columns=2)
    data = {"measured": in_degrees(motion, measured_rows(motion))}
    if fitted is not None:
        data["fit"] = in_degrees(fitted)
    for ax, x, y in ((axes[0], "beta_deg", "alpha_deg"), (axes[1], "y_cg_m", "beta_deg")):
        for name, part in data.items():
            if name == "measured":
                many = len(part[x]) > VECTOR_LIMIT
                ax.plot(part[x], part[y], ".", color=MEASURED, markersize=9, label=name, rasterized=many)
            else:
                ax.plot(part[x], part[y], color=VERMILION, linewidth=1.1, label="simulated fit", zorder=3)
        ax.axhline(0, color=GREY, linewidth=0.6)
        ax.axvline(0, color=GREY, linewidth=0.6)
    label(axes[0], "β, heading (deg)", "α, tow line (deg)")
    label(axes[1], r"$y_{CG}$ (m)", "β, heading (deg)")
    headroom(axes[0], 0.2)
    legend(axes[0], columns=2)
    words = "tow line angle against heading, heading against sideways place"
    return svg_image(drawing, words, "orbits", {name: held(part) for name, part in data.items()})


def spectrum_figure(rest: Residuals) -> Html:
    """Spectra of the residuals of y and beta, each with the level that white noise of the same size would have."""
    drawing, axes = new_figure(2.9, columns=2)
    data: dict[str, Columns] = {}
    for ax, values, colour, name, unit in (
        (axes[0], 1e3 * rest.y_m, BLUE, "y", "mm"),
        (axes[1], np.degrees(rest.beta_rad), ORANGE, "beta", "deg"),
    ):
        frequency_hz, density, level = spectrum(rest.t_s, values)
        data[name] = {"frequency_hz": frequency_hz, f"density_{unit}2_per_hz": density, "white": level}
        if level > 0:
            ax.loglog(frequency_hz, density, color=colour, linewidth=1.3, marker="o", markersize=2.5)
            ax.axhline(level, color=BLACK, linestyle="--", linewidth=1, label="white noise of this size")
            low, high = ax.get_ylim()
            ax.set_ylim(low, high * (high / low) ** 0.15)  # room for the legend
        label(ax, "frequency (Hz)", f"{'y' if name == 'y' else 'β'} residual ({unit}²/Hz)")
        ax.tick_params(which="both", labelsize=8)
    legend(axes[0], columns=1)
    return svg_image(drawing, "spectra of the residuals of sideways place and heading", "spectrum", data)


@dataclass(frozen=True)
class Answer:
    """What the Bode diagram is of.

    Attributes
    ----------
    hull : with the fitted derivatives
    covariance : (6, 6) of the six
    tow : where the force works, and how fast the model goes
    swings_rad_s : frequencies at which the runs swing
    """

    hull: Hull
    covariance: Array
    tow: Tow
    swings_rad_s: tuple[float, ...]


def bode_figure(found: Answer) -> Html:
    """Gain and phase of y and beta over the line's lateral force (8.27), with 95 % bands of the derivatives' errors."""
    drawing, axes = new_figure(4.6, (1, 1))
    omega = np.geomspace(LOWEST_RAD_S, HIGHEST_RAD_S, POINTS)
    middle = _bodes(found.hull, found.tow, omega)
    six = np.asarray(found.hull.six, dtype=float)
    slopes = np.empty((6, *middle.shape))
    for k in range(6):
        step = np.zeros(6)
        step[k] = STEP * abs(six[k])
        ends = [_bodes(_with(found.hull, six + sign * step), found.tow, omega) for sign in (1, -1)]
        slopes[k] = (ends[0] - ends[1]) / (2 * step[k])
    half = 1.96 * np.sqrt(np.maximum(np.einsum("kabn,kl,labn->abn", slopes, found.covariance, slopes), 0))
    data: dict[str, Columns] = {}
    for output, (name, text, colour, pale, dashed) in enumerate((
        ("y", "y (m/N)", BLUE, SKY, False), ("beta", "β (rad/N)", VERMILION, ORANGE, True),
    )):  # fmt: skip
        for which, ax in enumerate(axes):
            value, wide = middle[output, which], half[output, which]
            ax.fill_between(omega, value - wide, value + wide, color=pale, alpha=0.35, linewidth=0)
            ax.plot(omega, value, color=colour, linewidth=1.7, linestyle="--" if dashed else "-", label=text)
        data[name] = {
            "omega_rad_s": omega,
            "gain_db": middle[output, 0],
            "gain_half_95_db": half[output, 0],
            "phase_deg": middle[output, 1],
            "phase_half_95_deg": half[output, 1],
        }
    for ax in axes:
        ax.set_xscale("log")
        for k, swing in enumerate(found.swings_rad_s):
            ax.axvline(swing, color=GREY, linewidth=0.9, linestyle=":", label="swing of a run" if k == 0 else None)
    label(axes[0], y="gain (dB)")
    label(axes[1], "frequency (rad/s)", "phase (deg)")
    legend(axes[0], columns=3)
    axes[0].set_xlim(LOWEST_RAD_S, HIGHEST_RAD_S)
    return svg_image(drawing, "Bode diagram: place and heading over the lateral force of the line", "bode", data)


def _bodes(hull: Hull, tow: Tow, omega_rad_s: Array) -> Array:
    """(y | beta, gain dB | phase deg, n)."""
    from ..identify.methods.transfer import bode, open_loop_transfer

    functions = open_loop_transfer(hull, tow)
    both = (bode(functions[name], omega_rad_s) for name in ("y", "beta"))
    return np.array([[b.gain_db, b.phase_deg] for b in both])


def _with(hull: Hull, six: Array) -> Hull:
    names = ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")
    return replace(hull, **{name: float(value) for name, value in zip(names, six, strict=True)})
