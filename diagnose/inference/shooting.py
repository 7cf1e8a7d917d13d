"""Motion and its sensitivities for all times at once: multiple shooting, condensed.

A path holds the state at every node. One Runge-Kutta step from every node, all together, says by how much the path misses itself
(the defects) and how a change is carried on; a short recursion along the nodes then closes the path (Newton) and gives the
sensitivities. Beside integrating step by step this takes a tenth of the calls, and a path that begins at the measured motion cannot
run away while the numbers are still far off (Bock 1981; lifted Newton: Albersmeyer and Diehl 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...simulate.model import Array

BLOW_UP = 1e3
"""States are held within this (m, rad, m/s, rad/s), so that a motion that grows stays a number."""
CLOSE = 1e-4
"""A path whose Newton step is smaller than this (m, rad, m/s, rad/s) is closed by one step more to its square."""
HOPELESS = 3.0
"""A path that Newton moves by more is integrated step by step instead."""
MOST_CLOSINGS = 8
"""Newton steps of the paths, at most."""
STATE_STEP = 1e-6
"""Of the one-sided differences by the state, m, rad, m/s, rad/s: a choice between rounding and curvature."""
STEPS_BETWEEN = 2
"""Nodes stand 0.17 s apart: one step there errs by up to a tenth of a mean's noise, and as one in all runs."""
Rates = Callable[[Any, Array], Array]


def stepped(rates: Rates, t_s: Any, state: Array, step_s: float) -> Array:
    """From ``state`` at ``t_s`` to the next node by STEPS_BETWEEN classical Runge-Kutta steps.

    Parameters
    ----------
    rates : rates of the states
    t_s : time of the node, s
    state : at that time
    step_s : from node to node, s
    """
    step = step_s / STEPS_BETWEEN
    half = step / 2
    for k in range(STEPS_BETWEEN):
        now = t_s + k * step
        k1 = rates(now, state)
        k2 = rates(now + half, state + half * k1)
        k3 = rates(now + half, state + half * k2)
        k4 = rates(now + step, state + step * k3)
        state = np.clip(state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), -BLOW_UP, BLOW_UP)
    return state


def integrated(rates: Rates, start: Array, nodes: int, step_s: float) -> Array:
    """Step by step from ``start`` (states, runs, columns): (states, nodes, runs, columns).

    Parameters
    ----------
    rates : rates of the states
    start : states at the first node
    nodes : how many
    step_s : from node to node, s
    """
    path = np.empty((start.shape[0], nodes, *start.shape[1:]))
    path[:, 0] = start
    with np.errstate(all="ignore"):
        for k in range(nodes - 1):
            path[:, k + 1] = stepped(rates, k * step_s, path[:, k], step_s)
    return path


def between(slope: Array, step_s: float) -> tuple[Array, Array, Array]:
    """Of x' = A x + f with A and f straight between nodes: how x, and f at either node, come out at the next node.

    Parameters
    ----------
    slope : A at every node, (nodes, ..., s, s)
    step_s : from node to node, s

    Returns
    -------
    of x, of the earlier f, of the later f : (nodes - 1, ..., s, s) each
    """
    size = slope.shape[-1]
    early, late = slope[:-1], slope[1:]
    middle, half = (early + late) / 2, step_s / 2
    one = np.eye(size)
    nothing = np.zeros_like(one)
    x = np.broadcast_to(np.concatenate([one, nothing, nothing], axis=1), (*early.shape[:-1], 3 * size))
    f0, f1 = (np.concatenate(parts, axis=1) for parts in ((nothing, one, nothing), (nothing, nothing, one)))
    with np.errstate(all="ignore"):
        k1 = early @ x + f0
        k2 = middle @ (x + half * k1) + (f0 + f1) / 2
        k3 = middle @ (x + half * k2) + (f0 + f1) / 2
        k4 = late @ (x + step_s * k3) + f1
        end = x + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return end[..., :size], end[..., size : 2 * size], end[..., 2 * size :]


def carried(transition: Array, push: Array, start: Array) -> Array:
    """x[k+1] = transition[k] x[k] + push[k] along the nodes.

    Parameters
    ----------
    transition : (nodes - 1, ..., s, s)
    push : (nodes - 1, ..., s, k)
    start : (..., s, k), at the first node

    Returns
    -------
    (nodes, ..., s, k)
    """
    answer = np.empty((len(transition) + 1, *start.shape))
    answer[0] = start
    with np.errstate(all="ignore"):
        for k in range(len(transition)):
            np.matmul(transition[k], answer[k], out=answer[k + 1])
            answer[k + 1] += push[k]
    return answer


__all__ = ["CLOSE", "HOPELESS", "MOST_CLOSINGS", "STATE_STEP", "between", "carried", "integrated", "stepped"]
