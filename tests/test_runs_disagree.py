"""Whether runs agree about what they share: against the density of all values, written down whole.

The campaign is linear, y = a0 + rate t (+ size sin), in white noise, with a start of its own in each run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_fits import fitted
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.gap import diagnosed
from towline.diagnose.inference.disagree import SPREADS, Disagreement, disagreement
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator

NOISE_M, STEP_S, COUNT = 1e-3, 0.2, 40
T_S = STEP_S * np.arange(COUNT)
RATE_M_S, START_M, EFFECT_M = 0.02, 0.1, 0.01
WAVE = np.sin(4.0 * T_S + 0.5)
BEND = Effect("bend", "sway", (Parameter("y_b", "m", EFFECT_M),), "It bends.", "Straighten it.", sizes=(1.0,))
TWIST = Effect("twist", "yaw", (Parameter("n_t", "m", EFFECT_M),), "It twists.", "Untwist it.", sizes=(1.0,))
WIDE_M = 300 * NOISE_M
"""As good as unknown, and no trouble to numbers."""


def line(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
    total = n["a0"] + n["rate"] * T_S[:, None]
    for name, (size,) in effects.items():
        total = total + size * (WAVE if name == "bend" else np.sign(WAVE))[:, None]
    return total[:, None]


def campaign(planted: np.ndarray) -> UsersSimulator:
    """What is planted (runs, n) stands on the straight lines, noise included."""
    runs = [
        UsersRun(f"run-{k}", T_S, (START_M + RATE_M_S * T_S + more)[:, None], NOISE_M**2 * np.eye(COUNT)[None])
        for k, more in enumerate(planted)
    ]
    own = [UsersNumber("a0", [START_M] * len(runs))]
    return UsersSimulator(runs, line, [UsersNumber("rate", RATE_M_S, size=RATE_M_S)], own, usual_force=1e-3)


def white(seed: int, runs: int) -> np.ndarray:
    return NOISE_M * np.random.default_rng(seed).normal(size=(runs, COUNT))


def told(simulator: UsersSimulator, *effects: Effect) -> Disagreement:
    """Of the fit with these effects, without random forces."""
    return disagreement(*fitted(simulator, *effects))


def by_density(planted: np.ndarray, columns: list[np.ndarray], sd: list[float]) -> float:
    """Log evidence from the density of all values at once: noise, starts and shared numbers as widely as they may be, and those
    that each run has beside, spread by so many of an average run's standard deviations."""
    runs = len(planted)
    free = np.column_stack(columns)
    centred = free - free.mean(axis=0)
    alone = np.linalg.inv(centred.T @ centred / NOISE_M**2)

    still = np.kron(np.eye(runs), NOISE_M**2 * np.eye(COUNT) + WIDE_M**2)
    still += np.kron(np.ones((runs, runs)), free @ np.diag(np.square(sd)) @ free.T)
    apart = np.kron(np.eye(runs), free @ alone @ free.T)
    values = planted.ravel()
    logs = [multivariate_normal(cov=still + s**2 * apart).logpdf(values) for s in (0.0, *SPREADS)]  # pyright: ignore
    return float(logsumexp(logs[1:]) - np.log(len(SPREADS)) - logs[0])


@pytest.mark.parametrize("unlike", [0.0, 2.0, 6.0])
def test_it_is_the_evidence_of_numbers_of_each_runs_own(unlike: float) -> None:
    """Noise alone, and rates that differ from run to run by so many of their standard deviations."""
    runs = 4
    by = unlike * NOISE_M / np.sqrt(((T_S - T_S.mean()) ** 2).sum())
    planted = white(1, runs) + by * np.array([1.0, -1.0, 1.0, -1.0])[:, None] * T_S
    found = told(campaign(planted))
    assert found.log_evidence == pytest.approx(by_density(planted, [T_S], [WIDE_M]), abs=0.02)
    assert found.count == 1
    assert (found.log_evidence > 3) == (unlike > 3)


@pytest.mark.parametrize(("usual_m", "within"), [(EFFECT_M, 0.02), (1e-2 * EFFECT_M, 1.0)])
def test_an_effects_number_is_one_of_them_however_large_it_is(usual_m: float, within: float) -> None:
    """Thirty times its usual size in one run and ten times in three others are a disagreement, sixty times in all are none. What is
    usual of it hardly counts: it may be as large as it was found, one standard deviation then, worth half a unit.
    """
    planted = white(2, 4) + NOISE_M * np.array([3.0, 1.0, 1.0, 1.0])[:, None] * WAVE
    bend = replace(BEND, parameters=(replace(BEND.parameters[0], sd=usual_m),))
    found = told(campaign(planted), bend)
    assert found.log_evidence == pytest.approx(by_density(planted, [T_S, WAVE], [WIDE_M, WIDE_M]), abs=within)
    assert found.count == 2
    assert int(np.argmax(found.by_run)) == 0
    alike = told(campaign(white(2, 4) + 6 * NOISE_M * WAVE), bend)
    assert alike.log_evidence < 0


@pytest.mark.slow
def test_of_noise_odds_are_no_larger_than_chance_allows() -> None:
    """Odds of noise have a mean of 1, and by Markov's inequality exceed e^2 at most in a share e^-2 of all."""
    logs = np.array([told(campaign(white(seed, 4)), BEND).log_evidence for seed in range(100)])
    odds = np.exp(logs)
    assert odds.mean() < 1 + 4 * odds.std() / np.sqrt(len(odds))
    # at most 13.5 of a hundred on the mean: 27 and more come by chance once in 10,000
    assert (logs > 2).sum() < 27


def test_one_run_agrees_with_itself() -> None:
    assert told(campaign(white(3, 1))).log_evidence == 0.0


@pytest.mark.once
@pytest.mark.parametrize("seed", range(4, 7))
@pytest.mark.parametrize(
    ("sizes", "verdict"), [((3.0, 1.0, 3.0, 1.0), "form_not_exact"), ((3.0, -2.5, 2.5, -2.0), "unknown")]
)
def test_what_has_another_size_in_every_run_is_not_the_effect_as_it_stands(
    sizes: tuple[float, ...], verdict: str, seed: int
) -> None:
    """All that is left over is as smooth as the effect: it stands out at no time and no frequency."""
    planted = white(seed, 4) + NOISE_M * np.array(sizes)[:, None] * WAVE
    found = diagnosed(campaign(planted), [BEND], "test", {}, rng=np.random.default_rng(0))
    assert found.file.verdict == verdict
    assert found.ranking.rest.disagree
    assert any("The runs do not agree" in said for said in found.file.sentences)


@pytest.mark.parametrize("seed", range(7, 10))
def test_what_has_one_size_is_named(seed: int) -> None:
    planted = white(seed, 4) + 3 * NOISE_M * WAVE
    found = diagnosed(campaign(planted), [BEND, TWIST], "test", {}, rng=np.random.default_rng(0)).file
    assert found.verdict == "effect"
    assert found.ranking[0].effects == ["bend"]
