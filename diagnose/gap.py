"""From the ranking to gap.json and its words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..record.gap_file import GapFile, NextRun, RankedEffects, Where
from ..record.results import Measured
from ..simulate.model import DERIVATIVE_UNITS
from .effects import Effect
from .engine import TWINS, Candidate, Progress, Ranking, ranked
from .held_out import Shrink, shrink
from .inference import Fitted, Inference
from .next_run import Design, next_run
from .noise import TIMES_S
from .tow_data import TowRun
from .tow_rates import OWN
from .where import Place, where

Verdict = Literal["no_gap", "effect", "unknown"]
SHOWN = 8
"""Rows of the ranking that are worked out in full."""
LARGEST_D = 1000.0
SYMMETRIES = (
    ["tension scale", "all derivatives together"],
    ["frame_rate", "carriage speed"],
)
"""What no motion can tell apart (gap.md); another standard does: a weight, a clock."""
LIKE = {
    "crossflow_drag": "quadratic cross-flow drag",
    "cubic_damping": "cubic damping",
    "hull_asymmetry": "a hull that pulls to one side",
    "added_mass_coupling": "added mass that couples sway and yaw",
    "fluid_memory": "damping with memory",
    "bank_suction": "suction of the near wall",
    "cross_current": "a current across the tank",
    "speed_drift": "a drifting carriage speed",
    "tension_variation": "a line tension that changes with the angle",
    "elastic_line": "a line that stretches",
    "slack_line": "a line that goes slack",
    "tow_point_offset": "a tow point off the centre line",
    "swivel_friction": "friction in the swivel",
    "lens_distortion": "the lens's true distortion",
    "deck_height": "the marks' true height",
    "camera_shift": "a camera that was turned after the datum was picked",
    "datum_scale": "the datum's true scale",
    "datum_bias": "the tow post's true place",
    "marker_roll": "the model's roll under its marks",
    "frame_rate": "the true frame rate",
    "sync_delay": "the delay between load cell and video",
    "rolling_shutter": "a rolling shutter",
}


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


def diagnosed(
    runs: Sequence[TowRun],
    library: Sequence[Effect],
    tool: str,
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    reference: tuple[np.ndarray, np.ndarray, float] | None = None,
) -> Diagnosis:
    """Diagnose a campaign.

    Parameters
    ----------
    runs : all of one block length
    library : effects to try
    tool, inputs : for the file
    held : runs kept aside for ``shrink``; None: each in turn
    rng : of the bootstrap
    reference : see ``ranked``

    Raises
    ------
    EstimationError : the simulator as it is cannot be fitted at all
    """
    say = progress or (lambda _: None)
    rng = rng or np.random.default_rng()
    inference, ranking = ranked(runs, library, progress, reference)
    verdict, best = _verdict(ranking)
    say("where it lies, and how far it shrinks")
    place = where(inference, ranking, best)
    rows, headline = _rows(inference, ranking, held, rng, best)
    twins = _twins(ranking, best)
    say("the run that would tell most")
    design = _next(inference, ranking, best)
    names = [run.name for run in runs]
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
            when=_when(inference, best),
        ),
        ranking=rows,
        indistinguishable=twins,
        p_no_gap=ranking.p_no_gap,
        p_unknown=ranking.p_unknown,
        set95=[list(names) for names in ranking.set95],
        next_run=None if design is None else _next_file(design, ranking, best),
        derivatives={
            "before": _derivatives(ranking.base),
            **({"after": _derivatives(best.fitted)} if best is not None else {}),
        },
        noise=_noise(best.fitted if best is not None else ranking.base),
        runs=names,
        excluded=ranking.excluded,
        sentences=[],
    )
    file = file.model_copy(update={"sentences": sentences(file, best, headline)})
    return Diagnosis(file, inference, ranking, best, place, headline)


def _verdict(ranking: Ranking) -> tuple[Verdict, Candidate | None]:
    """What holds most of the probability: no gap, the effects together, or none of them."""
    top = ranking.candidates[0] if ranking.candidates else None
    mass = float(ranking.probabilities.sum()) if len(ranking.probabilities) else 0.0
    if ranking.p_unknown > max(ranking.p_no_gap, mass):
        return "unknown", None
    if top is None or ranking.p_no_gap >= mass:
        return "no_gap", None
    return "effect", top


def _rows(
    inference: Inference,
    ranking: Ranking,
    held: Sequence[int] | None,
    rng: np.random.Generator,
    best: Candidate | None,
) -> tuple[list[RankedEffects], Shrink | None]:
    rows: list[RankedEffects] = []
    headline: Shrink | None = None
    for index, (candidate, probability) in enumerate(zip(ranking.candidates, ranking.probabilities, strict=True)):
        if index >= SHOWN:
            break
        gap = shrink(inference, ranking.base, candidate.fitted, held, rng)
        if candidate is best:
            headline = gap
        rows.append(
            RankedEffects(
                effects=list(candidate.names),
                probability=float(probability),
                parameters=_numbers(inference, candidate),
                gap_before=gap.before,
                gap_after=gap.after,
                shrink=gap.shrink,
                shrink_interval=gap.interval,
                log_evidence=candidate.log_evidence,
                cure=" ".join(e.cure for e in candidate.effects),
            )
        )
    return rows, headline


def _numbers(inference: Inference, candidate: Candidate) -> dict[str, Measured]:
    at = 6 + inference.mode_count
    solved, found = candidate.fitted.solved, {}
    for effect, numbers in zip(candidate.effects, candidate.fitted.hypothesis.numbers, strict=True):
        for number, parameter in zip(numbers, effect.parameters, strict=True):
            std = float(np.sqrt(max(solved.covariance[at, at], 0.0)))
            found[f"{effect.name}.{parameter.name}"] = Measured(value=float(number), std=std)
            at += 1
        if effect.lag_s:
            found[f"{effect.name}.time_s"] = Measured(value=effect.lag_s, std=0.4 * effect.lag_s)
    return found


def _derivatives(fitted: Fitted) -> dict[str, Measured]:
    sd = np.sqrt(np.maximum(np.diag(fitted.solved.covariance)[:6], 0.0))
    return {
        name: Measured(value=float(v), std=float(s))
        for name, v, s in zip(DERIVATIVE_UNITS, fitted.hypothesis.six, sd, strict=True)
    }


def _noise(fitted: Fitted) -> dict[str, float]:
    forces = fitted.forces
    return {"side_n": float(forces.side_n), "moment_n_m": float(forces.moment_n_m), "time_s": TIMES_S[forces.time]}


def _twins(ranking: Ranking, best: Candidate | None) -> list[list[str]]:
    """Effects within TWINS of the headline, and the symmetries that concern them."""
    found: list[list[str]] = []
    if best is not None and len(best.effects) == 1:
        near = [
            c.names[0]
            for c in ranking.candidates
            if len(c.effects) == 1 and best.log_evidence - c.log_evidence < TWINS and c is not best
        ]
        if near:
            found.append([best.names[0], *near])
    if best is not None and "frame_rate" in best.names:
        found.append(list(SYMMETRIES[1]))
    found.append(list(SYMMETRIES[0]))
    return found


def _next(inference: Inference, ranking: Ranking, best: Candidate | None) -> Design | None:
    """Between the headline and its nearest rival (no gap among them)."""
    if not ranking.candidates:
        return None
    first = best.fitted if best is not None else ranking.base
    rivals = [c for c in ranking.candidates if c is not best and len(c.effects) == 1]
    if not rivals:
        return None
    second = max(rivals, key=lambda c: c.log_evidence).fitted
    return next_run(inference, first, second)


def _next_file(design: Design, ranking: Ranking, best: Candidate | None) -> NextRun:
    rivals = [c for c in ranking.candidates if c is not best and len(c.effects) == 1]
    rival = max(rivals, key=lambda c: c.log_evidence).names[0]
    against = best.names[0] if best is not None else "no gap"
    size = f"{design.distance:.0f}" if design.distance < LARGEST_D else f"over {LARGEST_D:.0f}"
    told = "tells" if design.distance > 20 else "tells best, though not surely,"
    why = f"{design.differs}: {told} {against} from {rival} (expected D {size}; 20 is enough)"
    return NextRun(
        tow_point_m=design.tow_point_m,
        line_length_m=design.line_length_m,
        speed_m_s=design.speed_m_s,
        y_release_m=design.y_m,
        beta_release_rad=design.beta_rad,
        distance=design.distance,
        why=why,
    )


def _when(inference: Inference, best: Candidate | None) -> str:
    """At which size of the motion a hull effect's force reaches the random forces."""
    if best is None or best.effects[0].force is None:
        return ""
    fastest = float(np.abs(best.fitted.hypothesis.own[:, OWN.index("v")]).max())
    speeds = [
        np.abs(np.gradient(r.values[:, 0], inference.model.step_s) - r.data.tow.speed_m_s * r.values[:, 1])
        for r in inference.model.runs
    ]
    top = max(float(np.nanmax(s)) for s in speeds)
    return f"sway velocities of the runs reach {max(top, fastest):.2f} m/s"


