"""Measured swings of a real pendulum and the equations of small swings: which terms do they lack?

    python benchmarks/pendulum_law.py SinglePendulumDataForParameterEstimation.mat

The file is that of github.com/dynamicslab/MultiArm-Pendulum (MIT): six swings of 9 s, released between 23 and 92 degrees. Means
over 40 ms are asked by ``towline gap --law`` with a'' = -w2 a - c a'. Nobody states the encoder's noise; 2 mrad hold what its disc
adds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from towline.pipeline.own_models import gap_of_model

BLOCK, STEP_S, NOISE_RAD = 40, 1e-3, 2e-3
MODEL = """
from towline.diagnose.own import Model, Number, Output, State

MODEL = Model(
    [State("angle", "rad"), State("rate", "rad/s", equation="pendulum")],
    [],
    [Number("w2", "1/s2", 50.0, least=0), Number("c", "1/s", 0.1, least=0)],
    [Output("angle", "rad", stage="encoder")],
    lambda t, x, u, p: (x.rate, -p.w2 * x.angle - p.c * x.rate),
)
"""
TABLE = f'[clock]\ncolumn = "t_s"\n\n[[column]]\nname = "angle_rad"\nrole = "output"\nof = "angle"\nnoise_sd = {NOISE_RAD}\n'


def main() -> None:
    """Ask, and print the answer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("file", type=Path)
    content = loadmat(parser.parse_args().file)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "small.py").write_text(MODEL)
        (folder / "data.toml").write_text(TABLE)
        tables = []
        for one in (own for kind in ("Y_id", "Y_vad") for own in content[kind].ravel()):
            angle = np.asarray(one[0], dtype=float) - np.pi
            count = len(angle) // BLOCK
            means = angle[: count * BLOCK].reshape(count, BLOCK).mean(axis=1)
            t_s = (np.arange(count) + 0.5) * BLOCK * STEP_S
            tables.append(folder / f"swing-{len(tables) + 1}.csv")
            np.savetxt(tables[-1], np.c_[t_s, means], "%.6f", ",", header="t_s,angle_rad", comments="")
        began = time.process_time()
        file = gap_of_model(folder / "small.py", tables, law=True).file
        spent_s = time.process_time() - began
    for sentence in file.sentences:
        print(sentence)
    print(f"\n{'hypothesis':62}{'probability':>12}{'exact':>8}{'gap before':>12}{'after':>8}  numbers")
    for row in file.ranking[:5]:
        numbers = ", ".join(f"{v.value:.4g} +- {v.std:.2g}" for v in row.parameters.values())
        words = " + ".join(row.effects)
        print(f"{words:62}{row.named:12.3f}{row.probability:8.3f}{row.gap_before:12.2f}{row.gap_after:8.2f}  {numbers}")
    print(f"{'unknown':62}{file.p_unknown:12.3f}")
    for when, those in file.derivatives.items():
        print(f"{when}: " + ", ".join(f"{k} {v.value:.4g} +- {v.std:.2g}" for k, v in those.items()))
    print(f"{spent_s:.0f} s of one core")


if __name__ == "__main__":
    main()
