"""The same input, the same version, the same machine: the same bytes, from other processes, in another folder, at another time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

FRAMES_S, RUN_S = 2.0, 25.0
"""Of a film, of a tow: the same bytes or not, however long."""
FilesOf = Callable[[Path], dict[str, bytes]]
HASH_SEEDS = ("1", "2")
"""Of Python's sets and dictionaries: an order that hangs on them shows."""
FILLED = ("0", "1")
"""What glibc fills the memory with that a library asks for (0: as it comes): a result that hangs on it shows."""


COMMANDS = "import json, sys; from towline.cli import main; sys.exit(max(map(main, json.loads(sys.argv[1]))))"
"""Several commands in one process."""


def towline(place: Path, which: int, *commands: list[str]) -> None:
    environment = {**os.environ, "PYTHONHASHSEED": HASH_SEEDS[which], "MALLOC_PERTURB_": FILLED[which]}
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)],
        cwd=place, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def assert_same(one: dict[str, bytes], other: dict[str, bytes], least: int) -> None:
    assert list(one) == list(other)
    assert len(one) >= least
    assert [name for name in one if one[name] != other[name]] == []


@pytest.mark.slow
def test_a_film_and_what_is_seen_in_it(samples: Path, files_of: FilesOf, tmp_path: Path) -> None:
    places = [tmp_path / "here", tmp_path / "and there"]
    for which, place in enumerate(places):
        place.mkdir()
        text = (samples / "mariner" / "x1446" / "scenario.toml").read_text()
        assert "duration_s = 40.0" in text
        (place / "scenario.toml").write_text(text.replace("duration_s = 40.0", f"duration_s = {FRAMES_S}"))
        read = [[command, "run"] for command in ("track", "motion", "check")]
        towline(place, which, ["render", "scenario.toml", "-o", "run"], *read)
    assert_same(*map(files_of, places), least=8)


@pytest.mark.slow
def test_derivatives_and_diagnosis(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], files_of: FilesOf, tmp_path: Path
) -> None:
    places = [tmp_path / "here", tmp_path / "and there"]
    whole = cases.campaign("none", np.random.default_rng(5)).runs[:2]
    runs = [(run, tracks[tracks["t_s"] < RUN_S], static) for run, tracks, static in whole]
    for which, place in enumerate(places):
        place.mkdir()
        names = [str(p.relative_to(place)) for p in write_runs(runs, place / "hall")]
        towline(place, which, ["identify", *names, "-o", "derivatives"], ["diagnose", *names, "-o", "gap"])
    assert_same(*map(files_of, places), least=12)
