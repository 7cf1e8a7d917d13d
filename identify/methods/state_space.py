"""State-space models A (8.25), B (8.26) and the open loop (8.27), made from the one linear form, and the change between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array, Hull, Tow, linear_system, sway_yaw_acceleration
from .common import constant_tension

ORDER_B = [2, 0, 3, 1]
"""(v, y, beta', beta) of (8.26) out of (y, beta, v, r) of ``linear_system``."""


@dataclass(frozen=True)
class StateSpace:
    """x' = a x + b u, output (y, beta) = c x.

    Attributes
    ----------
    states : names of x
    inputs : names of u
    a, b, c : (4, 4), (4, len(inputs)), (2, 4)
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    a: Array
    b: Array
    c: Array

    @property
    def poles(self) -> Array:
        """Eigenvalues of a, by falling real part."""
        roots = np.linalg.eigvals(self.a)
        return roots[np.argsort(-roots.real)]

    def transfer(self, s: complex) -> Array:
        """C (s I - A)^-1 B (8.28), (2, inputs)."""
        return self.c @ np.linalg.solve(s * np.eye(4) - self.a, self.b)


def model_b(hull: Hull, tow: Tow) -> StateSpace:
    """(8.26): state (v, y, beta', beta); input: the lateral force at the tow point beside the line, N.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    """
    here = hull.at_speed(tow.speed_m_s)
    matrix, _ = linear_system(here, tow)
    a = matrix[np.ix_(ORDER_B, ORDER_B)]
    c = np.array([[0.0, 1, 0, 0], [0, 0, 0, 1]])
    return StateSpace(("v", "y", "beta_rate", "beta"), ("force_n",), a, _force_column(here, tow), c)


def model_a(hull: Hull, tow: Tow) -> StateSpace:
    """(8.25): state (y', y, beta', beta); the same motion as model B in other coordinates.

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    """
    return transformed(model_b(hull, tow), b_to_a(tow), ("y_rate", "y", "beta_rate", "beta"))


def b_to_a(tow: Tow) -> Array:
    """S of x_A = S x_B: y' = v + U beta, the rest alike (2.12).

    Parameters
    ----------
    tow : T, X_T, L, U of the tow

    Returns
    -------
    (4, 4)
    """
    change = np.eye(4)
    change[0, 3] = linear_system(_PLAIN, tow)[0][0, 1]
    return change


def transformed(model: StateSpace, change: Array, states: tuple[str, ...]) -> StateSpace:
    """The model in the state S x: S A S^-1, S B, C S^-1.

    Parameters
    ----------
    model : in the state x
    change : (4, 4), S
    states : names of the new state
    """
    back = np.linalg.inv(change)
    return StateSpace(states, model.inputs, change @ model.a @ back, change @ model.b, model.c @ back)


def open_loop(hull: Hull, tow: Tow, form: str = "b") -> StateSpace:
    """(8.27): the model without its line, the line's lateral force T sin(alpha+beta) as input (positive = as the line pulls back).

    Parameters
    ----------
    hull : the six derivatives and the speed at which they are quoted
    tow : T, X_T, L, U of the tow
    form : "a" or "b", whose state it takes
    """
    free = replace(tow, tension_n=0.0)
    model = model_b(hull, free)
    model = replace(model, inputs=("line_force_n",), b=-model.b)
    return model if form == "b" else transformed(model, b_to_a(tow), ("y_rate", "y", "beta_rate", "beta"))


def feedback(tow: Tow) -> Array:
    """(1, 2): the line force T sin(alpha+beta) ~ T [y/L + (1 + X_T/L) beta] on (y, beta); closes (8.27) to (8.25) or (8.26).

    Parameters
    ----------
    tow : T, X_T, L, U of the tow
    """
    length = tow.line_length_m
    return constant_tension(tow) * np.array([[1 / length, 1 + tow.tow_point_m / length]])


def closed(model: StateSpace, tow: Tow) -> Array:
    """State matrix of an open loop with its line attached: A + B K C.

    Parameters
    ----------
    model : an open loop
    tow : T, X_T, L, U of the tow

    Returns
    -------
    (4, 4)
    """
    return model.a + model.b @ feedback(tow) @ model.c


def _force_column(hull: Hull, tow: Tow) -> Array:
    v_rate, r_rate = sway_yaw_acceleration(hull, 0.0, 0.0, 1.0, tow.tow_point_m)
    return np.array([[v_rate], [0.0], [r_rate], [0.0]])


_PLAIN = Hull(1.0, 1.0, -1.0, 0.0, 0.0, -1.0, speed_m_s=1.0)
"""Any hull will do: the first row of the linear form is kinematics."""
