"""A free model's zigzag and turn with a rudder, simulated with noise and identified through the public API.

    python examples/free_run.py [--seed 1]

`towline identify` does this with run folders (docs/methods/free-run.md); here it is done from Python: a record of (t, y, heading)
and the rudder's history. The line's tows give the six linear derivatives with their covariance (here: the truth moved at random
by 1 %); what the free runs add is the rudder, and a second opinion on the six as far as their covariance lets them move.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towline.identify.methods import FreeRecord, FreeRunFit, fit_free_run, straight_line_stability
from towline.identify.noise import ljung_box_p
from towline.simulate import DERIVATIVE_UNITS, Histories, Hull, Start, Tow, simulate_full

TRUTH = Hull(249.6448, 93.9161, -97.17078, -42.7710, -92.5523, -94.0412, speed_m_s=1.30, y_delta=-18.0, n_delta=25.5)
"""The thesis's Table 3.1, with a rudder at -1.417 m."""
SIGMA = (1e-3, np.radians(0.1))
RATE_HZ, LENGTH_S = 5.0, 40.0
KNOWN_TO = 0.01
WHITE_P = 0.01


@dataclass(frozen=True)
class Outcome:
    """What the example found; ``told`` is what went in as known of the six."""

    fit: FreeRunFit
    told: Hull


def zigzag(amplitude_rad: float = 0.17, rate_rad_s: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """Rudder history: over to each side every six seconds, at the steering gear's rate."""
    times, angles, here, side, before = [0.0, 1.0], [0.0, 0.0], 1.0, 1.0, 0.0
    while here < LENGTH_S:
        times += [here + abs(side * amplitude_rad - before) / rate_rad_s, here + 6.0]
        before = side * amplitude_rad
        angles += [before, before]
        side, here = -side, here + 6.0
    return np.array(times), np.array(angles)


def turn(angle_rad: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Rudder history: over once, and held."""
    return np.array([0.0, 2.0, 2.5, LENGTH_S]), np.array([0.0, 0.0, angle_rad, angle_rad])


def filmed(history: tuple[np.ndarray, np.ndarray], rng: np.random.Generator) -> FreeRecord:
    """A free run as a camera would give it: y_CG in axes that move with U, and heading, with noise."""
    t_s = np.arange(0, LENGTH_S, 1 / RATE_HZ)
    motion = simulate_full(
        TRUTH,
        Tow(TRUTH.speed_m_s, 1.0, 0.0, None, resistance_n=0.0),
        Start(y_cg_m=0.1, beta_rad=0.01),
        t_s,
        free=True,
        histories=Histories(rudder_rad=lambda t: float(np.interp(t, *history))),
    )
    seen = motion[["y_cg_m", "beta_rad"]].to_numpy() + rng.normal(size=(len(t_s), 2)) * SIGMA
    return FreeRecord(t_s, seen[:, 0], seen[:, 1], *history, TRUTH.speed_m_s)


def main(arguments: Sequence[str] | None = None) -> Outcome:
    """Run the example and print what it finds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    rng = np.random.default_rng(parser.parse_args(arguments).seed)
    runs = [filmed(zigzag(), rng), filmed(turn(), rng)]
    told = TRUTH.with_six(TRUTH.six * (1 + KNOWN_TO * rng.normal(size=6)))
    fit = fit_free_run(runs, told, np.diag((KNOWN_TO * told.six) ** 2))
    print(f"{'':16}{'value':>10}{'95 % interval':>24}{'truth':>10}")
    rows = [
        ("Y_delta, N/rad", fit.y_delta, TRUTH.y_delta),
        ("N_delta, N m/rad", fit.n_delta, TRUTH.n_delta),
        ("X_delta, m", fit.x_delta_m, TRUTH.n_delta / TRUTH.y_delta),
        *((name, fit.six.named[name], true) for name, true in zip(DERIVATIVE_UNITS, TRUTH.six, strict=True)),
    ]
    for name, found, true in rows:
        low, high = found.value - 1.96 * found.std, found.value + 1.96 * found.std
        print(f"{name:16}{found.value:10.3f}{f'{low:.3f} .. {high:.3f}':>24}{true:10.3f}")
    lowest = min(ljung_box_p(rest[:, c]) for rest in fit.fit.residual for c in range(2))
    print(f"residuals: {'white' if lowest > WHITE_P else 'not white'} (least Ljung-Box p {lowest:.2g} of four)")
    verdict = straight_line_stability(fit.six.six, fit.six.covariance)
    print(verdict.sentence)
    for note in fit.notes:
        print(f"note: {note}")
    return Outcome(fit, told)


if __name__ == "__main__":
    main()
