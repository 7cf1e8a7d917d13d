"""After a tow: what all tows of the day tell so far, against the wish of plan.toml, and which tow would tell most next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..identify.plan import (
    Candidates,
    TowPlan,
    gather,
    prior_information,
    relative_covariance,
    run_information,
    score,
    setting_of,
    tows,
)
from ..identify.plan.plan import NORMAL_95
from ..pipeline.analysis import Batch, compute_motions, identify_batch
from ..pipeline.stages import RunMotion
from ..record.errors import TowlineError
from ..record.plan_file import PlanRequest
from ..record.priors import DERIVATIVE_NAMES
from ..record.results import DerivativesFile
from ..record.toml import read_toml
from .log import logs_of, spoiling
from .session import Wanted

RELEASE_FRAMES = 15
"""The release is where the model stood in the median of so many first frames: a choice, half a second of usual film."""


@dataclass(frozen=True)
class Wish:
    """One derivative against what is wished of it, both half-widths of the 95 % interval in %; ``percent`` None: not
    determined."""

    name: str
    percent: float | None
    wished: float

    @property
    def met(self) -> bool:
        """It is reached."""
        return self.percent is not None and self.percent <= self.wished


@dataclass(frozen=True)
class Next:
    """The tow that helps most, and what is expected with it: half-widths in %, by derivative."""

    plan: TowPlan
    percent: dict[str, float]


@dataclass(frozen=True)
class Standing:
    """Where the day stands.

    Attributes
    ----------
    tows : names of those that are fitted
    result : of their joint fit; None: there is none, ``problem`` says why
    failed : tows that cannot be used, and why: they are to be repeated
    wishes : by derivative; empty without a plan
    next_tow : None: the wish is met, or there is no plan, or no tow is possible
    named : by tow, what was named while it was filmed and may spoil it
    """

    tows: tuple[str, ...]
    result: DerivativesFile | None
    problem: str = ""
    failed: dict[str, str] = field(default_factory=dict)
    wishes: tuple[Wish, ...] = ()
    next_tow: Next | None = None
    named: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def enough(self) -> bool:
        """Every wish is met."""
        return bool(self.wishes) and all(wish.met for wish in self.wishes)


class Day:
    """The tows of a day and what they are for.

    Parameters
    ----------
    plan : plan.toml; None: no wish is known

    Raises
    ------
    InputError : plan.toml cannot be used
    """

    def __init__(self, plan: Path | None = None) -> None:
        self._path = plan
        self._request = None if plan is None else read_toml(plan, PlanRequest)
        self._candidates: Candidates | None = None

    @property
    def wanted(self) -> Wanted:
        """What the plan wants to hear of while a tow is filmed."""
        request = self._request
        return Wanted() if request is None else Wanted(request.limits.wall_m, request.wish.x_v_m)

    def prepare(self, show: Callable[[str, int, int | None], None] | None = None) -> None:
        """Judge every tow that the plan allows, which takes its time: to be done before the first one is filmed.

        Parameters
        ----------
        show : (what, done, of how many)
        """
        if self._request is None or self._path is None:
            return
        request, setting = self._request, setting_of(self._request, self._path.parent)
        self._candidates = gather(setting, request.choices, request.tank.speeds_m_s, request.model.length_pp_m, show)

    def after(self, folders: Sequence[Path]) -> Standing:
        """What the tows so far tell.

        Parameters
        ----------
        folders : their run folders
        """
        batch = compute_motions(folders)
        used = [m for m in batch.runs if m.run.file.kind == "tow"]
        result, problem, failed = None, "no tow can be used" if folders else "no tow yet", batch.failed
        if used:
            try:
                result, problem = identify_batch(Batch(used, batch.failed)).result, ""
                failed = result.failed
            except TowlineError as error:
                problem = str(error)
        used = [m for m in used if m.run.name not in failed]
        named = {m.run.name: tuple(words for log in logs_of(m.run) for words in spoiling(log)) for m in batch.runs}
        standing = Standing(
            tuple(m.run.name for m in used),
            result,
            problem,
            failed,
            self._wishes(result),
            None,
            {name: words for name, words in named.items() if words},
        )
        return standing if standing.enough else replace(standing, next_tow=self._next(used))

    def _wishes(self, result: DerivativesFile | None) -> tuple[Wish, ...]:
        if self._request is None:
            return ()
        known = {} if result is None else result.derivatives
        return tuple(
            Wish(name, percent_of(known[name].value, known[name].std) if name in known else None, wished)
            for name, wished in zip(DERIVATIVE_NAMES, self._request.wish.percents, strict=True)
        )

    def _next(self, done: Sequence[RunMotion]) -> Next | None:
        """By the plan's own forecast: of the tows that are done as they were released, and of each that may be next."""
        if self._request is None or self._path is None:
            return None
        if self._candidates is None:
            self.prepare()
        found, setting = self._candidates, setting_of(self._request, self._path.parent)
        if found is None or not found.plans:
            return None
        plans = [_towed(m) for m in done]
        lengths = [float(m.motion["t_s"].iloc[-1] - m.motion["t_s"].iloc[0]) for m in done]
        have = prior_information(setting)
        for plan, tow in zip(plans, tows(setting, plans, lengths), strict=True):
            have = have + run_information(setting, plan, tow)
        wish = np.array(self._request.wish.percents) / 100 / NORMAL_95
        covariance = relative_covariance(have + found.information)
        best = int(np.argmin(score(self._request.wish.criterion, covariance, wish)))
        sd = np.sqrt(np.diagonal(covariance[best]))
        percent = {name: float(100 * NORMAL_95 * s) for name, s in zip(DERIVATIVE_NAMES, sd, strict=True)}
        return Next(found.plans[best], percent)


