"""Small scenes over photographs that nobody here made: marks of known places on a moving deck, drawn by one seed each.

The photographs are those that scikit-image's wheel carries. A deck (a plate, a puck under each mark, or the whole picture) moves
rigidly over a tank that stands; deck and tank are cut from two of them. Marks are discs seen through a lens that blurs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from towline.record import read_run
from towline.record.run import Run
from towline.vision.recording import Frame

PHOTOGRAPHS = (
    "astronaut.png", "brick.png", "camera.png", "cell.png", "chelsea.png", "clock_motion.png", "coffee.png", "coins.png",
    "grass.png", "gravel.png", "hubble_deep_field.jpg", "ihc.png", "moon.png", "motorcycle_left.png", "page.png", "retina.jpg",
    "rocket.jpg", "text.png",
)  # fmt: skip
SIZES = ((320, 240), (480, 360), (640, 480), (960, 720))
RATE_HZ, FRAMES = 30.0, 40
DIAMETER_PX = (0.8, 30.0)
BLUR_PX = (0.5, 1.2)
LEAST_CONTRAST = 6.0
"""Times the scatter of the ground about the mark."""
WORST_BOUND_PX = 0.15
"""Of one frame, for white noise."""
M_PER_PX = 0.004
FINE = 5
"""Points a pixel's side by which a disc is drawn."""
LEAST_APART = 3.0
"""Between two marks, in diameters of their pictures."""
FLAT = 30.0
"""Widths of a deck's rim beyond which it is deck, or tank, to 1e-13."""
ROOM_PX = 6.0
"""Beyond a mark's own radius, from the picture's edge."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """One scene and its truth.

    Attributes
    ----------
    seed : draws it all
    size_px : (w, h)
    diameter_px, blur_px, noise_dn : of every mark
    contrast_dn : of the mark that stands out least from the ground about it in the first frame; negative for dark ones
    paint_dn : grey value of the marks, which cover the deck below them
    deck : "plate", "pucks" or "all"
    place_px : (frames, marks, 2), centres
    seeded : run.toml says where the marks are seen at first
    bound_px : (marks,), Cramer-Rao bound of a coordinate in one frame, the worse of the two
    """

    seed: int
    size_px: tuple[int, int]
    diameter_px: float
    blur_px: float
    contrast_dn: float
    paint_dn: float
    noise_dn: float
    deck: str
    place_px: Array
    turn_rad: Array
    body_px: Array
    seeded: bool
    bound_px: Array
    scatter_dn: float
    deck_of: tuple[str, float, float]
    tank_of: tuple[str, float, float]
    margin: float

    def frames(self) -> Iterator[Frame]:
        """Its pictures."""
        rng = np.random.default_rng([self.seed, 1])
        for index in range(len(self.place_px)):
            picture = self.clean(index) + rng.normal(0, self.noise_dn, self.size_px[::-1])
            luma = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
            yield Frame(index, index / RATE_HZ, luma, None)

    def clean(self, index: int, marks: bool = True) -> Array:
        """One picture without noise."""
        import cv2

        w, h = self.size_px
        tank = photograph(*self.tank_of, (w, h))
        side = int(np.hypot(w, h)) + 4
        deck = photograph(*self.deck_of, (side, side))
        turn, body = self.turn_rad[index], self.body_px
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, -s], [s, c]])
        origin = self.place_px[index, 0] - rotation @ body[0]
        middle = (side - 1) / 2
        shift = origin - rotation @ np.array([middle, middle])
        way = np.column_stack([rotation, shift])
        seen = cv2.warpAffine(deck, way, (w, h), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        cover = self._cover(origin, rotation)
        picture = cover * seen + (1 - cover) * tank
        for place in self.place_px[index] if marks else ():
            cover_by_disc(picture, place, self.diameter_px, self.blur_px, self.paint_dn)
        return picture

    def _cover(self, origin: Array, rotation: Array) -> Array:
        w, h = self.size_px
        if self.deck == "all":
            return np.ones((h, w))
        u, v = np.arange(w) - origin[0], (np.arange(h) - origin[1])[:, None]
        x, y = rotation[0, 0] * u + rotation[1, 0] * v, rotation[0, 1] * u + rotation[1, 1] * v
        reach = self.margin * self.diameter_px
        if self.deck == "pucks":
            squares = [(x - bx) ** 2 + (y - by) ** 2 for bx, by in self.body_px]
            away = np.sqrt(np.minimum.reduce(squares)) - reach
        else:
            low, high = self.body_px.min(axis=0) - reach, self.body_px.max(axis=0) + reach
            away = np.maximum.reduce([low[0] - x, x - high[0], low[1] - y, y - high[1]])
        away /= 0.6 * self.blur_px
        cover = np.where(away > 0, 1 / (1 + np.exp(FLAT)), 1 / (1 + np.exp(-FLAT)))
        rim = np.abs(away) < FLAT
        cover[rim] = 1 / (1 + np.exp(away[rim]))
        return cover

    def run(self, folder: Path) -> Run:
        """Its run folder."""
        w, h = self.size_px
        lines = [f'name = "s{self.seed}"', 'kind = "free"', "[source]", 'video = "video.mp4"']
        for name, u, v in (("a", 0, 0), ("b", w - 1, 0), ("c", 0, h - 1), ("d", w - 1, h - 1)):
            lines += ["[[datum]]", f'name = "{name}"', f"pixel_px = [{u}, {v}]"]
            lines += [f"tank_m = [{-v * M_PER_PX:.6f}, {u * M_PER_PX:.6f}, 0.0]"]
        rng = np.random.default_rng([self.seed, 2])
        for index, (x, y) in enumerate(self.body_px * M_PER_PX):
            lines += [
                "[[marker]]",
                f'name = "m{index}"',
                f"body_m = [{-y:.6f}, {x:.6f}]",
                "depth_m = 0.0",
                'look = "disc"',
            ]
            lines += [f'colour = "{"dark" if self.contrast_dn < 0 else "bright"}"']
            if self.seeded:
                u, v = self.place_px[0, index] + rng.normal(0, 1.5, 2)
                lines += [f"seen_at_px = [{min(max(u, 0), w - 1):.1f}, {min(max(v, 0), h - 1):.1f}]"]
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.toml").write_text("\n".join(lines) + "\n")
        (folder / "video.mp4").touch()
        return read_run(folder)


def scene(seed: int) -> Scene:
    """The scene of a seed: drawn again until its marks keep the ranges."""
    for attempt in range(1000):
        drawn = _draw(seed, np.random.default_rng([seed, 0, attempt]))
        if drawn is not None:
            return drawn
    raise ValueError(f"scene {seed}: none keeps the ranges")


def _draw(seed: int, rng: np.random.Generator) -> Scene | None:
    w, h = SIZES[rng.integers(len(SIZES))]
    diameter = float(np.exp(rng.uniform(*np.log(DIAMETER_PX))))
    blur = float(rng.uniform(*BLUR_PX))
    noise = float(np.exp(rng.uniform(np.log(0.7), np.log(5.0))))
    deck = ("plate", "plate", "pucks", "all")[rng.integers(4)]
    count = 2 if rng.random() < 0.6 else 3
    size = np.hypot(diameter, 2.355 * blur)
    margin = float(rng.uniform(1.5, 4.0)) * size / diameter
    apart = size * np.exp(rng.uniform(np.log(4.0), np.log(16.0)))
    body = np.array([[0.5, 0.0], [-0.5, 0.0]]) * apart
    if count == 3:
        body = np.vstack([body, [rng.uniform(-0.35, -0.1) * apart, rng.uniform(0.3, 0.6) * apart]])
    gap = np.linalg.norm(body[:, None] - body[None], axis=2) + 1e9 * np.eye(count)
    if gap.min() < LEAST_APART * size:
        return None
    turn = rng.uniform(-np.pi, np.pi) + np.radians(rng.uniform(-3, 3)) * np.arange(FRAMES)
    speed, course = rng.uniform(0, 8), rng.uniform(-np.pi, np.pi)
    bend = rng.normal(0, 0.1, 2)
    when = np.arange(FRAMES) - FRAMES / 2
    path = np.outer(when, speed * np.array([np.cos(course), np.sin(course)])) + np.outer(0.5 * when**2 * 0.3, bend)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    place = path[:, None] + np.einsum("tij,mj->tmi", rotation, body)
    room = ROOM_PX + 0.5 * size
    low, high = place.min(axis=(0, 1)), place.max(axis=(0, 1))
    free = np.array([w, h]) - 1 - 2 * room - (high - low)
    if (free < 0).any():
        return None
    place = place + room - low + rng.random(2) * free
    deck_of = (
        PHOTOGRAPHS[rng.integers(len(PHOTOGRAPHS))],
        float(rng.uniform(40, 215)),
        float(np.exp(rng.uniform(0, np.log(40)))),
    )
    tank_of = (
        PHOTOGRAPHS[rng.integers(len(PHOTOGRAPHS))],
        float(rng.uniform(40, 215)),
        float(np.exp(rng.uniform(0, np.log(50)))),
    )
    seeded = count == 2 or rng.random() < 0.5
    bare = Scene(
        seed,
        (w, h),
        diameter,
        blur,
        0.0,
        0.0,
        noise,
        deck,
        place,
        turn,
        body,
        seeded,
        np.zeros(count),
        0.0,
        deck_of,
        tank_of,
        margin,
    )
    ground = [_about(bare.clean(0, marks=False), p, 0.5 * size, 1.4 * size) for p in place[0]]
    scatter = float(np.hypot(max(g.std() for g in ground), noise))
    level = [float(g.mean()) for g in ground]
    sign = -1.0 if rng.random() < 0.5 else 1.0
    nearest = min(level) if sign < 0 else max(level)
    most = nearest - 12 if sign < 0 else 243 - nearest
    least = LEAST_CONTRAST * scatter
    if most <= least:
        return None
    contrast = sign * float(rng.uniform(least, min(most, max(4 * least, 60.0))))
    paint = nearest + contrast
    bound = np.array([_bound(p, diameter, blur, paint - g, noise) for p, g in zip(place[0], level, strict=True)])
    # a small disc keeps a part of its contrast only
    seen = _disc(np.array([0.0, 0.0]), diameter, blur, 2).max()
    if bound.max() > WORST_BOUND_PX or abs(contrast) * seen < least:
        return None
    return Scene(
        seed,
        (w, h),
        diameter,
        blur,
        contrast,
        paint,
        noise,
        deck,
        place,
        turn,
        body,
        seeded,
        bound,
        scatter,
        deck_of,
        tank_of,
        margin,
    )


def _about(picture: Array, place: Array, inner: float, outer: float) -> Array:
    v, u = np.indices(picture.shape)
    away = np.hypot(u - place[0], v - place[1])
    ring = picture[(away > inner) & (away < outer)]
    return ring if len(ring) else picture[away < outer + 2]


@lru_cache(maxsize=8)
def photograph(name: str, level_dn: float, spread_dn: float, size_px: tuple[int, int]) -> Array:
    """A photograph's part of the given size, at a mean and a standard deviation."""
    grey = _grey(name)
    w, h = size_px
    tiles = np.pad(grey, ((0, max(0, h - grey.shape[0])), (0, max(0, w - grey.shape[1]))), mode="reflect")[:h, :w]
    return np.clip(level_dn + spread_dn * (tiles - tiles.mean()) / max(float(tiles.std()), 1e-6), 5, 250)


