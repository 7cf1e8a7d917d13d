"""The readers, what each is given, and what it promises of what it takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import faults_bases as base
import numpy as np
from faults_cases import csv_files, garbled, json_files, parquet_files, pictures, tokens, toml_files
from hypothesis import strategies as st

from towline.record import InputError, TowlineError, read_history, read_motion, read_result, read_run, read_tracks
from towline.record.check_file import CheckFile
from towline.record.gap_file import GapFile
from towline.record.imported import Wanted, import_tracks
from towline.record.instruments import motion_from_channels, read_channels, read_setup
from towline.record.lens_file import LensFile, read_lens
from towline.record.plan_file import PlanRequest
from towline.record.priors import Priors
from towline.record.results import CameraFile, DerivativesFile, SteadyFile
from towline.record.scenario import ScenarioFile
from towline.record.toml import read_toml

STATUS = {"measured", "predicted", "lost"}
LONGEST_LINE = 1000
CLIP_SIZE, CLIP_FRAMES, CLIP_RATE_HZ = 64, 12, 10


@dataclass(frozen=True)
class Reader:
    """A reader under test.

    Attributes
    ----------
    name : in the table
    file : what the damaged bytes are written as
    damaged : the bytes
    read : the path -> whatever the reader gives
    whole : of what was given, what promise it breaks; "" = none
    beside : files that stand beside it
    """

    name: str
    file: str
    damaged: st.SearchStrategy[bytes]
    read: Callable[[Path], Any]
    whole: Callable[[Any], str]
    beside: tuple[tuple[str, str], ...] = ()


def judged(reader: Reader, folder: Path, data: bytes) -> str:
    """accepted | refused; anything else that a reader does is raised as it is, a broken promise as AssertionError."""
    path = folder / reader.file
    path.write_bytes(data)
    try:
        found = reader.read(path)
    except TowlineError as error:
        said = str(error)
        assert path.name in said or folder.name in said, f"the message does not name the file: {said[:200]}"
        assert len(said.splitlines()) == 1, f"the message has several lines: {said[:200]!r}"
        assert len(said) < LONGEST_LINE + len(str(folder)), f"the message has {len(said)} letters"
        return "refused"
    broken = reader.whole(found)
    assert not broken, f"accepted, but {broken}"
    return "accepted"


def prepared(reader: Reader, folder: Path) -> None:
    """Write what stands beside the damaged file."""
    for name, text in reader.beside:
        (folder / name).write_text(text, encoding="utf-8")


# promises ------------------------------------------------------------------------------------------------------------


def finite(value: Any) -> str:
    """Every number of a checked file is finite."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"it holds {value}"
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ()
    return next((said for one in inner if (said := finite(one))), "")


def finite_file(file: Any) -> str:
    """The same of a pydantic model."""
    return finite(file.model_dump())


def _table(table: Any, always: tuple[str, ...], when_measured: tuple[str, ...], per_marker: bool) -> str:
    for name in always:
        if not np.isfinite(table[name].to_numpy(dtype=float)).all():
            return f"{name} is not finite"
    if not len(table) or not set(table["status"]) <= STATUS:
        return f"status holds {set(table['status'])}"
    rows = table[table["status"] == "measured"]
    for name in when_measured:
        if not np.isfinite(rows[name].to_numpy(dtype=float)).all():
            return f"{name} of a measured row is not finite"
    groups = [rows for _, rows in table.groupby("marker", dropna=False)] if per_marker else [table]
    if any((np.diff(one["t_s"]) <= 0).any() for one in groups):
        return "its times do not rise"
    if per_marker and not all(isinstance(m, str) and m.strip() for m in table["marker"]):
        return "a marker has no name"
    return ""


def tracks(table: Any) -> str:
    """Times rise; what counts as measured has a place."""
    return _table(table, ("t_s", "frame"), ("u_px", "v_px"), True)


