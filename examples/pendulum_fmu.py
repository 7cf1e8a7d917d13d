"""A pendulum with a motor as an FMU, made of C by the machine's compiler: FMI 2.0 or 3.0, model exchange or co-simulation.

    python examples/pendulum_fmu.py pendulum.fmu --version 2 --kind exchange

a'' = -w2 sin(a) - c a' + g u: the same equations as docs/gap.md has in Python.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from fmu_of_c import Variable
from fmu_of_c import make as made

EQUATIONS = r"""
static void rates(const Model *m, const double *x, double *d) {
    d[0] = x[1];
    d[1] = -m->v[2] * sin(x[0]) - m->v[3] * x[1] + m->v[4] * m->v[5];
}
"""
VARIABLES = (
    Variable("angle", "rad", 0.3, "output"),
    Variable("rate", "rad/s", 0.0, "local"),
    Variable("w2", "1/s2", 50.0, "parameter", "fixed", 0.0),
    Variable("damping.c", "1/s", 0.1, "parameter", "tunable", 0.0),
    Variable("gain", "1/(kg m2)", 1.0, "parameter", "tunable"),
    Variable("torque", "N m", 0.0, "input"),
)


def make(path: Path, version: int = 2, kind: str = "exchange", platform: str = "") -> Path:
    """Compile and pack.

    Parameters
    ----------
    path : of the FMU
    version : 2 or 3
    kind : "exchange" or "co-simulation"
    platform : folder of its binary; empty: this machine's

    Returns
    -------
    path : the same
    """
    return made(path, "pendulum", EQUATIONS, VARIABLES, 2, version, kind, platform)


def main(arguments: list[str] | None = None) -> None:
    """Make one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--version", type=int, choices=(2, 3), default=2)
    parser.add_argument("--kind", choices=("exchange", "co-simulation"), default="exchange")
    given = parser.parse_args(arguments)
    make(given.path, given.version, given.kind)


if __name__ == "__main__":
    main()
