"""Datum points found by what they are: a printed tag's corner, a chessboard's inner corner, a dot or cross near the rough pick.

Several frames are averaged while the camera stands still. What is noise of its own in every frame falls with their number; texture
of the ground, the print and the error of a codec, past or present, repeat in all of them. How much does not fall shows in the mean
of the frames: the points are found in that too, and its fit's sigma is that of the part that stays. Where the frames' places
scatter by more than the fits say, their scatter is believed. In pictures compressed with loss, and for what repeats in others, the
error is larger than what is left of the fit shows: ``CODEC_FACTOR`` times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from ..geometry.camera import Lens
from ..geometry.lens.boards import Board, find_board
from ..record.errors import InputError
from ..record.looks import DATUM_LOOKS, Look, look_of, register_look
from ..record.registry import Registry
from ..record.schema import DatumPoint
from ..record.tags import tag_name
from .fiducial import FiducialFollower
from .symmetry import centre_of_symmetry
from .tag_fit import Tag
from .tag_squares import tag_cells
from .tag_view import homography

Array = NDArray[Any]

SEARCH_PX = 12.0
"""A mark is looked for this far from its rough pick."""
NEARER_PX = 5.0
"""Of several spots the clear ones win, and the near ones: response times exp(-(distance/this)^2)."""
SURROUNDINGS_PX = 30.0
"""The cut-out goes so much farther than the search: as far as the largest window of a mark."""
SCALES_PX = (1.2, 1.7, 2.4, 3.4, 4.8, 6.8, 9.6)
"""A disc of radius r stands out most at r / sqrt(2)."""
LEAST_RESPONSE_DN, MOST_BLOBS = 6.0, 6
"""Of the Laplacian's response, so that noise is no spot; and how many of the best spots are tried. Choices."""
MARK_SCALES = 2.6
"""Radius of a mark's window over its scale: 1.8 radii of a disc."""
MARK_RADIUS_PX = (4.0, 30.0)
"""Smallest and largest radius of a mark's window: a choice."""
CORNER_SHARE = 0.45
"""Radius of a chessboard corner's window over the distance of its nearest neighbour."""
CORNER_RADIUS_PX = (3.0, 10.0)
"""Smallest and largest radius of a chessboard corner's window: a choice."""
MOVED_PX = 0.1
"""Points that go together by more than this: the camera moved."""
BY_CHANCE = 0.01
"""A scatter over the frames that the fits' sigmas let expect more rarely than this is believed instead of them."""
CODEC_FACTOR = 2.0
"""A fit's error over its sigma where what is left of the picture repeats in all frames: 1.4-2.3 for dots and crosses at H.264 crf
18-28, 1.4 on ground with texture."""
SURE_SHARE = 1.3
"""Something repeats where the variance of a fit to the frames' mean is beyond this many times the single frames' over their number:
some hundred pixels, half of them by symmetry the other half's, know it to a quarter."""
LEAST_SIGMA_PX = 1e-3
"""No point is stated to be better known than this, a thousandth of a pixel."""
NOT_FOUND, SEVERAL_SHAPES = "not found", "no symmetric mark near pixel_px"


@dataclass(frozen=True)
class FoundPoint:
    """A datum point, found.

    Attributes
    ----------
    name, look : of run.toml
    pixel_px : (2,), NaN where it was not found
    sigma_px : standard deviation along u and along v (root mean square of the two)
    frames : how many it was found in and averaged over
    reason : "" = found; else why not
    """

    name: str
    look: str
    pixel_px: Array
    sigma_px: float
    frames: int
    reason: str = ""


@dataclass(frozen=True)
class FoundDatum:
    """All of them.

    Attributes
    ----------
    points : one per datum point, None where run.toml gives it no look
    moved : the camera did not stand still; the first frame alone was used
    """

    points: tuple[FoundPoint | None, ...]
    moved: bool


