"""The towing tank as mitsuba sees it: water, rails, walls, lamps, the hull with its bar and marks, path-traced ray by ray.

Light adds: the lamps' light and the marks' own light are two scenes over the same bodies, each with one kind of emitter, so that
few rays suffice. Rays are made here (the lens's distortion and blur are exact, no picture is bent afterwards). A mark itself is
looked at by a fine grid of rays of its own: path tracing would hit its few pixels by chance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from path_traced_bodies import (
    LINE_RADIUS_M,
    aligned,
    box,
    disc,
    hull_body,
    joined,
    line_body,
    moved,
    outward,
    plate,
    rod,
)
from path_traced_cases import TANK_WIDTH_M, Array, Camera, camera_of, datum_of

LOOP = 25
"""Water repeats itself after so many frames: what no hull reaches is rendered once for each of them."""
STATIC_RAYS, WATER_RAYS, HULL_RAYS, GLOW_RAYS, NEAR_RAYS = 12, 4, 2, 2, 16
"""Per pixel: what never changes; water beyond the hull; around the hull by the lamps; where a mark glows; close to a mark."""
NEAR_PX, GLOW_PX, SPOT_PX, SPOT_GRID = 11, 22, 8, 40
EVERY = 3
"""Half width of the window close to a mark; of that which its glow reaches; of its own light; rays across a mark's
surroundings, each way. Around the hull, but not close to a mark, the light is traced anew in every third frame: a hull moves by
less than a pixel in one."""
CHUNK = 8192
"""Numbers of rays are whole multiples of it."""


def tracer() -> Any:
    """Mitsuba, ready.

    Raises
    ------
    SystemExit : it is not installed, or finds neither LLVM nor a graphics card
    """
    try:
        import mitsuba as mi
    except ImportError as error:
        raise SystemExit(
            "path_traced.py needs mitsuba: pip install mitsuba==3.9.1 (the benchmark alone uses it)"
        ) from error
    for variant in ("cuda_ad_rgb", "llvm_ad_rgb"):
        try:
            mi.set_variant(variant)
            import drjit

            drjit.eval(drjit.arange(mi.Float, 2) + 1)
            drjit.set_thread_count(1)  # more wait for one another by spinning
            return mi
        except (ImportError, RuntimeError):
            continue
    raise SystemExit(
        "mitsuba runs neither on LLVM 16 or newer (DRJIT_LIBLLVM_PATH=.../libLLVM.so) nor on a graphics card here"
    )


def mesh(mi: Any, name: str, points: Array, faces: Array, bsdf: Any, smooth: bool = False, light: Any = None) -> Any:
    """A mesh of (n, 3) m and (m, 3), flat-shaded or smooth; ``light``: it shines."""
    props = mi.Properties()
    props["bsdf"] = bsdf
    props["face_normals"] = not smooth
    if light is not None:
        props["emitter"] = mi.load_dict({"type": "area", "radiance": light})
    made = mi.Mesh(name, len(points), len(faces), has_vertex_normals=smooth, props=props)
    params = mi.traverse(made)
    params["vertex_positions"] = mi.Float(aligned(points))
    params["faces"] = mi.UInt32(np.asarray(faces, dtype=np.uint32).ravel())
    params.update()
    return made


class Water:
    """Ripples of both directions that repeat after ``LOOP`` frames."""

    def __init__(self, case: dict[str, Any], rate_hz: float) -> None:
        rng = np.random.default_rng(case["water"]["seed"])
        x, y = np.arange(-7.0, 6.0, 0.08), np.linspace(-TANK_WIDTH_M / 2, TANK_WIDTH_M / 2, 58)
        self.x, self.y = (a.ravel() for a in np.meshgrid(x, y, indexing="ij"))
        self.z_m = case["water"]["z_m"]
        n, m = len(x), len(y)
        corner = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
        faces = [np.stack([corner, corner + m, corner + 1], -1), np.stack([corner + 1, corner + m, corner + m + 1], -1)]
        flat = np.stack([self.x, self.y, np.full(self.x.shape, self.z_m)], -1)
        self.faces = outward((flat, np.concatenate(faces)), np.array([0.0, 0.0, 99.0]))[1]
        self.waves = []
        for length in np.exp(rng.uniform(np.log(0.3), np.log(1.2), 14)):
            number, heading = 2 * np.pi / length, rng.uniform(0, 2 * np.pi)
            turns = max(round(np.sqrt(9.81 * number) / (2 * np.pi) * LOOP / rate_hz), 1)
            self.waves.append(
                (number * np.cos(heading), number * np.sin(heading), turns, rng.uniform(0, 2 * np.pi), length)
            )
        share = np.array([w[-1] for w in self.waves])
        self.height = case["water"]["height_m"] * np.sqrt(2) * share / np.sqrt((share**2).sum())

    def points(self, frame: int) -> Array:
        """Its surface, (n, 3)."""
        z = np.full(self.x.shape, self.z_m)
        for (kx, ky, turns, phase, _), height in zip(self.waves, self.height, strict=True):
            z += height * np.cos(kx * self.x + ky * self.y - 2 * np.pi * turns * frame / LOOP + phase)
        return np.stack([self.x, self.y, z], -1)


class Tank:
    """The scenes of a campaign: lamps' light and marks' light over the same bodies."""

    def __init__(self, case: dict[str, Any], rate_hz: float) -> None:
        self.mi = mi = tracer()
        self.case, self.camera, self.water = case, camera_of(case), Water(case, rate_hz)
        self.body = hull_body(case)
        self.lamps, self.glow = self._scene(lamps=True), self._scene(lamps=False)
        self.params = [mi.traverse(self.lamps), mi.traverse(self.glow)]
        self.path = mi.load_dict({"type": "path", "max_depth": 4, "rr_depth": 10, "hide_emitters": True})
        self.shapes = {s.id(): s for s in self.glow.shapes()}

    def _scene(self, lamps: bool) -> Any:
        mi, case = self.mi, self.case

        def rgb(values: Any) -> dict[str, Any]:
            return {"type": "rgb", "value": [float(v) for v in values]}

        def paint(*values: float) -> Any:
            return mi.load_dict({"type": "diffuse", "reflectance": rgb(values)})

        def gloss(values: Any, alpha: float) -> Any:
            return mi.load_dict({"type": "roughplastic", "diffuse_reflectance": rgb(values), "alpha": alpha})

        deck = case["deck"]
        # one object for all that look alike: mitsuba compiles each anew
        metal = mi.load_dict({"type": "roughconductor", "material": "Al", "alpha": deck["bar_gloss"]})
        walls, white, black = paint(0.4, 0.4, 0.38), paint(0.8, 0.8, 0.8), paint(0.02, 0.02, 0.02)
        scene: dict[str, Any] = {"type": "scene"}
        scene["water"] = mesh(
            mi,
            "water",
            self.water.points(0),
            self.water.faces,
            gloss((0.01, 0.03, 0.035), case["water"]["gloss"]),
            smooth=True,
        )
        looks = {
            "deck": gloss(deck["colour"], deck["gloss"]),
            "sides": gloss(deck["hull_colour"], deck["gloss"]),
            "bar": metal,
        }
        for name, (points, faces) in self.body.items():
            scene[name] = mesh(mi, name, points, faces, looks[name])
        if lamps:
            scene |= self._hall(black, metal, white, walls, rgb((10, 10, 9.5)))
        for mark in case["marks"]:
            ball = {"type": "sphere", "radius": case["light"]["led_radius_m"]}
            light = {"emitter": {"type": "area", "radiance": rgb(case["light"]["led_colour"])}}
            scene["led_" + mark["name"]] = ball | (light if not lamps else {"bsdf": white})
        return mi.load_dict(scene)

    def _hall(self, black: Any, metal: Any, white: Any, walls: Any, light: Any) -> dict[str, Any]:
        """What the marks' own light need not reach: line, post, rails, walls, datum discs; and the lamps."""
        mi, case, half, z = self.mi, self.case, TANK_WIDTH_M / 2, self.water.z_m
        post = rod(np.array([0.02, 0.0, -1.0]), np.array([0.02, 0.0, z - 0.02]), 0.012)
        rails = [box([-6.5, s * 0.95 - 0.03, 0.001], [1.0, s * 0.95 + 0.03, 0.05]) for s in (-1, 1)]
        sides = [box([-8, s * half - 0.02, -0.4], [8, s * half + 0.02, z + 0.2]) for s in (-1, 1)]
        room = [*sides, box([7.9, -9, -7], [8, 9, z + 0.2]), box([-9, -9, z + 0.2], [9, 9, z + 0.3])]
        lamps = [plate(x - long / 2, x + long / 2, y - 0.12, y + 0.12, h) for x, y, h, long in case["light"]["lamps"]]
        line = rod(np.zeros(3), np.array([0.5, 0.0, 0.0]), LINE_RADIUS_M, 6)
        discs = [disc(np.array(p), 0.024) for p in datum_of(case)]
        dots = [disc(np.array(p) - (0, 0, 0.0005), 0.009) for p in datum_of(case)]
        return {
            "line": mesh(mi, "line", *line, black),
            "iron": mesh(mi, "iron", *joined([post, *rails]), metal),
            "room": mesh(mi, "room", *joined(room), walls),
            "discs": mesh(mi, "discs", *joined(discs), white),
            "dots": mesh(mi, "dots", *joined(dots), black),
            "lamps": mesh(mi, "lamps", *joined(lamps), black, light=light),
        }

    def put(
        self, frame: int, state: tuple[float, float, float] | None, tow_point_m: float = 1.5, water: bool = True
    ) -> None:
        """Water of ``frame`` (or as it was), the hull at ``state``; None: the tank without it."""
        import drjit as dr

        mi = self.mi
        flat = lambda points: mi.Float(aligned(points))  # noqa: E731
        away = (60.0, 0.0, 0.0)
        # the marks' own light on water does not need its ripples in step
        if water:
            self.params[0]["water.vertex_positions"] = flat(self.water.points(frame % LOOP))
        for params in self.params:
            for name, (points, _) in self.body.items():
                params[f"{name}.vertex_positions"] = flat(moved(points, state or away))
            if params is self.params[0]:
                params["line.vertex_positions"] = flat(line_body(self.case, tow_point_m, state or away)[0])
            for mark in self.case["marks"]:
                place = moved(np.array([[*mark["body_m"], mark["depth_m"]]]), state or away)[0]
                where = mi.Transform4f().translate([float(v) for v in place]).scale(self.case["light"]["led_radius_m"])
                dr.make_opaque(where)  # else its numbers are compiled in, anew for every frame
                params[f"led_{mark['name']}.to_world"] = where
            params.update()

    def ray(self, across_px: Any, down_px: Any) -> Any:
        """Rays through pixels; the lens's k1 undone by six corrections (each is wrong by a twentieth of the last, or less)."""
        import drjit as dr

        mi, camera = self.mi, self.camera
        k1 = camera.distortion[0]
        bent_x, bent_y = (across_px - camera.cx_px) / camera.fx_px, (down_px - camera.cy_px) / camera.fx_px
        x, y = bent_x, bent_y
        for _ in range(6):
            radial = 1 + k1 * (x * x + y * y)
            x, y = bent_x / radial, bent_y / radial
        turn = camera.turn.T
        ahead = [float(turn[i, 0]) * x + float(turn[i, 1]) * y + float(turn[i, 2]) for i in range(3)]
        return mi.Ray3f(mi.Point3f(*(float(v) for v in camera.place_m)), dr.normalize(mi.Vector3f(*ahead)))

    def light(self, scene: Any, pixels: Array, rays: Array, rng: np.random.Generator, most: float) -> Array:
        """Mean light of whole-number pixels (n, 2) by so many rays each (n,), none above ``most``: (n, 3)."""
        found, first = self._through(pixels, rays, rng, lambda sampler, ray: self._clipped(scene, sampler, ray, most))
        return np.add.reduceat(found, first, axis=0) / rays[:, None]

    def bodies(self, pixels: Array, names: tuple[str, ...]) -> Array:
        """Which of the bodies so named stands behind the middle of each pixel (n, 2): its number from 1, 0: another."""
        found = self.lamps.ray_intersect(self.ray(*(self.mi.Float(aligned(pixels[:, axis])) for axis in (0, 1)))).shape
        which = np.zeros(len(pixels), dtype=np.uint8)
        shapes = {s.id(): s for s in self.lamps.shapes()}
        for number, name in enumerate(names, 1):
            which[np.array(found == self.mi.ShapePtr(shapes[name])).astype(bool)] = number
        return which

    def primary(self, pixels: Array, rays: int, names: tuple[str, ...], rng: np.random.Generator) -> Array:
        """The share of the rays of pixels (n, 2) that end on the bodies so named: (n,)."""
        bodies = [self.mi.ShapePtr(s) for s in self.lamps.shapes() if s.id() in names]

        def hit(_sampler: Any, ray: Any) -> Any:
            shape = self.lamps.ray_intersect(ray).shape
            on = self.mi.Bool(False)
            for body in bodies:
                on |= shape == body
            one = self.mi.Float(0) + on
            return self.mi.Color3f(one, one, one)

        found, first = self._through(pixels, np.full(len(pixels), rays), rng, hit)
        return np.add.reduceat(found[:, 0], first) / rays

    def _clipped(self, scene: Any, sampler: Any, ray: Any, most: float) -> Any:
        import drjit as dr

        found, _, _ = self.path.sample(scene, sampler, ray)
        return dr.minimum(found, self._number(most))

    def _through(
        self, pixels: Array, rays: Array, rng: np.random.Generator, of: Callable[[Any, Any], Any]
    ) -> tuple[Array, Array]:
        """What rays of pixels find, (all rays, 3), and each pixel's first one."""
        mi = self.mi
        first = np.cumsum(rays) - rays
        owner = np.repeat(np.arange(len(pixels)), rays)
        stratum = np.arange(len(owner)) - first[owner]
        rows = np.where(rays >= 4, 2, 1)[owner]
        corner = (
            pixels[owner] + np.stack([(stratum // rows) / (rays[owner] // rows), (stratum % rows) / rows], -1) - 0.5
        )
        size = np.stack([rows / rays[owner], 1 / rows], -1)
        # kernels are compiled for a number of rays: few numbers, few kernels
        spare = -len(owner) % CHUNK
        corner, size = (np.concatenate([a, a[:1].repeat(spare, axis=0)]).astype(np.float32) for a in (corner, size))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(rng.integers(1 << 31)), len(corner))
        inside, blur = (
            sampler.next_2d(),
            self.case["camera"]["blur_px"] * mi.warp.square_to_std_normal(sampler.next_2d()),
        )
        across = mi.Float(aligned(corner[:, 0])) + mi.Float(aligned(size[:, 0])) * inside.x + blur.x
        down = mi.Float(aligned(corner[:, 1])) + mi.Float(aligned(size[:, 1])) * inside.y + blur.y
        return np.array(of(sampler, self.ray(across, down))).T[: len(owner)], first

    def _number(self, value: float) -> Any:
        """A number that is not compiled in."""
        import drjit as dr

        made = self.mi.Float(value)
        dr.make_opaque(made)
        return made

    def seen(self, mark: int, place_m: Array, rng: np.random.Generator) -> tuple[Array, float]:
        """What of a mark's ball is seen: px of the rays of a fine jittered grid that end on it, and each one's share of a pixel."""
        name, camera = "led_" + self.case["marks"][mark]["name"], self.camera
        half = 1.5 * self.case["light"]["led_radius_m"] * camera.fx_px / float(np.linalg.norm(place_m - camera.place_m))
        cells = np.stack(np.meshgrid(np.arange(SPOT_GRID), np.arange(SPOT_GRID)), -1).reshape(-1, 2)
        where = camera.pixel(place_m) + ((cells + rng.random(cells.shape)) / SPOT_GRID * 2 - 1) * half
        found = self.glow.ray_intersect(self.ray(*(self.mi.Float(aligned(where[:, axis])) for axis in (0, 1))))
        hit = np.array(found.shape == self.mi.ShapePtr(self.shapes[name])).astype(bool)
        return where[hit], (2 * half / SPOT_GRID) ** 2


def pixels_of(camera: Camera, outlines: list[Array], grow_px: float) -> Array:
    """Whole-number pixels in the hulls of point sets in the tank, grown: (n, 2)."""
    import cv2

    mask = np.zeros(camera.size_px[::-1], dtype=np.uint8)
    for points in outlines:
        ring = cv2.convexHull(camera.pixel(points).astype(np.float32))
        cv2.fillConvexPoly(mask, np.round(ring).astype(np.int32), 1)
    size = 2 * round(grow_px) + 1
    rows, columns = np.nonzero(cv2.dilate(mask, np.ones((size, size), dtype=np.uint8)))
    return np.stack([columns, rows], -1)
