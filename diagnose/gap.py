"""From the ranking to gap.json and its words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..record.gap_file import GapFile, NextMeasurement, NextRun, RankedEffects, Where
from ..record.results import Measured
from ..record.run import Run
from ..record.threads import one_thread
from .effects import Effect, paced
from .inference.apart import Apart, measurement
from .inference.diagnosable import Diagnosable
from .inference.engine import RUNS_AWAY, TWINS, Progress, ranked
from .inference.evidence import CONVERGED_GAIN, Fitted, Inference
from .inference.held_out import Shrink, none_left, shrink
from .inference.noise import TIMES_S
from .inference.ranking import Candidate, Ranking
from .inference.spread import Spread, one_by_one
from .tow.next_run import next_run
from .where import Place, where
from .words import sentences

STEPS_LEFT = 5.0
"""A fit that is not at its end may come on by so many times what its next step promises: a choice. From a step that is cut short it
is several of them, and each promises less."""
SMALLEST_P = 1e-300
"""Below it a probability has no logarithm."""
Verdict = Literal["no_gap", "effect", "form_not_exact", "unknown", "not_converged"]
NAMED: tuple[Verdict, ...] = ("effect", "form_not_exact")
"""Verdicts that say which effect is there."""
SHOWN = 8
"""Rows of the ranking that are worked out in full."""
RUN_OFF = 1e3
"""What makes a gap so many times larger on runs kept aside follows none of them: its motion has run off."""
HARDLY_D = 2.0
"""A next tow that is expected to tell less moves the odds by less than a factor of e: that is said."""
LARGEST_D = 1000.0
"""Beyond this a distance is said as "over": a choice."""
DOUBT = 0.2
"""No gap is called while its probability is above this: half as many campaigns without any are then called faulty as at one half,
and one effect in 170 that can be told apart is passed over (docs/blind.md).
"""


@dataclass(frozen=True)
class Diagnosis:
    """Everything the page shows.

    Attributes
    ----------
    file : gap.json
    inference, ranking : behind it
    best : the headline candidate, or None
    place, held : where; gap on runs kept aside, of the headline
    """

    file: GapFile
    inference: Inference
    ranking: Ranking
    best: Candidate | None
    place: Place
    held: Shrink | None


@dataclass(frozen=True)
class Diagnosed:
    """A campaign, diagnosed.

    Attributes
    ----------
    diagnosis : gap.json and what is behind it
    runs : run folders used
    failed : folder -> why
    library : effects that were tried
    held : runs kept aside, of ``runs``; None: each in turn
    """

    diagnosis: Diagnosis
    runs: list[Run]
    failed: dict[str, str]
    library: tuple[Effect, ...] = ()
    held: tuple[int, ...] | None = None


@one_thread()
def diagnosed(
    simulator: Diagnosable,
    library: Sequence[Effect],
    tool: str,
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    spread: Spread = one_by_one,
) -> Diagnosis:
    """Diagnose a campaign.

    Parameters
    ----------
    simulator : with its runs (tow.TowSimulator, users.UsersSimulator)
    library : effects to try
    tool, inputs : for the file
    held : runs kept aside for ``shrink``; None: each in turn
    rng : of the bootstrap
    progress : is told in a sentence what is done
    spread : does what is independent

    Raises
    ------
    EstimationError : the simulator as it is cannot be fitted at all
    """
    simulator, inference, ranking = ranked(simulator, library, progress, spread)
    return concluded(simulator, inference, ranking, library, tool, inputs, held, rng, progress)


@one_thread()
def concluded(
    simulator: Diagnosable,
    inference: Inference,
    ranking: Ranking,
    library: Sequence[Effect],
    tool: str,
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """What follows from a ranking.

    Parameters
    ----------
    simulator : with its runs
    inference, ranking : of ``engine.ranked``
    library, tool, inputs, held, rng, progress : as of ``diagnosed``
    """
    say = progress or (lambda _: None)
    rng = rng or np.random.default_rng()
    verdict = called(ranking.p_no_gap, ranking.p_unknown, float(ranking.named.sum()))
    if verdict == "effect" and 2 * ranking.probabilities[0] < ranking.named[0]:
        verdict = "form_not_exact"
    promised = max((f.promised for f in rests_on(ranking, verdict)), default=0.0)
    # that an effect is there is told all the same; only its size is not
    if promised > CONVERGED_GAIN and verdict not in NAMED:
        verdict = "not_converged"
    best = ranking.candidates[0] if verdict in NAMED else None
    say("where it lies, and how far it shrinks")
    place = where(inference, ranking, best)
    rows, headline, lost = _rows(inference, ranking, held, rng, best)
    twins = twins_of(ranking, best, simulator.symmetries(inference, ranking.base))
    names = [run.name for run in simulator.runs]
    say("the run that would tell most")
    file = GapFile(
        schema="towline/gap",
        tool=tool,
        inputs=inputs,
        verdict=verdict,
        where=Where(
            stage=place.stage,
            share=place.share,
            runs=place.runs,
            span_s=list(place.span_s) if verdict != "no_gap" else [],
            band_hz=list(place.band_hz) if verdict != "no_gap" else [],
            when=simulator.reached(best.fitted) if best is not None and best.effects[0].force is not None else "",
        ),
        ranking=rows,
        indistinguishable=twins,
        promised=promised,
        p_no_gap=ranking.p_no_gap,
        p_unknown=ranking.p_unknown,
        set95=[list(names) for names in ranking.set95],
        next_run=_next(inference, ranking, best),
        next_measurement=best_measurement(ranking, best, simulator.apart),
        kept_aside=not none_left(len(simulator.runs), held),
        derivatives={
            "before": _derivatives(ranking.base, simulator.shared_names),
            **({"after": _derivatives(best.fitted, simulator.shared_names)} if best is not None else {}),
        },
        noise=_noise(best.fitted if best is not None else ranking.base, simulator.force_scale),
        noise_without=_noise(ranking.base, simulator.force_scale),
        runs=names,
        excluded=ranking.excluded | lost,
        sentences=[],
    )
    nearest = ranking.for_unknown
    like = nearest.effects[-1] if nearest is not None else None
    said = sentences(file, headline, ranking.rest, _titles(library, ranking), like)
    file = file.model_copy(update={"sentences": said})
    return Diagnosis(file, inference, ranking, best, place, headline)


def _titles(library: Sequence[Effect], ranking: Ranking) -> dict[str, str]:
    found = (*library, *(effect for candidate in ranking.candidates for effect in candidate.effects))
    return {effect.name: effect.title for effect in found}


def called(p_no_gap: float, p_unknown: float, p_effects: float) -> Verdict:
    """Call no gap, unless something is missing almost surely; then the effects, or something unknown.

    Parameters
    ----------
    p_no_gap : probability that nothing is missing
    p_unknown : that what is missing is in no library
    p_effects : of all effects of the library together

    Returns
    -------
    verdict : "effect" where the effects together are at least as probable as the unknown
    """
    if p_no_gap > DOUBT:
        return "no_gap"
    return "effect" if p_effects > 0 and p_effects >= p_unknown else "unknown"


def rests_on(ranking: Ranking, verdict: Verdict) -> list[Fitted]:
    """Fits that a verdict rests on: of no gap, of the headline, or of both where neither is enough.

    A candidate decides nothing that would explain less than no gap, or than a free form, even where its next step kept its
    promise.

    Parameters
    ----------
    ranking : of the hypotheses
    verdict : called
    """
    first = ranking.candidates[:1]
    if verdict in NAMED:
        return [c.fitted for c in first]
    free = ranking.free.log_evidence if ranking.free is not None else 0.0
    others = [] if verdict == "no_gap" else [c.fitted for c in first if c.log_evidence > max(free, 0.0)]
    # no gap is no answer where the simulator as it is follows nothing, wherever its fit would end, nor where the gap is far more
    # than the way that is left to it
    apart = np.log(max(1.0 - ranking.p_no_gap, SMALLEST_P)) - np.log(max(ranking.p_no_gap, SMALLEST_P))
    open_still = ranking.follows and apart < STEPS_LEFT * ranking.base.promised
    return [ranking.base, *others] if open_still or verdict == "no_gap" else others


def _rows(
    inference: Inference,
    ranking: Ranking,
    held: Sequence[int] | None,
    rng: np.random.Generator,
    best: Candidate | None,
) -> tuple[list[RankedEffects], Shrink | None, dict[str, str]]:
    """Rows, what the best does to the gap, and which effects' motions have run off: without one of the runs nothing holds them."""
    shown = ranking.candidates[:SHOWN]
    # one measure for all rows: the random forces that the first of them leaves
    forces = (best or shown[0]).fitted.forces if shown else None

    def measured(pair: tuple[Candidate, np.random.Generator]) -> Shrink | None:
        candidate, own_rng = pair
        try:
            found = shrink(inference, ranking.base, candidate.fitted, held, own_rng, forces)
        except np.linalg.LinAlgError:
            if candidate is best:
                raise
            return None
        return found if candidate is best or found.after < RUN_OFF * max(found.before, 1.0) else None

    gaps = inference.spread(measured, list(zip(shown, rng.spawn(len(shown)), strict=True)))
    rows: list[RankedEffects] = []
    headline: Shrink | None = None
    lost: dict[str, str] = {}
    shares = zip(ranking.probabilities, ranking.named, strict=True)
    for candidate, (probability, named), gap in zip(shown, shares, gaps, strict=False):
        if gap is None:
            lost |= dict.fromkeys(candidate.names if len(candidate.names) == 1 else (), RUNS_AWAY)
            continue
        if candidate is best:
            headline = gap
        rows.append(
            RankedEffects(
                effects=list(candidate.names),
                titles=[effect.title or effect.name for effect in candidate.effects],
                probability=float(probability),
                probability_inexact=float(named - probability),
                form=candidate.variant,
                forms=_forms(ranking, candidate),
                parameters=_numbers(inference, candidate),
                units=_units(candidate),
                gap_before=gap.before,
                gap_after=gap.after,
                shrink=gap.shrink,
                shrink_interval=gap.interval,
                log_evidence=candidate.log_evidence,
                cure=" ".join(e.cure for e in candidate.effects),
            )
        )
    return rows, headline, lost


