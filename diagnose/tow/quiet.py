"""Runs that show less slow error than they were granted: how much less, by the evidence of the simulator as it is.

A gap shows in its residuals, too: beside one, as much is granted as before, and what is that large stands out all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...simulate.model import Array
from ..inference.evidence import Fitted, Inference
from ..inference.grams import Grams
from .data import TowRun, granted
from .noise import tow_noise

HALVINGS = 5
"""At most: what is left then, a thirtieth of what was granted, hides nothing."""
SURE = 2.0
"""Log evidence that a halving has to bring."""


def quieter(runs: Sequence[TowRun], pushed: Sequence[Array], inference: Inference, base: Fitted) -> list[TowRun]:
    """The runs, granted what they show: the line's part is halved while the evidence of the base rises by it, then the marks'.

    Parameters
    ----------
    runs : as the diagnosis sees them
    pushed : how they answer forces along the base, of ``TowModel.pushed``
    inference : of these runs
    base : the fit without effects

    Returns
    -------
    runs : the same ones where nothing less is as probable
    """
    best = list(runs)
    reached = _evidence(best, pushed, inference, base)
    for marks, line in ((1.0, 0.5), (0.5, 1.0)):
        for _ in range(HALVINGS):
            tried = [granted(run, run.slow.scaled(marks, line)) for run in best]
            now = _evidence(tried, pushed, inference, base)
            if not now > reached + SURE:
                break
            best, reached = tried, now
    return best


def _evidence(runs: Sequence[TowRun], pushed: Sequence[Array], inference: Inference, base: Fitted) -> float:
    """Log evidence of the base beside the runs' noise, its random forces' sizes estimated anew."""
    noise = tow_noise(runs, pushed)
    here = Inference(inference.simulator, noise)
    forces, solved = here.best_forces(
        Grams(base.linear.columns, noise), base.hypothesis, base.forces, (base.forces.time,), near=True
    )
    return solved.log_evidence + forces.log_prior(inference.simulator.most_force)


__all__ = ["quieter"]
