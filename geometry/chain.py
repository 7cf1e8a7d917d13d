"""The camera chain as one differentiable function: pixel -> undistort -> plane at depth -> rigid fit -> (x, y, beta).

Written with kornia's camera and homography operations and differentiated by torch, it knows nothing of the derivatives that
``mapping`` and ``rigid`` work out by hand: it stands beside them as their check, and runs in batches on a GPU.
Needs the extra ``kornia``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .camera import Array, Lens

UNDISTORT_STEPS = 60
"""kornia's fixed-point iteration; each step gains about one digit for |k1| up to 0.1 in the picture's corner."""
RIGID_STEPS = 6


@dataclass(frozen=True)
class ChainResult:
    """Pose and its exact derivative.

    Attributes
    ----------
    pose : (n, 3), x_CG m, y_CG m, beta rad
    per_px : (n, 3, m, 2), d(pose)/d(pixel)
    """

    pose: Array
    per_px: Array


def chain_pose(
    pixel_px: Array,
    lens: Lens,
    homographies: Array,
    body_m: Array,
    weight: Array,
    start: Array,
    device: str = "cpu",
) -> ChainResult:
    """Differentiate the whole chain for frames in which every marker is seen.

    Parameters
    ----------
    pixel_px : (n, m, 2), measured
    lens : its matrix and distortion
    homographies : (m, 3, 3), ideal pixel -> tank at each marker's depth (``Mapping.homography``)
    body_m : (m, 2)
    weight : (n, m, 2, 2), inverse covariances of the places, held fixed
    start : (n, 3), a pose near the answer
    device : of torch, "cpu" or "cuda"
    """
    import torch  # pyright: ignore[reportMissingImports]
    from kornia.geometry.calibration import undistort_points  # pyright: ignore[reportMissingImports]
    from kornia.geometry.linalg import transform_points  # pyright: ignore[reportMissingImports]

    def tensor(values: Array) -> Any:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float64, device=device)

    matrix, distortion = tensor(lens.matrix), tensor(lens.distortion)
    planes, body = tensor(homographies), tensor(body_m)

    def pose_of(pixel: Any, weights: Any, first: Any) -> Any:
        ideal = undistort_points(pixel[None], matrix[None], distortion[None], num_iters=UNDISTORT_STEPS)[0]
        place = transform_points(planes, ideal[:, None, :])[:, 0]
        pose = first
        for _ in range(RIGID_STEPS):
            cosine, sine = torch.cos(pose[2]), torch.sin(pose[2])
            along = cosine * body[:, 0] - sine * body[:, 1]
            across = sine * body[:, 0] + cosine * body[:, 1]
            gap = place - torch.stack([pose[0] + along, pose[1] + across], dim=1)
            one, zero = torch.ones_like(along), torch.zeros_like(along)
            slope = torch.stack([torch.stack([one, zero, -across], 1), torch.stack([zero, one, along], 1)], dim=1)
            normal = torch.einsum("mia,mij,mjb->ab", slope, weights, slope)
            right = torch.einsum("mia,mij,mj->a", slope, weights, gap)
            pose = pose + torch.linalg.solve(normal, right)
        return pose

    inputs = (tensor(pixel_px), tensor(weight), tensor(start))
    pose = torch.func.vmap(pose_of)(*inputs)
    slope = torch.func.vmap(torch.func.jacrev(pose_of))(*inputs)
    return ChainResult(pose.cpu().numpy(), slope.cpu().numpy())
