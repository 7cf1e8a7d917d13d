"""What is said of records that leave derivatives open: refusals, combinations, the run that would help, the transient."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from towline.identify import Fit, RunData, fit_runs
from towline.identify.limits.combinations import Combination, Determined
from towline.identify.limits.cure import Cure
from towline.identify.limits.identifiability import Identifiability
from towline.identify.limits.words import (
    combination_words,
    correlation_lines,
    cure_words,
    refusal_lines,
    transient_line,
    transient_share,
)
from towline.simulate import Hull, Tow
from towline.simulate.model import linear_system


@pytest.fixture(scope="module")
def run(campaigns: ModuleType) -> RunData:
    return campaigns.still_run(1.548, campaigns.times(4.0, 30.0), "modal")


@pytest.fixture(scope="module")
def fit(run: RunData, campaigns: ModuleType) -> Fit:
    """A fit whose six are the truth to the last digit."""
    return replace(fit_runs([run], "linear"), six=campaigns.SIX, speed_m_s=1.28)


def judged(fit: Fit, refused: tuple[int, ...] = (0, 3), combinations: tuple[Combination, ...] = ()) -> Identifiability:
    single = tuple(i for i in range(6) if i not in refused)
    return Identifiability(fit, fit.covariance, Determined(single, refused, combinations, np.zeros((0, 6))))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ([], "no single further run that was tried"),
        (
            [(1.649, 0.1, "a", 1)],
            "what would determine them: a second tow point 0.1 m forward of 'a' (X_T = 1.649 m), recorded from its release 0.15 m "
            "to the side (m - Y_vdot to 2 % and Y_r - mU to 3 %)",
        ),
        ([(1.349, -0.2, "b", 1)], "what would determine them: a second tow point 0.2 m aft of 'b' (X_T = 1.349 m)"),
        (
            [(1.549, 0.0, "c", 2)],
            "what would determine them: a run like 'c' whose record holds its release at rest 0.15 m to the side (m - Y_vdot to "
            "4 % and Y_r - mU to 7 %)",
        ),
    ],
)
def test_proposed_runs(fit: Fit, settings: list[tuple[float, float, str, float]], said: str) -> None:
    """Deviations that are 2.1 % of m' and 3.4 % of Y_R, or twice that."""
    sd = np.abs(fit.six) * [0.021, 0.1, 0.1, 0.034, 0.1, 0.1]
    cures = [Cure(*setting, wider * sd) for *setting, wider in settings]  # pyright: ignore[reportArgumentType]
    assert cure_words(cures, judged(fit), "these records").startswith(said)


def test_proposed_runs_are_alternatives(fit: Fit) -> None:
    one, two = Cure(1.649, 0.1, "a", np.abs(fit.six)), Cure(1.549, 0.0, "a", np.abs(fit.six))
    assert "; or a run like 'a'" in cure_words([one, two], judged(fit), "these records")


WHOLE = Combination(np.array([0.5, 0, -1.25, 1, 0, 0]), 3, -12.3456, 0.0123)
ALONE = Combination(np.array([0, 0, 0, 0, 0, 1.0]), 5, -57.6, 0.0)


@pytest.mark.parametrize(
    ("refused", "combination", "runs", "lines"),
    [
        ((), None, 1, []),
        (
            (5,), ALONE, 1,
            ["N_r is not determined by this record: no single number is given", "N_r = -57.600000 +- 0.000000 N m s"],
        ),
        (
            (0, 2, 3), WHOLE, 2,
            [
                "m - Y_vdot, Y_v and Y_r - mU are not determined by these records: no single number is given",
                "these records fix (Y_r - mU) + 0.5 (m - Y_vdot) - 1.25 Y_v = -12.346 +- 0.012 N s, not (m - Y_vdot), Y_v and "
                "(Y_r - mU) apart",
            ],
        ),
        (
            (0, 3), WHOLE, 1,
            [
                "m - Y_vdot and Y_r - mU are not determined by this record: no single number is given",
                "this record fixes (Y_r - mU) + 0.5 (m - Y_vdot) - 1.25 Y_v = -12.346 +- 0.012 N s, not (m - Y_vdot), Y_v and "
                "(Y_r - mU) apart",
            ],
        ),
    ],
)  # fmt: skip
def test_refusals(
    fit: Fit,
    run: RunData,
    refused: tuple[int, ...],
    combination: Combination | None,
    runs: int,
    lines: list[str],
) -> None:
    """What is refused, what is known in its place, and last the run that would help."""
    found = judged(fit, refused, () if combination is None else (combination,))
    said = refusal_lines(found, [], [run] * runs)
    assert said[:2] == lines
    assert said[2:] == ([cure_words([], found, "")] if lines else [])


