"""A hostile file, a bad day, an impatient user: every such way tried against the command line.

    python benchmarks/rough.py [--only WORD ...] [--seed 1] > benchmarks/rough.txt

Each try is a process of its own with a memory limit, in a copy of a folder of its own. *Done*: it ended well (exit code 0 or 3).
*One line*: exit code 1 and one line that names the file (130 and one line where it was interrupted). Anything else is a defect and
is shown: a traceback, a hang (180 s), more words, a process or temporary file left, a crash. Ends with code 1 if there was one.
Linux only.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rough_attacks import Attack, attacks, base_folder

LONGEST_S = 180.0
MEMORY_BYTES = 4 << 30
LEFT_S = 5.0
"""A process whose parent is gone may take so long to end."""
GOOD = ("done", "one line")
_LIMITED = 'ulimit -v "$1"; ulimit -f "$2"; ulimit -c 0; shift 2; exec "$@"'


@dataclass(frozen=True)
class Seen:
    """What came of one try: its outcome, and the words where it is a defect."""

    outcome: str
    words: str = ""


def tried(attack: Attack, base: Path, rng: np.random.Generator) -> Seen:
    """One try in a copy of ``base``."""
    with tempfile.TemporaryDirectory(prefix="rough-") as name:
        folder = Path(shutil.copytree(base, Path(name) / "hall", symlinks=True))
        attack.prepare(folder)
        before = _temporary(folder)
        limit = attack.memory or MEMORY_BYTES
        process = subprocess.Popen(
            [
                "sh",
                "-c",
                _LIMITED,
                "sh",
                str(limit // 1024),
                _blocks(attack),
                sys.executable,
                "-m",
                "towline",
                *attack.command,
            ],
            cwd=folder,
            stdout=subprocess.PIPE if attack.stdout is None else open(attack.stdout, "w"),  # noqa: SIM115
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        try:
            if attack.signals:
                _struck(process, attack, rng)
            said = process.communicate(timeout=LONGEST_S)[1].decode("utf-8", "replace")
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return Seen("hang", " ".join(attack.command))
        left = _left(process.pid)
        return _judged(attack, process.returncode, said, left, _temporary(folder) - before)


def _blocks(attack: Attack) -> str:
    """Of 512 bytes, as the shell counts."""
    return "unlimited" if attack.largest_kib is None else str(2 * attack.largest_kib)


def _struck(process: subprocess.Popen, attack: Attack, rng: np.random.Generator) -> None:
    """Send the signals, the first at a random moment; to all of the session as a terminal does, or to the process alone."""
    until_s = time.monotonic() + rng.uniform(*attack.moments_s)
    while process.poll() is None and time.monotonic() < until_s:
        time.sleep(0.005)
    for number in attack.signals:
        if process.poll() is None:
            if number == signal.SIGINT:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
        time.sleep(0.1)


def _left(session: int) -> str:
    """Processes of the session that do not end soon."""
    until_s = time.monotonic() + LEFT_S
    while True:
        found = [p for p in Path("/proc").glob("[0-9]*/stat") if _session_of(p) == session]
        if not found or time.monotonic() > until_s:
            return ", ".join(p.parent.name for p in found)
        time.sleep(0.05)


def _session_of(stat: Path) -> int | None:
    try:
        state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
    except OSError:
        return None
    return None if state == "Z" else int(session)


def _temporary(folder: Path) -> set[Path]:
    return {Path(at) / name for at, _, names in os.walk(folder) for name in names if ".tmp" in name}


def _judged(attack: Attack, code: int, said: str, left: str, temporary: set[Path]) -> Seen:
    words = f"{' '.join(attack.command)}: exit code {code}: {said.strip()[-1500:]}"
    if left:
        return Seen("process left", f"{words}; {left}")
    if (
        signal.SIGINT not in attack.signals and attack.signals
    ):  # it may leave a temporary file, under a name that nothing reads
        return Seen("done" if code in (0, -attack.signals[0]) else "crash", words)
    if temporary:
        return Seen("half written", f"{words}; {sorted(temporary)}")
    if "Traceback" in said or "Exception ignored" in said:
        return Seen("traceback", words)
    if code < 0 and not attack.signals:
        return Seen("crash", words)
    lines = [line for line in said.splitlines() if not line.startswith("towline: failed: ")]
    if code in (0, 3):
        return Seen("done")
    if attack.signals:  # SIGINT
        # to a shell both are 130; Python ends by the signal where it struck within exec() of a library
        return Seen("one line") if code in (130, -signal.SIGINT) and len(lines) == 1 else Seen("words", words)
    named = not attack.named or any(attack.named in line for line in said.splitlines())
    right = code == 1 and named and len(lines) == 1 and lines[0].startswith("towline: ")
    # of a refused argument argparse says its usage first
    return Seen("one line") if right or (code == 2 and ": error: " in lines[-1]) else Seen("words", words)


@dataclass
class Row:
    """A line of the table."""

    name: str
    seen: Counter = field(default_factory=Counter)
    defects: list[str] = field(default_factory=list)


def table(rows: Sequence[Row]) -> str:
    """The table as Markdown, and what was not held."""
    lines = ["| attack | tries | done | one line | anything else |", "|---|---|---|---|---|"]
    for row in rows:
        other = sum(count for outcome, count in row.seen.items() if outcome not in GOOD)
        lines.append(f"| {row.name} | {row.seen.total()} | {row.seen['done']} | {row.seen['one line']} | {other} |")
    total = sum((row.seen for row in rows), Counter())
    other = sum(count for outcome, count in total.items() if outcome not in GOOD)
    lines.append(f"| all | {total.total()} | {total['done']} | {total['one line']} | {other} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Try, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[], help="attacks whose name holds one of these words")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # in the background of a shell it is ignored, by its children, too
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rows: dict[str, Row] = {}
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="rough-base-") as name:
        base = base_folder(Path(name) / "base")
        for attack in attacks(base):
            if options.only and not any(word in attack.name for word in options.only):
                continue
            row = rows.setdefault(attack.name, Row(attack.name))
            seen = tried(attack, base, rng)
            row.seen[seen.outcome] += 1
            if seen.outcome not in GOOD:
                row.defects.append(f"{seen.outcome}: {seen.words}")
                print(f"{attack.name}: {row.defects[-1]}", file=sys.stderr, flush=True)
    print(table(list(rows.values())))
    print(f"\n{time.monotonic() - begun_s:.0f} s; seed {options.seed}")
    for row in rows.values():
        for defect in row.defects:
            print(f"\n{row.name}: {defect}")
    return int(any(row.defects for row in rows.values()))


if __name__ == "__main__":
    raise SystemExit(main())
