"""A case: everything that reality holds, as plain numbers; from it a run's pixels follow without any further choice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .camera import camera_of
from .clocks import cell_late, true_times
from .lanes import Array, Lane
from .motion import ROLL, STEP_S, B, Path, X, Y, swim
from .noise import wandering
from .sight import datum_stretch, deeper, read_late, sighted

CAMERA_NAMES = ("lens_distortion", "deck_height", "camera_shift", "datum_scale", "frame_rate", "rolling_shutter")
PICK_PX = 0.15
"""How well the datum's points are picked, standard deviation along u and v: a choice."""
CELL_HZ, CELL_SD = 10.0, 0.005
"""Samples of the load cell, and the standard deviation of one as a share of R."""
CELL_BEFORE_S = 3.0
"""It runs this long before the release, while the line is held straight with R."""
LONG_S = 1.5
"""The motion is followed this much longer than filmed: a clock may run fast."""


@dataclass(frozen=True)
class RunTruth:
    """One tow.

    Attributes
    ----------
    stated : what run.toml says: tow_point_m, line_m, speed_m_s, tension_n, y_m, beta_rad
    small : what the truth adds to it: the same names. The truth of tension_n is R at the true speed
    """

    stated: dict[str, float]
    small: dict[str, float]


@dataclass(frozen=True)
class Case:
    """A campaign with its truth.

    Attributes
    ----------
    name, seed : of the case; the seed draws its noise
    kind : effect, pair, null, unknown
    effects : names
    numbers : ``effect.number`` -> value; ``effect.number@3`` holds for run 3 alone
    hull_name, hull : name and numbers of ``hulls``, as drawn
    camera : numbers of ``camera_of``
    marks : name -> (ahead m, depth m, height above the roll axis m)
    datum : stated points (x, y, depth), m
    noise : white_px, shake_px, shake_s, side_n, moment_n_m, force_s, stated_px, coloured
    runs : tows
    rate_hz, duration_s, static_s : the films
    history : a load cell's record of the pull (tension.csv) instead of R
    video : films instead of tracks
    told : inputs that run.toml tells, as ``numbers``
    form : effect -> its kind in the grammar of ``forms``; one that is not named has the first. Its numbers alone make the motion
    kept : effects whose form was kept out while the diagnosis was worked on
    extra : anything else that is to be kept with a case; nothing reads it
    """

    name: str
    seed: int
    kind: str
    effects: list[str]
    numbers: dict[str, float]
    hull_name: str
    hull: dict[str, float]
    camera: dict[str, float]
    marks: dict[str, tuple[float, float, float]]
    datum: list[tuple[float, float, float]]
    noise: dict[str, float]
    runs: list[RunTruth]
    rate_hz: float = 25.0
    duration_s: float = 45.0
    static_s: float = 12.0
    history: bool = False
    video: bool = False
    told: dict[str, float] = field(default_factory=dict)
    form: dict[str, str] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Case:
        """Back from ``to_json``."""
        runs = [RunTruth(**run) for run in values["runs"]]
        marks = {name: (m[0], m[1], m[2]) for name, m in values["marks"].items()}
        datum = [(d[0], d[1], d[2]) for d in values["datum"]]
        return cls(**{**values, "runs": runs, "marks": marks, "datum": datum})


def run_numbers(numbers: Mapping[str, float], index: int) -> dict[str, float]:
    """Those of ``Case.numbers`` or ``Case.told`` that hold for a run.

    Parameters
    ----------
    numbers : names -> values
    index : of the run
    """
    found: dict[str, float] = {}
    for name, value in numbers.items():
        plain, _, at = name.partition("@")
        if not at:
            found.setdefault(plain, value)
        elif int(at) == index:
            found[plain] = value
    return found


