"""Gross mistakes of a run.toml, by name, before any statistics.

A set-up in which something is absurd (``ordinary``) is tried without each mistake that people make (``suspects``). What makes it
ordinary is named, with all that do so as well; where nothing is absurd, nothing is tried and nothing is named.
"""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from ...record.run import RUN_FILE, Run
from ...record.schema import RunFile
from ...record.template import left_of_template
from .ordinary import ABSURD, IMPOSSIBLE, ORDINARY, WORDS, Judge, film_of
from .suspects import Suspect, suspects

ALIKE = 9.0
"""Mistakes whose squared numbers, summed, lie within this of the best one's explain the set-up as well: three standard
deviations."""
WORSE = 1.2
"""What is not ordinary may become so much larger while something else is mended: a choice."""
MOST_NAMED = 4
"""So many that explain alike are said: a choice, for a line that can be read."""
MOST_AT_ONCE = 3
"""So many mistakes in one run.toml are looked for, one after the other."""
SEEN = frozenset(
    {"datum", "above", "camera", "marks", "hand", "heading", "ahead", "line", "picture", "lens", "height", "walls"}
)
"""Numbers that come from datum, marks and picture; the others from single keys."""

POINTS = frozenset({"datum", "above", "camera", "picture", "lens"})
"""Numbers that a single datum point, or a picture of another size, makes absurd, where there are points to spare."""
LEAST_POINTS = 5
"""Fewer points have none to spare: one of them that is wrong shows in the marks only."""


@dataclass(frozen=True)
class Mistake:
    """A gross mistake that run.toml seems to hold.

    Attributes
    ----------
    kind : as ``Suspect.kind``; "template", or "unexplained": something cannot be, and no single mistake explains it
    keys : of run.toml that hold it
    text : one line: file, key, value, what it seems to be, what was expected, what is absurd as it stands
    instead : others that explain the set-up as well
    """

    kind: str
    keys: tuple[str, ...]
    text: str
    instead: tuple[Mistake, ...] = ()

    @property
    def line(self) -> str:
        """The one line, with those that explain the set-up as well."""
        also = [m.text.partition(": ")[2] for m in self.instead[: MOST_NAMED - 1]]
        more = len(self.instead) - len(also)
        also += [f"{more} more"] if more else []
        return self.text + "".join(f"; or else {other}" for other in also)


def find_mistakes(
    run: Run,
    tracks: pd.DataFrame | None,
    size_px: tuple[int, int] | None = None,
    tension_n: float | None = None,
    rudder_rad: float | None = None,
) -> tuple[Mistake, ...]:
    """Gross mistakes of a set-up; empty where it is an ordinary one.

    Parameters
    ----------
    run : the run folder as read
    tracks : as ``record.read_tracks`` gives; None: not tracked yet, then less can be told
    size_px : width and height of its video's picture, where it has one
    tension_n : mean of its load cell's history, where it has one
    rudder_rad : largest angle of its rudder's history, where it has one
    """
    path = run.folder / RUN_FILE
    left = left_of_template(run.file, size_px)
    if left is not None:
        key, words = left
        return (Mistake("template", (key,), f"{path}: {key}: {words}"),)
    file = _with_histories(run.file, tension_n, rudder_rad)
    judge = Judge(run, film_of(run, tracks, size_px))
    found: list[Mistake] = []
    for _ in range(MOST_AT_ONCE):
        stated = judge.numbers(file) or {}
        absurd = {name for name, value in stated.items() if value >= ABSURD}
        if not absurd:
            break
        best = _explained(judge, file, stated, absurd)
        if not best:
            impossible = {name for name in absurd if stated[name] >= IMPOSSIBLE}
            if impossible and not found:
                words = f"{path}: {_said(impossible, file)}, and no single mistake explains it: check datum, marks and lengths"
                found.append(Mistake("unexplained", (), words))
            break
        named = [_mistake(str(path), some, mended, file) for some, mended in _by_key(best)]
        found.append(Mistake(named[0].kind, named[0].keys, named[0].text, tuple(named[1:])))
        file = best[0][0].without(file)
    return tuple(found)


def _with_histories(file: RunFile, tension_n: float | None, rudder_rad: float | None) -> RunFile:
    """A load cell's mean and a rudder's largest angle where a number of run.toml would stand."""
    if file.tow is None:
        return file
    update = {"tension_n": tension_n, "rudder_rad": rudder_rad}
    return file.model_copy(
        update={"tow": file.tow.model_copy(update={k: v for k, v in update.items() if v is not None})}
    )


def _explained(
    judge: Judge, file: RunFile, stated: dict[str, float], absurd: set[str]
) -> list[tuple[Suspect, frozenset[str]]]:
    """Mistakes without which most of what is absurd is ordinary, the best first, each with what it mends."""
    tried: list[tuple[Suspect, frozenset[str], float]] = []
    known = {repr(file)}
    most = {name: max(ORDINARY, WORSE * value) for name, value in stated.items()}
    seen = bool(absurd & SEEN) or any(name.startswith("marker") for name in absurd)
    points = bool(absurd & POINTS) or len(file.datum) < LEAST_POINTS
    for suspect in suspects(file, judge.film.size_px, seen, points):
        without = suspect.without(file)
        if repr(without) in known:
            continue
        known.add(repr(without))
        numbers = judge.numbers(without, most)
        if numbers is None:
            continue
        mended = frozenset(n for n in absurd if numbers.get(n, IMPOSSIBLE) < ORDINARY)
        if mended:
            tried.append(
                (suspect, mended, float(sum(v * v for n, v in numbers.items() if n in mended or n not in absurd)))
            )
    largest = max((len(mended) for _, mended, _ in tried), default=0)
    whole = sorted((one for one in tried if len(one[1]) == largest), key=lambda one: one[2])
    return [(suspect, mended) for suspect, mended, total in whole if total < whole[0][2] + ALIKE]


def _by_key(best: list[tuple[Suspect, frozenset[str]]]) -> list[tuple[list[Suspect], frozenset[str]]]:
    """Units of one key that explain alike (a beam in mm, cm or inches) are one mistake."""
    found: dict[tuple[object, ...], tuple[list[Suspect], frozenset[str]]] = {}
    for number, (suspect, mended) in enumerate(best):
        alike = (suspect.keys, suspect.unit is not None or number)
        found.setdefault(alike, ([], mended))[0].append(suspect)
    return list(found.values())


def _mistake(path: str, some: list[Suspect], mended: frozenset[str], file: RunFile) -> Mistake:
    suspect = some[0]
    keys = " and ".join(suspect.keys) if len(suspect.keys) < 3 else ", ".join(suspect.keys)
    value = f" = {suspect.stated}" if suspect.stated else ""
    words = suspect.words
    if suspect.unit is not None and len(some) > 1:
        words = words.replace(suspect.unit, " or ".join(one.unit for one in some if one.unit), 1)
    return Mistake(suspect.kind, suspect.keys, f"{path}: {keys}{value}: {words} (as it stands {_said(mended, file)})")


def _said(absurd: frozenset[str] | set[str], file: RunFile) -> str:
    """What is absurd, in words."""
    said = [WORDS[name] for name in WORDS if name in absurd]
    keys = sorted(name for name in absurd if name not in WORDS)
    if keys:
        size = f"for a model of {file.model.length_pp_m:g} m" if file.model is not None else "for a towed model"
        said.append(f"{' and '.join(keys)} would be out of all bounds {size}")
    return ", ".join(said[:3])


__all__ = ["Mistake", "find_mistakes"]
