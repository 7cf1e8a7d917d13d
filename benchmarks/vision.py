"""Marks in the picture: errors against their bound, losses and speed, beside what people use; one table from one run.

    python benchmarks/vision.py                        all of it, about five minutes on two cores
    python benchmarks/vision.py --quick                fewer frames
    python benchmarks/vision.py --only easy over       these conditions or sections (speed, film, pivot, beads, patches)
    python benchmarks/vision.py --keep DIR             clips are made in DIR and found there again
    python benchmarks/vision.py --json FILE            all figures, unrounded

The clips and what is known of them: vision_clips.py; the other methods and how they are set: vision_peers.py.
"""

from __future__ import annotations

import argparse
import json
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import vision_clips as clips
from vision_clips import Bounds, Clip, Condition
from vision_peers import Answer, answers, patch_answers, whole_frame_rates

from towline.geometry import run_datum
from towline.record import read_run
from towline.record.errors import InputError, TowlineError
from towline.vision import clip_info, read_frames, track

SHARED = Path(__file__).resolve().parents[1].parent / "shared"
FRAMES, QUICK_FRAMES = 400, 120
PEERS_EVERY, QUICK_PEERS_EVERY = 3, 4
MINUTE_FRAMES, QUICK_MINUTE_FRAMES = 1800, 300
REPEATS, QUICK_REPEATS = 3, 1
REPEATED = 10
"""The long clip is the minute this many times."""
FALSE_PX = 3.0
"""A mark measured farther than this from its true place is a false one."""
SECTIONS = ("speed", "film", "pivot", "beads", "patches")
PIVOT_SPAN_S = (3.17, 60.0)
PIVOT_HARMONICS, PIVOT_EVERY = 4, 3
PIVOT_DIAMETER_PX, PIVOT_GATE_PX = 17, 6.0
"""trackpy's scatter is the same from 13 to 21 px, and worse outside."""
BEAD_DIAMETER_PX, BEAD_MASS, BEAD_WINDOW_PX = 7, 100.0, 6


@dataclass(frozen=True)
class Score:
    """A method on a condition.

    Attributes
    ----------
    condition, method : names
    frames : looked at
    rmse_px : over u and v of the visible marks found
    bound_px, known_px, alone_px : Cramer-Rao bounds of a coordinate, see ``vision_clips.Bounds``
    bias_px : largest mean error of a marker along an axis
    scatter_px : rms error beyond each marker's mean
    missed, visible : marker-frames visible and not found; visible
    false : marker-frames found far from the truth or while hidden
    swaps : found at another mark's place
    partial, partial_px : found while partly hidden; rms error of those
    z_u, z_v : standard deviation of error over stated sigma about each mark's mean
    z_rms : root mean square of error over stated sigma, a mark's constant offset included
    rate_hz, decode_hz : frames per CPU-second; of decoding alone
    """

    condition: str
    method: str
    frames: int
    rmse_px: float
    bound_px: float
    known_px: float
    alone_px: float
    bias_px: float
    scatter_px: float
    missed: int
    visible: int
    false: int
    swaps: int
    partial: int
    partial_px: float
    z_u: float
    z_v: float
    z_rms: float
    rate_hz: float
    decode_hz: float


# conditions ---------------------------------------------------------------------------------------------------------


