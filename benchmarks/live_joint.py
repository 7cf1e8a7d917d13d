"""Two live cameras of one tow, joined while it is filmed: joint values against the truth.

    python benchmarks/live_joint.py [OUT] [--tows 30] [--seed 0] [--only level unstamped rolling played films]

The tows are those of ``two_cameras_cases``: pixel tracks through two cameras of OpenCV's that are not synchronised. Their frames
come as ``live.jsonl`` has them, each some time after it was taken (a camera's own delay, up to ``DELAY_S``, and jitter), and the
joint is asked ten times a second of that clock, as while a tow is filmed. Unstamped: the sources stamp nothing, so that a frame's
time is when it came, with ``UNSTAMPED_S`` of jitter. Played: nothing is known from when pictures come. Films:
rendered tows (``two_cameras_films``, into OUT), every frame looked at as ``towline live`` does, as fast as it is read.
z: error over all that is stated of it, at three moments of what each camera, or both, told of a tow, before the second clock is
told and after it; the clock each time it was said to be told.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from two_cameras_cases import Case, random_case

from towline.geometry.motion import run_datum
from towline.live.joint import Joint
from towline.live.session import Looking, frame_record
from towline.live.stamped import Stamped
from towline.pipeline.stages import fit_run_datum
from towline.record.run import Run, cameras_of, read_run
from towline.vision import read_frames

DELAY_S, JITTER_S = 0.3, 0.02
"""Between a picture and its last byte here: a camera's own, evenly up to the first; and of every picture, exponential."""
UNSTAMPED_S = 0.006
"""Where frames are stamped when they come: beyond it no beat is told at 25 frames/s (``vision.recording.beat``)."""
ASKED_S = 0.1
NAMES = ("y_cg_m", "beta_rad")
MOMENTS = (0.1, 0.5, 0.9)
"""Of the rows that one camera, or both, told of a tow."""
FEWEST = 10
DEGREE = float(np.degrees(1.0))


@dataclass(frozen=True)
class Told:
    """What was said of one tow: the joint's lines, and what was said of the clock, each with when it was said."""

    rows: pd.DataFrame
    clock: list[dict[str, Any]]


def lines_of(case: Case, rng: np.random.Generator, jitter_s: float = JITTER_S) -> list[list[dict[str, Any]]]:
    """Each camera's frames as ``live.jsonl`` has them."""
    found = []
    for place, tracks in enumerate(case.tracks):
        delay = rng.uniform(0, DELAY_S)
        lines: list[dict[str, Any]] = []
        names = tracks["marker"].unique().tolist()
        count = tracks["frame"].nunique()
        places = tracks[["u_px", "v_px", "sigma_u_px", "sigma_v_px"]].to_numpy().reshape(count, len(names), 4)
        own_s = tracks["t_s"].to_numpy().reshape(count, len(names))[:, 0]
        taken_s = own_s if place == 0 else case.offset_s + (1 + case.rate) * own_s
        here_s = np.maximum.accumulate(taken_s + delay + rng.exponential(jitter_s, count))
        for frame, (t_s, arrived_s, each) in enumerate(zip(own_s.tolist(), here_s.tolist(), places, strict=True)):
            marks = {
                name: [float(v) for v in four] if np.isfinite(four).all() else "not there"
                for name, four in zip(names, each, strict=True)
            }
            lines.append({"frame": frame, "t_s": t_s, "arrived_s": arrived_s, "marks": marks, "light": 0.3})
        found.append(lines)
    return found


@dataclass(frozen=True)
class Unstamped:
    """Frames stamped when they came.

    Attributes
    ----------
    lines : of each camera
    zero_s : what the first camera's recording shows when its own clock shows 0, but for the shortest way here
    offset_s : what it shows when the second one's recording shows 0
    """

    lines: list[list[dict[str, Any]]]
    zero_s: float
    offset_s: float


def unstamped(case: Case, lines: list[list[dict[str, Any]]]) -> Unstamped:
    """As if the sources stamped nothing: a frame's time is when it came, from the camera's first one on."""
    zeros, found = [], []
    for place, each in enumerate(lines):
        first_s = each[0]["arrived_s"]
        offset_s, step = (0.0, 1.0) if place == 0 else (case.offset_s, 1 + case.rate)
        zeros.append(min(line["arrived_s"] - offset_s - step * line["t_s"] for line in each) - first_s)
        found.append([{**line, "t_s": line["arrived_s"] - first_s, "on_arrival": True} for line in each])
    return Unstamped(found, zeros[0], zeros[0] - zeros[1])


