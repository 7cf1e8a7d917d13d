"""What reality's own motion says about an effect: signatures in the picture, their noise, and the distance D between them.

D_ij = lambda_i (1 - cos^2 rho_ij), from the generator alone: the noise-free pixels of both marks (and a load cell's record, where
there is one) with and without the effect, whitened by the case's true noise, after everything that any diagnosis must refit is
projected out (derivatives, surge and the stretch of a taut line within what a person knows of them, each run's start, settings
within their errors, place and heading of the marks, the camera's pose from the picked datum). Signatures are taken at a twentieth
of the size and scaled up: a straight line from no effect, so that D counts what can be told and not how far a fit has to walk.
What is there or is not (a slack line, a line that something holds at a tension) is taken at its whole size, and so is a soft line:
with a twentieth of its compliance it would be stiffer than the line of every other tow, and ring faster than the motion's step can
follow. A slack line is no rival of others (its window is free).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from .response import pose_covariance
from .truth.camera import Camera, camera_of
from .truth.cases import CELL_HZ, CELL_SD, PICK_PX, Case, clean_picks, lane_of, seen
from .truth.clocks import cell_late, true_times
from .truth.hulls import FREE
from .truth.lanes import Array
from .truth.motion import ROLL, B, Path, X, Y, swim
from .truth.sight import datum_stretch

BLOCK = 8
"""Frames to a mean."""
SMALL = 0.05
"""Effects are made this small, as a share, for their derivative: their signature is taken as linear."""
STEP_S = 0.04
"""Step of the motion: twice the truth's (blind/truth/motion.py says what that changes)."""
SETTINGS = {"tension": (0.005, True), "line": (0.0007, False), "x_t": (0.0007, False), "speed": (0.0015, True)}
"""What a diagnosis grants a run (standard deviation, as a share of the value or not): the defaults of [priors]."""
SURGE = {"surge_mass": (0.03, 0), "x_vr": (0.26, 0), "x_vv": (1.2, -1), "x_rr": (0.02, 1)}
"""What it grants a hull (standard deviation as a share of the mass, times the length to a power)."""
POWER = 0.1
"""Of the growth of resistance, plainly."""
GIVES_M_N = 1 / 20000.0
"""... and of a taut line's stretch: it is as stiff as those of ``one_case``, and nobody has measured it."""
PLACE_M, HEADING_RAD = 0.0015, 0.0016
"""What it grants each run beside these: a constant error of place across the tank and of heading, standard deviations."""
START = {"y_release": 0.01, "beta_release": 0.01, "v_release": 0.01, "r_release": 0.01}
"""Steps of the start's derivatives; the start is free."""
FREE_SD = 30.0
"""What is free may be off by so many of its steps: as good as unknown."""
STRENGTH: dict[str, tuple[str, ...]] = {
    "crossflow_drag": ("drag_m", "skeg_m", "whole_m", "moduli_m", "ahead_kg_m"),
    "cubic_damping": ("side", "turn", "plain_side", "plain_turn", "mix_side", "mix_turn", "steep_side"),
    "hull_asymmetry": ("lift_n_s2_m2", "twist_n_m_s2_m2", "stall_n_s2_m2", "wire_n", "wire_n_m", "grows_n"),
    "added_mass_coupling": ("y_rdot", "n_vdot"),
    "fluid_memory": ("sway", "yaw", "ring_sway", "ring_yaw"),
    "bank_suction": ("strength_m5", "gap_n_s2_m2", "near_n_s2_m2"),
    "cross_current": ("flow_m_s", "even_m_s", "grows_m_s", "swirl_m_s"),
    "speed_drift": ("share", "ramp_share", "swing_share"),
    "tension_variation": (),
    "constant_tension": (),
    "elastic_line": ("compliance_m_n", "sag"),
    "slack_line": (),
    "tow_point_offset": ("offset_m", "slip_m", "slide_m"),
    "swivel_friction": ("moment_n_m", "dry_n_m", "oil_n_m", "grease_n_m", "post_n_m"),
    "lens_distortion": ("bend", "k1", "fisheye", "aside"),
    "deck_height": ("depth_m", "bow_m", "trim_m", "squat_m"),
    "camera_shift": ("right_rad", "down_rad", "roll_rad"),
    "datum_scale": ("scale", "ahead_scale", "aside_scale"),
    "datum_bias": ("ahead_m", "aside_m"),
    "marker_roll": ("lean_rad", "sway_rad", "turn_rad"),
    "frame_rate": ("fast", "piece_one", "piece_two", "drift"),
    "sync_delay": ("delay_s", "drift_s", "jump_s"),
    "rolling_shutter": ("readout_s", "up_s", "across_s"),
    "washboard": ("side_n", "moment_n_m"),
    "kick": ("side_n", "moment_n_m"),
    "sloshing": ("side_n",),
    "vibration": ("size_m",),
    "magnet": ("side_n", "moment_n_m"),
    "carriage_shake": ("size_m",),
    "new_mass": ("share",),
    "stick_slip": ("share",),
    "law": ("side0", "turn0", "along0", "lean0", "side1", "turn1", "along1", "lean1"),
}
"""The numbers that make an effect large or small, those of all its forms."""
WHOLE = {"elastic_line", *(effect for effect, sizes in STRENGTH.items() if not sizes)}
"""Effects whose signature is taken at their whole size."""
Way = dict[str, float]
"""A direction in which an effect moves the picture: its numbers, small."""
RIVALS: dict[str, tuple[tuple[Way, ...], ...]] = {
    "crossflow_drag": (({"drag_m": 0.01}, {"drag_m": 0.01, "tilt": 1.0}),),
    "cubic_damping": (
        ({"side": 0.1}, {"side": 0.1, "arm": 0.5}, {"turn": 0.002}),
        ({"plain_side": 0.1}, {"plain_side": 0.1, "arm": 0.5}, {"plain_turn": 0.002}),
    ),
    "hull_asymmetry": (({"lift_n_s2_m2": 0.005}, {"twist_n_m_s2_m2": 0.005}), ({"wire_n": 0.005}, {"wire_n_m": 0.005})),
    "added_mass_coupling": (({"y_rdot": 2.0}, {"n_vdot": 2.0}),),
    "fluid_memory": tuple(
        tuple({which: 0.03, "quick": 1.0, "fast_s": lag, "slow_s": lag, "arm": 0.8} for which in ("sway", "yaw"))
        for lag in (0.5, 1.5, 4.0)
    ),
    "bank_suction": (
        ({"strength_m5": 0.0005}, {"strength_m5": 0.0005, "lead": 1.0}),
        *(
            ({wall: 0.05, "power": power}, {wall: 0.05, "power": power, "lever": 0.3})
            for wall in ("gap_n_s2_m2", "near_n_s2_m2")
            for power in (1.0, 3.0)
        ),
    ),
    "cross_current": (({"flow_m_s": 0.001},), ({"even_m_s": 0.001}, {"grows_m_s": 0.001})),
    "speed_drift": (({"share": 0.002, "settle_s": 20.0}, {"ramp_share": 0.002, "ramp_end": 1.05}),),
    "tension_variation": (({"power": 1.0, "period_s": 0.6},),),
    "constant_tension": (({"weight": 1.0},),),
    "elastic_line": (({"compliance_m_n": 0.0003, "damping": 0.3},),),
    "tow_point_offset": (({"offset_m": 0.001},),),
    "swivel_friction": (({"moment_n_m": 0.003}, {"oil_n_m": 0.003}), ({"post_n_m": 0.003},)),
    "lens_distortion": (({"bend": 0.002},), ({"k1": 0.002},)),
    "camera_shift": (({"right_rad": 2e-4}, {"down_rad": 2e-4}, {"roll_rad": 2e-4}),),
    "deck_height": (({"depth_m": 0.001}, {"trim_m": 0.001}), ({"depth_m": 0.001}, {"squat_m": 0.001})),
    "datum_scale": (({"ahead_scale": 0.001}, {"aside_scale": 0.001}),),
    "datum_bias": (({"ahead_m": 0.001}, {"aside_m": 0.001}),),
    "marker_roll": tuple(
        (
            {"lean_rad": 0.005, "period_s": period, "damping": 0.7},
            {"sway_rad": 0.005, "period_s": period, "damping": 0.7},
            {"turn_rad": 0.005, "period_s": period, "damping": 0.7},
        )
        for period in (0.6, 1.5)
    ),
    "frame_rate": (({"fast": 0.001}, {"drift": 0.001}),),
    "sync_delay": (({"delay_s": 0.02}, {"drift_s": 0.02}),),
    "rolling_shutter": (({"readout_s": 0.003},), ({"across_s": 0.003},)),
}
"""Forms of the library's effects, each by the directions in which it moves the picture; a form is refitted in all of its own."""
PICKED = ("lens_distortion.", "datum_scale.")
"""Effects that move the datum's points in the picture, too."""
CELL_MEAN, CELL_SKIPS_S = 5, 3.0
"""Samples of the load cell to a mean; the spring's ring after the release, which no line without stretch has, is left out."""


