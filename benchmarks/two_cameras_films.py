"""Tows rendered before two cameras that are not synchronised: a run folder with both films, and the truth of their clocks.

The renderer draws the same simulated motion twice: at the first camera's frames, and at the second camera's, whose clock begins
elsewhere and runs at another rate. Lens, picture noise, ripples, reflections and H.264 are those of the sample recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomlkit
from scipy.interpolate import CubicSpline

from towline.record.run import RUN_FILE
from towline.record.scenario import FilmTable, ScenarioFile
from towline.record.toml import check_tables
from towline.record.x264 import x264_options
from towline.simulate.render import camera_of, film_frames
from towline.simulate.scenario import read_scenario, simulate_scenario

DENSE_HZ = 200.0
"""The motion is simulated so often and taken between by a spline: exact to far below a micrometre."""
X264 = ("aq-mode=0", "no-dct-decimate=1", "deblock=-2,-2")
NAMES = ("port", "starboard")
POSE = ["x_cg_m", "y_cg_m", "beta_rad", "heave_m", "roll_rad", "pitch_rad"]


@dataclass(frozen=True)
class Filmed:
    """What was rendered.

    Attributes
    ----------
    folder : run folder
    offset_s, rate : of the second clock
    motion : truth, dense, on the first clock
    """

    folder: Path
    offset_s: float
    rate: float
    motion: pd.DataFrame

    def truth(self, t_s: np.ndarray) -> np.ndarray:
        """x, y, heading, heave, roll, pitch (n, 6) at times of the first clock."""
        columns = self.motion.reindex(columns=POSE, fill_value=0.0).to_numpy()
        return CubicSpline(self.motion["t_s"].to_numpy(), columns)(t_s)


def film_two(
    scenario: Path,
    folder: Path,
    poses: tuple[dict[str, Any], dict[str, Any]],
    ends_s: tuple[float, float],
    rates_hz: tuple[float, float],
    offset_s: float,
    rate: float,
    seed: int,
    size_px: tuple[int, int] | None = None,
    crf: int = 20,
) -> Filmed:
    """Render a scenario before two cameras.

    Parameters
    ----------
    scenario : scenario.toml with [film]
    folder : run folder that is made; one that is whole already is taken as it is
    poses : [film.pose] of each camera
    ends_s : of each camera, when it stops, on the first clock; the first begins at 0, the second at ``offset_s``
    rates_hz : of each
    offset_s, rate : t_first = offset_s + (1 + rate) t_second
    seed : of noise and picks
    size_px : of the picture, the lens scaled with it; None: the scenario's
    crf : of H.264
    """
    file = read_scenario(scenario)
    motion = dense_motion(file, scenario.parent, min(0.0, offset_s), max(ends_s))
    filmed = Filmed(folder, offset_s, rate, motion)
    return film_motion(filmed, file, poses, ends_s, rates_hz, seed, size_px, crf)


def dense_motion(file: ScenarioFile, where: Path, begin_s: float, end_s: float) -> pd.DataFrame:
    """What the model does from one time of the first clock to another, released at the first."""
    time = file.time.model_copy(update={"rate_hz": DENSE_HZ, "duration_s": end_s - begin_s})
    motion = simulate_scenario(file.model_copy(update={"time": time}), where)
    return motion.assign(t_s=motion["t_s"] + begin_s)


def film_motion(
    filmed: Filmed,
    file: ScenarioFile,
    poses: tuple[dict[str, Any], dict[str, Any]],
    ends_s: tuple[float, float],
    rates_hz: tuple[float, float],
    seed: int,
    size_px: tuple[int, int] | None = None,
    crf: int = 20,
) -> Filmed:
    """Render a motion before two cameras; the rest as ``film_two``."""
    folder, offset_s, rate = filmed.folder, filmed.offset_s, filmed.rate
    if (folder / RUN_FILE).is_file():
        return filmed
    folder.mkdir(parents=True, exist_ok=True)
    cameras = []
    for index in (0, 1):
        zero, step = (0.0, 1.0) if index == 0 else (offset_s, 1.0 + rate)
        own_s = np.arange(np.floor((ends_s[index] - zero) / step * rates_hz[index])) / rates_hz[index]
        first_s = zero + step * own_s
        seen = pd.DataFrame(filmed.truth(first_s), columns=pd.Index(POSE)).assign(t_s=first_s)
        own = as_filmed(file, poses[index], seed + index, size_px, crf)
        name = f"{NAMES[index]}.mp4"
        _encode(folder / name, film_frames(own, seen), own, rates_hz[index])
        cameras.append(_camera(own, NAMES[index], name, seed + index))
    document = {
        "name": folder.name,
        "kind": file.kind,
        "camera": cameras,
        "marker": [
            {**m.model_dump(exclude={"peak_dn", "width_px"}, exclude_none=True, exclude_defaults=True), "look": m.look}
            for m in file.marker
        ],
        "tow": file.tow.model_dump(
            exclude={"resistance_n", "line_stiffness_n_m", "line_damping_n_s_m"},
            exclude_none=True,
            exclude_defaults=True,
        ),
        "model": file.model.model_dump(exclude_none=True, exclude_defaults=True),
        "water": file.water.model_dump(exclude_none=True),
    }
    (folder / RUN_FILE).write_text(tomlkit.dumps(_plain(document)), encoding="utf-8")
    return filmed


def as_filmed(
    file: ScenarioFile, pose: dict[str, Any], seed: int, size_px: tuple[int, int] | None, crf: int
) -> ScenarioFile:
    """The scenario as one of the cameras sees it."""
    content = file.model_dump(exclude_none=True)
    content["seed"] = seed
    content["film"]["pose"] = pose
    content["film"]["crf"] = crf
    if size_px is not None:
        lens = content["film"]["camera"]
        share = size_px[0] / lens["image_size_px"][0]
        lens.update({key: share * (lens[key] + 0.5) - 0.5 for key in ("cx_px", "cy_px")})
        lens.update({key: share * lens[key] for key in ("fx_px", "fy_px")})
        lens["image_size_px"] = size_px
    return check_tables(content, ScenarioFile, "scenario.toml")


def _camera(own: ScenarioFile, name: str, video: str, seed: int) -> dict[str, object]:
    """Its [[camera]]: lens, and the datum as a person would pick it."""
    film: FilmTable | None = own.film
    assert film is not None
    pixel = camera_of(own).project(np.array([point.tank_m for point in film.datum]))
    pixel = pixel + film.pick_sigma_px * np.random.default_rng([seed, 77]).standard_normal(pixel.shape)
    datum = [
        {"name": p.name, "pixel_px": [float(v) for v in at], "tank_m": list(p.tank_m), "sigma_px": film.pick_sigma_px}
        for p, at in zip(film.datum, pixel, strict=True)
    ]
    return {
        "name": name,
        "video": video,
        "lens": film.camera.model_dump(exclude_none=True, exclude={"sd"}),
        "datum": datum,
    }


def _encode(path: Path, frames: Iterator[tuple[int, float, np.ndarray]], own: ScenarioFile, rate_hz: float) -> None:
    """H.264 at a constant rate."""
    import av
    import cv2

    assert own.film is not None
    rate = Fraction(rate_hz).limit_denominator(10_000)
    with av.open(str(path), "w") as container:
        options = {"crf": str(own.film.crf), "preset": "veryfast", "bf": "0", **x264_options(*X264)}
        stream = container.add_stream("libx264", rate=rate, options=options)
        stream.pix_fmt = "yuv420p"
        stream.width, stream.height = own.film.camera.image_size_px
        stream.codec_context.thread_count = 1
        stream.codec_context.time_base = 1 / rate
        for index, _, bgr in frames:
            yuv = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420), dtype=np.uint8)
            frame = av.VideoFrame.from_ndarray(yuv, format="yuv420p")
            frame.pts, frame.time_base = index, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _plain(value: Any) -> Any:
    """Tuples as lists, for TOML."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, (list, tuple)) else value