def heard(
    lines: list[list[dict[str, Any]]], every_s: float = ASKED_S
) -> Iterator[tuple[float, list[list[dict[str, Any]]]]]:
    """What came of each until then, again and again."""
    at, now_s = [0, 0], min(each[0]["arrived_s"] for each in lines)
    while any(k < len(each) for k, each in zip(at, lines, strict=True)):
        now_s += every_s
        new = []
        for place, each in enumerate(lines):
            first = at[place]
            while at[place] < len(each) and each[at[place]]["arrived_s"] <= now_s:
                at[place] += 1
            new.append(each[first : at[place]])
        yield now_s, new


def filmed(case: Case, rng: np.random.Generator, by_arrival: bool = True, every_s: float = ASKED_S) -> Told:
    """All that is said of a case while it comes."""
    return told_of(joint_of(case, by_arrival), lines_of(case, rng), every_s)


def joint_of(case: Case, by_arrival: bool = True) -> Joint:
    """Of a case's two cameras."""
    return Joint(case.run, [run_datum(view, None) for view in cameras_of(case.run)], by_arrival)


def told_of(joint: Joint, lines: list[list[dict[str, Any]]], every_s: float = ASKED_S) -> Told:
    """All that is said of lines while they come."""
    rows: list[dict[str, Any]] = []
    clock = []
    now_s = 0.0
    for now_s, new in heard(lines, every_s):
        for place in (0, 1):
            joint.add(place, new[place])
        said = joint.match()
        if said is not None:
            clock.append({**said, "now_s": now_s})
        rows += [{**row, "now_s": now_s} for row in joint.rows()]
    rows += [{**row, "now_s": now_s} for row in joint.rows(ended=True)]
    return Told(pd.DataFrame(rows), clock)


# the table ------------------------------------------------------------------------------------------------------------


class Tally:
    """Errors of many tows, by who told them and whether the clock was told."""

    def __init__(self) -> None:
        self.values: dict[tuple[bool, str], list[np.ndarray]] = {}
        self.clock: list[tuple[float, float]] = []
        self.told_s: list[float] = []
        self.behind_s: list[float] = []
        self.cpu: list[float] = []
        self.untold = 0

    def add(self, told: Told, truth: Callable[[np.ndarray], np.ndarray], offset_s: float) -> None:
        """A tow; ``truth``: times of the first clock -> (n, 2) y and heading."""
        rows = told.rows
        for key, some in rows[rows["y_cg_m"].notna()].groupby(["told", "camera"]):
            if len(some) < FEWEST:
                continue
            for moment in MOMENTS:
                row = some.iloc[int(moment * len(some))]
                right = truth(np.array([row["t_s"]]))[0]
                found = np.array([row[name] for name in NAMES])
                self.values.setdefault((bool(key[0]), str(key[1])), []).append(  # pyright: ignore
                    np.array([found[:, 0] - right, np.hypot(found[:, 1], found[:, 2])])
                )
        known = [said for said in told.clock if said["told"]]
        self.clock += [(said["offset_s"][0] - offset_s, said["offset_s"][1]) for said in known]
        self.untold += not known
        if known:
            self.told_s.append(known[0]["t_s"])
        self.behind_s += (rows["now_s"] - rows["arrived_s"]).tolist()

    def show(self, name: str, tows: int) -> None:
        """A block of the table."""
        off, sd = np.array(self.clock).T
        last = (
            f"told in {tows - self.untold} of {tows} tows, first after {np.median(self.told_s):.1f} s (median; latest "
        )
        last += f"{max(self.told_s):.1f})"
        print(
            f"{name}: {last}; each time it was told: rms {1e3 * _rms(off):.1f} ms, z {_rms(off / sd):.2f}, beyond 3 sd ",
            end="",
        )
        print(f"{int((np.abs(off / sd) > 3).sum())} of {len(off)}")
        late, cpu = np.percentile(self.behind_s, [50, 99]), np.mean(self.cpu)
        print(
            f"  after the first camera's picture: median {late[0]:.2f} s, 99 % {late[1]:.2f} s; {cpu:.1f} s of a core a tow"
        )
        heads = ("y, mm rms", 11), ("stated", 8), ("z", 6), ("heading", 10), ("stated", 8), ("z", 6), ("worst z", 9)
        print(f"  {'clock':10}{'by':18}{'rows':>6}" + "".join(f"{head:>{width}}" for head, width in heads))
        for (told, camera), found in sorted(self.values.items()):
            error, stated = np.array(found).transpose(1, 2, 0)
            z = error / stated
            cells = f"{1e3 * _rms(error[0]):11.2f}{1e3 * np.median(stated[0]):8.2f}{_rms(z[0]):6.2f}{DEGREE * _rms(error[1]):10.3f}"
            cells += f"{DEGREE * np.median(stated[1]):8.3f}{_rms(z[1]):6.2f}{np.abs(z).max():9.1f}"
            print(f"  {'told' if told else 'not told':10}{camera:18}{error.shape[1]:6d}{cells}")
        print(flush=True)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def tows(
    name: str,
    count: int,
    seed: int,
    marks: tuple[str, ...],
    rolls: bool,
    by_arrival: bool = True,
    stamps: bool = True,
) -> None:
    """Tows of pixel tracks."""
    from two_cameras import quoted

    tally = Tally()
    for k in range(count):
        case = random_case(seed + k, marks, rolls=rolls, pull_px_rad=(0.0, 0.2, 0.4)[k % 3])
        rng, zero_s, offset_s = np.random.default_rng([seed, k]), 0.0, case.offset_s
        lines = lines_of(case, rng, JITTER_S if stamps else UNSTAMPED_S)
        if not stamps:
            without = unstamped(case, lines)
            lines, zero_s, offset_s = without.lines, without.zero_s, without.offset_s
        began = time.process_time()
        told = told_of(joint_of(case, by_arrival), lines)
        tally.cpu.append(time.process_time() - began)
        tally.add(told, lambda t_s, case=case, zero_s=zero_s: quoted(case, t_s - zero_s, marks)[:, 1:3], offset_s)
    tally.show(name, count)


