"""Why does a viscous pendulum differ from a measured one? The diagnosis with a simulator and effects of one's own.

    python examples/pendulum_gap.py SinglePendulumDataForParameterEstimation.mat

The file is that of github.com/dynamicslab/MultiArm-Pendulum (MIT). The simulator is a'' = -w^2 a - c a', for small swings; then
a'' = -w^2 sin(a) - c a'. Effects that may be missing are written below, each in a line of physics.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.gap import Diagnosis, diagnosed
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.record import InputError

STEP_S, BLOCK = 1e-3, 40
"""s between samples, and samples of a block's mean."""
INNER = 2
"""Integration steps in a block."""
ENCODER_RAD, SLOW_RAD, SLOW_S = 5e-4, 3e-4, 2.0
"""Of a block's mean: white, and what an encoder's disc adds slowly."""
RUB_RAD_S = 0.05
EFFECTS = (
    Effect(
        "finite_amplitude", "pendulum", (Parameter("share", "", 1.0),),
        "Gravity pulls back with the sine of the angle, not with the angle.", "Use sin(a).",
    ),
    Effect(
        "quadratic_drag", "pendulum", (Parameter("per_rad", "1/rad", 0.02, one_sided=True),),
        "Air drags with the square of the speed.", "Add -q a'|a'|.",
    ),
    Effect(
        "dry_friction", "pendulum", (Parameter("rad_s2", "rad/s2", 0.1, one_sided=True),),
        "The bearing rubs with a constant moment.", "Add -f sign(a').",
    ),
    Effect(
        "encoder_offset", "encoder", (Parameter("offset_rad", "rad", 0.02),),
        "The encoder's zero is not where the pendulum hangs.", "Read the encoder at rest.",
    ),
    Effect(
        "clock", "clock", (Parameter("rate", "", 0.01),),
        "The samples come at another rate than stated.", "Record a clock.",
    ),
)  # fmt: skip
Array = np.ndarray


def simulate(run: UsersRun, n: dict[str, Array], effects: dict[str, tuple[Array, ...]]) -> Array:
    """Means of the angle over blocks, (blocks, 1, k): k pendulums side by side."""
    (full,), (drag,), (rub,), (offset,), (rate,) = (effects.get(e.name, (0.0,)) for e in EFFECTS)
    full = np.clip(full + n["sine"], 0.0, 1.5)
    step = BLOCK * STEP_S / INNER * (1 + rate)

    def rates(a: Array, w: Array) -> tuple[Array, Array]:
        back = n["w2"] * ((1 - full) * a + full * np.sin(a))
        return w, -back - n["c"] * w - drag * w * np.abs(w) - rub * np.tanh(w / RUB_RAD_S)

    a, w = n["a0"] + 0.0, n["rate0"] + 0.0
    path = [a]
    for _ in range(INNER * len(run.centre_s)):
        k1 = rates(a, w)
        k2 = rates(a + step / 2 * k1[0], w + step / 2 * k1[1])
        k3 = rates(a + step / 2 * k2[0], w + step / 2 * k2[1])
        k4 = rates(a + step * k3[0], w + step * k3[1])
        a, w = (x + step / 6 * (p + 2 * q + 2 * r + s) for x, p, q, r, s in zip((a, w), k1, k2, k3, k4, strict=True))
        path.append(a)
    whole = np.array(path)
    means = (whole[:-2:2] + 4 * whole[1:-1:2] + whole[2::2]) / 6
    return (means + offset)[:, None]


def answer(shared: dict[str, Array], run: UsersRun) -> Array:
    """Angle after a unit angular acceleration that lasts one block, of small swings."""
    w2, c = float(shared["w2"][0]), float(shared["c"][0])
    t_s = run.centre_s - run.centre_s[0]
    own = np.sqrt(max(w2 - c * c / 4, 1e-6))
    return (BLOCK * STEP_S * np.exp(-c * t_s / 2) * np.sin(own * t_s) / own)[:, None]


def swings(path: Path) -> list[UsersRun]:
    """All six swings in means over blocks."""
    from scipy.io import loadmat

    if not path.is_file():
        raise InputError(path, "", "no such file")
    content, runs = loadmat(path), []
    for kind in ("Y_id", "Y_vad"):
        if kind not in content:
            raise InputError(path, kind, "missing; SinglePendulumDataForParameterEstimation.mat is expected")
        for k, one in enumerate(content[kind].ravel()):
            angle = np.asarray(one[0], dtype=float) - np.pi
            count = len(angle) // BLOCK
            values = angle[: count * BLOCK].reshape(count, BLOCK).mean(axis=1)
            centre_s = (np.arange(count) + 0.5) * BLOCK * STEP_S
            lag = np.abs(centre_s[:, None] - centre_s[None, :])
            covariance = ENCODER_RAD**2 * np.eye(count) + SLOW_RAD**2 * np.exp(-lag / SLOW_S)
            runs.append(UsersRun(f"{kind} {k + 1}", centre_s, values[:, None], covariance[None]))
    return runs


def diagnose(runs: list[UsersRun], sine: bool) -> Diagnosis:
    """Which effect is missing; ``sine``: the simulator has the full sine already."""
    begin = [float(run.values[0, 0]) for run in runs]
    speed = [float((run.values[1, 0] - run.values[0, 0]) / (BLOCK * STEP_S)) for run in runs]
    shared = [
        UsersNumber("w2", 60.0, size=60.0),
        UsersNumber("c", 0.1, size=0.1),
        UsersNumber("sine", float(sine), 1e-9),
    ]
    own = [UsersNumber("a0", begin), UsersNumber("rate0", speed, size=5.0)]
    simulator = UsersSimulator(runs, simulate, shared, own, answer, usual_force=0.02, most_force=0.5)
    library = [e for e in EFFECTS if not (sine and e.name == "finite_amplitude")]
    return diagnosed(simulator, library, "example", {}, rng=np.random.default_rng(0))


def report(title: str, found: Diagnosis) -> None:
    """The ranking and the words."""
    file = found.file
    print(f"{title}: {file.verdict}; no gap {file.p_no_gap:.2f}, unknown {file.p_unknown:.2f}")
    for row in file.ranking[:6]:
        numbers = ", ".join(f"{k} {v.value:.4g} +- {v.std:.1g}" for k, v in row.parameters.items())
        print(
            f"  {' + '.join(row.effects):36} p {row.probability:5.2f}  log evidence {row.log_evidence:9.1f}  "
            f"gap aside {row.gap_before:.2f} -> {row.gap_after:.2f}  {numbers}"
        )
    print(f"  random accelerations left: {file.noise['side_n']:.3f} rad/s2")


def main() -> None:
    """Both simulators."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path)
    given = parser.parse_args()
    runs = swings(given.file)
    report("small swings", diagnose(runs, False))
    report("full sine", diagnose(runs, True))


if __name__ == "__main__":
    main()
