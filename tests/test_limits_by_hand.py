"""Parts of what the records cannot tell, by hand: walks and ends of a profile, proposed runs, anchors taken out, sentences."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towline.identify.limits import profile as profiles
from towline.identify.limits.bound import information_of_six
from towline.identify.limits.combinations import Combination
from towline.identify.limits.cure import Cure, _released
from towline.identify.limits.identifiability import ANCHOR_SHARE, OPEN_VARIANCE, _without
from towline.identify.limits.words import (
    combination_words,
    correlation_lines,
    cure_words,
    refusal_lines,
    transient_share,
)
from towline.simulate import Hull, Start, Tow, simulate_linear
from towline.simulate.model import linear_system

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)


@pytest.mark.parametrize(("index", "value", "sd"), [(0, 50.0, 1.0), (4, -3.0, 0.4), (1, 20.0, 20.0)])
def test_a_profile_of_a_parabola_ends_where_it_has_risen_by_3_841(
    monkeypatch: pytest.MonkeyPatch, index: int, value: float, sd: float
) -> None:
    """Steps of 0.7 sd, each half as long again; from m' and I' no lower than a tenth, no higher than tenfold: where the parabola
    is wider than that, there is no end."""
    asked = []

    def minimise(_: Any, theta: np.ndarray, weights: Any) -> Any:
        asked.append(theta.copy())
        assert weights == "weights"
        return SimpleNamespace(
            theta=theta + 0.1 * (np.arange(6) != index), chi_square=7.0 + ((theta[index] - value) / sd) ** 2
        )

    monkeypatch.setattr(profiles, "minimise", minimise)
    theta = np.full(6, 1.0)
    theta[index] = value
    ends = []
    nothing: Any = None
    for sign in (-1, 1):
        asked.clear()
        walked = profiles._walk(nothing, theta, 7.0, "weights", index, sign * 0.7 * sd)
        moved = np.cumsum(0.7 * 1.5 ** np.arange(len(walked)))
        np.testing.assert_allclose([v for v, _ in walked], value + sign * sd * moved)
        np.testing.assert_allclose([r for _, r in walked], moved**2)
        # each begins where the last one ended
        np.testing.assert_allclose([a[(index + 1) % 6] for a in asked], 1.0 + 0.1 * np.arange(len(asked)))
        ends.append(profiles._end(value, walked))
    high = value + np.sqrt(3.841) * sd
    if index == 1:
        assert ends[0] is None  # 20 - 14 is above 2, the next step would be below
        assert ends[1] == pytest.approx(high)
    else:
        assert ends == pytest.approx([2 * value - high, high])
    assert profiles._end(1.0, []) is None
    assert profiles._end(1.0, [(2.0, 3.84)]) is None


@pytest.mark.parametrize(("index", "value", "low", "high"), [(0, 50.0, 5.0, 500.0), (3, -50.0, -500.0, 400.0)])
def test_a_walk_that_finds_no_rise_stops_at_what_can_be(
    monkeypatch: pytest.MonkeyPatch, index: int, value: float, low: float, high: float
) -> None:
    """A mass between a tenth and ten times its value, a damping within nine times its size of it."""
    monkeypatch.setattr(profiles, "minimise", lambda _, theta, __: SimpleNamespace(theta=theta, chi_square=1.0))
    theta = np.full(6, value)
    nothing: Any = None
    for sign in (-1, 1):
        values = np.array([v for v, _ in profiles._walk(nothing, theta, 1.0, None, index, sign * 2.0)])
        assert ((values > low) & (values < high)).all()
        after = values[-1] + sign * 2.0 * 1.5 ** len(values)
        assert not low < after < high
        assert profiles._end(value, [(v, 0.0) for v in values]) is None
    # 14 steps at the most
    assert len(profiles._walk(nothing, theta, 1.0, None, index, 1e-3)) == 14


def test_a_proposed_run_is_that_of_the_linear_form_with_the_noise_that_was_seen(campaigns: ModuleType) -> None:
    run = campaigns.still_run(1.548, campaigns.times(8.0, 20.0), "linear")
    covariance = np.tile([[4e-6, 1e-6], [1e-6, 9e-6]], (len(run.t_s), 1, 1))
    covariance[0] *= 100  # the median is what counts
    run = replace(run, covariance=covariance, t_s=run.t_s + 3.0)
    made = _released(run, SIX, 1.28, 0.1, np.array([2.0, 0.5]))
    assert made is not None
    np.testing.assert_allclose(made.covariance[7], [[16e-6, 1e-6], [1e-6, 2.25e-6]])
    tow = made.tow
    assert (tow.tow_point_m, tow.line_length_m, tow.post_amplitude_m) == (1.548 + 0.1, run.tow.line_length_m, 0.0)
    np.testing.assert_allclose(made.t_s, np.arange(len(run.t_s)) / 8)
    wanted = simulate_linear(HULL, tow, Start(y_cg_m=0.15), made.t_s)
    np.testing.assert_allclose(made.y_m, wanted["y_cg_m"], atol=1e-6)
    np.testing.assert_allclose(made.beta_rad, wanted["beta_rad"], atol=1e-6)
    neutral = SIX[4] / SIX[2]
    aft = neutral - 1.548
    assert _released(run, SIX, 1.28, aft - 0.001, np.ones(2)) is None
    assert _released(run, SIX, 1.28, -1.6, np.ones(2)) is None
    # forward of the neutral point, but growing: wider than 0.8 L before its 20 s are over, or not
    wild = SIX * [1, 1, 1, 1, 1, -0.3]
    assert _released(run, wild, 1.28, 0.0, np.ones(2)) is None
    short = replace(
        run, **{k: getattr(run, k)[:8] for k in ("t_s", "y_m", "beta_rad", "covariance")}, common=run.common[:, :8]
    )
    assert _released(short, wild, 1.28, 0.0, np.ones(2)) is not None


def test_an_anchor_is_taken_out_again() -> None:
    """What was known without it comes back; a direction that held nothing but the anchor is open."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    size, anchor = np.abs(SIX), SIX * [1.2, 0.9, 1, 1, 1, 1]
    scaled = root @ root.T + 300 * np.eye(6)
    held = scaled.copy()
    for i in range(2):
        held[i, i] += (size[i] / (ANCHOR_SHARE * anchor[i])) ** 2
    outer = np.outer(size, size)
    np.testing.assert_allclose(
        _without(np.linalg.inv(held) * outer, SIX, anchor), np.linalg.inv(scaled) * outer, rtol=1e-8
    )
    only = np.diag(
        [(size[0] / (ANCHOR_SHARE * anchor[0])) ** 2, *[400.0 + (1 / (ANCHOR_SHARE * 0.9)) ** 2], *[400.0] * 4]
    )
    found = np.diag(_without(np.linalg.inv(only) * outer, SIX, anchor)) / size**2
    np.testing.assert_allclose(found, [OPEN_VARIANCE, *[1 / 400] * 5], rtol=1e-6)


