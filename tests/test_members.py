"""Effects as families: the evidence of sizes and members against integrals that are known in closed form."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import norm

from towline.diagnose.effects import LIBRARY, Effect, Parameter
from towline.diagnose.effects.members import any_of, with_some
from towline.diagnose.inference.members import log_evidence, mixed, over_widest, shares_of

TWO = Effect("two", "sway", (Parameter("a", "", 2.0), Parameter("b", "", 0.5)), "", "", members=with_some(["a"], ["b"]))


def by_integrals(effect: Effect, mean: np.ndarray, spread: np.ndarray) -> float:
    """Of numbers that the data tell apart, each with a normal likelihood: the prior's integral over that of no number."""
    names, sd = [p.name for p in effect.parameters], np.array([p.sd for p in effect.parameters])
    found = []
    for member in effect.members or (tuple(names),):
        there = np.array([name in member for name in names])
        for size in effect.sizes:
            wide = np.hypot(spread, size * sd * there)
            found.append(np.prod(norm.pdf(mean, 0, wide) / norm.pdf(mean, 0, spread)))
    return float(np.log(np.mean(found)))


def told(effect: Effect, mean: np.ndarray, spread: np.ndarray) -> float:
    sd = np.array([p.sd for p in effect.parameters])
    return mixed(log_evidence(np.diag((sd / spread) ** 2), sd * mean / spread**2, shares_of([effect])))


@pytest.mark.parametrize("mean", [(0.0, 0.0), (0.3, 0.0), (0.3, 0.2), (-0.2, 0.01)])
@pytest.mark.parametrize("effect", [TWO, replace(TWO, members=any_of("a", "b")), replace(TWO, members=())])
def test_the_evidence_of_a_family_is_the_integral_over_its_sizes_and_members(
    effect: Effect, mean: tuple[float, float]
) -> None:
    spread = np.array([0.02, 0.01])
    assert told(effect, np.array(mean), spread) == pytest.approx(by_integrals(effect, np.array(mean), spread), abs=1e-9)


def test_narrower_priors_over_the_widest_are_the_evidence_s_own_differences() -> None:
    """Well known, hardly known and correlated numbers, one on one side: by the data's information it is the same."""
    rng = np.random.default_rng(8)
    shares = np.array([[1.0, 1.0, 1.0], [0.3, 0.3, 0.3], [1.0, 0.0, 0.3], [0.0, 0.0, 0.0], [0.1, 1.0, 0.0]])
    for _ in range(20):
        root = rng.normal(size=(3, 3)) * [3.0, 0.5, 0.1]
        data, pull = root @ root.T, root @ root.T @ rng.normal(size=3)
        covariance = np.linalg.inv(np.eye(3) + data)
        expected = log_evidence(data, pull, shares, [1])
        beside = log_evidence(data, pull, shares[:1])  # the widest, whatever its side
        found = over_widest(covariance @ pull, covariance, shares, [1])
        np.testing.assert_allclose(found, expected - beside, rtol=1e-9, atol=1e-9)


def test_a_number_known_to_a_millionth_of_its_prior_costs_what_it_costs() -> None:
    """Exact fractions beside it: a winch's drag, known to 1e-6 of its prior, had been given 12,000 for what rounding left."""
    half = Fraction(1, 2)
    a, b, c = Fraction(1, 10**12), Fraction(9, 10**7), Fraction(1)  # covariance ((a, b), (b, c)), nearly singular
    mean = (Fraction(3), Fraction(1, 5))
    for share in (Fraction(0), Fraction(3, 10)):
        rest = share**2 / (1 - share**2)
        wide, other = a + rest, c + rest
        determinant = wide * other - b * b
        square = (other * mean[0] ** 2 - 2 * b * mean[0] * mean[1] + wide * mean[1] ** 2) / determinant
        expected = -float(half * square) - 0.5 * np.log(float(determinant)) - np.log(float(1 - share**2))
        known = np.array([[float(a), float(b)], [float(b), float(c)]])
        found = over_widest(np.array([3.0, 0.2]), known, np.full((1, 2), float(share)))
        assert found[0] == pytest.approx(expected, rel=1e-9)


def test_two_effects_have_every_pair_of_members_and_sizes() -> None:
    other = Effect("one", "yaw", (Parameter("c", "", 1.0),), "", "", sizes=(1.0, 0.1))
    shares = shares_of([TWO, other])
    assert shares.shape == (2 * len(TWO.sizes) * 2, 3)
    assert {tuple(row > 0) for row in shares} == {(True, False, True), (True, True, True)}


def test_a_simple_truth_is_not_charged_for_what_its_family_could_have() -> None:
    """With every number it pays for one that is not there; the family pays the choice of a member at most: log 2."""
    mean, spread = np.array([0.5, 0.0]), np.array([0.01, 1e-4])
    alone = Effect("a", "sway", TWO.parameters[:1], "", "")
    simple = told(alone, mean[:1], spread[:1])
    assert told(replace(TWO, members=()), mean, spread) < simple - 3.0
    assert simple - np.log(2) - 1e-9 < told(TWO, mean, spread) < simple


def test_members_are_of_numbers_that_there_are() -> None:
    with pytest.raises(ValueError, match=r"two: member .*z.*expected some of its numbers, \['a', 'b'\]"):
        replace(TWO, members=(("a",), ("z",)))
    with pytest.raises(ValueError, match="two: member"):
        replace(TWO, members=((),))
    assert any(e.members for e in LIBRARY)
