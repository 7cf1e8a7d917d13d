"""The budget of X_v from steady tows: each line against a refit with that input wrong, the whole against the fit and by drawing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from towline.identify.budget.steady_lines import SteadyBudget, steady_budget
from towline.identify.steady import Along, SteadyState, fit_steady

X_V, K = 0.92, 0.1
POINTS_M = (1.3, 1.45, 1.6, 1.75)
FRAMES = np.diag([4e-8, 1e-8])
MODES = np.array([[4e-4, -1e-4], [1e-4, 3e-4]])
DRAWS = 600


def tow(x_t: float, **more) -> SteadyState:
    """On the line X_T = X_v + k/F by T = 4 N."""
    whole = float(np.arcsin(K / (x_t - X_V) / 4.0))
    given = {"tension_n": 4.0, "tension_sd_rel": 0.004, "tow_point_sd_m": 7e-4, "common": MODES, "common_key": "camera"}
    return SteadyState(f"at {x_t}", x_t, 0.8 * whole, 0.2 * whole, FRAMES, **{**given, **more})


@pytest.fixture(scope="module")
def tows() -> list[SteadyState]:
    return [tow(x) for x in POINTS_M]


@pytest.fixture(scope="module")
def found(tows: list[SteadyState]) -> SteadyBudget:
    return steady_budget(tows, fit_steady(tows))


def x_v(tows: Sequence[SteadyState]) -> float:
    return fit_steady(list(tows)).x_v_m.value


def of(budget: SteadyBudget, source: str) -> float:
    return float(np.sqrt(sum(line.contribution_m**2 for line in budget.lines if line.source == source)))


def by_one(tows: list[SteadyState], change: Callable[[SteadyState], SteadyState]) -> float:
    """Root sum of squares of what X_v moves by as each tow in turn is changed."""
    here = x_v(tows)
    return float(np.sqrt(sum((x_v([*tows[:k], change(t), *tows[k + 1 :]]) - here) ** 2 for k, t in enumerate(tows))))


def test_the_lines_sum_to_what_the_fit_states(tows: list[SteadyState], found: SteadyBudget) -> None:
    assert found.combined_m == pytest.approx(fit_steady(tows).x_v_m.std, rel=1e-6)
    assert found.closure < 1e-6
    assert {line.source for line in found.lines} == {"pixels, frame to frame", "camera", "tension gauge", "tow point"}
    assert found.expanded_m == pytest.approx(1.959964 * found.combined_m)


def test_each_line_is_what_a_refit_says(tows: list[SteadyState], found: SteadyBudget) -> None:
    """Each input stated wrong by one standard uncertainty; to 1 %, the errors are small."""
    pulled = by_one(tows, lambda t: replace(t, tension_n=4.0 * (1 + t.tension_sd_rel)))
    assert of(found, "tension gauge") == pytest.approx(pulled, rel=0.01)
    moved = by_one(tows, lambda t: replace(t, tow_point_m=t.tow_point_m + t.tow_point_sd_m))
    assert of(found, "tow point") == pytest.approx(moved, rel=0.01)
    alpha, beta = np.sqrt(np.diag(FRAMES))
    aside = [
        by_one(tows, lambda t: replace(t, alpha_rad=t.alpha_rad + alpha)),
        by_one(tows, lambda t: replace(t, beta_rad=t.beta_rad + beta)),
    ]
    assert of(found, "pixels, frame to frame") == pytest.approx(np.hypot(*aside), rel=0.01)
    # a mode of the camera moves all tows together
    here = x_v(tows)
    modes = [
        x_v([replace(t, alpha_rad=t.alpha_rad + a, beta_rad=t.beta_rad + b) for t in tows]) - here for a, b in MODES
    ]
    assert of(found, "camera") == pytest.approx(np.hypot(*modes), rel=0.01)


def test_what_the_hull_resists_along_itself_has_lines_of_its_own() -> None:
    """The exponent and the drag are errors of all tows together."""
    along = Along((1.85, 0.1), (-0.8, 0.4))
    tows = [tow(x, along=along, tension_n=None, tension_sd_rel=0.0) for x in POINTS_M]
    found, here = steady_budget(tows, fit_steady(tows)), x_v(tows)
    for name, other in (
        ("resistance_exponent", replace(along, exponent=(1.86, 0.1))),
        ("x_vv_kg_m", replace(along, drag=(-0.76, 0.4))),
    ):
        (line,) = [line for line in found.lines if line.name == name]
        # a tenth of the standard uncertainty: the whole is not small
        assert line.contribution_m == pytest.approx(
            10 * abs(x_v([replace(t, along=other) for t in tows]) - here), rel=0.02
        )


def test_draws_of_every_input_scatter_as_it_says(tows: list[SteadyState], found: SteadyBudget) -> None:
    """JCGM 101: 600 draws tell a standard deviation to 2.9 %."""
    rng, values = np.random.default_rng(6), []
    for _ in range(DRAWS):
        shared = rng.standard_normal(2) @ MODES
        drawn = []
        for t in tows:
            alpha, beta = shared + rng.standard_normal(2) * np.sqrt(np.diag(FRAMES))
            pull, point = rng.standard_normal(2) * (t.tension_sd_rel, t.tow_point_sd_m)
            drawn.append(
                replace(
                    t,
                    alpha_rad=t.alpha_rad + alpha,
                    beta_rad=t.beta_rad + beta,
                    tension_n=4.0 * (1 + pull),
                    tow_point_m=t.tow_point_m + point,
                )
            )
        values.append(x_v(drawn))
    assert np.std(values) == pytest.approx(found.combined_m, rel=0.09)


def test_tows_off_the_line_are_a_line_of_type_a(tows: list[SteadyState]) -> None:
    off = [replace(t, alpha_rad=t.alpha_rad * (1 + 0.1 * (-1) ** k)) for k, t in enumerate(tows)]
    fit = fit_steady(off)
    found = steady_budget(off, fit)
    last = found.lines[-1]
    assert (last.source, last.evaluation, last.degrees) == ("tows off the line", "A", 2.0)
    assert found.combined_m == pytest.approx(fit.x_v_m.std, rel=1e-6)
    assert found.factor > 3
