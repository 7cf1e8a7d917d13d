"""The judge of the laws' benchmark: what was told against the truth, over the truth's own motion.

Nothing here is of the search (``diagnose/law``): the texts of law.json are read anew, and the states are those that reality had.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from towline.blind.signature import block_times
from towline.blind.truth.cases import Case, lane_of, swum
from towline.blind.truth.lanes import Lanes
from towline.blind.truth.laws import TERMS, law_ahead, law_force, law_lean
from towline.blind.truth.motion import B, R, U, V, Y
from towline.blind.truth.now import Now

Array = np.ndarray
G_M_S2 = 9.81
ASIDE, AHEAD = 2, 3
"""Rows of what is told: where a heeling model's marks stand; and a push ahead, which the line answers in the two forces."""
ROLLS = 3
"""Numbers of a roll, behind the others of a heel: period, damping, turning."""
SMALL = 0.03
"""A term, or another function, that changes the force by less than this share of it is no other law."""
VARIABLES = {0: "v", 1: "r", 2: "v r", 3: "v", 4: "v", 5: "y", 6: "beta", 7: "v y", 8: "v r", 9: "r", 10: "y"}
"""Kind of a true term -> what it depends on."""
NAMES = ("v", "r", "y", "beta", "turn", "time", "alpha")


@dataclass(frozen=True)
class Seen:
    """What reality did, dimensionless, at every mean of the runs.

    Attributes
    ----------
    of : variable -> (n,)
    now : the same for the truth's own law
    lanes : of it
    size : (2, n) rho/2 U^2 L^2 and rho/2 U^2 L^3
    sways_m : the marks' place aside for each radian of heel
    pull : (2, n) side force and moment by these, for a push ahead of 1 that a line that keeps its length answers
    """

    of: Mapping[str, Array]
    now: Now
    lanes: Lanes
    size: Array
    sways_m: float
    pull: Array | None = None


def seen_by(case: Case, runs: Sequence[int]) -> Seen:
    """States of a case's tows, from the motion without the camera.

    Parameters
    ----------
    case : as drawn
    runs : which of them
    """
    path, t_s = swum(case), block_times(case)
    parts, lanes = [], []
    for run in runs:
        lane = lane_of(case, run)
        y, b, u, v, r = path.at(t_s, run, (Y, B, U, V, R)).T
        alpha = np.arcsin(np.clip((y + lane["x_t"] * np.sin(b)) / lane["line"], -1, 1))
        parts.append(np.array([y, b, u, v, r, np.gradient(alpha, t_s) + r, t_s / t_s[-1], alpha]))
        lanes += [lane] * len(t_s)
    y, b, u, v, r, turn, time, alpha = np.concatenate(parts, axis=1)
    q, length, zero = Lanes(lanes), case.hull["length_pp"], np.zeros(len(y))
    now = Now(0.0, y, b, v, r, u, zero, turn, np.zeros((4, len(y))), zero)
    of = {
        "v": v / u, "r": r * length / u, "y": y / (q["tank_width"] / 2), "beta": b, "turn": turn * length / u, "time": time,
        "alpha": alpha,
    }  # fmt: skip
    whole = 0.5 * case.hull["density"] * u**2 * length**2
    aside = np.tan(alpha + b)
    push = np.array([aside, aside * q["x_t"] / length])
    return Seen(of, now, q, np.array([whole, whole * length]), sways_m(case), push)


def sways_m(case: Case) -> float:
    """The marks' place aside where LCG is, for a radian of heel: they stand above the roll axis."""
    ahead, above = zip(*sorted((ahead, above) for ahead, _, above in case.marks.values()), strict=True)
    return -float(np.interp(0.0, ahead, above))


def true_force(seen: Seen, numbers: Mapping[str, float] | None = None) -> Array:
    """(3, n) side force and moment of the truth's law over rho/2 U^2 L^2 (L^3), and the marks' place aside by U^2/g.

    Parameters
    ----------
    seen : states
    numbers : changed numbers of the law
    """
    q = copy(seen.lanes)
    q.values = dict(seen.lanes.values) | {name: np.full(q.n, value) for name, value in (numbers or {}).items()}
    found = np.array(law_force(q, seen.now)) / seen.size
    if seen.pull is not None:
        found = found + law_ahead(q, seen.now) / seen.size[0] * seen.pull
    return np.vstack([found, seen.sways_m * G_M_S2 / seen.now.speed**2 * law_lean(q, seen.now)])


