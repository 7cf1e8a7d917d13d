"""What takes several runs: derivatives and steady state, with failed runs kept beside the good ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ..__version__ import __version__
from ..identify import (
    Fit,
    RunData,
    derivatives_file,
    fit_free,
    fit_steady,
    fit_with_noise,
    free_data,
    free_file,
    run_data,
    same_trim,
    six_file,
    steady_file,
    steady_state,
)
from ..identify.bracket import SHEARS, bracket_words, neutral_bracket
from ..identify.cut import cut_of
from ..identify.estimators import Estimator
from ..identify.report import tow_stability
from ..identify.steady import SteadyState, UnsettledError, stands_off
from ..record.each import Each, in_turn
from ..record.errors import EstimationError, InputError, TowlineError
from ..record.exports import derivatives_covariance
from ..record.names import shown
from ..record.priors import Priors
from ..record.results import DerivativesFile, SteadyFile, TowStability
from ..record.run import RUN_FILE, Run, all_inputs, read_run
from ..simulate.model import DERIVATIVE_UNITS, Hull, Line, alpha_from_y
from .missing import KnownLaw, half_width_of, states_of
from .progress import Progress
from .stages import RunMotion, compute_run_motion, compute_static_motion, read_truth

if TYPE_CHECKING:
    from ..identify.reference import Comparison
    from ..report.identify_page import FitPage


@dataclass(frozen=True)
class Batch:
    """Runs with their motion, and those that failed.

    Attributes
    ----------
    runs : in the order given
    failed : folder or run name -> why
    """

    runs: list[RunMotion]
    failed: dict[str, str]


def compute_motions(
    folders: Sequence[str | Path],
    method: str = "exact",
    progress: Progress | None = None,
    fresh: bool = False,
    line: Line | None = None,
) -> Batch:
    """Motion of every run; a bad run is put aside with its reason and the others go on. ``line``: as for ``read_run``.

    Parameters
    ----------
    folders : run folders
    method : one of ``geometry.METHODS``
    progress : is told what is done
    fresh : make it anew even where out/ is up to date
    line : what the tow line keeps, "surge" or "constant", instead of what run.toml says; None: what it says
    """
    runs: list[RunMotion] = []
    failed: dict[str, str] = {}
    for folder in folders:
        name = shown(str(folder))
        try:
            run = read_run(folder, line)
            name = run.name
            if any(m.run.name == name for m in runs) or name in failed:
                raise InputError(
                    run.folder / RUN_FILE, "name", f"{name!r} is another run's name as well; names must differ"
                )
            runs.append(compute_run_motion(run, method, progress, fresh))
        except TowlineError as error:
            failed[name if name not in failed else shown(str(folder))] = str(error)
    return Batch(runs, failed)


def output_folder(folders: Sequence[str | Path]) -> Path:
    """RUN/out for one run, else out/ in the deepest folder that holds all of them."""
    paths = [Path(f).resolve() for f in folders]
    paths = [p.parent if p.name == RUN_FILE else p for p in paths]
    common = paths[0]
    while not all(p == common or common in p.parents for p in paths):
        common = common.parent
    return common / "out"


def by_line(batch: Batch) -> tuple[Batch, Batch]:
    """The runs on a line, and those without (kind "free"); the failed ones go with the first that has a run."""
    towed = [m for m in batch.runs if m.run.file.kind != "free"]
    free = [m for m in batch.runs if m.run.file.kind == "free"]
    return Batch(towed, batch.failed if towed else {}), Batch(free, {} if towed else batch.failed)


def hull_of(run: Run) -> tuple[float, float, float]:
    """What runs of one fit share: length_pp_m, mass_kg, density_kg_m3."""
    return run.model.length_pp_m, run.model.mass_kg, run.water.density_kg_m3


@dataclass(frozen=True)
class Identified:
    """Derivatives with what the page shows of them.

    Attributes
    ----------
    result : derivatives.json
    fitted : run name -> t_s, y_cg_m, beta_rad, alpha_rad of the fit, biases included
    fit, data, runs : the fit, what it was given, and the runs in the same order
    """

    result: DerivativesFile
    fitted: dict[str, pd.DataFrame]
    fit: Fit
    data: list[RunData]
    runs: list[RunMotion]


def identify_batch(
    batch: Batch,
    form: str = "full",
    speed_m_s: float | None = None,
    priors: Priors | None = None,
    progress: Callable[[str], None] | None = None,
    noise: str = "auto",
    each: Each = in_turn,
    kept: Callable[[Callable[[], Fit]], Fit] | None = None,
    law: KnownLaw | None = None,
) -> Identified:
    """Joint fit of the six derivatives over the batch; ``noise`` as in ``identify.fit_with_noise``.

    Parameters
    ----------
    batch : runs with their motion, and what failed
    form : "full" or "linear", as in ``identify.fit_runs``
    speed_m_s : at which the derivatives are quoted; None: the runs' mean
    priors : instead of the runs' own, or None
    progress : is told what is done
    noise : as in ``identify.fit_with_noise``
    each : does a run's share, here or by workers
    kept : gets what fits, and gives the fit: what it says, or what it said before of the same runs
    law : a force that is known beforehand; the derivatives are those beside it

    Raises
    ------
    EstimationError : no run can be used
    """
    data, used, failed = _prepared(batch, priors)
    remarks = _one_hull(used)
    if law is not None:
        if form != "full" or noise == "innovations":
            raise EstimationError("a law is fitted beside in the full form by output error only")
        hull = used[0].run
        force = law.missing(hull.model.length_pp_m, hull.water.density_kg_m3, float("nan"))
        data = [
            replace(d, missing=replace(force, half_width_m=half_width_of(m.run)))
            for d, m in zip(data, used, strict=True)
        ]
        noise = "output"

    def fitted_now() -> Fit:
        return fit_with_noise(data, form, speed_m_s, noise, progress, each)

    fit = fitted_now() if kept is None else kept(fitted_now)
    first = used[0].run
    result = derivatives_file(
        fit,
        data,
        first.model,
        first.water,
        __version__,
        all_inputs([m.run for m in used]) | (law.inputs if law is not None else {}),
        failed,
        _true_six(used, fit.speed_m_s),
    )
    if law is not None:
        remarks = [*remarks, f"fitted beside a law that is taken as known: {law.text}", *_beyond(law, fit, data, used)]
    if (cut := _cut_short(used)) or remarks:
        result = result.model_copy(update={"notes": [*result.notes, *cut, *remarks]})
    fitted = {d.name: _fitted(fit, d, m, i) for i, (d, m) in enumerate(zip(data, used, strict=True))}
    return Identified(result, fitted, fit, data, used)


def _beyond(law: KnownLaw, fit: Fit, data: list[RunData], used: list[RunMotion]) -> list[str]:
    """Where the fitted motions leave the law's range."""
    return [
        f"{m.run.name}: {text}"
        for d, m, fitted in zip(data, used, fit.response, strict=True)
        for text in law.beyond(states_of(d, half_width_of(m.run), *fitted.T))
    ]


