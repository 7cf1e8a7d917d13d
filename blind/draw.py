"""Draws the cases of a blind check: which effects, of which forms, how faint. Nothing is chosen later."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import root_scalar

from ..pipeline.executor.processes import in_parallel
from ..record.errors import EstimationError
from .one_case import case_of, ranges_of, told
from .progress import Progress, counted
from .truth.cases import LONG_S, Case, lane_of
from .truth.forms import FORMS, KEEP_SEED, allowed, form_of, kept_out
from .truth.motion import STEP_S, B, X, Y, swim
from .truth.sizes import EFFECTS, OUTSIDE, TOLD

NULLS, UNKNOWN, PAIRS = 0.25, 0.15, 0.10
"""Shares of the cases with nothing, with something in no library, with two effects; the rest hold one effect."""
FAINT = 0.3
"""Share of the cases with one effect whose size is not that of a tank but near the limit of what can be told."""
FAINT_D, FAINT_OUTSIDE_D = (2.0, 300.0), (30.0, 3000.0)
"""Ranges of D (logarithmically even) to which a faint effect, of the library or outside it, is made smaller."""
SOFTER, HANGING_M_N = 3.0, 0.01
"""A soft line gives so many times as much as a taut one at the least: one that stiffens by the cube is then no stiffer, and rings
no faster than ``signature``'s step can follow; one that hangs may be made as much smaller as one of the second."""
SIZE_TO, TINY_D = 0.02, 1e-6
"""Relative, to which its size is searched for; no D is less than the second."""
PULLED = {"tension_variation", "constant_tension"}
"""Something else than the line's length holds T: no two of these, and no stretch or slack beside one, make a pair."""
SLACK = "slack_line"
HELD = {"elastic_line", SLACK}
LARGEST_SINE, LARGEST_HEADING = 0.55, 0.4
"""Of the line's angle, and rad: a tow that swings further is none that a tank would keep."""
HARDER, HARDER_TIMES = 1.2, 8
"""What slackens a line is made so much stronger, so often at most, where it does not: a model that swings is pulled harder."""
LARGEST_DRIFT = 0.35
"""Of the line's length, ahead or astern, where the line pays out: a model that drifts further is towed over."""


@dataclass(frozen=True)
class Wanted:
    """What to draw.

    Attributes
    ----------
    cases, seed : how many, and the seed of everything
    nulls : cases with nothing (None: a quarter)
    video : how many of them are filmed
    only : effects to draw from (empty: all)
    unknown, pairs : their shares
    told : how many of the nulls have an input that run.toml tells
    forms : of ``truth.forms.CHOICES``, in which forms effects come
    keep_seed : draws the forms that are kept out
    """

    cases: int
    seed: int
    nulls: int | None = None
    video: int = 0
    only: tuple[str, ...] = ()
    unknown: float = UNKNOWN
    pairs: float = PAIRS
    told: int = 0
    forms: str = "all"
    keep_seed: int = KEEP_SEED


@dataclass(frozen=True)
class Dealt:
    """What a case will be: arguments of ``case_of``, whether its size is to be cut down to a faint one, what
    input it is told, the forms of its effects, and which effects have one that is kept out."""

    name: str
    kind: str
    effects: list[str]
    seed: list[int]
    coloured: bool | None
    video: bool
    faint: bool
    told: str = ""
    form: tuple[tuple[str, str], ...] = ()
    kept: tuple[str, ...] = ()


