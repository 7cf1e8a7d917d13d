"""Scores of a blind check, each with its 95 % interval (Clopper and Pearson), by strata of how far the truth can be told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .judge import INEXACT, NO_GAP, NONE, TOLD_APART, UNKNOWN, Call, Judged, names_of

STRATA = (("D > 20", TOLD_APART, np.inf), ("D 5-20", 5.0, TOLD_APART), ("D < 5", -np.inf, 5.0))
"""Strata of the true D to the nearest rival: told apart surely, likely, hardly."""
SURE = 0.9
"""A statement with more than this probability counts as sure."""
GROSS = 2.0
"""A gap of this size is one that anybody sees; its shrink is a number with few per cent of noise."""
KEPT = "kept-out forms"
"""Stratum of those whose effect has a form that was kept out while the diagnosis was worked on."""
BINS = 10
"""Of the stated probabilities in the calibration."""
TOWLINE = "towline"


@dataclass(frozen=True)
class Score:
    """One number.

    Attributes
    ----------
    what, stratum, method : of which cases, who
    hits, of : counts; None for a number that is no share
    value : share or number
    low, high : 95 % interval; the value itself where none is known
    unit : of the value
    """

    what: str
    stratum: str
    method: str
    hits: int | None
    of: int
    value: float
    low: float
    high: float
    unit: str = ""


def share(what: str, stratum: str, method: str, hits: Iterable[bool]) -> Score:
    """A share with Clopper and Pearson's interval.

    Parameters
    ----------
    what : that is counted
    stratum : of D
    method : who answered
    hits : right or wrong, one by one
    """
    found = [bool(hit) for hit in hits]
    k, n = sum(found), len(found)
    low, high = interval(k, n)
    return Score(what, stratum, method, k, n, k / n if n else float("nan"), low, high)


def interval(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's interval of k hits of n.

    Parameters
    ----------
    k : hits
    n : of how many
    level : of the interval
    """
    from scipy.stats import beta

    if n == 0:
        return 0.0, 1.0
    tail = (1 - level) / 2
    low = 0.0 if k == 0 else float(beta.ppf(tail, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(1 - tail, k + 1, n - k))
    return low, high


def scores(cases: Sequence[Judged]) -> list[Score]:
    """All scores, the diagnosis's and the baselines'."""
    methods = [TOWLINE, *dict.fromkeys(name for case in cases for name in case.calls)]
    found: list[Score] = []
    for method in methods:
        found += _of_calls(method, cases)
    return found + _of_probabilities(cases)


def said_by(method: str, case: Judged) -> Call:
    """A method's call; no answer where it gave none.

    Parameters
    ----------
    method : who answered
    case : judged
    """
    return case.said if method == TOWLINE else case.calls.get(method, NONE)


def _of_calls(method: str, cases: Sequence[Judged]) -> list[Score]:
    singles = [c for c in cases if c.kind == "effect"]
    found: list[Score] = []

    def rate(what: str, stratum: str, of: Sequence[Judged], hit: Callable[[Judged, Call], bool]) -> None:
        if of:
            found.append(share(what, stratum, method, (hit(c, said_by(method, c)) for c in of)))

    for name, here in _by_distance(singles):
        rate("right within its class", name, here, Judged.in_class)
        rate("right outright", name, here, Judged.right)
        rate("right by name, exact or not", name, here, Judged.named_right)
    nulls = [c for c in cases if c.kind == "null"]
    for name, of in _strata(nulls):
        rate("false alarms", name, of, lambda c, s: s not in (NO_GAP, NONE))
    unknown = [c for c in cases if c.kind == "unknown"]
    rate("rejected", "in no library", unknown, lambda c, s: s == UNKNOWN)
    rate("named as an effect", "in no library", unknown, lambda c, s: s not in (NO_GAP, UNKNOWN, NONE))
    rate("taken for no gap", "in no library", unknown, lambda c, s: s == NO_GAP)
    pairs = [c for c in cases if c.kind == "pair"]
    for name, of in (("pairs", pairs), (f"pairs, {KEPT}", [c for c in pairs if c.kept])):
        rate("both right", name, of, Judged.right)
        rate("both right by name, exact or not", name, of, Judged.named_right)
        rate("one right at least", name, of, lambda c, s: bool(s & c.truth))
    rate("no answer", "all", cases, lambda c, s: s == NONE)
    unmeasured = [c for c in singles if c.nearest is None]
    rate("right outright", "D not known", unmeasured, Judged.right)
    return found


def _of_probabilities(cases: Sequence[Judged]) -> list[Score]:
    """What only the diagnosis gives: probabilities, sets, shrink, time."""
    answered = [c for c in cases if c.said != NONE]
    singles = [c for c in answered if c.kind == "effect"]
    found: list[Score] = []
    for name, here in _by_distance(singles):
        if here:
            found.append(share("truth in the 95 % set", name, TOWLINE, (c.truth in c.set95 for c in here)))
            found.append(_mean("mean size of the set", name, [len(c.set95) for c in here]))
            found.append(share("right within the class it states", name, TOWLINE, (_in_own_class(c) for c in here)))
            named = [c for c in here if c.in_class(c.said)]
            if named:
                found.append(share("in class, called not exact", name, TOWLINE, (INEXACT in c.said for c in named)))
    nulls = [c for c in answered if c.kind == "null"]
    for name, of in (("nulls", nulls), *_strata(nulls)):
        if of:
            sure = (c.said != NO_GAP and c.probability > SURE for c in of)
            found.append(share("false alarms with p > 0.9", name, TOWLINE, sure))
            found.append(share("no gap in the 95 % set", name, TOWLINE, (NO_GAP in c.set95 for c in of)))
    unknown = [c for c in answered if c.kind == "unknown"]
    if unknown:
        wrong = (c.said not in (NO_GAP, UNKNOWN) and c.probability > SURE for c in unknown)
        found.append(share("named wrongly with p > 0.9", "in no library", TOWLINE, wrong))
    shrunk = [c for c in singles if c.clear and c.in_class(c.said) and c.shrink is not None and c.oracle is not None]
    gross = [c for c in shrunk if c.gap >= GROSS]
    of_kept = [c for c in shrunk if c.kept]
    for name, of in (("D > 20", shrunk), ("D > 20, gap >= 2", gross), (f"D > 20, {KEPT}", of_kept)):
        if of:
            found += _shrinks(name, of)
    if answered:
        error, *_ = calibration(answered)
        found.append(Score("expected calibration error", "all", TOWLINE, None, len(answered), error, error, error))
        even = even_calibration(answered)
        found.append(
            Score("calibration error, bins of equal count", "all", TOWLINE, None, len(answered), even, even, even)
        )
        seconds = [c.seconds for c in answered]
        found.append(_mean("seconds a case", "all", seconds, "s"))
        slow = float(np.quantile(seconds, 0.9))
        found.append(
            Score("seconds a case, 90th percentile", "all", TOWLINE, None, len(seconds), slow, slow, slow, "s")
        )
    return found


def _by_distance(singles: Sequence[Judged]) -> list[tuple[str, list[Judged]]]:
    """Those with one effect by how far it can be told; beside each stratum, those of them whose form was kept out."""
    found: list[tuple[str, list[Judged]]] = []
    for name, low, high in STRATA:
        here = [c for c in singles if c.nearest is not None and low < c.nearest <= high]
        found += [(name, here), (f"{name}, {KEPT}", [c for c in here if c.kept])]
    return found


def _strata(nulls: Sequence[Judged]) -> list[tuple[str, list[Judged]]]:
    """Those with nothing but the usual inputs by their noise, and those with one more that is told."""
    found = [(f"nulls, {name}", [c for c in nulls if not c.told and c.coloured is v]) for name, v in COLOURS]
    return [*found, ("nulls, inputs", [c for c in nulls if c.told])]


COLOURS = (("white", False), ("coloured", True))


def _in_own_class(case: Judged) -> bool:
    one = len(names_of(case.said)) == 1
    return case.named_right(case.said) or (one and case.truth <= case.own_class and bool(case.truth))


def _mean(what: str, stratum: str, values: Sequence[float], unit: str = "") -> Score:
    mean = float(np.mean(values))
    half = 1.96 * float(np.std(values)) / max(len(values) ** 0.5, 1.0)
    return Score(what, stratum, TOWLINE, None, len(values), mean, mean - half, mean + half, unit)


def _shrinks(stratum: str, cases: Sequence[Judged]) -> list[Score]:
    off = np.array([abs(float(c.shrink or 0.0) - float(c.oracle or 0.0)) for c in cases])
    rng = np.random.default_rng(0)
    drawn = off[rng.integers(0, len(off), (2000, len(off)))]
    found = []
    for what, q in (("|shrink - oracle|, median", 0.5), ("|shrink - oracle|, 90th percentile", 0.9)):
        low, high = np.quantile(np.quantile(drawn, q, axis=1), [0.025, 0.975])
        value = float(np.quantile(off, q))
        found.append(Score(what, stratum, TOWLINE, None, len(off), value, float(low), float(high)))
    inside = (c.interval is not None and c.interval[0] <= float(c.oracle or 0.0) <= c.interval[1] for c in cases)
    return [*found, share("oracle in the 90 % interval", stratum, TOWLINE, inside)]


@dataclass(frozen=True)
class Bin:
    """Answers of about one probability.

    Attributes
    ----------
    low, high : of the probability
    count, right : answers
    mean : stated probability
    """

    low: float
    high: float
    count: int
    right: int
    mean: float


def calibration(cases: Sequence[Judged]) -> tuple[float, list[Bin]]:
    """Expected calibration error of what was said against being right by name, and the bins of its diagram."""
    edges = np.linspace(0, 1, BINS + 1)
    stated, right = _stated(cases)
    at = np.minimum((stated * BINS).astype(int), BINS - 1)
    bins, error = [], 0.0
    for k in range(BINS):
        here = at == k
        if here.any():
            mean, hits = float(stated[here].mean()), int(right[here].sum())
            bins.append(Bin(float(edges[k]), float(edges[k + 1]), int(here.sum()), hits, mean))
            error += here.mean() * abs(hits / here.sum() - mean)
    return float(error), bins


def even_calibration(cases: Sequence[Judged]) -> float:
    """Expected calibration error with bins that hold equally many answers (within one), in the order of what they state.

    Answers of one stated probability that fall on a bin's edge are shared out as they come in that order.

    Parameters
    ----------
    cases : judged ones, pooled
    """
    stated, right = _stated(cases)
    order = np.argsort(stated, kind="stable")
    parts = np.array_split(order, min(BINS, len(order)))
    return float(sum(len(p) * abs(right[p].mean() - stated[p].mean()) for p in parts) / len(order))


def _stated(cases: Sequence[Judged]) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities of what was said, 0 to 1, and whether it was right by name."""
    stated = np.array([min(max(c.probability, 0.0), 1.0) for c in cases])
    return stated, np.array([c.named_right(c.said) for c in cases])
