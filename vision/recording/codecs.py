"""Which codecs keep every pixel, and which make pictures from others; names are ffmpeg's."""

from __future__ import annotations

# fmt: off
LOSSLESS = frozenset({
    "rawvideo", "ffv1", "huffyuv", "ffvhuff", "hymt", "utvideo", "magicyuv", "lagarith", "vble", "loco", "zlib",
    "mszh", "zmbv", "qtrle", "png", "apng", "tiff", "bmp", "dpx", "targa", "sgi", "ppm", "pgm", "pam", "r10k",
    "r210", "v210", "v210x", "v308", "v408", "v410", "y41p", "yuv4",
})
# fmt: on
"""Codecs, by ffmpeg's names, that keep every pixel; others may be set to, but their files do not say so."""
INTRA = frozenset(
    {"mjpeg", "mjpegb", "ljpeg", "jpegls", "jpeg2000", "prores", "dnxhd", "dvvideo", "cfhd", "webp", "gif"}
)
"""Codecs with loss that make no picture from another."""


def losses(codec: str) -> tuple[bool, bool]:
    """Whether a codec, by ffmpeg's name, compresses with loss, and whether it then makes pictures from others."""
    lossy = codec not in LOSSLESS
    return lossy, lossy and codec not in INTRA


__all__ = ["INTRA", "LOSSLESS", "losses"]
