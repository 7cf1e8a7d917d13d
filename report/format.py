"""Numbers as people read them: two digits of the standard deviation, the value to the same decimal.

Texts are plain ASCII (``-``, ``+-``); the page swaps in the typographic signs. Shared by the page and the terminal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..record.results import Derivative, DerivativesFile, Measured, SteadyFile

NONE = "-"
STD_DIGITS = 2
"""Significant digits of a standard deviation; the value stands to the same decimal (the GUM, JCGM 100, 7.2.6: two at
most)."""
_PLAIN_DECIMALS = range(-5, 8)
"""Numbers with so many decimals are written out; others with an exponent."""

SYMBOLS_TEXT = {
    "m_minus_y_vdot": "m - Y_vdot",
    "i_minus_n_rdot": "I - N_rdot",
    "y_v": "Y_v",
    "y_r_minus_mu": "Y_r - mU",
    "n_v": "N_v",
    "n_r": "N_r",
}
FREE_TEXT = {
    "y_delta": "Y_delta",
    "n_delta": "N_delta",
    "y_v_over_mass": "Y_v/(m - Y_vdot)",
    "y_r_minus_mu_over_mass": "(Y_r - mU)/(m - Y_vdot)",
    "n_v_over_inertia": "N_v/(I - N_rdot)",
    "n_r_over_inertia": "N_r/(I - N_rdot)",
    "y_delta_over_mass": "Y_delta/(m - Y_vdot)",
    "n_delta_over_inertia": "N_delta/(I - N_rdot)",
}
"""What free runs give beside the six, or in their place."""
MEANINGS = {
    "m_minus_y_vdot": "mass with the water that moves sideways with the hull",
    "i_minus_n_rdot": "yaw inertia with the water that turns with the hull",
    "y_v": "side force per sideways speed",
    "y_r_minus_mu": "side force per yaw rate, less the centrifugal term",
    "n_v": "yaw moment per sideways speed",
    "n_r": "yaw moment per yaw rate",
    "y_delta": "side force per radian of rudder",
    "n_delta": "yaw moment per radian of rudder",
}


@dataclass(frozen=True)
class Row:
    """One line of a result table, every cell a finished ASCII text; ``-`` where there is nothing to say.

    Attributes
    ----------
    key : key in the result file
    symbol : for people
    value, std, unit : rounded alike
    percent : std in % of the value
    prime, prime_std : non-dimensional x 1e3 (derivatives only)
    true : true value where the run carries it
    deviation : (value - true)/std, signed
    """

    key: str
    symbol: str
    value: str
    std: str
    unit: str
    percent: str
    prime: str = NONE
    prime_std: str = NONE
    true: str = NONE
    deviation: str = NONE


def decimals_of(std: float) -> int | None:
    """Decimals that show ``std`` with two digits; negative: tens, hundreds. None where std is 0 or not finite."""
    if not math.isfinite(std) or std <= 0:
        return None
    return STD_DIGITS - 1 - int(f"{std:.{STD_DIGITS - 1}e}".partition("e")[2])


def to_decimals(value: float, decimals: int) -> str:
    """``value`` with that many decimals, never ``-0``; negative decimals round to tens, hundreds.

    Parameters
    ----------
    value : the number
    decimals : after the point; negative: rounded to tens, hundreds
    """
    if not math.isfinite(value):
        return NONE
    text = f"{value:.{decimals}f}" if decimals >= 0 else f"{round(value, decimals):.0f}"
    return text.removeprefix("-") if float(text) == 0 else text


def significant(value: float, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits, trailing zeros kept within plain notation.

    Parameters
    ----------
    value : the number
    digits : significant ones
    """
    if not math.isfinite(value):
        return NONE
    if value == 0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if not -5 <= exponent <= 6:
        return f"{value:.{digits - 1}e}"
    return to_decimals(value, digits - 1 - exponent)


def round_pair(value: float, std: float) -> tuple[str, str]:
    """Value and standard deviation as texts: std to two significant digits, value to the same decimal.

    Parameters
    ----------
    value : the number
    std : its standard deviation

    >>> round_pair(-51.2345, 0.4567), round_pair(1234.0, 123.0), round_pair(2.0, 0.0)
    (('-51.23', '0.46'), ('1230', '120'), ('2.000', '0'))
    """
    if not math.isfinite(value):
        return NONE, NONE
    decimals = decimals_of(std)
    if decimals is None:
        return significant(value, 4), "0" if std == 0 else NONE
    if decimals in _PLAIN_DECIMALS:
        return to_decimals(value, decimals), to_decimals(std, decimals)
    exponent = 0 if value == 0 else int(f"{value:e}".partition("e")[2])
    return f"{value:.{max(0, exponent + decimals)}e}", f"{std:.{STD_DIGITS - 1}e}"


