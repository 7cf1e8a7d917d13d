"""Sixty re-encodings and edits of recordings whose marks are known, for benchmarks/footage_edits.py.

Each writes a recording into a folder and says which picture of the source stands at which time. Pictures are planes of YUV 4:2:0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = 250
"""Of each source: the first so many."""
X264 = {"preset": "veryfast", "crf": "18", "x264-params": "threads=1"}
X264_B = {**X264, "x264-params": "threads=1:bframes=3:b-adapt=0:keyint=50:min-keyint=50:scenecut=0"}
OPEN_GOP = {**X264, "x264-params": "threads=1:bframes=3:b-adapt=0:keyint=50:min-keyint=50:scenecut=0:open-gop=1"}
X265 = {"preset": "veryfast", "crf": "20", "x265-params": "log-level=none:pools=1"}


@dataclass(frozen=True)
class Source:
    """A recording with its truth.

    Attributes
    ----------
    name, path, rate_hz : of the recording
    run_toml : text of its run.toml
    planes : (n, 3 h / 2, w) uint8
    place_px : (n, m, 2), NaN where a mark is not seen
    markers : their names
    """

    name: str
    path: Path
    rate_hz: Fraction
    run_toml: str
    planes: np.ndarray
    place_px: np.ndarray
    markers: tuple[str, ...]

    @property
    def size_px(self) -> tuple[int, int]:
        """Width, height."""
        return self.planes.shape[2], self.planes.shape[1] * 2 // 3


@dataclass(frozen=True)
class Made:
    """A recording that was made of a source.

    Attributes
    ----------
    video : for run.toml
    times : time in the recording, s -> number of the source's picture there (half: between two)
    keys : lines of run.toml's [source]
    hidden : (n, m) marks that something stands before, by the source's numbers
    """

    video: str
    times: dict[float, float]
    keys: str = ""
    hidden: np.ndarray | None = None


@dataclass(frozen=True)
class Edit:
    """One edit: its name, and what makes it in a folder."""

    name: str
    make: Callable[[Source, Path], Made]


@dataclass
class Coding:
    """How pictures are coded."""

    codec: str = "libx264"
    suffix: str = ".mp4"
    form: str = "yuv420p"
    options: dict[str, str] = field(default_factory=lambda: dict(X264))
    rotation: int = 0
    full_range: bool = False
    transfer: int | None = None


def encoded(
    source: Source,
    folder: Path,
    coding: Coding,
    pictures: Iterable[np.ndarray] | None = None,
    stamps: Sequence[int] | None = None,
    base: Fraction | None = None,
    rate_hz: Fraction | None = None,
    name: str = "edited",
) -> Path:
    """Encode pictures at an even rate, or at ``stamps`` of ``base`` s."""
    import av

    rate_hz = rate_hz or source.rate_hz
    base = base or 1 / rate_hz
    path = folder / f"{name}{coding.suffix}"
    with av.open(str(path), "w") as target:
        stream: Any = target.add_stream(coding.codec, rate=rate_hz)
        stream.codec_context.time_base = base
        stream.pix_fmt, stream.options = coding.form, dict(coding.options)
        stream.codec_context.thread_count = 1
        if coding.rotation:
            stream.set_display_rotation(coding.rotation)
        if coding.full_range:
            stream.codec_context.color_range = 2
        if coding.transfer is not None:
            stream.codec_context.color_trc = coding.transfer
            stream.codec_context.colorspace = stream.codec_context.color_primaries = 9
        for place, planes in enumerate(source.planes if pictures is None else pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(planes), format="yuv420p")
            if not place:
                stream.width, stream.height = frame.width, frame.height
            if coding.form != "yuv420p":
                frame = frame.reformat(
                    format=coding.form,
                    src_color_range="MPEG",
                    dst_color_range="JPEG" if coding.full_range else "MPEG",
                )
            frame.pts, frame.time_base = place if stamps is None else int(stamps[place]), base
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    return path


def copied(
    source_path: Path,
    target: Path,
    begins_s: Fraction = Fraction(0),
    ends_s: Fraction | None = None,
    parts: int = 1,
    pause_s: Fraction = Fraction(0),
) -> Path:
    """Copy packets as an editor does, from the key frame before ``begins_s`` (time zero) on; ``parts`` times in a row."""
    import av

    with av.open(str(target), "w") as copy:
        stream: Any = None
        for part in range(parts):
            with av.open(str(source_path)) as container:
                video = container.streams.video[0]
                assert video.time_base is not None
                start = (video.start_time or 0) + round(begins_s / video.time_base)
                end = None if ends_s is None else (video.start_time or 0) + round(ends_s / video.time_base)
                packets = [p for p in container.demux(video) if p.size and p.pts is not None and p.dts is not None]
                key = max(p.pts for p in packets if p.is_keyframe and p.pts <= start)
                stream = stream or copy.add_stream_from_template(video)
                later = part * round(pause_s / video.time_base)
                for packet in packets:
                    if packet.pts >= key and (end is None or packet.dts < end):
                        packet.pts, packet.dts = packet.pts - start + later, packet.dts - start + later
                        packet.stream = stream
                        copy.mux(packet)
    return target


def even(source: Source, numbers: Sequence[float] | None = None, rate_hz: Fraction | None = None) -> dict[float, float]:
    """Pictures at an even rate."""
    numbers = range(len(source.planes)) if numbers is None else numbers
    return {float(place / (rate_hz or source.rate_hz)): number for place, number in enumerate(numbers)}


def recoded(coding: Coding) -> Callable[[Source, Path], Made]:
    """All pictures as they are, by another codec."""
    return lambda source, folder: Made(encoded(source, folder, coding).name, even(source))


def drawn(change: Callable[[Source, int], np.ndarray], coding: Coding | None = None) -> Callable[[Source, Path], Made]:
    """Every picture changed by itself."""

    def make(source: Source, folder: Path) -> Made:
        pictures = (change(source, number) for number in range(len(source.planes)))
        return Made(encoded(source, folder, coding or Coding(), pictures).name, even(source))

    return make


def _luma(source: Source, number: int, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    planes, height = source.planes[number].copy(), source.size_px[1]
    planes[:height] = np.clip(np.rint(change(planes[:height].astype(np.float32))), 16, 235).astype(np.uint8)
    return planes


# cuts and joins -------------------------------------------------------------------------------------------------------


def trimmed(suffix: str, counted: bool = False) -> Callable[[Source, Path], Made]:
    """From picture 68 to 200, copied; key frames every 50."""

    def make(source: Source, folder: Path) -> Made:
        whole = encoded(source, folder, Coding(options=X264_B), name="whole")
        begins, ends = 68 / source.rate_hz, 200 / source.rate_hz
        path = copied(whole, folder / f"edited{suffix}", Fraction(begins), Fraction(ends))
        first = 68 if suffix in (".mp4", ".mov") else 50  # without an edit list the pictures before it stay
        # by presentation an editor's cut takes some B frames of the last group away
        return Made(
            path.name, even(source, range(first, 210)), f"frame_rate_hz = {float(source.rate_hz)}\n" if counted else ""
        )

    return make


def joined(suffix: str) -> Callable[[Source, Path], Made]:
    """The same twice, the second time after a pause of two pictures."""

    def make(source: Source, folder: Path) -> Made:
        whole = encoded(source, folder, Coding(options=X264_B), name="whole")
        n = len(source.planes)
        path = copied(whole, folder / f"edited{suffix}", parts=2, pause_s=(n + 2) / source.rate_hz)
        first = even(source)
        return Made(path.name, first | {float((n + 2 + k) / source.rate_hz): k for k in range(n)})

    return make


def appended(source: Source, folder: Path) -> Made:
    """Two transport streams, one file behind the other."""
    part = encoded(source, folder, Coding(suffix=".ts", options=X264_B), name="part")
    (folder / "edited.ts").write_bytes(part.read_bytes() * 2)
    return Made("edited.ts", even(source, [*range(len(source.planes))] * 2))


def cut_short(suffix: str) -> Callable[[Source, Path], Made]:
    """The last third of the file is missing."""

    def make(source: Source, folder: Path) -> Made:
        whole = encoded(source, folder, Coding(options=X264_B, suffix=".mkv"), name="whole")
        path = folder / f"edited{suffix}"
        path.write_bytes(whole.read_bytes()[: int(0.67 * whole.stat().st_size)])
        return Made(path.name, even(source))

    return make


def begun_open(source: Source, folder: Path) -> Made:
    """Begun at the second key frame, which pictures shown before it predict from."""
    import av

    whole = encoded(source, folder, Coding(options=OPEN_GOP), name="whole")
    path = folder / "edited.mkv"
    shown = []
    with av.open(str(whole)) as container, av.open(str(path), "w") as copy:
        video = container.streams.video[0]
        assert video.time_base is not None
        stream = copy.add_stream_from_template(video)
        packets = [p for p in container.demux(video) if p.size and p.pts is not None]
        keys = [place for place, p in enumerate(packets) if p.is_keyframe]
        for packet in packets[keys[1] :]:
            assert packet.pts is not None
            shown.append(round((packet.pts - (video.start_time or 0)) * video.time_base * source.rate_hz))
            packet.stream = stream
            copy.mux(packet)
    return Made(path.name, even(source, sorted(shown)))


def unordered(source: Source, folder: Path) -> Made:
    """B frames whose container was given decoding times only."""
    import av

    whole = encoded(source, folder, Coding(options=X264_B), name="whole")
    with av.open(str(whole)) as container, av.open(str(folder / "edited.mkv"), "w") as copy:
        video = container.streams.video[0]
        stream = copy.add_stream_from_template(video)
        for packet in container.demux(video):
            if packet.size:
                packet.pts, packet.stream = packet.dts, stream
                copy.mux(packet)
    return Made("edited.mkv", even(source))


def span_of_avi(source: Source, folder: Path) -> Made:
    """``span_s`` ends early."""
    path = encoded(source, folder, Coding(suffix=".avi", options=X264_B))
    ends = float(150 / source.rate_hz)
    return Made(path.name, {t: n for t, n in even(source).items() if t <= ends}, f"span_s = [0.0, {ends}]\n")


# rates ----------------------------------------------------------------------------------------------------------------


def uneven(source: Source, folder: Path) -> Made:
    """A camera of variable rate: a tenth of the pictures left out, the others' times jittered by milliseconds."""
    rng = np.random.default_rng(4)
    kept = [n for n in range(len(source.planes)) if not n or rng.random() > 0.1]
    base = Fraction(1, 90000)
    stamps = [round(n / source.rate_hz / base) + int(rng.integers(-180, 181)) * (n > 0) for n in kept]
    path = encoded(source, folder, Coding(options=X264_B), (source.planes[n] for n in kept), stamps, base)
    return Made(path.name, {float(s * base): n for s, n in zip(stamps, kept, strict=True)})


