"""One campaign of six tows for every effect of the library, none, and two that are in no library: what the diagnosis says.

    python benchmarks/gap.py [--seeds 1] [--only NAME ...] [--line surge]

A look at every effect at a size that is clear to the eye in the residual, not a score: that takes many campaigns of random size
whose truth is withheld. benchmarks/gap.txt is a run of it.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from gap_cases import EFFECTS, NEEDS_CONSTANT, NEEDS_SURGE, campaign

from towline import __version__
from towline.diagnose.effects import LIBRARY
from towline.diagnose.gap import diagnosed
from towline.diagnose.tow.data import Recorded, block_step, tow_runs
from towline.diagnose.tow.towed import TowSimulator
from towline.geometry import motion_from_tracks, run_datum
from towline.record import TowlineError


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=sorted(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--line", choices=("constant", "surge"), default="surge", help="what the line keeps")
    given = parser.parse_args()
    head = ("planted", "size", "verdict", "first", "p", "no gap", "unknown", "before", "after", "s")
    print(("{:22}{:>8} {:9}{:44}{:>6}{:>8}{:>9}{:>8}{:>7}{:>5}").format(*head), flush=True)
    apart = NEEDS_CONSTANT if given.line == "surge" else NEEDS_SURGE
    for planted in (name for name in given.only if name not in apart):
        number = list(EFFECTS).index(planted)
        for seed in range(given.seeds):
            case = campaign(planted, np.random.default_rng([seed, number]), line=given.line)
            began = time.perf_counter()
            fit = run_datum(case.runs[0][0], None)
            runs = []
            for run, tracks, static in case.runs:
                made = motion_from_tracks(run, tracks, fit)
                runs.append(Recorded(run, made.motion, made.common, tracks, fit, static))
            runs = tow_runs(runs, block_step([45.0]))
            try:
                file = diagnosed(TowSimulator(runs), LIBRARY, __version__, {}, rng=np.random.default_rng(seed)).file
            except TowlineError as error:
                print(f"{planted:22}{EFFECTS[planted]:8g} {error}", flush=True)
                continue
            top = file.ranking[0]
            print(
                f"{planted:22}{EFFECTS[planted]:8g} {file.verdict:9}{' + '.join(top.effects):44}{top.probability:6.2f}"
                f"{file.p_no_gap:8.2f}{file.p_unknown:9.2f}{top.gap_before:8.2f}{top.gap_after:7.2f}"
                f"{time.perf_counter() - began:5.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
