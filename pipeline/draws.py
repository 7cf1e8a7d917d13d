"""Draws that are the same for the same runs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

SEED_BYTES = 8
"""Of the inputs' hashes: as many as a seed's 64 bits hold."""


def rng_of(inputs: Mapping[str, str]) -> np.random.Generator:
    """Random numbers that hang on what the inputs hold: the same runs give the same answer.

    Parameters
    ----------
    inputs : name of an input -> its SHA-256
    """
    text = "".join(sorted(inputs.values())).encode()[:SEED_BYTES].ljust(SEED_BYTES, b"0")
    return np.random.default_rng(int.from_bytes(text, "big"))


__all__ = ["rng_of"]
