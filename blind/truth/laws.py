"""Forces that nobody has a name for: laws drawn from a grammar of their own, of one or two terms.

Each number of a term stands for itself in a lane (``law.kind0`` its kind, ``law.side0``, ``law.turn0``, ``law.along0`` and
``law.lean0`` its sizes aside, in turning, ahead and as the angle of heel that it would have in time ...). Kinds:
0 a power of the drift, 1 of the yaw rate, 2 a product of powers of both, 3 a drift that saturates, 4 a drift that works from a
threshold on, 5 waves across the tank, 6 waves in heading, 7 a drift force that changes with the place, 8 the hull's section at a
station, by the power of its own drift, 9 a moment of constant size against the turning, 10 a bump at a place.
"""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes
from .now import Now

TERMS, KINDS = 2, 11
"""Terms that a law may have, and kinds of them."""


def _power(x: Array, p: Array, even: Array) -> Array:
    size = np.maximum(np.abs(x), 1e-12) ** p
    return np.where(even > 0.5, size, np.sign(x) * size)


def law_force(q: Lanes, now: Now) -> tuple[Array, Array]:
    """Side force and moment of all terms."""
    side, moment = np.zeros(q.n), np.zeros(q.n)
    for k, value in enumerate(_values(q, now)):
        side = side + q[f"law.side{k}"] * value
        moment = moment + q[f"law.turn{k}"] * value
    return side, moment


def law_ahead(q: Lanes, now: Now) -> Array:
    """What pushes ahead, of all terms: below 0 it is a resistance beyond the straight tow's."""
    return _summed(q, now, "along")


def law_lean(q: Lanes, now: Now) -> Array:
    """Angle at which the model would lie over if it had time to, of all terms, rad; ``marker_roll`` has its period and damping."""
    return _summed(q, now, "lean")


def _summed(q: Lanes, now: Now, size: str) -> Array:
    return sum((q[f"law.{size}{k}"] * value for k, value in enumerate(_values(q, now))), np.zeros(q.n))


def _values(q: Lanes, now: Now) -> list[Array]:
    """Of all terms, by the square of the speed through the water."""
    length = q["length_pp"]
    v, r = now.v / now.speed, now.r * length / now.speed
    values = []
    for k in range(TERMS):
        a, p, even = (q[f"law.{name}{k}"] for name in ("a", "p", "even"))
        b, phase = q[f"law.b{k}"], q[f"law.phase{k}"]
        scale = np.maximum(a, 1e-6)
        across = now.y_m / (q["tank_width"] / 2)
        station = v + b * r
        shapes = (
            _power(v / 0.05, p, even),
            _power(r / 0.2, p, even),
            _power(v / 0.05, p, even) * _power(r / 0.2, b, 1.0 - even),
            v / scale / np.sqrt(1.0 + (v / scale) ** 2),
            np.sign(v) * 0.5 * (np.abs(v) / scale - 1.0 + np.sqrt((np.abs(v) / scale - 1.0) ** 2 + 0.01)),
            np.sin(across * b + phase),
            np.sin(now.beta * b + phase),
            v / 0.05 * np.abs(across / 0.1) ** p,
            _power(station / 0.05, p, np.zeros(q.n)),
            r / np.sqrt(r**2 + 0.005**2),
            np.exp(-0.5 * ((across - phase) / scale) ** 2),
        )
        value = np.choose(q[f"law.kind{k}"].astype(int).clip(0, KINDS - 1), shapes)
        values.append((now.speed / q["speed_ref"]) ** 2 * value)
    return values


__all__ = ["KINDS", "TERMS", "law_ahead", "law_force", "law_lean"]
