"""The towed model: equations of motion (one place), integration, and videos rendered with their truth."""

from .characteristic import Stability, characteristic_coefficients, stability
from .model import DERIVATIVE_UNITS, Hull, Tow, linear_system
from .motion import Histories, Start, simulate_full, simulate_linear
from .scenario import hull_of, read_scenario, scenario_stability, simulate_scenario, tow_from_table

__all__ = [
    "DERIVATIVE_UNITS",
    "Histories",
    "Hull",
    "Stability",
    "Start",
    "Tow",
    "characteristic_coefficients",
    "hull_of",
    "linear_system",
    "read_scenario",
    "scenario_stability",
    "simulate_full",
    "simulate_linear",
    "simulate_scenario",
    "stability",
    "tow_from_table",
]