def sentences(file: GapFile, best: Candidate | None, held: Shrink | None) -> list[str]:
    """The summary in plain words."""
    if file.verdict == "no_gap":
        said = [f"The simulator explains these runs to within their noise (probability {file.p_no_gap:.2f})."]
        if file.ranking:
            first = file.ranking[0]
            said.append(
                f"The nearest thing to a gap would be {_like(first.effects)} (probability {first.probability:.2f})."
            )
        return said
    if file.verdict == "unknown":
        place = file.where
        return [
            f"There is a gap that no effect or pair of effects in the library explains (probability {file.p_unknown:.2f}).",
            f"It shows most in {max(place.share, key=lambda k: place.share[k])}, from {place.span_s[0]:.0f} to "
            f"{place.span_s[1]:.0f} s, at {place.band_hz[0]:.2f} to {place.band_hz[1]:.2f} Hz.",
        ]
    row = file.ranking[0]
    stage = file.where.stage
    side = {
        "sway": " in the sway equation",
        "yaw": " in the yaw equation",
        "line": " in the line",
        "camera": " in the camera",
    }
    said = [f"Your simulator misses {_like(row.effects)}{side.get(stage, '')} (probability {row.probability:.2f})."]
    numbers = ", ".join(f"{k.split('.')[1]} {v.value:.3g} +- {v.std:.2g}" for k, v in row.parameters.items())
    said.append(f"Its size: {numbers}.")
    if held is not None and held.before > 1:
        low, high = row.shrink_interval
        said.append(
            f"With it, the gap on the runs kept aside falls from {row.gap_before:.2f} to {row.gap_after:.2f} sigma "
            f"({100 * row.shrink:.0f} %, interval {100 * low:.0f}-{100 * high:.0f})."
        )
    twins = [t for t in file.indistinguishable if t[0] in row.effects]
    if twins:
        others = " or ".join(_like([n]) for n in twins[0][1:])
        cure = f"; {file.next_run.why.split(':')[0]} would" if file.next_run is not None else ""
        said.append(f"It cannot be told from {others} with these runs{cure}.")
    elif file.next_run is not None:
        said.append(f"To be surer: {file.next_run.why}.")
    said.append(row.cure)
    changed = _changed(file)
    if changed:
        said.append(changed)
    return said


def _like(names: Sequence[str]) -> str:
    return " and ".join(LIKE.get(name, name) for name in names)


def _changed(file: GapFile) -> str:
    """What the unmodelled effect had done to the derivatives."""
    before, after = file.derivatives.get("before", {}), file.derivatives.get("after", {})
    moved = {k: 100 * (before[k].value / after[k].value - 1) for k in after if after[k].value}
    if not moved:
        return ""
    worst = max(moved, key=lambda k: abs(moved[k]))
    return (
        f"Left out, it biases the derivatives by up to {abs(moved[worst]):.0f} % ({worst})."
        if abs(moved[worst]) >= 1
        else ""
    )
