"""A camera of its own: a 3 x 4 matrix, a lens that bends the picture, a sensor read row by row.

Lens numbers are those of run.toml (k1 k2 in OpenCV's sense, integer coordinates at pixel centres); the fault is applied forward
to the bent picture. A lens that is otherwise than stated may be so in several forms (``forms``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .lanes import Array, Lane

WRONG = ("k1", "k2_share", "fisheye", "aside", "centre_u", "centre_v")
"""Numbers of a lens that is not as stated, beside the bend of the finished picture; see ``Camera``."""


@dataclass(frozen=True)
class Camera:
    """What the tank's points look like.

    Attributes
    ----------
    matrix : ``(3, 4)``, rotation and place; tank metres to the normalised image plane
    lens : f, cx, cy, k1, k2
    fault : further bend of the picture: share of a point's distance from the centre at one focal length
    size_px : width, height
    wrong : other faults by name: k1 (added), k2_share (k2 added, by k1 added), fisheye (angles instead of tangents: its square
        shrinks as atan(c d)/(c d) with c^2 this number), aside (a bend like ``fault`` about centre_u, centre_v, in focal lengths)
    """

    matrix: Array
    lens: tuple[float, float, float, float, float]
    fault: float = 0.0
    size_px: tuple[int, int] = (1280, 720)
    wrong: Lane = field(default_factory=dict)

    def pixels(self, points_m: Array, turns: Array | None = None) -> Array:
        """``(..., 3)`` m in tank axes to ``(..., 2)`` px; ``turns``: of the camera at each of ``(n, 3)`` points, rad ``(n, 3)``."""
        f, cx, cy, k1, k2 = self.lens
        k1, k2 = k1 + self.wrong.get("k1", 0.0), k2 + self.wrong.get("k1", 0.0) * self.wrong.get("k2_share", 0.0)
        seen = points_m @ self.matrix[:, :3].T + self.matrix[:, 3]
        if turns is not None:
            seen = Rotation.from_rotvec(turns).apply(seen)
        flat = seen[..., :2] / seen[..., 2:]
        r2 = (flat**2).sum(axis=-1, keepdims=True)
        bent = flat * (1 + k1 * r2 + k2 * r2**2)
        if self.wrong:
            bent = self._worse(bent)
        if self.fault:
            bent = bent * (1 + self.fault * (bent**2).sum(axis=-1, keepdims=True))
        return f * bent + np.array([cx, cy])

    def _worse(self, bent: Array) -> Array:
        fisheye, aside = self.wrong.get("fisheye", 0.0), self.wrong.get("aside", 0.0)
        if fisheye:
            angle = np.sqrt(fisheye * (bent**2).sum(axis=-1, keepdims=True)) + 1e-12
            bent = bent * np.arctan(angle) / angle
        if aside:
            off = bent - np.array([self.wrong.get("centre_u", 0.0), self.wrong.get("centre_v", 0.0)])
            bent = bent + aside * off * (off**2).sum(axis=-1, keepdims=True)
        return bent

    def turned(self, right: float, down: float, roll: float) -> Camera:
        """After a turn about its own axes, rad."""
        return replace(self, matrix=turn_matrix(right, down, roll) @ self.matrix)


def turn_matrix(a: float, b: float, c: float) -> Array:
    """Rodrigues' formula for the vector (a, b, c).

    Parameters
    ----------
    a, b, c : the vector, rad
    """
    angle = float(np.sqrt(a * a + b * b + c * c))
    cross = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    if angle < 1e-12:
        return np.eye(3) + cross
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


def camera_of(numbers: Mapping[str, float], effects: Lane | None = None) -> Camera:
    """A camera behind the model that looks ahead and down (see ``draw``).

    Parameters
    ----------
    numbers : names -> values
    effects : ``effect.number`` -> value: those of lens_distortion are the lens's own
    """
    place = np.array([numbers["x_m"], numbers["y_m"], numbers["z_m"]])
    aim = np.array([numbers["aim_x_m"], 0.0, 0.1])
    ahead = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross([0.0, 0.0, 1.0], ahead)
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    tilt = numbers["tilt_rad"]
    rows = np.array(
        [
            np.cos(tilt) * right + np.sin(tilt) * down,
            -np.sin(tilt) * right + np.cos(tilt) * down,
            ahead,
        ]
    )
    matrix = np.column_stack([rows, -rows @ place])
    lens = (numbers["f_px"], numbers["cx_px"], numbers["cy_px"], numbers["k1"], numbers["k2"])
    given = {name: (effects or {}).get(f"lens_distortion.{name}", 0.0) for name in ("bend", *WRONG)}
    fault, wrong = given.pop("bend"), {name: value for name, value in given.items() if value}
    return Camera(matrix, lens, fault, (int(numbers["width_px"]), int(numbers["height_px"])), wrong)
