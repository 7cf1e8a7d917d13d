"""``towline campaign``: every run below a folder."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

NAME = "campaign"
HELP = "every run below a folder: motion, derivatives, one table (campaign.csv, .parquet) and one page; goes on where it stopped"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument(
        "folder", metavar="DIR", help="folder with run folders below it; also a URL that fsspec can open (s3://...)"
    )
    sub.add_argument("--workers", type=int, default=1, help="processes on this machine (default: 1)")
    sub.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler, tcp://host:port, instead of --workers")
    sub.add_argument("--form", choices=("full", "linear"), default="full", help="equations to fit (default: full)")
    from .common import add_line

    add_line(sub)
    sub.add_argument("--speed", type=float, metavar="M/S", help="speed at which derivatives are quoted")
    sub.add_argument(
        "--noise", choices=("auto", "output", "innovations"), default="auto", help="as towline identify (default: auto)"
    )
    sub.add_argument("--cache", type=Path, help="where the files of a URL are kept (default: the user's cache folder)")
    sub.add_argument("--fresh", action="store_true", help="redo what is up to date")
    sub.add_argument("-o", "--out", type=Path, help="where results of several runs go (default: DIR/out)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.campaign.remote import is_remote, mirrored
    from ..pipeline.campaign.whole import campaign
    from ..pipeline.campaign.work import Options
    from ..pipeline.campaign.workers import workers
    from ..report.campaign_page import write_campaign_page
    from .common import EXIT_OK, EXIT_SOME_FAILED, show_progress

    chosen = Options(
        form=options.form, speed_m_s=options.speed, noise=options.noise, fresh=options.fresh, line=options.line
    )
    place = mirrored(options.folder, options.cache) if is_remote(options.folder) else nullcontext(Path(options.folder))
    with show_progress() as show, place as folder, workers(options.workers, options.scheduler) as found:
        done = campaign(folder, found, chosen, options.out, show)
        page = done.out / "campaign.html"
        write_campaign_page(page, done)
    good = [a for a in done.runs if not a.reason]
    print(f"{len(good)} of {len(done.runs)} runs, {sum(a.redone for a in good)} worked out now")
    for fit in done.fits:
        if not fit.reason:
            print(
                f"{fit.name}: "
                + ", ".join(f"{q} {v:.5g} +- {s:.2g}" for q, v, s, _ in fit.numbers[:6] if s is not None)
            )
    options.outcome.result = {"runs": done.runs, "fits": done.fits}
    options.outcome.wrote(*done.wrote, page)
    options.outcome.fail(done.failed)
    return EXIT_SOME_FAILED if done.failed else EXIT_OK
