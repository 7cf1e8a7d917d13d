"""Seconds of ``towline identify`` against the number of runs and of frames: run folders, derivatives and page, one thread.

    python benchmarks/identify_scale.py [--runs 4 16 64] [--frames 54000] [--rate 64] [--repeats 1]

MARINER tows at four tow points, each with its own release and with tension, tow point and speed off by what its [priors] say;
motion tables with 1 mm and 0.1 degree of white noise, written as run folders with ``source.motion``.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from identify_cases import HULL, LENGTH_M, POINTS_M, SIGMA_BETA_RAD, SIGMA_Y_M, TENSION_N, times

from towline.pipeline.executor.processes import THREADS
from towline.record.tables import write_table
from towline.simulate import Start, Tow, simulate_full

SPAN_S = 60.0
TENSION_SD_REL, TOW_POINT_SD_M, TENSION_COMMON_SD_REL, LINE_LENGTH_SD_M, SPEED_SD_REL = 0.005, 1e-3, 0.003, 1e-3, 2e-3
MASS_KG = 78.0
SURGING = replace(HULL, mass_kg=MASS_KG, x_udot_kg=-0.05 * MASS_KG, x_vr_kg=0.5 * (HULL.m_minus_y_vdot - MASS_KG))
LONG_POINT_M = 1.72
"""A tow that neither grows nor decays much within half an hour."""
TOML = """\
name = "{name}"
kind = "tow"

[source]
motion = "motion.csv"

[tow]
speed_m_s = 1.28
line_length_m = {length}
tow_point_m = {point}
tension_n = {tension}

[model]
length_pp_m = 2.66
mass_kg = {mass}

[water]
density_kg_m3 = 1000.0

[priors]
tension_sd_rel = {tension_sd}
tow_point_sd_m = {point_sd}
tension_common_sd_rel = {common_sd}
line_length_sd_m = {length_sd}
speed_sd_rel = {speed_sd}
"""


def written(folder: Path, name: str, point_m: float, t_s: np.ndarray, rng: np.random.Generator) -> Path:
    """A run folder; run.toml says the tow as it was meant to be."""
    tow = Tow(
        1.28 * (1 + SPEED_SD_REL * 0.5),
        LENGTH_M - 0.5 * LINE_LENGTH_SD_M,
        point_m + TOW_POINT_SD_M * rng.normal(),
        TENSION_N * (1 + 0.5 * TENSION_COMMON_SD_REL + TENSION_SD_REL * rng.normal()),
        line="surge",
    )
    start = Start(y_cg_m=rng.uniform(0.08, 0.18) * rng.choice([-1, 1]), beta_rad=rng.normal(0, 0.02))
    motion = simulate_full(SURGING, tow, start, t_s)[["t_s", "y_cg_m", "beta_rad"]]
    motion["y_cg_m"] += rng.normal(0, SIGMA_Y_M, len(t_s))
    motion["beta_rad"] += rng.normal(0, SIGMA_BETA_RAD, len(t_s))
    motion["alpha_rad"] = np.nan
    motion["sigma_y_cg_m"], motion["sigma_beta_rad"], motion["status"] = SIGMA_Y_M, SIGMA_BETA_RAD, "measured"
    run = folder / name
    run.mkdir(parents=True)
    write_table(run / "motion.csv", motion)
    said = TOML.format(
        name=name, mass=MASS_KG, length=LENGTH_M, point=point_m, tension=TENSION_N,
        tension_sd=TENSION_SD_REL, point_sd=TOW_POINT_SD_M,
        common_sd=TENSION_COMMON_SD_REL, length_sd=LINE_LENGTH_SD_M, speed_sd=SPEED_SD_REL,
    )  # fmt: skip
    (run / "run.toml").write_text(said)
    return run


def timed(runs: list[Path], out: Path, repeats: int) -> tuple[float, float]:
    """Seconds of the command and of the processor, the least of some: the second says more where others use the machine."""
    command = [sys.executable, "-m", "towline", "identify", *map(str, runs), "--out", str(out)]
    found = []
    for _ in range(repeats):
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        found.append((took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return min(one[0] for one in found), min(one[1] for one in found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, nargs="+", default=[4, 16, 64])
    parser.add_argument("--frames", type=int, nargs="*", default=[54000])
    parser.add_argument("--rate", type=float, default=64.0)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="write the run folders there and keep them")
    given = parser.parse_args()
    for name in THREADS:
        os.environ[name] = "1"
    with tempfile.TemporaryDirectory() as place:
        folder = given.keep or Path(place)
        rng = np.random.default_rng(64)
        t_s = times(given.rate, SPAN_S)
        many = [
            written(folder, f"run-{k + 1:02d}", POINTS_M[k % 4], t_s, rng) for k in range(max(given.runs, default=0))
        ]
        cases = [(f"{count} runs of {SPAN_S:g} s", many[:count], len(t_s)) for count in given.runs]
        for frames in given.frames:
            long = written(folder, f"long-{frames}", LONG_POINT_M, times(given.rate, frames / given.rate), rng)
            cases.append((f"1 run of {frames / given.rate:.0f} s", [long], frames))
        print(
            f"towline identify, {given.rate:g} samples a second, full form, five priors, page and figures; one thread"
        )
        print(
            f"{'':22}{'frames':>8}{'seconds':>9}{'processor':>11}{'to the first':>14}{'a run, s':>10}{'1000 frames, s':>16}"
        )
        first = None
        for words, runs, frames in cases:
            took, busy = timed(runs, folder / "out", given.repeats)
            first = busy if first is None else first
            total = frames * len(runs)
            print(
                f"{words:22}{total:8d}{took:9.2f}{busy:11.2f}{busy / first:14.2f}{busy / len(runs):10.2f}"
                f"{1000 * busy / total:16.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
