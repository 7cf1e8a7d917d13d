"""Bad input: what every reader and estimator makes of damaged files and records.

    python benchmarks/faults.py [--cases 2000] [--seed 1] [--only NAME] [--estimators 100] > benchmarks/faults.txt

Valid files with keys, cells, bytes and encodings changed at random (hypothesis, from a stated seed). A case is handled where the
reader refuses it by a TowlineError of one line that names the file, or takes it and what it gives keeps the reader's promise
(finite, rising). Anything else is a defect and is shown with its smallest example; ends with code 1 if there was one. Damaged
recordings in earnest are fuzz.py's.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from faults_estimators import Estimator, estimated, estimators
from faults_readers import Reader, judged, prepared, readers
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

OUTCOMES = ("accepted", "refused", "unhandled")
MEMORY_BYTES = 6 << 30
QUIET = list(HealthCheck)


def outcomes(
    judge: Callable[[Any], str], cases: st.SearchStrategy[Any], count: int, from_seed: int
) -> tuple[Counter, str]:
    """Count what came of the cases; of the unhandled ones the smallest example and what was raised."""
    found: Counter = Counter()

    @seed(from_seed)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=QUIET)
    @given(cases)
    def counted(case: Any) -> None:
        try:
            found[judge(case)] += 1
        except Exception:
            found["unhandled"] += 1

    counted()
    return found, smallest(judge, cases, count, from_seed) if found["unhandled"] else ""


def smallest(judge: Callable[[Any], str], cases: st.SearchStrategy[Any], count: int, from_seed: int) -> str:
    """The smallest case that is not handled, and what it raises."""
    last: list[Any] = []

    @seed(from_seed)
    @settings(
        max_examples=count, database=None, deadline=None, phases=[Phase.generate, Phase.shrink],
        suppress_health_check=QUIET, report_multiple_bugs=False, print_blob=False,
    )  # fmt: skip
    @given(cases)
    def failing(case: Any) -> None:
        try:
            judge(case)
        except Exception:
            last[:] = [case]
            raise

    try:
        failing()
    except Exception as error:
        shown = repr(last[0]) if last else "?"
        return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}\n      from {shown[:300]}"
    return "not found again"


def of_reader(reader: Reader, count: int, from_seed: int) -> tuple[Counter, str]:
    """Outcomes of a reader."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared(reader, folder)
        return outcomes(lambda data: judged(reader, folder, data), reader.damaged, count, from_seed)


def of_estimator(estimator: Estimator, count: int, from_seed: int) -> tuple[Counter, str]:
    """Outcomes of an estimator."""
    return outcomes(
        lambda case: estimated(estimator, case), estimator.cases, max(1, round(estimator.share * count)), from_seed
    )


def main() -> int:
    """Run and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=2000, help="per reader")
    parser.add_argument("--estimators", type=int, default=100, help="cases per estimator")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="those whose name holds this")
    given_ = parser.parse_args()
    warnings.simplefilter("ignore")
    resource.setrlimit(
        resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES)
    )  # what asks for more is a defect, not a slow machine
    defects = 0
    for title, tried, judge, count in (
        ("reader", readers(), of_reader, given_.cases),
        ("estimator", estimators(), of_estimator, given_.estimators),
    ):
        print(f"{title:28}{'cases':>8}" + "".join(f"{name:>12}" for name in OUTCOMES) + f"{'s':>8}")
        total: Counter = Counter()
        for one in tried:
            if given_.only not in one.name or not count:
                continue
            began = time.perf_counter()
            found, example = judge(one, count, given_.seed)  # pyright: ignore[reportArgumentType]
            total += found
            took = time.perf_counter() - began
            print(
                f"{one.name:28}{found.total():8}" + "".join(f"{found[k] or '-':>12}" for k in OUTCOMES) + f"{took:8.1f}"
            )
            if example:
                print(f"      {example}")
            sys.stdout.flush()
        print(f"{'all':28}{total.total():8}" + "".join(f"{total[k] or '-':>12}" for k in OUTCOMES) + "\n")
        defects += total["unhandled"]
    print(f"seed {given_.seed}; {defects} unhandled")
    return int(defects > 0)


if __name__ == "__main__":
    sys.exit(main())