@dataclass(frozen=True)
class Distances:
    """Of a case.

    Attributes
    ----------
    strength : lambda: chi-square of the effect against nothing (the weaker one of a pair)
    nearest : D to the nearest rival
    rival : its name
    rivals : name -> D
    """

    strength: float
    nearest: float
    rival: str
    rivals: dict[str, float]


@dataclass(frozen=True)
class Sensed:
    """A case made linear: whitened columns.

    Attributes
    ----------
    common : ``(n, c)`` derivatives (free), surge and the camera's pose (unit prior)
    prior : ``(c,)`` 1/sd^2 of the common numbers
    truth : effect -> ``(n, 1)`` its signature at its true size
    rivals : effect -> of each form ``(n, k)``
    rows : slice of each run's pixels (a load cell's rows, where there are any, follow them)
    whiteners : lower Cholesky factor of the covariance of each run's pixels
    eyes : of each run ``(blocks, 2, 4)``: y and heading by the four pixel numbers
    """

    common: Array
    prior: Array
    truth: dict[str, Array]
    rivals: dict[str, list[Array]]
    rows: list[slice]
    whiteners: list[Array]
    eyes: list[Array]


def distances_of(case: Case, sensed: Sensed) -> Distances:
    """D of a case's effect; of two, the one that is harder to tell.

    Parameters
    ----------
    case : as drawn
    sensed : signatures of the case
    """
    worst: Distances | None = None
    for effect in case.effects:
        other = [sensed.truth[name] for name in case.effects if name != effect]
        found = _distances(sensed, effect, other, set(case.effects))
        if worst is None or found.nearest < worst.nearest:
            worst = found
    if worst is None:
        raise ValueError(f"{case.name} holds no effect")
    return worst