def without_linear(force: Array, seen: Seen) -> Array:
    """(3, n) the same without what is linear in v and r of the forces: the derivatives hold that."""
    return np.vstack([_plain_gone(force[:ASIDE], seen), force[ASIDE:]])


def _plain_gone(values: Array, seen: Seen) -> Array:
    plain = np.column_stack([seen.of["v"], seen.of["r"]])
    return values - (plain @ np.linalg.lstsq(plain, values.T, rcond=None)[0]).T


def apart(one: Array, other: Array, seen: Seen) -> float:
    """How far ``one`` is off ``other``, as a share of it."""
    left, whole = (np.linalg.norm(without_linear(f, seen)) for f in (one - other, other))
    return float(left / whole)


def true_terms(case: Case, seen: Seen) -> list[int]:
    """Which terms of the truth's law matter: without one of the others the force is another one."""
    whole = true_force(seen)
    there = [k for k in range(TERMS) if f"law.kind{k}" in case.numbers]
    gone = {k: true_force(seen, {f"law.{s}{k}": 0.0 for s in ("side", "turn", "along", "lean")}) for k in there}
    return [k for k in there if apart(gone[k], whole, seen) >= SMALL]


def true_variables(case: Case, seen: Seen) -> list[str]:
    """What the truth's law depends on."""
    return variables_of(case, seen, true_terms(case, seen))


def variables_of(case: Case, seen: Seen, terms: Sequence[int]) -> list[str]:
    """What some terms of the truth's law depend on."""
    whole, found = true_force(seen), set[str]()
    for k in terms:
        kind = int(case.numbers[f"law.kind{k}"])
        found |= set(VARIABLES[kind].split())
        if kind == 8 and apart(true_force(seen, {f"law.b{k}": 0.0}), whole, seen) < SMALL:
            found -= {"r"}  # a section so near to midship that yaw rate says nothing
    return sorted(found)


# what was told --------------------------------------------------------------------------------------------------------

Basis = Callable[[Mapping[str, Array], Sequence[float]], list[Array]]


def _beyond(x: Array) -> Array:
    return np.sign(x) * np.maximum(np.abs(x) - 1, 0)


def _begins(x: Array, gently: float) -> Array:
    return np.sign(x) * gently * np.logaddexp(0.0, (np.abs(x) - 1) / gently)


def _bump(x: Array, at: float, wide: float) -> Array:
    return np.exp(-0.5 * ((x - at) / max(abs(wide), 1e-9)) ** 2)


_NUMBER, _NAME = r"(-?[0-9.]+(?:e-?[0-9]+)?)", r"(v|r|y|beta|turn|time|alpha)"


def _odd(x: Array, power: float) -> Array:
    return np.sign(x) * np.abs(x) ** power


