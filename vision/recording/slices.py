"""What H.264 and HEVC packets tell without being decoded, where the decoder itself says nothing.

A picture that somebody cut out of the file leaves no broken data behind: the decoder predicts the next ones from the wrong
picture. H.264's own count, frame_num (ITU-T H.264, 7.4.3), shows it. A wiped stretch (a lost sector reads as zeros) can be decoded
as a picture, but no unit of either standard holds such bytes (7.4.1).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_SLICE, _SLICE_IDR, _SPS = 1, 5, 7
"""H.264's types of NAL units (table 7-1): a slice, a slice of an IDR picture, a sequence parameter set."""
_HEAD_BYTES = 48
"""The fields read here lie within this much of a slice."""
_SCAN_BYTES = 1 << 16
"""Where NAL units are told by start codes, the first slice is looked for this far into a packet."""
_FORBIDDEN = (b"\0\0\0", b"\0\0\1", b"\0\0\2")
_WIPED = re.compile(rb"\x00\x00\x00+[^\x00\x01]|\x00\x00\x02")
"""The same between start codes, where zeros may only lead up to the next one."""
_HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)
"""H.264's `profile_idc` whose sequence parameter sets state the chroma format (7.3.2.1.1)."""


@dataclass(frozen=True)
class SliceHead:
    """What one packet says of its place in the sequence.

    Attributes
    ----------
    gap : pictures that later ones may predict from are missing before this one
    reference : later pictures may predict from this one
    repeated : it is the key frame before it once more
    """

    gap: bool
    reference: bool
    repeated: bool = False


@dataclass(frozen=True)
class _Sequence:
    number_bits: int
    gaps_allowed: bool
    frames_only: bool
    separate_planes: bool


def holds_forbidden(packet, length_bytes: int) -> bool:
    """Whether a packet of units holds bytes that no unit may hold.

    Parameters
    ----------
    packet : bytes of one packet
    length_bytes : width of the lengths that tell the units apart; 0 = start codes do
    """
    data = bytes(packet)
    if not length_bytes:
        return _WIPED.search(data) is not None
    if not any(pattern in data for pattern in _FORBIDDEN):
        return False
    at = 0
    while at + length_bytes < len(data):
        size = int.from_bytes(data[at : at + length_bytes], "big")
        at += length_bytes
        unit = data[at : at + size].rstrip(b"\0")  # zeros may follow a unit
        if any(pattern in unit for pattern in _FORBIDDEN):
            return True
        at += size
    return False


def length_bytes_of(codec: str, extradata: bytes | None) -> int:
    """Width of the lengths that tell the units of a packet apart; 0 where start codes do.

    Parameters
    ----------
    codec : by ffmpeg's name
    extradata : of the stream
    """
    if extradata and extradata[0] == 1:
        if codec == "h264" and len(extradata) > 6:
            return (extradata[4] & 3) + 1
        if codec == "hevc" and len(extradata) > 22:
            return (extradata[21] & 3) + 1
    return 0