def _distances(sensed: Sensed, effect: str, other: list[Array], named: set[str]) -> Distances:
    def left(columns: list[Array]) -> float:
        free = np.column_stack([sensed.common, *columns]) if columns else sensed.common
        penalty = np.concatenate([sensed.prior, np.zeros(free.shape[1] - len(sensed.prior))])
        return float(max(_left(sensed.truth[effect][:, 0], free, penalty), 0.0))

    alone = left(other)
    rivals = {name: min(left([*other, c]) for c in forms) for name, forms in sensed.rivals.items() if name not in named}
    nearest = min(rivals, key=lambda name: rivals[name])
    return Distances(alone, rivals[nearest], nearest, rivals)


def _left(signal: Array, free: Array, penalty: Array) -> float:
    scale = np.sqrt((free**2).sum(axis=0) + penalty)
    scale = np.where(scale > 0, scale, 1.0)
    columns = np.vstack([free / scale, np.diag(np.sqrt(penalty) / scale)])
    target = np.concatenate([signal, np.zeros(free.shape[1])])
    solved = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
    rest = target - columns @ solved
    return float(rest @ rest)


def linear(case: Case) -> Sensed:
    """The case's linear form about its motion without effects."""
    runs = range(len(case.runs))
    base = [lane_of(case, i, effects=False) for i in runs]
    shares = {effect: 1.0 if effect in WHOLE else SMALL for effect in case.effects}
    small = {effect: [_scaled(case, effect, lane_of(case, i), by) for i in runs] for effect, by in shares.items()}
    lanes: list[dict[str, float]] = []
    labels: list[tuple[str, int, float]] = []

    def add(label: str, run: int, lane: dict[str, float], step: float) -> None:
        labels.append((label, run, step))
        lanes.append(lane)

    known = {name: RIVALS[name] for name in RIVALS if case.history or name != "sync_delay"}
    for i in runs:
        add("base", i, base[i], 1.0)
        for name in FREE:
            add(f"common {name}", i, base[i] | {name: base[i][name] * 1.001}, 0.001)
        for name, sd in surge_sd(case).items():
            add(f"common {name}", i, base[i] | {name: base[i][name] + 0.1 * sd}, 0.1)
        # its compliance, by a step at which it does not ring faster
        gives = 1 / base[i]["stiffness_n_m"] + 0.1 * GIVES_M_N
        add("common stretch", i, base[i] | {"stiffness_n_m": 1 / gives}, 0.1)
        for name, step in START.items():
            add(f"own {name}", i, base[i] | {name: base[i].get(name, 0.0) + 0.01 * step}, 0.01)
        for name, (sd, share) in SETTINGS.items():
            size = sd * (base[i][name] if share else 1.0)
            add(f"own {name}", i, base[i] | {name: base[i][name] + 0.1 * size}, 0.1)
        for effect, cases in small.items():
            add(f"truth {effect}", i, base[i] | cases[i], shares[effect])
        for effect, ways in known.items():
            for label, way in _labelled(effect, ways):
                add(label, i, base[i] | {f"{effect}.{n}": v for n, v in way.items()}, 1.0)
    with np.errstate(all="ignore"):
        path = swim(lanes, case.duration_s + 1.5, None, STEP_S)
    return _assembled(case, lanes, labels, path, known)


