"""Sizes that go together: of model, line, tank, weight, force and angles, as run.toml states them, without camera or film.

Ranges are far wider than any tank's: what lies outside is in another unit.
"""

from __future__ import annotations

import numpy as np

from ...record.schema import RunFile

IMPOSSIBLE = 1e3
"""The number of what cannot be, or lies out of every range."""
SLENDER = (1e-4, 0.1)
"""Of a displacement hull, mass over density and length cubed: a racing shell has 3e-4, a tug 0.05."""
RESISTANCE = (0.28, 29.0)
"""Force of a straight tow over the friction of a plate of the hull's wetted surface (ITTC 1957): 0.8 to 6 for models of ships.
A choice, about three and five times beyond, less than the 9.81 of a kgf, so that most forces in it show."""
VISCOSITY_M2_S = 1.1e-6
"""Of fresh water near 17 degrees."""

RANGES: dict[str, tuple[float, float]] = {
    "tow.line_length_m": (0.02, 25.0),
    "tow.tow_point_m": (0.0, 1.5),
    "tow.tow_point_offset_m": (0.0, 0.5),
    "marker.body_m": (0.0, 1.0),
    "marker.depth_m": (0.0, 2.0),
    "model.beam_m": (0.03, 1.2),
    "model.rudder_arm_m": (0.0, 0.9),
    "water.tank_width_m": (0.2, 100.0),
}
"""Sizes over the model's length between perpendiculars: wider than any tank's."""
SPREADS_M: dict[str, float] = {
    "priors.tow_point_sd_m": 0.1,
    "priors.line_length_sd_m": 0.1,
    "priors.y_bias_sd_m": 0.5,
    "priors.marker_depth_sd_m": 0.1,
    "priors.marker_place_sd_m": 0.1,
}
"""Standard deviations that nobody states who has a tape measure: larger ones are in millimetres."""
ANGLES_RAD: dict[str, float] = {"tow.rudder_rad": 0.9, "model.trim_rad": 0.07, "priors.beta_bias_sd_rad": 0.15}
"""Larger angles are in degrees: no rudder goes beyond 50 degrees, no model floats trimmed by a fourteenth of its length."""


def odd_sizes(file: RunFile) -> dict[str, float]:
    """Numbers of single keys, by key, and "hull", "force": 0 ordinary, ``IMPOSSIBLE`` out of every range.

    Parameters
    ----------
    file : run.toml's content
    """
    found: dict[str, float] = {}
    tow, model, water = file.tow, file.model, file.water

    def put(name: str, wrong: bool) -> None:
        found[name] = IMPOSSIBLE if wrong or found.get(name) else 0.0

    if model is not None:
        values = [
            ("tow.line_length_m", tow.line_length_m if tow else None),
            ("tow.tow_point_m", tow.tow_point_m if tow else None),
            ("tow.tow_point_offset_m", tow.tow_point_offset_m if tow else None),
            *(("marker.body_m", v) for m in file.marker if m.on == "model" for v in m.body_m),
            *(("marker.depth_m", m.depth_m) for m in file.marker if m.on == "model"),
            ("model.beam_m", model.beam_m),
            ("model.rudder_arm_m", model.rudder_arm_m),
            ("water.tank_width_m", water.tank_width_m if water else None),
        ]
        for key, value in values:
            if value is not None:
                low, high = RANGES[key]
                put(key, not low <= abs(value) / model.length_pp_m <= high)
        density = water.density_kg_m3 if water else 1000.0
        full = model.mass_kg / density / model.length_pp_m**3
        put("hull", not SLENDER[0] <= full <= SLENDER[1])
        force = tow.tension_n if tow else None
        if tow is not None and force and tow.speed_m_s > 0 and not found["hull"]:
            share = force / _plate_n(model.mass_kg, model.length_pp_m, tow.speed_m_s, density)
            put("force", not RESISTANCE[0] <= share <= RESISTANCE[1])
    for key, most in {**SPREADS_M, **ANGLES_RAD}.items():
        table, name = key.split(".")
        value = getattr(getattr(file, table), name, None)
        if value is not None:
            put(key, abs(value) > most)
    return found


def _plate_n(mass_kg: float, length_m: float, speed_m_s: float, density_kg_m3: float) -> float:
    """Friction of a plate of a hull's wetted surface, N; the surface by 2.6 roots of displacement times length (Taylor)."""
    reynolds = max(speed_m_s * length_m / VISCOSITY_M2_S, 1e3)
    friction = 0.075 / (np.log10(reynolds) - 2) ** 2
    surface = 2.6 * np.sqrt(mass_kg / density_kg_m3 * length_m)
    return float(0.5 * density_kg_m3 * surface * speed_m_s**2 * friction)


__all__ = ["ANGLES_RAD", "IMPOSSIBLE", "RANGES", "odd_sizes"]
