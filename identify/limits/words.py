"""Identifiability in words for the report."""

from __future__ import annotations

import numpy as np

from ...simulate.model import DERIVATIVE_UNITS, Hull, linear_system
from ..data import RunData
from ..fit import Fit
from .combinations import Combination
from .cure import RELEASED_M, Cure
from .identifiability import Identifiability

SYMBOLS = dict(zip(DERIVATIVE_UNITS, ("m - Y_vdot", "I - N_rdot", "Y_v", "Y_r - mU", "N_v", "N_r"), strict=True))
CORRELATED = 0.95
"""Correlation from which two derivatives are named as one combination."""
LISTED = tuple(SYMBOLS.values())
UNITS = tuple(DERIVATIVE_UNITS.values())


def combination_words(combination: Combination) -> str:
    """ "(Y_r - mU) + 0.21 (m - Y_vdot) = -35.2 +- 0.2 N s" """
    left = combination_name(combination)
    digits = max(0, 1 - int(np.floor(np.log10(combination.sd)))) if combination.sd > 0 else 6
    return f"{left} = {combination.value:.{digits}f} +- {combination.sd:.{digits}f} {UNITS[combination.leading]}"


def combination_name(combination: Combination) -> str:
    """The sum alone: "(Y_r - mU) + 0.21 (m - Y_vdot)"."""
    text = _bracketed(LISTED[combination.leading])
    for index in np.flatnonzero(combination.coefficients):
        if index != combination.leading:
            factor = combination.coefficients[index]
            text += f" {'+' if factor > 0 else '-'} {abs(factor):.3g} {_bracketed(LISTED[index])}"
    return text


def _bracketed(symbol: str) -> str:
    return f"({symbol})" if " " in symbol else symbol


def _listing(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def refusal_lines(found: Identifiability, cures: list[Cure], runs: list[RunData]) -> list[str]:
    """What is refused, what is fixed in its place, and the run that would cure it.

    Parameters
    ----------
    found : what the runs fix and what not
    cures : runs that would determine what is open
    runs : the runs, in their order
    """
    parts = found.parts
    if not parts.refused:
        return []
    record = "this record" if len(runs) == 1 else "these records"
    fixes = "fixes" if len(runs) == 1 else "fix"
    names = [LISTED[i] for i in parts.refused]
    lines = [
        f"{_listing(names)} {'is' if len(names) == 1 else 'are'} not determined by {record}: no single number is given"
    ]
    for combination in parts.combinations:
        apart = [_bracketed(LISTED[i]) for i in np.flatnonzero(combination.coefficients)]
        if len(apart) > 1:
            lines.append(f"{record} {fixes} {combination_words(combination)}, not {_listing(apart)} apart")
        else:
            lines.append(f"{combination_words(combination)}")
    lines.append(cure_words(cures, found, record))
    return lines


def cure_words(cures: list[Cure], found: Identifiability, record: str) -> str:
    """The runs that would determine what is open.

    Parameters
    ----------
    cures : runs that would determine what is open
    found : what the runs fix and what not
    record : what a run's record is called
    """
    if not cures:
        return (
            "no single further run that was tried (the same tow point with its release, tow points up to 0.4 m away) would "
            "determine them; several tow points would"
        )
    parts = []
    for proposed in cures:
        shares = [f"{LISTED[i]} to {100 * proposed.sd[i] / abs(found.fit.six[i]):.1g} %" for i in found.parts.refused]
        if proposed.move_m == 0.0:
            where = (
                f"a run like {proposed.beside!r} whose record holds its release at rest {RELEASED_M:g} m to the side"
            )
        else:
            side = "forward" if proposed.move_m > 0 else "aft"
            where = (
                f"a second tow point {abs(proposed.move_m):g} m {side} of {proposed.beside!r} "
                f"(X_T = {proposed.tow_point_m:.3f} m), recorded from its release {RELEASED_M:g} m to the side"
            )
        parts.append(f"{where} ({_listing(shares)})")
    return "what would determine them: " + "; or ".join(parts)


def correlation_lines(covariance: np.ndarray, single: tuple[int, ...]) -> list[str]:
    """Pairs of determined derivatives that are seen mostly as one combination.

    Parameters
    ----------
    covariance : (6, 6)
    single : indices of the determined derivatives
    """
    sd = np.sqrt(np.diag(covariance))
    lines = []
    for i in single:
        for j in single:
            rho = covariance[i, j] / (sd[i] * sd[j])
            if j < i and abs(rho) > CORRELATED:
                ratio = rho * sd[i] / sd[j]
                lines.append(
                    f"{LISTED[i]} and {LISTED[j]} are seen mostly as one combination ({LISTED[i]} "
                    f"{'-' if ratio > 0 else '+'} {abs(ratio):.3g} ({LISTED[j]}); correlation {rho:+.3f})"
                )
    return lines


def transient_line(fit: Fit, runs: list[RunData]) -> str:
    """How high the decaying part of the motion stands at the records' begin, beside the oscillation: it tells m' from Y_R.

    Parameters
    ----------
    fit : of ``runs``
    runs : the runs, in their order
    """
    parts = []
    for index, run in enumerate(runs):
        share = transient_share(fit, run, index)
        if share is not None:
            parts.append(f"{100 * share:.0f} % ({run.name})")
    return f"transient at the begin, of the oscillation's amplitude in y: {', '.join(parts)}" if parts else ""


def transient_share(fit: Fit, run: RunData, index: int) -> float | None:
    """Amplitude in y of all modes but the slow oscillation at the first sample, over that oscillation's; None without one.

    Parameters
    ----------
    fit : of ``runs``
    run : one of them
    index : of the run
    """
    hull = Hull(*(float(x) for x in fit.six), speed_m_s=fit.speed_m_s).at_speed(run.tow.speed_m_s)
    roots, shapes = np.linalg.eig(linear_system(hull, run.tow)[0])
    swing = np.flatnonzero(np.imag(roots) > 1e-3 * np.abs(roots))
    if not len(swing):
        return None
    slow = swing[np.argmin(np.abs(np.real(roots[swing])))]
    state = np.array(fit.own[index, :4], dtype=complex)
    if fit.form == "full":
        state[0] = run.tow.line_length_m * np.sin(state[0]) - run.tow.tow_point_m * np.sin(state[1])
    sizes = np.abs(np.linalg.solve(shapes, state) * shapes[0])
    pair = np.isclose(roots, roots[slow]) | np.isclose(roots, np.conj(roots[slow]))
    return float(sizes[~pair].sum() / max(sizes[pair].sum(), 1e-300))
