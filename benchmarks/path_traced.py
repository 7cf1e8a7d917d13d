"""From path-traced films to derivatives to verdict: campaigns whose pictures the project's own renderer did not draw.

    python benchmarks/path_traced.py OUT [--campaigns 10] [--workers 1] [--folders DIR ...] [--keep FOLDER]
    python benchmarks/path_traced.py OUT --check          # is what is rendered where it is said to be?
    python benchmarks/path_traced.py OUT --again benchmarks/path_traced      # verdicts anew, from the tracks kept there

Ten campaigns of four films (30 s, 25 or 12.5 frames/s, 960x540): hull, camera, lens, lamps, water, marks and codec are drawn; three
hold an effect that their run.toml does not know. The same campaigns stand in the table with true pixels and white noise instead of
films (those without an effect). mitsuba traces the paths (``pip install mitsuba==3.9.1``, of this benchmark alone; on LLVM
16 or newer, which ``DRJIT_LIBLLVM_PATH`` finds, or on a graphics card). A film that is done is not done again, nor is a score.
``--folders``: other campaigns with a truth.json, scored beside them; one that is not there is skipped. ``--keep``: where truth,
seeds, tracks and scores go, without the films.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from path_traced_cases import PLANTED, TOWS, drawn, marks_px, motion_of, told, truth_of
from path_traced_score import kept, table, verdict_of

from towline.pipeline.executor.processes import THREADS, in_parallel
from towline.record.files import write_text

SEED, CAMPAIGNS = 31, 10
FEWEST = 3
"""Films of a campaign that is scored although it is not whole: so many tow points give the six."""
NOISE_PX = 0.02
"""Of true pixels, about a good film's."""
PLACES = 3
"""Digits after the point of kept pixels: a thousandth is a twentieth of what a mark is known to."""


def one(out: str, number: int, seed: int) -> int:
    """A campaign's films and its score, OUT/NN/score.json."""
    from path_traced_film import filmed

    case = drawn(number, seed)
    folders = filmed(case, Path(out), seed, lambda text: print(text, file=sys.stderr, flush=True))
    scored(Path(out) / f"{number:02d}", folders, truth_of(case))
    return number


def scored(home: Path, folders: list[Path], truth: dict[str, Any]) -> dict[str, Any]:
    """The score of a campaign that is filmed."""
    return kept(home / "score.json", folders, truth, diagnose=True)


def standing(out: Path, number: int) -> list[Path]:
    """Run folders of a campaign whose films stand; none where they are too few for the six derivatives."""
    home = out / f"{number:02d}"
    folders = [home / f"run-{k}" for k in range(1, TOWS + 1)]
    folders = [f for f in folders if (f / "video.mp4").is_file()]
    return folders if len(folders) >= FEWEST else []


def beside(given: Path, out: Path) -> dict[str, Any] | None:
    """The score of a campaign that was filmed elsewhere; its folder stays as it is."""
    if not (given / "truth.json").is_file():
        print(f"{given}: no truth.json, skipped", file=sys.stderr)
        return None
    home = out / given.name
    if not home.is_dir():
        shutil.copytree(given, home)
        for path in (home, *home.rglob("*")):
            path.chmod(path.stat().st_mode | 0o200)
    folders = sorted(p.parent for p in home.glob("*/run.toml"))
    return scored(home, folders, json.loads((home / "truth.json").read_text(encoding="utf-8"))) | {"codec": "as filmed"}