def motion(table: Any) -> str:
    """Times rise; what counts as measured has a y_CG and a heading."""
    return _table(table, ("t_s",), ("y_cg_m", "beta_rad"), False)


def history(table: Any) -> str:
    """Times rise, nothing is missing."""
    values = table[["t_s", "tension_n"]].to_numpy(dtype=float)
    return (
        ""
        if len(values) > 1 and np.isfinite(values).all() and (np.diff(values[:, 0]) > 0).all()
        else "it is no history"
    )


def _channels(path: Path) -> Any:
    setup = read_setup(path.with_name("setup.toml"))
    return setup, read_channels(path, setup, path.with_name("setup.toml"))


def _channel_motion(path: Path) -> Any:
    try:
        return motion_from_channels(*_channels(path)).motion
    except TowlineError as error:  # of what several files hold together: the command names the file
        raise InputError(path, "", str(error)) if path.name not in str(error) else error from None


def _every_channel(found: Any) -> str:
    good = all(np.isfinite(c.t_s).all() and (np.diff(c.t_s) > 0).all() for c in found[1].values())
    return "" if good else "the times of a channel do not rise"


def _placed(setup: Any) -> str:
    places = [setup.tow_point_m, *(setup.place_m(c) for c in setup.channel if c.measures in ("x", "y"))]
    return finite(places) or finite_file(setup)


def _picture(path: Path) -> Any:
    from towline.cli.lens import _picture as read

    return read(path)


def _is_picture(luma: Any) -> str:
    return (
        "" if luma.ndim == 2 and luma.size and luma.dtype == np.uint8 else f"it is {luma.dtype} of shape {luma.shape}"
    )


def _clip(path: Path) -> Any:
    from towline.vision import read_frames

    return [(frame.t_s, frame.luma.shape) for frame in read_frames(path, decode_threads=1)]


def _is_clip(frames: Any) -> str:
    times = [t for t, _ in frames]
    return finite(times) or ("" if all(b > a for a, b in pairwise(times)) else "its times do not rise")


def _reference(path: Path) -> Any:
    from towline.identify.reference import read_reference

    return read_reference(path)


def _scenario(path: Path) -> Any:
    from towline.record.toml import read_toml

    return read_toml(path, ScenarioFile)


@cache
def clip() -> bytes:
    """A small H.264 clip in Matroska."""
    import tempfile

    import av

    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "clip.mkv"
        with av.open(str(path), "w") as out:
            stream = out.add_stream("libx264", rate=CLIP_RATE_HZ, options={"crf": "23", "bf": "0"})
            stream.width = stream.height = CLIP_SIZE
            stream.pix_fmt = "yuv420p"
            for k in range(CLIP_FRAMES):
                picture = np.full((CLIP_SIZE, CLIP_SIZE, 3), 40 + 10 * k, np.uint8)
                out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            out.mux(stream.encode())
        return path.read_bytes()


# the list ------------------------------------------------------------------------------------------------------------


def _toml(name: str, text: str, read: Callable[[Path], Any], whole: Callable[[Any], str], **more: Any) -> Reader:
    return Reader(name, name, toml_files(base.tree_of(text), text), read, whole, **more)


def _result(name: str, model: Any, tree: Any, read: Callable[[Path], Any] | None = None) -> Reader:
    return Reader(name, name, json_files(tree), read or (lambda path: read_result(path, model)), finite_file)


def _imported(name: str, file: str, program: str, damaged: st.SearchStrategy[bytes], wanted: Wanted) -> Reader:
    return Reader(name, file, damaged, lambda path: import_tracks(path, program, wanted).table, tracks)


def _columns(head: tuple[str, ...], rows: Any) -> dict[str, Any]:
    return dict(zip(head, map(list, zip(*rows, strict=True)), strict=True))


