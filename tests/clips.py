"""Small films whose every frame carries its number, and copies of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from towline.vision import Frame

WIDTH, HEIGHT, BLOCK_PX, BITS = 160, 96, 16, 8
CODER = "scenecut=0:b-adapt=0:keyint=12:min-keyint=12:threads=1:bframes="


def drawn(number: int) -> np.ndarray:
    """Planes of a frame that carries its number, (h 3/2, w)."""
    planes = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
    planes[:HEIGHT] = 60 + (np.arange(WIDTH) // 8 + np.arange(HEIGHT)[:, None] // 8 + number) % 12
    for bit in range(BITS):
        planes[8:24, BLOCK_PX * bit : BLOCK_PX * (bit + 1)] = 200 if number >> bit & 1 else 40
    planes[40:72, 20 + number : 52 + number] = 180
    return planes


def number_of(luma: np.ndarray) -> int:
    """The number that a frame carries."""
    return sum(int(luma[12:20, BLOCK_PX * bit + 4 : BLOCK_PX * bit + 12].mean() > 120) << bit for bit in range(BITS))


def film(
    path: Path,
    stamps: Sequence[int],
    base: Fraction = Fraction(1, 30),
    rate: Fraction = Fraction(30),
    b_frames: int = 0,
    turned: int = 0,
    **options: str,
) -> Path:
    """Encode a clip with these presentation timestamps, in units of ``base``."""
    import av

    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as target:
        stream = target.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = base
        if turned:
            stream.set_display_rotation(turned)
        stream.options = {"crf": "16", "preset": "veryfast", "x264-params": f"{CODER}{b_frames}", **options}
        for number, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(drawn(number), format="yuv420p")
            frame.pts, frame.time_base = stamp, base
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    return path


def remux(source_path: Path, target_path: Path, change: Callable[[int, Any], object]) -> Path:
    """Copy packets; ``change(index, packet)`` may alter one, or return False to leave it out."""
    import av

    with av.open(str(source_path)) as source, av.open(str(target_path), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for index, packet in enumerate(p for p in source.demux(stream) if p.size):
            if change(index, packet) is not False:
                packet.stream = copy
                target.mux(packet)
    return target_path


def pieces(
    codec: str, count: int, step: Fraction, first: int = 0, planes: Callable[[int], np.ndarray] = drawn
) -> Iterator[Any]:
    """A source's answer and its packets; it stamps and sends one every ``step``, drawn by ``planes``."""
    import io

    import av

    from towline.live.pieces import Opened, Packet

    with av.open(io.BytesIO(), "w", format="matroska") as target:
        stream = target.add_stream(codec, rate=1 / step)
        rows, stream.width = planes(0).shape
        stream.height = rows * 2 // 3
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        if codec == "libx264":
            stream.options = {"tune": "zerolatency", "preset": "veryfast"}
        stream.codec_context.time_base = step
        target.start_encoding()
        extra = stream.codec_context.extradata
        yield Opened("h264" if codec == "libx264" else codec, stream, True, False, (stream.width, stream.height), extra)
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(planes(number), format="yuv420p").reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = number, step
            for packet in stream.encode(frame):
                stamp = first + number
                yield Packet(bytes(packet), stamp, stamp, step, packet.is_keyframe, False, float(number * step))


def notes_of(frames: Iterable[Frame]) -> str:
    """What was said of the recording."""
    return "\n".join(note for frame in frames for note in frame.notes)
