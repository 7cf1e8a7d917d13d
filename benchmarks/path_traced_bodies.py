"""Bodies of the path-traced tank as meshes: bars, boxes, discs, the hull with its bar and line; in the tank or on the hull."""

from __future__ import annotations

from typing import Any

import numpy as np
from path_traced_cases import HULL_LENGTH_M, Array

LINE_RADIUS_M, BAR_RADIUS_M, BAR_TO_M = 0.0012, 0.008, 1.85
"""Of the tow line and the bar that it is tied to; the bar's end, ahead of LCG."""


def aligned(values: Array) -> Array:
    """Single precision, beginning where vector loads like it: kernels are compiled anew for memory that does not."""
    values = np.asarray(values).ravel()
    room = np.empty(values.size + 32, dtype=np.float32)
    first = (-room.ctypes.data // 4) % 32
    room[first : first + values.size] = values
    return room[first : first + values.size]


def rod(from_m: Array, to_m: Array, radius_m: float, sides: int = 12) -> tuple[Array, Array]:
    """A round bar with its ends: (n, 3), (m, 3)."""
    along = (to_m - from_m) / np.linalg.norm(to_m - from_m)
    a = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    a /= np.linalg.norm(a)
    b = np.cross(along, a)
    turn = np.arange(sides) * 2 * np.pi / sides
    ring = radius_m * (np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * b)
    points = np.concatenate([from_m + ring, to_m + ring, [from_m], [to_m]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    first, last = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [(i, i + sides, j), (j, i + sides, j + sides), (first, i, j), (last, j + sides, i + sides)]
    return outward((points, np.concatenate([np.stack(f, axis=-1) for f in faces])), (from_m + to_m) / 2)


def box(low: list[float], high: list[float]) -> tuple[Array, Array]:
    """A box between two corners: (8, 3), (12, 3)."""
    points = np.array(
        [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    around = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return outward(
        (points, np.array([t for a, b, c, d in around for t in ((a, b, c), (a, c, d))])), points.mean(axis=0)
    )


def plate(x0: float, x1: float, y0: float, y1: float, z: float) -> tuple[Array, Array]:
    """A level rectangle whose front looks down."""
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]), np.array([[0, 1, 2], [0, 2, 3]])


def disc(middle: Array, radius_m: float, sides: int = 32) -> tuple[Array, Array]:
    """A flat disc that lies level."""
    turn = np.arange(sides) * 2 * np.pi / sides
    ring = middle + radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    i = np.arange(sides)
    faces = np.stack([i, (i + 1) % sides, np.full(sides, sides)], -1)
    return outward((np.concatenate([ring, [middle]]), faces), middle + np.array([0.0, 0.0, 1.0]))


def joined(bodies: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(points) for points, _ in bodies)])
    return np.concatenate([p for p, _ in bodies]), np.concatenate(
        [f + n for (_, f), n in zip(bodies, first, strict=False)]
    )


def outward(body: tuple[Array, Array], inside_m: Array) -> tuple[Array, Array]:
    """The same mesh with every face's front away from a point."""
    points, faces = body
    a, b, c = (points[faces[:, i]] for i in range(3))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - inside_m) < 0
    return points, np.where(turned[:, None], faces[:, ::-1], faces)


def hull_body(case: dict[str, Any]) -> dict[str, tuple[Array, Array]]:
    """Deck, sides, bar in body axes (x, y, depth): name -> points and faces; and the line, whose far end is moved by ``moved``."""
    deck, marks, radius = case["deck"], case["marks"], case["light"]["led_radius_m"]
    under = [m["depth_m"] + radius + s for m, s in zip(marks, case["light"]["stand_off_m"], strict=True)]
    at = [m["body_m"][0] for m in marks]
    x = np.linspace(-HULL_LENGTH_M / 2, HULL_LENGTH_M / 2, 61)
    half = deck["beam_m"] / 2 * (1 - np.abs(2 * x / HULL_LENGTH_M) ** 2.6) + 1e-4
    order = np.argsort(at)
    z = np.interp(x, np.array(at)[order], np.array(under)[order])
    n, k = len(x), np.arange(len(x) - 1)
    top = np.concatenate([np.stack([x, -half, z], -1), np.stack([x, half, z], -1)])
    flat = np.concatenate([np.stack([k, k + 1, k + n], -1), np.stack([k + 1, k + n + 1, k + n], -1)])
    low = top.copy()
    low[:, 2] = case["water"]["z_m"] + 0.12
    sides = np.concatenate([top, low])
    wall = []
    for s in (0, n):
        wall.append(np.stack([k + s, k + s + 1, k + s + 2 * n], -1))
        wall.append(np.stack([k + s + 1, k + s + 2 * n + 1, k + s + 2 * n], -1))
    bow = marks[0]
    level = under[0] + BAR_RADIUS_M * 0.2
    start = np.array([bow["body_m"][0] + deck["bar_from_m"], bow["body_m"][1], level])
    return {
        "deck": outward((top, flat), np.array([0.0, 0.0, 99.0])),
        "sides": outward((sides, np.concatenate(wall)), np.array([0.0, 0.0, z.mean()])),
        "bar": rod(start, np.array([BAR_TO_M, 0.0, level]), BAR_RADIUS_M),
    }


def line_body(case: dict[str, Any], tow_point_m: float, state: tuple[float, float, float]) -> tuple[Array, Array]:
    """The tow line in the tank, from the bar to the post."""
    depth = hull_body(case)["bar"][0][:, 2].mean()
    held = moved(np.array([[tow_point_m, 0.0, depth]]), state)[0]
    return rod(held, np.array([0.0, 0.0, depth]), LINE_RADIUS_M, 6)


def moved(points: Array, state: tuple[float, float, float]) -> Array:
    """Body axes to the tank; ``state``: x_cg_m, y_cg_m, beta_rad."""
    x_cg, y_cg, beta = state
    x, y = points[:, 0], points[:, 1]
    return np.stack(
        [x_cg + x * np.cos(beta) - y * np.sin(beta), y_cg + x * np.sin(beta) + y * np.cos(beta), points[:, 2]], -1
    )