def _labelled(effect: str, forms: tuple[tuple[Way, ...], ...]) -> list[tuple[str, Way]]:
    """Every direction of an effect's forms, with a name of its own."""
    return [(f"rival {effect} {f} {k}", way) for f, ways in enumerate(forms) for k, way in enumerate(ways)]


def _by_form(columns: Array, forms: tuple[tuple[Way, ...], ...]) -> list[Array]:
    """Columns of all directions, form by form."""
    ends = np.cumsum([len(ways) for ways in forms])
    return np.split(columns, ends[:-1], axis=1)


def _scaled(case: Case, effect: str, lane: dict[str, float], by: float) -> dict[str, float]:
    keys = {f"{effect}.{name}" for name in STRENGTH[effect]}
    return {n: v * (by if n in keys else 1.0) for n, v in lane.items() if n.startswith(f"{effect}.")}


def surge_sd(case: Case) -> dict[str, float]:
    """What a person does not know of the hull in surge: number of a lane -> standard deviation."""
    mass, length = case.hull["mass"], case.hull["length_pp"]
    return {name: share * mass * length**power for name, (share, power) in SURGE.items()} | {"power": POWER}


def block_times(case: Case) -> Array:
    """The middles of the blocks, s."""
    n = round(case.duration_s * case.rate_hz) // BLOCK
    return (np.arange(n) * BLOCK + (BLOCK - 1) / 2) / case.rate_hz


def block_means(case: Case, pixel: Array) -> Array:
    """``(frames, marks, 2)`` to a vector of the blocks' means.

    Parameters
    ----------
    case : as drawn
    pixel : (n, marks, 2)
    """
    n = len(block_times(case))
    return pixel[: n * BLOCK].reshape(n, BLOCK, -1).mean(axis=1).ravel()


