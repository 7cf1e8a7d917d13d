"""Recordings as people edit them: 60 re-encodings and edits of three recordings whose marks are known.

    python benchmarks/footage_edits.py [--only WORDS]

Sources: ../shared/film (drawn by a path tracer) and two sample tows. Of every edit: whether it opens, or the line that says why
not; the share of frames whose time is right to half a frame, told by which picture of the source each shows; marks tracked, over
what the source gives on the same pictures; marks held more than a pixel from any truth; z, the rms of their error over the stated
sigma; that error (an offset of a mark that all frames share, which stands beside, and its lag behind its motion, which tracks.csv
states by itself, are in no sigma and taken out of both); what was said.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tempfile
from collections.abc import Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from footage_edits_cases import PICTURES, Edit, Made, Source, cases

from towline.pipeline.stages import fit_run_datum
from towline.record import TowlineError, read_run
from towline.vision import Frame, clip_info, read_frames, track
from towline.vision.recording.codecs import losses

HERE = Path(__file__).resolve().parent.parent
RIGHT_PX = 1.0
"""A place nearer to its mark than this is the mark's."""
EVERY_N, SMALLER, NEAR = 7, 4, 3
"""Every so many frames it is told which picture is shown, on pictures smaller by so much, among so many on either side."""
ALIKE = 0.02
"""Pictures whose difference from what is shown is the least, or so much more, are as good; neighbours differ by 6-10 %."""
PLAY_PX = 0.03
"""Motion per frame from which a codec's lag has its full size (docs/vision.md)."""
SAID = 88
"""Letters of a note in the table."""


def sources() -> dict[str, Source]:
    """The three recordings."""
    film, samples = HERE.parent / "shared" / "film", HERE / "sample_videos"
    found = {"film": _source("film", film, _film_truth(film / "truth.csv"))} if film.is_dir() else {}
    for name, folder in (("x1446", samples / "mariner" / "x1446"), ("hole6", samples / "leander_steady" / "hole6")):
        found[name] = _source(name, folder, _sample_truth(folder / "truth" / "tracks.csv"))
    return found


def _film_truth(path: Path) -> dict[str, list[tuple[float, float]]]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [(float(row[f"{name}_u"]), float(row[f"{name}_v"])) for row in rows] for name in ("bow", "stern")}


