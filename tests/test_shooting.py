"""The diagnosis's linearisation and noise against slower, plainer ways to the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from towline.diagnose.effects import LIBRARY, Effect, Parameter
from towline.diagnose.effects.camera import DRIFT_RAMPS, ROLLING_FREELY
from towline.diagnose.effects.hull import BANK, CROSSFLOW_ENDS, CUBIC_FORMS
from towline.diagnose.effects.line import FRICTION_FORMS
from towline.diagnose.inference.evidence import Inference, Solved
from towline.diagnose.inference.grams import Columns, Grams, Reduced, reduced
from towline.diagnose.inference.hypothesis import Hypothesis, Path
from towline.diagnose.inference.noise import Forces
from towline.diagnose.inference.shooting import between, carried
from towline.diagnose.tow.model import TowModel
from towline.diagnose.tow.noise import tow_noise
from towline.diagnose.tow.start import base_hypotheses, measured_path
from towline.geometry.normal import inverse_of_normal, root_of_covariance

SLOPE_SHARE = 0.03
"""Rates' slopes are straight between nodes 0.17 s apart: an error of (rate h)^2/12, 2 % for what decays at 3 a second after
a release, 0.2 % for a swing of 1 rad/s."""
FAMILIES = ((CROSSFLOW_ENDS,), CUBIC_FORMS, BANK[1:], DRIFT_RAMPS, FRICTION_FORMS, ROLLING_FREELY)
PLAIN = tuple(e for e in LIBRARY if e.correct is None and e.name != "sync_delay" and not any(e in f for f in FAMILIES))
TOGETHER = 8
"""So many of these push at once; the work of a group goes with the square of its size."""
GROUPS = -(-len(PLAIN) // TOGETHER)
PUSHED = (
    *(PLAIN[k::GROUPS] for k in range(GROUPS)),
    (CROSSFLOW_ENDS, *CUBIC_FORMS, BANK[1], BANK[7], DRIFT_RAMPS[1], *FRICTION_FORMS, ROLLING_FREELY[3]),
)
"""Together: the plain forms, in groups; of those beside them, one of each kind."""
QUICK = 1
"""The group that takes the least time."""


NOTHING = Reduced(
    np.zeros((0, 0)), np.zeros(0), 0.0, 0.0, 0.0, np.zeros((1, 0, 0)), np.zeros((1, 0, 0)), np.zeros((1, 0))
)


@pytest.fixture(scope="module")
def runs(tow_runs: Callable[[int, int], list]) -> list:
    return tow_runs(2, 2)


@pytest.fixture(scope="module")
def hypothesis(cases: ModuleType, runs: list) -> Hypothesis:
    tows = [r.data.tow for r in runs]
    own = [[0.1, 0.02, 0, 0, 0, 0, t.tension_n, t.tow_point_m, t.line_length_m, t.speed_m_s, 0, 0] for t in tows]
    return Hypothesis(np.array(cases.SIX), np.array(own))


@pytest.mark.parametrize(
    ("pushed", "size"),
    [
        pytest.param(group, 0.3 if k < GROUPS else 0.1, marks=[pytest.mark.slow] * (k != QUICK))
        for k, group in enumerate(PUSHED)
    ],
    ids=[*(f"plain {k + 1}" for k in range(GROUPS)), "beside"],
)
def test_slopes_are_differences_of_motions(
    runs: list, hypothesis: Hypothesis, pushed: tuple[Effect, ...], size: float
) -> None:
    """Every number, a group of effects present, against central differences of motions (to 3e-6 m or rad per prior sd).

    Where something changes at a time that is a number, the motion has a kink: there two slopes are right, and the differences are
    their mean.

    Those of the last group push with three cubics and three swivels at once: at 0.3 of their sizes the motion would grow.
    """
    model = TowModel(runs, 1.28)
    sizes = tuple(np.array([p.none + size * p.sd for p in e.parameters]) for e in pushed)
    h = replace(hypothesis, effects=pushed, numbers=sizes)
    found = model.linear([h])[0]
    slopes, at = np.array([slope for _, slope in found.rows]), 18
    # closed paths are motions, however the Newton steps that close them were made
    h = replace(h, path=found.path)

    moved: list[tuple[int, float, str, Hypothesis]] = []
    kinks: dict[str, np.ndarray] = {}
    for k in range(6):
        step = 1e-3 * abs(h.shared[k])
        moved += [(k, step, f"six {k}", replace(h, shared=h.shared + sign * step * np.eye(6)[k])) for sign in (1, -1)]
    for k in range(12):
        step = 1e-4 * max(float(np.abs(h.own[:, k]).max()), 1.0)
        moved += [(6 + k, step, f"own {k}", replace(h, own=h.own + sign * step * np.eye(12)[k])) for sign in (1, -1)]
    for index, effect in enumerate(pushed):
        for k, parameter in enumerate(effect.parameters):
            step = 0.01 * parameter.sd
            name = f"{effect.label} {parameter.name}"
            if parameter.name == "change_s":
                kinks[name] = np.array([np.abs(run.centre_s - sizes[index][k]) < run.step_s for run in runs])
            for sign in (1, -1):
                numbers = [n.copy() for n in sizes]
                numbers[index][k] += sign * step
                moved.append((at, step, name, replace(h, numbers=tuple(numbers))))
            at += 1
    values = np.array(model.values([hypothesis for *_, hypothesis in moved]))
    for (column, step, name, _), up, down in zip(moved[::2], values[::2], values[1::2], strict=True):
        plain = (up - down) / (2 * step)
        for channel in range(4):
            most = np.abs(plain[:, :, channel]).max()
            off = np.abs(slopes[..., channel, column] - plain[:, :, channel])
            wrong = np.where(kinks.get(name, False), 0.0, off).max()
            assert wrong < SLOPE_SHARE * most + 3e-8 / step, (name, channel)


def test_a_clock_that_runs_off_is_seen_at_its_own_times(runs: list, hypothesis: Hypothesis) -> None:
    """Half a second late at the end: against the motion of a finer clock, to a tenth of a block mean's noise."""
    from towline.simulate import Start, simulate_full
    from towline.simulate.model import Hull, Tow

    model, rate = TowModel(runs, 1.28), 0.012
    clock = next(e for e in LIBRARY if e.name == "frame_rate")
    seen = model.values([replace(hypothesis, effects=(clock,), numbers=(np.array([rate]),))])[0]
    for i, run in enumerate(runs):
        step = run.step_s
        tow = Tow(*hypothesis.own[i, [9, 8, 7, 6]])
        start = Start(alpha_rad=0.1, beta_rad=0.02)
        late_s = np.linspace(0, (len(run.centre_s) + 3) * step, 8001)
        truth = simulate_full(Hull(*hypothesis.shared, speed_m_s=1.28), tow, start, late_s)["y_cg_m"].to_numpy()
        total = np.concatenate([[0.0], np.cumsum((truth[1:] + truth[:-1]) / 2 * np.diff(late_s))])
        centre = run.centre_s * (1 + rate)
        edges = [np.interp(np.maximum(centre + side * step / 2, 0), late_s, total) for side in (-1, 1)]
        mean = (edges[1] - edges[0]) / step
        sd = np.sqrt(np.diag(run.covariance[0]))
        assert (np.abs(seen[i][:, 0] - mean)[1:] < 0.1 * sd[1:] + 1e-5).all()


