"""One tow from the first packet to the last: heard, recorded, seen, watched, written down."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from ..geometry import DatumFit
from ..record.errors import TrackingError, VideoError
from ..record.run import Run
from .arrivals import Arrival, ArrivalWatch
from .aside import TrackingAside
from .clock import Times
from .decoding import Decoding
from .event import Event
from .joining import Joining
from .log import LOG
from .meeting import Begin, Meeting, MeetingRecorder
from .picture import Pictures
from .pieces import Ended, Opened, Packet, Piece
from .ready import Line, Ready
from .resting import Resting
from .seen import Seeing, Seen, Valued
from .source import Hearing, kind_of
from .stamped import Stamped
from .watch import WALL_M, Watch

TICK_S = 0.1
"""How often a silent source is looked at."""
LATE_S = 0.1
"""A frame whose values come later than this after its last byte is late."""
BEHIND_S, CAUGHT_UP = 1.0, 2
"""Who looks is so far behind what comes: frames are decoded and recorded, and not looked at, until no more than so many wait.
Old values help nobody."""
READY_S, READY_EVERY_S = 3.0, 2.0
"""From the first frame on until what is said before a tow rests on enough of them; it is said again so often."""


@dataclass(frozen=True)
class Wanted:
    """What is to be named while a tow is filmed, and whether it is to be shown.

    Attributes
    ----------
    wall_m : less room to the wall
    x_v_m : of a steady tow, that X_v's 95 % interval is no wider than so much to either side; None: no such wish
    pictures : small ones go into out/live.jpg, a few times a second
    """

    wall_m: float = WALL_M
    x_v_m: float | None = None
    pictures: bool = False


USUAL = Wanted()
"""Where nobody says anything."""


class Telling(Protocol):
    """Who shows what is seen."""

    def frame(self, seen: Seen, latency_s: float) -> None:
        """A frame's values."""
        ...

    def event(self, event: Event) -> None:
        """Something was named."""
        ...

    def ready(self, lines: list[Line]) -> None:
        """What is to be said before the tow; again and again, as it changes."""
        ...

    def steady(self, told: dict[str, Any]) -> None:
        """Where a steady tow comes to rest, as it stands in live.jsonl."""
        ...

    def camera(self, name: str) -> Telling:
        """Who shows what one of two cameras sees."""
        ...

    def joint(self, told: dict[str, Any]) -> None:
        """What two cameras say together, of a frame or of their clocks, as it stands in the run's live.jsonl."""
        ...

    def ended(self) -> None:
        """The film is whole; its tracks may not be."""
        ...


@dataclass
class Counts:
    """What became of the frames.

    Attributes
    ----------
    packets : recorded
    frames : decoded and looked at
    not_looked_at : decoded and recorded, but no values: who looks was too far behind
    undecoded : packets that gave no picture
    late : values that came later than ``LATE_S`` after the frame's last byte
    missing, damaged : by the source's stamps; by the decoder
    """

    packets: int = 0
    frames: int = 0
    not_looked_at: int = 0
    undecoded: int = 0
    late: int = 0
    missing: int = 0
    damaged: int = 0

    @property
    def words(self) -> str:
        """One line."""
        parts = [f"{self.packets} pictures recorded", f"{self.frames} looked at"]
        for name in ("not_looked_at", "undecoded", "late", "missing", "damaged"):
            if count := getattr(self, name):
                parts.append(f"{count} {name.replace('_', ' ')}")
        return ", ".join(parts)


class Looking:
    """What is seen and named of one tow's frames: stamped frames in, values and events out; it knows no clock.

    Parameters
    ----------
    run : as its run.toml says
    fit : of its datum
    codec : of the frames, by ffmpeg's name
    wall_m : room to the wall that is wanted
    """

    def __init__(self, run: Run, fit: DatumFit, codec: str, wall_m: float = WALL_M) -> None:
        self._made = lambda: Seeing(run, fit, codec)
        self._seeing = self._made()
        self.watch, self.ready = Watch(run, wall_m), Ready(run, fit)

    def step(self, stamped: Stamped) -> tuple[Seen | None, list[Event]]:
        """Take the next frame; None: nothing can be told of it."""
        try:
            seen = self._seeing.step(stamped)
        except TrackingError as error:
            self._seeing = self._made()
            return None, [Event("mark", stamped.frame.t_s, str(error), "fault")]
        self.ready.step(seen)
        return seen, self.watch.step(seen)

    def passed_by(self, stamped: Stamped) -> list[Event]:
        """A frame came for which there is no time; what its times say is to be named all the same."""
        arrival = Arrival(stamped.frame.t_s, stamped.arrived_s, stamped.by_source)
        return list(self.watch.arrivals.step(arrival))

    def settle(self) -> None:
        """What takes longer, when the values have gone out."""
        try:
            self._seeing.settle()
        except TrackingError:
            self._seeing = self._made()

    @property
    def arrivals(self) -> ArrivalWatch:
        """Frames by their times."""
        return self.watch.arrivals


