"""Matroska's checksums: elements that are not as they were written.

libavformat (and with it OBS, ffmpeg and many recorders) gives every cluster a CRC-32. ffmpeg does not check it on reading.
"""

from __future__ import annotations

import zlib
from pathlib import Path

_CLUSTER, _SEGMENT, _CRC = 0x1F43B675, 0x18538067, 0xBF
"""Element IDs of the Matroska specification (RFC 9559): Cluster, Segment; and EBML's CRC-32 (RFC 8794)."""
_TIMING = (0x1549A966, 0x1654AE6B)
"""Info (unit of time) and Tracks."""
_OTHERS = (0x114D9B74, 0x1C53BB6B, 0x1043A770, 0x1941A469, 0x1254C367, 0xEC)
"""What else stands beside the clusters: SeekHead, Cues, Chapters, Attachments, Tags, Void."""
_CRC_BYTES = 6
"""A CRC-32 element: one byte of ID, one of size, four of the sum."""


class MatroskaSums:
    """Checks the checksums of a Matroska file's elements, in step with its packets; without checksums there is nothing to say.

    Attributes
    ----------
    timing_damaged : the elements that give the unit of time are not as they were written
    start_damaged : nor is the first cluster, whose time the recording starts at
    """

    def __init__(self, path: str | Path) -> None:
        self._file = Path(path).open("rb")  # noqa: SIM115 - closed by close()
        self._end = self._file.seek(0, 2)
        self.timing_damaged = False
        self._header_has_sums = self._clusters_have_sums = False
        self._bad: list[tuple[int, int]] = []
        self._at = self._first_child()
        while self._at < self._end and not self._step():
            pass
        self.start_damaged = bool(self._bad)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def damaged_at(self, place: int | None) -> bool:
        """Whether the byte at ``place`` lies in an element that is not as it was written."""
        if place is None:
            return False
        while self._at <= place and self._at < self._end:
            self._step()
        self._bad = [span for span in self._bad if span[1] > place]
        return any(start <= place for start, _ in self._bad)

    def _first_child(self) -> int:
        head = self._element(0)
        segment = self._element(head[2]) if head is not None else None
        return segment[1] if segment is not None and segment[0] == _SEGMENT else self._end

    def _step(self) -> bool:
        """Check the element at the present place and go on to the next; True for a cluster."""
        start = self._at
        element = self._element(start)
        if element is None or element[2] > self._end:
            self._at = self._next_cluster(start + 1)
            # the last one runs over the end of a recording that was cut: nothing against what is left of it
            if self._header_has_sums and self._at < self._end:
                self._bad.append((start, self._at))
            return False
        identity, content, self._at = element
        right = self._sum_is_right(content, self._at)
        if identity == _CLUSTER:
            if right is False or (right is None and self._clusters_have_sums):
                self._bad.append((start, self._at))
            self._clusters_have_sums |= right is not None
        elif identity in _TIMING:
            self._header_has_sums |= right is not None
            self.timing_damaged |= right is False
        elif identity not in _OTHERS and self._header_has_sums:
            self._bad.append((start, self._at))
        return identity == _CLUSTER

    def _element(self, at: int) -> tuple[int, int, int] | None:
        """Identity, start and end of the content of the element at ``at``; None where there is none."""
        self._file.seek(at)
        head = self._file.read(12)
        width = 8 - (head[0].bit_length() if head else 0) + 1
        if not head or width > 4:
            return None
        identity = int.from_bytes(head[:width], "big")
        rest = head[width:]
        size_width = 8 - (rest[0].bit_length() if rest else 0) + 1
        if not rest or size_width > 8:
            return None
        size = int.from_bytes(rest[:size_width], "big") & ((1 << 7 * size_width) - 1)
        content = at + width + size_width
        if size == (1 << 7 * size_width) - 1:  # not known (a live recording): up to the end, and without a checksum
            return identity, content, self._end
        return identity, content, content + size

    def _sum_is_right(self, content: int, end: int) -> bool | None:
        self._file.seek(content)
        head = self._file.read(_CRC_BYTES)
        if len(head) < _CRC_BYTES or head[0] != _CRC or head[1] != 0x84:
            return None
        found = 0
        left = end - content - _CRC_BYTES
        while left > 0:
            part = self._file.read(min(left, 1 << 20))
            if not part:
                return False
            found = zlib.crc32(part, found)
            left -= len(part)
        return found == int.from_bytes(head[2:6], "little")

    def _next_cluster(self, at: int) -> int:
        mark = _CLUSTER.to_bytes(4, "big")
        while at < self._end:
            self._file.seek(at)
            part = self._file.read(1 << 20)
            found = part.find(mark)
            if found >= 0:
                return at + found
            if len(part) < len(mark):
                break
            at += len(part) - len(mark) + 1
        return self._end
