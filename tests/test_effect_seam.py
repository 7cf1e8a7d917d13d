"""An effect of somebody's own, from one file: named in the tank, in the words, in the simulator. A line that sags."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import tomlkit

import towline
from towline.cli import main
from towline.pipeline.diagnosing import diagnose_folders, write_model
from towline.record import InputError

WEIGHT_N_M = 1.0
"""A chain of 0.1 kg a metre: on 0.91 m of line and 4 N its ends come 2 mm nearer."""


@pytest.fixture
def sag(root: Path, tmp_path: Path) -> Path:
    """The file of docs/developer/effect.md."""
    page = (root / "docs" / "developer" / "effect.md").read_text(encoding="utf-8")
    found = re.search(r"SAG = '''\n(.*?)'''", page, re.DOTALL)
    assert found is not None
    path = tmp_path / "sag.py"
    path.write_text(found[1])
    return path


@pytest.fixture(scope="module")
def folders(
    write_runs: Callable[[list, Path], list[Path]],
    cases: ModuleType,
    made_once: Callable[[str, Callable[[Path], None]], Path],
) -> list[Path]:
    """Tows at several speeds, so at several tensions, of a chain that hangs as a catenary: no parabola, no effect's formula."""

    def make(folder: Path) -> None:
        campaign = cases.campaign("sagging line", np.random.default_rng([25, 4]), size=WEIGHT_N_M, line="surge")
        write_runs(campaign.runs, folder, 26.0)  # the swings have died away by then

    return sorted(path.parent for path in made_once("sagging", make).glob("*/run.toml"))


@pytest.mark.slow
def test_a_sagging_line_is_named_by_its_own_file(
    folders: list[Path], straight_tow: Callable[[dict], dict], cases: ModuleType, sag: Path, tmp_path: Path
) -> None:
    found = diagnose_folders(folders, effects=[sag])
    file = found.diagnosis.file
    assert file.verdict == "effect"
    assert file.ranking[0].effects == ["sagging_line"]
    assert "a line that sags" in " ".join(file.sentences)
    squared = file.ranking[0].parameters["sagging_line.weight_squared"]
    assert abs(squared.value - WEIGHT_N_M**2) < 4 * squared.std + 0.1 * WEIGHT_N_M**2  # catenary against parabola
    assert file.ranking[0].gap_after < 1.15

    write_model(tmp_path / "model.toml", found)
    saved = tomlkit.parse((tmp_path / "model.toml").read_text()).unwrap()
    assert saved["effect"][0]["name"] == "sagging_line"
    path = tmp_path / "scenario.toml"
    path.write_text(tomlkit.dumps(straight_tow(saved)))
    assert main(["simulate", str(path), "--effects", str(sag)]) == 0
    straight = towline.simulate(path, effects=[sag])
    hangs = 0.91 - float(-straight["x_cg_m"].iloc[-1] - 1.6)
    assert hangs == pytest.approx(0.91 - cases.chord_m(0.91, 3.96, squared.value**0.5), rel=0.05)
    with pytest.raises(InputError, match=r"'sagging_line'; expected one of .*--effects FILE\.py"):
        towline.simulate(path)


@pytest.mark.slow
def test_without_its_file_something_is_missing(folders: list[Path]) -> None:
    """Three tows are enough for that, with the slow one among them."""
    file = towline.diagnose(*folders[1::2])
    assert file.verdict != "no_gap"
