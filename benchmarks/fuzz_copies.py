"""The clip of benchmarks/fuzz.py, whose every frame is known, and the ways to break it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

WIDTH, HEIGHT, FRAMES, RATE_HZ = 640, 480, 120, 30
BITS, BLOCK_PX, FIRST_BLOCK_PX = 8, 40, 24
WINDOW_PX = 8


@dataclass(frozen=True)
class Copy:
    """One broken copy.

    Attributes
    ----------
    suffix, kind, seed : container, how it is broken, seed of the breaking
    """

    suffix: str
    kind: str
    seed: int


# the clip -----------------------------------------------------------------------------------------------------------


def spots_px(number: int) -> np.ndarray:
    """Centres of the two spots, (2, 2)."""
    return np.array(
        [
            [160 + 1.3 * number, 200 + 30 * np.sin(number / 15)],
            [420 + 0.4 * number, 280 - 20 * np.cos(number / 11)],
        ]
    )


def picture(number: int, ground: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Luma of a frame, (h, w) uint8."""
    shown = ground.copy()
    for u, v in spots_px(number):
        y, x = np.mgrid[round(v) - 12 : round(v) + 13, round(u) - 12 : round(u) + 13]
        shown[y, x] += 150 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.2**2))
    for bit in range(BITS):
        left = FIRST_BLOCK_PX + BLOCK_PX * bit
        shown[16:48, left : left + 32] = 190 if number >> bit & 1 else 40
    shown += rng.normal(0, 1.5, shown.shape)
    return np.clip(np.rint(shown), 16, 235).astype(np.uint8)


def number_of(luma: np.ndarray) -> int:
    """The number that a frame carries."""
    means = [luma[20:44, FIRST_BLOCK_PX + BLOCK_PX * bit + 4 :][:, :24].mean() for bit in range(BITS)]
    return sum((mean > 115) << bit for bit, mean in enumerate(means))


def make_clip(path: Path, b_frames: int) -> None:
    """Encode the clip."""
    import av

    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    ground = 60 + 12 * np.sin(u / 60) + 10 * np.cos(v / 45)
    rng = np.random.default_rng(5)
    coder = f"scenecut=0:b-adapt=0:bframes={b_frames}:keyint=30:min-keyint=30:threads=1"
    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as target:
        stream = target.add_stream("libx264", rate=RATE_HZ)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"crf": "21", "preset": "veryfast", "x264-params": coder}
        for number in range(FRAMES):
            planes = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
            planes[:HEIGHT] = picture(number, ground, rng)
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts = number
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))


def spot_windows(luma: np.ndarray, number: int) -> np.ndarray:
    """Surroundings of both spots, (2, s, s) int16."""
    return np.array(
        [
            luma[round(v) - WINDOW_PX : round(v) + WINDOW_PX + 1, round(u) - WINDOW_PX : round(u) + WINDOW_PX + 1]
            for u, v in spots_px(number)
        ],
        dtype=np.int16,
    )


# breaking it --------------------------------------------------------------------------------------------------------


def _packets(path: Path) -> list:
    import av

    with av.open(str(path)) as source:
        return [(bytes(p), p.pts, p.dts, p.is_keyframe) for p in source.demux(video=0) if p.size]


def regions(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Byte offsets of what describes the pictures (header, index, block headers) and of the pictures themselves."""
    data = path.read_bytes()
    is_picture = np.zeros(len(data), bool)
    at = 0
    for payload, *_ in _packets(path):
        at = data.index(payload, at)
        is_picture[at : at + len(payload)] = True
        at += len(payload)
    return np.flatnonzero(~is_picture), np.flatnonzero(is_picture)


def flipped(count: int, in_index: bool) -> Callable[[Path, np.random.Generator], bytes]:
    """Flip ``count`` bits."""

    def change(path: Path, rng: np.random.Generator) -> bytes:
        data = bytearray(path.read_bytes())
        for offset in rng.choice(regions(path)[0 if in_index else 1], count):
            data[offset] ^= 1 << int(rng.integers(8))
        return bytes(data)

    return change


def wiped(path: Path, rng: np.random.Generator) -> bytes:
    """Zeros in place of a stretch, as after a bad sector."""
    data = bytearray(path.read_bytes())
    length = int(rng.choice([64, 512, 4096]))
    start = int(rng.integers(0, len(data) - length))
    data[start : start + length] = bytes(length)
    return bytes(data)


def truncated(path: Path, rng: np.random.Generator) -> bytes:
    """The end is missing."""
    data = path.read_bytes()
    return data[: int(rng.integers(1, len(data)))]


def remuxed(doubled: bool, length: int) -> Callable[[Path, np.random.Generator], bytes]:
    """``length`` packets left out, or handed over twice."""

    def change(path: Path, rng: np.random.Generator) -> bytes:
        import av

        # not the first: a recording that begins later is another recording
        first = int(rng.integers(1, FRAMES - length))
        with tempfile.TemporaryDirectory() as folder:
            target_path = Path(folder) / f"new{path.suffix}"
            with av.open(str(path)) as source, av.open(str(target_path), "w") as target:
                stream = source.streams.video[0]
                copy = target.add_stream_from_template(stream)
                for index, packet in enumerate(p for p in source.demux(stream) if p.size):
                    chosen = first <= index < first + length
                    again = _twin(packet) if chosen and doubled else None
                    if doubled or not chosen:
                        packet.stream = copy
                        target.mux(packet)
                    if again is not None:
                        again.stream = copy
                        target.mux(again)
            return target_path.read_bytes()

    return change


def _twin(packet):
    import av

    twin = av.Packet(bytes(packet))
    twin.pts, twin.dts, twin.time_base = packet.pts + 1, packet.dts + 1, packet.time_base
    twin.is_keyframe, twin.duration = packet.is_keyframe, packet.duration
    return twin


BREAKINGS: dict[str, tuple[int, Callable[[Path, np.random.Generator], bytes]]] = {
    "1 bit of the pictures": (12, flipped(1, False)),
    "4 bits of the pictures": (10, flipped(4, False)),
    "40 bits of the pictures": (8, flipped(40, False)),
    "1 bit of the index": (22, flipped(1, True)),
    "4 bits of the index": (10, flipped(4, True)),
    "20 bits of the index": (6, flipped(20, True)),
    "a wiped stretch": (8, wiped),
    "truncated": (8, truncated),
    "1 packet left out": (5, remuxed(False, 1)),
    "5 packets left out": (3, remuxed(False, 5)),
    "1 packet twice": (5, remuxed(True, 1)),
    "3 packets twice": (3, remuxed(True, 3)),
}
"""Kind -> (share, per hundred copies of a container; the change)."""


def plan(copies: int, seed: int) -> list[Copy]:
    """Which copies are made: the kinds in their shares, both containers, every one with a seed of its own."""
    kinds = [kind for kind, (share, _) in BREAKINGS.items() for _ in range(share)]
    order = np.random.default_rng(seed).permutation(len(kinds))
    half = copies // 2
    return [
        Copy(suffix, kinds[order[index % len(kinds)]], 1000 * seed + index + offset)
        for suffix, offset, count in ((".mp4", 0, half), (".mkv", 500, copies - half))
        for index in range(count)
    ]
