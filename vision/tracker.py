"""Follow the marks through a recording: acquisition on the whole frame, then a predicted window per marker.

Windows are cut frame by frame (``live``) and fitted a stretch at a time (``refine``); what the fits say of the end of a
stretch is where the next one begins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..geometry.mapping import Mapping
from ..record.errors import InputError, TrackingError
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .backend import NUMPY, Backend
from .candidates import Array, Candidates, find_candidates, with_tint
from .datum_marks import DatumMarks
from .decode import Frame
from .identity import DISTANCE_SD_M, DISTANCE_SD_SHARE, SEEN_SD_PX, TINTS, Assignment, assign
from .live import LiveMark
from .refine import SHAPE_LIMIT, Refiner, Stack
from .scatter import with_scatter

STRETCH_FRAMES = 64
"""Frames fitted together; a window of 31 x 31 pixels is kept of each."""
PROBATION_FRAMES = 8
"""A set of spots that loses one of its members within this many frames was not the set of marks."""
JUMP_PX = 3.0
"""Largest surprise of a spot's place beyond four standard deviations of the prediction."""
JUMP_SD = 4.0
BRIGHTNESS_RANGE = (0.4, 2.5)
COMMON_SPREAD, SAME_SPREAD = 1.5, 1.12
"""Marks whose brightness changes by factors this close to each other saw a change of exposure."""
WIDTH_RANGE = (0.55, 1.8)
COVERED_RANGE = (0.8, 1.25)
"""Motion blur spreads a mark's light and leaves its sum; a spot that looks odd and lacks light is partly covered."""
LARGEST_SIGMA_PX = 0.5
REFERENCE_FRAMES = 16
DISTANCE_MEMORY = 0.3
DOUBT_FRAMES = 4
"""What does not look like the mark for so many frames is judged at once."""
REACQUIRE_FRAMES = 10
SEARCH_SOON = (2, 5)
KNOCK_PX, KNOCK_PX_S = 30.0, 100.0
"""A mark that is lost is looked for on the whole frame, about where it was seen last: a knocked camera, and its own way since."""
SEEN_FRAMES = 10
DISTANCE_GATE = 6.0
ACQUIRE_WIDTHS_PX = (2.0, 4.0, 7.0)
"""Spot widths tried one after the other while nothing is known."""
ACQUIRE_EVERY_FRAME = 20
"""While nothing has been found: every frame at first, then ..."""
ACQUIRE_STRIDE = 15
STATIC_PX = 1.0
MOVED_PX = 8.0
"""A spot that stands while the marks move this far is a lamp or a glare, and never a mark."""


@dataclass(frozen=True)
class Tracking:
    """Tracks of a recording.

    Attributes
    ----------
    table : tracks.csv, with a column ``reason`` (why lost)
    frames : frames looked at
    measured : marker -> frames measured
    reasons : marker -> reason -> frames lost
    ambiguous : at some acquisition another assignment of spots to markers was nearly as good
    datum : datum points with ``track = true`` as in ``table``, by the point's name; None without one
    """

    table: pd.DataFrame
    frames: int
    measured: dict[str, int]
    reasons: dict[str, dict[str, int]]
    ambiguous: bool
    datum: pd.DataFrame | None = None


class Follower(Protocol):
    """What follows some markers of a run through its frames."""

    losses: int
    ambiguous: bool

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        ...

    def finish(self) -> pd.DataFrame:
        """Rows of tracks.csv with a reason, frame by frame; TrackingError where the marks were never found."""
        ...


