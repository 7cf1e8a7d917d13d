"""Sizes of effects as people read them: a word or a symbol, millimetres and degrees, instead of ``compliance_m_n 0.00242``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from ..identify.limits.words import SYMBOLS
from ..record.results import Measured

_DERIVATIVE = re.compile(r"([yxnk])_([vru]+(?:dot)?|[vr]_[vr]|star|delta)")
_SCALES = {"m": ("mm", 1e3), "rad": ("deg", 57.29577951308232)}
"""First word of a unit -> what it is shown in, and how many of these are one of it (1000; 180/pi)."""


@dataclass(frozen=True)
class Size:
    """A number with its word.

    Attributes
    ----------
    word : "compliance", "Y_vvv"
    value, std : in ``unit``
    unit : "mm/N"; empty: a plain number
    """

    word: str
    value: float
    std: float
    unit: str

    @property
    def text(self) -> str:
        """All of it in one: ``compliance 2.42 +- 0.15 mm/N``."""
        return f"{self.word} {self.value:.3g} +- {self.std:.2g} {self.unit}".rstrip()


def size_of(name: str, unit: str, measured: Measured) -> Size:
    """A number of an effect.

    Parameters
    ----------
    name : its own, which may end in its unit: ``compliance_m_n``
    unit : SI, as ``Parameter.unit`` has it
    measured : value and standard deviation in that unit

    >>> size_of("compliance_m_n", "m/N", Measured(value=0.00242, std=0.00015)).text
    'compliance 2.42 +- 0.15 mm/N'
    >>> size_of("n_vvr", "N s2/m", Measured(value=51.0, std=4.0)).text
    'N_vvr 51 +- 4 N s2/m'
    """
    ending = "_" + "_".join(unit.lower().replace("/", " ").split())
    bare = name.removesuffix(ending) if unit else name
    first, rest = re.fullmatch(r"(\w*)(.*)", unit, re.DOTALL).groups()  # pyright: ignore[reportOptionalMemberAccess]
    shown, times = _SCALES.get(first, (first, 1.0))
    return Size(symbol(bare), times * measured.value, times * measured.std, shown + rest)


def symbol(name: str) -> str:
    """The field's symbol of a derivative (``y_vvr`` -> Y_vvr, ``y_v_r`` -> Y_v|r|, ``y_star`` -> Y*), else the name as words.

    Parameters
    ----------
    name : as in gap.json, without its unit
    """
    found = _DERIVATIVE.fullmatch(name)
    if name in SYMBOLS:
        return SYMBOLS[name]
    if found is None:
        return name.replace("_", " ")
    if found[2] == "star":
        return f"{found[1].upper()}*"
    first, _, modulus = found[2].partition("_")
    return f"{found[1].upper()}_{first}|{modulus}|" if modulus else f"{found[1].upper()}_{first}"


def sizes_of(parameters: Mapping[str, Measured], units: Mapping[str, str]) -> list[Size]:
    """The numbers of a row of gap.json.

    Parameters
    ----------
    parameters : effect.number -> value and standard deviation, SI
    units : effect.number -> unit
    """
    return [size_of(key.split(".", 1)[1], units.get(key, ""), measured) for key, measured in parameters.items()]
