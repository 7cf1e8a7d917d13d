"""``python -m towline.blind.truth OUT --cases N --seed S``: write campaigns whose truth lies sealed beside them."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..draw import CASES, Wanted, sealed, write_cases


def main() -> None:
    """Write them."""
    parser = argparse.ArgumentParser(prog="python -m towline.blind.truth", description=(__doc__ or "").split(": ")[1])
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--nulls", type=int)
    parser.add_argument("--video", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[])
    given = parser.parse_args()
    wanted = Wanted(given.cases, given.seed, given.nulls, given.video, tuple(given.only))
    cases, digest = sealed(given.out, wanted, given.workers)
    print(f"sha256 of the truth: {digest}", flush=True)
    write_cases(given.out, cases, given.workers)
    print(f"wrote {given.out / CASES}")


if __name__ == "__main__":
    main()