def score(clip: Clip, method: str, answer: Answer, bounds: Bounds, decode_hz: float) -> Score:
    """Compare an answer with the truth."""
    truth = clip.truth()
    table = answer.table.merge(truth, on=["frame", "marker"], suffixes=("", "_true"), validate="one_to_one")
    gap = table[["u_px", "v_px"]].to_numpy(dtype=float) - table[["u_px_true", "v_px_true"]].to_numpy()
    stated = table[["sigma_u_px", "sigma_v_px"]].to_numpy(dtype=float)
    far = np.hypot(*gap.T)
    measured = (table["status"] == "measured").to_numpy()
    state = table["status_true"].to_numpy()
    marker = table["marker"].to_numpy()
    near = measured & (far <= FALSE_PX)
    kept = near & (state == "visible")
    false = measured & ((far > FALSE_PX) | (state == "hidden"))
    whole = gap[kept] / stated[kept]
    z = whole[np.isfinite(whole).all(axis=1)]
    z_of = [whole[(marker[kept] == name) & np.isfinite(whole).all(axis=1)] for name in clips.NAMES]
    # about each mark's own mean: a constant offset of a mark is in the columns bias and z rms
    z_sd = np.sqrt(np.mean([part.var(axis=0) for part in z_of], axis=0)) if min(map(len, z_of)) > 2 else [np.nan] * 2
    by_marker = [gap[kept & (marker == name)] for name in clips.NAMES]
    means = [g.mean(axis=0) for g in by_marker if len(g)]
    rest = [g - g.mean(axis=0) for g in by_marker if len(g)]
    cut = near & (state == "partial")
    return Score(
        condition=clip.scene.condition.name,
        method=method,
        frames=answer.frames,
        rmse_px=_rms(gap[kept]),
        bound_px=bounds.frame_px,
        known_px=bounds.known_px,
        alone_px=bounds.alone_px,
        bias_px=float(np.abs(means).max()) if means else np.nan,
        scatter_px=_rms(np.concatenate(rest)) if rest else np.nan,
        missed=int((~measured & (state == "visible")).sum()),
        visible=int((state == "visible").sum()),
        false=int(false.sum()),
        swaps=_swaps(table, measured, truth),
        partial=int(cut.sum()),
        partial_px=_rms(gap[cut]),
        z_u=float(z_sd[0]),
        z_v=float(z_sd[1]),
        z_rms=_rms(z) if len(z) > 2 else np.nan,
        rate_hz=answer.frames / max(answer.cpu_s, 1e-9),
        decode_hz=decode_hz,
    )


def _swaps(table: pd.DataFrame, measured: np.ndarray, truth: pd.DataFrame) -> int:
    """Marker-frames found at the other mark's true place."""
    other = truth.assign(marker=truth["marker"].map(dict(zip(clips.NAMES, clips.NAMES[::-1], strict=True))))
    both = table[["frame", "marker", "u_px", "v_px"]].merge(other, on=["frame", "marker"], suffixes=("", "_other"))
    far = np.hypot(both["u_px"] - both["u_px_other"], both["v_px"] - both["v_px_other"]).to_numpy(dtype=float)
    return int((measured & (far <= FALSE_PX)).sum())


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else np.nan


def ours(folder: Path) -> Answer:
    """towline over a run folder, decoding included."""
    run = read_run(folder)
    info = clip_info(run.source_path)
    datum = run_datum(run, (info.width_px, info.height_px))
    began = time.process_time()
    source = run.file.source
    found = track(run, read_frames(run.source_path, source.span_s, source.frame_rate_hz), datum.mapping)
    return Answer(found.table, found.frames, time.process_time() - began)


def decode_rate(video: Path) -> float:
    """Frames per CPU-second of ``read_frames`` alone."""
    began = time.process_time()
    count = sum(1 for _ in read_frames(video))
    return count / max(time.process_time() - began, 1e-9)


def conditions(wanted: list[Condition], frames: int, every: int, under: Path) -> dict[str, Any]:
    """Every condition by every method; then what compression adds."""
    _heading("conditions")
    for line in _SCORE_HEAD:
        print(line)
    scores: list[Score] = []
    coded: list[dict[str, Any]] = []
    for condition in wanted:
        clip = clips.clip(condition, frames, under)
        bounds = clip.scene.bounds()
        decode_hz = decode_rate(clip.video)
        try:
            own = ours(clip.folder)
        except TowlineError as error:
            print(f"{condition.name:10} {'towline':12} failed: {error}")
            own = None
        if own is not None:
            scores.append(score(clip, "towline", own, bounds, decode_hz))
            _print_score(scores[-1])
        for name, answer in answers(clip, every).items():
            scores.append(score(clip, name, answer, bounds, decode_hz))
            _print_score(scores[-1])
        if condition.twin is not None and own is not None:
            twin = clips.clip(clips.named(condition.twin), frames, under)
            own_score = next(s for s in scores if s.condition == condition.name and s.method == "towline")
            coded.append(codec_error(clip, own, ours(twin.folder), own_score))
    for s in scores:
        if s.partial:
            print(f"{s.condition}, {s.method}: {s.partial} measured while partly hidden, {s.partial_px:.3f} px rms off")
    if coded:
        _print_codec(coded)
    rates = {}
    if scores:
        rates = whole_frame_rates(clips.clip(wanted[0], frames, under))
        print(
            "\nPeers are timed on the marks' path only; whole picture, frames per CPU-second: " + _pairs(rates, ".1f")
        )
    return {"scores": [asdict(s) for s in scores], "codec": coded, "whole_frame_hz": rates}