def dealt(wanted: Wanted) -> list[Dealt]:
    """The kinds of the cases, in an order that tells nothing."""
    rng = np.random.default_rng([wanted.seed, 77])
    n = wanted.cases
    nulls = round(NULLS * n) if wanted.nulls is None else min(wanted.nulls, n)
    unknown = round(wanted.unknown * (n - nulls) / (1 - NULLS)) if not wanted.only else 0
    pairs = round(wanted.pairs * (n - nulls) / (1 - NULLS)) if not wanted.only else 0
    singles = n - nulls - unknown - pairs
    names = list(wanted.only or EFFECTS)
    kinds: list[tuple[str, list[str]]] = [("null", [])] * nulls
    kinds += [("unknown", [name]) for name in _dealt(list(OUTSIDE), unknown, rng)]
    kinds += [("pair", _pair(rng)) for _ in range(pairs)]
    kinds += [("effect", [name]) for name in _dealt(names, singles, rng)]
    order = rng.permutation(n)
    filmed = set(rng.permutation(n)[: wanted.video].tolist())
    # nulls alternate between white and coloured, so that neither goes short
    colours = {int(k): bool(i % 2) for i, k in enumerate(k for k in order if kinds[k][0] == "null")}
    inputs = dict(zip(colours, _dealt(list(TOLD), min(wanted.told, len(colours)), rng), strict=False))
    width = max(3, len(str(n)))
    faint = np.random.default_rng([wanted.seed, 78]).random(n) < FAINT
    forms = [_formed(wanted, kinds[k][1], [wanted.seed, i]) for i, k in enumerate(order)]
    kept = kept_out(wanted.keep_seed)
    return [
        Dealt(
            f"case-{i + 1:0{width}d}",
            kinds[k][0],
            kinds[k][1],
            [wanted.seed, i],
            colours.get(int(k)),
            i in filmed,
            bool(faint[i]) and kinds[k][0] in ("effect", "unknown"),
            inputs.get(int(k), ""),
            tuple(forms[i].items()),
            tuple(effect for effect, form in forms[i].items() if form in kept.get(effect, [])),
        )
        for i, k in enumerate(order)
    ]


def _formed(wanted: Wanted, effects: list[str], seed: list[int]) -> dict[str, str]:
    """Forms of a case's effects, by a seed of the case's own: drawn beside everything else, which stays as it is."""
    rng = np.random.default_rng([*seed, 11])
    found: dict[str, str] = {}
    for effect in effects:
        if effect in FORMS:
            forms = allowed(effect, wanted.forms, wanted.keep_seed)
            found[effect] = forms[int(rng.integers(len(forms)))]
    return found


def drawn(wanted: Wanted, workers: int = 1, progress: Progress | None = None) -> list[Case]:
    """The cases.

    Parameters
    ----------
    wanted : what the check is to hold
    workers : processes
    progress : is told (what, done, of how many)
    """
    todo = dealt(wanted)
    made = in_parallel(_drawn, [(each,) for each in todo], workers)
    found = {case.name: case for case in counted(made, "drawing campaigns", len(todo), progress)}
    return [found[each.name] for each in todo]


def _drawn(each: Dealt) -> Case:
    case = case_of(each.name, each.kind, each.effects, each.seed, each.coloured, each.video, dict(each.form))
    case = replace(case, kept=list(each.kept))
    if each.told:
        case = told(case, each.told, np.random.default_rng([*each.seed, 7]))
    case = slackened(gentle(case))
    return fainter(case, np.random.default_rng([*each.seed, 6])) if each.faint else case


def fainter(case: Case, rng: np.random.Generator) -> Case:
    """The case with its effect made so small that D, to its nearest rival, is drawn logarithmically even from ``FAINT_D``.

    Effects that are no matter of size (a slack line), and those that are smaller already, stay. D goes with the square of a size;
    a soft line's, which is no straight line from none, is searched for, and it stays softer than a taut one.

    Parameters
    ----------
    case : as drawn
    rng : that draws
    """
    from .signature import STRENGTH, WHOLE, distances_of, linear

    (effect,) = case.effects
    low, high = FAINT_D if case.kind == "effect" else FAINT_OUTSIDE_D
    target = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    keys = {f"{effect}.{name}" for name in STRENGTH[effect]}
    if not keys:
        return case

    def sized(log_by: float) -> Case:
        return replace(case, numbers=_scaled(case.numbers, keys, float(np.exp(log_by))))

    @cache  # the search begins at both ends, which are known by then
    def beyond(log_by: float) -> float:
        made = sized(log_by)
        return float(np.log(max(distances_of(made, linear(made)).nearest, TINY_D) / target))

    over = beyond(0.0)
    if over <= 0:
        return case
    if effect not in WHOLE:
        return sized(-over / 2)
    drawn_m_n = case.numbers.get(f"{effect}.compliance_m_n", HANGING_M_N)
    least = float(np.log(SOFTER / case.hull["stiffness_n_m"] / drawn_m_n))
    if least >= 0 or beyond(least) >= 0:
        return sized(min(least, 0.0))
    return sized(root_scalar(beyond, bracket=(least, 0.0), xtol=SIZE_TO).root)


