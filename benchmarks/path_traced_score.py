"""Path-traced campaigns through the commands' functions: derivatives against the drawn hull, verdicts against what is planted."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from towline.pipeline.analysis import compute_motions, identify_batch
from towline.pipeline.diagnosing import diagnose_folders
from towline.record.errors import TowlineError
from towline.record.files import write_text
from towline.simulate.model import DERIVATIVE_UNITS

NAMES = tuple(DERIVATIVE_UNITS)
SLOW_HZ = 0.25
"""Errors of a mark slower than this look like motion to the fit."""
FACTOR = {"y_v": 1, "y_r_minus_mu": 1, "n_v": 1, "n_r": 1}
"""Derivatives that grow with the speed: how."""


def mark_errors(folder: Path) -> list[dict[str, Any]]:
    """Tracked minus true pixel of every mark of a run, in figures.

    ``follows``: what a pixel's speed, its place and its phase within the pixel explain of it, px (standard deviation; amplitude).
    """
    tracks = pd.read_csv(folder / "out" / "tracks.csv", comment="#")
    truth = pd.read_csv(folder / "truth.csv")
    rows = []
    for name, track in tracks.groupby("marker", sort=False):
        both = track.set_index("frame").join(truth, rsuffix="_true", how="inner")
        for axis in "uv":
            true, sigma = both[f"{name}_{axis}"].to_numpy(), both[f"sigma_{axis}_px"].to_numpy()
            off = both[f"{axis}_px"].to_numpy() - true
            seen = np.isfinite(off)
            off, true, sigma, t_s = off[seen], true[seen], sigma[seen], both["t_s_true"].to_numpy()[seen]
            speed = np.gradient(true, t_s)
            power = np.abs(np.fft.rfft(off - off.mean())) ** 2
            hz = np.fft.rfftfreq(len(off), float(np.median(np.diff(t_s))))
            columns = [np.ones_like(off), _unit(true), _unit(speed), np.cos(2 * np.pi * true), np.sin(2 * np.pi * true)]
            size = np.linalg.lstsq(np.stack(columns, axis=-1), off, rcond=None)[0]
            rows.append(
                {
                    "run": folder.name, "mark": str(name), "axis": axis, "frames": int(seen.sum()),
                    "mean_px": off.mean(), "sd_px": off.std(),
                    "sigma_px": float(np.median(sigma)), "rms_z": float(np.sqrt(np.mean((off / sigma) ** 2))),
                    "slow_share": float(power[(hz > 0) & (hz < SLOW_HZ)].sum() / max(power[1:].sum(), 1e-30)),
                    "place_px": size[1], "speed_px": size[2], "phase_px": float(np.hypot(size[3], size[4])),
                }
            )  # fmt: skip
    return rows


def _unit(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / max(values.std(), 1e-9)


def true_six(truth: dict[str, Any], speed_m_s: float) -> np.ndarray:
    """The six at the speed at which the fit quotes them."""
    ratio = speed_m_s / truth["at_speed_m_s"]
    return np.array([truth[n] * ratio ** FACTOR.get(n, 0) for n in NAMES])


def scored(folders: list[Path], truth: dict[str, Any]) -> dict[str, Any]:
    """A campaign from its films: errors, standard deviations, chi-square of all six, marks."""
    began = time.perf_counter()
    batch = compute_motions(folders)
    tracked_s = time.perf_counter() - began
    found: dict[str, Any] = {"truth": truth, "failed": batch.failed, "track_s": round(tracked_s, 1)}
    try:
        answer = identify_batch(batch)
    except TowlineError as error:
        return found | {"error": str(error)}
    found["failed"] = batch.failed | answer.result.failed
    off = answer.fit.six - true_six(truth, answer.fit.speed_m_s)
    covariance = answer.fit.covariance
    found |= {
        "error_of": dict(zip(NAMES, map(float, off), strict=True)),
        "sd_of": dict(zip(NAMES, map(float, np.sqrt(np.diag(covariance))), strict=True)),
        "chi2": float(off @ np.linalg.solve(covariance, off)),
        "fit_s": round(time.perf_counter() - began - tracked_s, 1),
        "notes": list(answer.fit.notes),
    }
    if all((f / "truth.csv").is_file() for f in folders):
        found["marks"] = [row for f in folders if (f / "out" / "tracks.csv").is_file() for row in mark_errors(f)]
    return found


def verdict_of(folders: list[Path]) -> dict[str, Any]:
    """What the diagnosis says of a campaign."""
    try:
        file = diagnose_folders(folders).diagnosis.file
    except TowlineError as error:
        return {"verdict_error": str(error)}
    return {
        "verdict": file.verdict,
        "p_no_gap": file.p_no_gap,
        "p_unknown": file.p_unknown,
        "ranking": [{"effects": list(r.effects), "p": r.probability} for r in file.ranking[:3]],
        "set95": file.set95,
    }


def kept(path: Path, folders: list[Path], truth: dict[str, Any], diagnose: bool) -> dict[str, Any]:
    """The score of a campaign and then its verdict, from its file so far as they stand there (of so many films)."""
    found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if found.get("films") != len(folders):
        found = scored(folders, truth) | {"films": len(folders)}
        write_text(path, json.dumps(found, indent=1) + "\n")
    if diagnose and not {"verdict", "verdict_error", "error"} & set(found):
        found |= verdict_of(folders)
        write_text(path, json.dumps(found, indent=1) + "\n")
    return found


def table(answers: dict[str, dict[str, Any]]) -> str:
    """What came out, campaign by campaign; pooled over those without a planted effect."""
    made = {k: a for k, a in answers.items() if "chi2" in a}
    null = {k: a for k, a in made.items() if not a["truth"].get("planted")}
    lines = [f"{len(made)} of {len(answers)} have an answer", ""]
    lines.append(f"{'campaign':15}{'codec':12}{'chi2 of 6':>10}   " + "".join(f"{n[:14]:>22}" for n in NAMES))
    lines.append(f"{'':40}" + "".join(f"{'err %  sd %     z':>22}" for _ in NAMES))
    for name, a in answers.items():
        if "chi2" not in a:
            lines.append(f"{name:15}{a['codec']:12} {a['error']}")
            continue
        cells = []
        for n in NAMES:
            error, sd = a["error_of"][n], a["sd_of"][n]
            whole = abs(a["truth"][n]) / 100
            cells.append(f"{error / whole:9.2f} {sd / whole:5.2f} {error / sd:6.2f}")
        lines.append(
            f"{name:15}{a['codec']:12}{a['chi2']:10.1f}   "
            + "".join(f"{c:>22}" for c in cells)
            + f"  {a['truth'].get('planted', '')}"
        )
    if null:
        total, degrees = sum(a["chi2"] for a in null.values()), 6 * len(null)
        low, high = chi2.ppf([0.005, 0.995], degrees)
        z = np.array([[a["error_of"][n] / a["sd_of"][n] for n in NAMES] for a in null.values()])
        share = np.array([[abs(a["error_of"][n] / a["truth"][n]) for n in NAMES] for a in null.values()])
        lines += [
            "",
            f"without a planted effect, {len(null)} campaigns: "
            f"chi-square {total:.1f} of {degrees} (99 % range {low:.1f} to {high:.1f}); "
            f"largest |z| {np.abs(z).max():.2f}; 95 % intervals hold {(np.abs(z) < 1.96).sum()} of {z.size}; "
            f"rms of z {np.sqrt((z**2).mean()):.2f}; median error {100 * np.median(share):.2f} %",
        ]
    told = {k: a for k, a in made.items() if "verdict" in a or "verdict_error" in a}
    lines += ["", "verdicts of the diagnosis"] if told else []
    for name, a in told.items():
        if "verdict_error" in a:
            lines.append(f"{name:15} {a['verdict_error']}")
            continue
        first = " + ".join(a["ranking"][0]["effects"]) if a["ranking"] else ""
        p = a["ranking"][0]["p"] if a["ranking"] else 0.0
        planted = a["truth"].get("planted") or "nothing"
        lines.append(
            f"{name:15} planted {planted:18} verdict {a['verdict']:14} first {first:28} {p:5.2f}  "
            f"no gap {a['p_no_gap']:5.2f}  unknown {a['p_unknown']:5.2f}"
        )
    marks = [(k, row) for k, a in made.items() for row in a.get("marks", [])]
    if marks:
        lines += [
            "",
            f"marks, tracked minus true pixel, medians over runs (slow: share of its power below {SLOW_HZ} Hz; place, speed:",
        ]
        lines += [
            "sd of the part that follows them; phase: amplitude of the part that follows the place within a pixel; all px)"
        ]
        lines.append(
            f"{'campaign':15}{'mark':8}{'axis':5}{'mean':>8}{'sd':>8}{'sigma':>8}{'rms z':>7}"
            f"{'slow':>7}{'place':>8}{'speed':>8}{'phase':>8}"
        )
        frame = pd.DataFrame([{"campaign": k} | row for k, row in marks])
        for (name, mark, axis), rows in frame.groupby(["campaign", "mark", "axis"], sort=False):
            m = rows[
                ["mean_px", "sd_px", "sigma_px", "rms_z", "slow_share", "place_px", "speed_px", "phase_px"]
            ].median()
            lines.append(
                f"{name:15}{mark:8}{axis:5}{m.mean_px:+8.3f}{m.sd_px:8.3f}{m.sigma_px:8.3f}{m.rms_z:7.2f}{100 * m.slow_share:6.0f}%"
                f"{m.place_px:+8.3f}{m.speed_px:+8.3f}{m.phase_px:8.3f}"
            )
    return "\n".join(lines) + "\n"
