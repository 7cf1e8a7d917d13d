"""The same input, the same version, the same machine: the same bytes, from other processes, in another folder, at another time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

FRAMES_S = 2.0
FilesOf = Callable[[Path], dict[str, bytes]]
HASH_SEEDS = ("1", "2")
"""Of Python's sets and dictionaries: an order that hangs on them shows."""


def towline(place: Path, hash_seed: str, *arguments: str) -> None:
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
    done = subprocess.run(
        [sys.executable, "-m", "towline", *arguments], cwd=place, env=environment, capture_output=True, text=True, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def assert_same(one: dict[str, bytes], other: dict[str, bytes], least: int) -> None:
    assert list(one) == list(other)
    assert len(one) >= least
    assert [name for name in one if one[name] != other[name]] == []


def test_a_film_and_what_is_seen_in_it(samples: Path, files_of: FilesOf, tmp_path: Path) -> None:
    places = [tmp_path / "here", tmp_path / "and there"]
    for place, seed in zip(places, HASH_SEEDS, strict=True):
        place.mkdir()
        text = (samples / "mariner" / "x1446" / "scenario.toml").read_text()
        assert "duration_s = 40.0" in text
        (place / "scenario.toml").write_text(text.replace("duration_s = 40.0", f"duration_s = {FRAMES_S}"))
        towline(place, seed, "render", "scenario.toml", "-o", "run")
        for command in ("track", "motion", "check"):
            towline(place, seed, command, "run")
    assert_same(*map(files_of, places), least=8)


def test_derivatives_and_diagnosis(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], files_of: FilesOf, tmp_path: Path
) -> None:
    places = [tmp_path / "here", tmp_path / "and there"]
    for place, seed in zip(places, HASH_SEEDS, strict=True):
        place.mkdir()
        runs = cases.campaign("none", np.random.default_rng(5)).runs[:2]
        names = [str(p.relative_to(place)) for p in write_runs(runs, place / "hall")]
        towline(place, seed, "identify", *names, "-o", "derivatives")
        towline(place, seed, "diagnose", *names, "-o", "gap")
    assert_same(*map(files_of, places), least=12)
