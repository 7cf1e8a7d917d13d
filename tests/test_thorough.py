"""``towline identify --thorough``: the optimum and its intervals by other ways."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from towline.cli import main
from towline.record import read_result
from towline.record.priors import DERIVATIVE_NAMES
from towline.record.thorough_file import ThoroughFile

QUICK = ("--noise", "output", "--no-page")
BOOTSTRAP_TOL = 0.25
"""100 draws tell a standard deviation to 7 %; three and a half times that for the worst of six."""
SETTINGS_SHARE = 0.5
"""Drawn records hold the noise of the motion; errors of tension, speed and tow point, which are stated, are not drawn anew."""


@pytest.fixture(scope="module")
def runs(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], tmp_path_factory: pytest.TempPathFactory
) -> list[str]:
    folder = tmp_path_factory.mktemp("thorough")
    return [str(path) for path in write_runs(cases.campaign("none", np.random.default_rng(8)).runs[:2], folder)]


@pytest.mark.slow
def test_three_ways_agree_where_nothing_is_wrong(runs: list[str], tmp_path: Path) -> None:
    assert main(["identify", *runs, *QUICK, "--thorough", "3", "-o", str(tmp_path / "a")]) == 0
    found = read_result(tmp_path / "a" / "thorough.json", ThoroughFile)
    assert found.seed == 3
    assert found.better == 0
    assert 5 <= found.reached <= found.starts
    assert found.draws > 95
    assert list(found.derivatives) == list(DERIVATIVE_NAMES)
    for one in found.derivatives.values():
        assert one.bootstrap_std is not None
        assert SETTINGS_SHARE < one.bootstrap_std / one.std < 1 + BOOTSTRAP_TOL
        assert one.profile_interval is None  # the camera's errors move in this fit
    assert not any("larger" in sentence for sentence in found.sentences)


@pytest.mark.slow
def test_json_holds_it(runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", runs[0], *QUICK, "--form", "linear", "--thorough", "--json", "-o", str(tmp_path)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["result"]["thorough"]["seed"] == 1
    assert str(tmp_path / "thorough.json") in said["wrote"]
