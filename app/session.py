"""What lies on the session: the run that is open, the frame that is shown, what is picked and clicked, and the jobs.

One person works at one session. Nothing here draws; the pages ask and tell.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

from ..geometry.motion import lens_covariance
from ..record.errors import InputError, TowlineError
from ..record.run import CORRECTIONS, RUN_FILE, Run, leads_out, read_run, stay_inside
from ..record.sources import is_recording, recordings_in
from ..report.topview import TopView
from ..vision.recording import Frame
from .byhand import FILE, ByHand, begun
from .correcting import Correcting
from .document import Document
from .filming import Filming
from .frames import EXACT, Frames
from .live_view import Live
from .motion_view import Shown, read_shown
from .places import Place, inside, page_file, place
from .sight import Detected, Sight, detected, sight, view_of
from .snap import Snapped, as_clicked, snapped
from .worker import Worker

DIGITS = 4
"""Decimals of a place in pixels that are written into run.toml."""


@dataclass
class Session:
    """The state of the page.

    Attributes
    ----------
    start : folder that the command was given
    worker : does the long jobs
    filming : films tows
    live : what the live page shows; None until it was looked at with this run
    document : of the open run; None = none is open
    frames : of its recording; None where it has none, ``video_problem`` says why
    index : the frame that is shown
    snapping : clicks go to the mark next to them
    selected : numbers of the datum point and the marker that the next click moves; -1 = a new one
    by_hand : None until the markers are known
    corrections : of the tracks; None until they are asked for
    opened : goes up with every run that is opened
    unsure : a frame that was shown before the recording was read up to it; -1 = none
    pages : result pages that may be shown, by keys that nobody guesses: their address holds no other secret
    """

    start: Path
    worker: Worker = field(default_factory=Worker)
    filming: Filming = field(default_factory=Filming)
    live: Live | None = None
    document: Document | None = None
    frames: Frames | None = None
    video: str = ""
    video_problem: str = ""
    index: int = 0
    snapping: bool = True
    selected: dict[str, int] = field(default_factory=lambda: {"datum": -1, "marker": -1})
    by_hand: ByHand | None = None
    corrections: Correcting | None = None
    opened: int = 0
    unsure: int = -1
    pages: dict[str, Path] = field(default_factory=dict)
    _sight: tuple[tuple[int, str], Sight] | None = None
    _view: tuple[Sight, TopView | None] | None = None
    _detected: dict[tuple[int, int], Detected] = field(default_factory=dict)
    _detecting: Lock = field(default_factory=Lock)
    _shown: tuple[tuple[Any, ...], Shown] | None = None
    _corrected: tuple[Any, ...] = ()
    _looked_at: tuple[str, float | None, float, bool] | None = None

    # opening and saving --------------------------------------------------------------------------------------------------

    def open(self, folder: str | Path, video: str = "") -> Place:
        """Open a run folder, or begin one where there is only a video.

        Raises
        ------
        InputError : no such folder, nothing in it, several videos and none chosen, or a run.toml that is no TOML
        """
        found = place(folder)
        if found.has_run:
            document = Document.open(found.folder)
        else:
            names = list(found.videos)
            if not video and len(names) > 1:
                raise InputError(found.folder, "", f"{len(names)} videos; choose one: {', '.join(names)}")
            name = video or names[0]
            inside(found.folder, name)
            document = Document.new(found.folder, name)
        self.close()
        self.document = document
        self.opened += 1
        self._open_video()
        return found

    def close(self) -> None:
        """Put the open run away."""
        if self.frames is not None:
            self.frames.close()
        self.document = self.frames = self.by_hand = self.corrections = self.live = None
        self.index, self.video, self.video_problem = 0, "", ""
        self.selected = {"datum": -1, "marker": -1}
        self._sight = self._shown = self._view = None
        self._detected = {}

    @property
    def doc(self) -> Document:
        """The open document; InputError where none is."""
        if self.document is None:
            raise InputError("run", "", "no run is open")
        return self.document

    @property
    def dirty(self) -> bool:
        """Something is not saved."""
        by_hand = self.by_hand is not None and self.by_hand.dirty
        corrected = self.corrections is not None and self.corrections.dirty
        return self.document is not None and (self.document.dirty or by_hand or corrected)

    def save(self) -> list[Path]:
        """Write run.toml, and the clicks and corrections where there are new ones."""
        written = []
        if self.corrections is not None and self.corrections.dirty:
            written += self.corrections.write(self.doc.outside)
        if self.by_hand is not None and self.by_hand.dirty and self.frames is not None:
            if self.by_hand.clicks:
                written.append(self.by_hand.write(self.doc.folder, self.frames.time_s, self.doc.outside))
            else:
                self.by_hand.dirty = False
        if self.doc.dirty:
            written.append(self.doc.save())
        return written

    # recording -----------------------------------------------------------------------------------------------------------

    def video_name(self) -> str:
        """The recording to look at: source.video, else the one that stands there as a comment, else the folder's only one."""
        stated = self.doc.get("source", "video")
        if isinstance(stated, str):
            return stated
        for line in self.doc.text.splitlines():
            key, _, rest = line.lstrip("# ").partition("=")
            if line.lstrip().startswith("#") and key.strip() == "video" and rest.count('"') >= 2:
                name = rest.split('"')[1]
                if (self.doc.outside or not leads_out(name)) and is_recording(self.doc.folder / name):
                    return name
        there = recordings_in(self.doc.folder)
        return there[0] if len(there) == 1 else ""

    def _wanted(self) -> tuple[str, float | None, float, bool]:
        """The recording that run.toml names, its frame rate and exposure, and whether it may lie outside the folder."""
        rate, exposure = self.doc.get("source", "frame_rate_hz"), self.doc.get("source", "exposure_s")
        return (
            self.video_name(),
            float(rate) if isinstance(rate, (int, float)) and rate > 0 else None,
            float(exposure) if isinstance(exposure, (int, float)) else 0.0,
            self.doc.outside,
        )

    def _open_video(self) -> None:
        self._looked_at = name, rate_hz, exposure_s, outside = self._wanted()
        self.video = name
        if not name:
            self.video_problem = "this run has no video"
            return
        try:
            stay_inside(self.doc.folder / RUN_FILE, "source.video", name, outside)
            self.frames = Frames(self.doc.folder / name, rate_hz, exposure_s)
            self.video_problem = ""
            self.index = self.first_analysed()
        except TowlineError as error:
            self.frames, self.video_problem = None, str(error)

    def refresh_video(self) -> bool:
        """Open the recording anew where run.toml names another one, or another clock; whether it did."""
        if self.document is None or self._wanted() == self._looked_at:
            return False
        if self.frames is not None:
            self.frames.close()
            self.frames = None
        self._sight, self._detected = None, {}
        self._open_video()
        return True

    def first_analysed(self) -> int:
        """The first frame in source.span_s."""
        span = self.doc.get("source", "span_s")
        if self.frames is None or not isinstance(span, list) or not span or not isinstance(span[0], (int, float)):
            return 0
        begin_s = float(span[0]) + self.frames.exposure_s / 2
        index = self.frames.at_time(begin_s)
        return index if self.frames.time_s(index) > begin_s - 1e-6 else self.frames.clamp(index + 1)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        if self.frames is not None:
            return self.frames.info.width_px, self.frames.info.height_px
        size = None if self.document is None else self.document.get("camera", "image_size_px")
        return (int(size[0]), int(size[1])) if isinstance(size, list) and len(size) == 2 else (1280, 720)

    def go(self, index: int) -> int:
        """Show another frame; returns the one that is shown."""
        if self.frames is not None:
            self.index = self.frames.clamp(index)
        return self.index

    def frame(self, index: int) -> Frame:
        """A frame as decoded."""
        if self.frames is None:
            raise InputError(self.doc.folder, "", self.video_problem)
        return self.frames.exact(index)

    # picking -------------------------------------------------------------------------------------------------------------

    def snap(self, index: int, click_px: tuple[float, float], zoom: float = 1.0, to_mark: bool = True) -> Snapped:
        """Where a click into a frame landed: the mark next to it, or itself. Changes nothing, so it may run in a thread."""
        from ..vision.recording.codecs import LOSSLESS

        if not to_mark or self.frames is None:
            return as_clicked(click_px, zoom)
        return snapped(self.frame(index), click_px, self.frames.info.codec not in LOSSLESS, zoom)

    def pick_datum(self, found: Snapped) -> int:
        """A click sets a new datum point, or moves the selected one; returns its number."""
        pixel = [round(float(c), DIGITS) for c in found.pixel_px]
        sigma = round(found.sigma_px, DIGITS)
        number, rows = self.selected["datum"], self.doc.rows("datum")
        if 0 <= number < len(rows):
            name = rows[number].get("name") or f"point {number + 1}"
            places = [(("datum", number, "pixel_px"), pixel), (("datum", number, "sigma_px"), sigma)]
            self.doc.set_all(places, f"pick {name}")
            return number
        names = {row.get("name") for row in rows}
        name = next(f"point {k}" for k in range(1, len(rows) + 2) if f"point {k}" not in names)
        row = {"name": name, "pixel_px": pixel, "sigma_px": sigma}
        return self.doc.add_row("datum", row, f"pick {name}")

    def pick_marker(self, found: Snapped) -> int:
        """A click says where the selected marker is in the first analysed frame, or adds one; returns its number."""
        pixel = [round(float(c), 2) for c in found.pixel_px]
        number, rows = self.selected["marker"], self.doc.rows("marker")
        if 0 <= number < len(rows):
            self.doc.set(("marker", number, "seen_at_px"), pixel, f"click {rows[number].get('name', number + 1)}")
            return number
        names = {row.get("name") for row in rows}
        name = next(n for n in ("bow", "stern", *(f"mark {k}" for k in range(3, len(rows) + 4))) if n not in names)
        row = {"name": name, "look": "led", "seen_at_px": pixel}
        return self.doc.add_row("marker", row, f"click {name}")

    def sight(self) -> Sight:
        """The camera as far as it is known; kept until run.toml changes."""
        key = (self.doc.version, f"{self.opened} {self.size_px}")
        kept = self._sight
        if kept is None or kept[0] != key:
            kept = self._sight = (key, sight(self.doc.content, self.size_px, self._lens_covariance()))
        return kept[1]

    def _lens_covariance(self) -> Any:
        """Of the calibration or the standard deviations in [camera]; None where they are not there, or not complete."""
        run = self.run_or_none()
        try:
            return None if run is None else lens_covariance(run)
        except (TowlineError, OSError):
            return None

    def from_above(self, index: int) -> Any:
        """A frame as seen from above, (h, w, 3) BGR; None where there is no camera yet."""
        seen = self.sight()
        kept = self._view
        if kept is None or kept[0] is not seen:
            kept = self._view = (seen, view_of(seen))
        if kept[1] is None or self.frames is None:
            return None
        return kept[1].annotated(self.frames.exact(index).bgr(), f"z = {seen.depth_m:g} m")

    def run_or_none(self) -> Run | None:
        """The run as it stands, checked; None where something is missing."""
        try:
            return self.doc.run()
        except TowlineError:
            return None

    def detect(self, index: int) -> Detected:
        """What the detector sees in a frame; the last few answers are kept."""
        with self._detecting:
            kept, key = self._detected, (self.doc.version, index)
            if key not in kept:
                kept[key] = detected(self.frame(index), self.sight(), self.run_or_none())
                while len(kept) > EXACT:
                    del kept[next(iter(kept))]
            return kept[key]

    # by hand -------------------------------------------------------------------------------------------------------------

    def hand(self) -> ByHand:
        """The clicks by hand, begun or gone on with.

        Raises
        ------
        InputError : there are no two markers to click, or the clicks that are there do not fit them
        """
        names = [str(row["name"]) for row in self.doc.rows("marker") if row.get("name")]
        if len(names) < 2:
            raise InputError(
                self.doc.folder / RUN_FILE, "marker", f"{len(names)} markers; give the bow's and the stern's first"
            )
        if self.by_hand is None or (list(self.by_hand.markers) != names and not self.by_hand.clicks):
            self.by_hand = begun(self.doc.folder, names)
            if not self.by_hand.clicks:
                self.by_hand.frame = self.first_analysed()
        elif list(self.by_hand.markers) != names:
            self.by_hand.markers = names
        return self.by_hand

    def use_hand_tracks(self) -> None:
        """Name the clicks' file as the run's source; the video's name stays as a comment."""
        video = self.doc.get("source", "video")
        changes: list[tuple[tuple[str | int, ...], Any]] = [(("source", "video"), None), (("source", "tracks"), FILE)]
        self.doc.set_all(changes, "use the clicks as tracks")
        if isinstance(video, str) and f'video = "{video}"' not in self.doc.text:
            self.doc.note("source", f'video = "{video}"  # the recording that was digitised by hand')

    def use_video(self) -> None:
        """Track the video again instead of the clicks."""
        changes: list[tuple[tuple[str | int, ...], Any]] = [
            (("source", "tracks"), None),
            (("source", "video"), self.video or self.video_name()),
        ]
        self.doc.set_all(changes, "track the video")

    # corrections ---------------------------------------------------------------------------------------------------------

    def correcting(self) -> Correcting:
        """The corrections of the tracks, begun or gone on with; read again where another program changed them.

        Raises
        ------
        InputError : something is missing in run.toml, it names no video, or the corrections that are there cannot be used
        """
        if self.doc.get("source", "video") is None:
            raise InputError(
                self.doc.folder / RUN_FILE,
                "source.video",
                "none; corrections are of tracks that towline makes of a video",
            )
        kept = self.corrections
        markers = tuple(self.doc.rows("marker"))
        if kept is None or self._corrected != markers or (not kept.dirty and kept.changed_outside):
            run = self.doc.run()
            found = Correcting.of(run)
            if kept is not None and kept.dirty:  # the markers were edited: what is not written stays
                kept.markers = run.file.marker
            else:
                found.version = 0 if kept is None else kept.version + 1
                self.corrections = kept = found
            self._corrected = markers
        return kept

    def analysed(self, index: int) -> bool:
        """Whether a frame lies in source.span_s."""
        span = self.doc.get("source", "span_s")
        if self.frames is None or not isinstance(span, list) or len(span) != 2:
            return True
        t_s = self.frames.time_s(index) - self.frames.exposure_s / 2
        return float(span[0]) - 1e-6 <= t_s <= float(span[1]) + 1e-6

    # results -------------------------------------------------------------------------------------------------------------

    def shown(self) -> Shown:
        """Motion and tracks in out/; read again when something there, or the saved run.toml, changed."""
        folder = self.doc.folder
        paths = [folder / "out" / n for n in ("motion.csv", "tracks.csv")] + [
            folder / n for n in (RUN_FILE, FILE, CORRECTIONS)
        ]
        key = (self.opened, *(p.stat().st_mtime_ns if p.is_file() else 0 for p in paths))
        kept = self._shown
        if kept is None or kept[0] != key:
            try:
                run = read_run(folder)
            except TowlineError:
                run = None
            kept = self._shown = (key, read_shown(run, folder))
        return kept[1]

    def show_page(self, path: Path) -> str:
        """Let a result page be shown; returns its key.

        Raises
        ------
        InputError : it is no file of the run's folder (a link out of it)
        """
        page_file(path, path.name)
        for key, known in self.pages.items():
            if known == path:
                return key
        key = secrets.token_urlsafe(24)
        self.pages[key] = path
        return key


__all__ = ["Session"]