def looked_at(run: Run, offset_s: float, rate: float) -> list[list[dict[str, Any]]]:
    """Both films as ``live.jsonl`` has them, every frame looked at."""
    found = []
    for place, view in enumerate(cameras_of(run)):
        looking = Looking(view, fit_run_datum(view), "h264")
        lines = []
        for frame in read_frames(view.source_path):
            taken_s = frame.t_s if place == 0 else offset_s + (1 + rate) * frame.t_s
            seen, _ = looking.step(Stamped(frame, taken_s + 0.1))
            looking.settle()
            assert seen is not None
            lines.append(frame_record(seen, 0.0))
        found.append(lines)
    return found


def films(out: Path) -> None:
    """Rendered tows of the sample models."""
    from two_cameras import ENDS_S, FILMS, POSES, ROOT
    from two_cameras_films import film_two

    tally = Tally()
    for k, (name, offset_s, rate) in enumerate(FILMS):
        scenario = ROOT / "sample_videos" / "mariner" / name / "scenario.toml"
        made = film_two(scenario, out / name, POSES, ENDS_S, (30.0, 25.0), offset_s, rate, 40 + k, (640, 480))
        run = read_run(made.folder)
        lines = looked_at(run, offset_s, rate)
        began = time.process_time()
        told = told_of(Joint(run, [fit_run_datum(view) for view in cameras_of(run)]), lines)
        tally.cpu.append(time.process_time() - began)
        tally.add(told, lambda t_s, made=made: made.truth(t_s)[:, 1:3], offset_s)
    tally.show("films, 640x480, 30 and 25 frames/s, H.264, 20 s", len(FILMS))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", nargs="?", type=Path)
    parser.add_argument("--tows", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="added to the seed of every random tow")
    parser.add_argument("--only", nargs="+", default=["level", "unstamped", "rolling", "played", "films"])
    options = parser.parse_args()
    two, four = ("bow", "stern"), ("bow", "stern", "mast", "side")
    if "level" in options.only:
        tows("level, two marks", options.tows, options.seed + 9500, two, rolls=False)
    if "unstamped" in options.only:
        tows("level, sources that stamp nothing", options.tows, options.seed + 9500, two, rolls=False, stamps=False)
    if "rolling" in options.only:
        tows("rolling, four marks", options.tows // 2, options.seed + 9600, four, rolls=True)
    if "played" in options.only:
        tows("level, films that are played", options.tows // 2, options.seed + 9700, two, rolls=False, by_arrival=False)
    if "films" in options.only:
        with tempfile.TemporaryDirectory() as scratch:
            films(options.out or Path(scratch))


if __name__ == "__main__":
    main()
