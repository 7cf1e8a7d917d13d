"""Density of fresh water by its temperature, and what an error of the thermometer does to it."""

from __future__ import annotations

from ...record.errors import InputError

COLDEST_DEG_C, WARMEST_DEG_C = 0.0, 40.0
"""Range of the formula."""
FORMULA = "Tanaka et al. 2001"
"""In words, for a budget's origin."""


def fresh_water_density_kg_m3(temperature_deg_c: float) -> float:
    """Density of pure water at one atmosphere, kg/m3, to 1e-3 (Tanaka et al., Metrologia 38 (2001) 301, recommended by the CIPM).

    Parameters
    ----------
    temperature_deg_c : 0 to 40

    Raises
    ------
    InputError : outside of that

    Examples
    --------
    >>> round(fresh_water_density_kg_m3(20.0), 3)
    998.207
    """
    t = temperature_deg_c
    if not COLDEST_DEG_C <= t <= WARMEST_DEG_C:
        raise InputError(
            "water", "temperature_deg_c", f"{t:g}, expected {COLDEST_DEG_C:g} to {WARMEST_DEG_C:g} degrees Celsius"
        )
    return 999.974950 * (1 - (t - 3.983035) ** 2 * (t + 301.797) / (522528.9 * (t + 69.34881)))


def density_slope_kg_m3_deg(temperature_deg_c: float) -> float:
    """Change of the density with a degree, kg/m3; the formula's own derivative.

    Parameters
    ----------
    temperature_deg_c : 0 to 40

    Examples
    --------
    >>> round(density_slope_kg_m3_deg(20.0), 2)
    -0.21
    """
    t, off = temperature_deg_c, temperature_deg_c - 3.983035
    share = 2 / off + 1 / (t + 301.797) - 1 / (t + 69.34881) if off else 0.0
    return (fresh_water_density_kg_m3(t) - 999.974950) * share


__all__ = ["FORMULA", "density_slope_kg_m3_deg", "fresh_water_density_kg_m3"]