def lane_of(case: Case, index: int, effects: bool = True) -> dict[str, float]:
    """A run's numbers for ``swim``; with its small deviations from what run.toml says.

    Parameters
    ----------
    case : as drawn
    index : of the run in it
    effects : False: without what the simulator does not hold

    Returns
    -------
    name of a number -> its value, as ``swim`` takes it
    """
    run = case.runs[index]
    true = {name: run.stated[name] + run.small.get(name, 0.0) for name in run.stated}
    lane: dict[str, float] = {name: value for name, value in case.hull.items() if isinstance(value, float)}
    lane |= {
        "speed": true["speed_m_s"],
        "line": true["line_m"],
        "x_t": true["tow_point_m"],
        "tension": true["tension_n"],
        "y_release": true["y_m"],
        "beta_release": true["beta_rad"],
        "duration": case.duration_s,
    }
    lane |= run_numbers(case.told, index)
    if effects:
        lane |= run_numbers(case.numbers, index)
        if "elastic_line.sag" in lane:
            # of the hull's own tow; a metre of the line weighs the same in all: (w L/R)^2/24 of its length
            lane["elastic_line.sag"] *= (lane["line"] / case.hull["line"] * case.hull["tension"] / lane["tension"]) ** 2
    return lane


def random_forces(case: Case, rng: np.random.Generator, count: int) -> Array | None:
    """``(2 k - 1, 2, runs)`` for ``swim``, or None where the case has none.

    Parameters
    ----------
    case : as drawn
    rng : that draws
    count : how many
    """
    noise = case.noise
    if noise["side_n"] <= 0 and noise["moment_n_m"] <= 0:
        return None
    n = len(case.runs)
    side = wandering(2 * count - 1, STEP_S / 2, noise["side_n"], noise["force_s"], rng, n)
    moment = wandering(2 * count - 1, STEP_S / 2, noise["moment_n_m"], noise["force_s"], rng, n)
    return np.stack([side, moment], axis=0).transpose(2, 0, 1)


@dataclass(frozen=True)
class Filmed:
    """A run's pixels.

    Attributes
    ----------
    t_s : stated times ``(n,)``
    pixel : ``(n, marks, 2)`` with noise
    clean : without the camera's noise
    still : the same of the static record ``(k, marks, 2)``
    still_clean : of it
    true_s : when the frames were taken
    """

    t_s: Array
    pixel: Array
    clean: Array
    still: Array
    still_clean: Array
    true_s: Array


def swum(case: Case, effects: bool = True, random: bool = True, step_s: float = STEP_S) -> Path:
    """The motion of all runs of a case (with another step: without random forces only).

    Parameters
    ----------
    case : as drawn
    effects : with what the simulator does not hold
    random : with random forces
    step_s : of the integration
    """
    duration = case.duration_s + LONG_S
    steps = int(np.ceil(duration / STEP_S - 1e-9)) + 1
    forces = random_forces(case, np.random.default_rng([case.seed, 1]), steps) if random else None
    return swim([lane_of(case, i, effects) for i in range(len(case.runs))], duration, forces, step_s)


def seen(case: Case, index: int, numbers: Lane, pose: Array, true_s: Array, pose_at=None) -> Array:
    """Pixels of the marks without noise.

    Parameters
    ----------
    case : as drawn
    index : of the run
    numbers : names -> values
    pose : ``(n, 4)`` x, y, heading, roll at ``true_s``
    true_s : (n,) true times of the frames
    pose_at : times -> pose, for a sensor read row by row
    """
    found = np.empty((len(true_s), len(case.marks), 2))
    shaken = numbers.get("vibration.size_m", 0.0)
    uneven = numbers.get("marker_roll.uneven", 0.0)
    for m, (ahead, depth, above) in enumerate(case.marks.values()):
        here, late = pose, np.zeros(len(true_s))
        for turn in range(3 if pose_at is not None else 1):
            if turn and pose_at is not None:
                read = read_late(case.camera, numbers, found[:, m])
                if read is None:
                    break
                late, here = read, pose_at(true_s + read)
            x, y, b, roll = here.T
            height = above * (1 + (uneven if m == 0 else -uneven))
            aside = -height * np.sin(roll)
            if shaken and m == 0:
                phase = 2 * np.pi * numbers["vibration.rate_hz"] * (true_s + late)
                aside = aside + shaken * np.sin(phase)
            place = np.column_stack(
                [
                    x + ahead * np.cos(b) - aside * np.sin(b),
                    y + ahead * np.sin(b) + aside * np.cos(b),
                    depth + deeper(numbers, m) + height * (1 - np.cos(roll)),
                ]
            )
            found[:, m] = sighted(case.camera, numbers, index, true_s, place)
    return found