def _forms(ranking: Ranking, candidate: Candidate) -> dict[str, float]:
    """Other forms of the same effects that were fitted -> log evidence below this one's."""
    found = ranking.forms.get(candidate.names, {})
    return {variant: log - candidate.log_evidence for variant, log in found.items() if variant != candidate.variant}


def _units(candidate: Candidate) -> dict[str, str]:
    """effect.number -> unit, of those that have one."""
    found = {f"{e.name}.{p.name}": p.unit for e in candidate.effects for p in e.parameters if p.unit}
    return found | {f"{effect.name}.time_s": "s" for effect in candidate.effects if effect.lag_s}


def _numbers(inference: Inference, candidate: Candidate) -> dict[str, Measured]:
    at = inference.fixed(candidate.fitted.hypothesis)
    solved, found = candidate.fitted.solved, {}
    for effect, numbers in zip(candidate.effects, candidate.fitted.hypothesis.numbers, strict=True):
        for number, parameter in zip(numbers, effect.parameters, strict=True):
            std = float(np.sqrt(max(solved.covariance[at, at], 0.0)))
            found[f"{effect.name}.{parameter.name}"] = Measured(value=float(number), std=std)
            at += 1
        if effect.late is not None:
            found[f"{effect.name}.time_s"] = _lag_time(effect, found)
    return found


