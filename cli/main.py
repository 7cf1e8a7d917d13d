"""The command line: parse, call, print. No computing here, and nothing heavy is imported before it is needed."""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from ..__version__ import __version__
from ..pipeline.executor.memory import reserve, too_little
from ..record.names import lines_joined, take_any_name
from .commands import modules
from .common import EXIT_ERROR, EXIT_INTERRUPTED, EXIT_USAGE
from .outcome import Outcome, no_memory

JSON_HELP = "say the result as one JSON object on standard output, and nothing else there (docs/commands.md)"
LONGEST = 300
"""Letters of what a library says."""
INTERRUPTED = "interrupted; what was finished is kept"


class WrongUsage(SystemExit):
    """The words typed are no command, or not a command's."""

    def __init__(self, command: str, message: str) -> None:
        super().__init__(EXIT_USAGE)
        self.command, self.message = command, message


class Parser(argparse.ArgumentParser):
    """Remembers what was wrong, to be said as JSON as well."""

    def error(self, message: str) -> NoReturn:
        """Print usage and message, and raise ``WrongUsage`` with the message."""
        self.print_usage(sys.stderr)
        print(f"{self.prog}: error: {message}", file=sys.stderr)
        raise WrongUsage(self.prog.partition(" ")[2], message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code (0 done, 1 error, 2 usage, 3 done but some runs failed, 130 interrupted).

    Parameters
    ----------
    arguments : words of the command line; None: those of this process
    """
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
    parser = command_parser()
    try:
        options = parser.parse_args(arguments)
    except WrongUsage as wrong:
        Outcome(wrong.command or None, "--json" in (sys.argv if arguments is None else arguments)).close(
            EXIT_USAGE, wrong.message
        )
        raise
    options.parser = parser
    outcome = options.outcome = Outcome(options.command, options.json)
    try:
        with outcome.speaking():
            code, error = _called(parser, options)
    except Exception as fault:  # the program's own; its traceback follows
        outcome.close(EXIT_ERROR, f"{type(fault).__name__}: {lines_joined(str(fault))}")
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
        return EXIT_ERROR, f"a package cannot be loaded: {lines_joined(str(_first_cause(error)))[:LONGEST]}"
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
    from ..pipeline.progress import loading

    with loading("record"):
        from ..record.errors import TowlineError

    try:
        return options.call(options), None
    except TowlineError as error:
        if options.debug:
            raise
        return EXIT_ERROR, lines_joined(str(error))


def command_parser() -> argparse.ArgumentParser:
    """Of all commands."""
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

    for module in modules():
        sub = command(module.NAME, module.call, module.HELP)
        sub.set_defaults(light=getattr(module, "LIGHT", False))
        module.add_arguments(sub)
    return parser
