"""``towline identify``: derivatives from all runs together."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from .common import (
    add_fit,
    add_method,
    add_runs,
    console,
    exit_code,
    print_notes,
    read_batch,
    show_progress,
)

NAME = "identify"
HELP = "joint fit of the six linear derivatives over all runs (out/derivatives.json)"


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_runs(sub)
    add_method(sub)
    add_fit(sub)
    sub.add_argument(
        "--reference",
        metavar="ittc|southampton|FILE.csv",
        help="compare with a reference set of primes, as towline compare",
    )
    sub.add_argument(
        "--thorough",
        nargs="?",
        type=int,
        const=1,
        metavar="SEED",
        help="check optimum and intervals: other starts, 100 drawn records, profiles (out/thorough.json; a minute for four runs)",
    )
    sub.add_argument(
        "--estimator",
        metavar="NAME",
        help="another way to the six than the joint fit, for a second opinion (docs/methods; an unknown name lists them); "
        "writes out/derivatives_NAME.json and no page",
    )
    sub.add_argument(
        "--estimators",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE.py",
        help="estimators of one's own; this RUNS the file as a program: name none that you would not run yourself",
    )
    sub.add_argument(
        "--effects",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="a law of towline diagnose --law that is known beforehand: law.toml with its numbers and law.py with its terms, which "
        "is RUN as a program: name none that you would not run yourself",
    )
    sub.add_argument("--no-page", action="store_true", help="write no HTML page")
    sub.add_argument("-o", "--out", type=Path, help="where derivatives.json and derivatives.html go (default: RUN/out)")


def call(options: argparse.Namespace) -> int:
    """Run the command."""
    from ..identify.reference import compare_to_reference, comparison_lines, reference_set
    from ..pipeline.analysis import by_line, output_folder
    from ..record.errors import TowlineError

    reference = None if options.reference is None else reference_set(options.reference)
    other = _other_estimator(options)
    law = _known_law(options, other)
    batch, free = by_line(read_batch(options))
    out = options.out or output_folder(options.runs)
    if other is not None:
        return _estimate(options, other, batch, free, out)
    if not batch.runs and law is None:
        return _identify_free(options, free, out)
    if law is not None and free.runs:
        raise TowlineError(f"--effects: {free.runs[0].run.name} is a free run; a law goes with tows")
    answer = fit_and_write(options, batch, out, law)
    compared = None
    if reference is not None:
        from ..report.format import SYMBOLS_TEXT

        compared = compare_to_reference(answer.result, reference)
        options.outcome.result["comparison"] = compared
        print("\n".join(comparison_lines(compared, SYMBOLS_TEXT)))
        print_notes(compared.notes)
    if options.thorough is not None:
        _check_thoroughly(options, answer, out)
    if not options.no_page:
        from ..pipeline.analysis import fit_page
        from ..pipeline.executor.copies import with_a_copy
        from ..record.budget_file import budget_beside
        from ..report.identify_page import write_identify_page

        with show_progress() as show:
            shown = fit_page(answer, compared, lambda text: show(text, 0, None), with_a_copy)
        shown = replace(shown, budget=budget_beside(out, answer.result.inputs))
        page = out / "derivatives.html"
        write_identify_page(page, shown, with_a_copy)
        options.outcome.wrote(page, word="page:")
    options.outcome.fail(answer.result.failed)
    code = exit_code(answer.result.failed)
    return max(code, _identify_free(options, free, out, answer)) if free.runs else code


def _other_estimator(options: argparse.Namespace) -> Any:
    """The estimator that is asked for by name; None: the joint fit."""
    from ..record.errors import TowlineError

    if options.estimator is None and not options.estimators:
        return None
    from ..identify.estimators import estimator_of
    from ..record.own_code import run_own

    for path in options.estimators:
        run_own(path)
    if options.estimator is None:
        raise TowlineError("--estimators: which one? Name it with --estimator")
    for option in ("reference", "thorough"):
        if getattr(options, option) is not None:
            raise TowlineError(f"--{option} goes with the joint fit, not with --estimator")
    return estimator_of(options.estimator)


def _known_law(options: argparse.Namespace, estimator: Any) -> Any:
    """The law that the fit knows beforehand, or None."""
    if options.effects is None:
        return None
    from ..pipeline.missing import read_law
    from ..record.errors import TowlineError

    for option, wrong in (
        ("--estimator", estimator is not None),
        ("--form linear", options.form == "linear"),
        ("--noise innovations", options.noise == "innovations"),
    ):
        if wrong:
            raise TowlineError(f"{option}: a law goes with the joint fit, in the full form by output error")
    return read_law(options.effects)


def _estimate(options: argparse.Namespace, estimator: Any, batch: Any, free: Any, out: Path) -> int:
    """By another way than the joint fit: a table and derivatives_NAME.json."""
    from ..pipeline.analysis import estimate_batch
    from ..record.errors import TowlineError
    from ..record.priors import read_priors
    from ..record.results import write_result
    from ..report import derivatives_table

    if free.runs:
        raise TowlineError(f"--estimator: {free.runs[0].run.name} is a free run; the estimators take tows")
    priors = None if options.priors is None else read_priors(options.priors)
    with show_progress() as show:
        show(f"fitting: {estimator.title}", 0, None)
        result = estimate_batch(batch, estimator, options.speed, priors)
    path = out / f"derivatives_{estimator.name}.json"
    write_result(path, result)
    console().print(derivatives_table(result))
    print_notes(result.notes)
    options.outcome.result["derivatives"] = result
    options.outcome.wrote(path)
    options.outcome.fail(result.failed)
    return exit_code(result.failed)


def _check_thoroughly(options: argparse.Namespace, answer: Any, out: Path) -> None:
    from ..pipeline.thorough import thorough
    from ..record.results import write_result

    with show_progress() as show:
        checked = thorough(answer, options.thorough, progress=lambda text: show(text, 0, None))
    write_result(out / "thorough.json", checked)
    print("\n".join(checked.sentences))
    options.outcome.result["thorough"] = checked
    options.outcome.wrote(out / "thorough.json")


def fit_and_write(options: argparse.Namespace, batch: Any, out: Path, law: Any = None) -> Any:
    """Fit, write derivatives.json and print its table; returns ``analysis.Identified``."""
    from ..pipeline.analysis import identify_batch
    from ..record.priors import read_priors
    from ..record.results import write_result
    from ..report import derivatives_table

    priors = None if options.priors is None else read_priors(options.priors)
    with show_progress() as show:
        answer = identify_batch(
            batch, options.form, options.speed, priors, lambda text: show(text, 0, None), options.noise, law=law
        )
    write_result(out / "derivatives.json", answer.result)
    console().print(derivatives_table(answer.result))
    print_notes([*answer.result.not_identifiable, *answer.result.notes])
    options.outcome.result["derivatives"] = answer.result
    options.outcome.wrote(out / "derivatives.json")
    return answer


def _identify_free(options: argparse.Namespace, batch: Any, out: Path, towed: Any = None) -> int:
    """Free runs: on their own as derivatives.json, beside tows as free_run.json."""
    answer = fit_free_and_write(options, batch, out, towed)
    if not options.no_page:
        from ..pipeline.stages import make_run_page
        from ..report import write_page

        page = out / ("derivatives.html" if towed is None else "free_run.html")
        pages = [make_run_page(m, answer.fitted[m.run.name], None) for m in answer.runs]
        write_page(page, f"Free runs: {', '.join(answer.fitted)}", pages, answer.result, None, [])
        options.outcome.wrote(page, word="page:")
    options.outcome.fail(answer.result.failed)
    return exit_code(answer.result.failed)


def fit_free_and_write(options: argparse.Namespace, batch: Any, out: Path, towed: Any = None) -> Any:
    """The same of free runs; ``towed``: what the tows of the same hull gave."""
    from ..pipeline.analysis import identify_free_batch
    from ..record.errors import TowlineError
    from ..record.priors import read_priors
    from ..record.results import write_result
    from ..report import derivatives_table

    for option, wrong in (("--form", options.form == "linear"), ("--noise", options.noise == "innovations")):
        if wrong and towed is None:
            raise TowlineError(f"{option}: free runs are fitted by output error with the full kinematics only")
    if towed is None and getattr(options, "reference", None) is not None:
        raise TowlineError(
            "--reference: a reference holds the six derivatives of a towed hull; these runs are all free"
        )
    priors = None if options.priors is None else read_priors(options.priors)
    with show_progress() as show:
        show("fitting the free runs", 0, None)
        answer = identify_free_batch(batch, options.speed, priors, towed)
    name = "derivatives" if towed is None else "free_run"
    write_result(out / f"{name}.json", answer.result)
    if towed is not None:
        with_tows = answer.result.free is not None and answer.result.free.scale == "tows"
        how = "with the tows' derivatives and their covariance" if with_tows else "by themselves"
        print(f"the free runs ({', '.join(answer.fitted)}) were fitted apart, {how}")
    console().print(derivatives_table(answer.result))
    print_notes([*answer.result.not_identifiable, *answer.result.notes])
    options.outcome.result[name] = answer.result
    options.outcome.wrote(out / f"{name}.json")
    return answer