def live_tow(
    sources: Sequence[str],
    stems: Sequence[str],
    folder: Path,
    begin: Begin,
    telling: Telling,
    stopped: Callable[[], bool],
    wanted: Wanted = USUAL,
    track: bool = True,
    resting: Callable[[Run], Resting | None] = lambda _: None,
) -> tuple[Counts, ...]:
    """Film one tow: until ``stopped`` says so, or all sources have ended.

    Parameters
    ----------
    sources : as typed; one, or one for each of the run's cameras
    stems : what their recordings are called, before the suffix
    folder : of the run; made by ``begin``
    begin : makes the run when all have answered
    telling : is told what is seen
    stopped : whether to end
    wanted : what is to be named and shown
    track : make its tracks of the recording while that grows, so that they are there at its end
    resting : begins to tell of a tow where it comes to rest; None: it is no tow for that

    Returns
    -------
    counts : of each source

    Raises
    ------
    VideoError : a source does not answer, or ends before a frame has come
    TowlineError : no run can be made for it
    """
    meeting, came = Meeting(len(sources), begin), threading.Event()
    feeds = [
        _Feed(source, MeetingRecorder(folder, stem, meeting, place), came)
        for place, (source, stem) in enumerate(zip(sources, stems, strict=True))
    ]
    ending = False
    rests: Resting | None = None
    pair: _Pair | None = None
    asides: list[TrackingAside] = []
    for feed in feeds:
        feed.hearing.start()
    try:
        while not all(feed.ended for feed in feeds):
            # a camera that is gone does not end the tow for the other; before the run is there, it does
            if not ending and (stopped() or (meeting.run is None and any(feed.ended for feed in feeds))):
                ending = True
                for feed in feeds:
                    feed.hearing.stop()
            came.clear()
            some = False
            for feed in feeds:
                if feed.ended:
                    continue
                piece, times = feed.heard()
                some = some or piece is not None
                if meeting.run is None:
                    continue
                if not feed.begun:
                    place = feeds.index(feed)
                    view, fit = meeting.views[place]
                    feed.begin(view, fit, telling if len(feeds) == 1 else telling.camera(view.camera), wanted)
                feed.take(piece, times)
                feed.catch_up()
            if not some:
                came.wait(TICK_S)
            if meeting.run is None:
                continue
            if pair is None and len(feeds) > 1:
                pair = _Pair(meeting, sources, telling)
            if pair is not None:
                pair.tell()
            if track and not asides and all(feed.said for feed in feeds):
                asides = [TrackingAside(meeting.run, place) for place in range(len(feeds))]
            if rests is None and len(feeds) == 1 and feeds[0].said and not feeds[0].ended and not feeds[0].asked:
                feeds[0].asked, rests = True, resting(meeting.run)
            for told in rests.told() if rests is not None else ():
                feeds[0].steady(told)
    except BaseException:
        for aside in asides:
            aside.drop()
        raise
    finally:
        for feed in feeds:
            feed.hearing.stop()
        for feed in feeds:
            feed.hearing.join()
            feed.close()
        if rests is not None:
            rests.end()
        if pair is not None:
            pair.close()
    telling.ended()
    for aside in asides:
        aside.end()
    return tuple(feed.counted() for feed in feeds)


class _Pair:
    """Two cameras' joint course, written down and told as it comes."""

    def __init__(self, meeting: Meeting, sources: Sequence[str], telling: Telling) -> None:
        assert meeting.run is not None
        by_arrival = all(kind_of(source) != "file" for source in sources)
        self._joining = Joining(meeting.run, [fit for _, fit in meeting.views], by_arrival)
        self._scribe = _Scribe(telling)
        self._scribe.open(meeting.run)

    def tell(self) -> None:
        """What is new."""
        for told in self._joining.told():
            self._scribe.joint(told)

    def close(self) -> None:
        """The cameras' logs are whole."""
        for told in self._joining.rest():
            self._scribe.joint(told)
        self._joining.end()
        self._scribe.close()


