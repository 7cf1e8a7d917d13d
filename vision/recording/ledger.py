"""Which packet became which picture, and which pictures can be trusted.

What went into the decoder and never came out is lost; what was decoded after damage and before the next key frame predicts from
it. Pictures are held back until all that they may predict from is known; without B frames that is no delay at all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

MOST_REORDERED = 16
"""No picture is shown further than this from its place in decoding order (the decoded picture buffer of H.264 and HEVC)."""
LONGEST_STEPS = 1.5
"""Packets further apart than this many usual steps have lost one between them."""
_INTRA = 1
"""FFmpeg's AV_PICTURE_TYPE_I."""


@dataclass(slots=True, eq=False)
class Picture:
    """A picture, or the place where one should have been.

    Attributes
    ----------
    number : of its packet, in decoding order
    stamp : presentation timestamp, in the stream's time base; None where the container has none
    decode_stamp : decoding timestamp, likewise
    hidden : the container's edit list leaves it out
    key : predicts from nothing, and nothing after it predicts from what came before
    raw : the decoder's frame, once it is out
    index : its place in the recording, from 0, lost ones counted
    damaged : it, or something it may predict from, could not be decoded as it was written
    spoils : later ones may predict from what is damaged here
    reference : later ones may predict from it
    """

    number: int
    stamp: int | None
    decode_stamp: int | None
    hidden: bool = False
    key: bool = False
    raw: Any = None
    index: int = -1
    damaged: bool = False
    spoils: bool = False
    reference: bool = True
    failed: bool = False
    lost: bool = False
    judged: bool = False


@dataclass(frozen=True)
class Places:
    """Timestamps for a stream whose pictures come in another order than theirs.

    Attributes
    ----------
    stamps : all of them, in order
    unordered : they were written in decoding order, so that hardly a picture has its own; else one that stands elsewhere is wrong
    """

    stamps: Sequence[int]
    unordered: bool


class OrderError(Exception):
    """Pictures and their timestamps are in different orders; in words for the user."""

    def __init__(self) -> None:
        super().__init__(
            "its pictures and their timestamps are in different orders; each picture takes the time of its place"
        )