class Finder(Protocol):
    """What finds datum points of some looks in the first frames that are analysed.

    Attributes
    ----------
    reason : why a point that it does not find is not found
    exact : it takes pictures of float, too: the mean of the frames is not rounded for it. May be absent: no
    """

    reason: str

    def look(self, number: int, luma: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Places and sigmas (n, 2) px of its points in the next frame, luma (h, w); NaN where one is not found."""
        ...


Begin = Callable[[Sequence[DatumPoint], float, Lens | None], Finder]
"""(points of these looks, luma of white, lens) -> what finds them."""
BeginT = TypeVar("BeginT", bound=Begin)
FINDERS: Registry[Begin] = Registry()
"""By the name of the look."""


def register_finder(*looks: Look | str) -> Callable[[BeginT], BeginT]:
    """Say what finds the datum points of some looks; as ``looks.register_tracker`` for marks."""

    def registered(begin: BeginT) -> BeginT:
        for look in looks:
            if isinstance(look, Look):
                register_look(look, DATUM_LOOKS)
            FINDERS.add(look.name if isinstance(look, Look) else look, begin)
        return begin

    return registered


def _begin_of(value: str) -> Begin:
    look = look_of(value, DATUM_LOOKS)
    begin = None if look is None else FINDERS.get(look.name)
    if begin is None:
        raise InputError("run.toml", "datum.look", f"{value!r}: nothing that finds it is registered")
    return begin


def find_datum(
    points: Sequence[DatumPoint],
    frames: Sequence[NDArray[np.uint8]],
    lens: Lens | None = None,
    white_dn: float = 255.0,
    lossy: bool = False,
) -> FoundDatum:
    """Find the datum points that have a ``look``.

    Parameters
    ----------
    points : of run.toml; ``pixel_px`` is the rough pick
    frames : luma (h, w), the first ones that are analysed
    lens : of the camera
    white_dn : largest value of a pixel; such pixels may truly be brighter
    lossy : the video was compressed with loss

    Raises
    ------
    InputError : a look that no picture can answer (a chessboard corner outside its board, a tag in no family)
    """
    wanted = {k: point.look for k, point in enumerate(points) if point.look is not None}
    place = np.full((len(frames), len(points), 2), np.nan)
    sigma = np.full((len(frames), len(points), 2), np.nan)
    kept = np.full((len(points), 2), np.nan)
    mean: Any = np.mean(frames, axis=0, dtype=np.float32) if len(frames) > 1 else None
    reason = dict.fromkeys(wanted, NOT_FOUND)
    begun = {k: _begin_of(look) for k, look in wanted.items()}
    for begin in dict.fromkeys(FINDERS.here()):
        these = [k for k in wanted if begun[k] is begin]
        if not these:
            continue
        finder = begin([points[k] for k in these], white_dn, lens)
        reason |= dict.fromkeys(these, finder.reason)
        for number, luma in enumerate(frames):
            place[number, these], sigma[number, these] = finder.look(number, luma)
        if mean is not None:
            shown = mean if getattr(finder, "exact", False) else np.rint(mean).astype(np.uint8)
            kept[these] = finder.look(len(frames), shown)[1]
    moved = _camera_moved(place)
    if moved:
        place, sigma = place[:1], sigma[:1]
    found: list[FoundPoint | None] = [None] * len(points)
    for k, look in wanted.items():
        name = points[k].name or f"point {k + 1}"
        nowhere = FoundPoint(name, look, np.full(2, np.nan), np.nan, 0)
        found[k] = _averaged(nowhere, place[:, k], sigma[:, k], kept[k], lossy)
        if not found[k].frames:  # pyright: ignore[reportOptionalMemberAccess]
            found[k] = FoundPoint(name, look, np.full(2, np.nan), np.nan, 0, reason[k])
    return FoundDatum(tuple(found), moved)


def _averaged(point: FoundPoint, place: Array, sigma: Array, kept: Array, lossy: bool) -> FoundPoint:
    """The mean of a point's places, with its sigma; ``kept`` is that of the fit to the frames' mean."""
    good = np.isfinite(place).all(axis=1)
    count = int(good.sum())
    if not count:
        return point
    place, fitted = place[good], float((sigma[good] ** 2).mean())
    middle = place.mean(axis=0)
    freedom = 2 * (count - 1)
    scatter = float(((place - middle) ** 2).sum() / freedom) if freedom else 0.0
    beyond = freedom > 0 and scatter * freedom > fitted * chdtri(freedom, BY_CHANCE)
    falls = (scatter if beyond else fitted) / count
    # without a fit to the mean picture nothing is known to average
    whole = fitted if count == 1 or not np.isfinite(kept).all() else float((kept**2).mean())
    if lossy:
        variance = CODEC_FACTOR**2 * max(whole, falls)
    else:
        stays = max(whole - SURE_SHARE * fitted / count, 0.0) if count > 1 else 0.0
        variance = falls + CODEC_FACTOR**2 * stays
    return replace(point, pixel_px=middle, sigma_px=max(float(np.sqrt(variance)), LEAST_SIGMA_PX), frames=count)


def _camera_moved(place: Array) -> bool:
    """The points go together, by the median of those seen in a frame and in the first."""
    if len(place) < 2:
        return False
    with np.errstate(invalid="ignore"):
        gap = place[1:] - place[:1]
    seen: Array = np.asarray(np.isfinite(gap).all(axis=2))
    return any(np.hypot(*np.median(gap[n][seen[n]], axis=0)) > MOVED_PX for n in range(len(gap)) if seen[n].sum() >= 2)


def _whole(luma: Array) -> NDArray[np.uint8]:
    """A picture in whole grey values, for what OpenCV looks for."""
    return luma if luma.dtype == np.uint8 else np.rint(luma).astype(np.uint8)


# marks --------------------------------------------------------------------------------------------------------------


@register_finder("mark")
class _Marks:
    """Dots and crosses near their rough picks."""

    reason, exact = SEVERAL_SHAPES, True

    def __init__(self, points: Sequence[DatumPoint], *_: object) -> None:
        self._near = [np.array(point.pixel_px, dtype=float) for point in points]

    def look(self, number: int, luma: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Places and sigmas (n, 2) in the next frame."""
        place, sigma = zip(*(_mark(luma, near) for near in self._near), strict=True)
        return np.array(place), np.array(sigma)


def _mark(luma: NDArray[np.uint8], near_px: Array) -> tuple[Array, Array]:
    """The bright or dark mark near a rough pick: place and sigma (2,), NaN where there is none."""
    for start, radius in _blobs(luma, near_px):
        found = centre_of_symmetry(luma, start, radius)
        if found is not None and np.hypot(*(found.centre_px - near_px)) < SEARCH_PX:
            return found.centre_px, found.sigma_px
    return np.full(2, np.nan), np.full(2, np.nan)


def _blobs(luma: NDArray[np.uint8], near_px: Array) -> list[tuple[Array, float]]:
    """Places and window radii of what could be a mark, the likeliest first: extremes over place and scale of s^2 times the
    Laplacian of the picture smoothed by s. A mark that a string passes through is one too; an outline would take in the string."""
    from scipy.ndimage import gaussian_laplace, maximum_filter

    reach = int(SEARCH_PX + SURROUNDINGS_PX)
    low = np.maximum(np.rint(near_px).astype(int) - reach, 0)
    part = luma[low[1] : low[1] + 2 * reach + 1, low[0] : low[0] + 2 * reach + 1].astype(float)
    if min(part.shape, default=0) < 2 * MARK_RADIUS_PX[0]:
        return []
    found = []
    bright = np.stack([-(s**2) * np.asarray(gaussian_laplace(part, s)) for s in SCALES_PX])
    for response in (bright, -bright):
        peak = (response == maximum_filter(response, (3, 3, 3))) & (response > LEAST_RESPONSE_DN)
        for scale, row, column in np.argwhere(peak):
            place = np.array([column, row]) + low
            away = float(np.hypot(*(place - near_px)))
            if away < SEARCH_PX:
                score = response[scale, row, column] * np.exp(-((away / NEARER_PX) ** 2))
                radius = float(np.clip(MARK_SCALES * SCALES_PX[scale], *MARK_RADIUS_PX))
                found.append((float(score), place.astype(float), radius))
    found.sort(key=lambda blob: -blob[0])
    return [(place, radius) for _, place, radius in found[:MOST_BLOBS]]


# tags ---------------------------------------------------------------------------------------------------------------


@register_finder("aruco:N:CORNER", "apriltag:N:CORNER", "aruco:DICTIONARY:N:CORNER", "apriltag:DICTIONARY:N:CORNER")
class _Tags:
    """The corners of printed tags, given as looks such as "aruco:7:2"."""

    reason, exact = NOT_FOUND, True

    def __init__(self, points: Sequence[DatumPoint], white_dn: float, lens: Lens | None) -> None:
        looks = [str(point.look) for point in points]
        self.corner = [int(look.rsplit(":", 1)[1]) for look in looks]
        self.tag = [look.rsplit(":", 1)[0] for look in looks]
        self._names = list(dict.fromkeys(self.tag))
        try:
            self._follower = FiducialFollower(self._names, white_dn, lens)
        except ValueError as error:
            raise InputError("run.toml", "datum.look", str(error)) from None
        self._make = lambda cells: Tag(cells, white_dn, lens)
        self._fits: dict[str, Tag] = {}

    def look(self, number: int, luma: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Places and sigmas (n, 2) of the corners in the next frame."""
        seen = dict(zip(self._names, self._follower.step(number, float(number), _whole(luma)), strict=True))
        place, sigma = np.full((len(self.tag), 2), np.nan), np.full((len(self.tag), 2), np.nan)
        for name, tag in seen.items():
            if tag.reason:
                continue
            fit = self._tag(name).fit(luma, homography(tag.corners_px))
            if fit is None or not fit.whole:
                continue
            for k in (k for k, other in enumerate(self.tag) if other == name):
                place[k], sigma[k] = fit.corners_px[self.corner[k]], fit.corner_sigma_px[self.corner[k]]
        return place, sigma

    def _tag(self, name: str) -> Tag:
        if name not in self._fits:
            tag = tag_name(name)
            family = self._follower.families[tag.group]
            assert family is not None
            self._fits[name] = self._make(tag_cells(family, [tag.number])[0])
        return self._fits[name]


# chessboards --------------------------------------------------------------------------------------------------------


@register_finder("checker:COLSxROWS:I,J")
class _Boards:
    """Inner corners of chessboards, told apart by their sizes."""

    reason, exact = NOT_FOUND, True

    def __init__(self, points: Sequence[DatumPoint], *_: object) -> None:
        self._points = points
        self._sizes = [str(point.look).split(":")[1] for point in points]

    def look(self, number: int, luma: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Places and sigmas (n, 2) in the next frame."""
        place, sigma = np.full((len(self._points), 2), np.nan), np.full((len(self._points), 2), np.nan)
        for size in dict.fromkeys(self._sizes):
            these = [k for k, other in enumerate(self._sizes) if other == size]
            place[these], sigma[these] = _board(luma, size, [self._points[k] for k in these])
        return place, sigma


def _board(luma: NDArray[np.uint8], size: str, points: Sequence[DatumPoint]) -> tuple[Array, Array]:
    """Places and sigmas (n, 2) of inner corners; which end of the board is which, the rough picks say."""
    columns, rows = (int(part) for part in size.split("x"))
    index = np.array([[int(c) for c in str(p.look).rsplit(":", 1)[1].split(",")] for p in points])
    if (index >= [columns, rows]).any():
        i, j = index[(index >= [columns, rows]).any(axis=1)][0]
        raise InputError(
            "run.toml", "datum.look", f"checker:{size}:{i},{j} names a corner that the board does not have"
        )
    place, sigma = np.full((len(points), 2), np.nan), np.full((len(points), 2), np.nan)
    view = find_board(_whole(luma), Board(columns, rows, 1.0))
    if view is None:
        return place, sigma
    grid = view.pixel_px.reshape(rows, columns, 2)
    rough = np.array([p.pixel_px for p in points], dtype=float)
    turns = [grid, grid[::-1, ::-1]]
    if columns == rows:
        turns += [np.rot90(grid), np.rot90(grid, 3)]
    grid = min(turns, key=lambda g: float(((g[index[:, 1], index[:, 0]] - rough) ** 2).sum()))
    for k, (i, j) in enumerate(index):
        near = [
            grid[b, a]
            for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
            if 0 <= a < columns and 0 <= b < rows
        ]
        apart = min(float(np.hypot(*(other - grid[j, i]))) for other in near)
        found = centre_of_symmetry(luma, grid[j, i], float(np.clip(CORNER_SHARE * apart, *CORNER_RADIUS_PX)))
        if found is not None:
            place[k], sigma[k] = found.centre_px, found.sigma_px
    return place, sigma
