"""The array library behind the batched fit: numpy, or torch on a GPU, with the same calls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..record.errors import InputError

DEVICES = ("cpu", "cuda")


@dataclass(frozen=True)
class Backend:
    """Where the arithmetic of the fit runs.

    Attributes
    ----------
    xp : numpy, or torch (its names for what is used here are the same)
    device : None for numpy, else torch's device
    """

    xp: Any
    device: str | None = None

    def array(self, values: Any) -> Any:
        """``values`` as an array of this library, float64."""
        if self.device is None:
            return np.asarray(values, dtype=np.float64)
        return self.xp.as_tensor(values, dtype=self.xp.float64, device=self.device)

    def mask(self, values: Any) -> Any:
        """``values`` as truth values of this library."""
        if self.device is None:
            return np.asarray(values, dtype=np.bool_)
        return self.xp.as_tensor(values, dtype=self.xp.bool, device=self.device)

    def numpy(self, values: Any) -> Any:
        """Back on the host."""
        return values if self.device is None else values.cpu().numpy()

    def eye(self, size: int) -> Any:
        """Unit matrix."""
        return self.array(np.eye(size))

    def empty(self, shape: tuple[int, ...]) -> Any:
        """Uninitialised float64."""
        return (
            np.empty(shape) if self.device is None else self.xp.empty(shape, dtype=self.xp.float64, device=self.device)
        )


NUMPY = Backend(np)


def backend_for(device: str) -> Backend:
    """``cpu`` -> numpy, ``cuda`` -> torch on the graphics card, ``torch`` -> torch on the processor (a check).

    Raises
    ------
    InputError : unknown device, torch is not installed, or there is no such card
    """
    if device == "cpu":
        return NUMPY
    if device not in (*DEVICES, "torch"):
        raise InputError("--device", "", f"{device!r}; expected one of {', '.join(DEVICES)}")
    try:
        import torch
    except ImportError:
        raise InputError("--device", "", f"{device} needs torch: pip install 'towline[kornia]'") from None
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError(
            "--device", "", "cuda: torch finds no CUDA device here; leave --device out to use the processor"
        )
    return Backend(torch, "cuda" if device == "cuda" else "cpu")
