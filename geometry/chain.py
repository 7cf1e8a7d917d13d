"""The camera chain as one differentiable function: pixel -> undistort -> plane at depth -> rigid fit -> (y_CG, beta, alpha).

Written with kornia's camera and homography operations and differentiated by ``torch.func``, by everything that enters it: pixels,
lens, camera matrix, heights and places of the marks. It knows nothing of the derivatives that ``mapping``, ``rigid`` and ``motion``
work out by hand, stands beside them as their check, and runs in batches on a GPU. Needs the extra ``kornia``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .camera import Array, Lens

UNDISTORT_STEPS = 60
"""kornia's fixed-point iteration; each step gains about one digit for |k1| up to 0.1 in the picture's corner."""
RIGID_STEPS = 6
"""Gauss-Newton steps from the first pose, as many as in rigid.py; always all of them."""


@dataclass(frozen=True)
class Chain:
    """What the chain holds beside the pixels.

    Attributes
    ----------
    lens : matrix and distortion
    matrix : (3, 4), tank -> ideal coordinates (``ProjectiveMapping.matrix``)
    depth_m, body_m : (m,), (m, 2)
    tow_point_m, post_m : (2,), (2,)
    """

    lens: Lens
    matrix: Array
    depth_m: Array
    body_m: Array
    tow_point_m: Array
    post_m: Array


@dataclass(frozen=True)
class ChainResult:
    """Motion and its exact derivatives.

    Attributes
    ----------
    motion : (n, 3), y_CG m, beta rad, alpha rad
    per_px : (n, 3, m, 2)
    per_lens : (n, 3, 9), by ``Lens.vector``
    per_matrix : (n, 3, 3, 4)
    per_depth : (n, 3, m)
    per_body : (n, 3, m, 2)
    """

    motion: Array
    per_px: Array
    per_lens: Array
    per_matrix: Array
    per_depth: Array
    per_body: Array


def chain_motion(pixel_px: Array, chain: Chain, weight: Array, start: Array, device: str = "cpu") -> ChainResult:
    """Run and differentiate the whole chain for frames in which every mark is seen.

    Parameters
    ----------
    pixel_px : (n, m, 2), measured
    chain : camera, marks and line
    weight : (n, m, 2, 2), inverse covariances of the places, held fixed
    start : (n, 3), x, y, beta near the answer
    device : of torch, "cpu" or "cuda"
    """
    import torch  # pyright: ignore[reportMissingImports]

    def tensor(values: Array) -> Any:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float64, device=device)

    tow, post = tensor(chain.tow_point_m), tensor(chain.post_m)

    def motion(pixel, lens, matrix, depth, body, weights, first) -> Any:
        return _motion(pixel, lens, matrix, depth, body, weights, first, tow, post)

    shared = (tensor(chain.lens.vector), tensor(chain.matrix), tensor(chain.depth_m), tensor(chain.body_m))
    own = (tensor(weight), tensor(start))
    axes = (0, None, None, None, None, 0, 0)
    value = torch.func.vmap(motion, in_dims=axes)(tensor(pixel_px), *shared, *own)
    slopes = torch.func.vmap(torch.func.jacrev(motion, argnums=(0, 1, 2, 3, 4)), in_dims=axes)(
        tensor(pixel_px), *shared, *own
    )
    return ChainResult(value.cpu().numpy(), *(slope.cpu().numpy() for slope in slopes))


def _motion(pixel, lens, matrix, depth, body, weights, first, tow, post) -> Any:
    import torch  # pyright: ignore[reportMissingImports]
    from kornia.geometry.calibration import undistort_points  # pyright: ignore[reportMissingImports]
    from kornia.geometry.linalg import transform_points  # pyright: ignore[reportMissingImports]

    zero, one = torch.zeros_like(lens[0]), torch.ones_like(lens[0])
    inner = torch.stack(
        [torch.stack([lens[0], zero, lens[2]]), torch.stack([zero, lens[1], lens[3]]), torch.stack([zero, zero, one])]
    )
    straight = undistort_points(pixel[None], inner[None], lens[None, 4:], num_iters=UNDISTORT_STEPS)[0]
    planes = torch.stack(
        [
            matrix[:, 0].expand(len(depth), 3),
            matrix[:, 1].expand(len(depth), 3),
            depth[:, None] * matrix[:, 2] + matrix[:, 3],
        ],
        dim=2,
    )
    place = transform_points(torch.linalg.inv(inner[None] @ planes), straight[:, None, :])[:, 0]
    pose = first
    for _ in range(RIGID_STEPS):
        cosine, sine = torch.cos(pose[2]), torch.sin(pose[2])
        along = cosine * body[:, 0] - sine * body[:, 1]
        across = sine * body[:, 0] + cosine * body[:, 1]
        gap = place - torch.stack([pose[0] + along, pose[1] + across], dim=1)
        ones, zeros = torch.ones_like(along), torch.zeros_like(along)
        slope = torch.stack([torch.stack([ones, zeros, -across], 1), torch.stack([zeros, ones, along], 1)], dim=1)
        normal = torch.einsum("mia,mij,mjb->ab", slope, weights, slope)
        pose = pose + torch.linalg.solve(normal, torch.einsum("mia,mij,mj->a", slope, weights, gap))
    cosine, sine = torch.cos(pose[2]), torch.sin(pose[2])
    ahead = post[0] - pose[0] - (tow[0] * cosine - tow[1] * sine)
    aside = pose[1] + (tow[0] * sine + tow[1] * cosine) - post[1]
    return torch.stack([pose[1], pose[2], torch.atan2(aside, ahead)])