def _prepared(batch: Batch, priors: Priors | None) -> tuple[list[RunData], list[RunMotion], dict[str, str]]:
    """What is fitted of each run, those runs, and why others are not; EstimationError where there is none."""
    failed = dict(batch.failed)
    data: list[RunData] = []
    used: list[RunMotion] = []
    for m in batch.runs:
        try:
            data.append(run_data(m.run, m.motion, m.common, priors, compute_static_motion(m.run), m.lag))
            used.append(m)
        except TowlineError as error:
            failed[m.run.name] = str(error)
    if not used:
        raise EstimationError(next(iter(failed.values()), "no run to fit"))
    return data, used, failed


def estimate_batch(
    batch: Batch, estimator: Estimator, speed_m_s: float | None = None, priors: Priors | None = None
) -> DerivativesFile:
    """The six derivatives by another way than the joint fit.

    Parameters
    ----------
    batch : runs with their motion, and what failed
    estimator : of ``identify.estimators``
    speed_m_s : at which the derivatives are quoted; None: the runs' mean
    priors : instead of the runs' own, or None

    Raises
    ------
    EstimationError : no run can be used, or the runs are not what the estimator needs
    """
    data, used, failed = _prepared(batch, priors)
    remarks = _one_hull(used)
    speed = float(np.mean([d.tow.speed_m_s for d in data])) if speed_m_s is None else speed_m_s
    found = estimator.estimate(data, speed)
    first = used[0].run
    result = six_file(
        estimator,
        found,
        speed,
        first.model,
        first.water,
        __version__,
        all_inputs([m.run for m in used]),
        failed,
        _true_six(used, speed),
    )
    return result.model_copy(update={"notes": [*result.notes, *_cut_short(used), *remarks]})


def _one_hull(used: Sequence[RunMotion]) -> list[str]:
    """What must be said of the runs' trims; EstimationError where the runs are not of one hull in one water."""
    hulls = {hull_of(m.run) for m in used}
    if len(hulls) > 1:
        raise EstimationError(
            f"the runs are not of one hull in one water: (length_pp_m, mass_kg, density_kg_m3) = {sorted(hulls)}"
        )
    return same_trim({m.run.name: m.run.model.trim_rad for m in used})


