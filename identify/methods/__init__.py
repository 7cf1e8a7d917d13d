"""The thesis's other estimators, one a module. Which one when: docs/methods/README.md."""

from .arx import (
    ArxFit,
    arx_derivatives,
    arx_of_records,
    continuous_coefficients,
    discrete_tow,
    fit_arx,
    suggested_decimation,
)
from .calibration import RateCalibration, calibrate_rate
from .characteristic import (
    AppendixOne,
    appendix_one,
    coefficients_from_roots,
    derivatives_from_coefficients,
    derivatives_from_roots,
    monic_coefficients,
    roots_from_coefficients,
)
from .common import Record, SixEstimate
from .criteria import CriterionFit, fit_criterion
from .decay import DecayFit, fit_decay
from .forced import Swing, forced_response, frequency_dependence, modal_derivatives, swing_from_alpha
from .free_run import FreeRecord, FreeRunFit, fit_free_run
from .frequency import FrequencyResponse, fit_frequency_response, measure_response
from .hull_conditions import (
    StraightLine,
    from_prime,
    neutral_stern_force,
    probability_by_sampling,
    straight_line_stability,
    to_prime,
    with_stern_force,
)
from .iv import FourStages, Polynomials, four_stage_iv
from .least_squares import LeastSquares, least_squares_svd
from .open_loop_fit import OpenLoopFit, fit_open_loop
from .phase import Amplitudes, PhaseEstimate, complex_amplitudes, phase_derivatives, phase_from_amplitudes
from .rates import Rates, RatesEstimate, regression_on_rates, smooth_rates
from .state_space import StateSpace, b_to_a, closed, feedback, model_a, model_b, open_loop, transformed
from .steady_hull import SteadyHull, damping_from_known_point, fit_steady_hull
from .transfer import (
    Bode,
    TransferFunction,
    bode,
    free_ship_transfer,
    line_force_transfer,
    open_loop_transfer,
    post_transfer,
    rudder_transfer,
)

__all__ = [
    "Amplitudes",
    "AppendixOne",
    "ArxFit",
    "Bode",
    "CriterionFit",
    "DecayFit",
    "FourStages",
    "FreeRecord",
    "FreeRunFit",
    "FrequencyResponse",
    "LeastSquares",
    "OpenLoopFit",
    "PhaseEstimate",
    "Polynomials",
    "RateCalibration",
    "Rates",
    "RatesEstimate",
    "Record",
    "SixEstimate",
    "StateSpace",
    "SteadyHull",
    "StraightLine",
    "Swing",
    "TransferFunction",
    "appendix_one",
    "arx_derivatives",
    "arx_of_records",
    "b_to_a",
    "bode",
    "calibrate_rate",
    "closed",
    "coefficients_from_roots",
    "complex_amplitudes",
    "continuous_coefficients",
    "damping_from_known_point",
    "derivatives_from_coefficients",
    "derivatives_from_roots",
    "discrete_tow",
    "feedback",
    "fit_arx",
    "fit_criterion",
    "fit_decay",
    "fit_free_run",
    "fit_frequency_response",
    "fit_open_loop",
    "fit_steady_hull",
    "forced_response",
    "four_stage_iv",
    "free_ship_transfer",
    "frequency_dependence",
    "from_prime",
    "least_squares_svd",
    "line_force_transfer",
    "measure_response",
    "modal_derivatives",
    "model_a",
    "model_b",
    "monic_coefficients",
    "neutral_stern_force",
    "open_loop",
    "open_loop_transfer",
    "phase_derivatives",
    "phase_from_amplitudes",
    "post_transfer",
    "probability_by_sampling",
    "regression_on_rates",
    "roots_from_coefficients",
    "rudder_transfer",
    "smooth_rates",
    "straight_line_stability",
    "suggested_decimation",
    "swing_from_alpha",
    "to_prime",
    "transformed",
    "with_stern_force",
]