@pytest.mark.parametrize(
    ("value", "sd", "said"), [(-123.4, 34.0, "-123 +- 34 N s"), (-12.3456, 0.0123, "-12.346 +- 0.012 N s")]
)
def test_a_combination_has_two_digits_of_its_deviation(value: float, sd: float, said: str) -> None:
    assert combination_words(replace(WHOLE, value=value, sd=sd)).endswith(f" = {said}")


def test_pairs_seen_as_one_are_said_once_with_their_factor() -> None:
    """Correlations of 0.96, -0.97 and 0.94; the factor is the correlation times the ratio of the deviations."""
    covariance = np.diag([4.0, 1.0, 9.0, 16.0, 1.0, 25.0])
    covariance[3, 0] = covariance[0, 3] = 0.96 * 2 * 4
    covariance[5, 4] = covariance[4, 5] = -0.97 * 5
    covariance[2, 1] = covariance[1, 2] = 0.94 * 3
    assert correlation_lines(covariance, tuple(range(6))) == [
        "Y_r - mU and m - Y_vdot are seen mostly as one combination (Y_r - mU - 1.92 (m - Y_vdot); correlation +0.960)",
        "N_r and N_v are seen mostly as one combination (N_r + 4.85 (N_v); correlation -0.970)",
    ]
    assert len(correlation_lines(covariance, (0, 1, 2, 3, 4))) == 1


@pytest.mark.parametrize("share", [0.0, 0.3, 2.0])
def test_the_transient_is_what_is_no_oscillation(fit: Fit, run: RunData, campaigns: ModuleType, share: float) -> None:
    """A start put together from the slow pair, 0.1 m in y, and a mode that only decays, ``share`` of it."""
    roots, shapes = np.linalg.eig(linear_system(Hull(*campaigns.SIX, speed_m_s=1.28), run.tow)[0])
    slow = int(np.argmin(np.where(roots.imag > 0, np.abs(roots.real), np.inf)))
    real = int(np.flatnonzero(np.abs(roots.imag) < 1e-9)[0])
    state = np.real(0.1 * np.exp(0.4j) * shapes[:, slow] / shapes[0, slow]) + share * 0.1 * np.real(
        shapes[:, real] / shapes[0, real]
    )
    begun = replace(fit, own=state[None])
    found: Any = transient_share(begun, run, 0)
    assert found == pytest.approx(share, abs=1e-9)
    assert transient_line(begun, [run]).endswith(f"in y: {100 * share:.0f} % ({run.name})")


def test_a_hull_that_never_swings_has_no_transient_to_speak_of(fit: Fit, run: RunData, campaigns: ModuleType) -> None:
    """Forty times the yaw damping: all four modes decay without an oscillation."""
    damped = replace(fit, six=campaigns.SIX * [1, 1, 1, 1, 1, 40], own=np.array([[0.1, 0.0, 0.0, 0.0]]))
    roots = np.linalg.eigvals(linear_system(Hull(*damped.six, speed_m_s=1.28), Tow(1.28, 0.91, 1.548, 3.96))[0])
    assert np.abs(roots.imag).max() < 1e-9
    assert transient_share(damped, run, 0) is None
    assert transient_line(damped, [run]) == ""
