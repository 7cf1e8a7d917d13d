"""The oracle of the laws' benchmark: the truth's own form put into the diagnosis's fit; and gaps of tows that were not fitted.

The form is the truth's function (blind/truth/laws.py); only the engine that fits it is the diagnosis's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from laws_cases import SIZES
from laws_truth import sways_m

from towline.blind.truth.cases import Case, lane_of
from towline.blind.truth.laws import TERMS, law_ahead, law_force, law_lean
from towline.diagnose.effects import Effect, Parameter, Seen, Situation, rolled
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.grams import Grams
from towline.diagnose.inference.held_out import removed_share
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.inference.noise import Forces
from towline.diagnose.inference.ranking import P_NO_GAP
from towline.diagnose.tow.towed import TowSimulator

WIDE = 3.0
"""Prior standard deviation of a coefficient, over its true size: as good as free."""
INSIDE = {0: {"p": 0.7}, 1: {"p": 0.7}, 3: {"a": 0.02}, 4: {"a": 0.02}, 5: {"b": 3.0}, 6: {"b": 3.0}, 7: {"p": 0.7},
          8: {"p": 0.7, "b": 0.3}, 10: {"phase": 0.05, "a": 0.03}}  # fmt: skip
"""Kind of a term -> the numbers inside it that a fit of the form has to find, with a prior about the truth. A wave's phase is found
too, as its sine and cosine."""
STEPS, TURNS, FEW_FORCES = 8, (3, 6), 0.1
"""Of the oracle's fit: Gauss-Newton steps, when the random forces are estimated, and the share of the base's they begin with."""
OWN_STEPS, SHORTER = 6, 0.3
"""Steps in which a tow that is not fitted finds its own start; one that makes the fitted tows worse is shortened to this share."""


class _Numbers(dict):
    """Lanes whose numbers may have columns."""

    n: Any = ()

    def __missing__(self, name: str) -> Any:
        return np.zeros(())


def true_effect(case: Case, inside: bool) -> tuple[Effect, np.ndarray]:
    """The truth's law as an effect, and its true numbers.

    Parameters
    ----------
    case : as drawn
    inside : the numbers inside its terms (powers, thresholds, places) are fitted, too
    """
    lane = lane_of(case, 0)
    fixed = {
        name: value
        for name, value in lane.items()
        if name.startswith("law.") or name in ("length_pp", "tank_width", "speed_ref")
    }
    names, sds = [], []
    for k in range(TERMS):
        if f"law.kind{k}" not in fixed:
            continue
        kind = int(fixed[f"law.kind{k}"])
        names += [name for which in ("side", "turn", "along", "lean") if fixed.get(name := f"law.{which}{k}")]
        sds += [WIDE * abs(fixed[n]) for n in names[len(sds) :]]
        if inside:
            more = INSIDE.get(kind, {}) | ({"phase": 1.0} if kind in (5, 6) else {})
            names += [f"law.{which}{k}" for which in more]
            sds += more.values()
    values = np.array([fixed[n] for n in names])
    coefficient = np.array([n[4:8] in SIZES for n in names])

    def lanes(like: Any, *numbers: Any) -> Any:
        q = _Numbers({n: np.asarray(v) for n, v in fixed.items()} | dict(zip(names, numbers, strict=True)))
        q.n = np.broadcast_shapes(np.shape(like), *(np.shape(v) for v in numbers))
        return q

    def asked(s: Situation, *numbers: Any) -> tuple[Any, Any]:
        now = SimpleNamespace(v=s.v_m_s, r=s.r_rad_s, speed=s.speed_m_s, y_m=s.y_m, beta=s.beta_rad)
        return lanes(s.v_m_s, *numbers), now

    def force(s: Situation, *numbers: Any) -> tuple[Any, Any]:
        return law_force(*asked(s, *numbers))

    def ahead(s: Situation, *numbers: Any) -> Any:
        return law_ahead(*asked(s, *numbers))

    def observe(seen: Seen, *numbers: Any) -> tuple[Any, Any, Any, Any]:
        u, v = seen.through_water
        now = SimpleNamespace(v=v, r=seen.rate[2], speed=u, y_m=seen.pose[1], beta=seen.pose[2])
        drive = sways_m(case) * law_lean(lanes(seen.side, *numbers), now)
        return rolled(seen, drive, lane["marker_roll.period_s"], lane["marker_roll.damping"])

    along, lean = (any(fixed.get(f"law.{which}{k}") for k in range(TERMS)) for which in ("along", "lean"))
    parameters = tuple(
        Parameter(n, "", float(sd), none=0.0 if c else float(v))
        for n, sd, c, v in zip(names, sds, coefficient, values, strict=True)
    )
    return Effect(
        "truth",
        "sway",
        parameters,
        "",
        "",
        force=force,
        ahead=ahead if along else None,
        observe=observe if lean else None,
        remembers=lean,
        sizes=(1.0,),
        form=0.0,
    ), values


def oracle(case: Case, inference: Inference, base: Fitted) -> tuple[dict[str, Fitted], dict[str, dict[str, float]]]:
    """The true form refitted, derivatives, starts and random forces with it: once its coefficients alone, once all its numbers.

    Parameters
    ----------
    case : as drawn
    inference, base : of the diagnosis: the runs with their noise, and the fit without effects

    Returns
    -------
    fits : "coefficients" and "form"
    numbers : of each, as numbers of the case
    """
    fits, numbers = {}, {}
    for name, inside in (("coefficients", False), ("form", True)):
        effect, values = true_effect(case, inside)
        h = replace(base.hypothesis, effects=(effect,), numbers=(values,))
        fits[name] = inference.fit([h], [base.forces.scaled(FEW_FORCES)], STEPS, TURNS)[0]
        numbers[name] = dict(
            zip((p.name for p in effect.parameters), map(float, fits[name].hypothesis.numbers[0]), strict=True)
        )
    return fits, numbers


def reader(
    case: Case, inference: Inference, base: Fitted, whole: Fitted, single: float, pair: float
) -> tuple[list[int] | None, float]:
    """Which of the truth's terms one who knows their forms would tell from these runs: none, one, or both; and how surely.

    The forms are the truth's with all their numbers refitted, sizes about the true ones; the log priors are the search's. What such
    a reader does not tell no search can.

    Parameters
    ----------
    case : as drawn
    inference, base : of the diagnosis
    whole : all terms with all their numbers, of ``oracle``
    single, pair : log priors of a law of one term and of two; that of no gap is P_NO_GAP's

    Returns
    -------
    terms : positions; None: nothing
    weight : log evidence and prior of what is told, over that of no effect
    """
    there = [k for k in range(TERMS) if f"law.kind{k}" in case.numbers]
    fits = [(there, whole)]
    for k in there if len(there) > 1 else ():
        gone = tuple(str(other) for other in there if other != k)
        numbers = {n: v for n, v in case.numbers.items() if not (n.startswith("law.") and n.endswith(gone))}
        effect, values = true_effect(replace(case, numbers=numbers), inside=True)
        h = replace(base.hypothesis, effects=(effect,), numbers=(values,))
        fits.append(([k], inference.fit([h], [base.forces.scaled(FEW_FORCES)], STEPS, TURNS)[0]))
    weights = [f.log_evidence - base.log_evidence + (single if len(way) == 1 else pair) for way, f in fits]
    best = int(np.argmax(weights))
    least = float(np.log(P_NO_GAP))
    return (fits[best][0], weights[best]) if weights[best] > least else (None, least)


def gaps_beyond(simulator: TowSimulator, count: int, fits: Sequence[Fitted], forces: Forces) -> np.ndarray:
    """Gaps on tows that took no part in a fit: root mean square of what is left of y and heading over the noise.

    Derivatives and effects stay as the first runs have them; a tow's own start and settings are its own.

    Parameters
    ----------
    simulator : of all runs, the first ``count`` are those that were fitted
    count : of them
    fits : hypotheses, fitted to the first runs
    forces : random forces that all are measured by

    Returns
    -------
    gaps : (fits, runs beyond); infinite where the simulator cannot follow them
    """
    beyond, first = len(simulator.runs) - count, list(range(count))
    rows = []
    for fitted in fits:
        try:
            rows.append(_gaps(simulator, first, fitted, forces))
        except np.linalg.LinAlgError:  # a simulator that cannot follow these tows at all
            rows.append([np.inf] * beyond)
    return np.array(rows)


def _gaps(simulator: TowSimulator, first: list[int], fitted: Fitted, forces: Forces) -> list[float]:
    count, start = len(first), simulator.starts()[0]
    own = np.vstack([fitted.hypothesis.own, simulator.stated[count:]])
    own[count:, :4] = start.own[count:, :4]
    h = Hypothesis(fitted.hypothesis.shared, own, fitted.hypothesis.effects, fitted.hypothesis.numbers, start.path)
    inference = Inference(simulator, simulator.noise(h))
    share, kept, best = 1.0, None, -np.inf
    for _ in range(OWN_STEPS + 1):
        linear = inference.linear([h])[0]
        grams = Grams(linear.columns, inference.noise)
        try:
            solved = inference.solve(grams, h, forces, first)
        except np.linalg.LinAlgError:  # its motion runs off
            if kept is None:
                raise
            solved = None
        if solved is not None and (kept is None or solved.here >= best):
            kept, best = (h, linear, grams, solved.shared), solved.here
        else:
            # a whole step of a coefficient and its power runs off where the two are hardly told apart
            share *= SHORTER
        assert kept is not None
        h, linear, grams, step = kept[0], kept[1], kept[2], kept[3].copy()
        step[: len(h.shared)] *= share
        step[inference.fixed(h) :] *= share
        mine = inference.reduced(grams, h, forces).own_step(step)
        shared, effects = step[: len(h.shared)], step[inference.fixed(h) :]
        cuts = np.cumsum([len(n) for n in h.numbers])[:-1]
        numbers = tuple(n + e for n, e in zip(h.numbers, np.split(effects, cuts) if h.numbers else [], strict=True))
        path = linear.slopes.moved(shared, mine, effects)
        h = replace(h, shared=h.shared + shared, own=h.own + mine, numbers=numbers, path=path)
    assert kept is not None
    h = kept[0]
    row = []
    for run in range(count, len(simulator.runs)):
        left = inference.left(linear, forces, step, mine[run], run)[: len(inference.noise.runs[run].white)]
        gap = float(np.sqrt(left @ left / max(len(left) - simulator.free, 1)))
        row.append(gap if np.isfinite(gap) else np.inf)
    return row


__all__ = ["gaps_beyond", "oracle", "reader", "removed_share", "true_effect"]