def dropped(source: Source, folder: Path) -> Made:
    """An AVI whose program dropped every 20th picture."""
    kept = [n for n in range(len(source.planes)) if n % 20 != 10]
    coding = Coding("mpeg4", ".avi", options={"b": "20M", "qmin": "2", "qmax": "3"})
    path = encoded(source, folder, coding, (source.planes[n] for n in kept), kept)
    return Made(path.name, {float(n / source.rate_hz): n for n in kept})


def rated(step: int, factor: Fraction = Fraction(1), repeat: int = 1) -> Callable[[Source, Path], Made]:
    """Every ``step``-th picture, each ``repeat`` times, at ``factor`` times the rate that keeps the time."""

    def make(source: Source, folder: Path) -> Made:
        numbers = [n for n in range(0, len(source.planes), step) for _ in range(repeat)]
        rate_hz = source.rate_hz / step * repeat * factor
        path = encoded(source, folder, Coding(options=X264_B), (source.planes[n] for n in numbers), rate_hz=rate_hz)
        return Made(path.name, even(source, numbers, rate_hz))

    return make


def woven(source: Source, folder: Path) -> Made:
    """Interlaced: the rows of two pictures in one, top field first."""
    height = source.size_px[1]
    rate_hz = source.rate_hz / 2

    def pair(n: int) -> np.ndarray:
        planes = source.planes[n].copy()
        planes[1:height:2] = source.planes[n + 1][1:height:2]
        return planes

    firsts = range(0, len(source.planes) - 1, 2)
    coding = Coding(options={**X264, "x264-params": "threads=1:tff=1"})
    path = encoded(source, folder, coding, (pair(n) for n in firsts), rate_hz=rate_hz)
    return Made(path.name, even(source, [n + 0.5 for n in firsts], rate_hz))