def readers() -> list[Reader]:
    """All of them, in the order of the table."""
    tracks_text = "\n".join(",".join(map(str, row)) for row in (base.TRACK_HEAD, *base.TRACK_ROWS))
    tension = "t_s,tension_n\n0,4\n1,4\n"
    run_beside = (("tracks.csv", tracks_text), ("tension.csv", tension))
    csv, parquet = csv_files, parquet_files
    rate = Wanted(rate_hz=25.0)
    axes = Wanted(rate_hz=25.0, origin_px=(0.0, 720.0))
    kinovea = st.one_of(*map(tokens, (base.KINOVEA_CSV, base.KINOVEA_TXT, base.KINOVEA_CODE)))
    return [
        _toml("run.toml", base.RUN, lambda p: read_run(p.parent).file, finite_file, beside=run_beside),
        _toml("scenario.toml", base.SCENARIO, _scenario, finite_file),
        _toml("plan.toml", base.PLAN, lambda p: read_toml(p, PlanRequest), finite_file),
        _toml("setup.toml", base.SETUP, read_setup, _placed),
        _toml("priors.toml", base.PRIORS, lambda p: read_toml(p, Priors), finite_file),
        Reader("tracks.csv", "tracks.csv", csv(base.TRACK_HEAD, base.TRACK_ROWS), read_tracks, tracks),
        Reader("tracks.parquet", "t.parquet", parquet(_columns(base.TRACK_HEAD, base.TRACK_ROWS)), read_tracks, tracks),
        Reader("motion.csv", "motion.csv", csv(base.MOTION_HEAD, base.MOTION_ROWS), read_motion, motion),
        Reader("motion.parquet", "m.parquet", parquet(_columns(base.MOTION_HEAD, base.MOTION_ROWS)), read_motion, motion),
        Reader(
            "tension.csv", "h.csv", csv(("t_s", "tension_n"), base.HISTORY_ROWS), lambda p: read_history(p, "tension_n"), history
        ),
        _imported("trackpy, CSV", "s.csv", "trackpy", csv(base.TRACKPY_HEAD, base.TRACKPY_ROWS), rate),
        _imported(
            "trackpy, Parquet", "s.parquet", "trackpy", parquet(_columns(base.TRACKPY_HEAD, base.TRACKPY_ROWS)), rate
        ),
        _imported("DLTdv", "s_xypts.csv", "auto", csv(base.DLTDV_HEAD, base.DLTDV_ROWS), Wanted(rate_hz=25.0, y="down")),
        _imported("Kinovea, text", "s.txt", "kinovea", kinovea, axes),
        _imported("Kinovea, KVA", "s.kva", "auto", tokens(base.KINOVEA_KVA), Wanted()),
        _imported("Tracker", "s.txt", "tracker", tokens(base.TRACKER), axes),
        _imported("any program's", "s.txt", "auto", st.one_of(kinovea, tokens(base.TRACKER), st.binary(max_size=60)), axes),
        Reader(
            "instruments: channels", "c.csv", csv(base.CHANNEL_HEAD, base.CHANNEL_ROWS), _channels, _every_channel,
            (("setup.toml", base.SETUP),),
        ),
        Reader(
            "instruments: motion", "c.csv", csv(base.CHANNEL_HEAD, base.CHANNEL_ROWS), _channel_motion, motion,
            (("setup.toml", base.SETUP),),
        ),
        _result("derivatives.json", DerivativesFile, base.example_of(DerivativesFile)),
        _result("steady.json", SteadyFile, base.example_of(SteadyFile)),
        _result("check.json", CheckFile, base.example_of(CheckFile)),
        _result("gap.json", GapFile, base.example_of(GapFile)),
        _result("camera.json", CameraFile, base.example_of(CameraFile)),
        _result("lens.json", LensFile, base.lens_example(LensFile), read_lens),
        Reader("reference set", "r.csv", tokens(base.REFERENCE), _reference, lambda found: finite(found.prime.tolist())),
        Reader("pictures of a board", "p.png", pictures(), _picture, _is_picture),
        Reader("video (small clip)", "v.mkv", st.deferred(lambda: garbled(clip(), 3)), _clip, _is_clip),
    ]  # fmt: skip
