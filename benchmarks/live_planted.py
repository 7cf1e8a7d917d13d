"""Live tows with a known fault: windows of the sample films, changed from a random moment on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from towline.geometry import DatumFit
from towline.geometry.checks.filmed import half_sine
from towline.identify.cut import hull_reach
from towline.live.watch import WALL_M
from towline.pipeline.stages import fit_run_datum
from towline.record.run import Run, read_run
from towline.record.tables import read_motion, read_tracks
from towline.simulate.render import film_frames
from towline.simulate.scenario import read_scenario
from towline.vision import Frame, frame_of, read_frames

KINDS = ("mark", "camera", "line", "wall", "clock")
WINDOW_S = 20.0
EARLIEST_S, LATEST_S = 4.0, 16.0
NUDGE_DEG = 0.2
SLACK_S, SLACK_M = 1.0, (0.015, 0.04)
COVER_PX = 12
CLOCK_S = (0.1, 1.0)

Coming = Iterator[tuple[Frame, float, float]]
"""Frame, the source's stamp, arrival."""


@dataclass(frozen=True)
class Film:
    """A sample film with its truth."""

    run: Run
    fit: DatumFit
    motion: pd.DataFrame
    tracks: pd.DataFrame
    codec: str = "h264"


@dataclass(frozen=True)
class Case:
    """A live tow: what comes, and what is wrong with it."""

    run: Run
    fit: DatumFit
    codec: str
    frames: Callable[[], Coming]
    begins_s: float
    words: str


def bases(samples: Path) -> Iterator[Film]:
    """The sample films."""
    for path in sorted(samples.glob("*/*/run.toml")):
        run = read_run(path.parent)
        truth = path.parent / "truth"
        yield Film(run, fit_run_datum(run), read_motion(truth / "motion.csv"), read_tracks(truth / "tracks.csv"))


def planted(film: Film, kind: str | None, rng: np.random.Generator) -> Case:
    """A case: a window of ``film`` with a fault of ``kind``, or none."""
    length = float(film.motion["t_s"].iloc[-1])
    first_s = float(rng.uniform(0.0, length - WINDOW_S))
    begins_s = float(rng.uniform(EARLIEST_S, LATEST_S))
    at_s = first_s + begins_s

    def clean() -> Coming:
        for frame in read_frames(film.run.source_path, (first_s, first_s + WINDOW_S)):
            yield frame, frame.t_s - first_s, frame.t_s - first_s

    case = Case(film.run, film.fit, film.codec, clean, begins_s, f"{film.run.name} from {first_s:.2f} s")
    if kind is None:
        return case
    return {"mark": _covered, "camera": _nudged, "line": _slack, "wall": _near_wall, "clock": _stepping}[kind](
        film, case, first_s, at_s, rng
    )


def _changed(case: Case, begins_s: float, change: Callable[[Frame], np.ndarray]) -> Callable[[], Coming]:
    def frames() -> Coming:
        for frame, t_s, arrived_s in case.frames():
            if t_s < begins_s:
                yield frame, t_s, arrived_s
            else:
                picture = change(frame)
                yield replace(frame, luma=picture), t_s, arrived_s

    return frames


def _covered(film: Film, case: Case, first_s: float, at_s: float, rng: np.random.Generator) -> Case:
    """A disc of the ground's grey stands before one mark from then on."""
    import cv2

    marker = str(rng.choice([m.name for m in film.run.file.marker]))
    there = film.tracks[film.tracks["marker"] == marker].set_index("frame")[["u_px", "v_px"]]

    def change(frame: Frame) -> np.ndarray:
        picture = frame.luma.copy()
        u, v = (round(x) for x in there.loc[frame.index])
        around = picture[max(v - 20, 0) : v + 20, max(u - 20, 0) : u + 20]
        cv2.circle(picture, (u, v), COVER_PX, float(np.median(around)), -1)
        return picture

    frames = _changed(case, case.begins_s, change)
    return replace(case, frames=frames, words=f"{case.words}: {marker} covered at {case.begins_s:.2f} s")


