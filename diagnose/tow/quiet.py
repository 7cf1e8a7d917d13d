"""Marks without a film that show less slow error than they were granted: how much less, by the evidence of the simulator as it is.

A gap shows in its residuals, too: beside one, as much is granted as before, and what is that large stands out all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...simulate.model import Array
from ..inference.evidence import Fitted, Inference
from ..inference.grams import Grams
from .channels import LINE
from .noise import tow_noise
from .slow import LEAST
from .tow_run import TowRun

APART = ([LINE], [0, 1, 3])
"""Channels that are granted more or less together: a line is as steady as it is; the others err by the marks alone."""
SURE = 2.0
"""Log evidence that a halving has to bring."""


def quieter(runs: Sequence[TowRun], pushed: Sequence[Array], inference: Inference, base: Fitted) -> list[TowRun]:
    """The runs, granted what they show: the line's errors are halved while the evidence of the base rises by it, then the marks'.

    Parameters
    ----------
    runs : as the diagnosis sees them
    pushed : how they answer forces along the base, of ``TowModel.pushed``
    inference : of these runs
    base : the fit without effects

    Returns
    -------
    runs : the same ones where nothing less is as probable, and where one of them was filmed
    """
    best = list(runs)
    if not all(run.slow.unfilmed for run in runs):
        return best
    reached = _evidence(best, pushed, inference, base)
    for channels in APART:
        share = 1.0
        while share > LEAST and any(run.slow.sd[channels].any() for run in best):
            tried = [run.granted(run.slow.less(channels, 0.5)) for run in best]
            now = _evidence(tried, pushed, inference, base)
            if not now > reached + SURE:
                break
            best, reached, share = tried, now, 0.5 * share
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
