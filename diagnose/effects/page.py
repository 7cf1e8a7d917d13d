"""The page of the library (docs/effects.md), from the effects themselves: ``python -m towline.diagnose.effects.page``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from . import LAWS, LIBRARY, PULLEYS, slack
from .base import Effect, Parameter
from .line_laws import PULLEYS_M, SURGING
from .slack_line import springing

HEAD = """\
# The library of effects

What `towline diagnose` tries beside the simulator as it is, and how large it takes each to be before it has seen the runs. A
number's size is the standard deviation of its prior where the effect exists at its usual size; 0.3, 0.1 and 0.03 of it are as
likely (a slack line and a bounce, found in the residual, come in one size). "Above 0": physics lets it have one sign only.
"Measured to": how well a rule or a clock tells it without a tow (`[[measured]]`,
[diagnose.md](diagnose.md#measured-without-a-tow)). "Form": the share of what it explains that its own form may leave over before
something more is said to be missing. An effect far outside these sizes is still found, at the price that it was not expected;
give it as an effect of your own ([diagnose.md](diagnose.md#an-effect-of-ones-own)) where you know better. An effect has several
forms where physics allows several (in brackets): they share its name and its prior. Which form fits best is told, and which are
excluded.

| effect | acts in | numbers | form | what happens | what to do |
|---|---|---|---|---|---|
"""
OUT_OF_ROUND = (
    f"a pulley out of round: {len(PULLEYS_M)} forms, a turn about {1e3 * PULLEYS_M[0]:.0f} to {1e3 * PULLEYS_M[-1]:.0f} mm, "
    f"{SURGING}"
)
"""The page's one row of them all."""


def effects_page(effects: Sequence[Effect]) -> str:
    """The page, Markdown; effects of one name and numbers (variants) together in a row."""
    groups: dict[tuple[str, ...], list[Effect]] = {}
    for effect in effects:
        groups.setdefault((effect.name, *(f"{p.name} {p.unit}" for p in effect.parameters)), []).append(effect)
    return HEAD + "".join(f"{_row(alike)}\n" for alike in groups.values())


def whole_library() -> list[Effect]:
    """Of the library, lines with a law of their own, and what is found in a residual."""
    return [
        *LIBRARY,
        *LAWS,
        replace(PULLEYS[0], variant=OUT_OF_ROUND),
        slack([(1.0, 2.0)]),
        springing(lambda t_s: 0.0 * t_s, "springs, as the residual shows", 1.0, 0.03),
    ]


def _row(alike: Sequence[Effect]) -> str:
    first = alike[0]
    numbers = "; ".join(_number(p, len(alike)) for p in first.parameters)
    forms = [e.variant for e in alike if e.variant and not e.bound]
    if forms:
        numbers += f" ({'; '.join(forms)})"
    cells = f"`{first.name}`", first.stage, numbers, f"{100 * first.form:g} %", first.physics, first.cure
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _number(parameter: Parameter, variants: int) -> str:
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


if __name__ == "__main__":
    print(effects_page(whole_library()), end="")


__all__ = ["effects_page", "whole_library"]
