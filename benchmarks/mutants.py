"""How strong are the tests? Random mutants of geometry, identify and diagnose, each against the tests that reach its line.

    pip install cosmic-ray pytest-cov
    python benchmarks/mutants.py OUT [--count 300] [--seed 1] [--workers 2] [--most-s 120]

Mutations are cosmic-ray's (operators, comparisons, numbers, loops, decorators, booleans), drawn evenly over all that could be made,
but for annotations, which nothing evaluates. A coverage run says which tests reach which line, and how long each takes; a mutant
meets them, the shortest first, until one fails or they have taken --most-s. A line that no test reaches in its own process (a
module's constant, work in a worker) meets the shortest tests of its file, or of its room. Tests that killed are run without a
mutation in the end. Started again, it goes on; OUT/mutants.txt is the table, with every survivor.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Thread

from towline.blind.scores import interval
from towline.pipeline.executor.processes import THREADS

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("geometry", "identify", "diagnose")
SLACK_S = 60.0
"""On top of three times what the tests take: a mutant that has not ended by then loops, and is killed."""


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes
    ----------
    file, line : where
    operator, occurrence : cosmic-ray's
    before, after : the line
    """

    file: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str


def copied(to: Path) -> Path:
    """A copy of the project as it stands in git's index and working tree; returns the folder to import from."""
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, check=True
    ).stdout.decode().split("\0")  # fmt: skip
    for name in filter(None, names):
        if (ROOT / name).is_file():
            target = to / "towline" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    if (ROOT.parent / "shared").is_dir():
        (to / "shared").symlink_to(ROOT.parent / "shared")
    return to


