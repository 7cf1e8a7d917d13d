"""One run, one source or two: its folder is made when all of them have answered, and what came before waits for that."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..geometry import DatumFit
from ..record.run import Run
from .clock import Times
from .pieces import Opened, Packet, Piece
from .recorder import Recorder


@dataclass(frozen=True)
class Answer:
    """What a source said of itself.

    Attributes
    ----------
    recording : name that its file will have
    size_px : (width, height) of its picture
    """

    recording: str
    size_px: tuple[int, int]


Begin = Callable[[Sequence[Answer]], tuple[Run, list[tuple[Run, DatumFit]]]]
"""Of the answers, in the sources' order: makes the run, which is there from then on; and the run as each camera sees it, with its
datum's fit."""


class Meeting:
    """Where the sources of a run wait for each other.

    Parameters
    ----------
    count : of them
    begin : called once, in the thread of the one that answers last

    Attributes
    ----------
    run : None: they have not all answered
    views : as each camera sees it, with its datum's fit
    """

    def __init__(self, count: int, begin: Begin) -> None:
        self._count, self._begin = count, begin
        self._answers: dict[int, Answer] = {}
        self._lock = threading.Lock()
        self.run: Run | None = None
        self.views: list[tuple[Run, DatumFit]] = []

    def answered(self, place: int, answer: Answer) -> None:
        """A source has answered; again and again, as it may.

        Parameters
        ----------
        place : which one
        answer : what it said
        """
        with self._lock:
            self._answers[place] = answer
            if self.run is None and len(self._answers) == self._count:
                self.run, self.views = self._begin([self._answers[k] for k in range(self._count)])


class MeetingRecorder(Recorder):
    """A recorder whose folder is made by a meeting, in the threads that hear.

    Parameters
    ----------
    folder : of the run
    stem : of the recording's name
    meeting : of all that film this run
    place : which of them this is
    """

    def __init__(self, folder: Path, stem: str, meeting: Meeting, place: int) -> None:
        super().__init__(folder, stem)
        self._meeting, self._place = meeting, place
        self._waiting: list[Piece] = []
        self.early: list[tuple[Packet, Times]] = []

    def take(self, piece: Piece) -> Times | None:
        """As ``Recorder.take``; what comes before all have answered is kept, and then written first, and told of by ``early``."""
        if self._meeting.run is None:
            if isinstance(piece, Opened):
                self._waiting.clear()  # of a source that went and came back: its packets are another stream's
                self._meeting.answered(self._place, Answer(self.name_for(piece), piece.size_px))
            if self._meeting.run is None:
                self._waiting.append(piece)
                return None
        for old in self._waiting:
            times = super().take(old)
            if isinstance(old, Packet) and times is not None:
                self.early.append((old, times))
        self._waiting.clear()
        return super().take(piece)


__all__ = ["Answer", "Begin", "Meeting", "MeetingRecorder"]
