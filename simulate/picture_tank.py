"""The tank behind the model: walls, water and hall by one ray per (sub)pixel, painted once; ripples as a linear basis.

Rays meet planes in tank axes. Levels are in DN (0..255) at exposure 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from ..geometry.camera import Camera
from .model import GRAVITY_M_S2
from .picture_tools import Picture
from .scene import Stage

Rays = NDArray[np.float32]
_KNOT_PX = 16
"""Rays are computed at such knots and interpolated between by splines: a lens bends them slowly."""
_CAST_ROWS, _SHADED_ROWS = 256, 16
"""Rows of rays that are cast together, and shaded together: so many fit a processor's cache, which saves a fifth of the time."""
# The tank hall: z of ceiling and floor, x of the far end, width of the wall's top, the lamp's place. Choices, for
# looks.
_CEILING_M = -4.2
_FLOOR_M = 1.1
_END_M = 15.0
_WALL_TOP_M = 0.30
_LAMP = np.array([-1.0, 0.6, -4.0])
# Colours, blue green red, DN before the lamp's light: choices, for looks only.
_HALL = np.array([30.0, 28.0, 26.0])
_FLOOR = np.array([44.0, 46.0, 48.0])
_TOP = np.array([104.0, 110.0, 112.0])
_WALL = np.array([112.0, 110.0, 98.0])
_GIRDER = np.array([40.0, 104.0, 122.0])
_WATER = np.array([40.0, 33.0, 18.0])
_RAIL = np.array([70.0, 66.0, 64.0])
# Ripples: how many waves, root mean square of their slope (rad), and the brightness, DN, that limits them. Choices, for
# looks.
_WAVES = 14
_SLOPE = 0.045
_RIPPLE_TOP_DN = 13.0


@dataclass(frozen=True)
class Ripples:
    """Light and shade of travelling waves, linear in cos and sin of each wave's phase.

    Attributes
    ----------
    basis : (2 n, h/2 * w/2) float32 DN
    turning_rad_s : (n,) rate of each wave's phase as seen from the carriage
    shape : of the half-size picture
    """

    basis: NDArray[np.float32]
    turning_rad_s: NDArray[np.float64]
    shape: tuple[int, int]

    def at(self, t_s: float, size: tuple[int, int]) -> NDArray[np.float32]:
        """The change in brightness at time ``t_s``, ``(h, w)`` DN; ``size`` = (w, h) of the picture."""
        import cv2

        phase = self.turning_rad_s * t_s
        weights = np.concatenate([np.cos(phase), np.sin(phase)]).astype(np.float32)
        small = (weights @ self.basis).reshape(self.shape)
        return np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def cast_rays(camera: Camera, u_px: NDArray[np.float64], v_px: NDArray[np.float64]) -> Rays:
    """Directions ``(len(v), len(u), 3)`` in tank axes, not normalised; the lens is inverted on a grid and splined.

    Parameters
    ----------
    camera : of the scenario
    u_px : columns and rows
    v_px : columns and rows
    """
    grid_u = np.arange(u_px[0] - _KNOT_PX, u_px[-1] + 2 * _KNOT_PX, _KNOT_PX)
    grid_v = np.arange(v_px[0] - _KNOT_PX, v_px[-1] + 2 * _KNOT_PX, _KNOT_PX)
    mesh = np.stack(np.meshgrid(grid_u, grid_v), axis=-1).reshape(-1, 2)
    ideal = camera.lens.normalise(mesh)[0].reshape(len(grid_v), len(grid_u), 2)
    xy = [RectBivariateSpline(grid_v, grid_u, ideal[..., i])(v_px, u_px) for i in range(2)]
    seen = np.stack([*xy, np.ones_like(xy[0])], axis=-1)
    return (seen @ camera.rotation).astype(np.float32)