def pytest(place: Path, arguments: list[str], timeout_s: float | None = None) -> tuple[int, list[str]]:
    """Exit status of the tests in a copy (124: they did not end), and those that failed."""
    one = dict.fromkeys(THREADS, "1")
    environment = {**os.environ, **one, "PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    report = place / "report.xml"
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}", *arguments]
    process = subprocess.Popen(
        command, cwd=place / "towline", env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        code = process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
        return 124, []
    if not report.is_file():
        return code, []
    return code, [
        name for name, case in cases(report) if case.find("failure") is not None or case.find("error") is not None
    ]


def cases(report: Path) -> Iterator[tuple[str, ElementTree.Element]]:
    """Every test of a report, by its name on the command line; files are told from tests/, where pytest.ini stands."""
    for case in ElementTree.parse(report).iter("testcase"):
        yield f"tests/{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}", case


def reached(out: Path, workers: int) -> tuple[dict[str, list[str]], dict[str, float]]:
    """``file:line`` -> tests that reach it; test -> seconds."""
    kept = out / "reached.json"
    if not kept.is_file():
        place = copied(out / "whole")
        sources = [f"--cov={place / 'towline' / room}" for room in ROOMS]
        settings = place / "coverage.toml"
        settings.write_text(f'[tool.coverage.run]\ndata_file = "{place / "cov"}"\n')
        _, failed = pytest(
            place,
            [
                "tests",
                f"--numprocesses={workers}",
                *sources,
                "--cov-context=test",
                f"--cov-config={settings}",
                "--cov-report=",
            ],
        )
        if failed:
            print(f"fail without a mutation, and are not asked: {', '.join(failed)}", flush=True)
        # a test that failed or was skipped says nothing about a mutant
        times = {name: float(case.attrib["time"]) for name, case in cases(place / "report.xml") if not len(case)}
        lines: dict[str, list[str]] = defaultdict(list)
        for file, test, numbits in sqlite3.connect(place / "cov").execute(
            "select path, context, numbits from line_bits join file on file.id = file_id join context on context.id = context_id"
        ):
            name = f"tests/{test.partition('|')[0]}"
            if name in times:
                for byte, bits in enumerate(numbits):
                    for bit in range(8):
                        if bits >> bit & 1:
                            lines[f"{Path(file).relative_to(place / 'towline')}:{8 * byte + bit}"].append(name)
        kept.write_text(json.dumps([lines, times]))
        shutil.rmtree(place)
    lines, times = json.loads(kept.read_text())
    return lines, times


def possible(file: str) -> Iterator[tuple[str, int, int]]:
    """Operator, occurrence, line of every mutation of a file that could change what it does."""
    import cosmic_ray.plugins
    from cosmic_ray.ast import ast_nodes, get_ast_from_path

    path = ROOT / file
    spans = []
    for node in ast.walk(ast.parse(path.read_text())):
        for one in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if one is not None:
                spans.append(((one.lineno, one.col_offset), (one.end_lineno, one.end_col_offset)))
    tree = get_ast_from_path(path)
    for name in cosmic_ray.plugins.operator_names():
        kind = cosmic_ray.plugins.get_operator(name)
        if kind.arguments():
            continue
        operator = kind()
        places = [place for node in ast_nodes(tree) for place in operator.mutation_positions(node)]
        for occurrence, (start, _) in enumerate(places):
            if not any(first <= start < last for first, last in spans):
                yield name, occurrence, start[0]


def drawn(count: int, seed: int) -> list[Mutant]:
    """Evenly over all mutations of the rooms."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    files = sorted(str(p.relative_to(ROOT)) for room in ROOMS for p in (ROOT / room).rglob("*.py"))
    every = [(file, *one) for file in files for one in possible(file)]
    found = []
    for file, operator, occurrence, line in random.Random(seed).sample(every, len(every)):
        before = (ROOT / file).read_text()
        after = mutate_code(before, get_operator(operator)(), occurrence)
        if after is None or after == before:
            continue
        texts = [
            text.splitlines()[line - 1].strip() if line <= len(text.splitlines()) else "" for text in (before, after)
        ]
        found.append(Mutant(file, line, operator, occurrence, *texts))
        if len(found) == count:
            break
    return found


def judged(mutant: Mutant, place: Path, lines: dict[str, list[str]], times: dict[str, float], most_s: float) -> dict:
    """The tests against a mutant in a copy of the project."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    tests = lines.get(f"{mutant.file}:{mutant.line}", [])
    direct = bool(tests)
    if not direct:
        near = [f"{mutant.file}:", f"{mutant.file.partition('/')[0]}/"]
        every = [{t for key, names in lines.items() if key.startswith(start) for t in names} for start in near]
        tests = sorted(every[0] or every[1])
    chosen, spent = [], 0.0
    for test in sorted(set(tests), key=lambda t: times[t]):
        if chosen and spent + times[test] > most_s:
            break
        chosen.append(test)
        spent += times[test]
    path = place / "towline" / mutant.file
    whole = path.read_text()
    path.write_text(mutate_code(whole, get_operator(mutant.operator)(), mutant.occurrence) or whole)
    try:
        code, failed = pytest(place, ["-x", *chosen], 3 * spent + SLACK_S)
    finally:
        path.write_text(whole)
    return {
        **asdict(mutant),
        "killed": code != 0,
        "code": code,
        "by": [name for name in failed if name in times],
        "tests": len(chosen),
        "of": len(set(tests)),
        "direct": direct,
    }


def unsure(found: list[dict], out: Path) -> list[str]:
    """Tests that killed, and fail in the project as it stands too: their word is void."""
    names = sorted({name for one in found for name in one["by"]})
    if not names:
        return []
    place = copied(out / "as-it-stands")
    try:
        code, failed = pytest(place, names)
    finally:
        shutil.rmtree(place)
    if code not in (0, 1):
        raise SystemExit(f"the tests that killed could not be run without a mutation: pytest ended with {code}")
    return failed


def table(found: list[dict], void: list[str]) -> str:
    """Shares by room, how they died, and the survivors."""
    how = {"a test failed": 0, "no test could start": 0, "did not end": 0}
    for one in found:
        if one["killed"]:
            how["a test failed" if one["by"] else "did not end" if one["code"] == 124 else "no test could start"] += 1
    rows = [
        "killed because: " + ", ".join(f"{what} {count}" for what, count in how.items()),
        f"tests that failed without a mutation too, and killed nothing: {', '.join(void) or 'none'}",
        "",
    ]
    for room in (*ROOMS, ""):
        of = [one for one in found if one["file"].startswith(room)]
        k, n = sum(one["killed"] for one in of), len(of)
        if n:
            low, high = interval(k, n)
            rows.append(f"{room or 'all':10} {k}/{n} = {100 * k / n:.0f} % killed ({100 * low:.0f}-{100 * high:.0f})")
    rows += ["", "survivors"]
    for one in sorted((o for o in found if not o["killed"]), key=lambda o: (o["file"], o["line"])):
        reach = f"{one['tests']} of {one['of']} tests" + ("" if one["direct"] else " near it")
        rows += [f"{one['file']}:{one['line']} ({reach})", f"  - {one['before']}", f"  + {one['after']}"]
    return "\n".join(rows) + "\n"


def main() -> None:
    """Judge what is not judged yet, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--most-s", type=float, default=120.0, help="of tests a mutant")
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    lines, times = reached(out, given.workers)
    plan = out / "plan.json"
    if not plan.is_file():
        plan.write_text(json.dumps([asdict(m) for m in drawn(given.count, given.seed)], indent=1))
    todo = [(k, Mutant(**m)) for k, m in enumerate(json.loads(plan.read_text()))]
    left = [(k, m) for k, m in todo if not (out / f"{k:04d}.json").is_file()][::-1]

    def work(number: int) -> None:
        place = out / f"copy-{number}"
        shutil.rmtree(place, ignore_errors=True)
        copied(place)
        while left:
            k, mutant = left.pop()
            answer = judged(mutant, place, lines, times, given.most_s)
            (out / f"{k:04d}.json").write_text(json.dumps(answer, indent=1))
            print(f"{k}: {'killed' if answer['killed'] else 'SURVIVED'} {mutant.file}:{mutant.line}", flush=True)
        shutil.rmtree(place)

    threads = [Thread(target=work, args=(n,)) for n in range(given.workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = [json.loads((out / f"{k:04d}.json").read_text()) for k, _ in todo]
    void = unsure(found, out)
    found = [{**one, "killed": one["killed"] and not set(void).intersection(one["by"])} for one in found]
    text = table(found, void)
    (out / "mutants.txt").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
