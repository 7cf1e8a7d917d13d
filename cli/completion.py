"""``towline completion``: what makes a shell complete towline's commands, options and files on the Tab key."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

NAME = "completion"
HELP = "print a script that lets bash, zsh or fish complete commands, options and files"
LIGHT = True
FOLDERS = ("RUN", "FOLDER", "DIR", "OUT")
"""What an argument that is a folder is called."""

_EPILOG = """\
bash: towline completion bash > ~/.local/share/bash-completion/completions/towline
zsh:  towline completion zsh > DIR/_towline, DIR being in $fpath
fish: towline completion fish > ~/.config/fish/completions/towline.fish
"""


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.epilog = _EPILOG
    sub.formatter_class = argparse.RawDescriptionHelpFormatter
    sub.add_argument("shell", choices=("bash", "zsh", "fish"))


def call(options: argparse.Namespace) -> int:
    """Print the script."""
    script = completion_script(options.parser, options.shell)
    options.outcome.result |= {"shell": options.shell, "script": script}
    print(script)
    return 0


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script for ``shell`` (bash, zsh, fish), by shtab; arguments that are paths complete to files."""
    import shtab

    for action in _actions(parser):
        if action.metavar in FOLDERS:
            setattr(action, "complete", shtab.DIRECTORY)  # noqa: B010
        elif action.type is Path or "FILE" in str(action.metavar):
            setattr(action, "complete", shtab.FILE)  # noqa: B010
    return shtab.complete(parser, shell=shell)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                yield from _actions(sub)
