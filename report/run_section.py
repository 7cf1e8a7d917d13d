"""The page's section on one run: picture, tracks, motion, residuals, numbers, datum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.results import CameraFile, Measured, RunFit
from .draw import picture_image
from .dynamics_figures import orbits_figure, spectrum_figure
from .format import plus_minus, round_pair, significant
from .html import Html, bullets, figure, join, number, table, tag
from .run_figures import marker_key, motion_figure, residuals_figure, tracks_figure, whiteness_figure
from .sections import Frames
from .series import Residuals, column, measured_rows, outside, residuals, status_is, usual_step


@dataclass(frozen=True)
class RunPage:
    """Everything the page shows of one run.

    Attributes
    ----------
    name : the run
    picture : (h, w, 3) BGR frame with the overlay already drawn, or None
    tracks : frame, t_s, marker, u_px, v_px, sigma_u_px, sigma_v_px, status (measured | predicted | lost)
    motion : t_s, y_cg_m, beta_rad, alpha_rad, sigma_y_cg_m, sigma_beta_rad, sigma_alpha_rad, status; NaN where lost
    fitted : t_s, y_cg_m, beta_rad simulated with the fitted derivatives at the same times, biases included
    truth : t_s, y_cg_m, beta_rad, alpha_rad of rendered runs
    camera : out/camera.json
    problem : why this run failed, if it did
    """

    name: str
    picture: NDArray[np.uint8] | None
    tracks: pd.DataFrame | None
    motion: pd.DataFrame
    fitted: pd.DataFrame | None
    truth: pd.DataFrame | None
    camera: CameraFile | None
    problem: str | None = None


_NAMES = {
    "y_m": "y at the first sample",
    "beta_rad": "β at the first sample",
    "v_m_s": "sway velocity v at the first sample",
    "r_rad_s": "yaw rate r at the first sample",
    "y_b_m": "datum bias of y",
    "beta_b_rad": "datum bias of β",
    "tension_n": "line tension T",
    "tow_point_m": "tow point X_T",
    "alpha_rad": "α at the first sample",
    "y_over_sigma": "residual of y over its stated σ",
    "beta_over_sigma": "residual of β over its stated σ",
    "autocorrelation_y_lag1": "autocorrelation of y's residual, lag 1",
    "autocorrelation_beta_lag1": "autocorrelation of β's residual, lag 1",
    "noise_order_y": "order of the noise model of y",
    "noise_order_beta": "order of the noise model of β",
    "ljung_box_p_y": "Ljung-Box p of y, whitened",
    "ljung_box_p_beta": "Ljung-Box p of β, whitened",
}
# suffix -> unit shown, factor; the longest suffix that fits counts
_UNITS = {
    "_rad_s": ("deg/s", float(np.degrees(1.0))),
    "_m_s": ("m/s", 1.0),
    "_n_m": ("N m", 1.0),
    "_rad": ("deg", float(np.degrees(1.0))),
    "_m": ("m", 1.0),
    "_n": ("N", 1.0),
    "_s": ("s", 1.0),
}
_IN_MM = ("y_b_m",)
_SAMPLES = ("samples", "samples_used")


_PICTURE = (
    "A frame of the recording with what was found in it. Look for every cross sitting on its mark and the drawn datum "
    "lying on the real one."
)
_TRACKS = (
    "Where the marks stand in the picture. Look for smooth curves without jumps; hatched: at least one mark lost. The "
    "lanes below say which one: thick = measured, thin = predicted, open = lost."
)
_WHITENESS = (
    "What is left should be noise. Look for stems within the dashed lines (95 % of white noise) and bars on the bell "
    "curve (outermost bars hold all beyond). Short stems above the lines are the codec's colour, which the fit whitens; "
    "stems that swing mean a motion that the equations do not know."
)


ORBITS = (
    "The same without time: line angle against heading, heading against sideways place. A lightly damped swing is an ellipse that "
    "hardly shrinks; a spiral inwards is damped, outwards unstable. Look for the simulated line on the dots, and for a middle away "
    "from 0: a crooked hull, a rudder, a bias of the datum."
)
SPECTRUM = (
    "What is left, by frequency; dashed: white noise of the same size. Look for a level line. A rise to the left is a slow motion "
    "or a slow error, a hump at the swing's own frequency a wrong model, a narrow peak a line that springs or a shaking camera."
)


def frames_of(run: RunPage) -> Frames:
    """Frames of one run by their status; missing rows inside the record count as lost."""
    times = column(run.motion, "t_s")
    if not len(times):
        return Frames()
    good = measured_rows(run.motion)
    predicted = status_is(run.motion, "predicted") & ~good
    step = usual_step(times)
    whole = len(times) if step <= 0 else max(len(times), round((times[-1] - times[0]) / step) + 1)
    return Frames(
        int(good.sum()),
        int(predicted.sum()),
        whole - int(good.sum()) - int(predicted.sum()),
        float(times[-1] - times[0]),
    )


def run_section(run: RunPage, order: int, fit: RunFit | None) -> Html:
    """Heading, pictures in a grid, numbers; a run that failed says why and shows what it has.

    Parameters
    ----------
    run : its page
    order : number that the names of its pictures carry
    fit : of the run, or None
    """
    rest, name = residuals(run.motion, run.fitted), f"run-{order}"
    parts: list[object] = [
        tag("h2", "Run ", tag("span", run.name, class_="name")),
        tag("p", frames_of(run).sentence().capitalize() + "."),
    ]
    if run.problem:
        parts.append(tag("p", tag("strong", "This run could not be used: "), run.problem, class_="warn"))
    seen: list[object] = []
    judged: list[object] = []
    if run.picture is not None:
        alternative = "a frame of the recording with what was found in it"
        seen.append(figure(picture_image(run.picture, alternative), _PICTURE))
    if len(run.motion):
        seen.append(figure(motion_figure(run.motion, run.fitted, run.truth), _motion_words(run), of=name))
        seen.append(figure(orbits_figure(run.motion, run.fitted), ORBITS, of=name))
    seen.append(_fit_table(fit))
    if run.tracks is not None and len(run.tracks):
        judged.append(figure(tracks_figure(run.tracks), _TRACKS, before=marker_key(run.tracks), of=name))
    if rest is not None:
        judged.append(figure(residuals_figure(rest), _residual_words(rest), of=name))
        judged.append(figure(whiteness_figure(rest), _WHITENESS, of=name))
        judged.append(figure(spectrum_figure(rest), SPECTRUM, of=name))
    stacks = [tag("div", *stack, class_="stack") for stack in (seen, judged) if any(stack)]
    if run.camera is not None:
        stacks += [tag("div", _datum(run.camera)), tag("div", _camera_checks(run.camera))]
    parts.append(tag("div", *stacks, class_="grid"))
    return tag("section", *parts, id=f"run-{order}", class_="run")


def _motion_words(run: RunPage) -> str:
    words = "The motion in the tank."
    if run.fitted is not None:
        words += " Look for the simulated line running through the middle of the measured dots."
    else:
        words += " Look for smooth curves that settle or swing evenly."
    if run.truth is not None:
        words += " The truth is without the datum's bias: it may lie beside them by a constant."
    return words + " Hatched: nothing measured; only computed lines run on there."


def _residual_words(rest: Residuals) -> Html:
    shares = [outside(rest.y_m, rest.sigma_y_m), outside(rest.beta_rad, rest.sigma_beta_rad)]
    band = "the measurement's own ±2 σ" if rest.stated else "±2 times their own rms (no noise was stated)"
    return join([
        "Measured minus simulated. Look for dots spread evenly within the band, without a wave: ", band,
        f"; beyond it lie {100 * shares[0]:.1f} % (y) and {100 * shares[1]:.1f} % (β) of {rest.samples} samples, "
        "4.6 % would be normal.",
    ])  # fmt: skip


def _shown(key: str, measured: Measured) -> tuple[str, str]:
    """Value ± std and unit for people: degrees, biases of place in mm."""
    if key in _IN_MM:
        return plus_minus(1e3 * measured.value, 1e3 * measured.std), "mm"
    for suffix, (unit, factor) in _UNITS.items():
        if key.endswith(suffix):
            return plus_minus(factor * measured.value, factor * measured.std), unit
    return plus_minus(measured.value, measured.std), ""


def _fit_table(fit: RunFit | None) -> Html:
    if fit is None:
        return Html("")
    rows: list[list[object]] = []
    for group in (fit.start, fit.bias, fit.nuisance):
        for key, measured in group.items():
            text, unit = _shown(key, measured)
            rows.append([_NAMES.get(key, _words(key)), number(text), unit])
    if fit.trim_rad is not None:
        rows.append(["trim, by the stern positive", number(f"{np.degrees(fit.trim_rad):.2f}"), "deg"])
    for key, value in fit.noise.items():
        if key == "chi2_per_dof":
            rows.append(["chi² per degree of freedom (1 = the stated noise)", number(f"{value:.3g}"), ""])
        elif key == "y_m":
            rows.append(["residual of y, rms", number(significant(1e3 * value)), "mm"])
        elif key == "beta_rad":
            rows.append(["residual of β, rms", number(significant(float(np.degrees(value)))), "deg"])
        else:
            rows.append([_words(key), number(significant(value)), ""])
    rows += [[_words(key), number(f"{value:.3g}"), ""] for key, value in fit.tests.items() if key not in _SAMPLES]
    rows.append(["samples used", str(fit.samples), ""])
    return table(["quantity", "value ± std", "unit"], rows, kind="units", caption="The fit of this run")


def _words(key: str) -> str:
    return key.replace("_", " ").replace("ljung box", "Ljung-Box")


def _datum(camera: CameraFile) -> Html:
    rows = []
    for point in camera.datum:
        du, dv = point.residual_px
        size = float(np.hypot(du, dv))
        text = f"{size / point.sigma_px:.1f}" if point.sigma_px > 0 else "-"
        marked = tag("strong", text) if point.sigma_px > 0 and size > 3 * point.sigma_px else number(text)
        rows.append([point.name, number(f"{du:.2f}"), number(f"{dv:.2f}"), f"{point.sigma_px:g}", marked])
    caption = join([
        f"Datum points: picked minus projected, rms {significant(camera.rms_px)} px "
        f"(method: {_words(camera.method)}). "
        "Look for a point that stands out beyond 3 σ: it was mispicked or stands elsewhere than stated.",
    ])  # fmt: skip
    if not rows:
        return Html("")
    return table(["point", "Δu (px)", "Δv (px)", "σ (px)", "|Δ|/σ"], rows, caption=caption)


def _camera_checks(camera: CameraFile) -> Html:
    parts: list[object] = []
    if camera.uncertainty_mm:
        words = ", ".join(f"{_words(key)} {significant(value, 2)} mm" for key, value in camera.uncertainty_mm.items())
        parts.append(tag("p", f"Common error of x, y in the working area: {words}."))
    if camera.invariants:
        checks = []
        for key, measured in camera.invariants.items():
            value, scatter = round_pair(1e3 * measured.value, 1e3 * measured.std)
            checks.append([key, number(value), number(scatter)])
        words = "What must stay constant whatever the hull does: mean minus stated. Look for values near 0."
        parts.append(table(["invariant", "mean − stated (mm)", "scatter (mm)"], checks, caption=words))
    if camera.notes:
        parts += [tag("h3", "Notes of the camera"), bullets(camera.notes)]
    return join(parts)
