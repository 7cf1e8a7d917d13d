"""Measured swings of a real pendulum through the public API: a viscous linear model and one with the full sine.

    python examples/pendulum.py SinglePendulumDataForParameterEstimation.mat [--every 20] [--starts 4]

The file is that of github.com/dynamicslab/MultiArm-Pendulum (MIT): angle from upright in rad and its rate, every millisecond, four
swings for the fit and two kept aside. A pendulum is not a ship, but it is a free roll decay in all that matters here: an
oscillator with light damping whose period grows with its swing.

    linear  a'' = -w^2 a - c a'              full  a'' = -w^2 sin(a) - c a'        (a from hanging)

Nothing of the package knows pendulums. What it lends is generic: ``output_error`` fits any model of two channels,
measures scatter and colour of what is left and whitens both; ``ljung_box_p`` judges whether it is white. Scattered starts are
a loop here, because ``identify.multistart`` knows tows only.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from towline.identify.methods.output_error import OutputError, output_error
from towline.identify.noise import ljung_box_p, measured, stated
from towline.record import InputError

STEP_S = 1e-3
COMPLEX_STEP = 1e-30
SIGMA = (0.01, 0.1)
"""rad and rad/s to begin with; the fit measures its own."""
WHITE_P = 0.01
BEGIN = (60.0, 0.1)
"""w^2 (1/s2) and c (1/s) to start from; the scattered starts lie within a factor of e^(+-0.2) and e^(+-1)."""
Array = np.ndarray


@dataclass(frozen=True)
class Found:
    """A model fitted to all swings.

    Attributes
    ----------
    name : "linear" or "full"
    value, sd : w^2 (1/s2), c (1/s); the sd from what is left, whitened
    between : (2,), the same from swing to swing: standard deviation of the swings' own fits over sqrt(swings)
    rms_rad : of what is left of the angle, per swing
    aside_rad : of the swings kept aside, with w^2 and c held
    least_p : least Ljung-Box p of the whitened residuals
    same : starts that ended at the best optimum
    """

    name: str
    value: Array
    sd: Array
    between: Array
    rms_rad: Array
    aside_rad: Array
    least_p: float
    same: int


def swings(path: Path, every: int) -> tuple[list[Array], list[Array]]:
    """(n, 2) angle from hanging and rate, thinned: those for the fit, those kept aside."""
    from scipy.io import loadmat

    if not path.is_file():
        raise InputError(path, "", "no such file")
    content = loadmat(path)
    missing = [name for name in ("Y_id", "Y_vad") if name not in content]
    if missing:
        raise InputError(
            path, missing[0], "missing; the swings of SinglePendulumDataForParameterEstimation.mat are expected"
        )
    fit, aside = (
        [np.column_stack([one[0] - np.pi, one[1]])[::every] for one in content[name].ravel()]
        for name in ("Y_id", "Y_vad")
    )
    return fit, aside


def simulated(sine: bool, w2: Array, c: Array, state: Array, count: int, step: float) -> Array:
    """Angle and rate (count, 2, ...) by classical Runge-Kutta; complex where the parameters are."""
    pull = np.sin if sine else np.positive
    path = np.empty((count, *state.shape), dtype=state.dtype)
    path[0] = state
    angle, rate, half = state[0], state[1], step / 2
    for k in range(1, count):
        a1 = -w2 * pull(angle) - c * rate
        r2 = rate + half * a1
        a2 = -w2 * pull(angle + half * rate) - c * r2
        r3 = rate + half * a2
        a3 = -w2 * pull(angle + half * r2) - c * r3
        r4 = rate + step * a3
        a4 = -w2 * pull(angle + step * r3) - c * r4
        angle = angle + step / 6 * (rate + 2 * r2 + 2 * r3 + r4)
        rate = rate + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        path[k, 0], path[k, 1] = angle, rate
    return path


def fitted(
    sine: bool, seen: list[Array], step: float, begin: Array, alone: bool = False, held: bool = False
) -> OutputError:
    """One fit. theta: ln w^2, ln c (one pair, or with ``alone`` one for each swing; none if ``held``), then the swings' starts."""
    runs, counts = len(seen), [len(one) for one in seen]
    pairs = 0 if held else runs if alone else 1
    places = [[*_pair(pairs, run), 2 * pairs + 2 * run, 2 * pairs + 2 * run + 1] for run in range(runs)]
    start = np.concatenate([*[np.log(begin)] * pairs, *(one[0] for one in seen)])

    def predict(theta: Array) -> tuple[list[Array], list[Array]]:
        # every swing hangs on four numbers: five columns, the second to fifth with one of them moved by i 1e-30
        own = np.array([np.concatenate([np.log(begin), theta[at]])[-4:] if held else theta[at] for at in places])
        moved = own.T[:, :, None] + 1j * COMPLEX_STEP * np.eye(4, 5, 1)[:, None, :]
        path = simulated(sine, np.exp(moved[0]), np.exp(moved[1]), moved[2:], max(counts), step)
        responses, slopes = [], []
        for run, (count, at) in enumerate(zip(counts, places, strict=True)):
            part = path[:count, :, run]
            slope = np.zeros((count, 2, len(theta)))
            slope[:, :, at] = np.imag(part[..., 5 - len(at) :]) / COMPLEX_STEP
            responses.append(np.real(part[..., 0]))
            slopes.append(slope)
        return responses, slopes

    return output_error(predict, seen, [np.arange(count) * step for count in counts], start, sigma=SIGMA)


