"""``towline diagnose``: where simulator and tank differ, which unmodelled effect causes it, how far it shrinks."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

NAME = "diagnose"
HELP = "where simulator and tank differ, which unmodelled effect causes it, how far it shrinks (out/gap.json, out/gap.html)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    from .common import add_effects, add_line

    add_line(sub)
    sub.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folders of one model")
    sub.add_argument(
        "--hold-out", nargs="+", type=Path, default=[], metavar="RUN", help="runs kept aside to measure the shrink on"
    )
    sub.add_argument(
        "--reference",
        type=Path,
        metavar="derivatives.json",
        help="judge a simulator with these derivatives as they are",
    )
    sub.add_argument(
        "--hull",
        type=Path,
        metavar="HULL.fmu",
        help="judge another simulator: an FMU of its hull, whose equations stand in place of towline's; this RUNS its code",
    )
    add_effects(sub)
    sub.add_argument(
        "--without", nargs="+", default=[], metavar="EFFECT", help="effects that you know are not there, by their names"
    )
    sub.add_argument(
        "--law",
        action="store_true",
        help="search the missing force's law also where an effect of the library is named (out/law.json, law.py, law.toml)",
    )
    sub.add_argument("--write-model", type=Path, metavar="FILE.toml", help="derivatives and effect for a scenario.toml")
    sub.add_argument("--no-page", action="store_true", help="write no HTML page")
    sub.add_argument("-o", "--out", type=Path, help="where gap.json and gap.html go (default: RUN/out)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..pipeline.analysis import output_folder
    from ..pipeline.diagnosing import diagnose_folders, write_model
    from ..record.results import write_result
    from .common import EXIT_OK, EXIT_SOME_FAILED, show_progress

    with show_progress() as show:
        found = diagnose_folders(
            options.runs,
            options.hold_out,
            options.effects,
            options.reference,
            show,
            options.line,
            options.without,
            options.hull,
        )
    file = found.diagnosis.file
    out = options.out or output_folder([run.folder for run in found.runs])
    write_result(out / "gap.json", file)
    for sentence in file.sentences:
        print(sentence)
    print()
    _ranking(file)
    written = [out / "gap.json"]
    if options.write_model is not None:
        write_model(options.write_model, found)
        written.append(options.write_model)
    options.outcome.result["gap"] = file
    section = None
    if options.law or file.verdict in ("unknown", "form_not_exact"):
        more, section = _law(options, out, found)
        written += more
    if not options.no_page:
        from ..report.gap_page import write_gap_page

        write_gap_page(out / "gap.html", found, section)
        written.append(out / "gap.html")
    options.outcome.wrote(*written)
    options.outcome.fail(found.failed)
    return EXIT_SOME_FAILED if found.failed else EXIT_OK


def _law(options: argparse.Namespace, out: Path, found: Any) -> tuple[list[Path], Any]:
    """What was written, and the page's section."""
    from ..pipeline.laws import law_file, law_of, write_law
    from .common import show_progress

    with show_progress() as show:
        answer = law_of(found, show)
    file = law_file(answer, found.diagnosis.file.inputs)
    print()
    for sentence in file.sentences:
        print(sentence)
    for law in file.laws:
        print(f"{law.text:60}{law.probability:8.3f}")
    options.outcome.result["law"] = file
    written = write_law(out, found, answer, file)
    if options.no_page:
        return written, None
    from ..report.law_section import law_section

    return written, law_section(file, answer.searched)


def _ranking(file: Any) -> None:
    print(f"{'hypothesis':54}{'probability':>12}{'gap before':>12}{'after':>8}{'shrink':>8}")
    print(f"{'no gap':54}{file.p_no_gap:12.3f}")
    for row in file.ranking[:5]:
        shrink = "-" if row.shrinks is None else f"{row.shrink:.2f}"
        print(f"{row.words:54}{row.named:12.3f}{row.gap_before:12.2f}{row.gap_after:8.2f}{shrink:>8}")
    print(f"{'unknown':54}{file.p_unknown:12.3f}")
    shares = ", ".join(f"{stage} {share:.2f}" for stage, share in file.where.share.items())
    print(f"where: {shares}")
    for name, why in file.excluded.items():
        print(f"not judged: {name} ({why})")
