"""The grammar of laws: terms as functions of the dimensionless state, read from their text and written again.

v is the drift v/U, r is r L/U, y the place across the tank by its half width, beta the heading, alpha the line's angle, ``turn``
the turning between line and hull by L/U.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from ...record.errors import TowlineError
from ...simulate.model import Array

WIDE = "wide"
"""Name of a bump's width, which has no sign."""
NUMBER = "number"
"""Name of a number of waves."""
POWER = "power"
"""Name of a power that is fitted."""
AT = "at"
"""Name of the one number of what saturates or begins somewhere."""
ROUND = "round"
"""Name of how gently it begins."""
WALL = 0.9
"""Of the way to the wall: what grows towards it grows no more beyond."""


@dataclass(frozen=True)
class State:
    """A tow at one time, dimensionless; arrays that broadcast to one another.

    Attributes
    ----------
    v, r, y, beta, turn : as the module says
    v_late, r_late : v and r behind by a term's lag
    time : share of the run that has gone
    alpha : the line's angle
    arm : the tow point ahead of LCG by the length
    """

    v: Any
    r: Any
    y: Any
    beta: Any
    turn: Any
    v_late: Any
    r_late: Any
    time: Any
    alpha: Any = 0.0
    arm: Any = 0.0


@dataclass(frozen=True)
class Range:
    """What the runs have seen of each variable.

    Attributes
    ----------
    low, high : variable -> smallest and largest value
    usual : variable -> root mean square
    states : all of them; None: not known
    """

    low: dict[str, float]
    high: dict[str, float]
    usual: dict[str, float]
    states: State | None = None

    @property
    def ends(self) -> dict[str, tuple[float, float]]:
        """Variable -> smallest and largest value."""
        return {name: (low, self.high[name]) for name, low in self.low.items()}


ROUNDED = (0.01, 0.5)
"""A threshold that begins less gently is sharp, and one that begins more gently is none."""
DRY = 0.05
"""Of a variable's usual size: dry friction has turned over."""


@dataclass(frozen=True)
class Shape:
    """A number inside a term.

    Attributes
    ----------
    name : of it
    value : where a fit of it begins
    sd : prior standard deviation about that
    unit : SI; empty: a plain number
    of : the variable whose power it is; empty: it is none
    """

    name: str
    value: float
    sd: float
    unit: str = ""
    of: str = ""


@dataclass(frozen=True)
class Term:
    """One term: a sum of basis functions, each with a coefficient, and numbers inside them.

    Attributes
    ----------
    text : as it is written
    variables : it depends on
    parts : how many pieces it is made of: the price of writing it
    basis : (state, *shapes) -> its functions' values
    shapes : numbers inside
    functions : how many
    lag_s : of v_late and r_late
    form : the text with places for the shapes; empty where there are none
    """

    text: str
    variables: tuple[str, ...]
    parts: int
    basis: Callable[..., tuple[Any, ...]]
    shapes: tuple[Shape, ...] = ()
    functions: int = 1
    lag_s: float = 0.0
    form: str = ""


def dimensionless(
    speed_m_s: Any,
    length_m: Any,
    half_width_m: Any,
    v_m_s: Any,
    r_rad_s: Any,
    y_m: Any,
    beta_rad: Any,
    *,
    turn_rad_s: Any,
    time: Any,
    v_late_m_s: Any = None,
    r_late_rad_s: Any = None,
    alpha_rad: Any = 0.0,
    tow_point_m: Any = 0.0,
) -> State:
    """The state of a motion.

    Parameters
    ----------
    speed_m_s, length_m, half_width_m : of the tow, the model and the tank (NaN: not known, y is then by the length)
    v_m_s, r_rad_s, y_m, beta_rad, turn_rad_s, time : of the motion; turn: between line and hull
    v_late_m_s, r_late_rad_s : v and r behind by a lag; None: no lag
    alpha_rad, tow_point_m : the line's angle, and where it holds; 0: what acts ahead is not asked
    """
    by_turn = length_m / speed_m_s
    v, r = v_m_s / speed_m_s, r_rad_s * by_turn
    return State(
        v,
        r,
        y_m / np.where(np.isfinite(half_width_m), half_width_m, length_m),
        beta_rad,
        turn_rad_s * by_turn,
        v if v_late_m_s is None else v_late_m_s / speed_m_s,
        r if r_late_rad_s is None else r_late_rad_s * by_turn,
        time,
        alpha_rad,
        tow_point_m / length_m,
    )