def _lag_time(effect: Effect, found: dict[str, Measured]) -> Measured:
    """Of how it follows; known to the grid's spacing where none is fitted."""
    faster = found.get(f"{effect.name}.faster")
    if faster is None:
        return Measured(value=effect.lag_s, std=0.4 * effect.lag_s)
    pace = float(paced(faster.value))
    return Measured(value=effect.lag_s / pace, std=effect.lag_s * faster.std / pace**2)


def _derivatives(fitted: Fitted, names: Sequence[str]) -> dict[str, Measured]:
    sd = np.sqrt(np.maximum(np.diag(fitted.solved.covariance)[: len(names)], 0.0))
    return {
        name: Measured(value=float(v), std=float(s))
        for name, v, s in zip(names, fitted.hypothesis.shared, sd, strict=True)
    }


def _noise(fitted: Fitted, scale: float) -> dict[str, float]:
    forces = fitted.forces
    return {
        "side_n": scale * float(forces.side_n),
        "moment_n_m": scale * float(forces.moment_n_m),
        "time_s": TIMES_S[forces.time],
    }


def twins_of(
    ranking: Ranking, best: Candidate | None, symmetries: Sequence[tuple[str, Sequence[str]]]
) -> list[list[str]]:
    """List what these runs cannot tell apart.

    Parameters
    ----------
    ranking : of the hypotheses
    best : the headline, or None
    symmetries : what no motion can tell apart, each with the effect that raises the question ("": always)

    Returns
    -------
    twins : groups of names: a headline of one effect with the single effects whose log evidence is within TWINS of its own, and the
        symmetries that concern the headline
    """
    found: list[list[str]] = []
    if best is not None and len(best.effects) == 1:
        near = [
            c.names[0]
            for c in ranking.candidates
            if len(c.effects) == 1 and best.log_evidence - c.log_evidence < TWINS and c is not best
        ]
        if near:
            found.append([best.names[0], *near])
    concerned = best.names if best is not None else ()
    found += [list(members) for effect, members in symmetries if not effect or effect in concerned]
    return found


