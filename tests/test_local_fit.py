"""A polynomial through what was measured about a time: of polynomials, where nothing was measured, and near the ends."""

import numpy as np

from towline.geometry.local_fit import local_fit


def test_a_polynomial_is_its_own_with_gaps_and_ends() -> None:
    """1 + 2 t - 3 t^2 and 4 t, measured unevenly with a second missing: value, rate and half the second derivative."""
    t_s = np.delete(np.sort(np.random.default_rng(0).uniform(0, 10, 400)), slice(180, 220))
    values = np.column_stack([1 + 2 * t_s - 3 * t_s**2, 4 * t_s])
    at_s = np.array([0.0, 3.3, t_s[179] + 0.1, 10.0])
    found, told = local_fit(t_s, values, at_s, 0.8, 2, 0.2)
    assert told.all()
    rate = np.column_stack([2 - 6 * at_s, np.full(4, 4.0)])
    np.testing.assert_allclose(found[:, 0], np.column_stack([1 + 2 * at_s - 3 * at_s**2, 4 * at_s]), atol=1e-9)
    np.testing.assert_allclose(found[:, 1] / 0.8, rate, atol=1e-9)
    np.testing.assert_allclose(found[:, 2] / 0.8**2, np.tile([-3.0, 0.0], (4, 1)), atol=1e-8)


def test_it_is_not_told_where_too_little_was_measured() -> None:
    """No measurement in reach, fewer than a parabola needs, and all of them at one end of the reach."""
    t_s = np.array([0.0, 0.1, 5.0, 5.01, 5.02, 5.03])
    found, told = local_fit(t_s, np.ones((6, 1)), np.array([2.5, 0.05, 4.2]), 1.0, 2)
    assert not told.any()
    assert (found == 0).all()
    assert not local_fit(np.zeros(0), np.zeros((0, 1)), np.array([1.0]), 1.0, 2)[1].any()


def test_what_is_nearest_can_be_left_out() -> None:
    """A spike at the time itself and beside it, within 0.2 s, is not seen."""
    t_s = np.arange(0, 4, 0.1)
    values = np.where(np.abs(t_s - 2.0) < 0.15, 100.0, t_s)[:, None]
    assert abs(local_fit(t_s, values, np.array([2.0]), 1.0, 2, 0.1)[0][0, 0, 0] - 2.0) < 1e-9
    assert local_fit(t_s, values, np.array([2.0]), 1.0, 2)[0][0, 0, 0] > 10
