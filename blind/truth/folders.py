"""A case's run folders, as a tank would hand them over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ...record import write_table
from ...record.files import write_text
from .carriage import speed_at
from .cases import Case, Filmed, filmed, lane_of, load_cell, picks, run_numbers, swum
from .forces import rudder_rad
from .lanes import Array, Lanes
from .motion import Path as Swum

TOLD_HZ = 50.0
"""Samples of the histories that run.toml names."""


def write_case(folder: Path, case: Case) -> list[Path]:
    """Write run-1, run-2, ... of a case into ``folder``; returns them.

    Parameters
    ----------
    folder : that is made
    case : as drawn
    """
    path, picked = swum(case), picks(case)
    return [
        _write_run(folder / f"run-{i + 1}", case, i, path, filmed(case, path, i), picked) for i in range(len(case.runs))
    ]


def write_run(folder: Path, case: Case, index: int) -> Path:
    """Write one run of a case into ``folder``; raises ValueError where the tow turns over.

    Parameters
    ----------
    folder : that is made
    case : as drawn
    index : of the run
    """
    path = swum(case)
    return _write_run(folder / f"run-{index + 1}", case, index, path, filmed(case, path, index), picks(case))


def _write_run(folder: Path, case: Case, index: int, path: Swum, film: Filmed, picked: Array) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    if case.video:
        from .film import write_film

        write_film(folder / "video.mp4", case, film.clean, np.random.default_rng([case.seed, 5, index]))
        write_film(folder / "static.mp4", case, film.still_clean, np.random.default_rng([case.seed, 6, index]))
    else:
        write_table(folder / "tracks.parquet", _tracks(case, film.t_s, film.pixel))
        write_table(folder / "static.parquet", _tracks(case, np.arange(len(film.still)) / case.rate_hz, film.still))
    if case.history:
        t_s, pull = load_cell(case, path, index)
        write_table(folder / "tension.csv", pd.DataFrame({"t_s": t_s, "tension_n": pull}))
    for name, column, history in _histories(case, index):
        write_table(folder / name, pd.DataFrame({"t_s": history[0], column: history[1]}))
    # the description last: a folder without one is not finished
    write_text(folder / "run.toml", _description(case, index, picked, film))
    return folder


def _histories(case: Case, index: int) -> list[tuple[str, str, tuple[Array, Array]]]:
    """Of the inputs that run.toml tells: file, column, times and values."""
    q, found = Lanes([lane_of(case, index)]), []
    t_s = np.arange(-1.0, case.duration_s + 2.0, 1 / TOLD_HZ)
    if case.told and q.has("rudder.period_s"):
        found.append(("rudder.csv", "rudder_rad", (t_s, rudder_rad(q, t_s))))
    if case.told and q.has("speed_drift.share"):
        # the wheel that says the speed is as wrong as what is stated of it
        scale = case.runs[index].stated["speed_m_s"] / q["speed"]
        found.append(("speed.csv", "speed_m_s", (t_s, np.array([float((speed_at(q, t) * scale)[0]) for t in t_s]))))
    return found


def _told(case: Case, index: int) -> list[str]:
    """Keys of [tow] for the inputs that run.toml tells."""
    q = run_numbers(case.told, index)
    keys = {"tow_point_offset_m": "tow_point_offset.offset_m", "post_amplitude_m": "carriage_shake.size_m"}
    keys |= {"post_frequency_hz": "carriage_shake.rate_hz", "post_phase_rad": "carriage_shake.phase"}
    if "rudder.period_s" not in q:
        keys["rudder_rad"] = "rudder.angle_rad"
    said = [f"{key} = {q[name]:.6f}" for key, name in keys.items() if name in q]
    return said + [f'{Path(name).stem} = "{name}"' for name, _, _ in _histories(case, index)]


def _tracks(case: Case, t_s: Array, pixel: Array) -> pd.DataFrame:
    n, marks = pixel.shape[:2]
    return pd.DataFrame(
        {
            "frame": np.repeat(np.arange(n), marks),
            "t_s": np.repeat(t_s, marks),
            "marker": np.tile(list(case.marks), n),
            "u_px": pixel[:, :, 0].ravel(),
            "v_px": pixel[:, :, 1].ravel(),
            "sigma_u_px": case.noise["stated_px"],
            "sigma_v_px": case.noise["stated_px"],
            "status": "measured",
        }
    )


def _description(case: Case, index: int, picked: Array, film: Filmed) -> str:
    stated, camera, hull = case.runs[index].stated, case.camera, case.hull
    ending = "mp4" if case.video else "parquet"
    source = f'video = "video.{ending}"' if case.video else f'tracks = "tracks.{ending}"'
    lines = [
        f'name = "{case.name}-{index + 1}"',
        'kind = "tow"',
        "",
        "[source]",
        source,
        "",
        "[noise]",
        f'static = "static.{ending}"',
        "",
        "[camera]",
        f"image_size_px = [{camera['width_px']:.0f}, {camera['height_px']:.0f}]",
        *(f"{name} = {camera[key]:.4f}" for name, key in (("fx_px", "f_px"), ("fy_px", "f_px"))),
        f"cx_px = {camera['cx_px']:.4f}",
        f"cy_px = {camera['cy_px']:.4f}",
        f"distortion = [{camera['k1']:.6f}, {camera['k2']:.6f}, 0.0, 0.0, 0.0]",
    ]
    for k, (pixel, place) in enumerate(zip(picked, case.datum, strict=True)):
        lines += [
            "",
            "[[datum]]",
            f'name = "d{k + 1}"',
            f"pixel_px = [{pixel[0]:.3f}, {pixel[1]:.3f}]",
            f"tank_m = [{place[0]:.5f}, {place[1]:.5f}, {place[2]:.5f}]",
            "sigma_px = 0.15",
        ]
    for m, (name, (ahead, depth, _)) in enumerate(case.marks.items()):
        lines += ["", "[[marker]]", f'name = "{name}"', f"body_m = [{ahead:.4f}, 0.0]", f"depth_m = {depth:.4f}"]
        if case.video:
            lines += ['look = "led"', f"seen_at_px = [{film.clean[0, m, 0]:.0f}.0, {film.clean[0, m, 1]:.0f}.0]"]
    pull = 'tension = "tension.csv"' if case.history else f"tension_n = {stated['tension_n']:.4f}"
    lines += [
        "",
        "[tow]",
        f"speed_m_s = {stated['speed_m_s']:.4f}",
        f"line_length_m = {stated['line_m']:.4f}",
        f"tow_point_m = {stated['tow_point_m']:.4f}",
        pull,
        *_told(case, index),
        "",
        "[model]",
        f"length_pp_m = {hull['length_pp']:.3f}",
        f"mass_kg = {hull['mass_stated']:.2f}",
        "",
        "[water]",
        f"density_kg_m3 = {hull['density']:.1f}",
        f"tank_width_m = {hull['tank_width']:.2f}",
    ]
    return "\n".join(lines) + "\n"
