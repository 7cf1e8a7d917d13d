"""The optimum and the intervals of a fit, checked by other ways: other starts, drawn records, profiles of the chi-square."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..identify.colour.bootstrap import Bootstrap, bootstrap
from ..identify.limits.profile import profile
from ..identify.multistart import Multistart, multistart
from ..record.errors import EstimationError
from ..record.priors import DERIVATIVE_NAMES
from ..record.thorough_file import CheckedDerivative, ThoroughFile
from .analysis import Identified

STARTS, DRAWS = 10, 100
"""Other starts, and records drawn from the fitted model: choices; more take in proportion longer."""
WIDER = 1.25
"""A bootstrap's standard deviation of 100 draws is known to 7 %: beyond three times that it is another."""


def thorough(
    answer: Identified,
    seed: int = 1,
    starts: int = STARTS,
    draws: int = DRAWS,
    progress: Callable[[str], None] | None = None,
) -> ThoroughFile:
    """Check a fit.

    Parameters
    ----------
    answer : of ``analysis.identify_batch``
    seed : of what is drawn
    starts, draws : how many
    progress : is told what is done
    """
    say = progress or (lambda _: None)
    fit, data = answer.fit, answer.data
    rng = np.random.default_rng(seed)
    say("other starts")
    others = multistart(fit, data, rng, starts)
    drawn = None
    try:
        drawn = bootstrap(fit, data, rng, draws, progress)
    except EstimationError as error:
        said = [f"The bootstrap failed: {error}."]
    else:
        said = []
    alone = fit.method == "output_error" and not fit.modes
    found: dict[str, CheckedDerivative] = {}
    for k, name in enumerate(DERIVATIVE_NAMES):
        stated = answer.result.derivatives.get(name)
        if stated is None:
            continue
        say(f"profile of {name}")
        found[name] = CheckedDerivative(
            value=stated.value,
            std=stated.std,
            bootstrap_std=None if drawn is None else float(np.sqrt(drawn.covariance[k, k])),
            profile_interval=profile(fit, data, k).interval if alone else None,
        )
    return ThoroughFile(
        tool=answer.result.tool,
        inputs=answer.result.inputs,
        runs=[d.name for d in data],
        seed=seed,
        starts=len(others.six),
        reached=others.reached,
        better=others.better,
        draws=0 if drawn is None else len(drawn.six),
        derivatives=found,
        sentences=[_of_starts(others), *said, *_of_widths(found, drawn)],
    )


def _of_starts(others: Multistart) -> str:
    starts = len(others.six)
    if not starts:
        return "No other start was found whose motion can be simulated."
    if others.better:
        return f"{others.better} of {starts} other starts end at a lower chi-square: the fit stands in a side valley."
    return f"{others.reached} of {starts} other starts end at the fit's optimum, none at a better one."


def _of_widths(found: dict[str, CheckedDerivative], drawn: Bootstrap | None) -> Sequence[str]:
    if drawn is None or not found:
        return []
    ratios = {name: one.bootstrap_std / one.std for name, one in found.items() if one.bootstrap_std and one.std}
    words = {name: f"{name} {r:.2f}" for name, r in ratios.items()}
    wide = ", ".join(words[name] for name, r in ratios.items() if r > WIDER)
    narrow = ", ".join(words[name] for name, r in ratios.items() if r < 1 / WIDER)
    said = []
    if wide:
        said.append(f"The bootstrap finds larger standard deviations than stated (ratio {wide}): use the bootstrap's.")
    if narrow:
        said.append(
            f"The bootstrap finds smaller standard deviations than stated (ratio {narrow}): those stated also hold what drawn "
            "records do not show: errors of the settings, slow noise of the tracks."
        )
    if not said:
        said = [
            f"The bootstrap's standard deviations are {min(ratios.values()):.2f} to {max(ratios.values()):.2f} of those stated."
        ]
    return said


__all__ = ["thorough"]