def test_a_path_is_closed_from_the_measured_motion(runs: list, hypothesis: Hypothesis) -> None:
    """Newton from splines through the measurement ends on the motion that is integrated step by step."""
    model = TowModel(runs, 1.28)
    plain = model.linear([hypothesis])[0].path.states
    begun = np.stack([measured_path(run, plain.shape[1]) for run in runs], axis=-1)
    assert np.abs(begun - plain).max() > 0.01
    closed = model.linear([replace(hypothesis, path=Path((), begun))])[0].path.states
    np.testing.assert_allclose(closed, plain, atol=1e-7)


def test_the_start_is_the_measured_motion(runs: list) -> None:
    """The splines pass the measured means within their noise (5 sd for the largest of 260), and their rates are the path's."""
    h = base_hypotheses(runs, 1.28)[0]
    assert h.path is not None
    for i, run in enumerate(runs):
        node_s = np.arange(h.path.states.shape[1]) * run.step_s / 2
        alpha, beta, v, r = CubicSpline(node_s, h.path.states[..., i], axis=1)(run.centre_s)
        tow = run.data.tow
        y = tow.line_length_m * np.sin(alpha) - tow.tow_point_m * np.sin(beta)
        for value, channel in ((y, 0), (beta, 1)):
            sd = np.sqrt(np.diag(run.covariance[channel]))
            # means of a block differ from its middle by curvature, y'' h^2 / 24: 0.1 mm of a swing of 0.2 m at 1 rad/s
            assert (np.abs(value - run.values[:, channel]) < 5 * sd + 2e-4).all()
        step = run.centre_s
        assert np.abs(np.gradient(beta, step) - r)[2:-2].max() < 0.05 * np.abs(r).max()
        sway = np.gradient(y, step) - tow.speed_m_s * np.sin(beta)
        assert np.abs(sway / np.cos(beta) - v)[2:-2].max() < 0.05 * np.abs(v).max()