def paint_tank(camera: Camera, stage: Stage, size: tuple[int, int]) -> tuple[Picture, NDArray[np.float32]]:
    """The empty tank ``(h, w, 3)``, antialiased by 2 x 2 rays a pixel, and how much of a pixel is water, ``(h, w)``.

    Parameters
    ----------
    camera : of the scenario
    stage : walls, strings, girder and deck
    size : width and height, px
    """
    import cv2

    width, height = size
    u = (np.arange(2 * width) + 0.5) / 2 - 0.5
    v = (np.arange(2 * height) + 0.5) / 2 - 0.5
    strips = []
    for top in range(0, 2 * height, _CAST_ROWS):
        rays = cast_rays(camera, u, v[top : top + _CAST_ROWS])
        strips += [
            _shade(camera.place_m, rays[row : row + _SHADED_ROWS], stage) for row in range(0, len(rays), _SHADED_ROWS)
        ]
    colour, wet = (np.concatenate(parts) for parts in zip(*strips, strict=True))
    colour, wet = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (colour, wet))
    return np.asarray(colour, dtype=np.float32), np.asarray(wet, dtype=np.float32)


def _shade(place_m: NDArray[np.float64], rays: Rays, stage: Stage) -> tuple[Picture, NDArray[np.float32]]:
    """Colours ``(h, w, 3)`` where rays from ``place_m`` meet the nearest plane; 1 where that is water, ``(h, w)``."""
    place = place_m.astype(np.float32)
    half = stage.width_m / 2
    colour = np.full(rays.shape, _HALL, dtype=np.float32)
    nearest = np.full(rays.shape[:2], np.inf, dtype=np.float32)
    wet = np.zeros(rays.shape[:2], dtype=np.float32)

    flat, shades = rays.reshape(-1, 3), colour.reshape(-1, 3)

    def meet(axis: int, level: float, inside, shade, water: bool = False) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (level - place[axis]) / rays[..., axis]
        ahead = np.flatnonzero(np.isfinite(t) & (t > 1e-3) & (t < nearest))
        where = place + flat[ahead] * t.ravel()[ahead, None]
        good = inside(where)
        met = ahead[good]
        nearest.flat[met] = t.ravel()[met]
        wet.flat[met] = water
        shades[met] = shade(where[good], flat[met])

    meet(0, _END_M, lambda p: p[:, 2] > _CEILING_M, lambda p, d: _lit(_HALL * 1.2, p))
    meet(2, _FLOOR_M, lambda p: (np.abs(p[:, 1]) > half) & (p[:, 0] < _END_M), lambda p, d: _lit(_FLOOR, p))
    in_tank = lambda p: (np.abs(p[:, 1]) < half) & (p[:, 0] < _END_M)  # noqa: E731
    meet(2, stage.water_m, in_tank, lambda p, d: _water(p, d, stage), water=True)
    for side in (-1.0, 1.0):
        meet(1, side * half, lambda p: (p[:, 2] > 0) & (p[:, 2] < stage.water_m), lambda p, d: _wall(p, stage))
        meet(1, side * (half + _WALL_TOP_M), lambda p: p[:, 2] > 0, lambda p, d: _lit(_WALL * 0.5, p))
    middle = half + _WALL_TOP_M / 2
    meet(2, 0.0, lambda p: np.abs(np.abs(p[:, 1]) - middle) < _WALL_TOP_M / 2, lambda p, d: _top(p, half))
    meet(0, stage.girder_x_m, lambda p: _on_girder(p, half), lambda p, d: _girder(p))
    return colour, wet


def _light(p: NDArray) -> NDArray:
    """Falloff from the working lamp over the tank, (n,)."""
    away = ((p - _LAMP.astype(np.float32)) ** 2).sum(axis=1)
    return 0.30 + 0.85 / (1 + away / 30.0)


def _lit(colour: NDArray, p: NDArray) -> NDArray:
    return colour.astype(np.float32) * _light(p)[:, None]


