"""Motion -> derivatives: joint output-error fit, steady state, phase analysis."""

from .analytic import phase_analysis
from .colour.choose import NOISES, fit_with_noise
from .data import RunData, run_data
from .fit import FORMS, Fit, fit_runs
from .free import FreeData, FreeFit, fit_free, free_data, free_file
from .prime import prime_factors
from .report import derivatives_file, six_file, steady_file
from .steady import SteadyFit, SteadyState, fit_steady, steady_state, two_tow_x_v
from .trim import same_trim, trim_groups

__all__ = [
    "FORMS",
    "NOISES",
    "Fit",
    "FreeData",
    "FreeFit",
    "RunData",
    "SteadyFit",
    "SteadyState",
    "derivatives_file",
    "fit_free",
    "fit_runs",
    "fit_steady",
    "fit_with_noise",
    "free_data",
    "free_file",
    "phase_analysis",
    "prime_factors",
    "run_data",
    "same_trim",
    "six_file",
    "steady_file",
    "steady_state",
    "trim_groups",
    "two_tow_x_v",
]