class Ledger:
    """Follows the pictures of one stream through its decoder.

    Parameters
    ----------
    intra_only : no picture predicts from another
    one_to_one : every packet holds one picture to be shown
    shuffled : timestamps follow the decoding order; each picture takes the one of its place among the pictures shown
    step : usual distance of two timestamps, ticks; 0 = a gap between them leaves no picture's place uncertain
    places : a picture takes the timestamp of its place, whatever its own packet says

    Attributes
    ----------
    shuffled : as above; also where the first packet has no timestamp
    entered, shown : packets that went in, pictures that came out
    """

    def __init__(
        self,
        intra_only: bool,
        one_to_one: bool,
        shuffled: bool,
        step: float = 0.0,
        places: Places | None = None,
    ) -> None:
        self._intra_only, self._one_to_one, self.shuffled = intra_only, one_to_one, shuffled or places is not None
        self._places = places
        self._longest_step = LONGEST_STEPS * step
        self._inside: dict[int, Picture] = {}
        self._order: deque[Picture] = deque()
        self._queue: deque[Picture] = deque()
        self._lost: list[Picture] = []
        self._ranks: deque[int | None] = deque()
        self._ranked = self._count = 0
        # a recording that begins within a group of pictures lacks what its first ones predict from
        self._spoiled, self._spoiled_before = not intra_only, False
        self._key_stamp: int | None = None
        self._given_up: dict[int, Picture] = {}
        self._upset = False
        self._latest: int | None = None
        self._decoded: int | None = None
        self.entered = self.shown = 0

    def enter(self, picture: Picture) -> None:
        """A packet goes into the decoder."""
        if not self.entered and picture.stamp is None:
            self.shuffled = True
        self.entered += 1
        self._upset |= picture.damaged
        self._order.append(picture)
        if not picture.hidden:
            self._inside[picture.number] = picture
            if self.shuffled and self._places is None:
                self._rank(picture)
        if picture.decode_stamp is not None:
            self._decoded = picture.decode_stamp

    def fail(self, picture: Picture) -> None:
        """The decoder reports an error with this packet; a picture may come out all the same."""
        picture.failed = picture.damaged = self._upset = True
        picture.spoils |= picture.reference

    def show(self, raw: Any) -> None:
        """A picture comes out, in the order of presentation.

        Raises
        ------
        OrderError : sound pictures come in another order than that of their timestamps
        """
        number = next(iter(self._inside), None) if raw.pts is None else raw.pts
        self._upset |= raw.is_corrupt
        if number not in self._inside:
            late = self._given_up.get(-1 if number is None else number)
            if late is not None and late.stamp is not None and self._latest is not None and not self._upset:
                raise OrderError
            return  # a casualty of damage, or a packet's second picture: there is no time for it
        picture = self._inside.pop(number)
        self.shown += 1
        raw.pts, picture.raw = picture.stamp, raw
        picture.key = raw.key_frame and raw.pict_type == _INTRA
        if raw.is_corrupt:
            picture.damaged = True
            picture.spoils |= picture.reference
        # the two fields of a picture may come in two packets
        if not raw.interlaced_frame:
            self._miss(picture)
        if self._late(picture):
            picture.raw, picture.lost = None, True
        else:
            self._queue.append(picture)
        self._judge()

    def end(self) -> None:
        """Nothing more comes out."""
        for picture in list(self._inside.values()):
            self._lose(picture)
        self._judge()

    def ready(self) -> Iterator[Picture]:
        """Pictures whose worth is known, in the order of presentation."""
        while self._queue and self._queue[0].judged:
            picture = self._queue.popleft()
            before = [lost for lost in self._lost if self._precedes(lost, picture)]
            self._lost = [lost for lost in self._lost if lost not in before]
            picture.index = self._count + len(before)
            self._count = picture.index + 1
            if self.shuffled:
                own, picture.stamp = picture.stamp, self._stamp_of_rank(picture.index)
                picture.damaged |= self._places is not None and not self._places.unordered and own != picture.stamp
            elif picture.stamp is None:
                continue  # a picture without time among pictures with time: a gap
            yield picture

    def _precedes(self, a: Picture, b: Picture) -> bool:
        if self.shuffled or a.stamp is None or b.stamp is None:
            return a.number < b.number
        return a.stamp < b.stamp

    def _rank(self, picture: Picture) -> None:
        """Keep the timestamp; at a gap it is not known which of the pictures near it stand before it and which after."""
        before = self._decoded
        self._ranks.append(picture.decode_stamp)
        if not before or picture.decode_stamp is None or self._intra_only or not self._longest_step:
            return
        if picture.decode_stamp - before > self._longest_step:
            for near in (*self._inside.values(), *self._queue):
                near.damaged = True

    def _stamp_of_rank(self, index: int) -> int | None:
        if self._places is not None:
            return self._places.stamps[index] if index < len(self._places.stamps) else None
        stamp = None
        while self._ranked <= index and self._ranks:
            stamp = self._ranks.popleft()
            self._ranked += 1
        return stamp

    def _miss(self, shown: Picture) -> None:
        """What should have come out before ``shown`` will not come any more."""
        for picture in list(self._inside.values()):
            passed = not self.shuffled and self._precedes(picture, shown)
            if passed or picture.number + MOST_REORDERED < shown.number:
                self._lose(picture)

    def _lose(self, picture: Picture) -> None:
        """Give a picture up; only pictures that are handed out need ``damaged``."""
        del self._inside[picture.number]
        picture.lost = True
        if self._one_to_one or picture.failed:
            self._given_up[picture.number] = picture
            self._given_up.pop(picture.number - 4 * MOST_REORDERED, None)
            picture.spoils |= picture.reference
            self._lost.append(picture)

    def _late(self, picture: Picture) -> bool:
        """Damage upsets the decoder's own order; a picture that comes after its time is a casualty, not a wrong timestamp."""
        if self.shuffled or picture.stamp is None:
            return False
        if self._latest is not None and picture.stamp <= self._latest:
            return self._upset
        self._latest = picture.stamp
        return False

    def _judge(self) -> None:
        while self._order and (self._order[0].raw is not None or self._order[0].lost or self._order[0].hidden):
            picture = self._order.popleft()
            picture.judged = True
            if picture.key:
                # an encoder's first group predicts from itself, whatever it shows before its key frame
                self._spoiled_before = self._spoiled and self._key_stamp is not None
                self._spoiled, self._key_stamp = False, picture.stamp
                self._upset = picture.damaged or any(other.damaged for other in self._order)
            elif self._key_stamp is not None and picture.stamp is not None and picture.stamp < self._key_stamp:
                # shown before the key frame: may predict from the group before, and nothing shown after it predicts from this
                picture.damaged |= self._spoiled_before or self._spoiled
                self._spoiled_before |= picture.spoils
                continue
            picture.damaged |= self._spoiled
            self._spoiled |= picture.spoils and not self._intra_only
