"""``python -m towline.blind.truth OUT --cases N --seed S``: write campaigns whose truth lies sealed beside them."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..draw import Wanted
from ..seal import CASES, kept_digest, sealed, write_cases
from .forms import CHOICES, KEEP_SEED


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
    parser.add_argument("--forms", choices=CHOICES, default="all")
    parser.add_argument("--keep-seed", type=int, default=KEEP_SEED)
    given = parser.parse_args()
    chosen = {"forms": given.forms, "keep_seed": given.keep_seed}
    wanted = Wanted(given.cases, given.seed, given.nulls, given.video, tuple(given.only), **chosen)
    cases, digest = sealed(given.out, wanted, given.workers)
    print(f"sha256 of the forms kept out: {kept_digest(given.keep_seed)}", flush=True)
    print(f"sha256 of the truth: {digest}", flush=True)
    write_cases(given.out, cases, given.workers)
    print(f"wrote {given.out / CASES}")


if __name__ == "__main__":
    main()