def gentle(case: Case) -> Case:
    """Releases made smaller where a tow would swing too far; what still does has its numbers made smaller, too."""
    n = len(case.runs)
    for turn in range(12):
        # with the effects and without: a simulator that lacks them must be able to follow, too
        lanes = [lane_of(case, i, effects) for effects in (True, False) for i in range(n)]
        with np.errstate(all="ignore"):
            path = swim(lanes, case.duration_s + LONG_S, None, 2 * STEP_S)
            point, line = (np.array([lane[name] for lane in lanes]) for name in ("x_t", "line"))
            heading = path.states[:, B]
            aside, behind = path.states[:, Y] + point * np.sin(heading), path.states[:, X] + point * np.cos(heading)
            length = np.hypot(aside, behind)
            swing, drift = np.abs(aside / length).max(axis=0), np.abs(length / line - 1).max(axis=0)
        calm = (swing < LARGEST_SINE) & (np.abs(heading).max(axis=0) < LARGEST_HEADING) & (drift < LARGEST_DRIFT)
        wild = ~(calm[:n] & calm[n:])
        if not wild.any():
            return case
        runs = [
            replace(
                run, stated={k: v * (0.7 if bad and k in ("y_m", "beta_rad") else 1) for k, v in run.stated.items()}
            )
            for run, bad in zip(case.runs, wild, strict=True)
        ]
        numbers = case.numbers
        if turn > 3:
            sized = {f"{effect}.{name}" for effect in case.effects for name in _sizes(case, effect)}
            numbers = _scaled(numbers, sized, 0.7)
        laid = {k: v * (0.7 if k.startswith("rudder.angle_rad") else 1) for k, v in case.told.items()}
        case = replace(case, runs=runs, numbers=numbers, told=laid)
    raise EstimationError(f"{case.name}: no release keeps {case.effects} towing")


def _scaled(numbers: dict[str, float], keys: set[str], by: float) -> dict[str, float]:
    """Numbers with these times ``by``: of all runs, or (``name@run``) of one."""
    return {k: v * (by if k in keys or k.split("@")[0] in keys else 1) for k, v in numbers.items()}


def _sizes(case: Case, effect: str) -> tuple[str, ...]:
    """The numbers that an effect's size goes with: the first of its form; a law's forces."""
    from .signature import STRENGTH

    drawn = effect in FORMS or effect in OUTSIDE
    return (next(iter(ranges_of(effect, form_of(case, effect)))),) if drawn else STRENGTH[effect]


def slackened(case: Case) -> Case:
    """The case with what slackens its line made stronger until the line falls slack in every run that it befalls.

    Parameters
    ----------
    case : as drawn

    Raises
    ------
    EstimationError : it never does
    """
    if SLACK not in case.effects:
        return case
    strength = f"{SLACK}.{_sizes(case, SLACK)[0]}"
    befallen = [i for i in range(len(case.runs)) if f"{strength}@{i}" in case.numbers]
    for _ in range(HARDER_TIMES):
        pull = swim([lane_of(case, i) for i in befallen], case.duration_s).tension_n.min(axis=0)
        taut = {f"{strength}@{i}" for i, least in zip(befallen, pull, strict=True) if least > 0}
        if not taut:
            return case
        case = replace(case, numbers=_scaled(case.numbers, taut, HARDER))
    raise EstimationError(f"{case.name}: its line never falls slack")


def _dealt(names: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Every name about equally often."""
    found: list[str] = []
    while len(found) < count:
        found += [names[i] for i in rng.permutation(len(names))]
    return found[:count]


def _pair(rng: np.random.Generator) -> list[str]:
    names = [name for name in EFFECTS if name != "sync_delay"]
    while True:
        pair = [names[i] for i in sorted(rng.choice(len(names), 2, replace=False))]
        if not PULLED & set(pair) or not set(pair) <= PULLED | HELD:
            return pair
