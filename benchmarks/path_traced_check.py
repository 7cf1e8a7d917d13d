"""Is what is rendered where it is said to be? The benchmark's own geometry against mitsuba's picture and OpenCV's formulae."""

from __future__ import annotations

import numpy as np
from path_traced_cases import Array, camera_of, datum_of, drawn, motion_of, placed
from path_traced_film import scattered, states
from path_traced_scene import SPOT_PX, Tank, tracer

RAYS, FRAMES = 1500, 5
"""Of a pixel in a window about a mark; of a tow that are looked at."""


def centroid(picture: Array, middle: Array) -> Array:
    """Light's middle in a window (rows, columns) about a whole-number pixel."""
    at = np.arange(len(picture)) - len(picture) // 2
    return middle + np.array([(picture.sum(axis=0) * at).sum(), (picture.sum(axis=1) * at).sum()]) / picture.sum()


def checked(numbers: list[int], seed: int) -> list[str]:
    """Lines that say how far off it is, px."""
    mi = tracer()
    import cv2

    shown = mi.load_dict({"type": "path", "max_depth": 1, "hide_emitters": False})
    offs, fine, brighter, discs, pinhole = [], [], [], [], []
    for number in numbers:
        case = drawn(number, seed)
        camera, tank, rng = camera_of(case), Tank(case, case["rate_hz"]), np.random.default_rng(number)
        matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fx_px, camera.cy_px], [0, 0, 1]])
        points = rng.uniform((-4, -1, -0.2), (0, 1, 0.4), (200, 3))
        theirs = cv2.projectPoints(
            points, cv2.Rodrigues(camera.turn)[0], -camera.turn @ camera.place_m, matrix, np.array(camera.distortion)
        )[0]
        pinhole.append(np.abs(theirs[:, 0] - camera.pixel(points)).max())
        motion = motion_of(case, 0)
        places = placed(motion, [m["body_m"] for m in case["marks"]], [m["depth_m"] for m in case["marks"]])
        at = np.arange(-SPOT_PX, SPOT_PX + 1)
        window = np.stack(np.meshgrid(at, at), -1).reshape(-1, 2)
        for i in np.linspace(0, len(motion) - 1, FRAMES).astype(int):
            tank.put(int(i), states(motion)[i])
            for k, place in enumerate(places[i]):
                true = camera.pixel(place)
                middle = np.round(true).astype(int)
                tank.path, usual = shown, tank.path
                lit = tank.light(tank.glow, middle + window, np.full(len(window), RAYS), rng, 1e9)
                tank.path = usual
                traced = lit.sum(axis=1).reshape(len(at), len(at))
                hits, share = tank.seen(k, place, rng)
                spot = scattered(tank, hits, share, np.zeros((1, 2)), middle)
                offs.append(centroid(traced, middle) - true)
                fine.append(centroid(spot, middle) - true)
                brighter.append(spot.sum() * sum(case["light"]["led_colour"]) / traced.sum() - 1)
        tank.put(0, None)
        for point in datum_of(case):
            true = camera.pixel(np.array(point))
            middle = np.round(true).astype(int)
            found = tank.primary(middle + window, RAYS, ("discs", "dots"), rng).reshape(len(at), len(at))
            discs.append(centroid(found, middle) - true)
    lines = []
    for name, values in (
        ("marks, path-traced", offs),
        ("marks, by their own rays", fine),
        ("datum discs, path-traced", discs),
    ):
        off = np.array(values)
        mean, worst = off.mean(axis=0), np.abs(off).max()
        lines.append(
            f"{name:28}{len(off):4d} centroids minus the formulae: mean {mean[0]:+.4f}, {mean[1]:+.4f} px, "
            f"rms {off.std():.4f}, worst {worst:.4f}"
        )
    lines.append(
        f"a mark's light by its own rays over the same path-traced: {np.mean(brighter):+.4f} +- {np.std(brighter):.4f}"
    )
    lines.append(f"the pinhole with its lens against cv2.projectPoints: {max(pinhole):.1e} px at most")
    return lines