@lru_cache(maxsize=len(PHOTOGRAPHS))
def _grey(name: str) -> Array:
    import skimage
    from skimage import io

    return io.imread(Path(skimage.__file__).parent / "data" / name, as_gray=True).astype(float)


def _disc(centre: Array, diameter: float, blur: float, reach: int) -> Array:
    """(n, n) cover of a blurred disc whose centre lies ``centre`` (u, v) from the window's middle pixel."""
    import cv2

    half = reach * FINE + FINE // 2
    axis = np.arange(-half, half + 1) / FINE
    away = np.hypot(axis[None, :] - centre[0], axis[:, None] - centre[1])
    fine = np.clip((0.5 * diameter - away) * FINE + 0.5, 0, 1)
    if diameter < 3:  # a few points of the grid would not know its size
        fine *= np.pi / 4 * diameter**2 * FINE**2 / max(float(fine.sum()), 1e-9)
    fine = cv2.GaussianBlur(fine, (0, 0), blur * FINE)
    n = 2 * reach + 1
    return fine.reshape(n, FINE, n, FINE).mean(axis=(1, 3))


def _reach(diameter: float, blur: float) -> int:
    return int(np.ceil(0.5 * diameter + 4 * blur + 1))


def cover_by_disc(picture: Array, place: Array, diameter: float, blur: float, paint: float) -> None:
    """Put a disc of a grey value over a picture, which does not show through it."""
    reach = _reach(diameter, blur)
    u, v = (int(x) for x in np.rint(place))
    drawn = _disc(place - (u, v), diameter, blur, reach)
    h, w = picture.shape
    a, b, c, d = max(v - reach, 0), min(v + reach + 1, h), max(u - reach, 0), min(u + reach + 1, w)
    share = drawn[a - v + reach : b - v + reach, c - u + reach : d - u + reach]
    picture[a:b, c:d] += share * (paint - picture[a:b, c:d])


def _bound(place: Array, diameter: float, blur: float, contrast: float, noise: float) -> float:
    reach = _reach(diameter, blur)
    at, step = place - np.rint(place), 0.1
    slope = [
        contrast * (_disc(at + d, diameter, blur, reach) - _disc(at - d, diameter, blur, reach)) / (2 * step)
        for d in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    return float(noise / np.sqrt(min((s**2).sum() for s in slope)))