def of_tracks(folder: Path, tracks: pd.DataFrame, said: str) -> Path:
    """A run folder of tracks, with what is ``said`` of its film; the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    tracks.to_csv(folder / "tracks.csv", index=False)
    page = said.replace('video = "video.mp4"', 'tracks = "tracks.csv"')
    (folder / "run.toml").write_text(page, encoding="utf-8")
    return folder


def by_pixels(out: Path, number: int, seed: int) -> dict[str, Any]:
    """The score of a campaign from its true pixels with white noise of ``NOISE_PX``: what settings and fit leave."""
    case, home = drawn(number, seed), out / f"{number:02d}-pixels"
    rng = np.random.default_rng([seed, number, 3])
    folders = []
    for k, said in enumerate(told(case, seed)):
        motion = motion_of(case, k)
        parts = []
        for mark, pixels in zip(case["marks"], marks_px(case, motion).transpose(1, 0, 2), strict=True):
            u, v = (pixels + rng.normal(0, NOISE_PX, pixels.shape)).T
            sd = {"sigma_u_px": NOISE_PX, "sigma_v_px": NOISE_PX, "status": "measured"}
            part = pd.DataFrame(
                {"frame": range(len(u)), "t_s": motion["t_s"], "marker": mark["name"], "u_px": u, "v_px": v}
            )
            parts.append(part.assign(**sd))
        folders.append(of_tracks(home / f"run-{k + 1}", pd.concat(parts), said))
    return kept(home / "score.json", folders, truth_of(case), diagnose=False) | {"codec": "true pixels"}


def keep(out: Path, number: int, seed: int, to: Path) -> None:
    """Truth, draws, settings, tracks beside their true pixels, and the score of a campaign; no films."""
    home, there = out / f"{number:02d}", to / f"{number:02d}"
    there.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(home / "score.json", there / "score.json")
    write_text(there / "case.json", json.dumps(drawn(number, seed) | {"seed": seed}, indent=1) + "\n")
    parts = []
    for run in standing(out, number):
        shutil.copyfile(run / "run.toml", there / f"{run.name}.toml")
        truth = pd.read_csv(run / "truth.csv")
        for mark, track in pd.read_csv(run / "out" / "tracks.csv", comment="#").groupby("marker", sort=False):
            both = track.set_index("frame")[["u_px", "v_px", "sigma_u_px", "sigma_v_px"]].join(
                truth[[f"{mark}_u", f"{mark}_v"]]
            )
            both.columns = ["u_px", "v_px", "sigma_u_px", "sigma_v_px", "true_u_px", "true_v_px"]
            parts.append(both.reset_index().assign(run=run.name, mark=mark))
    tracks = pd.concat(parts, ignore_index=True)
    numbers = tracks.select_dtypes("float").columns
    tracks[numbers] = tracks[numbers].round(PLACES + 1).astype("float32")
    tracks.to_parquet(there / "tracks.parquet", compression="zstd", index=False)


def again(kept_there: Path, out: Path, number: int) -> str:
    """The verdict on a campaign's kept tracks, in a line; the films' own lag of the codec is not kept."""
    there, home = kept_there / f"{number:02d}", out / f"{number:02d}-again"
    case = json.loads((there / "case.json").read_text(encoding="utf-8"))
    folders = []
    for run, tracks in pd.read_parquet(there / "tracks.parquet").groupby("run", sort=True):
        columns = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status"]
        table = tracks.rename(columns={"mark": "marker"}).assign(t_s=tracks["frame"] / case["rate_hz"])
        seen = table["u_px"].notna()
        table = table.assign(status=np.where(seen, "measured", "lost"))[columns]
        folders.append(of_tracks(home / str(run), table, (there / f"{run}.toml").read_text(encoding="utf-8")))
    found = verdict_of(folders)
    if "verdict_error" in found:
        return f"{number:02d}  {found['verdict_error']}"
    first, planted = "", PLANTED.get(number, "nothing")
    if found["ranking"]:
        best = found["ranking"][0]
        first = f"first {' + '.join(best['effects'])} {best['p']:.2f}"
    return (
        f"{number:02d}  planted {planted:18} verdict {found['verdict']:14} no gap {found['p_no_gap']:5.2f}  "
        f"unknown {found['p_unknown']:5.2f}  {first}"
    )


def main() -> None:
    """Make what is missing, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--folders", type=Path, nargs="*", default=[], metavar="DIR")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="truth, seeds, tracks and scores, without the films"
    )
    parser.add_argument("--check", action="store_true", help="only say how far the pictures are from the formulae")
    parser.add_argument(
        "--again", type=Path, metavar="FOLDER", help="only verdicts, from the tracks that are kept there"
    )
    parser.add_argument("--no-films", action="store_true", help="score what is filmed already")
    given = parser.parse_args()
    for name in THREADS:
        os.environ.setdefault(name, "1")
    if given.check:
        from path_traced_check import checked

        print("\n".join(checked(list(range(given.campaigns)), given.seed)))
        return
    given.out.mkdir(parents=True, exist_ok=True)
    if given.again is not None:
        for number in range(given.campaigns):
            print(again(given.again, given.out, number), flush=True)
        return
    answers: dict[str, Any] = {}
    for folder in given.folders:
        if (found := beside(folder, given.out)) is not None:
            answers[folder.name] = found
    if not given.no_films:
        jobs = [(str(given.out), number, given.seed) for number in range(given.campaigns)]
        for number in in_parallel(one, jobs, given.workers):
            print(f"campaign {number} done", file=sys.stderr, flush=True)
    others = len(answers)
    for number in range(given.campaigns):
        if not (folders := standing(given.out, number)):
            continue
        case = drawn(number, given.seed)
        name = f"{number:02d}" if len(folders) == TOWS else f"{number:02d}, {len(folders)} films"
        found = scored(given.out / f"{number:02d}", folders, truth_of(case))
        answers[name] = found | {"codec": f"{case['codec']} {case['crf']}"}
        if given.keep is not None:
            keep(given.out, number, given.seed, given.keep)
    planted = ", ".join(f"{k:02d} {v}" for k, v in PLANTED.items() if k < given.campaigns)
    made = sum("films" not in name for name in list(answers)[others:])
    parts = len(answers) - others - made
    head = f"{made} of {given.campaigns} path-traced campaigns made whole, {parts} in part, seed {given.seed}; planted: {planted}\n"
    text = head + table(answers)
    text += "\nthe same without films: true pixels with white noise of 0.02 px\n"
    text += table({f"{n:02d}": by_pixels(given.out, n, given.seed) for n in range(given.campaigns) if n not in PLANTED})
    write_text(given.out / "path_traced.txt", text)
    print(text)


if __name__ == "__main__":
    main()
