"""Each run's own parameters eliminated by themselves: the same as with the whole matrix, on random problems."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.joint.arrow import Arrow, Layout, inverse_of, widened

Parts = list[tuple[np.ndarray, np.ndarray]]


def drawn(seed: int, runs: int, own: int, behind: int) -> tuple[Layout, Arrow, np.ndarray, np.ndarray, Parts]:
    """An information with its dense form, what is free, and more variance of the score; parameters of very different sizes."""
    rng = np.random.default_rng([5, seed])
    layout = Layout(6, own, runs, 6 + own * runs + behind)
    size = 10.0 ** rng.uniform(-3, 3, layout.size)
    arrow, dense, more = Arrow.zeros(layout), np.zeros((layout.size, layout.size)), []
    for run in range(runs):
        columns = rng.permutation(np.concatenate([layout.own_of(run), layout.shared]))[: own + 6 + behind - 2]
        slope = rng.normal(size=(len(columns), 60)) * size[columns, None]
        arrow.add(columns, slope @ slope.T)
        dense[np.ix_(columns, columns)] += slope @ slope.T
        meat = slope[:, :9] @ slope[:, :9].T
        more.append((columns, meat))
    pulled = np.concatenate([np.arange(layout.size), [0, 0, layout.begin]])
    pull = 0.1 * size[pulled] ** 2
    arrow.add_diagonal(pulled, pull)
    np.add.at(dense, (pulled, pulled), pull)
    free = rng.uniform(size=layout.size) > 0.15
    return layout, arrow, dense, free, more


def near(found: np.ndarray, wanted: np.ndarray) -> None:
    """To 1e-10 of the largest: relative to the diagonal for a matrix."""
    scale = np.sqrt(np.abs(np.diag(wanted))) if wanted.ndim == 2 else np.ones(len(wanted))
    scale = np.where(scale > 0, scale, 1.0)
    outer = np.outer(scale, scale) if wanted.ndim == 2 else np.abs(wanted).max()
    assert np.abs((found - wanted) / outer).max() < 1e-10


@pytest.mark.parametrize(("runs", "own", "behind"), [(1, 8, 0), (2, 1, 3), (5, 8, 3), (17, 4, 12)])
@pytest.mark.parametrize("seed", range(3))
def test_the_runs_own_eliminated_give_what_the_whole_matrix_gives(runs: int, own: int, behind: int, seed: int) -> None:
    layout, arrow, dense, free, more = drawn(seed, runs, own, behind)
    near(arrow.dense(), dense)
    near(arrow.diagonal, np.diag(dense))
    rng = np.random.default_rng(seed)
    vector = rng.normal(size=layout.size)
    near(layout.whole(*layout.split(vector)), vector)
    near(arrow.times(vector), dense @ vector)
    at = np.flatnonzero(free)
    # the step of the search, in its own scale
    scale = np.sqrt(np.diag(dense))
    damping = 1e-3
    step = arrow.held(free).scaled(np.where(free, scale, 1.0)).solve(np.where(free, vector, 0.0), damping)
    inner = dense[np.ix_(at, at)] / scale[at, None] / scale[None, at]
    near(step[at], np.linalg.solve(inner + damping * np.eye(len(at)), vector[at]))
    assert not step[~free].any()
    # covariance, plain and with more noise than the information says
    inverse = inverse_of(arrow, free)
    whole = np.zeros_like(dense)
    whole[np.ix_(at, at)] = np.linalg.inv(inner) / scale[at, None] / scale[None, at]
    shared = layout.shared
    near(inverse.shared, whole[np.ix_(shared, shared)])
    near(np.sqrt(inverse.variance), np.sqrt(np.diag(whole)))
    for columns, _ in more:
        near(inverse.of(columns), whole[np.ix_(columns, columns)])
    added = dense.copy()
    for columns, block in more:
        added[np.ix_(columns, columns)] += block
    sandwich = whole @ added @ whole
    found, variance = widened(inverse, more)
    near(found, sandwich[np.ix_(shared, shared)])
    known = np.diag(sandwich) > 0
    np.testing.assert_allclose(variance[known], np.diag(sandwich)[known], rtol=1e-10)
    assert not variance[~known].any()


def test_parameters_of_two_runs_do_not_meet() -> None:
    arrow = Arrow.zeros(Layout(6, 2, 2, 10))
    with pytest.raises(ValueError, match="two runs"):
        arrow.add(np.array([6, 8]), np.ones((2, 2)))