class _Feed:
    """One source: heard, recorded, and, when the run is there, looked at."""

    def __init__(self, source: str, recorder: MeetingRecorder, came: threading.Event) -> None:
        self._source, self._recorder = source, recorder
        self.hearing = Hearing(source, recorder.take, came)
        self._opened: Opened | None = None
        self._begun: tuple[Run, DatumFit, _Scribe, Wanted] | None = None
        self._tow: _Tow | None = None
        self.ended, self.asked, self._error, self._last_s = False, False, "", 0.0

    def heard(self) -> tuple[Piece | None, Times | None]:
        """The next piece; None: nothing has come."""
        try:
            piece, times = self.hearing.pieces.get_nowait()
        except queue.Empty:
            return None, None
        if isinstance(piece, Ended):
            self.ended, self._error = True, piece.error
        if isinstance(piece, Opened):
            if self._tow is not None:
                self._tow.decoding.again(piece)
            self._opened = piece
        return piece, times

    @property
    def begun(self) -> bool:
        """The run is there."""
        return self._begun is not None

    def begin(self, view: Run, fit: DatumFit, telling: Telling, wanted: Wanted) -> None:
        """The run is there."""
        scribe = _Scribe(telling)
        scribe.open(view)
        self._begun = view, fit, scribe, wanted

    def take(self, piece: Piece | None, times: Times | None) -> None:
        """Look at what was heard."""
        if self._tow is None and self._opened is not None and self._begun is not None:
            view, fit, scribe, wanted = self._begun
            looking = Looking(view, fit, self._opened.codec, wanted.wall_m)
            self._tow = _Tow(Decoding(self._opened), looking, scribe, Pictures(view) if wanted.pictures else None)
        if isinstance(piece, Ended) and piece.error and self._begun is not None and self._recorder.packets:
            said = f"the source ended: {piece.error}"
            self._begun[2].event(Event("source", self._last_s, said, "fault"))
        if self._tow is None or isinstance(piece, (Opened, Ended)):
            return
        self._last_s = self._last_s if times is None else times.t_s
        while self._recorder.early:
            self._tow.pass_by(*self._recorder.early.pop(0))
        self._tow.take(piece, times, self.hearing.pieces.qsize())

    def catch_up(self) -> None:
        """Of a source that fell behind all is taken that waits: one at a time, after each frame of the other that is looked at, it
        would never get there."""
        while self._tow is not None and self._tow.behind and not self.ended and self.hearing.pieces.qsize():
            piece, times = self.heard()
            self.take(piece, times)

    def steady(self, told: dict[str, Any]) -> None:
        """Where the tow comes to rest."""
        if self._begun is not None:
            self._begun[2].steady(told)

    @property
    def said(self) -> bool:
        """What is to be said before a tow was said."""
        return self._tow is not None and self._tow.said

    def close(self) -> None:
        """No more is shown or written."""
        if self._tow is not None:
            self._tow.close()
        if self._begun is not None:
            self._begun[2].close()

    def counted(self) -> Counts:
        """What became of its frames."""
        counts = Counts() if self._tow is None else self._tow.counted(self._recorder.packets)
        if not counts.packets:
            said = self._error or "no picture came"
            raise VideoError(said if said.startswith(self._source) else f"{self._source}: {said}")
        return counts