def beyond(x: Any) -> Any:
    """Nothing to +-1, then as x does.

    Parameters
    ----------
    x : by where it begins
    """
    return np.sign(x) * np.maximum(np.abs(x) - 1.0, 0.0)


def begins(x: Any, rounded: Any) -> Any:
    """Nothing to about +-1, then as x does: a threshold that begins gently, sharp where ``rounded`` is 0.

    Parameters
    ----------
    x : by where it begins
    rounded : by that, too; a tenth: over some four tenths about it
    """
    return np.sign(x) * rounded * np.logaddexp(0.0, (np.abs(x) - 1.0) / rounded)


def _walls(y: Any, power: int) -> Any:
    y = np.clip(y, -WALL, WALL)
    return (1 - y) ** -power - (1 + y) ** -power


PLAIN = (
    Term("1", (), 1, lambda s: (1.0 + 0.0 * s.v,)),
    Term("v", ("v",), 1, lambda s: (s.v,)),
    Term("r", ("r",), 1, lambda s: (s.r,)),
    Term("v|v|", ("v",), 2, lambda s: (s.v * np.abs(s.v),)),
    Term("v^3", ("v",), 2, lambda s: (s.v**3,)),
    Term("v^5", ("v",), 3, lambda s: (s.v**5,)),
    Term("|v|", ("v",), 2, lambda s: (np.abs(s.v),)),
    Term("v^2", ("v",), 2, lambda s: (s.v**2,)),
    Term("sign(v) sqrt|v|", ("v",), 3, lambda s: (np.sign(s.v) * np.sqrt(np.abs(s.v)),)),
    Term("r|r|", ("r",), 2, lambda s: (s.r * np.abs(s.r),)),
    Term("r^3", ("r",), 2, lambda s: (s.r**3,)),
    Term("|r|", ("r",), 2, lambda s: (np.abs(s.r),)),
    Term("r^2", ("r",), 2, lambda s: (s.r**2,)),
    Term("v|r|", ("v", "r"), 3, lambda s: (s.v * np.abs(s.r),)),
    Term("|v|r", ("v", "r"), 3, lambda s: (np.abs(s.v) * s.r,)),
    Term("v^2 r", ("v", "r"), 3, lambda s: (s.v**2 * s.r,)),
    Term("v r^2", ("v", "r"), 3, lambda s: (s.v * s.r**2,)),
    Term("v r", ("v", "r"), 2, lambda s: (s.v * s.r,)),
    Term("(v+r/2)|v+r/2|", ("v", "r"), 4, lambda s: ((s.v + s.r / 2) * np.abs(s.v + s.r / 2),)),
    Term("(v-r/2)|v-r/2|", ("v", "r"), 4, lambda s: ((s.v - s.r / 2) * np.abs(s.v - s.r / 2),)),
    Term("y", ("y",), 1, lambda s: (s.y,)),
    Term("y|y|", ("y",), 2, lambda s: (s.y * np.abs(s.y),)),
    Term("y^3", ("y",), 2, lambda s: (s.y**3,)),
    Term("y^2", ("y",), 2, lambda s: (s.y**2,)),
    Term("1/(1-y)-1/(1+y)", ("y",), 4, lambda s: (_walls(s.y, 1),)),
    Term("1/(1-y)^3-1/(1+y)^3", ("y",), 5, lambda s: (_walls(s.y, 3),)),
    Term("v|y|", ("v", "y"), 3, lambda s: (s.v * np.abs(s.y),)),
    Term("v y^2", ("v", "y"), 3, lambda s: (s.v * s.y**2,)),
    Term("r|y|", ("r", "y"), 3, lambda s: (s.r * np.abs(s.y),)),
    Term("r y^2", ("r", "y"), 3, lambda s: (s.r * s.y**2,)),
    Term("beta", ("beta",), 1, lambda s: (s.beta,)),
    Term("beta|beta|", ("beta",), 2, lambda s: (s.beta * np.abs(s.beta),)),
    Term("beta^3", ("beta",), 2, lambda s: (s.beta**3,)),
    Term("beta^2", ("beta",), 2, lambda s: (s.beta**2,)),
    Term("v beta^2", ("v", "beta"), 3, lambda s: (s.v * s.beta**2,)),
    Term("time", ("time",), 1, lambda s: (s.time - 0.5,)),
    Term("v time", ("v", "time"), 2, lambda s: (s.v * (s.time - 0.5),)),
    Term("r time", ("r", "time"), 2, lambda s: (s.r * (s.time - 0.5),)),
    Term("alpha^2", ("alpha",), 2, lambda s: (s.alpha**2,)),
    Term("|alpha|", ("alpha",), 2, lambda s: (np.abs(s.alpha),)),
    Term("v alpha", ("v", "alpha"), 2, lambda s: (s.v * s.alpha,)),
    Term("r alpha", ("r", "alpha"), 2, lambda s: (s.r * s.alpha,)),
)
"""Powers, moduli and products whose numbers are the usual ones of the field (Abkowitz, Norrbin), and two of a wall."""
_LEAST = 1e-6
"""Of a variable whose power is taken: the slope of a power below 1 has no end at 0."""
_POWER = re.compile(r"(sign )?\|(v|r|y|beta|alpha)\|\^([0-9.]+)")
_SCALED = re.compile(r"(tanh|beyond)\((v|r|y|beta|turn|alpha)/([0-9.e-]+)\)")
_ROUNDED = re.compile(r"beyond\((v|r|y|beta|turn|alpha)/([0-9.e-]+), ([0-9.e-]+) round\)")
_WAVE = re.compile(r"wave\(([0-9.]+) (y|beta|time)\)")
_BUMP = re.compile(r"bump\((y|beta|time) at (-?[0-9.e-]+), ([0-9.e-]+) wide\)")
_STATION = re.compile(r"\(v\+(-?[0-9.]+) r\)\|v\+-?[0-9.]+ r\|")
_LATE = re.compile(r"(v|r)\(t-([0-9.]+) s\)")
_ACROSS = re.compile(r"sign \|v\+(-?[0-9.]+) r\|\^([0-9.]+)")
_TIMES = re.compile(r"(v|r) \|(v|r|y)\|\^([0-9.]+)")
_BOTH = re.compile(r"sign \|(v|r)\|\^([0-9.]+) \|(v|r)\|\^([0-9.]+)")


