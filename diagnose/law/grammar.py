"""Which terms are searched: powers, products, saturation, thresholds, waves, places and lags, each from several starts.

The numbers inside a term are fitted in full for the best; where a fit begins decides where it ends, and each comes from several.
"""

from __future__ import annotations

from .functions import DRY, PLAIN, Range, Term, term

ODD, EVEN = (0.5, 1.5, 2.5, 4.0), (1.5, 3.0)
"""Powers that stand beside the usual ones."""
SATURATES, BEGINS = (DRY, 0.15, 0.5, 1.5), (0.7, 1.3, 2.0)
"""At which share of a variable's usual size."""
GENTLY = 0.15
"""A threshold begins so gently at first, by where it begins: a fit finds how gently."""
WAVES = (3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0)
"""Waves across half a tank, rad; a fit finds the number between them."""
HEADINGS = (6.0, 9.0, 13.0, 19.0, 28.0)
"""Waves in a radian of heading, rad."""
PLACES, WIDE = (-1.2, -0.5, 0.0, 0.5, 1.2), (0.3, 0.7)
"""Where a bump may be, in usual sizes of its variable, and how wide."""
ELSEWHERE = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0)
"""Where a term may saturate or begin, in usual sizes of its variable: looked at anew along a fitted law's own path."""
FURTHER = (4.0, 5.0)
"""... and there, where the runs have been further."""
ALL_ODD, ALL_EVEN = (0.5, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0)
"""Powers of drift or yaw rate that are looked at along a law's own path."""
STATIONS = (-0.4, -0.2, 0.2, 0.4)
"""Sections by whose own drift a force may go, in lengths ahead of midship."""
LAGS_S = (0.5, 1.5, 4.0)
"""Choices, a factor of three apart."""
SQUARES = ("v^2", "r^2", "beta^2", "y^2", "alpha^2", "|v|", "|r|", "|alpha|", "v r", "v alpha", "r alpha", "time")
"""What a resistance may go with beside powers and places: port and starboard alike, but for a time."""
PRODUCTS = [f"sign |{a}|^{p} |{b}|^{q}" for a, b in (("v", "r"), ("r", "v")) for p, q in ((1, 2), (2, 1), (2, 2))]
"""Of powers of drift and yaw rate, with the sign of the first."""
HEELS = (
    "v", "r", "v|v|", "v^3", "|v|", "v^2", "r|r|", "r^3", "|r|", "r^2", "v|r|", "|v|r", "v^2 r", "v r^2", "v r",
    "(v+r/2)|v+r/2|", "(v-r/2)|v-r/2|",
)  # fmt: skip
"""What a model may heel with, beside powers, saturation, thresholds and sections. Where it is moves its marks, too, but so does a
lens: no place is among them."""


def grammar(seen: Range, width: bool) -> list[Term]:
    """The terms that are searched.

    Parameters
    ----------
    seen : of the runs
    width : whether the tank's width is known
    """
    # what is linear in v and r is in the derivatives
    texts = [t.text for t in PLAIN if (width or "1/(1" not in t.text) and "alpha" not in t.text and t.text not in "vr"]
    texts += _drifting(seen)
    texts += [f"tanh(turn/{share * seen.usual['turn']:.2g})" for share in SATURATES[:2]]
    texts += [
        f"{one} |{other}|^{p}" for one, other in (("v", "y"), ("r", "y"), ("v", "r"), ("r", "v")) for p in (1.5, 3)
    ]
    texts += PRODUCTS
    texts += [*waves_and_bumps(seen, "y"), *waves_and_bumps(seen, "beta")]
    texts += [f"{x}(t-{lag:g} s)" for x in ("v", "r") for lag in LAGS_S]
    return [term(text) for text in dict.fromkeys(texts)]


def waves_and_bumps(seen: Range, x: str) -> list[str]:
    """Waves and bumps over the place or the heading.

    Parameters
    ----------
    seen : of the runs
    x : "y" or "beta"
    """
    usual = seen.usual[x]
    waves = [f"wave({k:g} {x})" for k in (WAVES if x == "y" else HEADINGS)]
    return waves + [f"bump({x} at {place * usual:.3g}, {wide * usual:.3g} wide)" for place in PLACES for wide in WIDE]


def forms_alone(seen: Range, x: str) -> list[str]:
    """Everything that goes with drift or yaw rate alone, at many places and with many powers.

    Parameters
    ----------
    seen : of the runs
    x : "v" or "r"
    """
    furthest = max(abs(seen.low[x]), abs(seen.high[x]))
    places = [share * seen.usual[x] for share in (*ELSEWHERE, *FURTHER) if share * seen.usual[x] < furthest]
    texts = [f"sign |{x}|^{power:g}" for power in ALL_ODD] + [f"|{x}|^{power:g}" for power in ALL_EVEN]
    return texts + [f"tanh({x}/{place:.3g})" for place in places] + [beginning(x, place) for place in places]


def beginning(x: str, at: float) -> str:
    """A threshold where nothing is said of how gently it begins.

    Parameters
    ----------
    x : a variable
    at : where it begins
    """
    return f"beyond({x}/{at:.3g}, {GENTLY} round)"


def _drifting(seen: Range) -> list[str]:
    """Powers, saturation and thresholds of drift and yaw rate, and of the drift of sections."""
    texts: list[str] = []
    for x in ("v", "r"):
        usual = seen.usual[x]
        texts += [f"sign |{x}|^{power}" for power in ODD] + [f"|{x}|^{power}" for power in EVEN]
        texts += [f"tanh({x}/{share * usual:.2g})" for share in SATURATES]
        texts += [beginning(x, share * usual) for share in BEGINS]
    for x in STATIONS:
        texts += [f"(v+{x} r)|v+{x} r|", f"sign |v+{x} r|^1.5", f"sign |v+{x} r|^3"]
    return texts


def heels(seen: Range) -> list[Term]:
    """The terms that are searched for what heels the model.

    Parameters
    ----------
    seen : of the runs
    """
    return [term(text) for text in (*HEELS, *PRODUCTS, *_drifting(seen))]


def resistances(seen: Range) -> list[Term]:
    """The terms that are searched for what acts ahead.

    Parameters
    ----------
    seen : of the runs
    """
    texts = [*SQUARES]
    texts += [f"|{x}|^{power}" for x in ("v", "r", "beta", "alpha") for power in EVEN]
    texts += waves_and_bumps(seen, "y")
    return [term(text) for text in texts]


__all__ = ["ELSEWHERE", "beginning", "forms_alone", "grammar", "heels", "resistances", "waves_and_bumps"]