class _Tow:
    """The loop's body: a piece in, what is said out."""

    def __init__(self, decoding: Decoding, looking: Looking, scribe: _Scribe, pictures: Pictures | None) -> None:
        self.decoding, self._looking, self._scribe, self._pictures = decoding, looking, scribe, pictures
        self._counts = Counts()
        self._said_s: float | None = None
        self.behind = False
        self._began_s: float | None = None

    def take(self, piece: Piece | None, times: Times | None, waiting: int) -> None:
        """A packet, or None: nothing has come."""
        if not isinstance(piece, Packet) or times is None:
            for event in self._looking.watch.tick(time.monotonic()):
                self._scribe.event(event)
            return
        for stamped in self.decoding.step(piece, times.t_s):
            usual = self._looking.arrivals.usual_s
            self.behind = waiting > CAUGHT_UP and (self.behind or (usual is not None and waiting * usual > BEHIND_S))
            if self.behind:
                self._counts.not_looked_at += 1
                for event in self._looking.passed_by(stamped):
                    self._scribe.event(event)
            else:
                self._look(stamped, waiting)

    def pass_by(self, packet: Packet, times: Times) -> None:
        """A packet that came before anybody could look."""
        for stamped in self.decoding.step(packet, times.t_s):
            self._counts.not_looked_at += 1
            for event in self._looking.passed_by(stamped):
                self._scribe.event(event)

    @property
    def said(self) -> bool:
        """What is to be said before a tow was said."""
        return self._said_s is not None

    def close(self) -> None:
        """No more is shown."""
        if self._pictures is not None:
            self._pictures.close()

    def _look(self, stamped: Stamped, waiting: int) -> None:
        seen, events = self._looking.step(stamped)
        latency_s = time.monotonic() - stamped.arrived_s
        for event in events:
            self._scribe.event(event)
        if seen is not None:
            self._scribe.frame(seen, latency_s)
            self._counts.frames += 1
            self._counts.late += latency_s > LATE_S
            if self._pictures is not None:
                self._pictures.offer(stamped.frame, seen.marks, waiting > 0)
        t_s = stamped.frame.t_s
        self._began_s = t_s if self._began_s is None else self._began_s
        if t_s - (self._began_s if self._said_s is None else self._said_s) >= (READY_EVERY_S if self.said else READY_S):
            self._said_s = t_s
            self._scribe.ready(t_s, self._looking.ready.lines(self._looking.arrivals))
        self._looking.settle()

    def counted(self, packets: int) -> Counts:
        """What became of the frames."""
        counts = self._counts
        counts.packets, counts.undecoded = packets, self.decoding.damaged
        counts.missing, counts.damaged = self._looking.arrivals.missing, self._looking.watch.damage.count
        return counts


class _Scribe:
    """Writes everything down as it happens, and tells it."""

    def __init__(self, telling: Telling) -> None:
        self._telling = telling
        self._file: TextIO | None = None

    def open(self, run: Run) -> None:
        run.out.mkdir(parents=True, exist_ok=True)
        self._file = (run.out / LOG).open("w", encoding="utf-8", newline="\n")

    def frame(self, seen: Seen, latency_s: float) -> None:
        self._write(frame_record(seen, latency_s))
        self._telling.frame(seen, latency_s)

    def event(self, event: Event) -> None:
        self._write({"event": event.kind, "t_s": round(event.t_s, 6), "level": event.level, "words": event.words})
        self._telling.event(event)

    def ready(self, t_s: float, lines: list[Line]) -> None:
        for line in lines:
            self._write({"ready": line.what, "t_s": round(t_s, 6), "good": line.good, "words": line.words})
        self._telling.ready(lines)

    def steady(self, told: dict[str, Any]) -> None:
        self._write(told)
        self._telling.steady(told)

    def joint(self, told: dict[str, Any]) -> None:
        if "arrived_s" in told:
            told = told | {"latency_s": round(time.monotonic() - told["arrived_s"], 4)}
        self._write(told)
        self._telling.joint(told)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def _write(self, record: dict[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(record, allow_nan=False) + "\n")
            self._file.flush()


def frame_record(seen: Seen, latency_s: float) -> dict[str, Any]:
    """A frame's line of live.jsonl: numbers as [value, sd, common sd]; null where there is none.

    Parameters
    ----------
    seen : the frame
    latency_s : from its last byte to its values
    """
    marks = {
        m.marker: [_plain(x, 4) for x in (m.u_px, m.v_px, m.sigma_u_px, m.sigma_v_px)] if m.seen else m.reason
        for m in seen.marks
    }
    return {
        "frame": seen.index,
        "t_s": round(seen.t_s, 6),
        "arrived_s": round(seen.arrived_s, 4),
        "latency_s": round(latency_s, 4),
        "damaged": seen.damaged,
        "marks": marks,
        **{name: _numbers(getattr(seen, name)) for name in ("y_cg_m", "beta_rad", "alpha_rad", "slack_m")},
        "camera_turn_rad": None if seen.turn is None else _plain(seen.turn.angle_rad, 7),
        "light": _plain(seen.light, 7),
        **({} if seen.by_source else {"on_arrival": True}),
        "lag_px": {m.marker: round(m.lag_px, 4) for m in seen.marks if m.lag_px},
    }


def _numbers(value: Valued) -> list[float | None] | None:
    if not np.isfinite(value.value):
        return None
    return [_plain(x, 7) for x in (value.value, value.sd, value.common_sd)]


def _plain(value: float, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


__all__ = ["Counts", "Looking", "Telling", "frame_record", "live_tow"]
