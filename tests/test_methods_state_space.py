"""Models A, B and the open loop: one motion in three forms; derivatives from the measured line force."""

from __future__ import annotations

import numpy as np
import pytest

from towline.identify.methods.common import Record
from towline.identify.methods.open_loop_fit import fit_open_loop
from towline.identify.methods.state_space import b_to_a, closed, feedback, model_a, model_b, open_loop
from towline.identify.methods.transfer import line_force_transfer, open_loop_transfer
from towline.record import EstimationError
from towline.simulate import Hull, Start, Tow, simulate_linear, stability

SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28)
M, IZ, YV, YR, NV, NR = SIX
X, L, T, U = 1.649, 0.91, 3.96, 1.28
TOW = Tow(U, L, X, T)
SIGMA = np.array([1e-3, np.radians(0.1)])


def test_model_b_is_8_26_and_model_a_is_8_25() -> None:
    """Retyped from the thesis (8.25, 8.26 with theory.md's signs)."""
    a = model_a(HULL, TOW).a
    expected = [
        [YV / M, -T / (M * L), (YR + M * U) / M, -(YV * U + T * (1 + X / L)) / M],
        [1, 0, 0, 0],
        [NV / IZ, -T * X / (IZ * L), NR / IZ, -(NV * U + T * X * (1 + X / L)) / IZ],
        [0, 0, 1, 0],
    ]
    np.testing.assert_allclose(a, expected, atol=1e-12)
    b = model_b(HULL, TOW).a
    expected[0][2:] = [YR / M, -T * (1 + X / L) / M]
    expected[1] = [1, 0, 0, U]
    expected[2][3] = -T * X * (1 + X / L) / IZ
    np.testing.assert_allclose(b, expected, atol=1e-12)
    np.testing.assert_allclose(a @ b_to_a(TOW), b_to_a(TOW) @ b, atol=1e-12)


def test_all_forms_have_the_same_poles_and_transfer_functions() -> None:
    s = 0.2 + 0.5j
    wanted = [line_force_transfer(HULL, TOW)[n](s) for n in ("y", "beta")]
    for make in (model_a, model_b):
        model = make(HULL, TOW)
        np.testing.assert_allclose(model.poles, stability(HULL, TOW).roots, atol=1e-9)
        np.testing.assert_allclose(model.transfer(s)[:, 0], wanted, rtol=1e-10)
    loop = [open_loop_transfer(HULL, TOW)[n](s) for n in ("y", "beta")]
    for form, make in (("a", model_a), ("b", model_b)):
        model = open_loop(HULL, TOW, form)
        np.testing.assert_allclose(model.transfer(s)[:, 0], -np.array(loop), rtol=1e-10)
        np.testing.assert_allclose(closed(model, TOW), make(HULL, TOW).a, atol=1e-12)
    # (8.27)'s own input matrix: the feedback of y and beta
    b = open_loop(HULL, TOW).b @ feedback(TOW)
    np.testing.assert_allclose(b[0], [-T / (M * L), -T * (1 + X / L) / M], atol=1e-12)
    np.testing.assert_allclose(b[2], [-T * X / (IZ * L), -T * X * (1 + X / L) / IZ], atol=1e-12)


def tow_with_force(x_t: float, y_0: float, t: np.ndarray) -> tuple[Record, np.ndarray]:
    tow = Tow(U, L, x_t, T)
    motion = simulate_linear(HULL, tow, Start(y_cg_m=y_0, beta_rad=0.02), t)
    y, beta = motion["y_cg_m"].to_numpy(), motion["beta_rad"].to_numpy()
    return Record(t, y, beta, tow), (feedback(tow) @ np.array([y, beta]))[0]


def test_an_exact_force_gives_the_derivatives() -> None:
    """First-order hold at 20 Hz: its error is h^2/12 times the force's curvature, 1e-5 of the derivatives."""
    t = np.arange(0, 30, 0.05)
    made = [tow_with_force(1.446, 0.2, t), tow_with_force(1.751, -0.2, t)]
    records = [Record(r.t_s, r.y_m + 0.3, r.beta_rad - 0.01, r.tow) for r, _ in made]
    found = fit_open_loop(records, [f for _, f in made])
    np.testing.assert_allclose(found.six, SIX, rtol=2e-4)
    assert found.fit is not None
    np.testing.assert_allclose(found.fit.theta[[10, 15]], -0.01, atol=1e-5)


def test_gain_errors_of_the_force_are_the_derivatives_errors() -> None:
    t = np.arange(0, 30, 0.05)
    made = [tow_with_force(1.446, 0.2, t), tow_with_force(1.751, -0.2, t)]
    found = fit_open_loop([r for r, _ in made], [1.05 * f for _, f in made])
    np.testing.assert_allclose(found.six / SIX, 1.05, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("force_noise_n", [0.0, 0.05])
def test_noisy_tows_have_true_errors(force_noise_n: float) -> None:
    """24 campaigns of two tow points, 1 mm and 0.1 degree: rms z of 1 within 4 standard errors and 10 % (noise model).

    0.05 N of noise in the force (a hundredth of T) makes the free hull wander.
    """
    rng = np.random.default_rng(9)
    t = np.arange(0, 40, 0.2)
    made = [tow_with_force(1.446, 0.2, t), tow_with_force(1.751, -0.2, t)]
    scores = []
    for _ in range(24):
        noise = [SIGMA * rng.normal(size=(len(t), 2)) for _ in made]
        records = [
            Record(r.t_s, r.y_m + n[:, 0], r.beta_rad + n[:, 1], r.tow) for (r, _), n in zip(made, noise, strict=True)
        ]
        forces = [f + force_noise_n * rng.normal(size=len(t)) for _, f in made]
        found = fit_open_loop(records, forces, force_sd_n=force_noise_n, start=SIX * 1.2)
        scores.append((found.six - SIX) / found.sd)
    z = np.array(scores)
    # six correlated derivatives: as if three were independent
    assert abs(np.sqrt(np.mean(z**2)) - 1) < 4 / np.sqrt(2 * 24 * 3) + 0.1, z.std(axis=0)


def test_refusals() -> None:
    t = np.arange(0, 30, 0.05)
    record, force = tow_with_force(1.446, 0.2, t)
    with pytest.raises(EstimationError, match="599 values of force_n for 600"):
        fit_open_loop([record], [force[:-1]])