# pictures -------------------------------------------------------------------------------------------------------------


def folder_of(suffix: str, timed: bool) -> Callable[[Source, Path], Made]:
    """The pictures in colour as files; with microseconds in their names, or with numbers."""

    def make(source: Source, folder: Path) -> Made:
        import av
        import cv2

        (folder / "shots").mkdir()
        for n, planes in enumerate(source.planes):
            name = f"shot_{round(n * 1e6 / source.rate_hz) + 1_700_000_000_000_000}" if timed else f"shot_{n:04d}"
            bgr = av.VideoFrame.from_ndarray(planes, format="yuv420p").to_ndarray(format="bgr24")
            cv2.imwrite(str(folder / "shots" / f"{name}{suffix}"), bgr)
        if timed:
            return Made(f"shots/shot_{{us}}{suffix}", even(source))
        return Made("shots", even(source), f"frame_rate_hz = {float(source.rate_hz)}\n")

    return make


# what the camera does -------------------------------------------------------------------------------------------------


def turned(degrees: int) -> Callable[[Source, Path], Made]:
    """A camera that was held otherwise and says so: the pictures lie on their side, a flag turns them upright."""

    def make(source: Source, folder: Path) -> Made:
        width, height = source.size_px
        quarter = degrees // 90

        def lying(planes: np.ndarray) -> np.ndarray:
            half = planes[height:].reshape(2, height // 2, width // 2)
            parts = [np.rot90(plane, -quarter) for plane in (planes[:height], *half)]
            wide = parts[0].shape[1]
            chroma = np.concatenate([part.reshape(-1) for part in parts[1:]]).reshape(-1, wide)
            return np.vstack([parts[0], chroma])

        path = encoded(source, folder, Coding(rotation=degrees), (lying(p) for p in source.planes))
        return Made(path.name, even(source))

    return make


def step_of_exposure(source: Source, number: int) -> np.ndarray:
    """From picture 120 on 0.7 of the light."""
    return _luma(source, number, lambda y: y if number < 120 else 16 + 0.7 * (y - 16))


def faded_in(source: Source, number: int) -> np.ndarray:
    """From black in the first 25 pictures."""
    return _luma(source, number, lambda y: 16 + min(number / 25, 1.0) * (y - 16))


def harder(source: Source, number: int) -> np.ndarray:
    """More contrast, as an editor's filter makes it."""
    return _luma(source, number, lambda y: 16 + 219 * np.clip((y - 16) / 219, 0, 1) ** 1.3)


def breathing(source: Source, number: int) -> np.ndarray:
    """Out of focus by up to 1.2 px (standard deviation) and back, every 100 pictures; the scale stays."""
    import cv2

    sigma = 1.2 * np.sin(np.pi * number / 100) ** 2
    return _luma(source, number, lambda y: cv2.GaussianBlur(y, (0, 0), sigma) if sigma > 0.05 else y)


def smeared(source: Source, number: int) -> np.ndarray:
    """Motion blur: the light of two steps of the marks' motion, the picture's time in the middle."""
    import cv2

    width, height = source.size_px
    before, after = max(number - 1, 0), min(number + 1, len(source.planes) - 1)
    step = (source.place_px[after] - source.place_px[before]).mean(axis=0) / (after - before)

    def smear(y: np.ndarray) -> np.ndarray:
        moved = [np.float32([[1, 0, share * step[0]], [0, 1, share * step[1]]]) for share in (-1, -0.5, 0, 0.5, 1)]
        return np.mean([cv2.warpAffine(y, m, (width, height), borderMode=cv2.BORDER_REPLICATE) for m in moved], axis=0)

    return _luma(source, number, smear)


def walked_through(source: Source, folder: Path) -> Made:
    """Someone dark walks through, 90 px wide, from left to right in 200 pictures."""
    width, height = source.size_px
    wide, n = 90, len(source.planes)
    left = (np.arange(n) - 25) / 200 * (width + wide) - wide
    away = source.place_px[..., 0] - left[:, None]
    near = (away > -8) & (away < wide + 8)

    def pictures() -> Iterable[np.ndarray]:
        for k, planes in enumerate(source.planes):
            shown = planes.copy()
            a, b = (int(np.clip(x, 0, width)) for x in (left[k], left[k] + wide))
            if b > a and 25 <= k < 225:
                shown[:height, a:b] = 38
            yield shown

    path = encoded(source, folder, Coding(), pictures())
    return Made(path.name, even(source), hidden=near & (np.arange(n) >= 25)[:, None] & (np.arange(n) < 225)[:, None])


DEEP = {"form": "yuv420p10le"}
EVERY: tuple[Edit, ...] = (
    Edit("trimmed by copying, mp4", trimmed(".mp4")),
    Edit("trimmed, mp4, frames counted", trimmed(".mp4", counted=True)),
    Edit("trimmed by copying, mkv", trimmed(".mkv")),
    Edit("joined by copying, a pause", joined(".mp4")),
    Edit("H.264 crf 18, B frames", recoded(Coding(options=X264_B))),
    Edit("HEVC", recoded(Coding("libx265", options=X265))),
    Edit("HEVC, 10 bit", recoded(Coding("libx265", options=X265, **DEEP))),
    Edit("variable rate", uneven),
    Edit("half the rate", rated(2)),
    Edit("turned by 90 degrees", turned(90)),
    Edit("interlaced", woven),
    Edit("a step of exposure", drawn(step_of_exposure)),
    Edit("focus breathing", drawn(breathing)),
    Edit("motion blur", drawn(smeared)),
    Edit("someone walks through", walked_through),
)
"""Of every source."""
MORE: tuple[Edit, ...] = (
    Edit("trimmed by copying, mov", trimmed(".mov")),
    Edit("begun in an open group", begun_open),
    Edit("joined transport streams", appended),
    Edit("cut short, mkv", cut_short(".mkv")),
    Edit("B frames without an order", unordered),
    Edit("AVI, span ends early", span_of_avi),
    Edit("AVI with dropped pictures", dropped),
    Edit("HEVC, 10 bit, HDR (PQ)", recoded(Coding("libx265", ".mov", options=X265, transfer=16, **DEEP))),
    Edit(
        "MJPEG", recoded(Coding("mjpeg", ".avi", "yuvj420p", {"b": "80M", "qmin": "2", "qmax": "3"}, full_range=True))
    ),
    Edit("ProRes 422, 10 bit", recoded(Coding("prores_ks", ".mov", "yuv422p10le", {"profile": "2"}))),
    Edit("MPEG-2", recoded(Coding("mpeg2video", ".ts", options={"b": "12M", "maxrate": "20M", "bufsize": "4M"}))),
    Edit("FFV1, 10 bit", recoded(Coding("ffv1", ".mkv", options={}, **DEEP))),
    Edit(
        "VP9",
        recoded(
            Coding("libvpx-vp9", ".webm", options={"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6"})
        ),
    ),
    Edit("numbered PNGs", folder_of(".png", timed=False)),
    Edit("JPEGs, times in names", folder_of(".jpg", timed=True)),
)
"""Of the path-traced film, beside those."""


def cases(names: Sequence[str]) -> list[tuple[str, Edit]]:
    """Sixty: (source, edit)."""
    film = names[0]
    return [(name, edit) for name in names for edit in EVERY] + [(film, edit) for edit in MORE]