def rival_of(ranking: Ranking, best: Candidate | None) -> Candidate | None:
    """Find the single effect of the largest log evidence beside the headline.

    Parameters
    ----------
    ranking : of the hypotheses
    best : the headline, or None
    """
    rivals = [c for c in ranking.candidates if c is not best and len(c.effects) == 1]
    return max(rivals, key=lambda c: c.log_evidence, default=None)


def _next(inference: Inference, ranking: Ranking, best: Candidate | None) -> NextRun | None:
    """Between the headline (or no gap) and its nearest rival."""
    second = rival_of(ranking, best)
    if second is None:
        return None
    design = next_run(inference, best.fitted if best is not None else ranking.base, second.fitted)
    if design is None:
        return None
    rival, against = (" + ".join(c.names) if c is not None else "no gap" for c in (second, best))
    why = f"{design.differs}: {_tells(design.distance)} {against} from {rival} {_expected(design.distance)}"
    if design.distance < HARDLY_D:
        why += ", nor would any other of the tows that were looked at"
    return NextRun(
        tow_point_m=design.tow_point_m,
        line_length_m=design.line_length_m,
        speed_m_s=design.speed_m_s,
        y_release_m=design.y_m,
        beta_release_rad=design.beta_rad,
        distance=design.distance,
        why=why,
    )


def _tells(distance: float) -> str:
    if distance < HARDLY_D:
        return "would hardly tell"
    return "tells" if distance >= 20 else "tells best, though not surely,"


def _expected(distance: float) -> str:
    told = "below 1" if distance < 1 else f"over {LARGEST_D:.0f}" if distance >= LARGEST_D else f"{distance:.0f}"
    return f"(expected D {told}; 20 is enough)"


def best_measurement(ranking: Ranking, best: Candidate | None, known: Mapping[str, Apart]) -> NextMeasurement | None:
    """Choose what to measure without a tow: the effect, of the headline's or its nearest rival's, whose presence that tells best.

    Parameters
    ----------
    ranking : of the hypotheses
    best : the headline, or None
    known : effect.number -> what was measured of it already

    Returns
    -------
    chosen : None where nothing of either can be measured without a tow
    """
    rival = rival_of(ranking, best)
    here = [c.fitted.hypothesis for c in (best, rival) if c is not None]
    found = [one for hypothesis in here for one in measurement(hypothesis, known)]
    if not found:
        return None
    distance, effect, numbers = max(found, key=lambda one: one[0])
    size = ", ".join(f"{name} to {sd:g}" for name, sd in numbers.items())
    why = f"{size}: {_tells(distance)} whether it is {effect.name} {_expected(distance)}. {effect.cure}"
    return NextMeasurement(effect=effect.name, numbers=numbers, distance=distance, why=why)
