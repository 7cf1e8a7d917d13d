"""What people use instead, on the same runs: scipy, CasADi multiple shooting, jax-sysid, pysindy (each where it is installed).

All are helped: they start from derivatives 10 % off and from the true start of each run, and know the noise's size. towline
is asked for everything without a guess.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec

import numpy as np
from identify_cases import RELEASED_M, SIX
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from towline.identify import RunData
from towline.simulate import Hull, linear_system

GUESS = SIX * np.array([1.1, 0.9, 1.1, 0.9, 1.1, 0.9])
Peer = Callable[[list[RunData]], np.ndarray]


def _start(runs: list[RunData]) -> np.ndarray:
    return np.concatenate([GUESS / SIX, *[[RELEASED_M, 0, 0, 0] for _ in runs]])


def user_fit(runs: list[RunData], rtol: float) -> np.ndarray:
    """scipy's least_squares round solve_ivp, as a user writes it; with solve_ivp's default rtol, 1e-3, or a finer one."""

    def residual(theta: np.ndarray) -> np.ndarray:
        parts = []
        hull = Hull(*(theta[:6] * SIX), speed_m_s=1.28)
        for k, run in enumerate(runs):
            matrix, _ = linear_system(hull, run.tow)
            begin = theta[6 + 4 * k : 10 + 4 * k]
            path = solve_ivp(
                lambda t, x, matrix=matrix: matrix @ x,
                (run.t_s[0], run.t_s[-1]),
                begin,
                t_eval=run.t_s,
                rtol=rtol,
                atol=rtol * 1e-3,
            ).y[:2]
            sd = np.sqrt(run.covariance[0].diagonal())
            parts += [(run.y_m - path[0]) / sd[0], (run.beta_rad - path[1]) / sd[1]]
        return np.concatenate(parts)

    return least_squares(residual, _start(runs)).x[:6] * SIX


def casadi_fit(runs: list[RunData]) -> np.ndarray:
    """CasADi multiple shooting: a node every 16th sample, Runge-Kutta between samples, IPOPT with exact derivatives."""
    import casadi as ca

    every = 16
    p = ca.MX.sym("p", 6)
    x = ca.MX.sym("x", 4)
    point, pull, length, speed = (ca.MX.sym(n) for n in ("point", "pull", "length", "speed"))
    s = x[0] / length + (1 + point / length) * x[1]
    rate = ca.vertcat(
        x[2] + speed * x[1],
        x[3],
        (p[2] * SIX[2] * x[2] + p[3] * SIX[3] * x[3] - pull * s) / (p[0] * SIX[0]),
        (p[4] * SIX[4] * x[2] + p[5] * SIX[5] * x[3] - pull * point * s) / (p[1] * SIX[1]),
    )
    setting = ca.vertcat(point, pull, length, speed)
    f = ca.Function("f", [x, p, setting], [rate])
    h = ca.MX.sym("h")
    k1 = f(x, p, setting)
    k2 = f(x + h / 2 * k1, p, setting)
    k3 = f(x + h / 2 * k2, p, setting)
    k4 = f(x + h * k3, p, setting)
    step = ca.Function("step", [x, p, setting, h], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    cost, constraints, variables, start = 0, [], [p], [GUESS / SIX]
    for run in runs:
        known = ca.DM([run.tow.tow_point_m, run.tow.tension_n, run.tow.line_length_m, run.tow.speed_m_s])
        dt = float(run.t_s[1] - run.t_s[0])
        nodes = len(run.t_s) // every
        states = ca.MX.sym("states", 4, nodes)
        variables.append(ca.vec(states))
        rates = np.array([np.gradient(run.y_m, dt), np.gradient(run.beta_rad, dt)])
        smooth = np.array([np.convolve(r, np.ones(33) / 33, mode="same") for r in rates])
        guess = np.array([run.y_m, run.beta_rad, smooth[0] - run.tow.speed_m_s * run.beta_rad, smooth[1]])
        start.append(guess[:, ::every][:, :nodes].ravel(order="F"))
        here, seen = states, []
        for _ in range(every):
            seen.append(here[:2, :])
            here = step.map(nodes)(here, ca.repmat(p, 1, nodes), ca.repmat(known, 1, nodes), dt)
        sd = np.sqrt(run.covariance[0].diagonal())
        for j, values in enumerate(seen):
            measured = np.array([run.y_m, run.beta_rad])[:, j::every][:, :nodes]
            cost = cost + ca.sumsqr((values - measured) / sd[:, None])
        constraints.append(ca.vec(here[:, :-1] - states[:, 1:]))
    problem = {"x": ca.vertcat(*variables), "f": cost, "g": ca.vertcat(*constraints)}
    quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
    solver = ca.nlpsol("solver", "ipopt", problem, quiet)
    found = solver(x0=np.concatenate(start), lbg=0, ubg=0)
    return np.array(found["x"])[:6, 0] * SIX


def jax_sysid_fit(runs: list[RunData]) -> np.ndarray:
    """jax-sysid: the discretised model (exact zero-order step) under its Adam and L-BFGS, all runs in one data set."""
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import Model

    jax.config.update("jax_enable_x64", True)
    dt = float(runs[0].t_s[1] - runs[0].t_s[0])
    sd = np.sqrt(runs[0].covariance[0].diagonal())
    size, tow = jnp.array(SIX), runs[0].tow

    @jax.jit
    def state(x, u, params):
        six = params[0] * size
        point = u[0]
        length = tow.line_length_m
        zero, one = jnp.zeros(()), jnp.ones(())
        rows = [
            jnp.stack([zero, tow.speed_m_s * one, one, zero]),
            jnp.stack([zero, zero, zero, one]),
            jnp.stack([-tow.tension_n / length, -tow.tension_n * (1 + point / length), six[2], six[3]]) / six[0],
            jnp.stack([-tow.tension_n * point / length, -tow.tension_n * point * (1 + point / length), six[4], six[5]])
            / six[1],
        ]
        a = jnp.stack(rows) * dt
        power = jnp.eye(4) + a @ (jnp.eye(4) + a / 2 @ (jnp.eye(4) + a / 3 @ (jnp.eye(4) + a / 4)))
        return power @ x

    @jax.jit
    def output(x, u, params):
        return x[:2] / jnp.array(sd)

    model = Model(4, 2, 1, state_fcn=state, output_fcn=output)
    model.init(params=[GUESS / SIX], x0=[np.array([RELEASED_M, 0, 0, 0.0]) for _ in runs])
    model.loss(rho_x0=0.0, rho_th=0.0, train_x0=True)
    model.optimization(adam_epochs=0, lbfgs_epochs=1000, iprint=-1)
    seen = [np.column_stack([r.y_m, r.beta_rad]) / sd for r in runs]
    inputs = [np.full((len(r.t_s), 1), r.tow.tow_point_m) for r in runs]
    model.fit(seen, inputs)
    return np.array(model.params[0]) * SIX


def pysindy_fit(runs: list[RunData], window: int = 129) -> np.ndarray:
    """pysindy: v and r from smoothed differences of y and beta, and least squares of their rates on v, r and the line's force.

    It is told the equations' form and the tension, and needs no guess; of windows of 9, 33, 65 and 129 samples the last is best.
    """
    import pysindy as ps

    smooth = ps.SmoothedFiniteDifference(smoother_kws={"window_length": window, "polyorder": 3})
    states, forces, times = [], [], []
    for run in runs:
        y, beta = (smooth._differentiate(x[:, None], run.t_s)[:, 0] for x in (run.y_m, run.beta_rad))
        tow = run.tow
        slope = run.y_m / tow.line_length_m + (1 + tow.tow_point_m / tow.line_length_m) * run.beta_rad
        states.append(np.column_stack([y - tow.speed_m_s * run.beta_rad, beta]))
        forces.append(tow.tension_n * np.column_stack([slope, tow.tow_point_m * slope]))
        times.append(run.t_s)
    model = ps.SINDy(
        optimizer=ps.STLSQ(threshold=0.0, alpha=0.0),
        feature_library=ps.PolynomialLibrary(degree=1, include_bias=False),
        differentiation_method=smooth,
    )
    model.fit(states, t=times, u=forces)
    (y_v, y_r, side, _), (n_v, n_r, _, turn) = model.coefficients()
    m, i = -1 / side, -1 / turn
    return np.array([m, i, y_v * m, y_r * m, n_v * i, n_r * i])


def peers() -> list[tuple[str, Peer]]:
    """Those that are installed; the others are said."""
    found: list[tuple[str, Peer]] = [
        (f"scipy least_squares + solve_ivp, rtol {rtol:g}", partial(user_fit, rtol=rtol)) for rtol in (1e-3, 1e-6, 1e-8)
    ]
    for module, name, call in (
        ("casadi", "CasADi multiple shooting", casadi_fit),
        ("jax_sysid", "jax-sysid, L-BFGS", jax_sysid_fit),
        ("pysindy", "pysindy, rates regressed", pysindy_fit),
    ):
        if find_spec(module) is None:
            print(f"{name}: not installed here")
        else:
            found.append((name, call))
    return found
