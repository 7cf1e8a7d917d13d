"""scenario.toml -> a filmed run with its truth: video, run.toml, truth/."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..__version__ import __version__
from ..geometry.camera import Camera
from ..record.errors import InputError, VideoError
from ..record.files import sha256_of_file, sha256_of_texts, write_text
from ..record.looks import in_words, is_spot, spot_names
from ..record.results import TruthFile, write_result
from ..record.run import RUN_FILE
from ..record.scenario import FilmTable, ScenarioFile
from ..record.tables import write_table
from ..record.x264 import x264_options
from .model import ExtraForce, Hull, Tow
from .picture_frames import PICK_SEED, film_frames
from .scenario import hull_of, read_scenario, simulate_scenario
from .scene import camera_of, film_of, true_tracks

__all__ = ["camera_of", "film_frames", "render_scenario", "true_tracks"]

SCENARIO_FILE = "scenario.toml"
_MADE_HERE = (RUN_FILE, "video.mp4", "video.mkv", "truth", "out")
_SMALLEST_SIGMA_PX = 1e-3
"""An exact pick is stated with this: a sigma of 0 would be no weight."""
_RATE_DENOMINATOR = 10_000
"""Frame rates are written as fractions with a denominator up to this: 30000/1001 among them."""
_X264 = ("aq-mode=0", "no-dct-decimate=1", "deblock=-2,-2")
"""Bits go where the light changes, the marks, instead of into flat water: a third less error for half the size."""
_X265 = "log-level=error:pools=1:frame-threads=1"
"""One thread: the same film on every machine."""
LOSSLESS = "ffv1"
_HISTORIES = ("tension", "rudder", "speed")


def render_scenario(
    file: ScenarioFile,
    scenario_folder: Path,
    run_folder: Path,
    progress: Callable[[int, int], None] | None = None,
    changed: Callable[[Hull, Tow], tuple[Hull, Tow, ExtraForce | None]] | None = None,
) -> None:
    """Simulate a scenario, film it, and write the run folder: video, run.toml, truth/. Whole or not at all.

    An earlier rendering in ``run_folder`` is replaced with its out/; other files there (scenario.toml) are kept.

    Parameters
    ----------
    file : with [film] and at least two marks
    changed : as ``simulate_scenario`` takes it
    scenario_folder : where the histories named in [tow] lie
    run_folder : new, empty, or holding a run.toml or scenario.toml
    progress : called with (frames done, frames in all)

    Raises
    ------
    InputError : no [film], an odd picture size, or a folder that holds something else
    """
    scenario_folder, run_folder = Path(scenario_folder), Path(run_folder)
    where = scenario_folder / SCENARIO_FILE
    if file.film is None:
        raise InputError(where, "film", "missing table; it says how the tow is filmed")
    film = film_of(file)
    if film.codec != LOSSLESS and any(side % 2 for side in film.camera.image_size_px):
        raise InputError(
            where,
            "film.camera.image_size_px",
            f"{list(film.camera.image_size_px)}: codec {film.codec!r} needs even numbers",
        )
    for i, marker in enumerate(file.marker):
        if not is_spot(marker.look):
            spots = in_words(spot_names())
            raise InputError(where, f"marker[{i + 1}].look", f"{marker.look!r} cannot be drawn; expected {spots}")
    camera = camera_of(file)
    picks, histories = _picks(file, camera, where), _histories(file, where)
    with _replacing_folder(run_folder) as folder:
        motion = simulate_scenario(file, scenario_folder, changed)
        video = "video.mkv" if film.codec == LOSSLESS else "video.mp4"
        _write_video(folder / video, film, file.time.rate_hz, film_frames(file, motion), len(motion), progress)
        for name in histories:
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(scenario_folder / name, target)
        write_table(folder / "truth" / "tracks.csv", true_tracks(file, motion, camera))
        write_table(folder / "truth" / "motion.csv", motion)
        write_result(folder / "truth" / "derivatives.json", _truth(file, where))
        write_text(folder / RUN_FILE, _run_toml(file, video, picks))


@contextmanager
def _replacing_folder(target: Path) -> Iterator[Path]:
    """Yield a new folder beside ``target``; it takes ``target``'s place when the block ends without an error."""
    kept: list[Path] = []
    if target.exists():
        if not target.is_dir():
            raise InputError(target, "", "is a file; a run folder is expected")
        inside = list(target.iterdir())
        known = {RUN_FILE, SCENARIO_FILE}
        if inside and not any(path.name in known for path in inside):
            raise InputError(target, "", "holds other files and no run.toml; give a new folder")
        kept = [path for path in inside if path.name not in _MADE_HERE]
    target = target.resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", suffix=".tmp", dir=target.parent))
    old = fresh.with_suffix(".old")
    try:
        yield fresh
        for path in kept:
            if path.is_dir():
                shutil.copytree(path, fresh / path.name, symlinks=True, dirs_exist_ok=True)
            elif not (fresh / path.name).exists():
                shutil.copy2(path, fresh / path.name, follow_symlinks=False)
        mask = os.umask(0)
        os.umask(mask)
        fresh.chmod(0o777 & ~mask)
        if target.exists():
            target.rename(old)
        try:
            fresh.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _write_video(
    path: Path,
    film: FilmTable,
    rate_hz: float,
    frames: Iterator[tuple[int, float, NDArray[np.uint8]]],
    count: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Encode frames with their true times; H.264 and HEVC in 4:2:0 of limited range (BT.601), or FFV1 without loss."""
    import av
    import cv2
    from av.error import FFmpegError
    from av.video.reformatter import ColorRange, Colorspace

    rate = Fraction(rate_hz).limit_denominator(_RATE_DENOMINATOR)
    width, height = film.camera.image_size_px
    try:
        with av.open(str(path), "w") as container:
            if film.codec != LOSSLESS:
                coder, options = _coder(film)
                stream: Any = container.add_stream(coder, rate=rate, options=options)
                stream.pix_fmt = "yuv420p10le" if film.codec == "hevc10" else "yuv420p"
                stream.codec_context.color_range = ColorRange.MPEG
                stream.codec_context.colorspace = Colorspace.ITU601
                stream.codec_context.gop_size = max(2, round(10 * rate_hz))
            else:
                stream = container.add_stream("ffv1", rate=rate)
                stream.pix_fmt = "bgr0"
            stream.width, stream.height = width, height
            stream.codec_context.thread_count = 2
            stream.codec_context.time_base = 1 / rate
            for index, _, bgr in frames:
                if film.codec != LOSSLESS:
                    yuv = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420), dtype=np.uint8)
                    frame = av.VideoFrame.from_ndarray(yuv, format="yuv420p")
                    if film.codec == "hevc10":
                        frame = frame.reformat(format=stream.pix_fmt)
                    frame.color_range = ColorRange.MPEG
                    frame.colorspace = Colorspace.ITU601
                else:
                    frame = av.VideoFrame.from_ndarray(bgr, format="bgr24").reformat(format="bgr0")
                frame.pts, frame.time_base = index, 1 / rate
                container.mux(stream.encode(frame))
                if progress is not None:
                    progress(index + 1, count)
            container.mux(stream.encode(None))
    except FFmpegError as error:
        raise VideoError(f"{path.name}: cannot be encoded ({error})") from error


def _coder(film: FilmTable) -> tuple[str, dict[str, str]]:
    """ffmpeg's name of a lossy coder, and its options."""
    options = {"crf": str(film.crf), "preset": "veryfast", "bf": str(film.b_frames)}
    if film.codec == "h264":
        return "libx264", {**options, **x264_options(*_X264)}
    return "libx265", {**options, "x265-params": _X265}


def _picks(file: ScenarioFile, camera: Camera, where: Path) -> NDArray[np.float64]:
    """The datum points as a person would pick them: projection plus scatter, ``(n, 2)`` px."""
    film = film_of(file)
    pixel = camera.project(np.array([point.tank_m for point in film.datum]))
    for point, place in zip(film.datum, pixel, strict=True):
        if not np.isfinite(place).all():
            raise InputError(where, f"film.datum {point.name!r}", "lies behind the camera")
    rng = np.random.default_rng([file.seed, PICK_SEED])
    return pixel + film.pick_sigma_px * rng.standard_normal(pixel.shape)


def _histories(file: ScenarioFile, where: Path) -> list[str]:
    """The histories named in [tow], which go into the run folder too."""
    names = [(key, getattr(file.tow, key)) for key in _HISTORIES]
    for key, name in names:
        if name and (Path(name).is_absolute() or ".." in Path(name).parts):
            raise InputError(
                where, f"tow.{key}", f"{name!r} lies outside the scenario's folder; it travels with the run"
            )
    return [name for _, name in names if name]


def _truth(file: ScenarioFile, where: Path) -> TruthFile:
    """What the run was made from."""
    hull = hull_of(file)
    derivatives = {name: value for name, value in asdict(hull).items() if value is not None}
    speed = derivatives.pop("speed_m_s")
    return TruthFile(
        schema="towline/truth",
        version=1,
        tool=__version__,
        inputs={"scenario": _hash_of(file, where)},
        speed_m_s=speed,
        derivatives=derivatives,
        x_v_m=hull.x_v_m,
    )


def _hash_of(file: ScenarioFile, where: Path) -> str:
    """SHA-256 of scenario.toml where ``file`` was read from it; of its content as JSON otherwise."""
    try:
        if read_scenario(where) == file:
            return sha256_of_file(where)
    except InputError:
        pass
    return sha256_of_texts(file.model_dump_json())


def _run_toml(file: ScenarioFile, video: str, picks: NDArray[np.float64]) -> str:
    """The run.toml of the filmed tow."""
    import tomlkit

    film = film_of(file)
    document = tomlkit.document()
    document.add("name", tomlkit.item(file.name))
    document.add("kind", tomlkit.item(file.kind))
    document.add("notes", tomlkit.item(file.notes or "Rendered from a simulation; its truth is in truth/."))
    source: dict[str, object] = {"video": video}
    if film.codec == LOSSLESS:  # Matroska rounds times to 1 ms
        source["frame_rate_hz"] = file.time.rate_hz
    tables: dict[str, object] = {"source": source}
    if film.lens_known:
        tables["camera"] = film.camera.model_dump(exclude_none=True, exclude={"sd"})
    sigma = max(film.pick_sigma_px, _SMALLEST_SIGMA_PX)
    tables["datum"] = [
        {
            "name": point.name,
            "pixel_px": [round(float(pick[0]), 4), round(float(pick[1]), 4)],
            "tank_m": list(point.tank_m),
            "sigma_px": sigma,
        }
        for point, pick in zip(film.datum, picks, strict=True)
    ]
    extra = {"peak_dn", "width_px"}
    tables["marker"] = [
        {**marker.model_dump(exclude=extra, exclude_none=True, exclude_defaults=True), "look": marker.look}
        for marker in file.marker
    ]
    not_stated = {"resistance_n", "line_stiffness_n_m", "line_damping_n_s_m"}
    tables["tow"] = file.tow.model_dump(exclude=not_stated, exclude_none=True, exclude_defaults=True)
    tables["model"] = file.model.model_dump(exclude_none=True, exclude_defaults=True)
    tables["water"] = file.water.model_dump(exclude_none=True)
    for name, content in tables.items():
        document.add(name, tomlkit.item(_plain(content)))
    return tomlkit.dumps(document)


def _plain(value):
    """Tuples as lists, for TOML."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    return value
