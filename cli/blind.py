"""``towline blind``: the diagnosis scored on campaigns whose truth is sealed."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "blind"
HELP = "score the diagnosis on campaigns of a reality of its own whose truth is sealed (score.txt, score.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("out", type=Path, metavar="OUT", help="folder of the check; started again, it goes on")
    sub.add_argument("--cases", type=int, default=200, help="campaigns (default: 200)")
    sub.add_argument("--seed", type=int, default=1, help="of everything that is drawn (default: 1)")
    sub.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    sub.add_argument("--nulls", type=int, help="campaigns without any effect (default: a quarter)")
    sub.add_argument(
        "--told",
        type=int,
        default=0,
        help="nulls whose run.toml tells a rudder, a speed history, ... (default: none)",
    )
    sub.add_argument("--video", type=int, default=0, help="campaigns that are filmed and tracked (default: none)")
    sub.add_argument("--only", nargs="+", default=[], metavar="EFFECT", help="draw from these effects alone")
    sub.add_argument(
        "--forms",
        choices=("all", "known", "kept", "classic"),
        default="all",
        help="forms in which effects come: all, those not kept out, those kept out alone, one each (default: all)",
    )
    sub.add_argument("--keep-seed", type=int, help="draws the forms that are kept out (default: the code's)")
    sub.add_argument("--only-write", action="store_true", help="seal and write the campaigns, diagnose nothing")
    sub.add_argument("--score-only", action="store_true", help="open the seal and score what is answered already")
    sub.add_argument("--next", action="store_true", help="make the proposed next runs, too, and diagnose once more")
    sub.add_argument("--html", action="store_true", help="write the reliability diagram (reliability.html)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..blind.check import PAGE, SCORE_JSON, SCORE_TEXT, diagnose, prepare, score
    from ..blind.draw import Wanted
    from ..blind.truth.forms import KEEP_SEED
    from ..blind.words import score_text
    from ..record.files import write_text
    from .common import EXIT_OK, EXIT_SOME_FAILED, show_progress

    out: Path = options.out
    with show_progress() as show:
        if not options.score_only:
            wanted = Wanted(
                options.cases,
                options.seed,
                options.nulls,
                options.video,
                tuple(options.only),
                told=options.told,
                forms=options.forms,
                keep_seed=KEEP_SEED if options.keep_seed is None else options.keep_seed,
            )
            prepare(out, wanted, lambda text: _say(options, text), options.workers, show)
            if options.only_write:
                return EXIT_OK
            diagnose(out, options.workers, show)
        outcome = score(out, options.workers, show)
        text = score_text(outcome)
        if options.next:
            from ..blind.next_runs import next_runs, next_text

            settled = next_runs(out, options.workers, show)
            options.outcome.result["next_runs"] = settled
            text += "\n" + next_text(settled)
    options.outcome.result["score"] = outcome
    print(text, end="")
    write_text(out / SCORE_TEXT, text)
    written = [out / SCORE_JSON, out / SCORE_TEXT]
    if options.html:
        from ..blind.page import write_blind_page

        write_blind_page(out / PAGE, outcome)
        written.append(out / PAGE)
    options.outcome.wrote(*written)
    return EXIT_SOME_FAILED if outcome.missing else EXIT_OK


def _say(options: argparse.Namespace, text: str) -> None:
    options.outcome.result.setdefault("prepared", []).append(text)
    print(text, flush=True)