def test_between_nodes_is_exact_for_constant_rates() -> None:
    """x' = A x + f with f straight: against the closed form; the Runge-Kutta step errs by (|A| h)^5/120."""
    from scipy.linalg import expm

    a, h = np.array([[-0.3, 1.0], [-0.8, -0.5]]), 0.2
    x, early, late = between(np.tile(a, (2, 1, 1)), h)
    whole = expm(np.block([[a, np.eye(2), np.zeros((2, 2))], [np.zeros((2, 4)), np.eye(2)], [np.zeros((2, 6))]]) * h)
    error = (np.linalg.norm(a) * h) ** 4 / 24 * h
    np.testing.assert_allclose(x[0], whole[:2, :2], atol=error)
    growing = whole[:2, 4:] / h
    np.testing.assert_allclose(late[0], growing, atol=error)
    np.testing.assert_allclose(early[0], whole[:2, 2:4] - growing, atol=error)
    np.testing.assert_allclose(carried(x, np.zeros((1, 2, 1)), np.ones((2, 1)))[1], x[0] @ np.ones((2, 1)))


def test_inner_products_are_those_of_the_whole_covariance(runs: list, hypothesis: Hypothesis) -> None:
    """Against the dense covariance, at three sizes; what is left out holds less than UNSEEN of the noise in any direction."""
    rng = np.random.default_rng(3)
    noise = tow_noise(runs, TowModel(runs, 1.28).pushed(hypothesis))
    tables = [rng.normal(size=(len(r.centre_s), 4, 13)) * 1e-3 for r in runs]
    grams = Grams(Columns(tables, 2), noise)
    for forces in (Forces(1e-4, 3e-4, 0), Forces(0.01, 0.02, 1), Forces(0.3, 0.05, 2)):
        whole, logs = grams.at(forces)
        for i, run in enumerate(runs):
            n = len(run.centre_s)
            side, moment = noise.by_force(i, forces.time)
            dense = noise.runs[i].measured + forces.side_n**2 * side + forces.moment_n_m**2 * moment
            moving = np.concatenate([tables[i][:, 0], tables[i][:, 1]])
            plain = moving.T @ np.linalg.solve(dense, moving)
            log = np.linalg.slogdet(dense)[1]
            for channel in (2, 3):
                plain = plain + tables[i][:, channel].T @ np.linalg.solve(
                    run.covariance[channel], tables[i][:, channel]
                )
                log += np.linalg.slogdet(run.covariance[channel])[1]
            np.testing.assert_allclose(whole[i], plain, atol=2e-3 * np.diag(plain).max())
            assert abs(logs[i] - log) < 1e-3 * 2 * n / 2
            white = noise.whitened(i, forces, [tables[i]])[0]
            np.testing.assert_allclose(white.T @ white, whole[i], rtol=1e-6, atol=1e-9 * np.diag(plain).max())


def test_own_numbers_are_eliminated(runs: list, hypothesis: Hypothesis) -> None:
    """The reduced normal equations give the step that the whole least-squares problem gives."""
    rng = np.random.default_rng(4)
    noise, forces = tow_noise(runs, TowModel(runs, 1.28).pushed(hypothesis)), Forces(0.01, 0.01, 1)
    tables = [rng.normal(size=(len(r.centre_s), 4, 1 + 3 + 2)) * 1e-3 for r in runs]
    away, sd = rng.normal(size=(len(runs), 2)), np.full((len(runs), 2), 2.0)
    part = reduced(Grams(Columns(tables, 3), noise), forces, away, sd)
    step = np.linalg.solve(part.matrix, part.right)
    rows, rights = [], []
    for i, table in enumerate(tables):
        white = noise.whitened(i, forces, [table])[0]
        wide = np.zeros((len(white), 3 + 2 * len(runs)))
        wide[:, :3], wide[:, 3 + 2 * i : 5 + 2 * i] = white[:, 1:4], white[:, 4:]
        prior = np.zeros((2, wide.shape[1]))
        prior[:, 3 + 2 * i : 5 + 2 * i] = np.eye(2) / sd[i]
        rows += [wide, prior]
        rights += [white[:, 0], away[i] / sd[i]]
    whole = np.linalg.lstsq(np.concatenate(rows), np.concatenate(rights), rcond=None)[0]
    np.testing.assert_allclose(step, whole[:3], rtol=1e-6)
    np.testing.assert_allclose(part.own_step(step).ravel(), whole[3:], rtol=1e-6)
    rest = np.concatenate(rights) - np.concatenate(rows) @ whole
    assert np.isclose(part.chi_square - part.right @ step, rest @ rest, rtol=1e-6)
    # as it stands: nothing moves but the modes, which no hypothesis holds (here the second shared number, of unit variance)
    still = reduced(Grams(Columns(tables, 3), noise), forces, away, sd, modes=slice(1, 2)).before
    mode, right = np.concatenate(rows)[:, 1], np.concatenate(rights)
    best = (mode @ right) / (mode @ mode + 1.0)
    assert np.isclose(still, ((right - best * mode) ** 2).sum() + best**2, rtol=1e-6)
    assert np.isclose(part.before, right @ right, rtol=1e-6)