def pictured(case: Case, lane: dict[str, float], path: Path, index: int, run: int) -> Array:
    """A lane's pixels at the blocks' middles, ``(blocks * 4,)``, less what the picked datum takes out of the camera's fault.

    Parameters
    ----------
    case : as drawn
    lane : numbers of the run
    path : motion of the lanes
    index : of the lane in ``path``
    run : its number
    """
    t_s = block_times(case)
    true_s = true_times(lane, t_s, case.duration_s)

    def pose_at(at: Array) -> Array:
        return path.at(np.clip(at, 0.0, path.t_s[-1]), index, (X, Y, B, ROLL))

    pixel = seen(case, run, lane, pose_at(true_s), true_s, pose_at)
    if any(value for name, value in lane.items() if name.startswith(PICKED)):
        picked = _picks_of(case, lane) - clean_picks(case, effects=False)
        jacobian = _pose_columns(case, np.array(case.datum))
        pose = np.linalg.lstsq(jacobian, picked.ravel(), rcond=None)[0]
        places = _places(case, pose_at(true_s))
        pixel = pixel - (_pose_columns(case, places) @ pose).reshape(pixel.shape)
    return pixel.ravel()


def celled(case: Case, lane: dict[str, float], path: Path, index: int) -> Array:
    """A lane's pull as the load cell's means have it, ``(means,)`` in standard deviations of one; empty where there is no cell.

    Parameters
    ----------
    case : as drawn
    lane : numbers of the run
    path : motion of the lanes
    index : of the lane in ``path``
    """
    if not case.history:
        return np.zeros(0)
    t_s = np.arange(CELL_SKIPS_S, case.duration_s, 1 / CELL_HZ)
    t_s = t_s[: len(t_s) // CELL_MEAN * CELL_MEAN]
    t_s = t_s + cell_late(lane, t_s, case.duration_s)
    pull = np.interp(t_s, path.t_s, path.tension_n[:, index])
    return pull.reshape(-1, CELL_MEAN).mean(axis=1) / (CELL_SD * case.hull["tension"] / np.sqrt(CELL_MEAN))


def _picks_of(case: Case, lane: dict[str, float]) -> Array:
    return camera_of(case.camera, lane).pixels(np.array(case.datum) * datum_stretch(lane))


def _places(case: Case, pose: Array) -> Array:
    x, y, b = pose[:, 0], pose[:, 1], pose[:, 2]
    return np.stack(
        [
            np.column_stack([x + a * np.cos(b), y + a * np.sin(b), np.full(len(x), depth)])
            for a, depth, _ in case.marks.values()
        ],
        axis=1,
    )


def _pose_columns(case: Case, points: Array) -> Array:
    """Pixels by the six numbers of the camera's pose, ``(points * 2, 6)``."""
    camera = camera_of(case.camera)
    still, columns = camera.pixels(points), []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        moved = camera.turned(*step[:3])
        matrix = moved.matrix.copy()
        matrix[:, 3] += step[3:]
        columns.append(((Camera(matrix, camera.lens).pixels(points) - still) / 1e-5).ravel())
    return np.column_stack(columns)


def _assembled(
    case: Case, lanes: list[dict[str, float]], labels: list[tuple[str, int, float]], path: Path, known: dict
) -> Sensed:
    runs = range(len(case.runs))
    seen_at: dict[tuple[str, int], Array] = {}
    for index, ((label, run, step), lane) in enumerate(zip(labels, lanes, strict=True)):
        told = np.concatenate([pictured(case, lane, path, index, run), celled(case, lane, path, index)])
        seen_at[label, run] = told if label == "base" else (told - seen_at["base", run]) / step
    index_of = {(label, run): i for i, (label, run, _) in enumerate(labels)}
    datum = _pose_columns(case, np.array(case.datum))
    pose_sd = np.linalg.cholesky(PICK_PX**2 * np.linalg.inv(datum.T @ datum))
    t_s = block_times(case)
    noise, moved = case.noise, None
    if noise["side_n"] > 0 or noise["moment_n_m"] > 0:
        at_base = [index_of["base", run] for run in runs]
        tows = [lanes[i] for i in at_base]
        moved = pose_covariance(tows, path, at_base, t_s, noise["side_n"], noise["moment_n_m"], noise["force_s"])
    eyes: list[Array] = []
    commons, truths, rivals, whiteners, rows, at = [], {e: [] for e in case.effects}, {e: [] for e in known}, [], [], 0
    surge = (*surge_sd(case), "stretch")
    for run in runs:
        pose = path.at(t_s, index_of["base", run], (X, Y, B, ROLL))
        places = _places(case, pose)
        camera = _pose_columns(case, places) @ pose_sd
        by_pose = _by_pose(case, pose)
        own = [seen_at[f"own {name}", run] * FREE_SD for name in START]
        own += [seen_at[f"own {name}", run] for name in SETTINGS]
        cell = np.zeros(len(own[0]) - 4 * len(t_s))
        for pixels in (by_pose[:, :, 1].ravel() * PLACE_M, by_pose[:, :, 2].ravel() * HEADING_RAD):
            own.append(np.concatenate([pixels, cell]))
        if len(cell):  # the cell's own scale
            own.append(
                np.concatenate([np.zeros(4 * len(t_s)), seen_at["base", run][4 * len(t_s) :] * SETTINGS["tension"][0]])
            )
        covariance = np.column_stack(own) @ np.column_stack(own).T + np.eye(len(own[0]))
        here = slice(0, 4 * len(t_s))
        covariance[here, here] += _noise(case, by_pose, None if moved is None else moved[run]) - np.eye(here.stop)
        factor = np.linalg.cholesky(covariance)

        def white(columns: Array, factor: Array = factor) -> Array:
            return solve_triangular(factor, columns, lower=True)

        camera = np.vstack([camera, np.zeros((len(cell), camera.shape[1]))])
        commons.append(white(np.column_stack([*(seen_at[f"common {n}", run] for n in (*FREE, *surge)), camera])))
        for effect in case.effects:
            truths[effect].append(white(seen_at[f"truth {effect}", run][:, None]))
        for effect, ways in known.items():
            columns = np.column_stack([seen_at[label, run] for label, _ in _labelled(effect, ways)])
            rivals[effect].append(white(columns))
        whiteners.append(factor[here, here])
        eyes.append(np.linalg.pinv(by_pose)[:, 1:])
        rows.append(slice(at, at + here.stop))
        at += len(factor)
    prior = np.concatenate([np.zeros(len(FREE)), np.ones(len(surge) + 6)])
    return Sensed(
        np.vstack(commons),
        prior,
        {e: np.vstack(v) for e, v in truths.items()},
        {e: _by_form(np.vstack(v), known[e]) for e, v in rivals.items()},
        rows,
        whiteners,
        eyes,
    )


def _by_pose(case: Case, pose: Array) -> Array:
    """Pixels by x, y and heading: ``(blocks, 4, 3)``."""
    camera = camera_of(case.camera)
    still, found = camera.pixels(_places(case, pose)), []
    for k in range(3):
        moved = pose.copy()
        moved[:, k] += 1e-5
        found.append((camera.pixels(_places(case, moved)) - still) / 1e-5)
    return np.stack([f.reshape(len(pose), 4) for f in found], axis=-1)


def _noise(case: Case, by_pose: Array, moved: Array | None) -> Array:
    """Covariance of the blocks' means: marks, the camera's shake, and what random forces do to the pose."""
    noise, t_s = case.noise, block_times(case)
    n = len(t_s)
    found = np.eye(4 * n) * noise["white_px"] ** 2 / BLOCK
    if noise["shake_px"] > 0:
        offsets = (np.arange(BLOCK)[:, None] - np.arange(BLOCK)[None, :]) / case.rate_hz
        lag = np.abs(t_s[:, None] - t_s[None, :])[:, :, None, None] + np.where(
            (t_s[:, None] >= t_s[None, :])[:, :, None, None], offsets, -offsets
        )
        shake = noise["shake_px"] ** 2 * np.exp(-np.abs(lag) / noise["shake_s"]).mean(axis=(2, 3))
        both = np.kron(np.ones((2, 2)), np.eye(2))
        found += np.kron(shake, both)
    if moved is not None:
        found += np.einsum("iax,ixjy,jby->iajb", by_pose, moved, by_pose).reshape(4 * n, 4 * n)
    return found


__all__ = ["Distances", "Sensed", "block_means", "block_times", "distances_of", "linear", "pictured", "surge_sd"]
