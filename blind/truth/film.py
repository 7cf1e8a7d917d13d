"""A plain film of the marks: soft bright spots on a dull, grainy ground."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from ...record.files import replacing
from ...record.x264 import x264_options
from .cases import Case
from .lanes import Array

SPOT_PX = 2.0
"""Width of a mark's light, the Gaussian's standard deviation."""
HALF = 12
"""Half the side of the square in which a mark is drawn: six of its widths."""


def write_film(path: Path, case: Case, pixel: Array, rng: np.random.Generator) -> None:
    """Write a film (H.264, crf 18).

    Parameters
    ----------
    path : .mp4
    case : as drawn
    pixel : ``(frames, marks, 2)`` where the spots stand, px
    rng : of the camera's noise
    """
    import av

    width, height = int(case.camera["width_px"]), int(case.camera["height_px"])
    rows, columns = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1]
    ground = 40 + 8 * np.sin(np.arange(width) / 90.0)[None, :] + 6 * np.cos(np.arange(height) / 70.0)[:, None]
    grain = rng.normal(scale=2.5, size=(8, height, width))
    with replacing(path) as temporary, av.open(str(temporary), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(case.rate_hz).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        # no frames from both sides: they would drag slow marks along
        stream.options = {"crf": "18", "preset": "veryfast", "bf": "0", **x264_options()}
        for k, marks in enumerate(pixel):
            frame = ground + np.roll(grain[k % 8], rng.integers(0, 997, size=2), axis=(0, 1))
            for u, v in marks:
                a, b = round(float(u)), round(float(v))
                if not (HALF < a < width - HALF - 1 and HALF < b < height - HALF - 1):
                    continue
                spot = np.exp(-0.5 * ((columns + a - u) ** 2 + (rows + b - v) ** 2) / SPOT_PX**2)
                frame[b - HALF : b + HALF + 1, a - HALF : a + HALF + 1] += 170 * spot
            picture = np.clip(np.rint(frame), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray8").reformat(format="yuv420p")))
        container.mux(stream.encode())