_INNER: tuple[tuple[str, Callable[..., Basis]], ...] = (
    (rf"sign \|v\+{_NUMBER} r\|\^{_NUMBER}", lambda: lambda s, p: [_odd(s["v"] + p[0] * s["r"], p[1])]),
    (
        rf"sign \|{_NAME}\|\^{_NUMBER} \|{_NAME}\|\^{_NUMBER}",
        lambda x, z: lambda s, p: [_odd(s[x], p[0]) * np.abs(s[z]) ** p[1]],
    ),
    (rf"{_NAME} \|{_NAME}\|\^{_NUMBER}", lambda x, z: lambda s, p: [s[x] * np.abs(s[z]) ** p[0]]),
    (rf"sign \|{_NAME}\|\^{_NUMBER}", lambda x: lambda s, p: [np.sign(s[x]) * np.abs(s[x]) ** p[0]]),
    (rf"\|{_NAME}\|\^{_NUMBER}", lambda x: lambda s, p: [np.abs(s[x]) ** p[0]]),
    (rf"tanh\({_NAME}/{_NUMBER}\)", lambda x: lambda s, p: [np.tanh(s[x] / p[0])]),
    (rf"beyond\({_NAME}/{_NUMBER}\)", lambda x: lambda s, p: [_beyond(s[x] / p[0])]),
    (
        rf"beyond\({_NAME}/{_NUMBER}, {_NUMBER} round\)",
        lambda x: lambda s, p: [_begins(s[x] / p[0], min(max(abs(p[1]), 0.01), 0.5))],
    ),
    (rf"wave\({_NUMBER} {_NAME}\)", lambda x: lambda s, p: [np.sin(p[0] * s[x]), np.cos(p[0] * s[x])]),
    (rf"bump\({_NAME} at {_NUMBER}, {_NUMBER} wide\)", lambda x: lambda s, p: [_bump(s[x], *p)]),
    (
        rf"\(v\+{_NUMBER} r\)\|v\+{_NUMBER} r\|",
        lambda: lambda s, p: [(s["v"] + p[0] * s["r"]) * np.abs(s["v"] + p[0] * s["r"])],
    ),
)
"""Terms with numbers inside: how they are written, and what they are."""


def told_term(text: str) -> tuple[Basis, list[float], set[str]]:
    """A term as it is written: its functions, the numbers inside it, what it depends on.

    Raises
    ------
    ValueError : it cannot be read (a term with memory is none of the state alone)
    """
    for pattern, made in _INNER:
        if found := re.fullmatch(pattern, text):
            names = [part for part in found.groups() if part in NAMES]
            numbers = [float(part) for part in found.groups() if part not in NAMES]
            if not names:
                # of the section's own drift, whose station may be written twice
                return made(), numbers[:1] if "|v+" in text and "sign" not in text else numbers, {"v", "r"}
            return made(*names), numbers, set(names)
    plain = _plain(text)
    return (lambda s, p: [plain(s)]), [], {name for name in NAMES if re.search(rf"(?<![a-z]){name}(?![a-z])", text)}


def _plain(text: str) -> Callable[[Mapping[str, Array]], Array]:
    """Powers, moduli and products: what stands side by side is multiplied."""
    special = {
        "1": lambda s: 1.0 + 0.0 * s["v"],
        "sign(v) sqrt|v|": lambda s: np.sign(s["v"]) * np.sqrt(np.abs(s["v"])),
        "(v+r/2)|v+r/2|": lambda s: (s["v"] + s["r"] / 2) * np.abs(s["v"] + s["r"] / 2),
        "(v-r/2)|v-r/2|": lambda s: (s["v"] - s["r"] / 2) * np.abs(s["v"] - s["r"] / 2),
        "1/(1-y)-1/(1+y)": lambda s: 1 / (1 - s["y"]) - 1 / (1 + s["y"]),
        "1/(1-y)^3-1/(1+y)^3": lambda s: (1 - s["y"]) ** -3.0 - (1 + s["y"]) ** -3.0,
    }
    if text in special:
        return special[text]
    factors = re.findall(rf"\|{_NAME}\||{_NAME}(?:\^{_NUMBER})?", text)
    if re.sub(rf"\|{_NAME}\||{_NAME}(?:\^{_NUMBER})?", "", text).strip():
        raise ValueError(f"{text!r} cannot be read")

    def value(s: Mapping[str, Array]) -> Array:
        found = 1.0 + 0.0 * s["v"]
        for modulus, name, power in factors:
            x = np.abs(s[modulus]) if modulus else s[name] - (0.5 if name == "time" else 0.0)
            found = found * x ** (float(power) if power else 1.0)
        return found

    return value


def _row(seen: Seen, row: int, value: Array) -> Array:
    """(3, n) of a value in one row; what acts ahead is in the first two, by what the line answers."""
    if row == AHEAD and seen.pull is not None:
        return np.vstack([value * seen.pull, 0.0 * value])
    return np.array([value if k == row else 0.0 * value for k in range(3)])