_SCORE_HEAD = (
    "condition  method          RMSE   bound  ratio   known scatter    bias   lost false swap   z u   z v z rms  frame/s decode/s",
    "                             px      px             px      px      px      %                                   CPU      CPU",
)


def _print_score(s: Score) -> None:
    print(
        f"{s.condition:10} {s.method:12} {s.rmse_px:7.4f} {s.bound_px:7.4f} {s.rmse_px / s.bound_px:6.2f} {s.known_px:7.4f} "
        f"{s.scatter_px:7.4f} {s.bias_px:7.4f} {_percent(s):6.2f} {s.false:5d} {s.swaps:4d} {s.z_u:5.2f} {s.z_v:5.2f} "
        f"{s.z_rms:5.2f} "
        f"{s.rate_hz:8.0f} {s.decode_hz:8.0f}",
        flush=True,
    )


def _percent(s: Score) -> float:
    """Visible marker-frames lost; a method that saw only some of the frames is judged on those."""
    return 100 * s.missed / max(s.visible, 1)


def codec_error(clip: Clip, coded: Answer, plain: Answer, own: Score) -> dict[str, Any]:
    """What compression adds to our own places: compressed minus uncompressed, frame by frame."""
    both = coded.table.merge(plain.table, on=["frame", "marker"], suffixes=("", "_plain"))
    both = both[(both["status"] == "measured") & (both["status_plain"] == "measured")]
    both = both.sort_values(["marker", "frame"])
    gap = both[["u_px", "v_px"]].to_numpy() - both[["u_px_plain", "v_px_plain"]].to_numpy()
    lags = []
    for name in clips.NAMES:
        own_gap = gap[(both["marker"] == name).to_numpy()]
        own_gap = own_gap - own_gap.mean(axis=0)
        lags.append((own_gap[1:] * own_gap[:-1]).sum(axis=0) / (own_gap**2).sum(axis=0))
    codec = _rms(gap)
    expected = float(np.hypot(own.bound_px, codec))
    return {
        "condition": own.condition,
        "mbit_per_s": 8e-6 * clip.video.stat().st_size * clips.RATE_HZ / clip.scene.frames,
        "codec_px": codec,
        "codec_u_px": _rms(gap[:, 0]),
        "codec_v_px": _rms(gap[:, 1]),
        "lag_1": float(np.mean(lags)),
        "rmse_px": own.rmse_px,
        "expected_px": expected,
        "ratio": own.rmse_px / expected,
        "z_u": own.z_u,
        "z_v": own.z_v,
    }


def _print_codec(rows: list[dict[str, Any]]) -> None:
    _heading(
        f"compressed (libx264, preset {clips.PRESET}, yuv420p): towline's places against those from the uncompressed twin"
    )
    print(
        f"{'condition':10} {'Mbit/s':>7} {'codec':>7} {'u':>7} {'v':>7} {'lag 1':>6} {'RMSE':>7} {'sqrt(bound2+codec2)':>20} "
        f"{'ratio':>6} {'z u':>5} {'z v':>5}"
    )
    for r in rows:
        print(
            f"{r['condition']:10} {r['mbit_per_s']:7.2f} {r['codec_px']:7.4f} {r['codec_u_px']:7.4f} {r['codec_v_px']:7.4f} "
            f"{r['lag_1']:6.2f} {r['rmse_px']:7.4f} {r['expected_px']:20.4f} {r['ratio']:6.2f} {r['z_u']:5.2f} {r['z_v']:5.2f}"
        )


# end to end -----------------------------------------------------------------------------------------------------------

_CHILD = """
import json, resource, subprocess, sys, time
began = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
wall = time.perf_counter() - began
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([done.returncode, wall, used.ru_utime + used.ru_stime, used.ru_maxrss, done.stderr.decode()[-500:]]))
"""
"""Runs a command from a small process of its own: a child's peak memory starts at that of the process which starts it."""

_DECODE = """
import av, sys
with av.open(sys.argv[1]) as container:
    stream = container.streams.video[0]
    stream.thread_type = "NONE"
    stream.codec_context.thread_count = 1
    for _ in container.decode(stream):
        pass
"""

_IMPORTS = "import towline.cli, towline.pipeline.stages, towline.vision, av, cv2, pandas, scipy.optimize"


