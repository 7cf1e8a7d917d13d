"""Follow the marks through a recording: acquisition on the whole frame, then a predicted window per marker."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from ..geometry.mapping import Mapping, Places
from ..record.errors import InputError, TrackingError
from ..record.run import RUN_FILE, Run
from ..record.schema import Marker
from .candidates import MAD_TO_SD, Array, find_candidates
from .decode import Frame
from .identity import DISTANCE_SD_M, DISTANCE_SD_SHARE, Assignment, assign
from .spot import SpotFit, fit_spots, windows

SEARCH_PX = 4
"""A spot is looked for this far beyond its window in each frame; more while it is lost."""
SEARCH_GROWTH_PX = 2
SEARCH_LIMIT_PX = 40
JUMP_PX = 3.0
"""Largest surprise of a spot's place against its prediction, beside half of its own step."""
AMPLITUDE_RANGE = (0.4, 2.5)
WIDTH_RANGE = (0.55, 1.8)
LARGEST_SIGMA_PX = 0.5
LEAST_WINDOW_SHARE = 0.6
"""A window that lies farther outside the picture is not fitted."""
REFERENCE_MEMORY = 0.05
"""Share of a new frame in the running amplitude, width and distance."""
REACQUIRE_FRAMES = 10
SEEN_FRAMES = 10
FIRST_REACH_PX = 16
"""Search beyond the window while a mark's rate is not known yet."""
PROBATION_FRAMES = 8
"""A set of spots that loses one of its members within this many frames was not the set of marks."""
DISTANCE_GATE = 6.0
ACQUIRE_WIDTHS_PX = (2.0, 4.0, 7.0)
"""Spot widths tried one after the other while nothing is known."""
ACQUIRE_EVERY_FRAME = 60
"""While nothing has been found: every frame at first, then ..."""
ACQUIRE_STRIDE = 15
LAGS_FRAMES = (1, 2, 4, 8, 16)
LEAST_DIFFERENCES = 20
MOTION_GROWTH = 1.9


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
    """

    table: pd.DataFrame
    frames: int
    measured: dict[str, int]
    reasons: dict[str, dict[str, int]]
    ambiguous: bool


@dataclass
class _State:
    """What is known of one marker while tracking."""

    place: Array = field(default_factory=lambda: np.full(2, np.nan))
    rate: Array = field(default_factory=lambda: np.zeros(2))
    t_s: float = 0.0
    width: float = 2.0
    amplitude: float = 0.0
    sharp: bool = False
    lost: int = 0
    steps: int = 0
    known: bool = False

    def predict(self, t_s: float) -> Array:
        return self.place + self.rate * (t_s - self.t_s)

    @property
    def rate_known(self) -> bool:
        return self.steps > 1

    def begin(self, fit: SpotFit, t_s: float) -> None:
        """The mark is seen for the first time."""
        self.known, self.place, self.t_s, self.rate = True, fit.centre_px[0], t_s, np.zeros(2)
        self.amplitude, self.width = float(fit.amplitude_dn[0]), float(fit.width_px[0])

    @property
    def radius(self) -> int:
        # a flat-topped spot ends soon beyond its edge, a Gaussian one only after some widths
        share = round(self.width + 1.9) if self.sharp else round(2.8 * self.width)
        return int(np.clip(share, 5, 16))


def check_looks(run: Run) -> None:
    """InputError for a marker whose look this version cannot follow."""
    for marker in run.file.marker:
        if marker.look not in ("led", "disc"):
            raise InputError(
                run.folder / RUN_FILE,
                f"marker {marker.name!r}.look",
                f"{marker.look!r} is not tracked by this version; led and disc are",
            )


def track(
    run: Run,
    frames: Iterable[Frame],
    mapping: Mapping,
    progress: Callable[[int, int], None] | None = None,
    watch: Callable[[Frame, dict[str, Array | None]], None] | None = None,
) -> Tracking:
    """Track the markers of ``run`` through ``frames``.

    Parameters
    ----------
    mapping : pixel -> tank of the run's datum
    progress : called with frames done and losses so far
    watch : called with each frame and the markers' places (None = lost), for an overlay

    Raises
    ------
    TrackingError : the marks were never found
    """
    check_looks(run)
    tracker = _Tracker(run, mapping)
    count = losses = 0
    for frame in frames:
        places = tracker.step(frame)
        count += 1
        losses += sum(p is None for p in places.values())
        if watch is not None:
            watch(frame, places)
        if progress is not None:
            progress(count, losses)
    if not count:
        raise TrackingError(f"{run.source_path}: no frame lies within source.span_s")
    if tracker.never_found:
        raise TrackingError(tracker.why_never())
    return tracker.result(count)


class _Tracker:
    def __init__(self, run: Run, mapping: Mapping) -> None:
        self.run, self.mapping = run, mapping
        self.markers: tuple[Marker, ...] = tuple(m for m in run.file.marker)
        self.states = [_State() for _ in self.markers]
        self.rows: list[tuple] = []
        self.tried = 0
        self.last: Assignment | None = None
        self.candidates_seen = 0
        self.ambiguous = False
        self.began = 0
        self.distances: dict[tuple[int, int], float] = {}
        self.places: dict[int, tuple[SpotFit, Places]] = {}

    @property
    def never_found(self) -> bool:
        measured = [row[0] for row in self.rows if row[7] == "measured"]
        return not any(count >= 2 for count in Counter(measured).values())

    def step(self, frame: Frame) -> dict[str, Array | None]:
        if not any(s.known for s in self.states):
            found, reasons = self._acquire(frame)
        else:
            found, reasons = self._follow(frame)
            if self._on_probation() and any(s.known and f is None for s, f in zip(self.states, found, strict=True)):
                self._dismiss()
                found, reasons = self._acquire(frame)
            if any(s.known and s.lost and s.lost % REACQUIRE_FRAMES == 0 for s in self.states) or not all(
                s.known or frame.index % REACQUIRE_FRAMES for s in self.states
            ):
                self._recover(frame, found, reasons)
        places: dict[str, Array | None] = {}
        for index, marker in enumerate(self.markers):
            fit = found[index]
            if fit is None:
                self.states[index].lost += 1
                row = (np.nan, np.nan, np.nan, np.nan, "lost", reasons[index])
                places[marker.name] = None
            else:
                self._update(self.states[index], fit, frame.t_s)
                row = (*fit.centre_px[0], *fit.sigma_px[0], "measured", "")
                places[marker.name] = fit.centre_px[0]
            self.rows.append((frame.index, frame.t_s, marker.name, *row[:4], *row[4:]))
        self._learn_distances(found)
        return places

    # acquisition ------------------------------------------------------------------------------------------------

    def _spots(
        self, frame: Frame, widths_px: tuple[float, ...], near: list[Array | None]
    ) -> tuple[Assignment, list[Array], list[float]]:
        """Assign the frame's spots to the markers, trying ``widths_px`` in turn; their places and widths."""
        best = None
        for width in widths_px:
            candidates = find_candidates(frame.luma, self._dark(0), width)
            self.candidates_seen = max(self.candidates_seen, len(candidates))
            chosen = assign(candidates, self.markers, self.mapping, self.run, near)
            if best is None or chosen.cost < best[0].cost:
                best = (chosen, candidates)
            if chosen.accepted and not chosen.ambiguous:
                break
        assert best is not None
        chosen, candidates = best
        centres = [candidates.centre_px[c] if c >= 0 else np.full(2, np.nan) for c in chosen.chosen]
        widths = [float(candidates.width_px[c]) if c >= 0 else 2.0 for c in chosen.chosen]
        return chosen, centres, widths

    def _acquire(self, frame: Frame) -> tuple[list[SpotFit | None], list[str]]:
        empty: list[SpotFit | None] = [None] * len(self.markers)
        reasons = ["not found yet"] * len(self.markers)
        self.tried += 1
        if self.tried > ACQUIRE_EVERY_FRAME and self.tried % ACQUIRE_STRIDE:
            return empty, reasons
        groups = {m.colour == "dark" for m in self.markers}
        if len(groups) > 1:
            raise InputError(
                self.run.folder / RUN_FILE,
                "marker.colour",
                "dark and bright marks in one run are not tracked by this version",
            )
        chosen, centres, widths = self._spots(frame, ACQUIRE_WIDTHS_PX, self._seen_by_user())
        self.last = chosen
        if not chosen.accepted:
            return empty, reasons
        self.ambiguous |= chosen.ambiguous
        wanted = {i: (c, w) for i, (c, w) in enumerate(zip(centres, widths, strict=True)) if np.isfinite(c).all()}
        fits = {index: fit for index, fit in self._fits(frame, wanted).items() if fit is not None}
        if len(fits) < 2:
            return empty, reasons
        self.began = len(self.rows)
        for index, fit in fits.items():
            empty[index], reasons[index] = fit, ""
            self.states[index].begin(fit, frame.t_s)
        return empty, reasons

    def _seen_by_user(self) -> list[Array | None]:
        """seen_at_px holds for the first analysed frame and a moment after it."""
        stale = self.tried > SEEN_FRAMES
        return [None if stale or m.seen_at_px is None else np.array(m.seen_at_px) for m in self.markers]

    def _recover(self, frame: Frame, found: list[SpotFit | None], reasons: list[str]) -> None:
        """Look for lost marks on the whole frame; believed only where the marks that are still held are found as well."""
        near = [None if fit is None else fit.centre_px[0] for fit in found]
        chosen, centres, widths = self._spots(frame, (float(np.median([s.width for s in self.states])),), near)
        if not chosen.accepted or chosen.ambiguous:
            return
        for index, fit in enumerate(found):
            if fit is not None and not np.hypot(*(centres[index] - fit.centre_px[0])) < JUMP_PX + fit.width_px[0]:
                return
        for index, fit in enumerate(found):
            if fit is None and np.isfinite(centres[index]).all():
                again = self._fit(frame, index, centres[index], widths[index])
                if again is not None and self._fits_distance(index, again, found):
                    found[index], reasons[index] = again, ""
                    state = self.states[index]
                    if state.known:
                        state.rate = np.zeros(2)
                    else:
                        state.begin(again, frame.t_s)

    def _on_probation(self) -> bool:
        return len(self.rows) - self.began < PROBATION_FRAMES * len(self.markers)

    def _dismiss(self) -> None:
        """What was acquired did not hold: those frames were not the marks, and the search begins anew."""
        for at in range(self.began, len(self.rows)):
            index, t_s, name, *_ = self.rows[at]
            self.rows[at] = (index, t_s, name, np.nan, np.nan, np.nan, np.nan, "lost", "not confirmed")
        self.states = [_State() for _ in self.markers]
        self.distances.clear()

    # following --------------------------------------------------------------------------------------------------

    def _follow(self, frame: Frame) -> tuple[list[SpotFit | None], list[str]]:
        reasons = [""] * len(self.states)
        wanted: dict[int, tuple[Array, float]] = {}
        gates: dict[int, tuple[Array, int]] = {}
        height, width = frame.luma.shape
        for index, state in enumerate(self.states):
            if not state.known:
                reasons[index] = "not found yet"
                continue
            expected = state.predict(frame.t_s) if state.lost < REACQUIRE_FRAMES else state.place
            if not (0 <= expected[0] < width and 0 <= expected[1] < height):
                reasons[index] = "outside the picture"
                continue
            grown = min(SEARCH_PX + SEARCH_GROWTH_PX * state.lost, SEARCH_LIMIT_PX)
            reach = grown if state.rate_known else FIRST_REACH_PX
            wanted[index] = (self._brightest(frame, index, expected, reach), state.width)
            gates[index] = (expected, reach)
        fits = self._fits(frame, wanted)
        found: list[SpotFit | None] = [None] * len(self.states)
        for index, (expected, reach) in gates.items():
            fit = fits[index]
            reasons[index] = self._judge(self.states[index], fit, expected, reach, frame.t_s)
            found[index] = None if reasons[index] else fit
        self._check_distances(found, reasons, frame.t_s)
        return found, reasons

    def _brightest(self, frame: Frame, index: int, expected: Array, reach: int) -> Array:
        """The strongest spot within ``reach`` of ``expected``, nearer ones preferred, to half a pixel."""
        import cv2

        state = self.states[index]
        cut, corner = windows(frame.luma, expected[None], reach + 2)
        values = cut[0]
        values = np.where(np.isfinite(values), values, np.nanmedian(values) if np.isfinite(values).any() else 0.0)
        sign = -1.0 if self._dark(index) else 1.0
        smooth = cv2.GaussianBlur(sign * values, (0, 0), max(0.7, 0.6 * state.width))
        axis = np.arange(smooth.shape[0])
        v, u = np.meshgrid(axis, axis, indexing="ij")
        away = (u + corner[0, 0] - expected[0]) ** 2 + (v + corner[0, 1] - expected[1]) ** 2
        score = smooth - 0.3 * abs(state.amplitude) * away / max(reach, 3) ** 2
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        return corner[0] + [column, row]

    def _fit(self, frame: Frame, index: int, start: Array, width: float) -> SpotFit | None:
        return self._fits(frame, {index: (start, width)})[index]

    def _fits(self, frame: Frame, wanted: dict[int, tuple[Array, float]]) -> dict[int, SpotFit | None]:
        """Fit the spots of several markers, (start, width) each, in one batch per window size; None = no spot there."""
        found: dict[int, SpotFit | None] = dict.fromkeys(wanted)
        batches: dict[tuple[int, bool], list[int]] = {}
        for index, (_, width) in wanted.items():
            state = self.states[index]
            radius = state.radius if state.known else int(np.clip(round(2.0 * width + 2), 5, 16))
            batches.setdefault((radius, self._dark(index)), []).append(index)
        for (radius, dark), members in batches.items():
            centres = np.array([wanted[i][0] for i in members], dtype=float)
            cut, corner = windows(frame.luma, centres, radius)
            inside = np.isfinite(cut).mean(axis=(1, 2)) >= LEAST_WINDOW_SHARE
            if not inside.any():
                continue
            widths = np.array([wanted[i][1] for i in members])
            fit = fit_spots(cut[inside], corner[inside], centres[inside], widths[inside], dark)
            for row, index in enumerate(np.array(members)[inside]):
                if fit.good[row]:
                    found[int(index)] = fit.row(row)
        return found

    def _judge(self, state: _State, fit: SpotFit | None, expected: Array, reach: int, t_s: float) -> str:
        """Why a fit is not the mark; empty = it is."""
        if fit is None:
            return "no spot"
        if not AMPLITUDE_RANGE[0] < fit.amplitude_dn[0] / state.amplitude < AMPLITUDE_RANGE[1]:
            return "brightness"
        if not WIDTH_RANGE[0] < fit.width_px[0] / state.width < WIDTH_RANGE[1]:
            return "shape"
        if fit.sigma_px[0].max() > LARGEST_SIGMA_PX:
            return "too faint"
        step = np.hypot(*state.rate) * (t_s - state.t_s)
        if np.hypot(*(fit.centre_px[0] - expected)) > JUMP_PX + 0.5 * step + (
            reach if state.lost or not state.rate_known else 0
        ):
            return "jumped"
        return ""

    def _dark(self, index: int) -> bool:
        return self.markers[index].colour == "dark"

    # rigid distances --------------------------------------------------------------------------------------------

    def _place(self, index: int, fit: SpotFit) -> Places:
        """Where a fit lies in the tank; asked for by several checks of one frame, worked out once."""
        kept = self.places.get(index)
        if kept is None or kept[0] is not fit:
            kept = (fit, self.mapping.to_tank(fit.centre_px, self.markers[index].depth_m))
            self.places[index] = kept
        return kept[1]

    def _distance(self, i: int, j: int, one: SpotFit, two: SpotFit) -> tuple[float, float]:
        """Distance of two marks in the tank and its standard deviation from the pixels, m."""
        a, b = self._place(i, one), self._place(j, two)
        gap = a.xy_m[0] - b.xy_m[0]
        apart = float(np.hypot(*gap))
        unit = gap / max(apart, 1e-12)
        spread = [unit @ p.per_px[0] * f.sigma_px[0] for p, f in ((a, one), (b, two))]
        return apart, float(np.sqrt(sum((s**2).sum() for s in spread)))

    def _fits_distance(self, index: int, fit: SpotFit, found: list[SpotFit | None]) -> bool:
        for j, other in enumerate(found):
            if other is None or j == index:
                continue
            key = (min(index, j), max(index, j))
            apart, sd = self._distance(index, j, fit, other)
            if key in self.distances and abs(apart - self.distances[key]) > self._gate(key, sd):
                return False
        return True

    def _gate(self, key: tuple[int, int], sd: float) -> float:
        body = np.array(self.markers[key[0]].body_m) - np.array(self.markers[key[1]].body_m)
        # the camera's common errors change slowly over the picture: one standard deviation of identity's tolerance
        return DISTANCE_GATE * sd + DISTANCE_SD_M + DISTANCE_SD_SHARE * float(np.hypot(*body))

    def _check_distances(self, found: list[SpotFit | None], reasons: list[str], t_s: float) -> None:
        """Where a pair's distance is wrong, the mark that surprises most is lost, until all pairs agree."""
        while True:
            wrong: set[int] = set()
            for (i, j), stated in self.distances.items():
                one, two = found[i], found[j]
                if one is None or two is None:
                    continue
                apart, sd = self._distance(i, j, one, two)
                if abs(apart - stated) > self._gate((i, j), sd):
                    wrong |= {i, j}
            if not wrong:
                return
            surprise = {i: self._surprise(i, found[i], t_s) for i in wrong}
            worst = max(surprise, key=lambda i: surprise[i])
            found[worst], reasons[worst] = None, "distance"

    def _surprise(self, index: int, fit: SpotFit | None, t_s: float) -> float:
        assert fit is not None
        state = self.states[index]
        return float(np.hypot(*(fit.centre_px[0] - state.predict(t_s)))) + 10.0 * state.lost

    def _learn_distances(self, found: list[SpotFit | None]) -> None:
        for j in range(len(found)):
            for i in range(j):
                one, two = found[i], found[j]
                if one is None or two is None:
                    continue
                apart, _ = self._distance(i, j, one, two)
                before = self.distances.get((i, j), apart)
                self.distances[(i, j)] = before + REFERENCE_MEMORY * (apart - before)

    def _update(self, state: _State, fit: SpotFit, t_s: float) -> None:
        step = t_s - state.t_s
        if step > 0 and state.lost < REACQUIRE_FRAMES:
            rate = (fit.centre_px[0] - state.place) / step
            # alpha-beta tracker: the rate follows by 60 % a frame, all at once after the first one
            state.rate = state.rate + 0.6 * (rate - state.rate) if state.rate_known else rate
        elif step > 0:
            state.rate, state.steps = np.zeros(2), 0
        state.steps += 1
        state.place, state.t_s, state.lost = fit.centre_px[0], t_s, 0
        state.amplitude += REFERENCE_MEMORY * (float(fit.amplitude_dn[0]) - state.amplitude)
        state.width += REFERENCE_MEMORY * (float(fit.width_px[0]) - state.width)
        state.sharp = bool(fit.sharpness[0] > 1.3)

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

    def result(self, frames: int) -> Tracking:
        names = ["frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status", "reason"]
        table = pd.DataFrame(self.rows, columns=names)
        table = _with_scatter(table)
        measured = {
            m.name: int(((table["marker"] == m.name) & (table["status"] == "measured")).sum()) for m in self.markers
        }
        lost = table[table["status"] == "lost"]
        reasons = {
            str(name): {str(k): int(v) for k, v in rows["reason"].value_counts().items()}
            for name, rows in lost.groupby("marker")
        }
        return Tracking(table, frames, measured, reasons, self.ambiguous)


