"""A camera of its own: a 3 x 4 matrix, a lens that bends the picture, a sensor read row by row.

Lens numbers are those of run.toml (k1 k2 in OpenCV's sense, integer coordinates at pixel centres); the fault is applied forward
to the bent picture.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .lanes import Array


@dataclass(frozen=True)
class Camera:
    """What the tank's points look like.

    Attributes
    ----------
    matrix : ``(3, 4)``, rotation and place; tank metres to the normalised image plane
    lens : f, cx, cy, k1, k2
    fault : further bend of the picture: share of a point's distance from the centre at one focal length
    size_px : width, height
    """

    matrix: Array
    lens: tuple[float, float, float, float, float]
    fault: float = 0.0
    size_px: tuple[int, int] = (1280, 720)

    def pixels(self, points_m: Array) -> Array:
        """``(..., 3)`` m in tank axes to ``(..., 2)`` px."""
        f, cx, cy, k1, k2 = self.lens
        seen = points_m @ self.matrix[:, :3].T + self.matrix[:, 3]
        flat = seen[..., :2] / seen[..., 2:]
        r2 = (flat**2).sum(axis=-1, keepdims=True)
        bent = flat * (1 + k1 * r2 + k2 * r2**2)
        if self.fault:
            bent = bent * (1 + self.fault * (bent**2).sum(axis=-1, keepdims=True))
        return f * bent + np.array([cx, cy])

    def turned(self, right: float, down: float, roll: float) -> Camera:
        """After a turn about its own axes, rad."""
        return Camera(turn_matrix(right, down, roll) @ self.matrix, self.lens, self.fault, self.size_px)


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


def camera_of(numbers: Mapping[str, float], fault: float = 0.0) -> Camera:
    """A camera behind the model that looks ahead and down (see ``draw``).

    Parameters
    ----------
    numbers : names -> values
    fault : further bend of the picture, as in ``Camera``
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
    return Camera(matrix, lens, fault, (int(numbers["width_px"]), int(numbers["height_px"])))