def term(text: str) -> Term:
    """A term by its text.

    ``sign |v|^1.7`` is an odd power, ``|v|^1.7`` an even one; ``tanh(v/0.05)`` saturates, ``beyond(v/0.05)`` begins at 0.05 and
    then grows as v does, ``beyond(v/0.05, 0.1 round)`` gently; ``wave(12 y)`` is a sine and a cosine of 12 y,
    ``bump(y at 0.1, 0.05 wide)`` is at one place; ``(v+0.3 r)|v+0.3 r|`` is the drag of the section at 0.3 L,
    ``sign |v+0.3 r|^1.7`` with another power; ``v |y|^1.5`` and ``sign |v|^1.5 |r|^1.2`` are products (the sign is the first
    one's); ``v(t-2 s)`` is the drift two seconds before, by a first-order lag, less the drift now. The numbers in it are where a
    fit begins.

    Parameters
    ----------
    text : as ``Term.text``

    Raises
    ------
    TowlineError : it is none of the grammar

    Examples
    --------
    >>> term("v|v|").variables, term("tanh(turn/0.01)").variables
    (('v',), ('turn',))
    """
    for plain in PLAIN:
        if plain.text == text:
            return plain
    for pattern, made in (
        (_POWER, _power),
        (_SCALED, _scaled),
        (_ROUNDED, _rounded),
        (_WAVE, _wave),
        (_BUMP, _bump),
        (_STATION, _station),
        (_LATE, _late),
        (_ACROSS, _across),
        (_TIMES, _times),
        (_BOTH, _both),
    ):
        if (found := pattern.fullmatch(text)) and _widths_above_zero(found):
            return made(text, found)
    raise TowlineError(f"{text!r}: no term of the grammar of laws (docs/law.md)")


def _widths_above_zero(found: re.Match[str]) -> bool:
    """Whether scales, widths, powers and lags are above 0; a place or a station may be anywhere."""
    last = found[found.re.groups]
    return found.re is _STATION or found.re is _WAVE or float(last) > 0