def _with_scatter(table: pd.DataFrame) -> pd.DataFrame:
    """Widen each marker's sigma to the scatter that its own track shows beyond a smooth path (third differences).

    A codec's error lasts several frames, so differences over longer steps show more of it; the steps are doubled until the
    motion itself comes up (its third difference grows eightfold with every doubling, noise hardly at all).
    """
    table = table.copy()
    for _, rows in table.groupby("marker"):
        for place, sigma in (("u_px", "sigma_u_px"), ("v_px", "sigma_v_px")):
            seen = _path_scatter(rows["t_s"].to_numpy(), rows[place].to_numpy())
            stated = float(np.nanmean(rows[sigma].to_numpy() ** 2)) if rows[sigma].notna().any() else 0.0
            table.loc[rows.index, sigma] = np.sqrt(rows[sigma] ** 2 + max(0.0, seen**2 - stated))
    return table


def _path_scatter(t_s: Array, values: Array) -> float:
    """Standard deviation of a track's noise, px; 0 where the track is too short to tell.

    Third divided differences, scaled to unit noise gain: a quadratic path leaves nothing, whatever the frames' spacing.
    """
    scatter = 0.0
    for step in LAGS_FRAMES:
        count = len(values) - 3 * step
        if count < LEAST_DIFFERENCES * step:
            break
        at = np.arange(count)[:, None] + step * np.arange(4)
        times = t_s[at]
        apart = times[:, :, None] - times[:, None, :] + np.eye(4)
        weights = 1.0 / apart.prod(axis=2)
        third = (weights * values[at]).sum(axis=1) / np.linalg.norm(weights, axis=1)
        third = third[np.isfinite(third)]
        if len(third) < LEAST_DIFFERENCES * step:
            break
        # a robust scale: the few frames where the mark jumps or turns sharply must not widen all others
        seen = MAD_TO_SD * float(np.median(np.abs(third)))
        if scatter and seen > MOTION_GROWTH * scatter:
            break
        scatter = max(scatter, seen)
    return scatter