def _wall(p: NDArray, stage: Stage) -> NDArray:
    """Painted wall: panel joints every metre, a dark band where the water wets it."""
    level = 0.78 + 0.05 * np.sin(5.1 * p[:, 0]) * np.sin(2.3 * p[:, 0] + 1)
    joint = np.exp(-(((p[:, 0] + 50) % 1.0 - 0.5) ** 2) / (2 * 0.008**2))
    wet = 1 / (1 + np.exp(-(p[:, 2] - stage.water_m + 0.045) / 0.008))
    edge = np.exp(-(p[:, 2] ** 2) / (2 * 0.012**2))
    return _lit(_WALL, p) * (level * (1 - 0.25 * joint) * (1 - 0.45 * wet) + 0.3 * edge)[:, None]


def _top(p: NDArray, half: float) -> NDArray:
    """Concrete edge with the carriage's steel rail on it."""
    across = np.abs(p[:, 1]) - half
    colour = _lit(_TOP, p) * (0.92 + 0.05 * np.sin(1.7 * p[:, 0]) * np.sin(0.9 * p[:, 0] + 2))[:, None]
    joint = np.exp(-(((p[:, 0] + 50.3) % 2.0 - 1.0) ** 2) / (2 * 0.012**2))
    colour = colour * (1 - 0.3 * joint)[:, None]
    rail = (np.abs(across - 0.15) < 0.03).astype(np.float32)[:, None]
    shine = np.exp(-((across - 0.143) ** 2) / (2 * 0.008**2))[:, None]
    return colour * (1 - rail) + _lit(_RAIL, p) * rail * (0.8 + 1.3 * shine)


def _on_girder(p: NDArray, half: float) -> NDArray:
    beam = (p[:, 2] > -0.72) & (p[:, 2] < -0.54) & (np.abs(p[:, 1]) < half + 0.25)
    foot = (p[:, 2] > -0.60) & (p[:, 2] < -0.02) & (np.abs(np.abs(p[:, 1]) - half - 0.15) < 0.09)
    return beam | foot


def _girder(p: NDArray) -> NDArray:
    """The carriage's cross girder: an I-beam with bright flanges."""
    flange = 0.75 + 0.35 * (p[:, 2] < -0.70) - 0.25 * ((p[:, 2] > -0.57) & (p[:, 2] < -0.53))
    stiffener = np.exp(-(((p[:, 1] + 50) % 0.6 - 0.3) ** 2) / (2 * 0.008**2))
    return _lit(_GIRDER, p) * (flange - 0.25 * stiffener)[:, None]


def _water(p: NDArray, d: NDArray, stage: Stage, slope_x: float = 0.0, slope_y: float = 0.0) -> NDArray:
    """Water: its own dark colour plus what it mirrors; the surface may be tilted by small slopes."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    normal = np.array([-slope_x, -slope_y, -1.0], dtype=np.float32)
    normal /= np.linalg.norm(normal)
    facing = -(d @ normal)
    r = d + 2 * facing[:, None] * normal
    fresnel = 0.02 + 0.98 * (1 - np.clip(facing, 0, 1)) ** 5
    up = np.maximum(-r[:, 2], 0.02)
    half = stage.width_m / 2
    to_wall = (np.where(r[:, 1] > 0, half, -half) - p[:, 1]) / np.where(np.abs(r[:, 1]) < 1e-4, 1e-4, r[:, 1])
    at_wall = stage.water_m - up * to_wall
    wall = 1 / (1 + np.exp(-np.clip(at_wall / 0.03, -60, 60)))
    to_ceiling = (stage.water_m - _CEILING_M) / up
    x, y = p[:, 0] + r[:, 0] * to_ceiling, p[:, 1] + r[:, 1] * to_ceiling
    mirrored = wall[:, None] * 2.2 * _lit(_WALL, p) + (1 - wall)[:, None] * _ceiling(x, y)
    body = _lit(_WATER, p) * (1 + 0.10 * np.cos(np.pi * np.clip(p[:, 1] / half, -1, 1)))[:, None]
    return body + fresnel[:, None] * mirrored


def _ceiling(x: NDArray, y: NDArray) -> NDArray:
    """The hall's roof: dim panels and rows of lamps, blurred as moving water blurs them."""
    row = np.exp(-((np.abs(y) - 1.1) ** 2) / (2 * 0.34**2))
    along = np.exp(-(((x + 100.4) % 2.8 - 1.4) ** 2) / (2 * 0.55**2))
    lamps = 1150.0 * row * along
    far = np.exp(-np.clip(x - 2.0, 0, None) / 5.0)
    return (lamps * far)[:, None] * np.array([0.98, 1.0, 0.95], dtype=np.float32) + (150.0 + 90.0 * far)[:, None]


