"""Units as people write them, "rad/s", "kN m", "1/s2", "m3/h": what they are in SI, and whether two fit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction

Dimension = tuple[Fraction, ...]
_BASES = ("m", "kg", "s", "A", "K", "mol", "cd")
_PREFIXES = {
    "": 1.0,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
    "h": 1e2,
    "d": 1e-1,
    "c": 1e-2,
    "m": 1e-3,
    "u": 1e-6,
    "µ": 1e-6,
    "n": 1e-9,
}
"""SI prefixes."""
_PLAIN: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "-": (1.0, {}),
    "%": (0.01, {}),
    "rad": (1.0, {}),
    "deg": (math.pi / 180, {}),
    "rev": (2 * math.pi, {}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "kn": (1852 / 3600, {"m": 1, "s": -1}),
    "rpm": (2 * math.pi / 60, {"s": -1}),
    "degC": (1.0, {"K": 1}),
}
"""Units that take no prefix. An angle has no dimension; a difference of degrees Celsius is one of kelvins."""
_PREFIXED: dict[str, tuple[float, dict[str, int]]] = {
    "m": (1.0, {"m": 1}),
    "g": (1e-3, {"kg": 1}),
    "s": (1.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "mol": (1.0, {"mol": 1}),
    "cd": (1.0, {"cd": 1}),
    "Hz": (1.0, {"s": -1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "C": (1.0, {"A": 1, "s": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "l": (1e-3, {"m": 3}),
}
"""Units that take them: times SI, and the powers of its base units (SI brochure)."""
_FACTOR = re.compile(r"(?P<name>[A-Za-zµ%]+|1|-)(?:\^?(?P<power>[+-]?\d+(?:\.\d+)?))?$")


@dataclass(frozen=True)
class Unit:
    """A unit.

    Attributes
    ----------
    factor : times this it is in SI
    dimension : powers of m, kg, s, A, K, mol, cd
    """

    factor: float
    dimension: Dimension


def unit_of(text: str) -> Unit:
    """Read a unit.

    Parameters
    ----------
    text : factors with a blank, ``*`` or ``.`` between, what is divided by behind one ``/``; powers as ``s2``, ``s^2`` or ``s-2``;
        empty: none

    Raises
    ------
    ValueError : it is none that is known

    Examples
    --------
    >>> unit_of("deg/s").dimension == unit_of("1/s").dimension, round(unit_of("m3/h").factor * 3600, 9)
    (True, 1.0)
    """
    over, *under = text.strip().split("/")
    if len(under) > 1:
        raise ValueError(f"{text!r} has more than one /; put what is divided by behind one")
    factor, dimension = 1.0, [Fraction(0)] * len(_BASES)
    for side, part in ((1, over), (-1, *under) if under else (-1, "")):
        for word in re.split(r"[\s*.·]+(?!\d)", str(part).strip(" ()")):
            if not word:
                continue
            one, power = _factor(word, text)
            factor *= one.factor ** float(side * power)
            dimension = [d + side * power * own for d, own in zip(dimension, one.dimension, strict=True)]
    return Unit(factor, tuple(dimension))


def conversion(given: str, wanted: str) -> float:
    """What a number in the unit ``given`` is multiplied with to be in the unit ``wanted``.

    Parameters
    ----------
    given, wanted : units, as of ``unit_of``

    Raises
    ------
    ValueError : one is not known, or they are of different kinds

    Examples
    --------
    >>> conversion("mm", "m")
    0.001
    """
    one, other = unit_of(given), unit_of(wanted)
    if one.dimension != other.dimension:
        raise ValueError(f"{given!r} does not fit {wanted!r}")
    return one.factor / other.factor


def _factor(word: str, text: str) -> tuple[Unit, Fraction]:
    match = _FACTOR.match(word)
    if match is not None:
        power = Fraction(match["power"] or "1")
        name = match["name"]
        if name in _PLAIN:
            return _made(*_PLAIN[name]), power
        for cut in (0, 1):
            if name[:cut] in _PREFIXES and name[cut:] in _PREFIXED:
                size, powers = _PREFIXED[name[cut:]]
                return _made(_PREFIXES[name[:cut]] * size, powers), power
    raise ValueError(f"{text!r} is no unit that is known ({word!r} in it)")


def _made(size: float, powers: dict[str, int]) -> Unit:
    return Unit(size, tuple(Fraction(powers.get(base, 0)) for base in _BASES))


__all__ = ["Unit", "conversion", "unit_of"]