@dataclass(frozen=True)
class Used:
    """Resources of a command: wall and CPU time, s; peak resident memory, MiB."""

    wall_s: float
    cpu_s: float
    peak_mib: float


def used_by(*command: str) -> Used:
    """Run a command and measure it."""
    return _used(_start(*command))


def _start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", _CHILD, *command], stdout=subprocess.PIPE, text=True, cwd=tempfile.gettempdir()
    )


def _used(child: subprocess.Popen[str]) -> Used:
    code, wall, cpu, peak, words = json.loads(child.communicate()[0])
    if code:
        raise TowlineError(
            f"a measured command ended with {code}: {words.strip().splitlines()[-1] if words.strip() else ''}"
        )
    return Used(wall, cpu, peak / (1024 if sys.platform != "darwin" else 1024**2))


def _median(runs: list[Used]) -> Used:
    return Used(*(statistics.median(getattr(r, name) for r in runs) for name in ("wall_s", "cpu_s", "peak_mib")))


def _tow(folder: Path, *options: str) -> tuple[str, ...]:
    """The command that tracks a run; earlier results are removed so that nothing is read back."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    return (sys.executable, "-m", "towline", "track", str(folder), *options)


def speed(frames: int, repeats: int, under: Path, long: list[subprocess.Popen[str]]) -> dict[str, Any]:
    """The command beside plain decoding; leaves the run over the long clip under way in ``long``."""
    _heading(
        f"end to end: 720p, H.264 crf {clips.MINUTE.crf}, {frames / clips.RATE_HZ:.0f} s, medians of {repeats}, interleaved"
    )
    clip = clips.clip(clips.MINUTE, frames, under)
    decode, plain = [], []
    for _ in range(repeats):
        decode.append(used_by(sys.executable, "-c", _DECODE, str(clip.video)))
        plain.append(used_by(*_tow(clip.folder, "--no-overlay")))
    drawn = used_by(*_tow(clip.folder))
    bare = used_by(sys.executable, "-c", _IMPORTS)
    rows = {
        "decoding, one thread": _median(decode),
        "towline track --no-overlay": _median(plain),
        "towline track (overlay)": drawn,
        "imports alone": bare,
    }
    limit = rows["decoding, one thread"]
    print(f"{'command':28} {'wall s':>7} {'CPU s':>7} {'frame/s':>8} {'/ decode':>8} {'CPU ratio':>9} {'peak MiB':>9}")
    for name, r in rows.items():
        rate = (
            ""
            if name == "imports alone"
            else f"{frames / r.wall_s:8.0f} {r.wall_s / limit.wall_s:8.2f} {r.cpu_s / limit.cpu_s:9.2f}"
        )
        print(f"{name:28} {r.wall_s:7.2f} {r.cpu_s:7.2f} {rate:27} {r.peak_mib:9.0f}")
    tracks = pd.read_csv(clip.folder / "out" / "tracks.csv", comment="#")
    print(f"lost: {int((tracks['status'] != 'measured').sum())} of {len(tracks)} marker-frames", flush=True)
    long.append(_start(*_tow(clips.repeated(clip, REPEATED), "--no-overlay")))
    return {"frames": frames, "repeats": repeats, **{name: asdict(r) for name, r in rows.items()}}


def memory(child: subprocess.Popen[str], short: dict[str, Any]) -> dict[str, Any]:
    """Peak memory of the long clip against the short one."""
    long = _used(child)
    before = short["towline track --no-overlay"]["peak_mib"]
    _heading(
        f"memory: the same clip {REPEATED} times after itself (its run shared the machine with the sections above)"
    )
    print(
        f"peak {long.peak_mib:.0f} MiB against {before:.0f} MiB: {long.peak_mib / before:.2f}; {long.cpu_s:.0f} s CPU"
    )
    return {"times": REPEATED, "peak_mib": long.peak_mib, "ratio": long.peak_mib / before, "cpu_s": long.cpu_s}


# recordings that were not drawn here ------------------------------------------------------------------------------------


def film() -> dict[str, Any]:
    """The path-traced film, per marker and axis."""
    _heading("../shared/film: path-traced, H.264 crf 20")
    truth = pd.read_csv(SHARED / "film" / "truth.csv")
    answer = ours(SHARED / "film")
    table = answer.table
    result: dict[str, Any] = {"rate_hz": answer.frames / answer.cpu_s}
    print(f"{'marker':8} {'axis':4} {'RMSE':>7} {'bias':>8} {'scatter':>8} {'largest':>8} {'missed':>7} {'z std':>6}")
    for name in clips.NAMES:
        rows = table[table["marker"] == name].set_index("frame")
        good = rows["status"] == "measured"
        for axis in ("u", "v"):
            gap = (rows[f"{axis}_px"] - truth[f"{name}_{axis}"].reindex(rows.index))[good].to_numpy()
            z = gap / rows[f"sigma_{axis}_px"][good].to_numpy()
            figures = (_rms(gap), gap.mean(), gap.std(), np.abs(gap).max(), int(len(truth) - good.sum()), z.std())
            result[f"{name} {axis}"] = dict(
                zip(("rmse", "bias", "scatter", "largest", "missed", "z"), map(float, figures))
            )
            cells = "{:7.4f} {:+8.4f} {:8.4f} {:8.3f} {:7d} {:6.2f}".format(*figures)
            print(f"{name:8} {axis:4} {cells}")
    return result


def pivot(under: Path) -> dict[str, Any]:
    """Two dark dots on a turning disc, real video: how often both are held, and the scatter of their distance."""
    import trackpy as tp

    _heading("../shared/real/pivot_video: dark dots on a turning disc, after the hand has gone")
    folder = under / "pivot"
    folder.mkdir(parents=True, exist_ok=True)
    source = SHARED / "real" / "pivot_video" / "RotationOnAFixedPivot_R1.MP4"
    if not (folder / "video.mp4").is_file():
        shutil.copyfile(source, folder / "video.mp4")
    (folder / "run.toml").write_text(_pivot_toml())
    answer = ours(folder)
    table = answer.table
    place = {m: table[table["marker"] == m].set_index("frame")[["u_px", "v_px"]] for m in ("pivot", "rim")}
    arm = (place["rim"] - place["pivot"]).to_numpy()
    both = np.isfinite(arm).all(axis=1)
    peer = np.full_like(arm, np.nan)
    tp.quiet()
    looked = []
    for row, frame in enumerate(read_frames(folder / "video.mp4", PIVOT_SPAN_S)):
        if row % PIVOT_EVERY:
            continue
        looked.append(row)
        found = tp.locate(frame.luma, PIVOT_DIAMETER_PX, invert=True, topn=30, minmass=200)[["x", "y"]].to_numpy()
        # trackpy is told which of its spots is the dot: the one nearest to our place
        nearest = {}
        for name, path in place.items():
            gap = np.hypot(*(found - path.loc[frame.index].to_numpy()).T)
            nearest[name] = found[int(np.argmin(gap))] if np.nanmin(gap, initial=np.inf) < PIVOT_GATE_PX else np.nan
        peer[row] = nearest["rim"] - nearest["pivot"]
    seen = {"towline": 100 * both[looked].mean(), "trackpy": 100 * np.isfinite(peer[looked]).all(axis=1).mean()}
    shared_frames = both & np.isfinite(peer).all(axis=1)
    rows = {"towline": arm[shared_frames], "trackpy": peer[shared_frames]}
    print(
        f"both dots held: towline {100 * both.mean():.2f} % of {len(arm)} frames; of every {PIVOT_EVERY}.: "
        + _pairs(seen, ".2f")
    )
    result: dict[str, Any] = {"frames": len(arm), "both": float(both.mean())}
    for name, a in rows.items():
        rest = _without_ellipse(a)
        robust = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
        result[name] = {"scatter_px": float(rest.std()), "robust_px": robust, "largest_px": float(np.abs(rest).max())}
        print(
            f"{name:8} scatter of the distance {rest.std():.4f} px, robust {robust:.4f}, largest {np.abs(rest).max():.3f}"
        )
    return result


def _without_ellipse(arm_px: np.ndarray) -> np.ndarray:
    """Distance (n,) less its slow dependence on the angle: the disc is seen at an angle."""
    angle = np.arctan2(arm_px[:, 1], arm_px[:, 0])
    waves = [f(k * angle) for k in range(1, PIVOT_HARMONICS + 1) for f in (np.cos, np.sin)]
    basis = np.column_stack([np.ones_like(angle), *waves])
    distance = np.hypot(*arm_px.T)
    return distance - basis @ np.linalg.lstsq(basis, distance, rcond=None)[0]


def _pivot_toml() -> str:
    text = f'name = "pivot"\nkind = "free"\n[source]\nvideo = "video.mp4"\nspan_s = {list(PIVOT_SPAN_S)}\n'
    for name, u, v in (("a", 50, 20), ("b", 250, 20), ("c", 50, 220), ("d", 250, 220)):
        text += f'[[datum]]\nname = "{name}"\npixel_px = [{u}.0, {v}.0]\ntank_m = [{u / 1000}, {v / 1000}, 0.0]\n'
    for name, x, u, v in (("pivot", 0.0, 199, 110), ("rim", 0.073, 269, 130)):
        text += f'[[marker]]\nname = "{name}"\nbody_m = [{x}, 0.0]\ndepth_m = 0.0\nlook = "disc"\ncolour = "dark"\n'
        text += f"seen_at_px = [{u}.0, {v}.0]\n"
    return text


def our_fit(values: np.ndarray, corner: np.ndarray, start_px: np.ndarray, width_px: float) -> np.ndarray:
    """towline's spot fit: windows (b, n, n) at ``corner`` (b, 2) -> centres (b, 2) px, NaN where it did not converge."""
    from towline.vision import fit_spots, start_of
    from towline.vision.spots.model import ELLIPSE

    start = start_of(values, start_px, np.full(len(values), width_px))
    fit = fit_spots(values, corner, start, ELLIPSE)
    return np.where(fit.good[:, None], fit.centre_px, np.nan)