def make_ripples(
    camera: Camera,
    stage: Stage,
    open_water: NDArray[np.float32],
    speed_m_s: float,
    height: float,
    rng: np.random.Generator,
) -> Ripples | None:
    """Waves on the water plane, moving aft with the carriage's speed, as a basis on every second pixel.

    The change in brightness is the slope of the wave times the change of the mirrored picture with slope. Waves that a
    pixel cannot resolve fade out. ``open_water`` (h, w): how much of a pixel is water with nothing before it.

    Parameters
    ----------
    camera : of the scenario
    stage : walls, strings, girder and deck
    open_water : (h, w), how much of a pixel is open water
    speed_m_s : of the carriage
    height : of the waves, over the usual
    rng : that draws
    """
    import cv2

    if height <= 0:
        return None
    rows, width = open_water.shape
    shape = ((rows + 1) // 2, (width + 1) // 2)
    u = 2.0 * np.arange(shape[1]) + 0.5
    v = 2.0 * np.arange(shape[0]) + 0.5
    rays = cast_rays(camera, u, v).reshape(-1, 3)
    place = camera.place_m.astype(np.float32)
    t = (stage.water_m - place[2]) / np.where(rays[:, 2] > 1e-3, rays[:, 2], np.nan)
    p = np.nan_to_num(place + rays * t[:, None])
    wet = np.isfinite(t) & (t > 0) & (np.abs(p[:, 1]) < stage.width_m / 2) & (p[:, 0] < _END_M)
    tilt = 0.04
    gain = np.zeros((2, len(p)), dtype=np.float32)
    for axis, slope in enumerate(((tilt, 0.0), (0.0, tilt))):
        up, down = (_water(p[wet], rays[wet], stage, s * slope[0], s * slope[1])[:, 1] for s in (1, -1))
        gain[axis, wet] = (up - down) / (2 * tilt)
    gain[0, wet] -= 38.0  # the sky over the tank brightens towards the bow
    top = _RIPPLE_TOP_DN / (_SLOPE * 1.4)
    gain = top * np.tanh(gain / top)

    scale = np.clip(stage.width_m / 4.6, 0.4, 1.2)
    length = scale * np.exp(rng.uniform(np.log(0.16), np.log(0.75), _WAVES))
    heading = rng.normal(0.0, 0.95, _WAVES)
    number = 2 * np.pi / length
    kx, ky = number * np.cos(heading), number * np.sin(heading)
    start = rng.uniform(0, 2 * np.pi, _WAVES)
    bare = cv2.resize(open_water, shape[::-1], interpolation=cv2.INTER_AREA).ravel()
    basis = np.zeros((2 * _WAVES, len(p)), dtype=np.float32)
    for i in range(_WAVES):
        phase = (kx[i] * p[:, 0] + ky[i] * p[:, 1] + start[i]).astype(np.float32)
        grid = phase.reshape(shape)
        step = np.maximum(np.abs(np.gradient(grid, axis=0)), np.abs(np.gradient(grid, axis=1))).ravel()
        strength = height * _SLOPE * np.sqrt(2 / _WAVES) * (gain[0] * kx[i] + gain[1] * ky[i]) / number[i]
        strength = strength * np.exp(-((step / 1.1) ** 2)) * bare * wet
        basis[i], basis[_WAVES + i] = strength * np.cos(phase), -strength * np.sin(phase)
    turning = kx * speed_m_s - np.sqrt(GRAVITY_M_S2 * number)
    return Ripples(basis, turning, shape)
