"""Is a stated set-up an ordinary one? A model in a tank, seen from above: each property as a number, 0 ordinary, large absurd.

Nothing here is statistics of a good set-up: tolerances are those of a tape measure, ranges are far wider than any tank. What lies
outside them is a slip of sign, unit, name or clip (``suspects``), or no tow at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pandas as pd

from ...record.errors import TowlineError
from ...record.run import Run
from ...record.schema import RunFile
from ...record.tables import seen_rows
from ..camera import Array
from ..datum import DatumFit, fit_datum
from ..datum_model import datum_model
from ..line import tow_arm
from ..mapping import ProjectiveMapping
from ..motion import lens_covariance
from ..rigid import fit_rigid
from .sizes import IMPOSSIBLE, odd_sizes

Seen = tuple[Array, Array, Array]
"""Marks in the tank, the camera's modes, their change with depth (``_places``)."""
ABSURD = 8.0
"""A number from here on is not ordinary: eight tolerances, far beyond chance and what a careful set-up is off by. A choice."""
ORDINARY = 4.0
"""A number below is ordinary: a choice, half of the above, so that nothing lies on the edge of both."""
FRAMES = 16
"""Frames that are looked at, spread over the run: what is asked is the same in all of them."""
LEAST_SIGMA_PX = 0.3
"""A pick counts as no better than this, however it is stated: gross mistakes are looked for."""
PLACE_M, DEPTH_M = 1e-3, 2e-3
"""How well a tape measure tells a place and a height, where [priors] says nothing."""
SHARE = 3e-3
"""Of a length: lens, datum and tape together are seldom off by more. A choice."""
FAR, FAR_ROUGH = 20.0, 60.0
"""A start of the camera's fit that misses its picks by more than so many of their errors is not fitted further; the second where
the focal length is to be found as well, whose start is rough. Choices, for the time that it takes."""
STEEPEST = np.radians(75.0)
"""A towed model heads into the tow, and its line pulls ahead, within this: beyond every swing that a line lets it make."""
WORDS: dict[str, str] = {
    "datum": "no camera sees the datum points where they were picked",
    "above": "the camera would look up from below the tank, or in a mirror",
    "camera": "the camera would have a lens that nobody makes",
    "marks": "the marks would not keep their distances",
    "hand": "the marks would stand mirrored on deck",
    "heading": "the model would be towed stern first",
    "ahead": "the model would run ahead of its tow post",
    "line": "the tow point would not stay within the line's length of the post",
    "picture": "points would lie outside the picture",
    "lens": "the lens would not be of this picture",
    "height": "marks would lie above the camera",
    "walls": "the model would swim outside its tank",
    "hull": "the hull would not weigh what its length says",
    "force": "the line would not pull with the force of such a hull",
}
"""What each number says where it is large; those of single keys are said by the key."""


@dataclass(frozen=True)
class Film:
    """What was seen, as arrays.

    Attributes
    ----------
    pixel_px : (n, m, 2), of the marks in run.toml's order; NaN where not measured; n = 0 without tracks
    size_px : width and height of the video's picture; None without a video
    """

    pixel_px: Array
    size_px: tuple[int, int] | None = None


def film_of(run: Run, tracks: pd.DataFrame | None, size_px: tuple[int, int] | None = None) -> Film:
    """A run's tracks as arrays, some frames of them.

    Parameters
    ----------
    run : the run folder as read
    tracks : as ``record.read_tracks`` gives; None: not tracked yet
    size_px : of its video, where it has one
    """
    names = [m.name for m in run.file.marker]
    if tracks is None or tracks.empty:
        return Film(np.zeros((0, len(names), 2)), size_px)
    known = tracks[tracks["marker"].isin(names) & seen_rows(tracks)]
    span = run.file.source.span_s
    if span is not None:
        known = known[known["t_s"].between(*span)]
    count = known.groupby("frame")["marker"].count()
    frames = count.index[count >= min(2, len(names))].to_numpy()
    kept = (
        frames[np.unique(np.linspace(0, len(frames) - 1, min(FRAMES, len(frames))).astype(int))]
        if len(frames)
        else frames
    )
    known = known[known["frame"].isin(kept)]
    pixel = np.full((len(kept), len(names), 2), np.nan)
    column = known["marker"].map({name: i for i, name in enumerate(names)}).to_numpy()
    pixel[np.searchsorted(kept, known["frame"].to_numpy()), column] = known[["u_px", "v_px"]].to_numpy()
    return Film(pixel, size_px)