def track(
    run: Run,
    frames: Iterable[Frame],
    mapping: Mapping,
    progress: Callable[[int, int], None] | None = None,
    backend: Backend = NUMPY,
    lossy: bool = True,
) -> Tracking:
    """Track the markers of ``run`` through ``frames``.

    Parameters
    ----------
    mapping : pixel -> tank of the run's datum
    progress : called with frames done and losses so far
    backend : where the fits run
    lossy : the recording was compressed with loss

    Raises
    ------
    TrackingError : the marks were never found
    """
    followers = _followers(run, mapping, backend)
    fixed = DatumMarks(run)
    count = 0
    for frame in frames:
        if fixed.points:
            fixed.step(frame)
        for follower in followers:
            follower.step(frame)
        count += 1
        if progress is not None:
            progress(count, sum(f.losses for f in followers))
    if not count:
        raise TrackingError(f"{run.source_path}: no frame lies within source.span_s")
    table = _merged([f.finish() for f in followers], [m.name for m in run.file.marker])
    table = with_scatter(table, run.file.marker, mapping, lossy)
    return _tracking(table, run, count, any(f.ambiguous for f in followers), fixed.finish())


def _followers(run: Run, mapping: Mapping, backend: Backend) -> list[Follower]:
    """One for all lights and discs, one for all fiducials, one for each template."""
    from .patch_follower import FiducialMarks, TemplateMark

    spots = tuple(m for m in run.file.marker if m.look in ("led", "disc"))
    tags = tuple(m for m in run.file.marker if ":" in m.look)
    patches = [m for m in run.file.marker if m.look == "template"]
    if len(spots) == 1:
        raise InputError(
            run.folder / RUN_FILE,
            f"marker {spots[0].name!r}.look",
            f"{spots[0].look!r} alone: which spot it is shows only beside a second led or disc",
        )
    found: list[Follower] = [SpotFollower(run, spots, mapping, backend)] if spots else []
    if tags:
        found.append(FiducialMarks(run, tags))
    return [*found, *(TemplateMark(run, marker) for marker in patches)]


def _merged(tables: list[pd.DataFrame], names: list[str]) -> pd.DataFrame:
    """One table, the rows of a frame together in run.toml's order."""
    if len(tables) == 1:
        return tables[0]
    table = pd.concat(tables, ignore_index=True)
    table["order"] = table["marker"].map({name: at for at, name in enumerate(names)})
    return table.sort_values(["frame", "order"]).drop(columns="order").reset_index(drop=True)


def _tracking(table: pd.DataFrame, run: Run, frames: int, ambiguous: bool, datum: pd.DataFrame | None) -> Tracking:
    seen = table["status"] == "measured"
    measured = {m.name: int(((table["marker"] == m.name) & seen).sum()) for m in run.file.marker}
    reasons = {
        str(name): {str(k): int(v) for k, v in rows["reason"].value_counts().items()}
        for name, rows in table[~seen].groupby("marker")
    }
    return Tracking(table, frames, measured, reasons, ambiguous, datum)


class _Mark:
    """One marker while it is followed."""

    def __init__(self, live: LiveMark, refiner: Refiner) -> None:
        self.live, self.refiner = live, refiner
        self.replay = live.filter.copy()
        self.brightness_dn = live.rise_dn
        self.lost = 0


class _Stretch:
    """Windows of all markers over some frames, in arrays of fixed size."""

    def __init__(self, markers: int) -> None:
        self.markers = markers
        self.frames: list[tuple[int, float, bool]] = []
        self.windows: list[list[tuple[int, NDArray[np.uint8], tuple[int, int], tuple[float, float], float]]] = [
            [] for _ in range(markers)
        ]

    def __len__(self) -> int:
        return len(self.frames)

    def clear(self) -> None:
        self.__init__(self.markers)

    def keep(self, marker: int, luma: NDArray[np.uint8], u: float, v: float, half: int, reach: float) -> None:
        """Store one marker's window about ``u, v`` for the frame added last."""
        height, width = luma.shape
        u0, v0, side = round(u) - half, round(v) - half, 2 * half + 1
        if u0 >= 0 and v0 >= 0 and u0 + side <= width and v0 + side <= height:
            cut = luma[v0 : v0 + side, u0 : u0 + side].copy()
        else:
            cut = np.zeros((side, side), np.uint8)
            a, b = slice(max(u0, 0), min(u0 + side, width)), slice(max(v0, 0), min(v0 + side, height))
            if a.stop > a.start and b.stop > b.start:
                cut[b.start - v0 : b.stop - v0, a.start - u0 : a.stop - u0] = luma[b, a]
        self.windows[marker].append((len(self.frames) - 1, cut, (u0, v0), (u, v), reach))

    def stack(self, marker: int, size_px: tuple[int, int]) -> tuple[NDArray[np.int64], Stack, Array] | None:
        """The stored windows of one marker: their frames, the windows, the search's reach."""
        kept = self.windows[marker]
        if not kept:
            return None
        rows, cuts, corners, starts, reach = zip(*kept, strict=True)
        stack = Stack(np.stack(cuts), np.array(corners), np.array(starts), size_px)
        return np.array(rows), stack, np.array(reach)


