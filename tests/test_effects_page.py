"""docs/effects.md says of every effect what the library has: its numbers, how large they are taken to be, its words."""

from __future__ import annotations

from pathlib import Path

from towline.diagnose.effects import LIBRARY, Effect, Parameter
from towline.diagnose.effects.line import slack, springing


def number(parameter: Parameter, variants: int) -> str:
    """As the page says it."""
    about = " about the variant's" if variants > 1 and parameter.name == "period_s" else f" about {parameter.none:g}"
    return "".join(
        (
            f"`{parameter.name}` {parameter.sd:g}",
            f" {parameter.unit}" if parameter.unit else "",
            about if parameter.none else "",
            ", above 0" if parameter.one_sided else "",
            f", measured to {parameter.apart:g}" if parameter.apart else "",
        )
    )


def rows() -> list[str]:
    """Of the library's effects, those of one name and numbers together, and of what a residual suggests."""
    effects: list[Effect] = [
        *LIBRARY,
        slack([(1.0, 2.0)]),
        springing(lambda t_s: 0.0 * t_s, "springs, as the residual shows", 1.0, 0.03),
    ]
    groups: dict[tuple[str, ...], list[Effect]] = {}
    for effect in effects:
        groups.setdefault((effect.name, *(p.name for p in effect.parameters)), []).append(effect)
    found = []
    for alike in groups.values():
        first = alike[0]
        numbers = "; ".join(number(p, len(alike)) for p in first.parameters)
        if len(alike) > 1:
            numbers += f" ({', '.join(e.variant for e in alike)})"
        cells = f"`{first.name}`", first.stage, numbers, f"{100 * first.form:g} %", first.physics, first.cure
        found.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return found


def test_the_page_lists_the_library_as_it_is(root: Path) -> None:
    page = (root / "docs" / "effects.md").read_text(encoding="utf-8").splitlines()
    assert [line for line in page if line.startswith("| `")] == rows()


def test_what_belongs_to_the_runs_made_says_so() -> None:
    """A window or a bounce found in a residual foretells nothing of another run."""
    assert not any(e.bound for e in LIBRARY)
    assert slack([(1.0, 2.0)]).bound
    assert slack([(1.0, 2.0)], wave=True).bound
    assert springing(lambda t_s: 0.0 * t_s, "", 1.0, 0.03).bound
