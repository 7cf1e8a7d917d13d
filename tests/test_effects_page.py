"""docs/effects.md is made from the library; an effect of somebody's own needs one object, and is on the page and in the words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from towline.diagnose.effects import LIBRARY, Effect, Parameter, slack
from towline.diagnose.effects.page import effects_page, whole_library
from towline.diagnose.effects.slack_line import springing

SAGGING = Effect(
    "sagging_line",
    "line",
    (Parameter("weight_n_m", "N/m", 0.05, one_sided=True),),
    "A heavy line hangs through, and is the shorter the less it pulls.",
    "Use a lighter line, or give its weight.",
    length=lambda tension_n, length_m, weight: -(weight**2) * length_m**3 / (24 * tension_n**2),
    title="a line that sags",
)
"""The chord of a parabola of length L under w N/m: L - w^2 L^3/(24 T^2)."""


def test_the_page_is_made_from_the_library(root: Path) -> None:
    page = (root / "docs" / "effects.md").read_text(encoding="utf-8")
    assert page == effects_page(whole_library()), "run `make docs`"


def test_an_effect_of_ones_own_is_on_the_page() -> None:
    [row] = [line for line in effects_page([*LIBRARY, SAGGING]).splitlines() if "sagging_line" in line]
    assert row == (
        "| `sagging_line` | line | `weight_n_m` 0.05 N/m, above 0 | 3 % | A heavy line hangs through, and is the shorter the less "
        "it pulls. | Use a lighter line, or give its weight. |"
    )


def test_every_effect_has_a_title_of_its_own() -> None:
    titles = {e.name: e.title for e in whole_library()}
    assert all(titles.values())
    assert len(set(titles.values())) == len(titles)
    assert replace(SAGGING, title="").title == ""


def test_what_belongs_to_the_runs_made_says_so() -> None:
    """A window or a bounce found in a residual foretells nothing of another run."""
    assert not any(e.bound for e in LIBRARY)
    assert slack([(1.0, 2.0)]).bound
    assert slack([(1.0, 2.0)], wave=True).bound
    assert springing(lambda t_s: 0.0 * t_s, "", 1.0, 0.03).bound
