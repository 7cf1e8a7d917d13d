"""Runs in which a fit or a start runs off beyond all numbers on the way: what is missing is named all the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from towline.blind.one_case import case_of
from towline.blind.truth.folders import write_case
from towline.pipeline.diagnosing import diagnose_folders

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("kind", "forms", "index"),
    [
        ("effect", {"constant_tension": "sticking"}, 557),
        ("pair", {"tension_variation": "hunting", "tow_point_offset": "fixed"}, 517),
    ],
    ids=["a line whose forces have no size", "random forces beside which squares sum to less than nothing"],
)
def test_the_first_effect_is_named(tmp_path: Path, kind: str, forms: dict[str, str], index: int) -> None:
    """Case-558 and case-518 of seed 271148, which had ended in "normal equations cannot be solved"."""
    case = case_of("off", kind, list(forms), [271148, index], forms=forms)
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis.file
    assert found.verdict == "effect"
    assert next(iter(forms)) in found.ranking[0].effects
