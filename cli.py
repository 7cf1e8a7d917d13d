"""The command line: parse, call, print. No computing here, and nothing heavy is imported before it is needed."""

from __future__ import annotations

import argparse
import errno
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NoReturn

from . import __version__
from .commands.outcome import Outcome, no_memory, one_line
from .memory import reserve, too_little
from .names import take_any_name

PIPE_WIDTH = 130
"""Columns of a table that does not go to a terminal."""
JSON_HELP = "say the result as one JSON object on standard output, and nothing else there (docs/commands.md)"
LONGEST = 300
"""Letters of what a library says."""
INTERRUPTED = "interrupted; what was finished is kept"
EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_SOME_FAILED, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


class WrongUsage(SystemExit):
    """The words typed are no command, or not a command's."""

    def __init__(self, command: str, message: str) -> None:
        super().__init__(EXIT_USAGE)
        self.command, self.message = command, message


class Parser(argparse.ArgumentParser):
    """Remembers what was wrong, to be said as JSON as well."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise WrongUsage(self.prog.partition(" ")[2], message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code (0 done, 1 error, 2 usage, 3 done but some runs failed, 130 interrupted)."""
    # many small matrices: one thread each is faster, and leaves the other cores to those who work side by side
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    take_any_name(sys.stdout, sys.stderr)
    try:
        code = _main(arguments)
        if code == EXIT_INTERRUPTED and arguments is None:
            _hear_no_more()
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:  # before the command began, or after its end
        if arguments is None:
            _hear_no_more()
        print(f"towline: {INTERRUPTED}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except OSError as error:  # of standard output
        _silence(sys.stdout)
        if not isinstance(error, BrokenPipeError):  # nobody reads any more: nothing to say, and to whom
            print(f"towline: error: standard output: {error.strerror or error}", file=sys.stderr)
        return EXIT_ERROR


def _hear_no_more() -> None:
    """The program ends anyway: who is impatient and presses Ctrl+C again gets the same exit code, and no words of Python's."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _silence(stream: Any) -> None:
    """What could not be written there is not tried again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _main(arguments: Sequence[str] | None) -> int:
    parser = _parser()
    try:
        options = parser.parse_args(arguments)
    except WrongUsage as wrong:
        Outcome(wrong.command or None, "--json" in (sys.argv if arguments is None else arguments)).close(
            EXIT_USAGE, wrong.message
        )
        raise
    outcome = options.outcome = Outcome(options.command, options.json)
    try:
        with outcome.speaking():
            code, error = _called(parser, options)
    except Exception as fault:  # the program's own; its traceback follows
        outcome.close(EXIT_ERROR, f"{type(fault).__name__}: {one_line(str(fault))}")
        raise
    if error:
        print(f"towline: {'' if code == EXIT_INTERRUPTED else 'error: '}{error}", file=sys.stderr)
    outcome.close(code, error)
    return code


def _called(parser: argparse.ArgumentParser, options: argparse.Namespace) -> tuple[int, str | None]:
    """Exit code, and, where the command did not end well, why."""
    if options.command is None:
        parser.print_help()
        return EXIT_USAGE, "a command is expected" if options.json else None
    try:
        return _without_faults(options)
    except ModuleNotFoundError as error:
        if options.debug or error.name is None or error.name.startswith("towline"):
            raise
        return EXIT_ERROR, f"the package {error.name} is missing; towline doctor says what is needed"
    except ImportError as error:
        if options.debug:
            raise
        return EXIT_ERROR, f"a package cannot be loaded: {one_line(str(_first_cause(error)))[:LONGEST]}"
    except (MemoryError, SystemError) as error:  # the second is what a library makes of the first
        if options.debug:
            raise
        return EXIT_ERROR, no_memory(error)
    except OSError as error:
        if options.debug or (error.filename is None and error.errno in (errno.ENOSPC, errno.EPIPE)):
            raise  # what is written to a file has its name: this is standard output
        place = f"{error.filename}: " if error.filename else ""
        return EXIT_ERROR, f"{place}{error.strerror or error}"
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED, INTERRUPTED


def _first_cause(error: BaseException) -> BaseException:
    return error if error.__cause__ is None else _first_cause(error.__cause__)


def _without_faults(options: argparse.Namespace) -> tuple[int, str | None]:
    """Call the command; faults of its input become one line."""
    if options.light:
        return options.call(options), None
    short = too_little()
    if short is not None:
        return EXIT_ERROR, short
    reserve()
    from .progress import loading

    with loading("record"):
        from .record.errors import TowlineError

    try:
        return options.call(options), None
    except TowlineError as error:
        if options.debug:
            raise
        return EXIT_ERROR, one_line(str(error))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="towline",
        description="From a camera recording of a towed ship model to its hydrodynamic derivatives.",
        epilog="Exit codes: 0 done, 1 error, 2 wrong usage, 3 done but some runs failed, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=f"towline {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.add_argument("--json", action="store_true", help=JSON_HELP)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")

    def command(name: str, call: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help=JSON_HELP)
        sub.set_defaults(call=call, light=False)
        return sub

    sub = command("run", _run, "everything: video to tracks, motion, derivatives or steady state, and an HTML page")
    _add_runs(sub)
    _add_method(sub)
    _add_fit(sub)
    sub.add_argument("-o", "--out", type=Path, help="where results go (default: RUN/out, or out/ beside several runs)")
    sub.add_argument("--fresh", action="store_true", help="redo stages whose results are up to date")

    sub = command(
        "track",
        _track,
        "video to pixel tracks (out/tracks.csv), an overlay video (out/overlay.mp4) and the worst frames (out/worst.png)",
    )
    _add_runs(sub)
    sub.add_argument("--no-overlay", action="store_true", help="write neither out/overlay.mp4 nor out/worst.png")
    sub.add_argument("--sheet", action="store_true", help="write out/worst.png also with --no-overlay")
    sub.add_argument("--follow", action="store_true", help="say how it goes: frames per second, frames done, losses")
    sub.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where the fits run (default: cpu)")
    sub.add_argument("--fresh", action="store_true", help="track again even if the tracks are up to date")

    sub = command(
        "motion", _motion, "tracks to metres (out/marks.csv), motion (out/motion.csv) and camera (out/camera.json)"
    )
    _add_runs(sub)
    _add_method(sub)

    sub = command("identify", _identify, "joint fit of the six linear derivatives over all runs (out/derivatives.json)")
    _add_runs(sub)
    _add_method(sub)
    _add_fit(sub)
    sub.add_argument(
        "--reference",
        metavar="ittc|southampton|FILE.csv",
        help="compare with a reference set of primes, as towline compare",
    )
    sub.add_argument("--no-page", action="store_true", help="write no HTML page")
    sub.add_argument("-o", "--out", type=Path, help="where derivatives.json and derivatives.html go (default: RUN/out)")

    sub = command("steady", _steady, "neutral point X_v from steady tows at two or more tow points (out/steady.json)")
    _add_runs(sub)
    _add_method(sub)
    add_line(sub)
    sub.add_argument("-o", "--out", type=Path, help="where steady.json goes")

    sub = command("simulate", _simulate, "scenario.toml to motion.csv and the tow's stability verdict")
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    sub.add_argument(
        "-o", "--out", type=Path, help="the motion table, .csv or .parquet (default: motion.csv beside it)"
    )
    add_line(sub)

    sub = command("render", _render, "scenario.toml to a filmed run: video, run.toml and its truth")
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    sub.add_argument("-o", "--out", type=Path, required=True, metavar="RUN", help="the run folder to write")
    add_line(sub)

    from .commands import modules

    for module in modules():
        sub = command(module.NAME, module.call, module.HELP)
        sub.set_defaults(light=getattr(module, "LIGHT", False))
        module.add_arguments(sub)
    return parser


def _add_runs(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folder (with a run.toml)")


def _add_method(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--method",
        choices=("exact", "trapezoid", "trapezoid_corners"),
        default="exact",
        help="exact plane at each marker's depth (default), the thesis's trapezoid with its deck-height shift (4.2), or "
        "the trapezoid with its corners moved down",
    )


def add_line(sub: argparse.ArgumentParser) -> None:
    """--line, of every command that takes a tow's forces."""
    sub.add_argument(
        "--line",
        choices=("surge", "constant"),
        help="what the tow line keeps, instead of what tow.line says: its length (surge in full) or its tension",
    )


def _add_fit(sub: argparse.ArgumentParser) -> None:
    add_line(sub)
    sub.add_argument(
        "--form",
        choices=("full", "linear"),
        default="full",
        help="full sine and kinematics (default) or the linear model",
    )
    sub.add_argument(
        "--speed", type=float, metavar="M_S", help="quote the derivatives at this speed (default: the runs' mean)"
    )
    sub.add_argument("--priors", type=Path, metavar="PRIORS.toml", help="priors instead of each run.toml's own")
    sub.add_argument(
        "--noise",
        choices=("auto", "output", "innovations"),
        default="auto",
        help="output error, a Kalman filter's innovations (a force pushes the hull about), or whichever the residuals show "
        "(default: auto)",
    )


# progress and printing -------------------------------------------------------------------------------------------


def _console() -> Any:
    from rich.console import Console

    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=PIPE_WIDTH)


def show_progress(follow: bool = False) -> AbstractContextManager[Callable[[str, int, int | None], None]]:
    """A progress line on the terminal; silent where the output is not one, unless it is to be followed."""
    from .progress import progress

    return progress(follow)


def _notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {note}")


def _batch(options: argparse.Namespace, fresh: bool = False):
    from .analysis import moved_batch
    from .record.errors import TowlineError

    with show_progress() as show:
        batch = moved_batch(options.runs, options.method, show, fresh, getattr(options, "line", None))
    if not batch.runs:
        if len(batch.failed) == 1:
            raise TowlineError(next(iter(batch.failed.values())))
        options.outcome.fail(batch.failed)
        raise TowlineError("no run could be used")
    return batch


def _code(failed: dict[str, str]) -> int:
    return EXIT_SOME_FAILED if failed else EXIT_OK


# commands --------------------------------------------------------------------------------------------------------


def _simulate(options: argparse.Namespace) -> int:
    from .record.tables import write_table
    from .simulate import read_scenario, scenario_stability, simulate_scenario

    file = read_scenario(options.scenario, options.line)
    changed: Callable[..., Any] | None = None
    if file.effect:
        from .diagnose.simulated import effects_of, with_effects

        effects = effects_of(file, options.scenario)
        changed = lambda hull, tow: with_effects(hull, tow, effects, file)  # noqa: E731
    motion = simulate_scenario(file, options.scenario.parent, changed)
    target = options.out or options.scenario.parent / "motion.csv"
    write_table(target, motion)
    verdict = scenario_stability(file)
    if verdict is not None:
        options.outcome.result["stability"] = verdict
        print(f"tow {verdict.sentence}")
        print("roots 1/s: " + ", ".join(f"{root:.4f}" for root in verdict.roots))
    duration_s = motion["t_s"].iloc[-1]
    options.outcome.result |= {"samples": len(motion), "duration_s": duration_s}
    options.outcome.wrote(target, more=f": {len(motion)} samples, {duration_s:.2f} s")
    return EXIT_OK


def _render(options: argparse.Namespace) -> int:
    from .simulate import read_scenario
    from .simulate.render import render_scenario

    file = read_scenario(options.scenario, options.line)
    with show_progress() as show:
        render_scenario(
            file, options.scenario.parent, options.out, lambda done, total: show(f"{file.name}: rendering", done, total)
        )
    options.outcome.result["name"] = file.name
    options.outcome.wrote(options.out)
    return EXIT_OK


def _track(options: argparse.Namespace) -> int:
    from .progress import loading
    from .record.errors import TowlineError

    with loading("stages"):
        import av  # noqa: F401

        from . import stages
        from .record.run import read_run
    failed: dict[str, str] = {}
    overlay, sheet = not options.no_overlay, options.sheet or not options.no_overlay
    for folder in options.runs:
        try:
            run = read_run(folder)
            filmed = run.file.source.video is not None
            with show_progress(options.follow) as show:
                found = stages.tracked(run, show, options.fresh, options.device)
                drawn = stages.draw(found, overlay, sheet, show) if filmed else []
        except TowlineError as error:
            if len(options.runs) == 1:
                raise
            failed[str(folder)] = str(error)
            continue
        options.outcome.result[run.name] = {"markers": _markers_seen(found.table), "notes": found.notes}
        print(f"{run.name}: {_seen(found.table)}")
        _notes(found.notes)
        if filmed:
            wanted = {"tracks.csv": True, "overlay.mp4": overlay, "worst.png": sheet}
            _say_written(options.outcome, run.out, wanted, found.anew, drawn)
    options.outcome.fail(failed)
    return _code(failed)


def _say_written(outcome: Outcome, out: Path, wanted: dict[str, bool], anew: bool, drawn: Sequence[Path]) -> None:
    """Which files were written, and which were up to date."""
    paths = [out / name for name, asked in wanted.items() if asked]
    made = [path for path in paths if path in drawn or (anew and path.name == "tracks.csv")]
    outcome.wrote(*made)
    if kept := [path for path in paths if path not in made]:
        print("up to date: " + ", ".join(map(str, kept)))


def _markers_seen(table: Any) -> list[dict[str, Any]]:
    return [_marker_seen(str(marker), rows) for marker, rows in table.groupby("marker", sort=False)]


def _seen(table: Any) -> str:
    return "; ".join(map(_seen_words, _markers_seen(table)))


def _marker_seen(marker: str, rows: Any) -> dict[str, Any]:
    """How often and how well a marker was measured, and why not."""
    lost = rows[rows["status"] == "lost"]
    reasons = lost["reason"] if "reason" in rows else []
    return {
        "marker": marker,
        "frames": len(rows),
        "measured": int((rows["status"] == "measured").sum()),
        "sigma_px": rows[["sigma_u_px", "sigma_v_px"]].median().mean(),
        "lost": dict(
            Counter(why if isinstance(why, str) and why else "no reason given" for why in reasons).most_common()
        ),
    }


def _seen_words(seen: dict[str, Any]) -> str:
    """In words: "lost: 20 covered, 14 brightness"."""
    text = f"{seen['marker']} measured in {100 * seen['measured'] / seen['frames']:.2f} % of {seen['frames']} frames"
    if not math.isnan(seen["sigma_px"]):
        text += f" (sigma {seen['sigma_px']:.3f} px)"
    if seen["lost"]:
        text += "; lost: " + ", ".join(f"{count} {reason}" for reason, count in seen["lost"].items())
    return text


def _motion(options: argparse.Namespace) -> int:
    batch = _batch(options)
    for m in batch.runs:
        options.outcome.result[m.run.name] = _motion_found(m)
        print(f"{m.run.name}: {_motion_line(m)}")
        if m.camera is not None:
            _notes(m.camera.notes)
            options.outcome.wrote(*(m.run.out / name for name in ("marks.csv", "motion.csv", "camera.json")))
    options.outcome.fail(batch.failed)
    return _code(batch.failed)


def _motion_found(m: Any) -> dict[str, Any]:
    good = m.motion["status"] == "measured"
    first_s, last_s = m.motion["t_s"].iloc[0], m.motion["t_s"].iloc[-1]
    return {"frames": len(m.motion), "measured": int(good.sum()), "duration_s": last_s - first_s, "camera": m.camera}


def _motion_line(m: Any) -> str:
    motion = m.motion
    good = motion["status"] == "measured"
    text = f"{int(good.sum())} of {len(motion)} frames, {motion['t_s'].iloc[-1] - motion['t_s'].iloc[0]:.1f} s"
    if m.camera is not None:
        rows = motion[good]
        frame, common = (1e3 * rows[f"{kind}_y_cg_m"].median() for kind in ("sigma", "common"))
        text += f"; y_CG +- {frame:.2f} mm frame to frame, {common:.2f} mm common"
        text += f"; camera {m.camera.method}, datum {m.camera.rms_px:.2f} px rms"
        for name, value in m.camera.invariants.items():
            text += f"; {name} off by {1e3 * value.value:+.1f} mm (scatter {1e3 * value.std:.1f})"
    return text


def _truth_lines(runs: Sequence[Any]) -> dict[str, Any]:
    """Say how far the motion lies from the truth, of those runs that carry it."""
    from .diagnose import motion_error
    from .stages import truth_motion

    errors: dict[str, Any] = {}
    for m in runs:
        truth = truth_motion(m.run)
        if truth is None:
            continue
        error = errors[m.run.name] = motion_error(m.motion, truth)
        alpha = f", alpha {error.alpha_deg:.4f} deg" if not math.isnan(error.alpha_deg) else ""
        print(
            f"{m.run.name}: against its truth: y_CG {1e3 * error.y_cg_m:.2f} mm, beta {error.beta_deg:.4f} deg{alpha} rms"
        )
    return errors


def _identify(options: argparse.Namespace) -> int:
    from .analysis import by_line, output_folder
    from .identify.reference import compare_to_reference, comparison_lines, reference_set

    reference = None if options.reference is None else reference_set(options.reference)
    batch, free = by_line(_batch(options))
    out = options.out or output_folder(options.runs)
    if not batch.runs:
        return _identify_free(options, free, out)
    answer = _fit_and_write(options, batch, out)
    compared = None
    if reference is not None:
        from .report.format import SYMBOLS_TEXT

        compared = compare_to_reference(answer.result, reference)
        options.outcome.result["comparison"] = compared
        print("\n".join(comparison_lines(compared, SYMBOLS_TEXT)))
        _notes(compared.notes)
    if not options.no_page:
        from .analysis import fit_page
        from .report.identify_page import write_identify_page

        with show_progress() as show:
            shown = fit_page(answer, compared, lambda text: show(text, 0, None))
        page = out / "derivatives.html"
        write_identify_page(page, shown)
        options.outcome.wrote(page, word="page:")
    options.outcome.fail(answer.result.failed)
    code = _code(answer.result.failed)
    return max(code, _identify_free(options, free, out, answer)) if free.runs else code


def _identify_free(options: argparse.Namespace, batch: Any, out: Path, towed: Any = None) -> int:
    """Free runs: on their own as derivatives.json, beside tows as free_run.json."""
    answer = _fit_free_and_write(options, batch, out, towed)
    if not options.no_page:
        from .report import write_page
        from .stages import run_page

        page = out / ("derivatives.html" if towed is None else "free_run.html")
        pages = [run_page(m, answer.fitted[m.run.name], None) for m in answer.runs]
        write_page(page, f"Free runs: {', '.join(answer.fitted)}", pages, answer.result, None, [])
        options.outcome.wrote(page, word="page:")
    options.outcome.fail(answer.result.failed)
    return _code(answer.result.failed)


def _fit_free_and_write(options: argparse.Namespace, batch: Any, out: Path, towed: Any = None) -> Any:
    from .analysis import identified_free
    from .record.errors import TowlineError
    from .record.results import write_result
    from .report import derivatives_table
    from .stages import read_priors

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
        answer = identified_free(batch, options.speed, priors, towed)
    name = "derivatives" if towed is None else "free_run"
    write_result(out / f"{name}.json", answer.result)
    if towed is not None:
        with_tows = answer.result.free is not None and answer.result.free.scale == "tows"
        how = "with the tows' derivatives and their covariance" if with_tows else "by themselves"
        print(f"the free runs ({', '.join(answer.fitted)}) were fitted apart, {how}")
    _console().print(derivatives_table(answer.result))
    _notes([*answer.result.not_identifiable, *answer.result.notes])
    options.outcome.result[name] = answer.result
    options.outcome.wrote(out / f"{name}.json")
    return answer


def _fit_and_write(options: argparse.Namespace, batch: Any, out: Path) -> Any:
    from .analysis import identified
    from .record.results import write_result
    from .report import derivatives_table
    from .stages import read_priors

    priors = None if options.priors is None else read_priors(options.priors)
    with show_progress() as show:
        answer = identified(batch, options.form, options.speed, priors, lambda text: show(text, 0, None), options.noise)
    write_result(out / "derivatives.json", answer.result)
    _console().print(derivatives_table(answer.result))
    _notes([*answer.result.not_identifiable, *answer.result.notes])
    options.outcome.result["derivatives"] = answer.result
    options.outcome.wrote(out / "derivatives.json")
    return answer


def _steady(options: argparse.Namespace) -> int:
    from .analysis import output_folder

    batch = _batch(options)
    result = _steady_and_write(options, batch, options.out or output_folder(options.runs))
    options.outcome.fail(result.failed)
    return _code(result.failed)


def _steady_and_write(options: argparse.Namespace, batch: Any, out: Path) -> Any:
    from .analysis import steadied
    from .record.results import write_result
    from .report import steady_table

    result = steadied(batch)
    write_result(out / "steady.json", result)
    _console().print(steady_table(result))
    _notes(result.notes)
    options.outcome.result["steady"] = result
    options.outcome.wrote(out / "steady.json")
    return result


def _run(options: argparse.Namespace) -> int:
    from .analysis import Batch, good_for, has_rudder, has_tension, output_folder
    from .record.errors import TowlineError
    from .report import write_page
    from .stages import run_page

    batch = _batch(options, options.fresh)
    out = options.out or output_folder(options.runs)
    for m in batch.runs:
        print(f"{m.run.name}: {_motion_line(m)}")
    options.outcome.result["runs"] = {m.run.name: _motion_found(m) for m in batch.runs}
    options.outcome.result["against_truth"] = _truth_lines(batch.runs)
    failed = dict(batch.failed)
    problems: list[str] = []
    remarks: list[str] = []
    identified = steady = free = None
    fitted: dict[str, Any] = {}
    kinds = [good_for(m) for m in batch.runs]
    settled = [m for m, good in zip(batch.runs, kinds, strict=True) if "steady" in good]
    tensioned = [m for m, good in zip(batch.runs, kinds, strict=True) if "derivatives" in good]
    if tensioned:
        try:
            identified = _fit_and_write(options, Batch(tensioned, batch.failed), out)
            failed |= identified.result.failed
            fitted = identified.fitted
        except TowlineError as error:
            problems.append(f"no derivatives: {one_line(str(error))}")
    if len({m.run.tow.tow_point_m for m in settled}) > 1:
        try:
            steady = _steady_and_write(options, Batch(settled, batch.failed), out)
            # a tow that is not steady may have served the derivatives
            failed |= {name: why for name, why in steady.failed.items() if name not in fitted}
        except TowlineError as error:
            (remarks if identified is not None else problems).append(f"no neutral point: {one_line(str(error))}")
    elif settled and not tensioned:
        why = "the tows were at rest from their first frame" if has_tension(settled[0]) else "no tension is given"
        problems.append(f"no derivatives: {why}; no neutral point: steady tows at two or more tow points are needed")
    steered = [m for m in batch.runs if has_rudder(m)]
    if steered:
        try:
            alone = len(steered) == len(batch.runs)
            free = _fit_free_and_write(options, Batch(steered, batch.failed if alone else {}), out, identified)
            failed |= free.result.failed
            fitted |= free.fitted
        except TowlineError as error:
            problems.append(f"no derivatives from the free runs: {one_line(str(error))}")
    silent = [m.run.name for m in batch.runs if m.run.file.kind == "free" and not has_rudder(m)]
    if silent:
        remarks.append(
            f"no derivatives from {', '.join(silent)}: a free run gives its motion only, unless [tow] says its speed and its "
            "rudder (tow.rudder or tow.rudder_rad)"
        )
    notes = [*problems, *remarks]
    options.outcome.result |= {"problems": problems, "remarks": remarks}
    for note in notes:
        print(f"towline: {note}", file=sys.stderr)
    pages = [run_page(m, fitted.get(m.run.name), failed.get(m.run.name)) for m in batch.runs]
    page = out / "report.html"
    title = pages[0].name if len(pages) == 1 else f"{out.parent.name}: {len(pages)} runs"
    found = [answer.result for answer in (identified, free) if answer is not None]
    said = [*notes, *(f"{name}: {why}" for name, why in batch.failed.items())]
    write_page(page, title, pages, found[0] if found else None, steady, said, found[1] if found[1:] else None)
    options.outcome.wrote(page, word="page:")
    options.outcome.fail(failed)
    return EXIT_ERROR if problems else _code(failed)