def percent_of(value: float, std: float) -> float:
    """Half-width of the 95 % interval, % of the value.

    Parameters
    ----------
    value, std : of a derivative
    """
    return abs(100 * NORMAL_95 * std / value)


def _towed(m: RunMotion) -> TowPlan:
    """A tow as it was done: its rig by run.toml, its release by its first frames."""
    tow = m.run.tow
    first = m.motion[m.motion["status"] == "measured"].iloc[:RELEASE_FRAMES]
    return TowPlan(
        m.run.need(tow.tow_point_m, "tow.tow_point_m"),
        m.run.need(tow.line_length_m, "tow.line_length_m"),
        m.run.need(tow.speed_m_s, "tow.speed_m_s"),
        float(first["y_cg_m"].median()) - tow.post_m[1],
        float(first["beta_rad"].median()),
    )


def standing_lines(standing: Standing) -> list[str]:
    """In words, a line each.

    Parameters
    ----------
    standing : of ``Day.after``
    """
    from ..identify.plan.words import SHORT

    many = len(standing.tows)
    lines = [f"{many} tow{'s' if many != 1 else ''} fitted: {', '.join(standing.tows) or 'none'}"]
    lines += [f"repeat {name}: {why}" for name, why in standing.failed.items()]
    lines += [
        f"look at {name} before it counts, or repeat it: {'; '.join(words)}"
        for name, words in standing.named.items()
        if name not in standing.failed
    ]
    if standing.problem:
        lines.append(f"no derivatives yet: {standing.problem}")
    known = {} if standing.result is None else standing.result.derivatives
    wishes = {wish.name: wish for wish in standing.wishes}
    for name in DERIVATIVE_NAMES:
        wish = wishes.get(name)
        wished = "" if wish is None else f", wished {wish.wished:g} %: {'met' if wish.met else 'not yet'}"
        if name not in known:
            lines.append(f"  {SHORT[name]:4} not determined by these tows{wished}" if known or wish else "")
            continue
        value, std = known[name].value, known[name].std
        lines.append(f"  {SHORT[name]:4} {value:10.3f} +- {std:.3f}  (95 %: +- {percent_of(value, std):.2f} %{wished})")
    if standing.enough:
        lines.append("enough: every wish is met")
    if standing.next_tow is not None:
        plan = standing.next_tow.plan
        worst = max(standing.next_tow.percent.values())
        lines.append(
            f"next, the tow that helps most: X_T {plan.tow_point_m:.3f} m, L {plan.line_length_m:.2f} m, U {plan.speed_m_s:g} m/s, "
            f"released at y {plan.release_y_m:+.2f} m, beta {plan.release_beta_rad:+.3f} rad (then +- {worst:.1f} % or better)"
        )
    return [line for line in lines if line]


__all__ = ["Day", "Next", "Standing", "Wish", "percent_of", "standing_lines"]