def _sample_truth(path: Path) -> dict[str, list[tuple[float, float]]]:
    places: dict[str, list[tuple[float, float]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            places.setdefault(row["marker"], []).append((float(row["u_px"] or "nan"), float(row["v_px"] or "nan")))
    return places


def _source(name: str, folder: Path, truth: dict[str, list[tuple[float, float]]]) -> Source:
    path = folder / "video.mp4"
    rate = Fraction(clip_info(path).rate_hz).limit_denominator(1001)
    planes = np.array([f.raw.to_ndarray(format="yuv420p") for f in islice(read_frames(path), PICTURES)])
    place = np.stack([np.array(rows)[: len(planes)] for rows in truth.values()], axis=1)
    return Source(name, path, rate, (folder / "run.toml").read_text(encoding="utf-8"), planes, place, tuple(truth))


class Watched:
    """Frames on their way to the tracker, some of them looked at: is it the picture of its time?

    Parameters
    ----------
    source, made : the recording and what was made of it
    """

    def __init__(self, source: Source, made: Made) -> None:
        self._small = np.array([_small(planes[: source.size_px[1]]) for planes in source.planes])
        self._times, self._numbers = np.array(list(made.times)), np.array(list(made.times.values()))
        self.right: list[bool] = []
        self.notes: list[str] = []
        self.t_s: dict[int, float] = {}

    def through(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Hand the frames on."""
        for place, frame in enumerate(frames):
            self.notes += frame.notes
            self.t_s[frame.index] = frame.t_s
            if place % EVERY_N == 0 and not frame.damaged:
                self.right.append(self._is_right(frame))
            yield frame

    def _is_right(self, frame: Frame) -> bool:
        near = int(np.abs(self._times - frame.t_s).argmin())
        places = np.arange(max(near - NEAR, 0), min(near + NEAR + 1, len(self._times)))
        shown = _small(frame.luma)
        off = np.array([np.abs(shown - self._of(self._numbers[k])).mean() for k in places])
        alike = places[off <= (1 + ALIKE) * off.min()]
        step_s = float(np.median(np.diff(self._times)))
        return bool(np.abs(self._times[alike] - frame.t_s).min() <= step_s / 2)

    def _of(self, number: float) -> np.ndarray:
        low, high = int(np.floor(number)), int(np.ceil(number))
        return (self._small[low] + self._small[high]) / 2


def _small(luma: np.ndarray) -> np.ndarray:
    h, w = (size // SMALLER * SMALLER for size in luma.shape)
    small = luma[:h, :w].reshape(h // SMALLER, SMALLER, w // SMALLER, SMALLER).mean(axis=(1, 3))
    return (small - small.mean()) / max(float(small.std()), 1e-6)


def judged(source: Source, made: Made, folder: Path) -> dict[str, Any]:
    """What towline makes of a recording."""
    keys = f'video = "{made.video}"\n{made.keys}'
    (folder / "run.toml").write_text(source.run_toml.replace('video = "video.mp4"\n', keys), encoding="utf-8")
    watched = Watched(source, made)
    try:
        run = read_run(folder)
        info = clip_info(run.source_path)
        mapping = fit_run_datum(run, info).mapping
        given = run.file.source
        frames = read_frames(run.source_path, given.span_s, given.frame_rate_hz, given.exposure_s)
        table = track(
            run, watched.through(frames), mapping, None, lossy=losses(info.codec)[0], linked=losses(info.codec)[1]
        ).table
    except TowlineError as error:
        return {"opened": False, "said": str(error).replace(f"{folder}/", "")}
    times, numbers = np.array(list(made.times)), np.array(list(made.times.values()))
    rms: list[np.ndarray] = []
    offsets, z = [], []
    held = shown = wrong = 0
    for place, name in enumerate(source.markers):
        rows = table[table["marker"] == name]
        number = numbers[np.abs(times[None, :] - rows["t_s"].to_numpy()[:, None]).argmin(axis=1)]
        truth = (
            source.place_px[np.floor(number).astype(int), place] + source.place_px[np.ceil(number).astype(int), place]
        ) / 2
        seen = np.isfinite(truth).all(axis=1)
        if made.hidden is not None:
            seen &= ~made.hidden[np.round(number).astype(int), place]
        gap = rows[["u_px", "v_px"]].to_numpy() - truth
        measured = (rows["status"] == "measured").to_numpy()
        right = measured & (np.hypot(gap[:, 0], gap[:, 1]) < RIGHT_PX)
        wrong += int((measured & ~right).sum())
        shown, held = shown + int(seen.sum()), held + int((right & seen).sum())
        if right.any():
            offsets.append(float(np.hypot(*np.median(gap[right], axis=0))))
            rest = _less_lag(rows["t_s"].to_numpy()[right], truth[right], gap[right])
            z.append(rest / rows[["sigma_u_px", "sigma_v_px"]].to_numpy()[right])
            rms.append(rest)
    pooled = np.concatenate(z) if z else np.full((1, 2), np.nan)
    return {
        "opened": True,
        "right": float(np.mean(watched.right)) if watched.right else np.nan,
        "held": held / max(shown, 1),
        "wrong": wrong,
        "z": float(np.sqrt(np.mean(pooled**2))),
        "rms": float(np.sqrt(np.mean(np.concatenate(rms) ** 2))) if rms else np.nan,
        "offset": max(offsets, default=np.nan),
        "frames": len(watched.t_s),
        "said": "; ".join(dict.fromkeys(note.partition(": ")[2] for note in watched.notes)),
    }


def _less_lag(t_s: np.ndarray, truth: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Errors without what no sigma holds: a mark's offset, and its lag against its motion (tracks.csv states that by itself)."""
    step_s = float(np.median(np.diff(t_s)))
    rest = gap.copy()
    for axis in (0, 1):
        speed = np.gradient(truth[:, axis], t_s) * step_s
        basis = np.column_stack([np.ones_like(speed), np.clip(speed / PLAY_PX, -1, 1)])
        rest[:, axis] -= basis @ np.linalg.lstsq(basis, gap[:, axis], rcond=None)[0]
    return rest


def original(source: Source) -> dict[str, Any]:
    """The source's own first pictures."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copyfile(source.path, Path(folder) / "video.mp4")
        times = {float(n / source.rate_hz): float(n) for n in range(len(source.planes))}
        last = max(times) + 0.5 / float(source.rate_hz)
        return judged(source, Made("video.mp4", times, f"span_s = [0.0, {last}]\n"), Path(folder))


def line(name: str, edit: str, got: dict[str, Any], base: float) -> str:
    """A row."""
    if not got["opened"]:
        return f"{name:6}{edit:31}no: {got['said']}"
    said = got["said"] if len(got["said"]) <= SAID else got["said"][: SAID - 3] + "..."
    return (
        f"{name:6}{edit:31}{got['frames']:6}{100 * got['right']:8.1f}{100 * got['held'] / base:10.1f}{got['wrong']:7}"
        f"{got['z']:7.2f}{got['rms']:8.3f}{got['offset']:8.3f}  {said}".rstrip()
    )


def main() -> None:
    """Make, read and judge; print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="edits whose name holds this")
    given = parser.parse_args()
    head = f"{'':37}{'frames':>6}{'times':>8}{'tracked':>10}{'wrong':>7}{'z':>7}{'rms':>8}{'offset':>8}  said"
    print(head + f"\n{'':37}{'':6}{'right %':>8}{'of it, %':>10}{'marks':>7}{'':7}{'px':>8}{'px':>8}", flush=True)
    there = sources()
    base: dict[str, float] = {}
    for name, source in there.items():
        got = original(source)
        base[name] = max(got.get("held", 0.0), 1e-9)
        print(line(name, "as it is", got, base[name]), flush=True)
    good: list[bool] = []
    for name, edit in cases(list(there)):
        if given.only in edit.name:
            got = _one(there[name], edit)
            print(line(name, edit.name, got, base[name]), flush=True)
            good.append(
                bool(
                    got["opened"] and got["right"] == 1 and got["held"] >= 0.99 * base[name] and 0.8 <= got["z"] <= 1.3
                )
            )
    print(f"\n{len(good)} edits: {sum(good)} open with every time right, 99 % of the marks and z in 0.8-1.3")


def _one(source: Source, edit: Edit) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        return judged(source, edit.make(source, Path(folder)), Path(folder))


if __name__ == "__main__":
    main()
