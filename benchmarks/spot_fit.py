"""The sub-pixel fit against the Cramer-Rao bound, beside what people use; the same pictures for all.

    python benchmarks/spot_fit.py        (trackpy's column appears where it is installed)

Spots of amplitude 160 on 20, read noise 3 DN, 20 e-/DN; the mark's own window is given to everybody.
RMSE over the bound; in brackets the standard deviation of error/sigma where the method states a sigma.
"""

from __future__ import annotations

import importlib.util
import time
from dataclasses import dataclass

import numpy as np

from towline.vision import fit_spots

AMPLITUDE_DN, GROUND_DN, READ_DN, ELECTRONS_PER_DN = 160.0, 20.0, 3.0, 20.0
COUNT, SIZE, SEED = 400, 31, 7


@dataclass(frozen=True)
class Clip:
    """Pictures with one spot each.

    Attributes
    ----------
    name, width : of the condition; standard deviation of the spot, px
    pictures : (n, s, s)
    centre : (n, 2), true places
    bound : Cramer-Rao standard deviation of one coordinate, px, of the spot alone
    """

    name: str
    width: float
    pictures: np.ndarray
    centre: np.ndarray
    bound: float


def clip(name: str, width: float, noise: float = 1.0, ghost: tuple[float, float, float] | None = None) -> Clip:
    """Make a clip; ``ghost`` is a mirror image (dx px, dy px, share of the amplitude), taller than wide."""
    rng = np.random.default_rng(SEED)
    axis = np.arange(SIZE, dtype=float)
    centre = (SIZE - 1) / 2 + rng.uniform(-0.5, 0.5, (COUNT, 2))
    x = axis[None, None, :] - centre[:, 0, None, None]
    y = axis[None, :, None] - centre[:, 1, None, None]
    bell = np.exp(-(x**2 + y**2) / (2 * width**2))
    mean = GROUND_DN + AMPLITUDE_DN * bell
    if ghost is not None:
        dx, dy, share = ghost
        mean = mean + share * AMPLITUDE_DN * np.exp(
            -((x - dx) ** 2) / (2 * width**2) - (y - dy) ** 2 / (2 * (1.6 * width) ** 2)
        )
    variance = (noise * READ_DN) ** 2 + noise**2 * mean / ELECTRONS_PER_DN
    information = ((AMPLITUDE_DN * bell * x / width**2) ** 2 / variance).sum(axis=(1, 2))
    pictures = np.clip(np.rint(mean + rng.normal(size=mean.shape) * np.sqrt(variance)), 0, 255)
    return Clip(name, width, pictures, centre, float(np.sqrt(np.mean(1 / information))))


def ours(made: Clip) -> tuple[np.ndarray, np.ndarray]:
    """Predicted window and batched fit, started at the nearest pixel."""
    radius = int(np.clip(round(2.8 * made.width), 5, 15))
    middle = (SIZE - 1) // 2
    cut = made.pictures[:, middle - radius : middle + radius + 1, middle - radius : middle + radius + 1]
    corner = np.full((COUNT, 2), float(middle - radius))
    fit = fit_spots(cut, corner, np.rint(made.centre), np.full(COUNT, made.width))
    return fit.centre_px, fit.sigma_px


def centroid(made: Clip) -> tuple[np.ndarray, None]:
    """Threshold at half height, intensity-weighted centroid by scikit-image's region properties."""
    from skimage.measure import label, regionprops

    found = np.full((COUNT, 2), np.nan)
    for index, picture in enumerate(made.pictures):
        regions = regionprops(label(picture > GROUND_DN + AMPLITUDE_DN / 2), intensity_image=picture - GROUND_DN)
        if regions:
            row, column = max(regions, key=lambda r: r.area).centroid_weighted
            found[index] = column, row
    return found, None


def blob(made: Clip) -> tuple[np.ndarray, None]:
    """OpenCV's SimpleBlobDetector with its bright setting."""
    import cv2

    settings = cv2.SimpleBlobDetector.Params()
    settings.blobColor, settings.filterByArea, settings.minArea, settings.maxArea = 255, True, 4.0, 400.0
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = 40, 200, 10
    detector = cv2.SimpleBlobDetector.create(settings)
    found = np.full((COUNT, 2), np.nan)
    for index, picture in enumerate(made.pictures):
        points = detector.detect(picture.astype(np.uint8))
        if points:
            found[index] = min((p.pt for p in points), key=lambda p: np.hypot(p[0] - SIZE / 2, p[1] - SIZE / 2))
    return found, None


def trackpy(made: Clip) -> tuple[np.ndarray, None]:
    """trackpy.locate with a diameter of about five widths."""
    import trackpy as tp  # pyright: ignore[reportMissingImports]

    tp.quiet()
    diameter = 2 * round(2.5 * made.width) + 1
    found = np.full((COUNT, 2), np.nan)
    for index, picture in enumerate(made.pictures):
        table = tp.locate(picture.astype(np.uint8), diameter, topn=1)
        if len(table):
            found[index] = table[["x", "y"]].to_numpy()[0]
    return found, None


def main() -> None:
    """Print the table."""
    clips = [
        clip("alone, width 1.5", 1.5),
        clip("alone, width 2.5", 2.5),
        clip("noise x 3, width 1.5", 1.5, noise=3.0),
        clip("reflection beside (12 px), width 1.5", 1.5, ghost=(1.0, 12.0, 0.4)),
        clip("reflection over (5 px), width 2.5", 2.5, ghost=(0.5, 5.0, 0.4)),
    ]
    methods = {"towline": ours, "region centroid": centroid, "OpenCV blob": blob}
    if importlib.util.find_spec("trackpy"):
        methods["trackpy"] = trackpy
    print(f"{'RMSE / bound':38} {'bound':>7}" + "".join(f"{name:>18}" for name in methods))
    spent = dict.fromkeys(methods, 0.0)
    for made in clips:
        cells = []
        for name, method in methods.items():
            began = time.process_time()
            found, sigma = method(made)
            spent[name] += time.process_time() - began
            gap = found - made.centre
            missed = int(np.isnan(gap).any(axis=1).sum())
            ratio = np.sqrt(np.nanmean(gap**2)) / made.bound
            text = f"{ratio:.2f}" + (f" ({np.nanstd(gap / sigma):.2f})" if sigma is not None else "")
            cells.append(text + (f" -{missed}" if missed else ""))
        print(f"{made.name:38} {made.bound:7.4f}" + "".join(f"{c:>18}" for c in cells))
    print(
        f"{'spots per CPU-second':38} {'':7}" + "".join(f"{len(clips) * COUNT / spent[name]:18.0f}" for name in methods)
    )


if __name__ == "__main__":
    main()
