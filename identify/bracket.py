"""X_v between tow points that shear off and tow points that tow stably (4.7.1, 9.2): no angle is measured for it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ..record.results import NeutralBracket, TowStability

SHEARS = "shearing off"
"""A real root above 0 is E < 0, that is X_T < X_v (2.22). A swing proves nothing, whether it grows or decays: Routh's condition
(2.26) fails on either side of X_v, and a slow real root may lie under a swing unseen."""
STABLE = "settled"
"""It proves X_T > X_v where something would have set a real root going: a swing that decayed before, or a side force."""


def neutral_bracket(
    runs: Mapping[str, TowStability],
    interval_m: tuple[float, float] | None = None,
    standing_off: Collection[str] = (),
) -> NeutralBracket | None:
    """The largest X_T that sheared off and the smallest that towed stably.

    Parameters
    ----------
    runs : by name
    interval_m : 95 % interval of a fitted X_v to hold against them, or None
    standing_off : runs that settled under a side force

    Returns
    -------
    NeutralBracket : None where no run sheared off or towed stably

    >>> runs = {"a": TowStability(verdict="settled", tow_point_m=0.44), "b": TowStability(verdict="shearing off", tow_point_m=0.18)}
    >>> found = neutral_bracket(runs, (0.217, 0.221), ["a"])
    >>> found.above_m, found.below_m, found.agrees
    (0.18, 0.44, True)
    """
    off = [name for name, run in runs.items() if run.verdict == SHEARS]
    stable = [
        name
        for name, run in runs.items()
        if run.verdict == STABLE and (name in standing_off or run.lambda_per_s is not None)
    ]
    if not off and not stable:
        return None
    above = max((runs[name].tow_point_m for name in off), default=None)
    below = min((runs[name].tow_point_m for name in stable), default=None)
    agrees = None
    if interval_m is not None:
        agrees = (above is None or interval_m[1] >= above) and (below is None or interval_m[0] <= below)
    return NeutralBracket(above_m=above, below_m=below, sheared_off=off, towed_stably=stable, agrees=agrees)


def bracket_words(bracket: NeutralBracket) -> str:
    """In one sentence; empty where no run sheared off.

    A bracket that closes on itself (a tow point ahead of another that tows stably shears off) is said to.
    """
    if bracket.above_m is None:
        return ""
    low, off = bracket.above_m, ", ".join(bracket.sheared_off)
    if bracket.below_m is None:
        return f"X_v lies ahead of {low:g} m, where {off} sheared off; no tow point towed stably"
    high = bracket.below_m
    if low >= high:
        return (
            f"X_T = {low:g} m sheared off and X_T = {high:g} m towed stably: X_v cannot lie ahead of the first and aft "
            "of the second; speed, trim or rudder changed between them, or the model was disturbed"
        )
    text = (
        f"X_v lies between {low:g} m, where {off} sheared off, and {high:g} m, the aftmost tow point that towed stably"
    )
    if bracket.agrees is None:
        return text
    return f"{text}; the X_v of the steady tows {'agrees' if bracket.agrees else 'does not agree: one of the two is wrong'}"