@dataclass(frozen=True)
class FreeIdentified:
    """What free runs give, with what the page shows of them.

    Attributes
    ----------
    result : derivatives.json, method "free_run"
    fitted : run name -> t_s, y_cg_m, beta_rad of the fit
    runs : as fitted
    """

    result: DerivativesFile
    fitted: dict[str, pd.DataFrame]
    runs: list[RunMotion]


def identify_free_batch(
    batch: Batch, speed_m_s: float | None = None, priors: Priors | None = None, towed: Identified | None = None
) -> FreeIdentified:
    """Joint fit of free runs: the rudder and the ratios, or, with the tows of the same hull, everything in newtons.

    Parameters
    ----------
    batch : runs with their motion, and what failed
    speed_m_s : at which the values are quoted; None = the tows', or the runs' mean
    priors : instead of each run's own
    towed : the fit of tows whose derivatives and covariance the free runs are read with

    Raises
    ------
    EstimationError : no run can be used, the runs are not of one hull, or the rudder never moves
    """
    failed = dict(batch.failed)
    data, used = [], []
    for m in batch.runs:
        try:
            data.append(free_data(m.run, m.motion, m.common, priors, m.lag))
            used.append(m)
        except TowlineError as error:
            failed[m.run.name] = str(error)
    if not used:
        raise EstimationError(next(iter(failed.values()), "no run to fit"))
    first = used[0].run
    water = next((m.run.water for m in used if m.run.file.water is not None), None)
    if len({(m.run.model.length_pp_m, m.run.model.mass_kg) for m in used}) > 1:
        raise EstimationError("the free runs are not of one hull: length_pp_m or mass_kg differ")
    remarks = same_trim({m.run.name: m.run.model.trim_rad for m in (*used, *(towed.runs if towed else ()))})
    known = None
    if towed is not None:
        whole = towed.runs[0].run
        if (whole.model.length_pp_m, whole.model.mass_kg) != (first.model.length_pp_m, first.model.mass_kg):
            raise EstimationError("tows and free runs are not of one hull: length_pp_m or mass_kg differ")
        water = whole.water
        if set(DERIVATIVE_UNITS) <= set(towed.result.derivatives):
            six = np.array([towed.result.derivatives[name].value for name in DERIVATIVE_UNITS])
            known = six, derivatives_covariance(towed.result, tuple(DERIVATIVE_UNITS)), towed.result.speed_m_s
        else:
            remarks.append("the tows do not determine all six derivatives: the free runs were fitted without them")
    fit = fit_free(data, speed_m_s, known)
    result = free_file(
        fit,
        data,
        first.model.length_pp_m,
        first.model.mass_kg,
        None if water is None else water.density_kg_m3,
        __version__,
        all_inputs([m.run for m in (*used, *(towed.runs if towed else ()))]),
        failed,
        _true_hull(used),
    )
    result = result.model_copy(update={"notes": [*result.notes, *remarks]})
    return FreeIdentified(result, {d.name: f for d, f in zip(data, fit.fitted, strict=True)}, used)


def fit_page(
    answer: Identified,
    compared: Comparison | None = None,
    progress: Callable[[str], None] | None = None,
    each: Each = in_turn,
) -> FitPage:
    """What the page of a fit shows: beside the fit, whether the runs agree, and what it left.

    Parameters
    ----------
    answer : of ``identify_batch``
    compared : against a reference, or None
    progress : is told what is done
    each : does a run's share, here or by workers
    """
    from ..identify.consistency import consistency, judged
    from ..report.identify_page import FitPage

    return FitPage(
        result=answer.result,
        fit=answer.fit,
        data=answer.data,
        motion={m.run.name: m.motion for m in answer.runs},
        fitted=answer.fitted,
        agreed=consistency(answer.fit, answer.data, progress, each),
        judged=judged(answer.fit, answer.data),
        compared=compared,
    )


def _fitted(fit: Fit, data: RunData, m: RunMotion, index: int) -> pd.DataFrame:
    y, beta = fit.response[index].T
    tow = data.tow
    post, _ = tow.post_motion(data.t_s)
    return pd.DataFrame(
        {
            "t_s": data.t_s,
            "y_cg_m": y + m.run.tow.post_m[1],
            "beta_rad": beta,
            "alpha_rad": alpha_from_y(y, beta, replace(tow, post_m=(tow.post_m[0], 0.0)), post),
        }
    )


def _true_six(runs: Sequence[RunMotion], speed_m_s: float) -> dict[str, float] | None:
    """The rendered runs' derivatives at the fit's speed, where all runs carry the same."""
    found = []
    for m in runs:
        truth = read_truth(m.run)
        if truth is None or not set(DERIVATIVE_UNITS) <= set(truth.derivatives):
            return None
        six = [truth.derivatives[name] for name in DERIVATIVE_UNITS]
        found.append(Hull(*six, speed_m_s=truth.speed_m_s).at_speed(speed_m_s).six)
    if not np.allclose(found, found[0], rtol=1e-9):
        return None
    return dict(zip(DERIVATIVE_UNITS, (float(x) for x in found[0]), strict=True))