@dataclass
class _Found:
    """What a stretch gave, (markers, frames): places, sigmas, and why a place is missing ("" = measured)."""

    place: Array
    sigma: Array
    reason: NDArray[np.object_]
    brightness: Array
    frames: list[tuple[int, float, bool]]


class SpotFollower:
    """Lights and discs: known by their distances, their common brightness, the taut line and the heading."""

    def __init__(self, run: Run, markers: tuple[Marker, ...], mapping: Mapping, backend: Backend) -> None:
        self.run, self.mapping, self.backend = run, mapping, backend
        self.markers = markers
        self.marks: list[_Mark | None] = [None] * len(self.markers)
        self.stretch = _Stretch(len(self.markers))
        self.done: list[_Found] = []
        self.size_px = (0, 0)
        self.tried = 0
        self.last: Assignment | None = None
        self.candidates_seen = 0
        self.ambiguous = False
        self.on_probation = True
        self.losses = 0
        self.searched = -REACQUIRE_FRAMES
        self.distances: dict[tuple[int, int], float] = {}
        self.standing = np.zeros((0, 2))
        self.begun_at: dict[int, Array] = {}

    @property
    def never_found(self) -> bool:
        measured = np.array([(found.reason == "").sum(axis=1) for found in self.done]).sum(axis=0)
        return not (measured >= 2).any()

    def step(self, frame: Frame) -> None:
        """Take one frame."""
        self.size_px = frame.luma.shape[1], frame.luma.shape[0]
        damaged = bool(getattr(frame, "damaged", False))
        self.stretch.frames.append((frame.index, frame.t_s, damaged))
        if damaged:
            pass
        elif not any(self.marks):
            self._acquire(frame)
        else:
            self._look(frame)
        if len(self.stretch) >= self._length() or any(
            m is not None and m.live.doubtful == DOUBT_FRAMES for m in self.marks
        ):
            self.flush()
        if not damaged and any(self.marks) and self._search_due(frame):
            self.flush()
            if any(self.marks):
                self.searched = frame.index
                self._recover(frame)

    def _look(self, frame: Frame) -> None:
        for index, mark in enumerate(self.marks):
            if mark is None:
                continue
            seen = mark.live.look(frame.luma, frame.t_s)
            if seen is not None:
                self.stretch.keep(index, frame.luma, seen[0], seen[1], mark.refiner.half_px, seen[2])

    def _length(self) -> int:
        """Frames of a stretch: few while the marks are new or one of them is lost, so that the end is known soon."""
        short = self.on_probation or any(m is not None and m.lost for m in self.marks)
        return PROBATION_FRAMES if short else STRETCH_FRAMES

    def _search_due(self, frame: Frame) -> bool:
        """Time to look for a lost mark on the whole frame."""
        unseen = [0 if m is None else max(m.live.unseen, m.lost) for m in self.marks]
        if all(m is None or m.live.unseen for m in self.marks) and max(unseen) in SEARCH_SOON:
            return True  # all at once: the camera was knocked, or a cut
        if frame.index - self.searched < REACQUIRE_FRAMES:
            return False
        return (
            not all(self.marks) or max(unseen) >= REACQUIRE_FRAMES or any(m is not None and m.lost for m in self.marks)
        )

    # acquisition ------------------------------------------------------------------------------------------------

    def _spots(
        self,
        frame: Frame,
        widths_px: tuple[float, ...],
        near: list[Array | None],
        near_sd_px: list[float] | None = None,
    ) -> tuple[Assignment, Candidates]:
        """Assign the frame's spots to the markers, trying ``widths_px`` in turn."""
        best = None
        for width in widths_px:
            candidates = self._without_lamps(self._candidates(frame, width))
            self.candidates_seen = max(self.candidates_seen, len(candidates))
            chosen = assign(candidates, self.markers, self.mapping, self.run, near, near_sd_px)
            if best is None or chosen.cost < best[0].cost:
                best = (chosen, candidates)
            if chosen.accepted and not chosen.ambiguous:
                break
        assert best is not None
        return best

    def _candidates(self, frame: Frame, width_px: float) -> Candidates:
        """Spots of the frame, bright and dark as the markers are, with their colour where a marker has one."""
        found = None
        for dark in sorted({m.colour == "dark" for m in self.markers}):
            one = find_candidates(frame.luma, dark, width_px)
            found = one if found is None else found.and_also(one)
        assert found is not None
        if len(found) and frame.raw is not None and any(m.colour in TINTS for m in self.markers):
            found = with_tint(found, frame.bgr())
        return found

    def _without_lamps(self, candidates: Candidates) -> Candidates:
        """Leave out spots that stood where they stand now when the marks were elsewhere."""
        if not len(self.standing) or not len(candidates):
            return candidates
        apart = np.linalg.norm(candidates.centre_px[:, None] - self.standing[None], axis=2).min(axis=1)
        return candidates.rows(apart > STATIC_PX)

    def _learn_lamps(self, candidates: Candidates, chosen: tuple[int, ...]) -> None:
        """Once the marks have moved away, what still stands where it stood at acquisition is no mark."""
        if not self.begun_at:
            self.begun_at = {i: candidates.centre_px[c] for i, c in enumerate(chosen) if c >= 0}
            self.others = np.delete(candidates.centre_px, [c for c in chosen if c >= 0], axis=0)
            return
        moved = [
            np.hypot(*(candidates.centre_px[c] - self.begun_at[i]))
            for i, c in enumerate(chosen)
            if c >= 0 and i in self.begun_at
        ]
        if moved and min(moved) > MOVED_PX and len(self.others) and len(candidates):
            apart = np.linalg.norm(self.others[:, None] - candidates.centre_px[None], axis=2).min(axis=1)
            self.standing = self.others[apart < STATIC_PX]

    def _acquire(self, frame: Frame) -> None:
        self.tried += 1
        if self.tried > ACQUIRE_EVERY_FRAME and self.tried % ACQUIRE_STRIDE:
            return
        chosen, candidates = self._spots(frame, ACQUIRE_WIDTHS_PX, self._seen_by_user())
        self.last = chosen
        if not chosen.accepted:
            return
        begun = {}
        for index, spot in enumerate(chosen.chosen):
            if spot >= 0:
                mark = self._begin(frame, index, candidates.centre_px[spot], float(candidates.width_px[spot]))
                if mark is not None:
                    begun[index] = mark
        if len(begun) < 2:
            return
        self.ambiguous |= chosen.ambiguous
        self._learn_lamps(candidates, chosen.chosen)
        # frames before this one hold nothing: they are written as they are, so that probation counts from here
        before, self.stretch.frames = self.stretch.frames[:-1], self.stretch.frames[-1:]
        self._write_unseen(before)
        self.on_probation = True
        for index, (mark, place) in begun.items():
            self.marks[index] = mark
            self.stretch.keep(index, frame.luma, float(place[0]), float(place[1]), mark.refiner.half_px, 0.0)

    def _begin(self, frame: Frame, index: int, place: Array, width: float) -> tuple[_Mark, Array] | None:
        """A new mark where a spot stands; None where it is none."""
        refiner = Refiner(width, self._dark(index), float(getattr(frame, "white_dn", 255)), self.backend)
        fit = refiner.once(self._one(frame, place, refiner))
        sign = -1.0 if self._dark(index) else 1.0
        if not fit.good[0] or sign * fit.amplitude_dn[0] <= 0:
            return None
        centre = fit.centre_px[0]
        live = LiveMark(centre, frame.t_s, float(fit.width_px[0]), abs(float(fit.amplitude_dn[0])), self._dark(index))
        refiner.width_px = float(np.clip(fit.width_px[0], 0.6, 12.0))
        return _Mark(live, refiner), centre

    def _one(self, frame: Frame, place: Array, refiner: Refiner) -> Stack:
        alone = _Stretch(1)
        alone.frames.append((frame.index, frame.t_s, False))
        alone.keep(0, frame.luma, float(place[0]), float(place[1]), refiner.half_px, 0.0)
        kept = alone.stack(0, self.size_px)
        assert kept is not None
        return kept[1]

    def _seen_by_user(self) -> list[Array | None]:
        """seen_at_px holds for the first analysed frame and a moment after it."""
        stale = self.tried > SEEN_FRAMES
        return [None if stale or m.seen_at_px is None else np.array(m.seen_at_px) for m in self.markers]

    def _recover(self, frame: Frame) -> None:
        """Look for lost marks on the whole frame; believed only where the marks that are still held are found as well."""
        now = self.done[-1]
        held = [None if r else p for r, p in zip(now.reason[:, -1], now.place[:, -1], strict=True)]
        if all(place is not None for place in held):
            return
        width = float(np.median([m.refiner.width_px for m in self.marks if m is not None]))
        near, near_sd = list(held), [SEEN_SD_PX] * len(held)
        for index, mark in enumerate(self.marks):
            if mark is not None and near[index] is None:  # tells a pair of marks from the same pair turned round
                near[index] = np.array([mark.replay.u, mark.replay.v])
                near_sd[index] = KNOCK_PX + KNOCK_PX_S * (frame.t_s - mark.replay.t_s)
        chosen, candidates = self._spots(frame, (width,), near, near_sd)
        if not chosen.accepted or chosen.ambiguous:
            return
        self._learn_lamps(candidates, chosen.chosen)
        centres = [candidates.centre_px[c] if c >= 0 else None for c in chosen.chosen]
        for place, centre in zip(held, centres, strict=True):
            if place is not None and (centre is None or np.hypot(*(centre - place)) > JUMP_PX + width):
                return
        for index, centre in enumerate(centres):
            if held[index] is not None or centre is None:
                continue
            begun = self._begin(frame, index, centre, width)
            if begun is None:
                continue
            mark, place = begun
            known = self.marks[index]
            fit = (known or mark).refiner.once(self._one(frame, place, mark.refiner))
            if not fit.good[0] or not self._fits_distance(index, fit.centre_px[0], fit.sigma_px[0], now):
                continue
            now.place[index, -1], now.sigma[index, -1], now.reason[index, -1] = fit.centre_px[0], fit.sigma_px[0], ""
            self.losses -= 1
            if known is not None:
                mark.refiner, mark.brightness_dn = known.refiner, known.brightness_dn
            self.marks[index] = mark

    def _dark(self, index: int) -> bool:
        return self.markers[index].colour == "dark"

    # a stretch ---------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Fit the windows of the stretch, judge every place, and write it."""
        stretch = self.stretch
        if not len(stretch):
            return
        if not any(self.marks):
            self._write_unseen(stretch.frames)
            stretch.clear()
            return
        found = self._unseen(stretch.frames)
        width = np.full(found.brightness.shape, np.nan)
        excess = np.full(found.brightness.shape, np.nan)
        flux = np.full(found.brightness.shape, np.nan)
        for index, mark in enumerate(self.marks):
            kept = None if mark is None else stretch.stack(index, self.size_px)
            if mark is None or kept is None:
                continue
            rows, stack, _ = kept
            fit = (refined := mark.refiner.refine(stack)).fit
            good = fit.good
            found.reason[index, rows] = np.where(good, "", "no spot")
            found.place[index, rows[good]] = fit.centre_px[good]
            found.sigma[index, rows[good]] = fit.sigma_px[good]
            found.brightness[index, rows] = np.where(good, fit.amplitude_dn, np.nan)
            width[index, rows] = fit.width_px / mark.refiner.width_px
            excess[index, rows] = refined.excess
            flux[index, rows] = np.where(refined.odd, refined.flux, 1.0)
        self._judge(found, width, excess, flux)
        if self.on_probation and self._broken(found):
            self._dismiss(found)
        else:
            self.on_probation = False
            self._learn(found)
        self._write(found)
        stretch.clear()

    def _unseen(self, frames: list[tuple[int, float, bool]]) -> _Found:
        """Nothing seen in these frames, and why."""
        shape = len(self.markers), len(frames)
        reason = np.full(shape, "not found yet", dtype=object)
        for index, mark in enumerate(self.marks):
            if mark is not None:
                reason[index] = "outside the picture"
        reason[:, [damaged for _, _, damaged in frames]] = "damaged frame"
        return _Found(
            np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan), reason, np.full(shape, np.nan), frames
        )

    def _write_unseen(self, frames: list[tuple[int, float, bool]]) -> None:
        if frames:
            self._write(self._unseen(frames))

    def _write(self, found: _Found) -> None:
        missing = found.reason != ""
        found.place[missing] = np.nan
        found.sigma[missing] = np.nan
        self.losses += int(missing.sum())
        self.done.append(found)

    def _broken(self, found: _Found) -> bool:
        followed = [i for i, mark in enumerate(self.marks) if mark is not None]
        reasons = found.reason[followed]
        return bool(((reasons != "") & (reasons != "damaged frame")).any())

    def _dismiss(self, found: _Found) -> None:
        """What was acquired did not hold: those frames were not the marks, and the search begins anew."""
        found.reason[found.reason != "damaged frame"] = "not confirmed"
        self.marks = [None] * len(self.markers)
        self.distances.clear()
        self.begun_at.clear()

    # judging -----------------------------------------------------------------------------------------------------

    def _judge(self, found: _Found, width: Array, excess: Array, flux: Array) -> None:
        """Why a fit is not the mark; the reason stays empty where it is.

        ``width``, ``excess`` (residual variance) and ``flux`` (of odd frames; 1 elsewhere) are over the usual ones.
        """
        reason, brightness = found.reason, found.brightness
        ratio = np.full(brightness.shape, np.nan)
        for index, mark in enumerate(self.marks):
            if mark is not None:
                sign = -1.0 if mark.live.dark else 1.0
                with np.errstate(invalid="ignore", divide="ignore"):
                    ratio[index] = np.log(
                        np.maximum(sign * brightness[index] / self._reference(mark, brightness[index]), 1e-9)
                    )
        low, high = np.log(BRIGHTNESS_RANGE)
        fine = ratio - _common(ratio, COMMON_SPREAD)[None, :]
        with np.errstate(invalid="ignore"):
            _put(reason, "brightness", ~((fine > low) & (fine < high)))
            _put(reason, "shape", ~((width > WIDTH_RANGE[0]) & (width < WIDTH_RANGE[1])) | (excess > SHAPE_LIMIT))
            common = np.where(flux == 1.0, 1.0, np.exp(_common(ratio, SAME_SPREAD))[None, :])
            _put(reason, "covered", ~((flux / common > COVERED_RANGE[0]) & (flux / common < COVERED_RANGE[1])))
            _put(reason, "too faint", found.sigma.max(axis=2) > LARGEST_SIGMA_PX)
        surprise = np.full(brightness.shape, np.nan)
        for index, mark in enumerate(self.marks):
            if mark is not None:
                self._replay(index, mark, found, surprise)
        self._check_distances(found, surprise)

    def _reference(self, mark: _Mark, brightness: Array) -> float:
        """The brightness to compare with: the running one, or that of the very first stretch."""
        if mark.refiner.stretches > 1:
            return mark.brightness_dn
        middle = np.nanmedian(np.abs(brightness)) if np.isfinite(brightness).any() else np.nan
        return float(middle) if np.isfinite(middle) else mark.brightness_dn

    def _replay(self, index: int, mark: _Mark, found: _Found, surprise: Array) -> None:
        """Run the filter over the fitted places; what it cannot follow has jumped."""
        state, lost = mark.replay, mark.lost
        places, reasons = found.place[index], found.reason[index]
        for row, (_, t_s, _) in enumerate(found.frames):
            if reasons[row]:
                lost += 1
                continue
            u, v, spread = state.predict(t_s) if t_s > state.t_s else (state.u, state.v, state.spread)
            gap = float(np.hypot(places[row, 0] - u, places[row, 1] - v))
            surprise[index, row] = gap
            if gap > JUMP_PX + JUMP_SD * np.sqrt(spread) and lost <= REACQUIRE_FRAMES:
                reasons[row] = "jumped"
                lost += 1
                continue
            if lost > REACQUIRE_FRAMES:
                state.stop()
            if t_s > state.t_s:
                state.update(float(places[row, 0]), float(places[row, 1]), t_s)
            lost = 0
        mark.lost = lost

    # rigid distances ---------------------------------------------------------------------------------------------

    def _tank(self, index: int, place: Array, sigma: Array) -> tuple[Array, Array]:
        """Places (n, 2) m and their covariance (n, 2, 2) m^2 from the pixels' sigma."""
        seen = self.mapping.to_tank(place, self.markers[index].depth_m)
        spread = seen.per_px * sigma[:, None, :]
        return seen.xy_m, spread @ spread.swapaxes(1, 2)

    def _apart(self, i: int, j: int, found: _Found, rows: Array) -> tuple[Array, Array]:
        """Distances of two marks in the tank and their standard deviations from the pixels, m."""
        (one, one_sd), (two, two_sd) = (self._tank(k, found.place[k, rows], found.sigma[k, rows]) for k in (i, j))
        gap = one - two
        apart = np.linalg.norm(gap, axis=1)
        unit = gap / np.maximum(apart, 1e-12)[:, None]
        return apart, np.sqrt(np.einsum("ni,nij,nj->n", unit, one_sd + two_sd, unit))

    def _gate(self, key: tuple[int, int], sd: Array) -> Array:
        body = np.array(self.markers[key[0]].body_m) - np.array(self.markers[key[1]].body_m)
        # the camera's common errors change slowly over the picture: one standard deviation of identity's tolerance
        return DISTANCE_GATE * sd + DISTANCE_SD_M + DISTANCE_SD_SHARE * float(np.hypot(*body))

    def _pairs(self):
        count = len(self.markers)
        return [(i, j) for j in range(count) for i in range(j) if self.markers[i].on == self.markers[j].on]

    def _check_distances(self, found: _Found, surprise: Array) -> None:
        """Where a pair's distance is wrong, the mark that surprises most is lost, until all pairs agree."""
        for _ in range(len(self.markers)):
            wrong = np.zeros(found.reason.shape, dtype=bool)
            for i, j in self._pairs():
                rows = np.flatnonzero((found.reason[i] == "") & (found.reason[j] == ""))
                if not len(rows):
                    continue
                apart, sd = self._apart(i, j, found, rows)
                stated = self.distances.get((i, j), float(np.median(apart)))
                off = rows[np.abs(apart - stated) > self._gate((i, j), sd)]
                wrong[i, off] = wrong[j, off] = True
            if not wrong.any():
                return
            for row in np.flatnonzero(wrong.any(axis=0)):
                worst = int(np.argmax(np.where(wrong[:, row], np.nan_to_num(surprise[:, row]), -1.0)))
                found.reason[worst, row] = "distance"

    def _fits_distance(self, index: int, place: Array, sigma: Array, now: _Found) -> bool:
        """A mark found again stands at its distance from those that are held."""
        trial = _Found(
            now.place[:, -1:].copy(), now.sigma[:, -1:].copy(), now.reason[:, -1:].copy(), now.brightness, []
        )
        trial.place[index, 0], trial.sigma[index, 0], trial.reason[index, 0] = place, sigma, ""
        for pair in self._pairs():
            other = pair[0] if pair[1] == index else pair[1]
            if index in pair and pair in self.distances and trial.reason[other, 0] == "":
                apart, sd = self._apart(*pair, trial, np.array([0]))
                if abs(apart[0] - self.distances[pair]) > self._gate(pair, sd)[0]:
                    return False
        return True

    # learning ----------------------------------------------------------------------------------------------------

    def _learn(self, found: _Found) -> None:
        """Carry distances, brightness and the filters' state into the next stretch."""
        for i, j in self._pairs():
            rows = np.flatnonzero((found.reason[i] == "") & (found.reason[j] == ""))
            if len(rows):
                apart = float(np.median(self._apart(i, j, found, rows)[0]))
                before = self.distances.get((i, j), apart)
                self.distances[(i, j)] = before + DISTANCE_MEMORY * (apart - before)
        for index, mark in enumerate(self.marks):
            if mark is None:
                continue
            seen = np.flatnonzero(found.reason[index] == "")
            if len(seen):
                mark.brightness_dn = float(np.median(np.abs(found.brightness[index, seen[-REFERENCE_FRAMES:]])))
                mark.live.rise_dn = mark.brightness_dn
                mark.live.width_px = mark.refiner.width_px
            mark.live.filter = mark.replay.copy()
            mark.live.unseen = mark.lost

    # results ----------------------------------------------------------------------------------------------------

    def why_never(self) -> str:
        names = ", ".join(m.name for m in self.markers)
        text = f"{self.run.source_path}: markers never found ({names}): {self.candidates_seen} spots in the best frame"
        if self.last is not None and self.last.nearest_m is not None:
            apart, stated = self.last.nearest_m
            text += (
                f"; no set of them fits the markers' distances, the taut line, the heading and a common brightness "
                f"(pair distance stated {stated:.3f} m, nearest {apart:.3f} m)"
            )
        return text + "; check marker.body_m, depth_m, colour and the datum, or give marker.seen_at_px"

    def finish(self) -> pd.DataFrame:
        self.flush()
        if self.never_found:
            raise TrackingError(self.why_never())
        count = len(self.markers)
        names = np.array([m.name for m in self.markers], dtype=object)
        place = np.concatenate([f.place for f in self.done], axis=1).swapaxes(0, 1).reshape(-1, 2)
        sigma = np.concatenate([f.sigma for f in self.done], axis=1).swapaxes(0, 1).reshape(-1, 2)
        reason = np.concatenate([f.reason for f in self.done], axis=1).T.ravel()
        index = np.concatenate([[i for i, _, _ in f.frames] for f in self.done])
        t_s = np.concatenate([[t for _, t, _ in f.frames] for f in self.done])
        return pd.DataFrame(
            {
                "frame": np.repeat(index, count),
                "t_s": np.repeat(t_s, count),
                "marker": np.tile(names, len(index)),
                "u_px": place[:, 0],
                "v_px": place[:, 1],
                "sigma_u_px": sigma[:, 0],
                "sigma_v_px": sigma[:, 1],
                "status": np.where(reason == "", "measured", "lost"),
                "reason": reason,
            }
        )


def _common(ratio: Array, most: float) -> Array:
    """Per frame the logarithmic change of brightness that all marks share to a factor ``most``; 0 where they do not."""
    seen = np.isfinite(ratio)
    count = seen.sum(axis=0)
    filled = np.where(seen, ratio, 0.0)
    mean = filled.sum(axis=0) / np.maximum(count, 1)
    spread = np.where(seen, np.abs(ratio - mean), 0.0).max(axis=0)
    return np.where((count > 1) & (2 * spread < np.log(most)), mean, 0.0)


def _put(reason: NDArray[np.object_], word: str, where: NDArray[np.bool_]) -> None:
    """Name the reason where there is none yet."""
    reason[where & (reason == "")] = word
