"""What a law must be beside the best of those tried: more likely than everything else, and on runs that were kept aside as good as
a force without a form.

The best of bad ones is no law. One that is right is followed by runs that took no part in its fit at least as well as by a smooth
force that knows no form, whose many numbers the other runs had to find; one that is not leaves there what its form cannot follow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..inference.evidence import Fitted, Inference
from ..inference.held_out import BLOCKS_TOGETHER, aside, none_left
from ..inference.noise import Forces

TOLD = 0.5
"""A law is told from this probability on: it is then rather right than wrong."""
CLEARLY = 2.0
"""Kept-aside runs are followed worse if they are by more than so many standard errors."""


def worse_aside(inference: Inference, law: Fitted, free: Fitted, held: Sequence[int] | None) -> float:
    """By how many of its standard errors a law leaves more of the runs kept aside than a force without a form does.

    Both are measured beside the same random forces, the smaller ones of the two. The error is that of a sum over stretches of
    ``BLOCKS_TOGETHER`` means, each run's own: neighbours are not independent.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    law, free : fitted
    held : runs kept aside; None: each in turn

    Returns
    -------
    errors : above 0 where the law leaves more; NaN where no run can be kept aside
    """
    count = len(inference.simulator.runs)
    if none_left(count, held):
        return float("nan")
    one, two = law.forces, free.forces
    forces = Forces(min(one.side_n, two.side_n), min(one.moment_n_m, two.moment_n_m), two.time)
    turns = [(i, [j for j in range(count) if j not in (held or (i,))]) for i in held or range(count)]
    parts = []
    for run, others in turns:
        n = len(inference.simulator.runs[run].centre_s)
        a, b = (np.square(aside(inference, f, forces, run, others)).reshape(-1, n).sum(axis=0) for f in (law, free))
        parts.append(np.add.reduceat(a - b, np.arange(0, n, BLOCKS_TOGETHER)))
    differences = np.concatenate(parts)
    error = float(np.sqrt(len(differences)) * differences.std(ddof=1)) if len(differences) > 1 else 0.0
    return float(differences.sum()) / error if error > 0 else float("nan")


__all__ = ["CLEARLY", "TOLD", "worse_aside"]