@pytest.mark.parametrize("mean", [-0.01, 0.02, 0.4, 3.0])
@pytest.mark.parametrize("sided", [False, True])
def test_an_effect_of_any_size_has_the_evidence_of_the_integral(mean: float, sided: bool) -> None:
    """One number with a normal likelihood: against the integral over the mixed prior by quadrature."""
    sd, spread = 2.0, 0.15
    effect = Effect("one", "sway", (Parameter("x", "", sd, one_sided=sided),), "", "")

    def prior(x: float, share: float) -> float:
        return float(norm.pdf(x, 0, share * sd)) * (2.0 * (x > 0) if sided else 1.0)

    def integral(share: float) -> float:
        likelihood = lambda x: norm.pdf(x, mean, spread) * prior(x, share)  # noqa: E731
        return quad(likelihood, -3, 6, points=[0.0, mean], limit=400)[0]

    wanted = np.log(np.mean([integral(share) for share in effect.sizes]))
    # Laplace at the widest size, both sides: what ``sized`` is added to
    variance = 1 / (1 / spread**2 + 1 / sd**2)
    plain = float(norm.logpdf(mean, 0, np.hypot(spread, sd)))
    inference = object.__new__(Inference)
    inference.mode_count = 0
    h = Hypothesis(np.zeros(0), np.zeros((1, 0)), (effect,), (np.zeros(1),))
    step = np.array([variance * mean / spread**2])
    solved = Solved(0.0, 0.0, 0.0, step, np.zeros((1, 0)), np.array([[variance]]), NOTHING)
    assert plain + inference.sized(h, solved) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("off", [-1e-14, 1e-14])
def test_rounding_in_a_variance_is_no_knowledge(off: float) -> None:
    """Of two numbers the data tell the sum very well: the difference's variance may round to less than none, or above the prior."""
    parameters = (Parameter("x", "", 2.0, one_sided=True), Parameter("y", "", 2.0))
    inference = object.__new__(Inference)
    inference.mode_count = 0
    h = Hypothesis(
        np.zeros(0), np.zeros((1, 0)), (Effect("two", "sway", parameters, "", ""),), (np.array([0.4, -0.4]),)
    )
    exact, rounded = (2.0**2 * np.array([[0.5, -0.5], [-0.5, 0.5]]) + shift * np.ones((2, 2)) for shift in (1e-11, off))
    told = [
        inference.sized(h, Solved(0.0, 0.0, 0.0, np.zeros(2), np.zeros((1, 0)), covariance, NOTHING))
        for covariance in (exact, rounded)
    ]
    # of a variance of 1e-11, or the least one: the prior's shape is as flat
    assert told[1] == pytest.approx(told[0], abs=1e-3)


def test_numbers_that_are_not_told_get_nothing() -> None:
    """Sizes from 1e-9 to 1e9, and two numbers without any information: no overflow, no made-up variance."""
    rng = np.random.default_rng(6)
    slopes = rng.normal(size=(40, 4)) * [1e-9, 1.0, 1e5, 1e9]
    matrix = np.zeros((6, 6))
    matrix[:4, :4] = slopes.T @ slopes
    inverse = inverse_of_normal(matrix)
    assert (inverse[4:] == 0).all()
    assert (inverse[:, 4:] == 0).all()
    size = np.array([1e-9, 1.0, 1e5, 1e9])
    plain = np.linalg.inv((slopes / size).T @ (slopes / size))
    np.testing.assert_allclose(inverse[:4, :4] * np.outer(size, size), plain, rtol=1e-6)


def test_a_covariance_has_a_root_where_rounding_has_left_it_none() -> None:
    """Variances from 1e-24 to 1e6, correlated; and one that rounding has made a little less than nothing along one direction."""
    rng = np.random.default_rng(7)
    free = rng.normal(size=(5, 5)) * [[1e-12], [1e-6], [1.0], [1e3], [1e-3]]
    covariance = free @ free.T
    root, size = root_of_covariance(covariance), np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(root @ root.T / np.outer(size, size), covariance / np.outer(size, size), atol=1e-12)
    less = np.array([[1.0, 1.0 + 1e-15], [1.0 + 1e-15, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(less - 1e-15 * np.eye(2))
    np.testing.assert_allclose(root_of_covariance(less) @ root_of_covariance(less).T, less, atol=1e-14)
