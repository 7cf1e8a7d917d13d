"""Dry friction of a model's equation: Coulomb's, Stribeck's, and bristles that give before they slide (LuGre)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...simulate.model import Array
from ..effects import Parameter
from .model import Missing

STICKS = 0.01
"""Dry friction has turned by this share of the usual speed: no integrator takes a jump."""
STRIBECK = 0.1
"""Speed at which static friction has gone over into sliding, of the usual one."""
GIVES, LEAST_GIVES = 0.05, 0.002
"""How far bristles usually give before they slide, and how far at least, of the way that the usual speed and its rate make
(size^2/rate: of a swing its amplitude). Below the least they are Stribeck's friction, and nothing but steps that are too long."""
GIVE_SD = 3.0
"""Prior standard deviation of the give, of its usual size: effects are mostly smaller than usual, and their priors are narrower by
the same share (``Effect.sizes``), but bristles of a small friction give as far."""
NOTHING = 1e-9
"""Of the usual friction: keeps bristles of no force from 0/0."""
DAMPING = "Add the term to the equation, or find what drags."


def frictions(v: str, usual: float, size: float, rate: float) -> list[Missing]:
    """Coulomb's, Stribeck's and LuGre's friction in one equation.

    Parameters
    ----------
    v : the state, a speed, whose rate it takes from
    usual : size of what is missing, in the unit of the rate
    size, rate : usual sizes of the state and of its rate

    Examples
    --------
    >>> [m.name for m in frictions("v", 0.1, 2.0, 1.0)]
    ['v_dry_friction', 'v_static_friction', 'v_lugre_friction']
    """
    turn, slow = STICKS * size, STRIBECK * size

    def dry(t: Any, x: Any, u: Any, p: Any, f: Array) -> Array:
        return -f * np.tanh(getattr(x, v) / turn)

    def static(t: Any, x: Any, u: Any, p: Any, f: Array, more: Array) -> Array:
        s = getattr(x, v)
        return -(f + more * np.exp(-((s / slow) ** 2))) * np.tanh(s / turn)

    sliding, sticking = (Parameter(name, "", usual, one_sided=True) for name in ("sliding", "sticking"))
    return [
        Missing(
            f"{v}_dry_friction",
            (Parameter("size", "", usual, one_sided=True),),
            "It rubs with a constant force (Coulomb).",
            DAMPING,
            dry,
            equation=v,
            title=f"dry friction in {v}",
            code=f"-size * np.tanh(x.{v} / {turn!r})",
        ),
        Missing(
            f"{v}_static_friction",
            (sliding, sticking),
            "It rubs, and more where it hardly moves (Stribeck).",
            DAMPING,
            static,
            equation=v,
            title=f"friction that is larger at rest in {v}",
            code=f"-(sliding + sticking * np.exp(-(x.{v} / {slow!r}) ** 2)) * np.tanh(x.{v} / {turn!r})",
        ),
        _bristles(v, usual, size, size**2 / rate, sliding, sticking),
    ]


def _bristles(v: str, usual: float, size: float, way: float, sliding: Parameter, sticking: Parameter) -> Missing:
    """LuGre (Canudas de Wit and others, IEEE Trans. Automatic Control 40, 1995, 419); m is the bristles' deflection over the way
    that they give: m' = v/give - |v|/give (sliding + sticking)/g(v) m, and the force is (sliding + sticking)(m + time_s m'), with
    g(v) = sliding + sticking exp(-(v/slow)^2). sigma_0 is (sliding + sticking)/give, sigma_1 is sigma_0 time_s, sigma_2 the model's
    own linear damping.
    """
    slow, least, nothing = STRIBECK * size, LEAST_GIVES * way, NOTHING * usual

    def memory(
        t: Any, x: Any, u: Any, p: Any, f: Array, more: Array, give: Array, time_s: Array
    ) -> tuple[Array, Array]:
        s = getattr(x, v)
        drive = s / (give**2 + least**2) ** 0.5
        return drive, np.abs(drive) * (f + more + nothing) / (f + more * np.exp(-((s / slow) ** 2)) + nothing)

    def changes(
        t: Any, x: Any, u: Any, p: Any, m: Array, rate: Array, f: Array, more: Array, give: Array, time_s: Array
    ) -> Array:
        return -(f + more) * (m + time_s * rate)

    gives = f"(give**2 + {least!r} ** 2) ** 0.5"
    return Missing(
        f"{v}_lugre_friction",
        (
            sliding,
            sticking,
            # begun where it usually is: nearer to nothing a fit would stay there
            Parameter("give", "", GIVE_SD * GIVES * way, GIVES * way),
            Parameter("time_s", "s", GIVES * way / size, one_sided=True),
        ),
        "It rubs, more where it hardly moves, and gives like a spring before it slides (LuGre).",
        DAMPING,
        changes,
        equation=v,
        title=f"friction that gives before it slides in {v}",
        code="-(sliding + sticking) * (m + time_s * rate)",
        memory=memory,
        memory_code=f"(x.{v} / {gives}, np.abs(x.{v}) / {gives} * (sliding + sticking + {nothing!r}) "
        f"/ (sliding + sticking * np.exp(-(x.{v} / {slow!r}) ** 2) + {nothing!r}))",
    )


__all__ = ["frictions"]