def test_what_is_left_of_the_information_is_the_inverse_of_the_six_inverted() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(10, 40)) * 10.0 ** np.arange(-4, 6)[:, None]
    matrix = root @ root.T
    free = np.array([True] * 6 + [True, False, True, True])
    kept = np.flatnonzero(free)
    problem: Any = SimpleNamespace(free=free)
    whole = np.linalg.inv(matrix[np.ix_(kept, kept)])[:6, :6]
    found = information_of_six(matrix, problem) @ whole
    scale = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(found * scale[:, None] ** -1 * scale, np.eye(6) * 1.0, atol=1e-5)


def found(**more: Any) -> Any:
    fit: Any = SimpleNamespace(six=SIX)
    parts = SimpleNamespace(**{"refused": (0, 3), "single": (1, 2, 4, 5), "combinations": (), **more})
    return SimpleNamespace(fit=fit, parts=parts)


def test_proposed_runs_in_words() -> None:
    sd = np.abs(SIX) * [0.021, 0.1, 0.1, 0.034, 0.1, 0.1]
    runs = [Cure(1.649, 0.1, "a", sd), Cure(1.349, -0.2, "b", sd), Cure(1.549, 0.0, "c", 2 * sd)]
    assert cure_words(runs, found(), "x") == (
        "what would determine them: a second tow point 0.1 m forward of 'a' (X_T = 1.649 m), recorded from its release 0.15 m to "
        "the side (m - Y_vdot to 2 % and Y_r - mU to 3 %); or a second tow point 0.2 m aft of 'b' (X_T = 1.349 m), recorded from "
        "its release 0.15 m to the side (m - Y_vdot to 2 % and Y_r - mU to 3 %); or a run like 'c' whose record holds its release "
        "at rest 0.15 m to the side (m - Y_vdot to 4 % and Y_r - mU to 7 %)"
    )
    assert cure_words([], found(), "x").startswith("no single further run that was tried")


