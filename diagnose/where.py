"""Where the gap lies: stage by probability; runs, time and frequencies by what the headline changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..simulate.model import Array
from .effects import STAGES, Effect
from .inference.evidence import Fitted, Inference
from .inference.ranking import Candidate, Ranking

MOST = 0.6
"""The stated time span holds this share of the drop of chi-square, the stated band this share of the change's power: a choice."""
YAW_WORDS = ("n_", "moment", "yaw")


@dataclass(frozen=True)
class Place:
    """Where.

    Attributes
    ----------
    stage, share : headline stage and the probability of each
    runs : name -> share of the drop of chi-square
    span_s, band_hz : time and band that hold MOST of it
    drop : run name -> (n,) drop of squared whitened residual over time
    """

    stage: str
    share: dict[str, float]
    runs: dict[str, float]
    span_s: tuple[float, float]
    band_hz: tuple[float, float]
    drop: dict[str, Array]


def where(inference: Inference, ranking: Ranking, best: Candidate | None) -> Place:
    """Put the probabilities and the drop of chi-square together.

    Parameters
    ----------
    inference : the simulator with its runs and noise
    ranking : of the hypotheses
    best : the best one, or None
    """
    share: dict[str, float] = dict.fromkeys(STAGES, 0.0)
    for candidate, probability in zip(ranking.candidates, ranking.named, strict=True):
        for effect in candidate.effects:
            for stage, part in _stages(candidate, effect).items():
                share[stage] = share.get(stage, 0.0) + float(probability) * part / len(candidate.effects)
    unknown = ranking.for_unknown
    if unknown is not None and ranking.p_unknown > 0:
        for stage, part in _stages(unknown, unknown.effects[-1]).items():
            share[stage] = share.get(stage, 0.0) + ranking.p_unknown * part
    total = sum(share.values())
    stage = max(share, key=lambda k: share[k]) if total > 0.5 else ""
    after = best or unknown
    if after is None:
        return Place(stage, share, {}, (0.0, 0.0), (0.0, 0.0), {})
    drop = _drops(inference, ranking.base, after.fitted)
    sums = {name: max(float(d.sum()), 0.0) for name, d in drop.items()}
    whole = sum(sums.values()) or 1.0
    step = inference.simulator.step_s
    longest = max(len(d) for d in drop.values())
    course = np.zeros(longest)
    for d in drop.values():
        course[: len(d)] += np.maximum(d, 0.0)
    begin, end = shortest_stretch(course, MOST)
    return Place(
        stage,
        share,
        {name: value / whole for name, value in sums.items()},
        (begin * step, end * step),
        _band(inference, ranking.base, after.fitted),
        drop,
    )


def _stages(candidate: Candidate, effect: Effect) -> dict[str, float]:
    """Hull effects are split between sway and yaw by how significant their numbers are."""
    if effect.stage not in ("sway", "yaw"):
        return {effect.stage: 1.0}
    at = candidate.effects.index(effect)
    numbers = candidate.fitted.hypothesis.numbers[at]
    weight = {"sway": 0.0, "yaw": 0.0}
    for number, parameter in zip(numbers, effect.parameters, strict=True):
        stage = "yaw" if parameter.name.startswith(YAW_WORDS) or "yaw" in parameter.name else "sway"
        weight[stage] += ((number - parameter.none) / parameter.sd) ** 2
    total = weight["sway"] + weight["yaw"]
    if total == 0 or len(effect.parameters) == 1:
        return {effect.stage: 1.0}
    return {stage: value / total for stage, value in weight.items()}


def _drops(inference: Inference, base: Fitted, after: Fitted) -> dict[str, Array]:
    """Squared whitened residuals before minus after, (n,) per run, all channels; at the after's noise."""
    forces = after.forces
    solved = [inference.solve(fitted.grams, fitted.hypothesis, forces) for fitted in (base, after)]
    answers = {}
    for index, run in enumerate(inference.simulator.runs):
        one, two = (
            inference.left(f.linear, forces, s.shared, s.own[index], index)
            for f, s in zip((base, after), solved, strict=True)
        )
        change = one**2 - two**2
        answers[run.name] = change.reshape(-1, len(run.centre_s)).sum(axis=0)
    return answers


def shortest_stretch(course: Array, share: float) -> tuple[int, int]:
    """Find the shortest stretch that holds a share of the sum; the first of several.

    Parameters
    ----------
    course : (n,) not negative
    share : of the sum, 0 to 1

    Returns
    -------
    begin, end : such that course[begin:end] holds the share; all of it where the sum is zero
    """
    sums = np.concatenate([[0.0], np.cumsum(course)])
    wanted = share * sums[-1]
    best = (0, len(course))
    if sums[-1] <= 0:
        return best
    for begin in range(len(course)):
        end = int(np.searchsorted(sums, sums[begin] + wanted))
        if end > len(course):
            break
        if end - begin < best[1] - best[0]:
            best = (begin, end)
    return best


def _band(inference: Inference, base: Fitted, after: Fitted) -> tuple[float, float]:
    """Frequencies of the difference between the two fits in y."""
    step = inference.simulator.step_s
    longest = max(len(r.centre_s) for r in inference.simulator.runs)
    frequency = np.fft.rfftfreq(2 * longest, step)
    power = np.zeros(len(frequency))
    for (before, _), (later, _), run in zip(base.linear.rows, after.linear.rows, inference.simulator.runs, strict=True):
        sd = np.sqrt(np.array([np.median(np.diag(c)) for c in run.covariance[:2]]))
        change = np.nan_to_num((later - before)[:, :2]) / sd
        change = change - change.mean(axis=0)
        taper = np.hanning(len(change))[:, None]
        power += (np.abs(np.fft.rfft(change * taper, 2 * longest, axis=0)) ** 2).sum(axis=1)
    begin, end = shortest_stretch(power, MOST)
    return float(frequency[begin]), float(frequency[min(end, len(frequency) - 1)])