def beads() -> dict[str, Any]:
    """Beads stuck to a glass, five frames: scatter of each bead's place, less the frame's common shift."""
    import trackpy as tp
    from skimage import io

    _heading("../shared/real/trackpy_spots/stuck.tif: beads that do not move, 5 frames")
    frames = io.imread(SHARED / "real" / "trackpy_spots" / "stuck.tif").astype(float)
    tp.quiet()
    tables = [tp.locate(f, BEAD_DIAMETER_PX, minmass=BEAD_MASS, preprocess=True) for f in frames]
    linked = tp.link(pd.concat([t.assign(frame=i) for i, t in enumerate(tables)]), 2)
    counts = linked.groupby("particle")["frame"].count()
    linked = linked[linked["particle"].isin(counts[counts == len(frames)].index)].sort_values(["particle", "frame"])
    peer = linked[["x", "y"]].to_numpy().reshape(-1, len(frames), 2)
    inside = (np.abs(peer - 255.5) < 255.5 - BEAD_WINDOW_PX - 2).all(axis=(1, 2))
    apart = np.hypot(*(peer[:, None, 0] - peer[None, :, 0]).T) + 1e3 * np.eye(len(peer))
    peer = peer[inside & (apart.min(axis=0) > 2 * BEAD_WINDOW_PX)]
    own = np.empty_like(peer)
    side = 2 * BEAD_WINDOW_PX + 1
    width = BEAD_DIAMETER_PX / 4
    for i, frame in enumerate(frames):
        corner = np.rint(peer[:, 0]) - BEAD_WINDOW_PX
        cut = np.stack([frame[int(v) : int(v) + side, int(u) : int(u) + side] for u, v in corner])
        own[:, i] = our_fit(cut, corner, np.rint(peer[:, 0]), width)
    result: dict[str, Any] = {"beads": len(peer)}
    good = np.isfinite(own).all(axis=(1, 2))
    print(f"{len(peer)} beads apart from others; towline's fit converged in all frames on {int(good.sum())}")
    for name, places in (("towline", own), ("trackpy", peer)):
        still = places[good] - places[good].mean(axis=1, keepdims=True)
        still = still - np.median(still, axis=0)
        scatter = np.sqrt((still**2).sum(axis=1) / (len(frames) - 1))
        result[name] = {"median_px": float(np.median(scatter)), "mean_px": float(scatter.mean())}
        low, middle, high = np.quantile(scatter, [0.25, 0.5, 0.75])
        cells = f"median {middle:.4f}, quartiles {low:.4f} .. {high:.4f}, mean {scatter.mean():.4f}"
        print(f"{name:8} scatter per bead and axis, px: {cells}")
    return result


