"""Four tows with surge by ``fit_runs`` and as one would write it with scipy: the same unknowns and priors, seconds and optimum.

python benchmarks/surge_peers.py [--campaigns 3] > benchmarks/surge_peers.txt
"""

from __future__ import annotations

import argparse
import math
import os
import time

import numpy as np
from identify_surge import SEED, options_of, runs_of
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from surge_cases import NAMES, SurgeCampaign, surge_campaigns

from towline.identify import fit_runs
from towline.pipeline.executor.processes import THREADS

Array = np.ndarray
START_OFF = 1.1
"""scipy is told where to begin: the truth, each derivative a tenth too large. ``fit_runs`` is told nothing."""
SHARED = ("x_udot_kg", "x_vr_kg", "x_vv_kg_m", "x_rr_kg_m", "power")
SIGMA = 1e-3, float(np.radians(0.1))
TOLERANCE = 1e-8


def rates(
    t: float, s: Array, h: list[float], length: float, speed: float, pull_at: float, point: float, mass: float
) -> list[float]:
    """alpha', beta', v', r' of theory.md 10, one tow, plain floats."""
    m, i, y_v, y_r, n_v, n_r, x_udot, x_vr, x_vv, x_rr, power, reference = h
    a, b, v, r = s
    sine, cosine = math.sin(a + b), math.cos(a + b)
    turn = (v + point * r + speed * math.sin(b)) / (length * cosine)
    by_v = sine / cosine
    u = speed * math.cos(b) + length * turn * sine
    share = u / reference
    v_free = share * (y_v * v + y_r * r) / m
    r_free = share * (n_v * v + n_r * r) / i
    v_free -= mass * (u - share * reference) * r / m
    push = -pull_at * share * abs(share) ** (power - 1) + x_vv * v * v + x_vr * v * r + x_rr * r * r + mass * v * r
    whole = mass - x_udot
    k_0 = speed * r * (by_v * math.cos(b) - math.sin(b)) + length * turn * (turn + r) / cosine
    needed = k_0 + by_v * v_free + by_v * point * r_free
    pull = (whole * needed - push) / (cosine + whole * by_v * sine * (1 / m + point * point / i))
    return [turn, r, v_free - pull * sine / m, r_free - pull * point * sine / i]


def scipys(made: SurgeCampaign, start: Array) -> tuple[Array, int]:
    """The six at its optimum, evaluations."""
    say, priors = made.stated, made.stated["priors"]
    known = np.array([priors[n] for n in SHARED])  # (5, 2)
    speed_0, length_0 = say["speed_m_s"], say["line_m"]
    points, tension = np.array(say["tow_points_m"]), np.array(say["tension_n"])
    scale_sd = priors["tension_common_sd_rel"], priors["line_length_sd_m"], priors["speed_sd_rel"]
    begins = []
    for y, beta, point in zip(made.y_m[:, 0], made.beta_rad[:, 0], points, strict=True):
        begins.append([np.arcsin(np.clip((y + point * np.sin(beta)) / length_0, -0.9, 0.9)), beta, 0.0, 0.0, 0.0, 0.0])
    first = np.concatenate([start, np.zeros(5 + 3 + 8), *begins])

    def residual(x: Array) -> Array:
        along = known[:, 0] + known[:, 1] * x[6:11]
        factor, length, speed = (
            math.exp(scale_sd[0] * x[11]),
            length_0 + scale_sd[1] * x[12],
            speed_0 * (1 + scale_sd[2] * x[13]),
        )
        found = [x[6:22]]
        hull = [*x[:6], *along, speed_0]
        for k in range(4):
            pull = tension[k] * factor * (1 + priors["tension_sd_rel"] * x[14 + k])
            point = points[k] + priors["tow_point_sd_m"] * x[18 + k]
            own = x[22 + 6 * k : 28 + 6 * k]
            answer = solve_ivp(
                rates, (0, made.t_s[-1]), own[:4], t_eval=made.t_s, rtol=TOLERANCE, atol=TOLERANCE,
                args=(hull, length, speed, pull, point, say["mass_kg"]),
            )  # fmt: skip
            if not answer.success or answer.y.shape[1] < len(made.t_s):
                found.append(np.full(2 * len(made.t_s), 1e3))
                continue
            y = length * np.sin(answer.y[0]) - point * np.sin(answer.y[1]) + own[4]
            found += [(made.y_m[k] - y) / SIGMA[0], (made.beta_rad[k] - answer.y[1] - own[5]) / SIGMA[1]]
        return np.concatenate(found)

    answer = least_squares(residual, first, x_scale="jac", ftol=1e-10, xtol=1e-10, gtol=1e-10, max_nfev=60)
    return answer.x[:6], int(answer.nfev)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=3)
    given = parser.parse_args()
    for name in THREADS:
        os.environ[name] = "1"
    print("four tows of 60 s at 25 Hz, surge in full, 46 unknowns with their priors; processor seconds, one thread")
    print(
        f"{'campaign':>9}{'towline':>10}{'scipy':>10}{'ratio':>8}   largest difference of the six, in sd   evaluations of scipy"
    )
    campaigns = surge_campaigns(SEED, given.campaigns, options_of("gauge"))
    fit_runs(runs_of(campaigns[0]))  # what is loaded once
    ours_all = []
    for k, made in enumerate(campaigns):
        began = time.process_time()
        fit = fit_runs(runs_of(made))
        ours = time.process_time() - began
        began = time.process_time()
        six, tries = scipys(made, START_OFF * np.array([made.truth[n] for n in NAMES]))
        theirs = time.process_time() - began
        gap = np.abs((six - fit.six) / np.sqrt(np.diag(fit.covariance))).max()
        ours_all.append(ours)
        print(f"{k + 1:9d}{ours:10.2f}{theirs:10.1f}{theirs / ours:8.0f}   {gap:12.2f} {tries:38d}", flush=True)
    print(f"median of towline {np.median(ours_all):.2f} s")


if __name__ == "__main__":
    main()