@dataclass
class Judge:
    """Judges set-ups of one film; cameras that were fitted already are remembered.

    Attributes
    ----------
    run : whose film it is
    film : what was seen
    """

    run: Run
    film: Film
    _fits: dict[object, DatumFit | None] = field(default_factory=dict)
    _seen_at: dict[object, Seen] = field(default_factory=dict)

    def numbers(self, file: RunFile, most: dict[str, float] | None = None) -> dict[str, float] | None:
        """Each property of a set-up, by the names of ``WORDS``, or by the key that it belongs to.

        Parameters
        ----------
        file : the set-up: run.toml's content, or what it would be without a mistake
        most : by name, what a number may be (``ORDINARY`` where it is not named); None: anything

        Returns
        -------
        dict of numbers, or None as soon as one is above what it may be
        """
        found: dict[str, float] = {}
        for step in (odd_sizes, self._picture, self._camera, self._marks):
            with np.errstate(all="ignore"):  # an absurd set-up divides by nothing; what is not finite is impossible
                found |= step(file)
            if most is not None and any(value > most.get(name, ORDINARY) for name, value in found.items()):
                return None
        return found

    def _picture(self, file: RunFile) -> dict[str, float]:
        return _picture(file, self.film)

    def _told(self, file: RunFile) -> bool:
        """Something tells the camera: a lens, the picture's size, two depths, or marks in the datum's plane (``datum_model``)."""
        depths = {p.tank_m[2] for p in file.datum}
        if file.camera is not None or self.film.size_px is not None or (len(depths) > 1 and len(file.datum) > 5):
            return True
        return len(depths) == 1 and all(m.depth_m in depths for m in file.marker)

    def _fit(self, file: RunFile) -> DatumFit | None:
        """The camera over all datum points; None where it is far from seeing them as picked."""
        flat = {p.tank_m[2] for p in file.datum} == {m.depth_m for m in file.marker}
        key = (file.camera, file.datum, file.camera is None and flat)
        if key not in self._fits:
            try:
                self._fits[key] = self._fitted(file)
            except (TowlineError, ArithmeticError, np.linalg.LinAlgError, ValueError):
                self._fits[key] = None
        return self._fits[key]

    def _fitted(self, file: RunFile) -> DatumFit | None:
        size = file.camera.image_size_px if file.camera else self.film.size_px
        depths = [m.depth_m for m in file.marker]
        points = [p.model_copy(update={"sigma_px": max(p.sigma_px, LEAST_SIGMA_PX)}) for p in file.datum]
        spread = lens_covariance(self.run)
        tank, pixel = (np.array([getattr(p, key) for p in points], dtype=float) for key in ("tank_m", "pixel_px"))
        model = datum_model(tank, pixel, file.camera, depths, size, spread)
        seen = np.column_stack([tank, np.ones(len(tank))]) @ model.matrix(model.start).T
        if not (seen[:, 2] > 0).all():
            return None
        gap = pixel - model.lens(model.start).distort(seen[:, :2] / seen[:, 2:])
        sigma = np.array([p.sigma_px for p in points])
        far = FAR_ROUGH if model.method == "square_pixels" else FAR
        near = np.sqrt(np.mean((gap / sigma[:, None]) ** 2)) < far or any(p.tank_sd_m > 0 for p in points)
        return fit_datum(points, file.camera, depths, size, spread, robust=False) if near else None

    def _camera(self, file: RunFile) -> dict[str, float]:
        """What the datum says; nothing where too little is known for any camera."""
        if file.source.motion is not None or not self._told(file):
            return {}
        fit = self._fit(file)
        if fit is None:
            return {"datum": IMPOSSIBLE}
        mapping = fit.mapping
        found = {"datum": float(np.sqrt(fit.chi_square / max(fit.degrees, 1))), "above": _above(mapping, file)}
        if mapping.method == "two_planes":
            found["camera"] = _usual_camera(mapping)
        if not found["above"]:
            height = _height(mapping)
            found["height"] = IMPOSSIBLE * any(m.depth_m < -height for m in file.marker)
        return _finite(found)

    def _marks(self, file: RunFile) -> dict[str, float]:
        """What the marks say."""
        if file.source.motion is not None or not len(self.film.pixel_px) or not self._told(file):
            return {}
        fit = self._fit(file)
        if fit is None:
            return {}
        key = (id(fit), tuple(m.depth_m for m in file.marker))
        try:
            if key not in self._seen_at:
                self._seen_at[key] = _places(file, self.film, fit.mapping)
            return _finite(_marks(file, self._seen_at[key]))
        except (TowlineError, ArithmeticError, np.linalg.LinAlgError):
            return {"marks": IMPOSSIBLE}