def patches(frames: int, every: int, under: Path) -> dict[str, Any]:
    """Unlit textured marks: template tracking beside trackpy and optical flow."""
    _heading("unlit marks: a bright and a dark textured patch, 30 px, on a textured moving ground (uncompressed)")
    clip = clips.clip(clips.PATCHES, frames, under)
    bounds = clip.scene.bounds(every=23)
    decode_hz = decode_rate(clip.video)
    found = patch_answers(clip, every)
    scores = []
    try:
        found = {"towline": ours(clip.folder), **found}
    except InputError as error:
        print(f"towline: not built yet ({error.args[-1] if error.args else error})")
    except TowlineError as error:
        print(f"towline: failed: {error}")
    print("method          RMSE px   bound    bias scatter  lost % false   z u   z v  frame/s")
    for name, answer in found.items():
        s = score(clip, name, answer, bounds, decode_hz)
        scores.append(asdict(s))
        print(
            f"{name:14} {s.rmse_px:8.4f} {s.bound_px:7.4f} {s.bias_px:7.4f} {s.scatter_px:7.4f} {_percent(s):7.2f} {s.false:5d} "
            f"{s.z_u:5.2f} {s.z_v:5.2f} {s.rate_hz:8.0f}"
        )
    return {"scores": scores}


# command line -----------------------------------------------------------------------------------------------------------


