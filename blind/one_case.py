"""One case of a blind check, by its seed: its hull, camera, noise and tows, and how large its effects are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .truth.camera import camera_of
from .truth.cases import Case, RunTruth
from .truth.forms import FORMS, IN_EACH_RUN, IN_SOME_RUNS, SINCE_A_RUN, Form, first_form
from .truth.hulls import FREE, HULLS
from .truth.sizes import FORCES, MASS_ARMS, MOMENTS, OUTSIDE, RUDDER_ARM, RUDDER_N_RAD, TOLD, Range

COLOURED = 0.5
"""Share of the cases whose picture noise has a colour."""
SMALL = {"tension_n": 0.004, "tow_point_m": 0.0005, "line_m": 0.0005, "speed_m_s": 0.001}
"""Standard deviations of the settings: tension and speed as shares, lengths in metres."""
MASS_SD = 0.003
"""Of the weighing, as a share."""
SURGE_MASS, POWER = (1.02, 1.08), (1.8, 2.0)
"""m - X_udot as a share of m; how resistance grows with the speed through the water."""
X_VR, X_VV, X_RR = (0.0, 1.0), (-1.2, 0.0), (-0.02, 0.02)
"""Shares of -Y_vdot, of m/Lpp and of m Lpp."""
STIFFNESS_N_M, LINE_DAMPING = (20000.0, 60000.0), (0.05, 0.3)
"""Of a taut line, and its damping as a share of the critical one for surge. 0.9 m of 0.5 mm steel wire or braided aramid has 20 to
45 kN/m. At 20 kN/m a tow differs from that on a line without stretch by a chi-square of 3 to 25 after all refitting, at 6 kN/m by
30 to 310: that would be a soft line, and no null."""
HISTORY = 0.1
"""Share of the cases, beside those with a clock's delay, that give the tension as a history."""
SCATTER = 0.03
"""Of a hull's numbers from case to case."""
LONGEST = 1.4
"""The longest line of a case, over the hull's own."""
LARGEST_GROWTH_1_S = 0.012
"""A hull whose tows grow faster than this is drawn again: over a record of a minute twice as large, no more."""
REACH_M, FILLED = 0.5, 0.94
"""How far marks may stray sideways on a hull of 2.66 m, and the share of the picture that all of it fills."""
TOW_POINTS = (0.56, 0.60, 0.64, 0.68)
"""Ahead of the LCG, as shares of the length between perpendiculars."""


def case_of(
    name: str,
    kind: str,
    effects: list[str],
    seed: list[int],
    coloured: bool | None = None,
    video: bool = False,
    forms: Mapping[str, str] | None = None,
) -> Case:
    """One case.

    Parameters
    ----------
    name : of the case
    kind, effects : see ``Case``
    seed : of its numbers
    coloured : random forces and a shaking camera; None: drawn
    video : films instead of tracks
    forms : effect -> its form; the first, where none is named
    """
    rng = np.random.default_rng([*seed, 5])
    hull_name = str(rng.choice(list(HULLS), p=[0.6, 0.4]))
    hull = _hull(hull_name, rng)
    size = hull["length_pp"] / 2.66
    coloured = bool(rng.random() < COLOURED) if coloured is None else coloured
    runs = _runs(hull, rng)
    camera, datum = _camera(hull, runs, video, rng)
    history = "sync_delay" in effects or bool(rng.random() < HISTORY)
    numbers: dict[str, float] = {}
    named = {effect: (forms or {}).get(effect, first_form(effect)) for effect in effects if effect in FORMS}
    for effect in effects:
        numbers |= _numbers(effect, named.get(effect, ""), hull, rng, len(runs))
    return Case(
        name,
        int(rng.integers(2**31)),
        kind,
        effects,
        numbers,
        hull_name,
        hull,
        camera,
        {
            "bow": (hull["marker_bow"], 0.19 * size + _off(0.02, rng), 0.15 + 0.15 * float(rng.random())),
            "stern": (hull["marker_stern"], 0.23 * size + _off(0.02, rng), 0.15 + 0.15 * float(rng.random())),
        },
        datum,
        _noise(hull, coloured, rng),
        runs,
        history=history,
        video=video,
        form=named,
    )