def plus_minus(value: float, std: float, unit: str = "") -> str:
    """``value +- std unit`` in one text.

    Parameters
    ----------
    value : the number
    std : its standard deviation
    unit : of both
    """
    shown, spread = round_pair(value, std)
    text = shown if spread == NONE else f"{shown} +- {spread}"
    return f"{text} {unit}".rstrip()


def percent(value: float, std: float) -> str:
    """std in % of |value|, two digits; ``-`` where the value is zero or something is not finite.

    Parameters
    ----------
    value : the number
    std : its standard deviation
    """
    if value == 0 or not math.isfinite(value) or not math.isfinite(std):
        return NONE
    return significant(100 * std / abs(value), 2)


def deviation(value: float, std: float, true: float | None) -> str:
    """(value - true)/std with its sign, one decimal.

    Parameters
    ----------
    value : the number
    std : its standard deviation
    true : true value, or None
    """
    if true is None or std <= 0 or not math.isfinite(std) or not math.isfinite(value):
        return NONE
    score = (value - true) / std
    text = to_decimals(score, 1) if abs(score) < 1000 else significant(score, 2)
    return text if text.startswith("-") or float(text) == 0 else f"+{text}"


def _true_text(std: float, true: float | None) -> str:
    if true is None:
        return NONE
    decimals = decimals_of(std)
    return to_decimals(true, decimals) if decimals in _PLAIN_DECIMALS and decimals is not None else significant(true, 4)


def derivative_row(key: str, derivative: Derivative) -> Row:
    """The table line of one derivative.

    Parameters
    ----------
    key : name in the result file
    derivative : as it stands there
    """
    value, std = round_pair(derivative.value, derivative.std)
    prime, prime_std = round_pair(1e3 * derivative.prime, 1e3 * derivative.prime_std)
    return Row(
        key,
        (SYMBOLS_TEXT | FREE_TEXT).get(key, key),
        value,
        std,
        derivative.unit,
        percent(derivative.value, derivative.std),
        prime,
        prime_std,
        _true_text(derivative.std, derivative.true_value),
        deviation(derivative.value, derivative.std, derivative.true_value),
    )


def derivative_rows(result: DerivativesFile) -> list[Row]:
    """The lines of the derivatives table in the file's order; then Y_vdot and N_rdot where the dry model was weighed and swung."""
    rows = [derivative_row(key, derivative) for key, derivative in result.derivatives.items()]
    alone = ("y_vdot_kg", "Y_vdot", result.y_vdot_kg, "kg"), ("n_rdot_kg_m2", "N_rdot", result.n_rdot_kg_m2, "kg m2")
    return rows + [quantity_row(key, symbol, value, unit) for key, symbol, value, unit in alone if value is not None]


def quantity_row(key: str, symbol: str, measured: Measured, unit: str, true: float | None = None) -> Row:
    """The table line of a number with its standard deviation.

    Parameters
    ----------
    key : name in the result file
    symbol : as it is printed
    measured : value and standard deviation
    unit : of both
    true : true value, or None
    """
    value, std = round_pair(measured.value, measured.std)
    share = percent(measured.value, measured.std)
    return Row(
        key,
        symbol,
        value,
        std,
        unit,
        share,
        true=_true_text(measured.std, true),
        deviation=deviation(measured.value, measured.std, true),
    )


def tension_measured(result: SteadyFile) -> bool:
    """Whether F stands in newtons; otherwise it is F/R."""
    return result.force_unit == "N"


def steady_rows(result: SteadyFile) -> list[Row]:
    """The lines of the steady table: X_v, slope, then Y_v, N_v, Y_delta delta, N_delta delta where known, then the pairs."""
    slope_unit = "N m" if tension_measured(result) else "m"
    rows = [
        quantity_row("x_v_m", "X_v", result.x_v_m, "m", result.x_v_true_m),
        quantity_row("slope", "k of X_T = X_v + k/F", result.slope, slope_unit),
    ]
    for key, symbol, unit in (
        ("y_v", "Y_v", "N s/m"),
        ("n_v", "N_v", "N s"),
        ("y_delta_delta", "Y_delta delta", "N"),
        ("n_delta_delta", "N_delta delta", "N m"),
    ):
        measured = getattr(result, key)
        if measured is not None:
            rows.append(quantity_row(key, symbol, measured, unit))
    rows += [
        quantity_row(f"pairs.{name}", f"X_v of {name}", measured, "m", result.x_v_true_m)
        for name, measured in result.pairs.items()
    ]
    return rows


def interval_text(low: float, high: float) -> str:
    """An interval ``low to high``, both to two digits of its width.

    Parameters
    ----------
    low : lower end
    high : upper end
    """
    decimals = decimals_of(abs(high - low))
    if decimals is None or decimals not in _PLAIN_DECIMALS:
        return f"{significant(low, 4)} to {significant(high, 4)}"
    return f"{to_decimals(low, decimals)} to {to_decimals(high, decimals)}"