def _heading(text: str) -> None:
    print(f"\n== {text}", flush=True)


def _pairs(values: dict[str, float], form: str) -> str:
    return ", ".join(f"{name} {value:{form}}" for name, value in values.items())


def _plain(value: Any) -> Any:
    """For JSON: Python's own numbers, None for what is not a number."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def versions() -> dict[str, str]:
    """Of what was compared; nothing of the machine."""
    import av
    import cv2
    import skimage
    import trackpy

    import towline

    modules = {"towline": towline, "numpy": np, "opencv": cv2, "trackpy": trackpy, "scikit-image": skimage, "PyAV": av}
    return {"python": platform.python_version(), **{name: m.__version__ for name, m in modules.items()}}


def main() -> None:
    """Measure and print."""
    names = [*(c.name for c in clips.CONDITIONS), *SECTIONS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer frames")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, help="; ".join(names))
    parser.add_argument("--keep", type=Path, metavar="DIR", help="where the clips lie; made there if they do not")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    options = parser.parse_args()
    wanted = options.only or names
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(set(wanted), options.quick, (options.keep or Path(folder)).resolve())
    if options.json is not None:
        options.json.write_text(json.dumps(_plain(figures), indent=1) + "\n", encoding="utf-8")


def measure(wanted: set[str], quick: bool, under: Path) -> dict[str, Any]:
    """Everything asked for, printed as it comes."""
    frames, every = (QUICK_FRAMES, QUICK_PEERS_EVERY) if quick else (FRAMES, PEERS_EVERY)
    figures: dict[str, Any] = {"versions": versions(), "quick": quick, "frames": frames}
    print(", ".join(f"{name} {version}" for name, version in figures["versions"].items()))
    print(
        f"{frames} frames at {clips.RATE_HZ} Hz, two marks; peers see every {every}. frame. Marks {clips.AMPLITUDE_DN:.0f} DN on "
        f"{clips.GROUND_DN:.0f}, read noise {clips.READ_DN:.0f} DN, {clips.ELECTRONS_PER_DN:.0f} e-/DN. z = std of error / sigma."
    )
    chosen = [c for c in clips.CONDITIONS if c.name in wanted]
    length, repeats = (QUICK_MINUTE_FRAMES, QUICK_REPEATS) if quick else (MINUTE_FRAMES, REPEATS)
    jobs = [(clips.MINUTE, length)] if "speed" in wanted else []
    jobs += [(c, frames) for c in chosen] + ([(clips.PATCHES, frames)] if "patches" in wanted else [])
    with ProcessPoolExecutor(max_workers=2) as pool:
        list(pool.map(clips.clip, *zip(*jobs, strict=True), [under] * len(jobs)) if jobs else ())
    if chosen:
        figures["conditions"] = conditions(chosen, frames, every, under)
    long: list[subprocess.Popen[str]] = []
    sections: dict[str, Callable[[], dict[str, Any]]] = {
        "speed": lambda: speed(length, repeats, under, long),
        "film": film,
        "pivot": lambda: pivot(under),
        "beads": beads,
        "patches": lambda: patches(frames, 4 * every, under),
        "memory": lambda: memory(long[0], figures["speed"]),
    }
    for name, section in sections.items():
        if name in wanted or (name == "memory" and long):
            try:
                figures[name] = section()
            except TowlineError as error:
                print(f"failed: {error}")
    return figures


if __name__ == "__main__":
    main()
