"""A number of an effect or a law, as a page tells it."""

from __future__ import annotations

from ..diagnose.sizes import Size
from .format import plus_minus
from .html import Html, join, number, symbols, tag, unit


def told_size(one: Size) -> Html:
    """Word, value and standard deviation, unit, on one line.

    Parameters
    ----------
    one : the number
    """
    said = join(
        [symbols(one.word), " ", number(plus_minus(one.value, one.std)), " " if one.unit else "", unit(one.unit)]
    )
    return tag("span", said, class_="whole")


__all__ = ["told_size"]
