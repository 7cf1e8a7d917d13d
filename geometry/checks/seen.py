"""A camera that gives slopes by all of its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..camera import Array, Lens

NEAREST_M = 1e-6
"""What lies no further than this ahead of the camera is not seen."""


@dataclass(frozen=True)
class SeenCamera:
    """A camera at the parameters of a bundle.

    Attributes
    ----------
    lens, skew : skew in px
    rotation, translation : (3, 3), (3,), tank -> camera
    """

    lens: Lens
    skew: float
    rotation: Array
    translation: Array

    def project(self, tank: Array, turn: Array | None = None) -> tuple[Array, Array, Array]:
        """Pixels of tank points.

        Parameters
        ----------
        tank : (k, 3) m
        turn : (k, 3) rad, of the camera about itself; None: it stands

        Returns
        -------
        tuple : pixels (k, 2), slopes by ``layout.CAMERA`` (k, 2, 16) and by the tank point (k, 2, 3)
        """
        turned = tank @ self.rotation.T
        if turn is not None and turn.any():
            turned = Rotation.from_rotvec(turn).apply(turned + self.translation) - self.translation
        seen = turned + self.translation
        ahead = np.where(seen[:, 2] > NEAREST_M, seen[:, 2], np.nan)
        ideal = seen[:, :2] / ahead[:, None]
        pixel, per_ideal, per_lens = self.lens.slopes(ideal)
        if self.skew:
            share = self.skew / self.lens.fy_px
            pixel = np.stack([pixel[:, 0] + share * (pixel[:, 1] - self.lens.cy_px), pixel[:, 1]], axis=1)
            per_ideal = np.stack([per_ideal[:, 0] + share * per_ideal[:, 1], per_ideal[:, 1]], axis=1)
        zero = np.zeros(len(tank))
        per_skew = np.stack([(pixel[:, 1] - self.lens.cy_px) / self.lens.fy_px, zero], axis=1)
        right = np.stack([1.0 / ahead, zero, -ideal[:, 0] / ahead], axis=1)
        down = np.stack([zero, 1.0 / ahead, -ideal[:, 1] / ahead], axis=1)
        per_seen = per_ideal @ np.stack([right, down], axis=1)
        per_camera = np.concatenate([per_lens, per_skew[..., None], per_seen @ _cross(seen), per_seen], axis=2)
        return pixel, per_camera, per_seen @ self.rotation


def _cross(seen: Array) -> Array:
    """Slope of camera coordinates (k, 3) by a small turn of the camera, (k, 3, 3)."""
    x, y, z = seen.T
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, z, -y], -1), np.stack([-z, zero, x], -1), np.stack([y, -x, zero], -1)], -2)


__all__ = ["SeenCamera"]