def _power(text: str, found: re.Match[str]) -> Term:
    of, odd = attrgetter(found[2]), bool(found[1])

    def basis(s: State, power: Any) -> tuple[Any]:
        x = of(s)
        size = _size(x, power)
        return (np.sign(x) * size if odd else size,)

    form = f"{found[1] or ''}|{found[2]}|^{{:.4g}}"
    return Term(text, (found[2],), 3, basis, (Shape(POWER, float(found[3]), 0.7, of=found[2]),), form=form)


def _scaled(text: str, found: re.Match[str]) -> Term:
    of, scale, saturates = attrgetter(found[2]), float(found[3]), found[1] == "tanh"

    def basis(s: State, at: Any) -> tuple[Any]:
        x = of(s) / np.maximum(at, 0.05 * scale)
        return (np.tanh(x) if saturates else beyond(x),)

    form = f"{found[1]}({found[2]}/{{:.4g}})"
    return Term(text, (found[2],), 3, basis, (Shape(AT, scale, 0.5 * scale),), form=form)


def _rounded(text: str, found: re.Match[str]) -> Term:
    of, scale, soft = attrgetter(found[1]), float(found[2]), float(found[3])

    def basis(s: State, at: Any, rounded: Any) -> tuple[Any]:
        return (begins(of(s) / np.maximum(at, 0.05 * scale), np.clip(np.abs(rounded), *ROUNDED)),)

    shapes = (Shape(AT, scale, 0.5 * scale), Shape(ROUND, soft, 0.7 * soft))
    return Term(text, (found[1],), 4, basis, shapes, form=f"beyond({found[1]}/{{:.4g}}, {{:.4g}} round)")


def _wave(text: str, found: re.Match[str]) -> Term:
    of, number = attrgetter(found[2]), float(found[1])
    return Term(
        text,
        (found[2],),
        4,
        lambda s, k: (np.sin(k * of(s)), np.cos(k * of(s))),
        (Shape(NUMBER, number, 0.25 * number),),
        2,
        form=f"wave({{:.4g}} {found[2]})",
    )


def _bump(text: str, found: re.Match[str]) -> Term:
    of, place, width = attrgetter(found[1]), float(found[2]), float(found[3])

    def basis(s: State, at: Any, wide: Any) -> tuple[Any]:
        return (np.exp(-0.5 * ((of(s) - at) / np.maximum(np.abs(wide), 0.1 * width)) ** 2),)

    shapes = (Shape(AT, place, width), Shape(WIDE, width, 0.5 * width))
    return Term(text, (found[1],), 4, basis, shapes, form=f"bump({found[1]} at {{:.4g}}, {{:.4g}} wide)")


def _station(text: str, found: re.Match[str]) -> Term:
    def basis(s: State, x: Any) -> tuple[Any]:
        across = s.v + x * s.r
        return (across * np.abs(across),)

    form = "(v+{0:.4g} r)|v+{0:.4g} r|"
    return Term(text, ("v", "r"), 4, basis, (Shape("x", float(found[1]), 0.3),), form=form)


def _size(x: Any, power: Any) -> Any:
    return np.maximum(np.abs(x), _LEAST) ** np.clip(power, 0.3, 8.0)


def _across(text: str, found: re.Match[str]) -> Term:
    def basis(s: State, x: Any, power: Any) -> tuple[Any]:
        across = s.v + x * s.r
        return (np.sign(across) * _size(across, power),)

    shapes = (Shape("x", float(found[1]), 0.3), Shape(POWER, float(found[2]), 0.7, of="v"))
    return Term(text, ("v", "r"), 5, basis, shapes, form="sign |v+{:.4g} r|^{:.4g}")


def _times(text: str, found: re.Match[str]) -> Term:
    of, by = attrgetter(found[1]), attrgetter(found[2])
    form = f"{found[1]} |{found[2]}|^{{:.4g}}"
    variables = tuple(dict.fromkeys((found[1], found[2])))
    return Term(
        text,
        variables,
        4,
        lambda s, p: (of(s) * _size(by(s), p),),
        (Shape(POWER, float(found[3]), 0.7, of=found[2]),),
        form=form,
    )


