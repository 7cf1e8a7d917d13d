"""What surge does to a fit, in numbers and in words: how far it would move a constant-T fit, what the mass says of the tension."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..record.errors import EstimationError
from ..simulate.model import DERIVATIVE_UNITS
from .data import RunData
from .fit import Fit, fit_runs
from .limits.words import LISTED
from .tension import AGREES_Z, TensionFromMotion, slack_spells

SMALLEST_MOVE = 0.002
"""Below this share no derivative's move is worth a sentence."""


def surge_moves(fit: Fit, runs: list[RunData]) -> dict[str, float] | None:
    """By what share of itself surge in full would move each derivative of a constant-T fit: the same runs fitted with it.

    None where the fit has surge already, has no mass, is linear, or does not reach an optimum with it.

    Parameters
    ----------
    fit : of ``runs``
    runs : the runs, in their order
    """
    if runs[0].tow.line != "constant" or fit.form != "full" or fit.method != "output_error":
        return None
    if any(d.mass_kg is None or d.tension is not None for d in runs):
        return None
    towed = [replace(d, tow=replace(d.tow, line="surge")) for d in runs]
    try:
        other = fit_runs(towed, fit.form, fit.speed_m_s)
    except EstimationError:
        return None
    moves = other.six / fit.six - 1
    return {name: float(move) for name, move in zip(DERIVATIVE_UNITS, moves, strict=True)}


def along_lines(
    fit: Fit, runs: list[RunData], weighed: TensionFromMotion | None, moved: dict[str, float] | None
) -> list[str]:
    """Sentences for the result's notes.

    Parameters
    ----------
    fit : of ``runs``
    runs : the runs, in their order
    weighed : tension from the motion, or None
    moved : of ``surge_moves``, or None
    """
    lines = []
    if moved is not None and max(abs(m) for m in moved.values()) > SMALLEST_MOVE:
        sd = np.sqrt(np.diag(fit.covariance)) / np.abs(fit.six)
        parts = [
            f"{symbol} {100 * move:+.1f} % ({abs(move) / max(s, 1e-12):.1f} sd)"
            for symbol, move, s in zip(LISTED, moved.values(), sd, strict=True)
        ]
        lines.append(f'line = "constant": were this a line of constant length, surge would move {", ".join(parts)}')
    if weighed is not None and weighed.weighed:
        low, high = weighed.interval
        said = (
            f"tension from the motion and the model's mass: {weighed.factor:.3f} ({low:.3f} .. {high:.3f}) of what is "
        )
        if weighed.z is None:
            parts = [f"{name} {value:.3g} N" for name, value in weighed.resistance_n.items()]
            lines.append(
                f"no tension is stated: R from the model's mass to {100 * weighed.log_sd:.1f} %: {', '.join(parts)}; it is in "
                "every standard deviation"
            )
        elif abs(weighed.z) < AGREES_Z:
            lines.append(f"{said}stated: they agree ({weighed.z:+.1f} standard deviations)")
        else:
            lines.append(
                f"{said}stated: they do not agree ({weighed.z:+.1f} standard deviations): check the tension, model.mass_kg and "
                "what [priors] says of them"
            )
    for name, gauge in (weighed.gauges if weighed is not None else {}).items():
        lines += [f"load cell of run {name!r}: {words}" for words in gauge.departures(runs[0].priors)]
    for name, (first, last) in slack_spells(runs, fit).items():
        lines.append(
            f"run {name!r}: the fitted motion would need a line that pushes, between {first:.1f} and {last:.1f} s: the line was "
            "slack there; cut it out with source.span_s"
        )
    return lines


__all__ = ["along_lines", "surge_moves"]
