"""Stages with versions of their own: what makes kept results stale, and that nobody forgets to raise a version.

Where results changed on purpose: raise the stage's version in ``pipeline/stages/versions.py``, and write the results anew with
``TOWLINE_STAGES=write pytest tests/test_stages.py``.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towline.pipeline.stages import compute_run_motion, track_run, versions
from towline.record import read_run

KEPT = Path(__file__).parent / "stage_results.json"
EVERY = 15
"""Frames."""
PLACES = {"u_px": 1e-4, "v_px": 1e-4, "sigma_u_px": 1e-4, "y_cg_m": 1e-6, "beta_rad": 1e-6, "sigma_y_cg_m": 1e-6}
"""To what a column is the same on another machine: its linear algebra differs in the last digits, its decoder does not."""


@pytest.fixture
def short(samples: Path, tmp_path: Path) -> Path:
    """The first three seconds of a sample tow."""
    folder = tmp_path / "run"
    shutil.copytree(samples / "mariner" / "x1446", folder, ignore=shutil.ignore_patterns("out"))
    text = (folder / "run.toml").read_text()
    (folder / "run.toml").write_text(text.replace("[source]\n", "[source]\nspan_s = [0.0, 3.0]\n", 1))
    return folder


def results_of(run: Path) -> dict[str, dict[str, Any]]:
    """What the stages give: a few columns of every so many rows."""
    made = compute_run_motion(read_run(run))
    assert made.tracks is not None
    bow = made.tracks[made.tracks["marker"] == "bow"]
    return {
        "tracks": {name: bow[name].to_numpy()[::EVERY].tolist() for name in ("u_px", "v_px", "sigma_u_px")},
        "motion": {
            name: made.motion[name].to_numpy()[::EVERY].tolist() for name in ("y_cg_m", "beta_rad", "sigma_y_cg_m")
        },
    }


def test_results_change_with_the_version_only(short: Path) -> None:
    found = {stage: {"version": versions.VERSIONS[stage], **values} for stage, values in results_of(short).items()}  # pyright: ignore
    if os.environ.get("TOWLINE_STAGES") == "write":
        KEPT.write_text(json.dumps(found, indent=1) + "\n")
    kept = json.loads(KEPT.read_text())
    for stage, values in found.items():
        assert values.pop("version") == kept[stage].pop("version"), (
            f"{stage}: write the results of this version (docstring)"
        )
        for name, now in values.items():
            apart = np.abs(np.subtract(now, kept[stage][name])).max()
            assert apart < PLACES[name], (
                f"{stage}: {name} changed by {apart:.2g}: raise VERSIONS[{stage!r}] (docstring)"
            )


@pytest.mark.slow
def test_a_raised_version_makes_its_stage_and_what_rests_on_it_anew(
    short: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = read_run(short)
    compute_run_motion(run)
    tracks, motion = (run.out / name for name in ("tracks.csv", "motion.csv"))
    made = tracks.stat().st_mtime_ns, motion.stat().st_mtime_ns
    compute_run_motion(run)
    assert (tracks.stat().st_mtime_ns, motion.stat().st_mtime_ns) == made
    monkeypatch.setitem(versions.VERSIONS, "motion", 1000)
    compute_run_motion(run)
    assert tracks.stat().st_mtime_ns == made[0]
    assert motion.stat().st_mtime_ns > made[1]
    monkeypatch.setitem(versions.VERSIONS, "tracks", 1000)
    assert track_run(run).anew
    before = motion.stat().st_mtime_ns
    compute_run_motion(run)
    assert motion.stat().st_mtime_ns > before


def test_a_stamp_follows_inputs_and_options(short: Path) -> None:
    run = read_run(short)
    before = versions.stamp_of(run, "motion", "exact")
    assert before == versions.stamp_of(read_run(short), "motion", "exact")
    assert before != versions.stamp_of(run, "motion", "trapezoid")
    text = (short / "run.toml").read_text()
    (short / "run.toml").write_text(text.replace("depth_m = 0.12", "depth_m = 0.121"))
    assert before != versions.stamp_of(read_run(short), "motion", "exact")
