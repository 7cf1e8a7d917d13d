"""Other ways from tows to the six derivatives: asked for by name, one's own registered from outside."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import towline
from towline.cli import main
from towline.identify import RunData
from towline.identify.estimators import estimators_table, register_estimator
from towline.identify.methods import SixEstimate

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
"""MARINER's, that the two runs were made with."""
NAMES = ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")


@pytest.fixture
def two_tows(tmp_path: Path) -> list[str]:
    """Small swings of MARINER at two tow points, T held constant, 60 s at 10 Hz, 0.2 mm and 0.02 degree of noise."""
    from towline.simulate import Hull, Start, Tow, simulate_full

    rng, folders = np.random.default_rng(4), []
    for x in (1.446, 1.751):
        folder = tmp_path / f"x{x:g}"
        folder.mkdir()
        tow = Tow(1.28, 0.91, x, 3.96)
        table = simulate_full(
            Hull(*SIX, speed_m_s=1.28), tow, Start(y_cg_m=0.03, beta_rad=0.01), np.arange(0, 60, 0.1)
        )[["t_s", "y_cg_m", "beta_rad"]]
        table[["y_cg_m", "beta_rad"]] += rng.normal(size=(len(table), 2)) * [2e-4, np.radians(0.02)]
        table["sigma_y_cg_m"], table["sigma_beta_rad"] = 2e-4, np.radians(0.02)
        table.to_csv(folder / "motion.csv", index=False)
        (folder / "run.toml").write_text(
            f'name = "{folder.name}"\nkind = "tow"\n[source]\nmotion = "motion.csv"\n[tow]\nspeed_m_s = 1.28\n'
            f'line_length_m = 0.91\ntow_point_m = {x}\ntension_n = 3.96\nline = "constant"\n'
            "[model]\nlength_pp_m = 2.66\nmass_kg = 78.0\n[water]\ndensity_kg_m3 = 1000.0\n"
        )
        folders.append(str(folder))
    return folders


@pytest.mark.parametrize("name", ["decay", "determinant", "trace"])
def test_the_thesiss_ways_give_the_six_within_what_they_state(two_tows: list[str], tmp_path: Path, name: str) -> None:
    assert main(["identify", *two_tows, "--estimator", name, "-o", str(tmp_path)]) == 0
    found = json.loads((tmp_path / f"derivatives_{name}.json").read_text())
    assert found["method"] == name
    z = [(found["derivatives"][n]["value"] - six) / found["derivatives"][n]["std"] for n, six in zip(NAMES, SIX)]
    assert np.abs(z).max() < 4.5, z
    assert not (tmp_path / "derivatives.json").exists()


def test_one_of_ones_own_is_asked_for_by_name(two_tows: list[str], tmp_path: Path, registries: None, capsys) -> None:
    @register_estimator("guess", "what the tests know", "any run")
    def guess(runs: Sequence[RunData], speed_m_s: float) -> SixEstimate:
        ratio = np.array([1, 1, *4 * [speed_m_s / 1.28]])
        return SixEstimate(SIX * ratio, np.diag((0.1 * SIX * ratio) ** 2), (f"of {len(runs)} runs",))

    assert main(["identify", *two_tows, "--estimator", "guess", "--speed", "1.0", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "what the tests know" in said
    assert "of 2 runs" in said
    found = json.loads((tmp_path / "derivatives_guess.json").read_text())
    assert found["derivatives"]["y_v"]["value"] == pytest.approx(-52.87 / 1.28)
    assert towline.identify(*two_tows, estimator="guess").derivatives["n_r"].value == -57.60


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--estimator", "nought"], "expected decay, arx, rates, determinant, trace"),
        (["--estimators", "FILE"], "which one"),
        (["--estimators", "ABSENT", "--estimator", "decay"], "absent.py: no such"),
        (["--estimator", "decay", "--thorough"], "--thorough goes with the joint fit"),
        (["--estimator", "wrong", "--estimators", "FILE"], "no finite answer"),
    ],
)
def test_what_cannot_be_is_said(
    two_tows: list[str], tmp_path: Path, registries: None, capsys, options: list[str], words: str
) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "import numpy as np\nfrom towline.identify.estimators import register_estimator\n"
        "from towline.identify.methods import SixEstimate\n"
        '@register_estimator("wrong", "nothing", "nothing")\n'
        "def wrong(runs, speed_m_s):\n    return SixEstimate(np.full(6, np.nan), np.eye(6))\n"
    )
    given = [o.replace("FILE", str(own)).replace("ABSENT", str(tmp_path / "absent.py")) for o in options]
    assert main(["identify", *two_tows, *given, "-o", str(tmp_path)]) != 0
    assert words in capsys.readouterr().err


def test_the_table_of_the_docs_is_made_of_what_is_registered(root: Path) -> None:
    assert estimators_table() in (root / "docs" / "methods" / "README.md").read_text(encoding="utf-8")