def _both(text: str, found: re.Match[str]) -> Term:
    of, by = attrgetter(found[1]), attrgetter(found[3])

    def basis(s: State, power: Any, other: Any) -> tuple[Any]:
        return (np.sign(of(s)) * _size(of(s), power) * _size(by(s), other),)

    shapes = (Shape(POWER, float(found[2]), 0.7, of=found[1]), Shape("other", float(found[4]), 0.7, of=found[3]))
    form = f"sign |{found[1]}|^{{:.4g}} |{found[3]}|^{{:.4g}}"
    return Term(text, tuple(dict.fromkeys((found[1], found[3]))), 5, basis, shapes, form=form)


def _late(text: str, found: re.Match[str]) -> Term:
    late, now = attrgetter(f"{found[1]}_late"), attrgetter(found[1])
    return Term(text, (found[1],), 3, lambda s: (late(s) - now(s),), lag_s=float(found[2]))


def written(text: str, shapes: Sequence[float] | Array) -> str:
    """The text with the numbers that a fit has found.

    Parameters
    ----------
    text : of the term
    shapes : its numbers, as of ``Term.shapes``

    Examples
    --------
    >>> written("tanh(v/0.05)", [0.0312])
    'tanh(v/0.0312)'
    """
    if not len(shapes):
        return text
    found = term(text)
    told = (abs(x) if shape.name in (WIDE, ROUND) else x for shape, x in zip(found.shapes, shapes, strict=True))
    return found.form.format(*told)


def freed_text(text: str) -> str | None:
    """A term of a fixed power with the power free; None: it has none, or it is free.

    What is linear in a variable is of a power, too. The numbers in the answer are where a fit of it begins.

    Parameters
    ----------
    text : of the term, its numbers written

    Examples
    --------
    >>> freed_text("v|v|"), freed_text("v y^2"), freed_text("(v+0.3 r)|v+0.3 r|"), freed_text("|v|^1.5")
    ('sign |v|^2', 'v |y|^2', 'sign |v+0.3 r|^2', None)
    """
    return next((made(found) for pattern, made in _FREED if (found := pattern.fullmatch(text))), None)


_X, _P = "(v|r|y|beta|alpha)", "([0-9])"
_FREED: tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], str]], ...] = (
    (re.compile(r"(v|r|y|beta)"), lambda m: f"sign |{m[1]}|^1"),
    (re.compile(rf"{_X}\|\1\|"), lambda m: f"sign |{m[1]}|^2"),
    (re.compile(r"sign\((v)\) sqrt\|v\|"), lambda m: f"sign |{m[1]}|^0.5"),
    (re.compile(rf"\|{_X}\|"), lambda m: f"|{m[1]}|^1"),
    (re.compile(rf"{_X}\^{_P}"), lambda m: f"{'sign ' * (int(m[2]) % 2)}|{m[1]}|^{m[2]}"),
    (re.compile(r"(v|r)\|(v|r|y)\|"), lambda m: f"{m[1]} |{m[2]}|^1"),
    (re.compile(r"\|(v)\|(r)"), lambda m: f"{m[2]} |{m[1]}|^1"),
    (re.compile(rf"(v|r) (r|y)\^{_P}"), lambda m: f"{m[1]} |{m[2]}|^{m[3]}"),
    (re.compile(rf"(v)\^{_P} (r)"), lambda m: f"{m[3]} |{m[1]}|^{m[2]}"),
    (re.compile(r"\(v(\+|-)r/2\)\|v[+-]r/2\|"), lambda m: f"sign |v+{'-' * (m[1] == '-')}0.5 r|^2"),
    (re.compile(r"\(v\+(-?[0-9.]+) r\)\|v\+-?[0-9.]+ r\|"), lambda m: f"sign |v+{m[1]} r|^2"),
)
"""Terms of a fixed power -> the same with the power free."""


def family(text: str) -> str:
    """What terms have in common that differ by the numbers inside alone: a fit of one may end at another.

    Parameters
    ----------
    text : of the term

    Examples
    --------
    >>> family("wave(12 y)") == family("wave(20 y)"), family("v^3")
    (True, 'v^3')
    """
    return term(text).form or text


__all__ = [
    "AT", "DRY", "NUMBER", "PLAIN", "POWER", "ROUND", "WIDE", "Range", "Shape", "State", "Term", "begins", "beyond",
    "dimensionless", "family", "freed_text", "term", "written",
]  # fmt: skip