def _finite(found: dict[str, float]) -> dict[str, float]:
    return {name: value if np.isfinite(value) else IMPOSSIBLE for name, value in found.items()}


def _picture(file: RunFile, film: Film) -> dict[str, float]:
    """Points inside their picture, a lens of that picture."""
    found: dict[str, float] = {}
    camera = file.camera
    size = film.size_px or (camera.image_size_px if camera else None)
    if size is not None and file.datum:
        seen = np.vstack([np.array([p.pixel_px for p in file.datum], dtype=float), film.pixel_px.reshape(-1, 2)])
        seen, edge = seen[np.isfinite(seen).all(axis=1)], 0.01 * max(size)
        found["picture"] = IMPOSSIBLE * bool((seen < -edge).any() or (seen > np.array(size) + edge).any())
    if camera is not None:
        size = film.size_px or camera.image_size_px
        centre = np.array([camera.cx_px, camera.cy_px]) / np.array(size)
        focal = camera.fx_px / max(size)
        usual = (np.abs(centre - 0.5) < 0.25).all() and 0.25 < focal < 25 and 0.5 < camera.fx_px / camera.fy_px < 2
        found["lens"] = IMPOSSIBLE * (not usual)
    return found


# what the camera sees --------------------------------------------------------------------------------------------------


def _above(mapping: ProjectiveMapping, file: RunFile) -> float:
    """0 where the camera stands above its datum and sees it as it is, x turned to y clockwise, ahead of it; else impossible."""
    tank = np.array([p.tank_m for p in file.datum], dtype=float)
    seen = np.column_stack([tank, np.ones(len(tank))]) @ mapping.matrix.T
    if (seen[:, 2] <= 0).any():
        return IMPOSSIBLE
    solid = mapping.matrix[:, :3]
    if mapping.method != "homography" and np.linalg.det(solid) <= 0:
        return IMPOSSIBLE
    for depth in np.unique(tank[:, 2]):
        # det of (x, y) -> (u, v) is that of the plane's matrix over w^3
        if np.linalg.det(mapping.plane(depth)) <= 0:
            return IMPOSSIBLE
    return 0.0


def _height(mapping: ProjectiveMapping) -> float:
    """Of the camera above depth 0, m; inf where its place is not known."""
    if mapping.method == "homography":
        return np.inf
    return -float(np.linalg.solve(mapping.matrix[:, :3], -mapping.matrix[:, 3])[2])


def _usual_camera(mapping: ProjectiveMapping) -> float:
    """Impossible where a camera of free inner numbers comes out as none: pixels far from square or far from upright."""
    from scipy.linalg import rq

    inner = np.abs(rq(mapping.matrix[:, :3])[0])
    square, slant = inner[0, 0] / inner[1, 1], inner[0, 1] / inner[1, 1]
    return 0.0 if 0.4 < square < 2.5 and slant < 0.5 else IMPOSSIBLE


