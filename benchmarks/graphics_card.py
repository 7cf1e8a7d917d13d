"""What a graphics card gives: tracks and the differentiable camera chain, on it and on the processor.

    python benchmarks/graphics_card.py [--runs sample_videos/leander_steady] [--device cuda]

Writes a table to standard output; benchmarks/graphics_card.txt is a run of it. Needs the extra ``kornia`` and a CUDA device.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from geometry_cases import film, random_scene

from geometry import chain_of
from towline.geometry import motion_from_tracks, run_datum
from towline.geometry.chain import chain_motion
from towline.geometry.poses import poses_from_tracks
from towline.pipeline import stages
from towline.record.run import read_run

MINUTES = (1, 10, 100)
FRAMES_A_MINUTE = 1800
LONGEST_ON_CPU = 10
"""Minutes; the processor's share of a frame does not change beyond."""
DERIVATIVES = ("motion", "per_px", "per_lens", "per_matrix", "per_depth", "per_body")


def tracks(folder: Path, device: str) -> None:
    """The same films tracked with the fits on the processor and on the card."""
    print(f"== tracks of {folder.name}, frames/s; largest difference of any number in them", flush=True)
    for source in sorted(p for p in folder.iterdir() if (p / "run.toml").exists()):
        tables, speeds = [], []
        for where in ("cpu", device, device):  # a card's first call compiles
            with tempfile.TemporaryDirectory() as kept:
                copy = Path(kept) / source.name
                shutil.copytree(source, copy, ignore=shutil.ignore_patterns("out"))
                began = time.perf_counter()
                table = stages.track_run(read_run(copy), None, True, where).table
                speeds.append(table["t_s"].nunique() / (time.perf_counter() - began))
                tables.append(table)
        numbers = tables[0].select_dtypes("number").columns
        gap = max(float(np.nanmax(np.abs(tables[0][n] - tables[2][n]))) for n in numbers)
        print(f"{source.name:12s} cpu {speeds[0]:5.0f}   {device} {speeds[2]:5.0f}   {gap:.1e}", flush=True)


def chain(device: str) -> None:
    """The chain with all its derivatives, by the length of a film."""
    print("\n== the differentiable chain with all its derivatives, two marks at 30 Hz, us a frame", flush=True)
    for minutes in MINUTES:
        case = film(
            random_scene(np.random.default_rng(0), minutes * FRAMES_A_MINUTE),
            np.random.default_rng(1),
            noise=(0.0, 0.0),
        )
        fit = run_datum(case.run, None)
        began = time.perf_counter()
        motion_from_tracks(case.run, case.tracks, fit)
        spent = {"by hand": time.perf_counter() - began}
        found = poses_from_tracks(case.run, case.tracks, fit.mapping)
        stated, weight = chain_of(case, fit), np.linalg.inv(found.covariance_m2)
        answers = {}
        for where in (device, "cpu") if minutes <= LONGEST_ON_CPU else (device,):
            chain_motion(found.pixel_px[:100], stated, weight[:100], found.rigid.pose[:100], where)
            began = time.perf_counter()
            answers[where] = chain_motion(found.pixel_px, stated, weight, found.rigid.pose, where)
            spent[where] = time.perf_counter() - began
        each = ", ".join(f"{name} {1e6 * s / len(found.t_s):.1f}" for name, s in spent.items())
        print(f"{minutes:4d} min: {each}", flush=True)
        if len(answers) == 2:
            pairs = [(getattr(answers[device], name), getattr(answers["cpu"], name)) for name in DERIVATIVES]
            apart = max(float(np.abs(one - other).max() / np.abs(other).max()) for one, other in pairs)
            print(f"          {device} and cpu differ by at most {apart:.1e} of the largest of each", flush=True)


def main() -> None:
    """Both sections."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=Path, default=Path("sample_videos/leander_steady"))
    parser.add_argument("--device", default="cuda", help="cuda; torch (for the tracks) or cpu to try the script itself")
    given = parser.parse_args()
    import torch

    card = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "no card"
    print(f"torch {torch.__version__}, {card}", flush=True)
    tracks(given.runs, given.device)
    chain(given.device)


if __name__ == "__main__":
    main()