def _hull(name: str, rng: np.random.Generator) -> dict[str, float]:
    """A hull like one of the two, whose tows from the foremost and aftmost point grow slowly if at all."""
    while True:
        hull = dict(HULLS[name])
        for key in FREE:
            hull[key] *= 1 + SCATTER * float(rng.normal())
        hull |= _surge(hull, rng)
        if max(_growth(hull, point * hull["length_pp"]) for point in TOW_POINTS) < LARGEST_GROWTH_1_S:
            return hull


def _surge(hull: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """What a tow needs beside the six: the hull in surge, its mass as weighed, the line."""
    mass, length = hull["mass"] * (1 + SCATTER * float(rng.normal())), hull["length_pp"]
    return {
        "mass": mass,
        "tension": hull["tension"] * (1 + SCATTER * float(rng.normal())),
        "surge_mass": mass * float(rng.uniform(*SURGE_MASS)),
        "x_vr": (hull["m"] - mass) * float(rng.uniform(*X_VR)),
        "x_vv": mass / length * float(rng.uniform(*X_VV)),
        "x_rr": mass * length * float(rng.uniform(*X_RR)),
        "power": float(rng.uniform(*POWER)),
        "mass_stated": mass * (1 + MASS_SD * float(rng.normal())),
        "stiffness_n_m": number((*STIFFNESS_N_M, "log"), rng),
        "line_damping": float(rng.uniform(*LINE_DAMPING)),
    }


def _growth(hull: dict[str, float], x_t: float) -> float:
    """The largest real part of the roots of the linear tow (theory.md 2), 1/s."""
    u, pull, line = hull["speed_ref"], hull["tension"], LONGEST * hull["line"]
    m, i = hull["m"], hull["i"]
    back = [-pull / line, -pull * (1 + x_t / line)]
    matrix = np.array(
        [
            [0, u, 1, 0],
            [0, 0, 0, 1],
            [back[0] / m, back[1] / m, hull["y_v"] / m, hull["y_r"] / m],
            [x_t * back[0] / i, x_t * back[1] / i, hull["n_v"] / i, hull["n_r"] / i],
        ]
    )
    return float(np.linalg.eigvals(matrix).real.max())


def _off(size: float, rng: np.random.Generator) -> float:
    return float(size * (2 * rng.random() - 1))


def number(span: Range, rng: np.random.Generator) -> float:
    """A number of a range.

    Parameters
    ----------
    span : smallest, largest, how it is drawn: evenly, by its logarithm, or so of either sign
    rng : that draws
    """
    low, high, how = span
    if how == "even":
        return float(rng.uniform(low, high))
    value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return value if how == "log" or rng.random() < 0.5 else -value


def ranges_of(effect: str, form: str) -> Form:
    """Ranges of a form's numbers.

    Parameters
    ----------
    effect, form : by their names; what is in no library has one form
    """
    return FORMS[effect][form] if effect in FORMS else OUTSIDE[effect]


def _numbers(effect: str, form: str, hull: dict[str, float], rng: np.random.Generator, runs: int) -> dict[str, float]:
    found = _sized(effect, form, hull, rng)
    if effect == "added_mass_coupling" and form == first_form(effect):  # potential flow makes the two nearly one
        found["added_mass_coupling.n_vdot"] = found["added_mass_coupling.y_rdot"] * float(rng.uniform(0.7, 1.3))
    if effect in IN_SOME_RUNS and IN_SOME_RUNS[effect] in (None, form):
        chosen = rng.choice(runs, 2 if rng.random() < 0.5 else 1, replace=False)
        found = {f"{name}@{run}": value for run in sorted(chosen.tolist()) for name, value in found.items()}
    if SINCE_A_RUN.get(effect) == form:  # a next run, too
        first = int(rng.integers(1, runs))
        found = {f"{name}@{run}": value for run in range(first, runs + 1) for name, value in found.items()}
    if IN_EACH_RUN.get(effect) == form:
        others = [_sized(effect, form, hull, rng) for _ in range(runs)]
        found = {f"{name}@{run}": value for run, own in enumerate([*others, found]) for name, value in own.items()}
    return found | _when_turned(form, found, rng, runs) if effect == "camera_shift" else found


def _sized(effect: str, form: str, hull: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Numbers of a form for a hull."""
    pull, length = hull["tension"] / 3.96, hull["length_pp"] / 2.66
    found: dict[str, float] = {}
    for key, span in ranges_of(effect, form).items():
        name, value = f"{effect}.{key}", number(span, rng)
        if name in FORCES:
            value *= pull
        if name in MOMENTS:
            value *= pull * length
        if name in MASS_ARMS:
            value *= hull["m"] / 149.19 * length
        found[name] = value
    return found


def _when_turned(form: str, turn: Mapping[str, float], rng: np.random.Generator, runs: int) -> dict[str, float]:
    """When a camera was turned, in and about what."""
    if form == "little by little":
        return {}
    found: dict[str, float] = {}
    when = rng.random() if form in (first_form("camera_shift"), "one axis") else 1.0
    if when > 0.5:  # else it was turned before the first run
        found["camera_shift.first_run"] = float(rng.integers(0, runs))
    if when > 0.75:
        found["camera_shift.time_s"] = float(rng.uniform(8, 35))
    if form == "one axis":
        kept = sorted(turn)[int(rng.integers(len(turn)))]
        found |= {name: 0.0 for name in turn if name != kept}
    return found


def _camera(
    hull: dict[str, float], runs: list[RunTruth], video: bool, rng: np.random.Generator
) -> tuple[dict[str, float], list[tuple[float, float, float]]]:
    """A camera behind and above the model that holds all tows and the datum points in its picture, and these points."""
    size = hull["length_pp"] / 2.66
    middles = [-run.stated["line_m"] - run.stated["tow_point_m"] for run in runs]
    back, front = min(middles) + hull["marker_stern"], max(middles) + hull["marker_bow"]
    datum = [
        (round(x, 3), round(y * size, 3), 0.0)
        for x in (back + 0.1 * size, (back + front) / 2, front - 0.1 * size)
        for y in (-0.85, 0.85)
    ]
    width, height = (960, 540) if video else (1280, 720)
    numbers = {
        "x_m": back - 1.0 * size + _off(0.1 * size, rng),
        "y_m": 0.1 * size * float(rng.normal()),
        "z_m": -2.6 * size + _off(0.1 * size, rng),
        "aim_x_m": (2 * back + front) / 3,
        "tilt_rad": 0.02 * float(rng.normal()),
        "f_px": 1.0,
        "cx_px": 0.0,
        "cy_px": 0.0,
        "k1": float(rng.uniform(-0.08, 0.02)),
        "k2": 0.0,
        "width_px": float(width),
        "height_px": float(height),
    }
    centre = {"cx_px": width / 2 + 4.0 * float(rng.normal()), "cy_px": height / 2 + 4.0 * float(rng.normal())}
    reach = [(x, y, 0.2 * size) for x in (back, front) for y in (-REACH_M * size, REACH_M * size)]
    seen = np.abs(camera_of(numbers).pixels(np.array([*datum, *reach])))
    largest = FILLED * min(width / 2 / seen[:, 0].max(), height / 2 / seen[:, 1].max())
    focal = min(largest, 1300.0 * width / 1280) * float(rng.uniform(0.96, 1.0))
    return numbers | centre | {"f_px": focal}, datum


def _noise(hull: dict[str, float], coloured: bool, rng: np.random.Generator) -> dict[str, float]:
    pull, length = hull["tension"] / 3.96, hull["length_pp"] / 2.66
    white = number((0.06, 0.14, "log"), rng)
    side = number((0.001, 0.01, "log"), rng) * pull
    return {
        "white_px": white,
        "shake_px": number((0.015, 0.07, "log"), rng) if coloured else 0.0,
        "shake_s": number((0.2, 1.2, "log"), rng),
        "side_n": side if coloured else 0.0,
        "moment_n_m": side * length * number((0.5, 1.5, "log"), rng) if coloured else 0.0,
        "force_s": number((0.7, 3.0, "log"), rng),
        "stated_px": round(white * float(rng.uniform(0.85, 1.2)), 3),
        "coloured": float(coloured),
    }


def _runs(hull: dict[str, float], rng: np.random.Generator) -> list[RunTruth]:
    count, speed, line = int(rng.integers(4, 7)), hull["speed_ref"], hull["line"]
    points = list(TOW_POINTS) if count == 6 else [TOW_POINTS[i] for i in sorted(rng.choice(4, 3, replace=False))]
    plan = [(p, 1.0, 1.0) for p in points]
    plan.append((float(rng.choice(points)), float(rng.choice([0.66, LONGEST])), 1.0))
    if count > 4:
        plan.append((float(rng.choice(points)), 1.0, float(rng.choice([0.7, 0.8]))))
    found = []
    for point, longer, faster in plan:
        beta = float(rng.choice([0.0, 0.0, 0.05, -0.05, 0.1, -0.1]))
        stated = {
            "tow_point_m": round(point * hull["length_pp"], 4),
            "line_m": round(longer * line, 4),
            "speed_m_s": round(faster * speed, 4),
            "y_m": round(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.12, 0.22)) * hull["length_pp"] / 2.66, 3),
            "beta_rad": beta,
        }
        run = tow_of(hull, stated, rng)
        start = {"y_m": 0.004 * float(rng.normal()), "beta_rad": 0.004 * float(rng.normal())}
        found.append(replace(run, small=run.small | start))
    return found


def tow_of(hull: dict[str, float], stated: dict[str, float], rng: np.random.Generator) -> RunTruth:
    """A tow by what is stated of it but its pull: the settings' small errors, and R as somebody read it from a straight tow.

    Parameters
    ----------
    hull : its numbers
    stated : settings of the run, but its pull
    rng : that draws
    """
    small = {
        name: (stated[name] if name == "speed_m_s" else 1.0) * sd * float(rng.normal())
        for name, sd in SMALL.items()
        if name != "tension_n"
    }
    straight = hull["tension"] * ((stated["speed_m_s"] + small["speed_m_s"]) / hull["speed_ref"]) ** hull["power"]
    read = round(straight * (1 + SMALL["tension_n"] * float(rng.normal())), 4)
    return RunTruth({**stated, "tension_n": read}, {**small, "tension_n": straight - read})


def told(case: Case, what: str, rng: np.random.Generator) -> Case:
    """The case with one of ``TOLD``, in every run of another size.

    Parameters
    ----------
    case : as drawn
    what : of ``TOLD``
    rng : that draws
    """
    found = {
        f"{name}@{run}": number(span, rng) * (case.hull["length_pp"] / 2.66 if name.endswith("_m") else 1.0)
        for run in range(len(case.runs))
        for name, span in TOLD[what].items()
    }
    if what.startswith("rudder"):
        y_delta = float(rng.uniform(*RUDDER_N_RAD)) * case.hull["tension"] / 3.96
        found["rudder.y_delta"] = y_delta
        found["rudder.n_delta"] = y_delta * case.hull["length_pp"] * float(rng.uniform(*RUDDER_ARM))
    return replace(case, told=found)