class FrameCount:
    """Follows frame_num through the packets of one stream, in decoding order."""

    def __init__(self, extradata: bytes | None) -> None:
        self._sequence: _Sequence | None = None
        self._length_bytes = length_bytes_of("h264", extradata)
        self._last: int | None = None
        self._last_key: int | None = None
        if extradata and self._length_bytes:
            size = int.from_bytes(extradata[6:8], "big")
            self._learn(extradata[8 : 8 + size])
        elif extradata:
            for unit in _after_start_codes(extradata):
                if unit[0] & 31 == _SPS:
                    self._learn(unit)

    def head(self, packet) -> SliceHead:
        """Read a packet (buffer); what cannot be read counts as no gap: the decoder will say what is wrong with it."""
        view = memoryview(packet)
        units = self._by_length(view) if self._length_bytes else _after_start_codes(bytes(view[:_SCAN_BYTES]))
        try:
            for unit in units:
                kind = unit[0] & 31
                if kind == _SPS:
                    self._learn(unit)
                elif kind in (_SLICE, _SLICE_IDR):
                    return self._slice(unit, kind)
        except (IndexError, ValueError):
            pass
        return SliceHead(False, True)

    def _by_length(self, view: memoryview):
        at, width = 0, self._length_bytes
        while at + width < len(view):
            size = int.from_bytes(view[at : at + width], "big")
            at += width
            if size < 1 or at + size > len(view):
                return
            kind = view[at] & 31
            yield bytes(view[at : at + (size if kind == _SPS else min(size, _HEAD_BYTES))])
            at += size

    def _slice(self, unit: bytes, kind: int) -> SliceHead:
        reference = bool(unit[0] & 0x60)
        sequence = self._sequence
        if sequence is None or sequence.gaps_allowed:
            return SliceHead(False, reference)
        bits = _Bits(unit[1:_HEAD_BYTES])
        bits.golomb()  # first_mb_in_slice
        bits.golomb()  # slice_type
        bits.golomb()  # pic_parameter_set_id
        if sequence.separate_planes:
            bits.take(2)
        number = bits.take(sequence.number_bits)
        field = not sequence.frames_only and bool(bits.take(1))
        if kind == _SLICE_IDR:
            if field:
                bits.take(1)
            key = bits.golomb()  # idr_pic_id: two in a row differ (7.4.3)
            repeated = key == self._last_key and not field
            self._last, self._last_key = number, key
            return SliceHead(False, reference, repeated)
        self._last_key = None
        # a recording may begin within a group of pictures; the decoder leaves those out
        after = None if self._last is None else (self._last + 1) % (1 << sequence.number_bits)
        gap = after is not None and number != after and not (field and number == self._last)
        if reference:
            self._last = number
        return SliceHead(gap, reference)

    def _learn(self, unit: bytes) -> None:
        try:
            self._sequence = _sequence(unit)
        except (IndexError, ValueError):
            self._sequence = None


def _sequence(unit: bytes) -> _Sequence:
    """Read a sequence parameter set (7.3.2.1.1)."""
    profile = unit[1]
    bits = _Bits(unit[4:])
    bits.golomb()  # seq_parameter_set_id
    separate = False
    if profile in _HIGH_PROFILES:
        chroma = bits.golomb()
        separate = chroma == 3 and bool(bits.take(1))
        bits.golomb()  # bit depths
        bits.golomb()
        bits.take(1)
        if bits.take(1):
            for index in range(8 if chroma != 3 else 12):
                if bits.take(1):
                    _skip_scaling(bits, 16 if index < 6 else 64)
    number_bits = bits.golomb() + 4
    order = bits.golomb()
    if order == 0:
        bits.golomb()
    elif order == 1:
        bits.take(1)
        bits.golomb()
        bits.golomb()
        for _ in range(bits.golomb()):
            bits.golomb()
    bits.golomb()  # max_num_ref_frames
    gaps_allowed = bool(bits.take(1))
    bits.golomb()  # size
    bits.golomb()
    if number_bits > 16:
        raise ValueError("log2_max_frame_num is at most 16")
    return _Sequence(number_bits, gaps_allowed, bool(bits.take(1)), separate)


def _skip_scaling(bits: _Bits, size: int) -> None:
    last = following = 8
    for _ in range(size):
        if following:
            code = bits.golomb()
            step = (code + 1) // 2 if code % 2 else -(code // 2)
            following = (last + step) % 256
        last = following or last


def _after_start_codes(data: bytes):
    at = data.find(b"\0\0\1")
    while at >= 0:
        following = data.find(b"\0\0\1", at + 3)
        unit = data[at + 3 : following if following >= 0 else len(data)]
        if unit:
            yield unit
        at = following


class _Bits:
    """A bit reader over a NAL unit's payload; IndexError beyond its end."""

    def __init__(self, data: bytes) -> None:
        data = data.replace(b"\0\0\3", b"\0\0")  # emulation prevention, 7.4.1.1
        self._value = int.from_bytes(data, "big")
        self._left = 8 * len(data)

    def take(self, count: int) -> int:
        self._left -= count
        if self._left < 0:
            raise IndexError("the header ends early")
        return (self._value >> self._left) & ((1 << count) - 1)

    def golomb(self) -> int:
        """ue(v), 9.1."""
        zeros = 0
        while not self.take(1):
            zeros += 1
            if zeros > 31:
                raise ValueError("no Exp-Golomb code")
        return (1 << zeros) - 1 + self.take(zeros)