def filmed(case: Case, path: Path, index: int, effects: bool = True, noisy: bool = True) -> Filmed:
    """A run's pixels and those of its static record.

    Parameters
    ----------
    case : as drawn
    path : of the motion
    index : of the run
    effects : with what the simulator does not hold
    noisy : with noise
    """
    numbers = lane_of(case, index, effects)
    n = round(case.duration_s * case.rate_hz)
    t_s = np.arange(n) / case.rate_hz
    true_s = true_times(numbers, t_s, case.duration_s)
    what = (X, Y, B, ROLL)

    def pose_at(at: Array) -> Array:
        return path.at(np.clip(at, 0.0, path.t_s[-1]), index, what)

    clean = seen(case, index, numbers, pose_at(true_s), true_s, pose_at)
    k = round(case.static_s * case.rate_hz)
    held = np.tile(path.states[0, list(what), index], (k, 1))
    moves = ("vibration.", "rolling_shutter.", "deck_height.squat_m")
    at_rest = {name: v for name, v in numbers.items() if not name.startswith(moves)}
    before = np.arange(k) / case.rate_hz - case.static_s
    still = seen(case, index, at_rest, held, before)
    rng = np.random.default_rng([case.seed, 2, index])
    return Filmed(
        t_s,
        clean + picture_noise(case, rng, clean.shape) if noisy else clean,
        clean,
        still + picture_noise(case, rng, still.shape) if noisy else still,
        still,
        true_s,
    )


def picture_noise(case: Case, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """White noise of each mark and the camera's own shake, px.

    Parameters
    ----------
    case : as drawn
    rng : that draws
    shape : of what is drawn
    """
    noise = case.noise
    shake = wandering(shape[0], 1 / case.rate_hz, noise["shake_px"], noise["shake_s"], rng, 2)
    return noise["white_px"] * rng.normal(size=shape) + shake.T[:, None, :]


def picks(case: Case) -> Array:
    """Datum points as picked in the picture before the tows, ``(k, 2)`` px."""
    rng = np.random.default_rng([case.seed, 3])
    return clean_picks(case) + PICK_PX * rng.normal(size=(len(case.datum), 2))


def clean_picks(case: Case, effects: bool = True) -> Array:
    """The same without the picking's error.

    Parameters
    ----------
    case : as drawn
    effects : with what the simulator does not hold
    """
    numbers = case.numbers if effects else {}
    return camera_of(case.camera, numbers).pixels(np.array(case.datum) * datum_stretch(numbers))


def load_cell(case: Case, path: Path, index: int) -> tuple[Array, Array]:
    """The pull of the line as a load cell saw it (one that reads as stated): times on its own clock, and newtons.

    An observation of the tow and no input to it: what the line pulls with is in ``path``.

    Parameters
    ----------
    case : as drawn
    path : of the motion
    index : of the run
    """
    numbers = lane_of(case, index)
    rng = np.random.default_rng([case.seed, 4, index])
    true_s = np.arange(-CELL_BEFORE_S, path.t_s[-1], 1 / CELL_HZ)
    pull = np.interp(true_s, path.t_s, path.tension_n[:, index])
    pull[true_s < 0] = numbers["tension"]
    pull *= case.runs[index].stated["tension_n"] / numbers["tension"]
    noise = CELL_SD * numbers["tension"] * rng.normal(size=len(pull))
    stated = true_s - cell_late(numbers, true_s, case.duration_s)
    # a logger whose clock is set back writes nothing until it has caught up with itself
    rising = np.concatenate([[True], stated[1:] > np.maximum.accumulate(stated)[:-1] + 1e-3 / CELL_HZ])
    return stated[rising], (pull + noise)[rising]
