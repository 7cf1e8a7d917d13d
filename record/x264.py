"""The coder x264, told to give the same bytes for the same pictures."""

from __future__ import annotations

_AVX2, _AVX_512F = 11, 13
"""OpenCV's numbers of a processor's instructions (its ``CpuFeatures``, which Python's module does not name)."""


def x264_options(*params: str) -> dict[str, str]:
    """Options for ffmpeg's libx264: these of x264's own parameters, and what keeps its bytes the same.

    Of its instructions those of AVX-512 are left out: with them its macroblock tree reads memory that nothing was written to, and
    a film comes out one time in a hundred, or at another place in a long program, as other bytes (of x264's build 165, in PyAV
    18.1; seen with glibc's ``MALLOC_PERTURB_=1``). With AVX2 it gives what it gives with AVX-512 where that memory is zero.

    Parameters
    ----------
    params : ``name=value`` each

    Examples
    --------
    >>> x264_options("aq-mode=0")["x264-params"].split(":")[0]
    'aq-mode=0'
    """
    import cv2

    # named only where the processor has them: x264 takes what it is told, and would stop at an instruction that is not there
    without = ["asm=avx2"] if cv2.checkHardwareSupport(_AVX_512F) and cv2.checkHardwareSupport(_AVX2) else []
    told = ":".join([*params, *without])
    return {"x264-params": told} if told else {}


__all__ = ["x264_options"]