def _nudged(film: Film, case: Case, first_s: float, at_s: float, rng: np.random.Generator) -> Case:
    """The camera turned by 0.2 degrees about a random axis across its view."""
    import cv2
    from scipy.spatial.transform import Rotation

    camera = film.run.file.camera
    assert camera is not None
    angle = rng.uniform(0, 2 * np.pi)
    inner = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    turn = Rotation.from_rotvec(np.radians(NUDGE_DEG) * np.array([np.cos(angle), np.sin(angle), 0.0])).as_matrix()
    moved = inner @ turn @ np.linalg.inv(inner)

    def change(frame: Frame) -> np.ndarray:
        rows, columns = frame.luma.shape
        return cv2.warpPerspective(frame.luma, moved, (columns, rows), borderMode=cv2.BORDER_REPLICATE)  # pyright: ignore

    frames = _changed(case, case.begins_s, change)
    return replace(case, frames=frames, words=f"{case.words}: camera nudged at {case.begins_s:.2f} s")


def _slack(film: Film, case: Case, first_s: float, at_s: float, rng: np.random.Generator) -> Case:
    """The tow point comes nearer to the post in half a sine of a second: drawn anew."""
    amount_m = float(rng.uniform(*SLACK_M))
    scenario = read_scenario(film.run.folder / "scenario.toml")
    inside = film.motion["t_s"].between(first_s, first_s + WINDOW_S)
    motion = film.motion[inside].copy()
    t_s, alpha = motion["t_s"].to_numpy(), motion["alpha_rad"].to_numpy()
    nearer = amount_m * half_sine(t_s, at_s, at_s + SLACK_S)
    motion["x_cg_m"] += nearer * np.cos(alpha)
    motion["y_cg_m"] -= nearer * np.sin(alpha)

    def frames() -> Coming:
        for (index, _, picture), time_s in zip(film_frames(scenario, motion), t_s, strict=True):
            yield frame_of(picture, index, time_s - first_s), time_s - first_s, time_s - first_s

    words = f"{case.words}: {1e3 * amount_m:.0f} mm slack at {case.begins_s:.2f} s"
    return replace(case, frames=frames, codec="rawvideo", words=words)


def _near_wall(film: Film, case: Case, first_s: float, at_s: float, rng: np.random.Generator) -> Case:
    """The tank is so wide that the hull comes within 5 cm of its wall in this window, for the first time some way into it."""
    model, water = film.run.file.model, film.run.file.water
    assert model is not None
    assert water is not None
    inside = film.motion["t_s"].between(first_s, first_s + WINDOW_S)
    motion = film.motion[inside]
    reach = np.abs(motion["y_cg_m"].to_numpy()) + hull_reach(model, motion["beta_rad"].to_numpy())
    t_s = motion["t_s"].to_numpy() - first_s
    # the first moment at which the hull is as far out as it will be at a random share of its largest way
    most = reach.max()
    least = reach[t_s < EARLIEST_S].max() + 0.002
    limit = float(rng.uniform(min(least, most - 0.001), most - 0.001))
    begins_s = float(t_s[reach > limit][0])
    width_m = 2 * (limit + WALL_M)
    file = film.run.file.model_copy(update={"water": water.model_copy(update={"tank_width_m": width_m})})
    words = f"{case.words}: wall at 5 cm at {begins_s:.2f} s"
    return replace(case, run=Run(film.run.folder, file), begins_s=begins_s, words=words)


def _stepping(film: Film, case: Case, first_s: float, at_s: float, rng: np.random.Generator) -> Case:
    """The source's clock steps ahead, or one of its steps is uneven, while pictures come as before."""
    step_s = float(rng.uniform(*CLOCK_S))

    def frames() -> Coming:
        for frame, t_s, arrived_s in case.frames():
            yield frame, t_s + (step_s if t_s >= case.begins_s else 0.0), arrived_s

    return replace(case, frames=frames, words=f"{case.words}: clock steps by {step_s:.2f} s at {case.begins_s:.2f} s")


__all__ = ["KINDS", "Any", "Case", "Film", "bases", "planted"]
