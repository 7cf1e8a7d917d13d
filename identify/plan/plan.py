"""plan.toml -> plan.json: which tows, and how many, bring each derivative to its wished interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...record.errors import EstimationError, InputError
from ...record.plan_file import Campaign, PlanFile, PlanRequest, RuleTable, RunForecast
from ...record.results import DerivativesFile, read_result
from ...simulate.model import DERIVATIVE_UNITS, Array, Hull
from ..data import Missing, RunData, usual_resistance
from ..prime import prime_factors
from ..reference import ReferenceSet, reference_set, set_of_result
from .candidates import Candidates, gather, nearer, plan_text
from .checks import Conduct, conduct
from .choose import best_campaigns
from .information import planned_record, prior_information, relative_covariance, run_information
from .kept import tows
from .releases import release_rows, release_rule
from .rules import cycles_rule, swing_sensitivity, transient_rule
from .setting import Setting, TowPlan

NORMAL_95 = 1.959964
"""97.5 % quantile of the normal distribution, to six decimals: half of a two-sided 95 % interval."""
HULL_LENGTH_LBP, BREADTH_LBP = 1.05, 0.15
"""Length overall and breadth of a usual merchant hull, where the plan does not state them (the MARINER's breadth:
1/6.9)."""


def guessed_hull(request: PlanRequest, folder: Path) -> Hull:
    """The guess for the plan's model, water and mass, quoted at choices.tension_speed_m_s.

    Parameters
    ----------
    request : the content of plan.toml
    folder : where paths of the request begin

    Raises
    ------
    InputError : the named file cannot be used
    """
    guess, model, density = request.guess, request.model, request.water.density_kg_m3
    speed = request.choices.tension_speed_m_s
    if guess.dimensional is not None:
        table = guess.dimensional
        return Hull(*(getattr(table, name) for name in DERIVATIVE_UNITS), speed_m_s=table.speed_m_s).at_speed(speed)
    if guess.prime is not None:
        found = ReferenceSet("prime", "", np.array([getattr(guess.prime, n) for n in DERIVATIVE_UNITS]), np.zeros(6))
    elif guess.derivatives is not None:
        found = set_of_result(read_result(folder / guess.derivatives, DerivativesFile))
    else:
        assert guess.reference is not None
        found = reference_set(guess.reference, folder)
    return found.hull(density, model.length_pp_m, speed, model.mass_kg, model.yaw_inertia_kg_m2)


def setting_of(request: PlanRequest, folder: Path) -> Setting:
    """What the request asks the plan to be made for.

    Parameters
    ----------
    request : the content of plan.toml
    folder : where paths of the request begin
    """
    model, choices = request.model, request.choices
    tension = choices.tension_n
    if tension is None:
        tension = usual_resistance(model.mass_kg, model.length_pp_m, choices.tension_speed_m_s)
    return Setting(
        hull=guessed_hull(request, folder),
        tension_n=tension,
        tension_speed_m_s=choices.tension_speed_m_s,
        way_m=request.tank.length_m - request.tank.lost_m,
        width_m=request.tank.width_m,
        hull_length_m=model.hull_length_m or HULL_LENGTH_LBP * model.length_pp_m,
        breadth_m=model.breadth_m or BREADTH_LBP * model.length_pp_m,
        mass_kg=model.mass_kg,
        noise=request.noise,
        priors=request.priors,
        limits=request.limits,
        line=request.tow.line,
        gauge=request.tow.gauge,
        length_pp_m=model.length_pp_m,
        unlike_speeds=len(set(request.tank.speeds_m_s)) > 1,
    )


def make_plan(
    request: PlanRequest,
    path: Path,
    tool: str,
    inputs: dict[str, str],
    show: Callable[[str, int, int | None], None] | None = None,
    missing: Missing | None = None,
    outside: Callable[[RunData, Array, Array], list[str]] | None = None,
) -> PlanFile:
    """Choose the runs.

    Parameters
    ----------
    request : the content of plan.toml
    path : of plan.toml; files that it names start at its folder
    tool : version of towline, as the file states it
    inputs : name of an input -> its SHA-256, as the file states them
    show : (what, done, of how many)
    missing : a force on the hull that is known beforehand; of lines that keep their length
    outside : of a planned record and its motion (y_m, beta_rad): where nothing is known of that force, a sentence each

    Raises
    ------
    InputError : the guess or a run cannot be used
    EstimationError : no run is possible within the limits
    """
    setting = setting_of(request, path.parent)
    refuse_unusable(setting, request, path)
    if missing is not None:
        if setting.line != "surge":
            raise InputError(path, "tow.line", f'{setting.line!r}; a law is planned with where line = "surge"')
        setting = replace(setting, missing=missing)
    found = gather(setting, request.choices, request.tank.speeds_m_s, request.model.length_pp_m, show)
    if not found.plans:
        reasons = "; ".join(f"{count} x {found.example[kind]}" for kind, count in found.excluded.items())
        raise EstimationError(f"{path}: no tow is possible within [limits]: {reasons}")
    prior = prior_information(setting)
    wish = np.array(request.wish.percents) / 100 / NORMAL_95
    if setting.line == "surge":
        found = nearer(setting, found, [i for c in ("A", "D") for i in _best(setting, request, found, wish, c)[-1]])
    made: dict[str, list[Campaign]] = {}
    for criterion in ("A", "D"):
        made[criterion] = [
            _campaign(
                setting,
                [found.plans[i] for i in chosen],
                [found.conducts[i] for i in chosen],
                prior + found.information[chosen].sum(axis=0),
                wish,
            )
            for chosen in _best(setting, request, found, wish, criterion)
        ]
    ours = made[request.wish.criterion]
    chosen = next((c for c in ours if c.reached), ours[-1])
    plans = _plans_of(chosen)
    own_plans = [
        TowPlan(r.tow_point_m, r.line_length_m, r.speed_m_s, r.release_y_m, r.release_beta_rad) for r in request.run
    ]
    own = judged(setting, own_plans, wish) if own_plans else None
    rows = release_rows(setting, own_plans or plans) if setting.line == "surge" else []
    return PlanFile(
        schema="towline/plan",
        tool=tool,
        inputs=inputs,
        speed_m_s=setting.hull.speed_m_s,
        guess={name: float(v) for name, v in zip(DERIVATIVE_UNITS, setting.values, strict=True)},
        wished_percent=dict(zip(DERIVATIVE_UNITS, request.wish.percents, strict=True)),
        candidates=len(found.plans),
        excluded=found.excluded,
        excluded_example=found.example,
        a_optimal=made["A"],
        d_optimal=made["D"],
        chosen=chosen,
        runs_needed=_needed(ours, request.wish.percents),
        own=own,
        rules=thesis_rules(setting, own_plans or plans),
        line=setting.line,
        gauge=setting.gauge,
        releases=rows,
        release_rule=release_rule(setting, rows) if rows else None,
        notes=[*_notes(setting, request, chosen, ours), *_outside(setting, own_plans or plans, outside)],
    )


def _outside(
    setting: Setting, plans: Sequence[TowPlan], outside: Callable[[RunData, Array, Array], list[str]] | None
) -> list[str]:
    """Where planned runs go beyond what is known of the missing force."""
    if outside is None:
        return []
    told = ["planned beside a law that is taken as known"]
    for k, (plan, tow) in enumerate(zip(plans, tows(setting, plans), strict=True), start=1):
        course = tow.course(setting, plan)
        record = planned_record(setting, plan, tow.times_s)
        told += [f"run {k}: {text}" for text in outside(record, course.y_m, course.beta_rad)]
    return told


def _best(setting: Setting, request: PlanRequest, found: Candidates, wish: Array, criterion: str) -> list[list[int]]:
    return best_campaigns(found.information, prior_information(setting), wish, criterion, request.wish.max_runs)


def judged(setting: Setting, plans: Sequence[TowPlan], wish: Array | None = None) -> Campaign:
    """A given campaign: what it is expected to give, and its warnings. ``wish``: relative sd (6,) asked for.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    wish : (6,) relative standard deviations asked for, or None
    """
    setting = replace(setting, unlike_speeds=len({p.speed_m_s for p in plans}) > 1)
    total = prior_information(setting)
    conducts = []
    for plan, tow in zip(plans, tows(setting, plans), strict=True):
        conducts.append(conduct(setting, plan, tow))
        total = total + run_information(setting, plan, tow)
    return _campaign(setting, list(plans), conducts, total, np.full(6, np.inf) if wish is None else wish)


def thesis_rules(setting: Setting, plans: Sequence[TowPlan]) -> list[RuleTable]:
    """The thesis's rules with the numbers of ``plans``, the first one alone and all together.

    Parameters
    ----------
    setting : hull, tank, gauge and limits that the plan is made for
    plans : the tows, in their order
    """
    first = plans[0]
    together = f"all {len(plans)} runs"
    rules = [
        RuleTable(
            rule=f"two cycles are too few: sd in %, first run alone ({plan_text(first)})",
            rows=cycles_rule(setting, [first]),
        ),
    ]
    if len(plans) > 1:
        rules.append(RuleTable(rule=f"two cycles are too few: sd in %, {together}", rows=cycles_rule(setting, plans)))
    moved = [{"run": float(i), **swing_sensitivity(setting, p)} for i, p in enumerate(plans, 1)]
    rules.append(
        RuleTable(
            rule="L and X_T change the frequency: per metre of line and of tow point, and per m/s (T grows with U^2), of each run",
            rows=[row for row in moved if len(row) > 1],
        )
    )
    rules.append(
        RuleTable(
            rule="the release must be recorded: sd in % without the first seconds, first run alone",
            rows=transient_rule(setting, [first]),
        )
    )
    if len(plans) > 1:
        rules.append(
            RuleTable(
                rule=f"the release must be recorded: sd in % without the first seconds, {together}",
                rows=transient_rule(setting, plans),
            )
        )
    return rules


def refuse_unusable(setting: Setting, request: PlanRequest, path: Path) -> None:
    """Refuse what no plan can be made with.

    Parameters
    ----------
    setting : of ``setting_of``
    request : plan.toml
    path : of plan.toml, for the error

    Raises
    ------
    InputError : a tension, derivative, speed or release that moves nothing
    """
    if setting.tension_n <= 0:
        raise InputError(path, "choices.tension_n", f"{setting.tension_n:g} N; a tension above 0 is expected")
    for name, value in zip(DERIVATIVE_UNITS, setting.values, strict=True):
        if value == 0 or not np.isfinite(value):
            raise InputError(path, "guess", f"{name} is {value:g}; an interval in % needs a value that is not 0")
        if name.endswith("dot") and value < 0:
            raise InputError(path, "guess", f"{name} is {value:g} for this model's mass; a value above 0 is expected")
    for number, run in enumerate(request.run, 1):
        if run.speed_m_s <= 0:
            raise InputError(path, f"run[{number}].speed_m_s", f"{run.speed_m_s:g} m/s; a speed above 0 is expected")
        if run.release_y_m == 0 and run.release_beta_rad == 0:
            raise InputError(
                path,
                f"run[{number}].release_y_m",
                "0 m and heading 0: nothing moves; a release off the centre line is expected",
            )


def _campaign(
    setting: Setting, plans: Sequence[TowPlan], conducts: Sequence[Conduct], information: Array, wish: Array
) -> Campaign:
    covariance = relative_covariance(information)
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / sd[:, None] / sd[None, :]
    return Campaign(
        runs=[_forecast(setting, p, c) for p, c in zip(plans, conducts, strict=True)],
        percent={name: float(100 * NORMAL_95 * s) for name, s in zip(DERIVATIVE_UNITS, sd, strict=True)},
        sd_percent={name: float(100 * s) for name, s in zip(DERIVATIVE_UNITS, sd, strict=True)},
        reached=bool((sd <= wish).all()),
        correlation=correlation.tolist(),
    )


def _forecast(setting: Setting, plan: TowPlan, found: Conduct) -> RunForecast:
    return RunForecast(
        tow_point_m=plan.tow_point_m,
        line_length_m=plan.line_length_m,
        speed_m_s=plan.speed_m_s,
        tension_n=setting.tow(plan).resistance,
        release_y_m=plan.release_y_m,
        release_beta_rad=plan.release_beta_rad,
        duration_s=found.duration_s,
        omega_rad_s=found.omega_rad_s,
        damping_per_s=found.damping_per_s,
        cycles=found.cycles,
        largest_angle_rad=min(found.largest_angle_rad, 1e6),
        wall_room_m=max(found.wall_room_m, -1e6),
        line_share=max(found.line_share, -1e6),
        warnings=list(found.warnings.values()),
    )


def _plans_of(campaign: Campaign) -> list[TowPlan]:
    return [
        TowPlan(r.tow_point_m, r.line_length_m, r.speed_m_s, r.release_y_m, r.release_beta_rad) for r in campaign.runs
    ]


def _needed(campaigns: Sequence[Campaign], wished: Sequence[float]) -> dict[str, int | None]:
    """Runs from which on each derivative keeps its wish in every larger campaign too."""
    needed: dict[str, int | None] = {}
    for name, wish in zip(DERIVATIVE_UNITS, wished, strict=True):
        kept = [c.percent[name] <= wish for c in campaigns]
        late = max((i for i, ok in enumerate(kept) if not ok), default=-1)
        needed[name] = late + 2 if late + 1 < len(kept) else None
    return needed


def _notes(setting: Setting, request: PlanRequest, chosen: Campaign, ours: Sequence[Campaign]) -> list[str]:
    notes = ["the plan holds for the guess: plan again with the first run's derivatives.json"]
    priors = setting.priors
    scatter = np.array([setting.tension_scatter(p) for p in _plans_of(chosen)])
    if setting.line == "constant" and scatter.all():
        notes.append(
            f"the scatter of T ({100 * scatter.min():.2g} to {100 * scatter.max():.2g} % in a run) puts a floor of "
            f"{100 / np.sqrt((1 / scatter**2).sum()):.2g} % (sd) under every derivative of the chosen campaign; only "
            "more runs or a better force gauge lower it"
        )
    if setting.line == "surge" and not setting.gauge:
        notes.append(
            "no gauge: nearly all that is left of the scale is X_udot, for the motion tells (m - X_udot)/T; [priors.surge] "
            "x_udot_kg, or a gauge, makes it smaller"
        )
        if request.choices.tension_n is None:
            notes.append(
                f"T of {setting.tension_n:.2f} N at {setting.tension_speed_m_s:g} m/s is a bare hull's of this size"
            )
    if setting.line == "constant" and priors.tension_common_sd_rel:
        notes.append(
            f"T's common error of {100 * priors.tension_common_sd_rel:.2g} % stays in every derivative, however many runs"
        )
    if not chosen.reached:
        wished = dict(zip(DERIVATIVE_UNITS, request.wish.percents, strict=True))
        missed = [f"{n} {chosen.percent[n]:.2f} % (wished {w:g} %)" for n, w in wished.items() if chosen.percent[n] > w]
        notes.append(f"not reached with {len(ours)} runs: " + ", ".join(missed))
    short = sum(any("cycles" in w for w in r.warnings) for r in chosen.runs)
    if short:
        notes.append(
            f"{short} of the chosen runs hold no more than {request.limits.cycles:g} cycles: this tank allows no longer ones"
        )
    same = len(chosen.runs) - len({(r.tow_point_m, r.line_length_m, r.speed_m_s) for r in chosen.runs})
    if same:
        notes.append(
            f"{same} of the runs repeat a tow of the campaign: good for the numbers, but a new tow point or line "
            "also tests the equations"
        )
    factors = prime_factors(request.water.density_kg_m3, request.model.length_pp_m, setting.hull.speed_m_s)
    notes.append(
        "guess in primes x 1e3: "
        + ", ".join(f"{n} {1e3 * v:.3f}" for n, v in zip(DERIVATIVE_UNITS, setting.values / factors, strict=True))
    )
    return notes