def test_refusals_in_words() -> None:
    run: Any = None
    assert refusal_lines(found(refused=()), [], [run]) == []
    whole = Combination(np.array([0.5, 0, -1.25, 1, 0, 0]), 3, -12.3456, 0.0123)
    alone = Combination(np.array([0, 0, 0, 0, 0, 1.0]), 5, -57.6, 0.0)
    one = refusal_lines(found(refused=(5,), combinations=(alone,)), [], [run])
    assert one[:2] == [
        "N_r is not determined by this record: no single number is given",
        "N_r = -57.600000 +- 0.000000 N m s",
    ]
    two = refusal_lines(found(refused=(0, 2, 3), combinations=(whole,)), [], [run, run])
    assert two[:2] == [
        "m - Y_vdot, Y_v and Y_r - mU are not determined by these records: no single number is given",
        "these records fix (Y_r - mU) + 0.5 (m - Y_vdot) - 1.25 Y_v = -12.346 +- 0.012 N s, not (m - Y_vdot), Y_v and (Y_r - mU) "
        "apart",
    ]
    assert refusal_lines(found(refused=(0, 3), combinations=(whole,)), [], [run])[1].startswith(
        "this record fixes (Y_r - mU) +"
    )
    assert combination_words(replace(whole, value=-123.4, sd=34.0)).endswith("= -123 +- 34 N s")


def test_pairs_seen_as_one_are_said_once_with_their_factor() -> None:
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
def test_the_transient_is_what_is_no_oscillation(share: float) -> None:
    """A start put together from the slow pair, 0.1 m in y, and a fast mode of a share of it."""
    tow = Tow(1.28, 0.91, 1.548, 3.96)
    roots, shapes = np.linalg.eig(linear_system(HULL, tow)[0])
    slow = int(np.argmin(np.where(roots.imag > 0, np.abs(roots.real), np.inf)))
    real = int(np.flatnonzero(np.abs(roots.imag) < 1e-9)[0])
    state = np.real(0.1 * np.exp(0.4j) * shapes[:, slow] / shapes[0, slow]) + share * 0.1 * np.real(
        shapes[:, real] / shapes[0, real]
    )
    fit: Any = SimpleNamespace(six=SIX, speed_m_s=1.28, form="linear", own=state[None])
    run: Any = SimpleNamespace(tow=tow)
    found: Any = transient_share(fit, run, 0)
    assert found == pytest.approx(share, abs=1e-9)
    over: Any = SimpleNamespace(six=SIX * [1, 1, 1, 1, 1, 40], speed_m_s=1.28, form="linear", own=state[None])
    assert transient_share(over, run, 0) is None  # all four modes die away without a swing