def _marks(file: RunFile, seen: Seen) -> dict[str, float]:
    """Distances, hand, heading, line and walls, by the marks in the film."""
    place, modes, lower = seen
    own = [i for i, m in enumerate(file.marker) if m.on == "model"]
    posts = [i for i, m in enumerate(file.marker) if m.on == "post"]
    body = np.array([file.marker[i].body_m for i in own], dtype=float)
    found = _distances(file, place[:, own], modes[:, :, own], lower[:, own], body)
    if file.tow is None or file.kind == "free":
        return found
    post = np.array(file.tow.post_m, dtype=float)
    if posts:
        stands = np.array([file.marker[i].body_m for i in posts], dtype=float) + post
        place = place - np.nanmean(place[:, posts] - stands, axis=1)[:, None]
    good = place[:, own]
    pose = fit_rigid(good, np.broadcast_to(np.eye(2), (*good.shape, 2)), body).pose
    pose = pose[np.isfinite(pose).all(axis=1)]
    if not len(pose):
        return found
    pulled = post - pose[:, :2] - tow_arm(pose[:, 2], file.tow)
    along = np.arctan2(np.abs(pulled[:, 1]), pulled[:, 0])
    found["heading"] = IMPOSSIBLE * bool(
        np.median(np.abs(np.arctan2(np.sin(pose[:, 2]), np.cos(pose[:, 2])))) > STEEPEST
    )
    found["ahead"] = IMPOSSIBLE * bool(np.median(along) > STEEPEST)
    if file.tow.line_length_m is not None:
        length, priors = file.tow.line_length_m, file.priors
        lens = np.sqrt((np.nanmean(modes, axis=(1, 2)) ** 2).sum()) if len(modes) else 0.0
        sag = DEPTH_M * np.sqrt(np.nanmean(lower**2))
        tape = np.hypot(max(PLACE_M, priors.line_length_sd_m), max(PLACE_M, priors.tow_point_sd_m))
        spread = np.sqrt(
            2 * tape**2
            + lens**2
            + sag**2
            + (SHARE * (length + abs(file.tow.tow_point_m or 0.0))) ** 2
            + file.tow.post_amplitude_m**2
        )
        found["line"] = float(abs(np.mean(np.hypot(*pulled.T)) - length) / spread)
    width = file.water.tank_width_m if file.water else None
    if width is not None:
        found["walls"] = IMPOSSIBLE * bool(np.median(np.abs(pose[:, 1])) > 0.55 * width)
    return found


def _places(file: RunFile, film: Film, mapping: ProjectiveMapping) -> Seen:
    """Marks in the tank (n, m, 2), the camera's modes (k, n, m, 2), their change with depth (n, m, 2)."""
    at, modes, lower = [], [], []
    for index, marker in enumerate(file.marker):
        places = mapping.to_tank(film.pixel_px[:, index], marker.depth_m)
        below = mapping.to_tank(film.pixel_px[:, index], marker.depth_m + DEPTH_M).xy_m
        at.append(places.xy_m)
        modes.append(places.modes_m)
        lower.append((below - places.xy_m) / DEPTH_M)
    return np.stack(at, 1), np.stack(modes, 2), np.stack(lower, 1)


def _distances(file: RunFile, place: Array, modes: Array, lower: Array, body: Array) -> dict[str, float]:
    """The worst pair's distance in tolerances, and whether three marks turn as they do on deck."""
    found = {"marks": 0.0}
    place_sd = max(PLACE_M, file.priors.marker_place_sd_m)
    depth_sd = max(DEPTH_M, file.priors.marker_depth_sd_m)
    for i, j in combinations(range(len(body)), 2):
        apart = place[:, i] - place[:, j]
        both = np.isfinite(apart).all(axis=1)
        if not both.any():
            continue
        apart = apart[both]
        size = np.hypot(*apart.T)
        unit = apart / np.maximum(size, 1e-9)[:, None]
        lens = np.einsum("knj,nj->kn", (modes[:, :, i] - modes[:, :, j])[:, both], unit).mean(axis=1)
        high = [np.einsum("nj,nj->n", lower[both, k], unit).mean() for k in (i, j)]
        stated = float(np.hypot(*(body[i] - body[j])))
        spread = np.sqrt(
            2 * place_sd**2 + (lens**2).sum() + depth_sd**2 * (high[0] ** 2 + high[1] ** 2) + (SHARE * stated) ** 2
        )
        found["marks"] = max(found["marks"], float(abs(size.mean() - stated) / spread))
    for i, j, k in combinations(range(len(body)), 3):
        deck = _turn(body[j] - body[i], body[k] - body[i])
        seen = _turn(place[:, j] - place[:, i], place[:, k] - place[:, i])
        seen = seen[np.isfinite(seen)]
        longest = max(np.hypot(*(body[a] - body[b])) for a, b in ((i, j), (i, k), (j, k)))
        if len(seen) and abs(deck) > ABSURD * place_sd * longest:
            found["hand"] = max(found.get("hand", 0.0), IMPOSSIBLE * bool(np.median(seen) * deck < 0))
    return found


def _turn(first: Array, second: Array) -> Array:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


__all__ = ["ABSURD", "IMPOSSIBLE", "ORDINARY", "WORDS", "Film", "Judge", "film_of"]
