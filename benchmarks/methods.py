"""Every estimator against truth under one noise: error, bias, coverage of its stated interval, time.

    python benchmarks/methods.py [--only TEXT] [--seeds N] [--workers 2]

Cases: methods_cases.py, their data: methods_data.py. Draw k takes numpy's default_rng([c, k]), c the
first case with the same data: what stands beside each other saw the same noise.
Writes a table to standard output; benchmarks/methods.txt is a run of it. docs/how-to-choose.md takes its figures from there.
"""

from __future__ import annotations

import argparse
import time
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from methods_cases import CASES, Case, Draw, EstimationError


def run(case: Case, seeds: int) -> tuple[list[Draw], list[float], int]:
    """Draws, CPU seconds of each estimate, refusals."""
    draws: list[Draw] = []
    spent: list[float] = []
    refused = 0
    index = next(i for i, other in enumerate(CASES) if other.make is case.make)
    for k in range(seeds):
        data = case.make(np.random.default_rng([index, k]))
        began = time.process_time()
        try:
            draws.append(case.call(data))
        except (EstimationError, np.linalg.LinAlgError):
            refused += 1
        spent.append(time.process_time() - began)
    return draws, spent, refused


def line(title: str, values: np.ndarray, form: str) -> str:
    cells = "".join(f"{'-':>9}" if np.isnan(v) else f"{v:>9{form}}" for v in values)
    return f"  {title:34}{cells}"


def table(index: int, seeds: int | None) -> str:
    """One case's lines."""
    warnings.simplefilter("ignore", RuntimeWarning)
    case = CASES[index]
    seeds = seeds or case.seeds
    draws, spent, refused = run(case, seeds)
    lines = [f"{index:2d} {case.name}: {case.data}; {seeds} seeds, {np.median(spent):.2g} s"]
    if refused:
        lines.append(f"  refused: {refused} of {seeds}")
    if not draws:
        return "\n".join(lines)
    value, sd = np.array([d.value for d in draws]), np.array([d.sd for d in draws])
    truth = draws[0].truth
    error = value - truth
    lines.append(f"  {'':34}" + "".join(f"{name:>9}" for name in draws[0].names))
    lines.append(line("median |error|, %", 100 * np.median(np.abs(error), axis=0) / np.abs(truth), ".3g"))
    middle = error.mean(axis=0)
    lines.append(line("bias, %", 100 * middle / np.abs(truth), ".2g"))
    if len(draws) > 2:
        lines.append(
            line("bias in its standard errors", middle / (error.std(axis=0, ddof=1) / np.sqrt(len(draws))), ".1f")
        )
    if np.isfinite(sd).all():
        lines.append(line("median stated sd, %", 100 * np.median(sd, axis=0) / np.abs(truth), ".3g"))
        lines.append(line("95 % interval holds the truth, %", 100 * (np.abs(error) < 1.96 * sd).mean(axis=0), ".0f"))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--seeds", type=int, help="instead of each case's own")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    began = time.perf_counter()
    print(
        "ITTC MARINER hull, U 1.28 m/s, L 0.91 m, T 3.96 N, X_T 1.446, 1.548, 1.649, 1.751 m, 60 s at 64 Hz, 1 mm, 0.1 degree,"
    )
    print("released at 0.15 m at rest; seconds: median CPU time of one estimate. What a case changes stands beside it.")
    wanted = [k for k, case in enumerate(CASES) if options.only.lower() in case.name.lower()]
    with ProcessPoolExecutor(options.workers) as pool:
        for text in pool.map(table, wanted, [options.seeds] * len(wanted)):
            print("\n" + text, flush=True)
    print(f"\nall: {time.perf_counter() - began:.0f} s, {options.workers} processes")


if __name__ == "__main__":
    main()
