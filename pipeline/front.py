"""The front door: what a user calls, one function a step; ``towline`` offers these names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ..record.errors import TowlineError
from ..record.run import Run, read_run
from ..record.threads import one_thread

if TYPE_CHECKING:
    import pandas as pd

    from ..diagnose.own import Model
    from ..record.budget_file import BudgetFile
    from ..record.check_file import CheckFile
    from ..record.gap_file import GapFile
    from ..record.priors import Priors
    from ..record.results import DerivativesFile, SteadyFile
    from ..record.schema import Line

Folder = str | Path
Form = Literal["full", "linear"]
Noise = Literal["auto", "output", "innovations"]


def track(run: Folder | Run, *, device: Literal["cpu", "cuda"] = "cpu", fresh: bool = False) -> pd.DataFrame:
    """Find the marks in every frame of a run's video.

    What was tracked before and still fits is read from ``out/tracks.csv``; what is tracked now is written there.

    Parameters
    ----------
    run : run folder, its run.toml, or what ``read_run`` gives
    device : where the fits of marks run
    fresh : track again, even if nothing has changed

    Returns
    -------
    pandas.DataFrame
        a row a frame and mark: ``frame``, ``t_s``, ``marker``, ``u_px``, ``v_px``, ``sigma_u_px``, ``sigma_v_px``, ``status``
        ("measured", "lost"), and ``reason`` where it is lost

    Raises
    ------
    InputError : run.toml is wrong, or its video is not what it describes
    VideoError : the video cannot be read
    TrackingError : a mark is nowhere to be found

    Examples
    --------
    >>> import towline
    >>> tracks = towline.track("sample_videos/mariner/x1446")
    >>> bool((tracks.status == "measured").mean() > 0.9)
    True
    """
    from .stages import track_run

    return track_run(_run(run), fresh=fresh, device=device).table


@one_thread()
def compute_motion(
    run: Folder | Run,
    *,
    method: Literal["exact", "trapezoid", "trapezoid_corners"] = "exact",
    line: Line | None = None,
    fresh: bool = False,
) -> pd.DataFrame:
    """Marks to the model's motion in the tank: y_CG, heading beta, tow line angle alpha.

    Tracks the video first where that was not done yet. Written to ``out/motion.csv``, with the camera in ``out/camera.json``.

    Parameters
    ----------
    run : run folder, its run.toml, or what ``read_run`` gives
    method : "exact": the plane at each mark's own depth; the others are the thesis's (4.2)
    line : what the tow line keeps, instead of ``tow.line``; only where ``run`` is a folder
    fresh : track again

    Returns
    -------
    pandas.DataFrame
        a row a frame: ``t_s``, ``y_cg_m``, ``beta_rad``, ``alpha_rad``, each with ``sigma_...`` (frame by frame) and
        ``common_...`` (the camera's), and ``status``

    Raises
    ------
    InputError : run.toml is wrong
    GeometryError : the datum or the marks do not give a plane

    Examples
    --------
    >>> import towline
    >>> motion = towline.compute_motion("sample_videos/mariner/x1446")
    >>> bool(motion.sigma_y_cg_m.median() < 1e-3)
    True
    """
    from .stages import compute_run_motion

    return compute_run_motion(_run(run, line), method, fresh=fresh).motion


@one_thread()
def check_camera(*runs: Folder, refine: Sequence[str] = (), effects: bool = True) -> list[CheckFile]:
    """Is the camera right? One fit of datum, marks and the taut line to runs of one set-up.

    Parameters
    ----------
    runs : run folders; those of one camera, datum and set of marks are checked together
    refine : parameters to estimate, as ``towline check --refine``
    effects : also say what each parameter's uncertainty does to each derivative

    Returns
    -------
    list of CheckFile
        one a set-up: ``verdict`` ("sound", "fault", "unknown"), the ``faults`` with their sizes, and ``sentences``

    Raises
    ------
    TowlineError : no run can be checked

    Examples
    --------
    >>> import towline
    >>> [check] = towline.check_camera("sample_videos/mariner/x1446", effects=False)
    >>> check.verdict
    'sound'
    """
    from .checking import checked, filmed_runs, set_ups

    found, tables, failed = filmed_runs(list(runs), _silent)
    if not found:
        raise TowlineError("; ".join(failed.values()) or "no run to check")
    return [checked(own, tracks, refine, effects).file for _, own, tracks in set_ups(found, tables)]


@one_thread()
def identify(
    *runs: Folder,
    form: Form = "full",
    speed_m_s: float | None = None,
    priors: Priors | None = None,
    noise: Noise = "auto",
    line: Line | None = None,
    estimator: str | None = None,
) -> DerivativesFile:
    """The six linear sway and yaw derivatives from tows of one hull, fitted together by state-space prediction error.

    Parameters
    ----------
    runs : run folders of towed runs; films are tracked where that was not done yet
    form : "full": full sines and kinematics; "linear": the linear equations
    speed_m_s : at which the derivatives are quoted; default: the runs' mean
    priors : instead of each run's ``[priors]``
    noise : "output": output error; "innovations": a force pushes the hull about; "auto": what the residuals show
    line : what every tow line keeps, instead of ``tow.line``
    estimator : another way than the joint fit, by its name (``identify.estimators``); ``form`` and ``noise`` are the joint fit's

    Returns
    -------
    DerivativesFile
        ``derivatives`` by name (``y_v``, ...), each with ``value``, ``std``, ``unit`` and its prime; what cannot be told
        stands in ``not_identifiable``, runs that were left out in ``failed``

    Raises
    ------
    EstimationError : no run can be used, the runs are not of one hull, or no motion fits them

    Examples
    --------
    >>> import towline
    >>> found = towline.identify("sample_videos/mariner/x1446", "sample_videos/mariner/x1649")
    >>> found.derivatives["y_v"].unit
    'N s/m'
    """
    from .analysis import compute_motions, estimate_batch, identify_batch

    if estimator is not None:
        from ..identify.estimators import estimator_of

        return estimate_batch(compute_motions(runs, line=line), estimator_of(estimator), speed_m_s, priors)
    return identify_batch(compute_motions(runs, line=line), form, speed_m_s, priors, noise=noise).result


@one_thread()
def steady(*runs: Folder, line: Line | None = None) -> SteadyFile:
    """The neutral point X_v from steady tows at two or more tow points.

    Parameters
    ----------
    runs : run folders
    line : what every tow line keeps, instead of ``tow.line``

    Returns
    -------
    SteadyFile
        ``x_v_m`` with its standard deviation; tows that still swing or drift stand in ``failed`` with the reason

    Raises
    ------
    EstimationError : fewer than two tows can be used

    Examples
    --------
    >>> import towline
    >>> holes = [f"sample_videos/leander_steady/hole{k}" for k in (3, 4, 5, 6)]
    >>> bool(towline.steady(*holes).x_v_m.std < 0.05)
    True
    """
    from .analysis import compute_motions, fit_steady_batch

    return fit_steady_batch(compute_motions(runs, line=line))


@one_thread()
def budget(
    *runs: Folder,
    inputs: Folder | None = None,
    gap: Folder | None = None,
    form: Form = "full",
    speed_m_s: float | None = None,
    priors: Priors | None = None,
    noise: Noise = "auto",
    line: Line | None = None,
) -> BudgetFile:
    """The uncertainty budget of the derivatives and of X_v by the GUM: every source with its share.

    Parameters
    ----------
    runs : run folders of towed runs of one hull
    inputs : TOML that says more of the lines than run.toml does (docs/budget.md)
    gap : gap.json of the same runs, whose verdict is the model form's line
    form : as ``identify`` takes
    speed_m_s : as ``identify`` takes
    priors : as ``identify`` takes
    noise : as ``identify`` takes
    line : as ``identify`` takes

    Returns
    -------
    BudgetFile
        ``quantities`` with combined and expanded uncertainty, the ``lines`` of all sources, correlations, what is carried on

    Raises
    ------
    EstimationError : as of ``identify``; or the runs do not determine all six derivatives
    InputError : ``inputs`` names no line, or a file cannot be read

    Examples
    --------
    >>> import towline
    >>> found = towline.budget("sample_videos/mariner/x1446", "sample_videos/mariner/x1649")
    >>> found.closure < 0.01
    True
    """
    from .analysis import compute_motions, identify_batch
    from .budgeting import budget_batch

    answer = identify_batch(compute_motions(runs, line=line), form, speed_m_s, priors, noise=noise)
    return budget_batch(answer, None if inputs is None else Path(inputs), None if gap is None else Path(gap))


def diagnose(
    *runs: Folder,
    held_out: Sequence[Folder] = (),
    effects: Sequence[Folder] = (),
    reference: Folder | None = None,
    line: Line | None = None,
    hull: Folder | None = None,
) -> GapFile:
    """Where simulator and tank differ, which unmodelled effect causes it, and how far the gap shrinks with it.

    Parameters
    ----------
    runs : run folders of one hull
    held_out : runs kept aside to say how far the gap shrinks; default: each in turn
    effects : Python files with effects of one's own (their code is run)
    reference : a derivatives.json to start from
    line : what every tow line keeps, instead of ``tow.line``
    hull : an FMU of another towing simulator's hull, in place of towline's own equations of it (its code is run)

    Returns
    -------
    GapFile
        ``verdict`` ("no_gap", "effect", "form_not_exact", "unknown", "not_converged"), ``where`` it lies, the ``ranking`` of
        effects with their probabilities, the next run that would tell most, and ``sentences`` that say it in words

    Raises
    ------
    EstimationError : the simulator cannot follow the runs at all

    Examples
    --------
    >>> import towline
    >>> gap = towline.diagnose("sample_videos/mariner/x1446", "sample_videos/mariner/x1649")
    >>> gap.verdict
    'no_gap'
    """
    from .diagnosing import diagnose_folders

    given, aside, own = ([Path(one) for one in some] for some in (runs, held_out, effects))
    judged, equations = (None if one is None else Path(one) for one in (reference, hull))
    return diagnose_folders(given, aside, own, judged, line=line, hull=equations).diagnosis.file


def gap(
    model: Folder | Model,
    *tables: Folder,
    columns: Folder | None = None,
    held_out: Sequence[Folder] = (),
    tried: Sequence[Folder] = (),
) -> GapFile:
    """What a model of your own misses against measured records: which effect, where, and how far the gap shrinks with it.

    Parameters
    ----------
    model : a Python file with a ``Model`` (its code is run), an FMU, or a ``Model``
    tables : records: CSV, Parquet, MAT, MCAP or a ROS bag
    columns : TOML that says what their columns are; default: NAME.toml beside NAME.csv, else data.toml
    held_out : records kept aside to say how far the gap shrinks; default: each in turn
    tried : tables of inputs that the next record may have, beside what [[next]] of data.toml spans

    Returns
    -------
    GapFile
        as of ``diagnose``; its stages are the model's own

    Raises
    ------
    InputError : names file, key or column, value and what was expected
    EstimationError : the model cannot follow the records at all

    Examples
    --------
    >>> import numpy as np, pathlib, towline
    >>> from towline.diagnose.own import Model, Number, Output, State
    >>> tank = Model([State("h", "m")], [], [Number("a", "1/s", 0.5)], [Output("h", "m")], lambda t, x, u, p: [-p.a * x.h])
    >>> rows = [f"{t:.2f},{np.exp(-0.8 * t) + 1e-3 * np.sin(91 * t * t):.6f}" for t in np.arange(0, 4, 0.05)]
    >>> _ = pathlib.Path("emptied.csv").write_text("t,h\\n" + "\\n".join(rows))
    >>> _ = pathlib.Path("emptied.toml").write_text(
    ...     '[clock]\\ncolumn = "t"\\n[[column]]\\nname = "h"\\nrole = "output"\\nnoise_sd = 7e-4'
    ... )
    >>> towline.gap(tank, "emptied.csv").verdict
    'no_gap'
    """
    from .own_models import gap_of_model

    given, aside, next_ones = ([Path(one) for one in some] for some in (tables, held_out, tried))
    return gap_of_model(model, given, None if columns is None else Path(columns), aside, tried=next_ones).file


def simulate(scenario: Folder, *, effects: Sequence[Folder] = (), line: Line | None = None) -> pd.DataFrame:
    """A tow or a free run by the equations of motion.

    Parameters
    ----------
    scenario : a scenario.toml; the effects of its ``[[effect]]`` tables are in the motion
    effects : Python files with effects of one's own that it may name (their code is run)
    line : what the tow line keeps, instead of ``tow.line``

    Returns
    -------
    pandas.DataFrame
        a row a sample: ``t_s``, ``y_cg_m``, ``beta_rad``, ``alpha_rad``, ``x_cg_m``, ``v_m_s``, ``r_rad_s``, ``tension_n``

    Raises
    ------
    InputError : names file, key, value and what was expected

    Examples
    --------
    >>> import towline
    >>> motion = towline.simulate("sample_videos/mariner/x1446/scenario.toml")
    >>> float(motion.t_s.iloc[0])
    0.0
    """
    from .simulating import simulate_file

    return simulate_file(Path(scenario), [Path(one) for one in effects], line)[1]


def render(scenario: Folder, out: Folder, *, effects: Sequence[Folder] = (), line: Line | None = None) -> Run:
    """Simulate a scenario and film it: a run folder with video, run.toml and the truth in ``truth/``.

    Parameters
    ----------
    scenario : a scenario.toml with ``[film]`` and at least two marks
    out : run folder to write
    effects : Python files with effects of one's own that it may name (their code is run)
    line : what the tow line keeps, instead of ``tow.line``

    Returns
    -------
    Run
        what was written

    Raises
    ------
    InputError : names file, key, value and what was expected

    Examples
    --------
    >>> import towline
    >>> run = towline.render("sample_videos/mariner/x1446/scenario.toml", "rendered")
    >>> run.source_path.name
    'video.mp4'
    """
    from .simulating import render_file

    render_file(Path(scenario), Path(out), [Path(one) for one in effects], line)
    return read_run(out)


def _run(given: Folder | Run, line: Line | None = None) -> Run:
    return given if isinstance(given, Run) else read_run(given, line)


def _silent(*_: Any) -> None:
    """No progress is shown."""


__all__ = [
    "budget",
    "check_camera",
    "compute_motion",
    "diagnose",
    "gap",
    "identify",
    "read_run",
    "render",
    "simulate",
    "steady",
    "track",
]