def _true_hull(runs: Sequence[RunMotion]) -> Hull | None:
    """The hull that rendered runs were made from, where all carry the same."""
    truths = [read_truth(m.run) for m in runs]
    first = truths[0]
    if first is None or any(
        t is None or (t.derivatives, t.speed_m_s) != (first.derivatives, first.speed_m_s) for t in truths
    ):
        return None
    try:
        return Hull(**first.derivatives, speed_m_s=first.speed_m_s)
    except TypeError:  # it names what this simulator does not know
        return None


def fit_steady_batch(batch: Batch) -> SteadyFile:
    """Neutral point of the batch's steady tows; those that still swing, drift or shear off are failed runs.

    Raises
    ------
    EstimationError : fewer than two usable tows
    """
    failed = dict(batch.failed)
    tows: list[SteadyState] = []
    used: list[RunMotion] = []
    seen: dict[str, TowStability] = {}
    for m in batch.runs:
        try:
            tows.append(steady_state(m.run, m.motion, m.common))
            used.append(m)
            seen[m.run.name] = tow_stability(m.run, tows[-1].stability)
        except UnsettledError as error:
            failed[m.run.name] = str(error)
            seen[m.run.name] = tow_stability(m.run, error.stability)
        except TowlineError as error:
            failed[m.run.name] = str(error)
    if len(tows) < 2:
        reasons = "; ".join(f"{name}: {why}" for name, why in failed.items())
        bracket = neutral_bracket(seen, standing_off=[tow.name for tow in tows if stands_off(tow)])
        known = bracket_words(bracket) if bracket is not None else ""
        raise EstimationError(
            f"{len(tows)} steady tows; two or more are needed{f' ({reasons})' if reasons else ''}{f'; {known}' if known else ''}"
        )
    remarks = same_trim({t.name: t.trim_rad for t in tows})
    fit = fit_steady(tows, used[0].run.model.x_delta_m)
    truths = {t.x_v_m for m in used if (t := read_truth(m.run)) is not None}
    true_x_v = truths.pop() if len(truths) == 1 else None
    result = steady_file(fit, tows, __version__, all_inputs([m.run for m in used]), failed, true_x_v, seen)
    return result.model_copy(update={"notes": [*result.notes, *_cut_short(batch.runs), *remarks]})


def _cut_short(runs: Sequence[RunMotion]) -> list[str]:
    """Which of the runs end early, and why: the model touched the wall, or was lost for good."""
    cuts = {m.run.name: cut_of(m.run, m.motion) for m in runs}
    return [f"run {name!r}: {cut.words}" for name, cut in cuts.items() if cut is not None]


def good_for(m: RunMotion) -> tuple[str, ...]:
    """What a run is analysed for, by its motion and by whether T is known: "derivatives", "steady", both or none.

    A tow without a known tension gives its steady state, or, swinging on a line that keeps its length, derivatives: its mass weighs
    the pull. One with it gives derivatives, and beside them its steady state where it has settled off the line behind its post,
    whatever rudder_rad says; one that was there from its first frame on holds nothing of the six. A tow that shears off stands
    with the steady ones: it brackets X_v.
    """
    if m.run.file.kind == "free" or m.run.file.tow is None:
        return ()
    if m.run.file.kind != "tow":
        return ("derivatives",) if has_tension(m) else ()
    known = has_tension(m)
    if not known and m.run.file.tow.line == "constant":
        return ("steady",)
    try:
        tow = steady_state(m.run, m.motion, m.common)
    except UnsettledError as error:
        return ("derivatives", "steady") if error.stability.verdict == SHEARS else ("derivatives",)
    except TowlineError:
        return ("derivatives",)
    if not stands_off(tow):
        return ("derivatives",)
    return ("steady",) if tow.whole or not known else ("derivatives", "steady")


def has_rudder(m: RunMotion) -> bool:
    """A free run whose rudder is known: stated over, or by its history."""
    tow = m.run.file.tow
    return m.run.file.kind == "free" and tow is not None and (tow.rudder is not None or tow.rudder_rad != 0.0)


def has_tension(m: RunMotion) -> bool:
    """T is known: stated, logged, or in the motion."""
    tow = m.run.file.tow
    if tow is None:
        return False
    return bool(
        tow.tension_n is not None
        or tow.tension is not None
        or ("tension_n" in m.motion and m.motion["tension_n"].notna().any())
    )
