"""From film to derivatives: random campaigns rendered to video, through the commands, against the hull that was drawn.

    python benchmarks/end_to_end.py OUT [--campaigns 100] [--only 28 35 69 70] [--workers 2]

Every campaign is a hull, a camera with its lens and codec, marks, light, reflections, and four tow points; what run.toml says of
tension, line, speed, tow points and marks is wrong by what its [priors] admit. Each is analysed as ``towline identify`` does, then
again with parts of the truth put in: true pixels, true motion, true motion with true settings. What is left of the error each time
says where it came from. A campaign that is done is not done again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomlkit
from end_to_end_cases import PRIORS, SPEED_M_S, campaign, filmed

from towline.blind.scores import interval
from towline.pipeline.analysis import compute_motions, identify_batch
from towline.pipeline.executor.processes import THREADS, in_parallel
from towline.record.errors import TowlineError
from towline.record.files import write_text
from towline.simulate.model import DERIVATIVE_UNITS

LEVELS = ("film", "true pixels", "true motion", "true motion and settings")
TRUE_SIGMA_PX, TRUE_SIGMA_M, TRUE_SIGMA_RAD = 0.02, 2e-5, 1e-5
"""Stated beside true pixels and motions, which have none: a fit needs weights."""
CODECS = {"ffv1": "lossless", "h264": "H.264", "hevc": "HEVC", "hevc10": "HEVC 10 bit"}
CRF = ((17, 20), (21, 24), (25, 28))
COVERED = 1.96


def analysed(folders: list[Path]) -> dict[str, Any]:
    """Derivatives with their errors, and how long it took."""
    began = time.perf_counter()
    batch = compute_motions(folders)
    tracked_s = time.perf_counter() - began
    # damping goes with the speed: left to itself the fit quotes it at the stated one, which is off by what [priors] say
    answer = identify_batch(batch, speed_m_s=SPEED_M_S)
    lost = [float((m.motion["status"] != "measured").mean()) if "status" in m.motion else 0.0 for m in batch.runs]
    return {
        "derivatives": {n: [d.value, d.std] for n, d in answer.result.derivatives.items()},
        "failed": {**batch.failed, **answer.result.failed},
        "lost": lost,
        "track_s": round(tracked_s, 2),
        "fit_s": round(time.perf_counter() - began - tracked_s, 2),
    }


def with_truth(folders: list[Path], level: str, to: Path) -> list[Path]:
    """Runs of the same film in which tracks or motion, and maybe the settings, are the true ones."""
    made = []
    for folder in folders:
        here = to / level.replace(" ", "-") / folder.name
        here.mkdir(parents=True, exist_ok=True)
        settings = folder / "truth" / "run.toml" if level.endswith("settings") else folder / "run.toml"
        told: Any = tomlkit.parse(settings.read_text(encoding="utf-8"))
        del told["source"]["video"]
        if level == "true pixels":
            tracks = pd.read_csv(folder / "truth" / "tracks.csv", comment="#")
            tracks["sigma_u_px"] = tracks["sigma_v_px"] = TRUE_SIGMA_PX
            tracks.to_csv(here / "tracks.csv", index=False)
            told["source"]["tracks"] = "tracks.csv"
        else:
            motion = pd.read_csv(folder / "truth" / "motion.csv", comment="#")
            columns = ["t_s", "y_cg_m", "beta_rad", "alpha_rad", "x_cg_m"]
            motion = motion[columns].assign(sigma_y_cg_m=TRUE_SIGMA_M, sigma_beta_rad=TRUE_SIGMA_RAD)
            motion.to_csv(here / "motion.csv", index=False)
            told["source"]["motion"] = "motion.csv"
        (here / "run.toml").write_text(tomlkit.dumps(told), encoding="utf-8")
        made.append(here)
    return made


def one(out: str, seed: int, duration_s: float | None = None, keep: bool = False, rate_hz: float | None = None) -> int:
    """A campaign; its answer is OUT/NNN.json."""
    target = Path(out) / f"{seed:03d}.json"
    if target.is_file():
        return seed
    folder = Path(out) / f"{seed:03d}"
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    runs = campaign(seed, duration_s, rate_hz)
    folders = filmed(folder, runs, seed)
    found: dict[str, Any] = {
        "seed": seed,
        "truth": {name: runs[0]["hull"][name] for name in DERIVATIVE_UNITS},
        "film_s": len(runs) * runs[0]["time"]["duration_s"],
        "render_s": round(time.perf_counter() - began, 2),
        "codec": runs[0]["film"]["codec"],
        "crf": runs[0]["film"]["crf"],
    }
    for level in LEVELS:
        try:
            found[level] = analysed(folders if level == "film" else with_truth(folders, level, folder))
        except TowlineError as error:
            found[level] = {"error": str(error)}
    write_text(target, json.dumps(found, indent=1) + "\n")
    if not keep:
        shutil.rmtree(folder)
    return seed


def table(answers: list[dict[str, Any]]) -> str:
    """What came out."""
    whole = [a for a in answers if "derivatives" in a["film"]]
    lines = [
        f"{len(answers)} campaigns of 4 tows, {sum(a['film_s'] for a in answers) / 60:.0f} min of film; "
        f"{len(answers) - len(whole)} without an answer",
        f"priors of run.toml: {', '.join(f'{k} {v:g}' for k, v in PRIORS.items())}",
        "",
        f"{'derivative':16}{'median |error|':>15}{'median std':>12}{'worst':>8}{'bias/its se':>13}   95 % interval holds",
    ]
    for name in DERIVATIVE_UNITS:
        truth = np.array([a["truth"][name] for a in whole])
        value, std = np.array([a["film"]["derivatives"][name] for a in whole]).T
        share, z = (value - truth) / np.abs(truth), (value - truth) / std
        held = int((np.abs(z) < COVERED).sum())
        low, high = interval(held, len(z))
        bias = share.mean() / (share.std(ddof=1) / np.sqrt(len(share))) if len(share) > 1 else float("nan")
        lines.append(
            f"{name:16}{100 * np.median(np.abs(share)):13.2f} %{100 * np.median(std / np.abs(truth)):10.2f} %"
            f"{np.abs(z).max():7.1f}s{bias:13.1f}   "
            f"{held}/{len(z)} = {100 * held / len(z):.0f} % ({100 * low:.0f}-{100 * high:.0f})"
        )
    lines += ["", f"{'rms error in %, with':28}" + "".join(f"{name[:13]:>15}" for name in DERIVATIVE_UNITS)]
    for level in LEVELS:
        able = [a for a in whole if "derivatives" in a[level]]
        cells = []
        for name in DERIVATIVE_UNITS:
            share = [a[level]["derivatives"][name][0] / a["truth"][name] - 1 for a in able]
            cells.append(f"{100 * float(np.sqrt(np.mean(np.square(share)))):13.2f} %")
        label = level if len(able) == len(whole) else f"{level}, {len(able)} of them"
        lines.append(f"{label:28}" + "".join(f"{c:>15}" for c in cells))
    lines += ["", *_by_codec(whole)]
    minutes = np.array([a["film_s"] / 60 for a in whole])
    track, fit = (np.array([a["film"][k] for a in whole]) for k in ("track_s", "fit_s"))
    lines += [
        "",
        f"a minute of film: {np.median(track / minutes):.1f} s to track, {np.median(fit / minutes):.1f} s to fit "
        "(medians, one thread a campaign)",
    ]
    worst = sorted(whole, key=_worst, reverse=True)[:3]
    lines += ["worst:"] + [
        f"  campaign {a['seed']}, {CODECS[a['codec']]} crf {a['crf']}: {_worst(a):.1f} standard deviations"
        for a in worst
    ]
    lines += [f"  campaign {a['seed']}: {a['film']['error']}" for a in answers if "error" in a["film"]]
    return "\n".join(lines) + "\n"


def _by_codec(whole: list[dict[str, Any]]) -> list[str]:
    """What the film's compression costs."""
    lines = [
        f"{'by codec':12}{'campaigns':>10}{'median |error| of the six':>28}{'median std':>12}{'rms of z':>10}   95 % intervals hold"
    ]
    groups = [(CODECS[codec], [a for a in whole if a["codec"] == codec]) for codec in CODECS]
    lossy = [a for a in whole if a["codec"] != "ffv1"]
    groups += [(f"crf {low}-{high}", [a for a in lossy if low <= a["crf"] <= high]) for low, high in CRF]
    for name, here in groups:
        if not here:
            continue
        share = np.array([[v / a["truth"][n] - 1 for n, (v, _) in a["film"]["derivatives"].items()] for a in here])
        std = np.array([[s / abs(a["truth"][n]) for n, (_, s) in a["film"]["derivatives"].items()] for a in here])
        held = int((np.abs(share) < COVERED * std).sum())
        lines.append(
            f"{name:12}{len(here):10d}{100 * np.median(np.abs(share)):26.2f} %{100 * np.median(std):10.2f} %"
            f"{np.sqrt(np.mean(np.square(share / std))):10.2f}   {held}/{share.size} = {100 * held / share.size:.0f} %"
        )
    return lines


def _worst(a: dict[str, Any]) -> float:
    return max(abs(v - a["truth"][n]) / s for n, (v, s) in a["film"]["derivatives"].items())


def main() -> None:
    """Make what is missing, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--campaigns", type=int, default=100)
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="these campaigns alone")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=None, help="of every run; 30 to 45 where absent")
    given = parser.parse_args()
    for name in THREADS:
        os.environ.setdefault(name, "1")
    given.out.mkdir(parents=True, exist_ok=True)
    seeds = given.only or range(given.campaigns)
    jobs = [(str(given.out), seed, given.seconds) for seed in seeds]
    for done, seed in enumerate(in_parallel(one, jobs, given.workers), 1):
        print(f"campaign {seed}: {done} of {len(jobs)}", file=sys.stderr, flush=True)
    answers = [json.loads((given.out / f"{seed:03d}.json").read_text()) for seed in seeds]
    text = table(answers)
    write_text(given.out / "end_to_end.txt", text)
    print(text)


if __name__ == "__main__":
    main()