@dataclass(frozen=True)
class Told:
    """A term of an answer.

    Attributes
    ----------
    basis, inside, variables : of ``told_term``
    acts : rows of the force, side force 0 and moment 1, that it is in; ASIDE; AHEAD
    numbers : coefficients by row, then by function
    """

    basis: Basis
    inside: list[float]
    variables: set[str]
    acts: tuple[int, ...]
    numbers: list[float]

    def force(self, seen: Seen) -> Array:
        """(3, n) over rho/2 U^2 L^2 (L^3) and U^2/g."""
        values = self.basis(seen.of, self.inside)
        found = np.zeros((3, len(values[0])))
        for k, row in enumerate(self.acts):
            for j, value in enumerate(values):
                number = self.numbers[k * len(values) + j]
                found += number * _row(seen, row, value)
        return found


def told(terms: Sequence[Mapping]) -> list[Told]:
    """Terms of law.json's first law.

    Parameters
    ----------
    terms : as in law.json

    Raises
    ------
    ValueError : one cannot be read
    """
    found = []
    for one in terms:
        basis, inside, variables = told_term(one["text"])
        values = [number["value"] if isinstance(number, Mapping) else number for number in one["numbers"].values()]
        acts = {"Y": (0,), "N": (1,), "Y and N": (0, 1), "X": (AHEAD,), "K": (ASIDE,)}[one["acts"]]
        if one["acts"] == "K":
            values = values[:-ROLLS]
        count = len(values) - len(inside)
        found.append(Told(basis, values[count:], variables, acts, values[:count]))
    return found


def right_form(terms: Sequence[Told], seen: Seen, target: Array) -> bool:
    """Whether the truth's force is one of what was told, up to SMALL of it: with other numbers, and without needless terms.

    Parameters
    ----------
    terms : of the answer
    seen, target : states and the truth's force there
    """
    whole = np.sum([one.force(seen) for one in terms], axis=0)
    for count in range(1, len(terms) + 1):
        enough = [
            some
            for some in combinations(range(len(terms)), count)
            if nearest([terms[k] for k in some], seen, target) < SMALL
        ]
        if enough:
            # terms beyond those that are enough must be next to nothing
            kept = (np.sum([terms[k].force(seen) for k in some], axis=0) for some in enough)
            return any(apart(part, whole, seen) < SMALL for part in kept)
    return False


def nearest(terms: Sequence[Told], seen: Seen, target: Array) -> float:
    """How near functions of this form come to the truth's force: the least that is left, as a share of it.

    Parameters
    ----------
    terms : of the answer
    seen, target : states and the truth's force there
    """
    wanted = without_linear(target, seen)
    begin = np.array([x for one in terms for x in one.inside])
    cuts = np.cumsum([len(one.inside) for one in terms])[:-1]

    def left(shapes: Array) -> Array:
        rest = wanted.copy()
        parts = np.split(shapes, cuts) if len(shapes) else [[] for _ in terms]
        for row in range(3):
            columns = [
                _row(seen, which, f)[row]
                for one, p in zip(terms, parts, strict=True)
                for which in one.acts
                for f in one.basis(seen.of, p)
            ]
            columns = [f for f in columns if np.any(f)]
            if columns:
                table = (np.array(columns) if row == ASIDE else _plain_gone(np.array(columns), seen)).T
                table = table / np.maximum(np.linalg.norm(table, axis=0), 1e-30)
                rest[row] -= table @ np.linalg.lstsq(table, wanted[row], rcond=1e-10)[0]
        return rest.ravel() / np.linalg.norm(wanted)

    best = float(np.linalg.norm(left(begin)))
    for factor in (1.0, 0.6, 1.6) if len(begin) else ():
        try:
            found = least_squares(left, begin * factor, x_scale=np.maximum(np.abs(begin), 1e-3), max_nfev=200)
        except ValueError:
            continue
        best = min(best, float(np.linalg.norm(found.fun)))
    return best


__all__ = [
    "SMALL", "Seen", "Told", "apart", "nearest", "right_form", "seen_by", "sways_m", "told", "told_term", "true_force",
    "true_terms", "true_variables", "variables_of", "without_linear",
]  # fmt: skip
