"""Motion -> derivatives: joint output-error fit, steady state, phase analysis."""

from .analytic import phase_analysis
from .colour.choose import NOISES, fit_with_noise
from .data import RunData, run_data
from .fit import FORMS, Fit, fit_runs
from .prime import prime_factors
from .report import derivatives_file, steady_file
from .steady import SteadyFit, SteadyState, fit_steady, steady_state, two_tow_x_v

__all__ = [
    "FORMS",
    "NOISES",
    "Fit",
    "RunData",
    "SteadyFit",
    "SteadyState",
    "derivatives_file",
    "fit_runs",
    "fit_steady",
    "fit_with_noise",
    "phase_analysis",
    "prime_factors",
    "run_data",
    "steady_file",
    "steady_state",
    "two_tow_x_v",
]