def _pair(pairs: int, run: int) -> tuple[int, ...]:
    """Where a swing's ln w^2 and ln c stand."""
    return () if pairs == 0 else (0, 1) if pairs == 1 else (2 * run, 2 * run + 1)


def model(name: str, seen: list[Array], aside: list[Array], step: float, starts: int) -> Found:
    """Fit one of the two models from scattered starts, to all swings and to each alone."""
    sine = name == "full"
    rng = np.random.default_rng(1)
    tried = []
    for k in range(starts):
        begin = np.array(BEGIN) * np.exp([0.2, 1.0] * rng.uniform(-1, 1, 2) * (k > 0))
        found = fitted(sine, seen, step, begin)
        tried.append((sum(float((r**2 / np.square(SIGMA)).sum()) for r in found.residual), found))
    least = min(cost for cost, _ in tried)
    best = next(found for cost, found in tried if cost == least)
    value = np.exp(best.theta[:2])
    alone = np.exp(fitted(sine, seen, step, value, alone=True).theta[: 2 * len(seen)].reshape(-1, 2))
    kept = fitted(sine, aside, step, value, held=True)
    return Found(
        name,
        value,
        value * np.sqrt(np.diag(best.covariance)[:2]),
        alone.std(axis=0, ddof=1) / np.sqrt(len(seen)),
        np.array([np.sqrt(np.mean(r[:, 0] ** 2)) for r in best.residual]),
        np.array([np.sqrt(np.mean(r[:, 0] ** 2)) for r in kept.residual]),
        min(whitened_p(r) for r in best.residual),
        sum(cost < least * (1 + 1e-3) for cost, _ in tried),
    )


def whitened_p(residual: Array) -> float:
    """Least Ljung-Box p of the two channels after the autoregression that the fit takes out."""
    clock = np.arange(len(residual), dtype=float)
    weight = measured(residual, stated(np.broadcast_to(np.diag(np.square(SIGMA)), (len(residual), 2, 2)), clock))
    white = weight(residual)
    return min(ljung_box_p(white[:, c], len(weight.regression[c])) for c in range(2))


def say(found: Found, hint: str) -> None:
    """A model's result in words; ``hint``: where to look if it is wrong."""
    print(f"\n{found.name} model")
    for name, unit, i in (("w^2", "1/s2", 0), ("c", "1/s", 1)):
        value, noise, swing = found.value[i], 1.96 * found.sd[i], 1.96 * found.between[i]
        print(
            f"  {name:4}{value:9.4f} {unit:5} +- {noise:.4f} (95 %, from the residuals), +- {swing:.4f} (from swing to swing)"
        )
    print(f"  left over: {', '.join(f'{1e3 * r:.1f}' for r in found.rms_rad)} mrad rms in the four swings, "
          f"{', '.join(f'{1e3 * r:.1f}' for r in found.aside_rad)} mrad in the two kept aside")  # fmt: skip
    white = found.least_p > WHITE_P
    print(f"  residuals after whitening: {'white' if white else 'not white'} (least Ljung-Box p {found.least_p:.2g})")
    if not white or (found.between > 2 * found.sd).any():
        print(
            "  the model lacks something that the records show: the interval from the residuals is too small, and the one from "
            f"swing to swing is what can be said; {hint}"
        )


def main(arguments: Sequence[str] | None = None) -> list[Found]:
    """Run the example and print what it finds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="SinglePendulumDataForParameterEstimation.mat")
    parser.add_argument("--every", type=int, default=20, help="take every n-th sample (default: 20, 50 a second)")
    parser.add_argument("--starts", type=int, default=4)
    options = parser.parse_args(arguments)
    seen, aside = swings(options.data, options.every)
    step = options.every * STEP_S
    largest = ", ".join(f"{np.degrees(np.abs(one[:, 0]).max()):.0f}" for one in seen)
    print(f"{len(seen)} swings of up to {largest} degrees, {len(seen[0]) * step:.1f} s each, {len(aside)} kept aside")
    answers = []
    for name in ("linear", "full"):
        found = model(name, seen, aside, step, options.starts)
        say(found, "look at the period over the swing" if name == "linear" else "look at the friction over the speed")
        print(f"  {found.same} of {options.starts} starts ended here")
        answers.append(found)
    linear, full = answers
    ratio = float(np.sqrt(np.mean(linear.rms_rad**2) / np.mean(full.rms_rad**2)))
    print(f"\nthe full sine leaves {ratio:.1f} times less than the linear model")
    return answers


if __name__ == "__main__":
    main()
