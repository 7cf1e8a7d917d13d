"""The worst of a recording on one sheet: where marks were lost, and where they were placed least surely."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..record.errors import VideoError
from ..record.files import replacing
from ..record.tables import BY_HAND
from .overlay import COLOURS, plain, reasons_of, write_text
from .recording import Frame

Place = tuple[float, float]

TILES = 12
"""Of a sheet: three rows of COLUMNS."""
APART_S = 0.5
"""Two tiles of one marker and one kind are at least this far apart in time: neighbours tell the same."""
LOST_SHARE = 0.75
"""The ends of losses take no more of the sheet than this, so that something is seen of the sigmas."""
SCALE = 6
"""Enlargement of the crop, whole, so that pixels stay squares."""
CROP_PX = (49, 39)
"""Width and height of what a tile shows, px; odd, so that the mark's pixel lies in the middle."""
COLUMNS = 4
"""Tiles side by side: about 1200 px, a page's width."""
CAPTION_PX, GAP_PX, HEADER_PX, FOOTER_PX = 44, 12, 40, 30
"""Heights of a tile's caption, the sheet's title and its foot, and the gap between tiles."""
GROUND, TILE_GROUND, INK, FAINT_INK = (24, 24, 24), (44, 44, 44), (235, 235, 235), (165, 165, 165)
"""Colours, BGR: sheet, tile, letters, and what is said beside."""
LETTERS, SMALLEST_LETTERS = 0.5, 0.4
"""OpenCV's scale of the letters, and how small they may become to fit a line."""
NAME_LETTERS = 16
"""Of a marker's name; the rest of the line is what matters."""
SIGMAS = 3.0
"""The ellipse drawn about a measured place, in standard deviations; the sheet's foot says so."""
_SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates: sixteenths of a pixel."""


@dataclass(frozen=True)
class Pick:
    """A mark in a frame that is worth a look.

    Attributes
    ----------
    frame : its number in the recording
    t_s : its time
    marker : name
    lost : why it is lost ("" also where no reason is given), or None where it was measured
    place_px : (u, v) where it was measured, or, lost, where it may be by the frames around; None: it was never seen
    sigma_px : (of u, of v), None where lost
    ratio : the larger sigma over its usual value, nan where lost
    """

    frame: int
    t_s: float
    marker: str
    lost: str | None
    place_px: Place | None
    sigma_px: Place | None = None
    ratio: float = float("nan")

    @property
    def verdict(self) -> str:
        """What is the matter: "lost: covered", or "sigma 0.21 px (7.0 x usual)"."""
        if self.lost is not None:
            return f"lost: {self.lost}" if self.lost else "lost"
        sigma = max(self.sigma_px) if self.sigma_px is not None else float("nan")
        digits = 1 if self.ratio < 9.95 else 0
        return f"sigma {sigma:.2g} px ({self.ratio:.{digits}f} x usual)"


# which frames -------------------------------------------------------------------------------------------------------


def worst_frames(table: pd.DataFrame, count: int = TILES) -> list[Pick]:
    """Choose the frames that tell most about what went wrong.

    First every contiguous loss of one marker for one reason, the longest first, by its frame beside a measured one; then the
    other ends of those losses; then the largest sigmas over the marker's usual one, whatever their size.

    Parameters
    ----------
    table : tracks with ``frame, t_s, marker, u_px, v_px, sigma_u_px, sigma_v_px, status`` and perhaps ``reason``
    count : most picks

    Returns
    -------
    list : losses in the order of time, then sigmas, the largest first; fewer than ``count`` where there are no more
    """
    tracks = [_Track.of(str(name), rows) for name, rows in table.groupby("marker", sort=False)]
    spells = sorted(
        (spell for track in tracks for spell in track.spells()), key=lambda s: (-len(s), s.track.t_s[s.first])
    )
    lost = _apart((spell.pick(spell.telling) for spell in spells), count, [])
    room = min(count, max(len(lost), round(LOST_SHARE * count)))
    lost = _apart((spell.pick(spell.other) for spell in spells if len(spell) > 1), room, lost)
    unsure = sorted((pick for track in tracks for pick in track.unsure(count)), key=lambda p: -p.ratio)
    chosen = _apart(unsure, count, lost)
    return sorted(lost, key=lambda p: (p.t_s, p.marker)) + chosen[len(lost) :]


def _apart(picks: Iterable[Pick], count: int, before: Sequence[Pick]) -> list[Pick]:
    """``before`` and as many of ``picks`` after them as there is room for and as are far enough apart."""
    chosen = list(before)
    for pick in picks:
        if len(chosen) >= count:
            break
        near = [p for p in chosen if p.marker == pick.marker and p.lost == pick.lost]
        if all(abs(p.t_s - pick.t_s) >= APART_S for p in near):
            chosen.append(pick)
    return chosen


@dataclass(frozen=True)
class _Track:
    """One marker's rows as arrays of n: frame, t_s, place (n, 2) and sigma (n, 2) px (NaN: lost), lost, reason, set by hand."""

    name: str
    frame: NDArray[np.int64]
    t_s: NDArray[np.float64]
    place: NDArray[np.float64]
    sigma: NDArray[np.float64]
    lost: NDArray[np.bool_]
    reason: NDArray[np.object_]
    by_hand: NDArray[np.bool_]

    @classmethod
    def of(cls, name: str, rows: pd.DataFrame) -> _Track:
        rows = rows.sort_values("t_s", kind="stable")
        lost = (rows["status"] == "lost").to_numpy()
        place, sigma = (
            np.where(lost[:, None], np.nan, rows[columns].to_numpy(dtype=float))
            for columns in (["u_px", "v_px"], ["sigma_u_px", "sigma_v_px"])
        )
        frame, t_s = rows["frame"].to_numpy().astype(np.int64), rows["t_s"].to_numpy(dtype=float)
        by_hand = (rows["status"] == BY_HAND).to_numpy()
        return cls(name, frame, t_s, place, sigma, lost, reasons_of(rows), by_hand)

    def spells(self) -> Iterator[_Spell]:
        """The contiguous losses, each for one reason."""
        changes = (self.lost[1:] != self.lost[:-1]) | (self.reason[1:] != self.reason[:-1])
        edges = [0, *(np.flatnonzero(changes) + 1), len(self.lost)]
        for first, end in pairwise(edges):
            if end > first and self.lost[first]:
                yield _Spell(self, int(first), int(end) - 1)

    def place_at(self, row: int) -> Place | None:
        """Measured, or interpolated in time between the measured places around; beyond the last one, that one."""
        t_s, u, v = self._seen
        if not len(t_s):
            return None
        return float(np.interp(self.t_s[row], t_s, u)), float(np.interp(self.t_s[row], t_s, v))

    @cached_property
    def _seen(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Times and places (u, v) of the rows that have one."""
        seen = np.isfinite(self.place).all(axis=1)
        return self.t_s[seen], self.place[seen, 0].copy(), self.place[seen, 1].copy()

    def unsure(self, count: int) -> list[Pick]:
        """The ``count`` measured rows of the largest sigma that are apart from each other, the largest first; none set by hand."""
        larger = self.sigma.max(axis=1)
        known = np.flatnonzero(np.isfinite(larger) & (larger > 0) & ~self.by_hand)
        if not len(known):
            return []
        ratio = larger / np.median(larger[known])
        order = known[np.argsort(-ratio[known], kind="stable")]
        return _apart((self._unsure(int(row), float(ratio[row])) for row in order), count, [])

    def _unsure(self, row: int, ratio: float) -> Pick:
        sigma = float(self.sigma[row, 0]), float(self.sigma[row, 1])
        place = self.place_at(row)
        return Pick(int(self.frame[row]), float(self.t_s[row]), self.name, None, place, sigma, ratio)


@dataclass(frozen=True)
class _Spell:
    """A contiguous loss: rows ``first`` to ``last`` of a track."""

    track: _Track
    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first + 1

    @property
    def telling(self) -> int:
        """The row to look at: the first, or the last where the mark had not been seen before."""
        return self.first if not self.track.lost[: self.first].all() else self.last

    @property
    def other(self) -> int:
        """The other end."""
        return self.last if self.telling == self.first else self.first

    def pick(self, row: int) -> Pick:
        track = self.track
        return Pick(
            int(track.frame[row]), float(track.t_s[row]), track.name, str(track.reason[row]), track.place_at(row)
        )


# the picture --------------------------------------------------------------------------------------------------------


def draw_sheet(
    frames: Iterable[Frame], table: pd.DataFrame, picks: Sequence[Pick], title: str = ""
) -> NDArray[np.uint8]:
    """Draw one magnified tile for each pick; see ``Sheet``.

    Parameters
    ----------
    frames : of the recording; read as far as the last pick
    table : tracks: the order of its markers gives the colours
    picks : what the tiles show
    title : at the head

    Returns
    -------
    (h, w, 3) BGR
    """
    sheet = Sheet(table, picks, title)
    for frame in frames:
        if sheet.look(frame):
            break
    return sheet.picture()


def write_sheet(path: str | Path, picture: NDArray[np.uint8]) -> None:
    """Write the sheet as a PNG, whole or not at all.

    Parameters
    ----------
    path : of the file
    picture : (h, w, 3) uint8, BGR
    """
    import cv2

    done, data = cv2.imencode(".png", picture)
    if not done:
        raise VideoError(f"{path}: the sheet cannot be encoded")
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())


class Sheet:
    """Tiles that fill while the recording is played; only what they show of a frame is kept.

    Parameters
    ----------
    table : tracks: the order of its markers gives the colours, as in the overlay
    picks : what to show, in the order of the tiles
    title : written above
    """

    def __init__(self, table: pd.DataFrame, picks: Sequence[Pick], title: str = "") -> None:
        names = [str(name) for name in pd.unique(table["marker"])]
        self._colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}
        self._picks, self._title = list(picks), title
        self._tiles: dict[int, NDArray[np.uint8]] = {}
        self._at: dict[int, list[int]] = {}
        for k, pick in enumerate(self._picks):
            self._at.setdefault(pick.frame, []).append(k)

    def look(self, frame: Frame) -> bool:
        """Take from a frame what the sheet shows of it; True once nothing more is needed."""
        wanted = self._at.pop(frame.index, None)
        if wanted:
            picture = frame.bgr()
            for k in wanted:
                pick = self._picks[k]
                self._tiles[k] = _tile(picture, pick, self._colours.get(pick.marker, INK))
        return not self._at

    def picture(self) -> NDArray[np.uint8]:
        """The sheet so far, (h, w, 3) BGR; a tile whose frame was not seen says so."""
        wide, tall = CROP_PX[0] * SCALE, CROP_PX[1] * SCALE
        columns = max(1, min(COLUMNS, len(self._picks)))
        rows = -(-len(self._picks) // columns)
        step_x, step_y = wide + GAP_PX, tall + CAPTION_PX + GAP_PX
        width = max(GAP_PX + columns * step_x, 2 * step_x)
        canvas = np.full((HEADER_PX + rows * step_y + FOOTER_PX, width, 3), GROUND, np.uint8)
        _line(canvas, self._title or "worst frames", (GAP_PX, 26), INK, 0.6, width - 2 * GAP_PX)
        for k, pick in enumerate(self._picks):
            left, top = GAP_PX + (k % columns) * step_x, HEADER_PX + (k // columns) * step_y
            tile = self._tiles.get(k)
            if tile is None:
                tile = _empty_tile("frame not decoded")
            canvas[top : top + tall, left : left + wide] = tile
            _caption(canvas, pick, self._colours.get(pick.marker, INK), (left, top + tall), wide)
        foot = (
            f"{SCALE} x. Cross: measured. Ellipse: 3 sigma. Corners: lost, may be here"
            if self._picks
            else "no mark is lost and none has a sigma"
        )
        _line(canvas, foot, (GAP_PX, canvas.shape[0] - 12), FAINT_INK, LETTERS, width - 2 * GAP_PX)
        return canvas


def _caption(
    canvas: NDArray[np.uint8], pick: Pick, colour: tuple[int, int, int], corner: tuple[int, int], wide: int
) -> None:
    left, top = corner
    canvas[top : top + CAPTION_PX, left : left + wide] = TILE_GROUND
    canvas[top : top + CAPTION_PX, left : left + 4] = colour
    room = wide - 16
    name = pick.marker if len(pick.marker) <= NAME_LETTERS else pick.marker[: NAME_LETTERS - 3] + "..."
    _line(canvas, f"{name}  {pick.verdict}", (left + 11, top + 18), INK, LETTERS, room)
    _line(canvas, f"frame {pick.frame},  t = {pick.t_s:.2f} s", (left + 11, top + 37), FAINT_INK, LETTERS, room)


def _line(
    canvas: NDArray[np.uint8], text: str, corner: tuple[int, int], ink: tuple[int, int, int], size: float, room: int
) -> None:
    """One line of text, smaller or cut short where it would run out of its ``room``, px."""
    text = plain(text)
    while size > SMALLEST_LETTERS and _width(text, size) > room:
        size -= 0.02
    while len(text) > 4 and _width(text, size) > room:
        text = text[:-4] + "..."
    write_text(canvas, text, corner, ink, size)


def _width(text: str, size: float) -> int:
    import cv2

    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0]


def _tile(picture: NDArray[np.uint8], pick: Pick, colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    """A pick's surroundings, magnified, with what was measured."""
    if pick.place_px is None:
        return _whole(picture)
    corner, tile = _magnified(picture, pick.place_px)
    centre = tuple(SCALE * (place - first + 0.5) - 0.5 for place, first in zip(pick.place_px, corner, strict=True))
    if pick.lost is not None:
        _corners(tile, centre)
    else:
        _cross(tile, centre, colour)
        if pick.sigma_px is not None and SIGMAS * max(pick.sigma_px) > 1:
            _ellipse(tile, centre, pick.sigma_px, colour)
    return tile


def _magnified(picture: NDArray[np.uint8], place: Place) -> tuple[tuple[int, int], NDArray[np.uint8]]:
    """The first pixel (u, v) shown and the tile about ``place``: nearest neighbour; ground where the picture ends."""
    wide, tall = CROP_PX
    height, width = picture.shape[:2]
    u0, v0 = round(place[0]) - wide // 2, round(place[1]) - tall // 2
    crop = np.full((tall, wide, 3), TILE_GROUND, np.uint8)
    left, right, top, bottom = max(u0, 0), min(u0 + wide, width), max(v0, 0), min(v0 + tall, height)
    if right > left and bottom > top:
        crop[top - v0 : bottom - v0, left - u0 : right - u0] = picture[top:bottom, left:right]
    return (u0, v0), np.repeat(np.repeat(crop, SCALE, axis=0), SCALE, axis=1)


def _fixed(*values: float) -> tuple[int, ...]:
    return tuple(round(value * (1 << _SHIFT)) for value in values)


def _cross(tile: NDArray[np.uint8], centre: tuple[float, ...], colour: tuple[int, int, int]) -> None:
    """A thin circle with four ticks, and a small cross at the place; between them the mark itself stays to be seen."""
    import cv2

    u, v = centre
    for ink, thick in (((0, 0, 0), 3), (colour, 1)):
        cv2.circle(tile, _fixed(u, v), _fixed(10 * SCALE)[0], ink, thick, cv2.LINE_AA, _SHIFT)
        for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            near, far = (_fixed(u + r * SCALE * du, v + r * SCALE * dv) for r in (6.5, 10))
            cv2.line(tile, near, far, ink, thick, cv2.LINE_AA, _SHIFT)
    for du, dv in ((0.75 * SCALE, 0), (0, 0.75 * SCALE)):
        cv2.line(tile, _fixed(u - du, v - dv), _fixed(u + du, v + dv), colour, 1, cv2.LINE_AA, _SHIFT)


def _ellipse(tile: NDArray[np.uint8], centre: tuple[float, ...], sigma: Place, colour: tuple[int, int, int]) -> None:
    import cv2

    axes = _fixed(SIGMAS * SCALE * sigma[0], SIGMAS * SCALE * sigma[1])
    for ink, thick in (((0, 0, 0), 3), (colour, 1)):
        cv2.ellipse(tile, _fixed(*centre), axes, 0, 0, 360, ink, thick, cv2.LINE_AA, _SHIFT)


def _corners(tile: NDArray[np.uint8], centre: tuple[float, ...]) -> None:
    """Four corners about where a lost mark may be: nothing was measured there."""
    import cv2

    u, v = centre
    reach, arm = 10 * SCALE, 3 * SCALE
    for ink, thick in (((0, 0, 0), 3), (INK, 1)):
        for side_u in (-1, 1):
            for side_v in (-1, 1):
                tip = u + side_u * reach, v + side_v * reach
                cv2.line(tile, _fixed(*tip), _fixed(tip[0] - side_u * arm, tip[1]), ink, thick, cv2.LINE_AA, _SHIFT)
                cv2.line(tile, _fixed(*tip), _fixed(tip[0], tip[1] - side_v * arm), ink, thick, cv2.LINE_AA, _SHIFT)


def _whole(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The whole frame, made to fit: nobody knows where the mark may be."""
    import cv2

    tile = _empty_tile("")
    tall, wide = tile.shape[:2]
    scale = min(wide / picture.shape[1], tall / picture.shape[0])
    size = max(1, int(picture.shape[1] * scale)), max(1, int(picture.shape[0] * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    left, top = (wide - size[0]) // 2, (tall - size[1]) // 2
    tile[top : top + size[1], left : left + size[0]] = small
    write_text(tile, "never seen: the whole frame", (10, tall - 10), INK, LETTERS)
    return tile


def _empty_tile(text: str) -> NDArray[np.uint8]:
    tile = np.full((CROP_PX[1] * SCALE, CROP_PX[0] * SCALE, 3), TILE_GROUND, np.uint8)
    write_text(tile, text, (10, tile.shape[0] // 2), FAINT_INK, LETTERS)
    return tile
