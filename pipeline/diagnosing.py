"""The diagnosis of a campaign from its run folders: composes stages and diagnose; the command prints it, the page shows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..__version__ import __version__
from ..diagnose.effects import LIBRARY, Effect, installed_effects, load_effects
from ..diagnose.gap import Diagnosed, Diagnosis, concluded, diagnosed
from ..diagnose.inference.apart import measured_apart
from ..diagnose.inference.evidence import Fitted
from ..diagnose.inference.ranking import Ranking
from ..diagnose.own.hull import read_hull
from ..diagnose.tow.data import Recorded, block_step, tow_runs, without_cell
from ..diagnose.tow.lasting import shown_px
from ..diagnose.tow.numbers import COMPLIANCE
from ..diagnose.tow.tow_run import TowRun
from ..diagnose.tow.towed import TowSimulator
from ..record.errors import EstimationError, InputError, TowlineError
from ..record.files import sha256_of_file, write_text
from ..record.names import shown
from ..record.results import DerivativesFile, read_result
from ..record.run import RUN_FILE, Run, all_inputs, read_run, refuse_two_cameras
from ..simulate.model import DERIVATIVE_UNITS, Line
from .draws import rng_of
from .executor.copies import side_by_side
from .stages import RunMotion, compute_run_motion, fit_run_datum, track_static

Progress = Callable[[str, int, int | None], None]

FOUND = {"slack_line"}
"""Effects that are looked for in the runs themselves, and stand in no list."""


def library_of(files: Sequence[Path]) -> list[Effect]:
    """The library, what other packages install, and a user's own files; a later effect replaces one of its name."""
    found: dict[str, Effect] = {}
    for effect in (*LIBRARY, *installed_effects(), *(e for path in files for e in load_effects(path))):
        found[effect.label] = effect
    return list(found.values())


def diagnose_folders(
    folders: Sequence[Path],
    held_out: Sequence[Path] = (),
    effects: Sequence[Path] = (),
    reference: Path | None = None,
    progress: Progress | None = None,
    line: Line | None = None,
    without: Sequence[str] = (),
    hull: Path | None = None,
) -> Diagnosed:
    """Diagnose run folders.

    Parameters
    ----------
    folders : runs to fit
    held_out : runs kept aside for the shrink (fitted last); none: each run is kept aside in turn; one run alone is fitted itself
    effects : Python files with effects of one's own
    reference : derivatives.json of the simulator that is to be judged; None: the derivatives are fitted to these runs
    progress : is told what is done
    line : what the tow line keeps, instead of what the runs say
    without : names of effects that are known not to be there
    hull : an FMU of the hull's equations (``diagnose.own.hull``), of the simulator that is judged; None: towline's own

    Raises
    ------
    TowlineError : no run can be used, a file is wrong, or an effect to be left out is none
    """
    equations = None if hull is None else read_hull(hull)
    library = library_of(effects)
    known = {effect.name for effect in library} | FOUND
    for name in without:
        if name not in known:
            raise TowlineError(f"without {name!r}: no effect; expected some of {', '.join(sorted(known))}")
    runs: list[Run] = []
    motions: list[RunMotion] = []
    failed: dict[str, str] = {}
    held: list[int] = []
    for folder in (*folders, *held_out):
        try:
            run = read_run(folder, line)
            if run.file.kind == "free":
                raise InputError(run.folder / RUN_FILE, "kind", f"{run.file.kind!r}: only towed runs can be diagnosed")
            refuse_two_cameras(run, "towline diagnose")
            motions.append(compute_run_motion(run, progress=progress))
            if folder in held_out:
                held.append(len(runs))
            runs.append(run)
        except TowlineError as error:
            failed[shown(str(folder))] = str(error)
    if not runs:
        raise TowlineError(next(iter(failed.values()), "no run to diagnose"))
    tows = tows_of(runs, motions, progress)
    inputs = all_inputs(runs) | ({} if hull is None else {str(hull): sha256_of_file(hull)})
    judged = None if reference is None else _reference(reference)
    apart = measured_apart(runs, library)
    simulator = TowSimulator(tows, judged, apart, without, equations)
    try:
        found = diagnosed_runs(simulator, library, inputs, held or None, progress)
    except EstimationError:
        if not simulator.celled:
            raise
        # a line that is far from what is stated pulls otherwise than any start can follow; the motion alone may say why
        simulator = TowSimulator(without_cell(tows), judged, apart, without, equations)
        found = without_the_cell(diagnosed_runs(simulator, library, inputs, held or None, progress))
    return Diagnosed(found, runs, failed, tuple(library), tuple(held) or None)


def tows_of(runs: Sequence[Run], motions: Sequence[RunMotion], progress: Progress | None = None) -> list[TowRun]:
    """Runs as the diagnosis takes them: means over blocks, with their noise.

    Parameters
    ----------
    runs : of one campaign
    motions : of ``compute_run_motion``, one of each
    progress : is told what is done
    """
    step = block_step([float(m.motion["t_s"].iloc[-1] - m.motion["t_s"].iloc[0]) for m in motions])
    recorded = [
        Recorded(
            run,
            m.motion,
            m.common,
            m.tracks,
            fit_run_datum(run) if m.tracks is not None else None,
            track_static(run, progress),
        )
        for run, m in zip(runs, motions, strict=True)
    ]
    return tow_runs(recorded, step)


def without_the_cell(found: Diagnosis) -> Diagnosis:
    """A diagnosis that says that the load cells' records were left out.

    Parameters
    ----------
    found : from the motion alone
    """
    why = "left out: beside it the simulator as it is cannot follow these runs at all"
    said = "The load cell's record is left out: beside it the simulator cannot follow these runs at all."
    file = found.file
    changed = {"excluded": file.excluded | {"load cell": why}, "sentences": [*file.sentences, said]}
    return replace(found, file=file.model_copy(update=changed))


def diagnosed_runs(
    simulator: TowSimulator,
    library: Sequence[Effect],
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose prepared runs, side by side.

    Parameters
    ----------
    simulator : of the runs
    library : effects to try
    inputs : files behind them -> what they hold
    held : runs kept aside; None: each in turn
    progress : is told what is done

    Raises
    ------
    EstimationError : the runs cannot be fitted
    """
    say = None if progress is None else lambda text: progress(text, 0, None)
    rng = rng_of(inputs)  # for the bootstrap of an interval
    try:
        found = diagnosed(simulator, library, __version__, inputs, held, rng, say, side_by_side)
    except np.linalg.LinAlgError as error:
        raise EstimationError(
            f"the runs' normal equations cannot be solved ({error}); does each run hold a tow?"
        ) from error
    return _with_lasting(found, simulator)


def concluded_runs(
    found: Diagnosis,
    ranking: Ranking,
    library: Sequence[Effect],
    held: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """What follows from another ranking of runs that were diagnosed.

    Parameters
    ----------
    found : their diagnosis
    ranking : with further candidates
    library : effects that were tried
    held : runs kept aside; None: each in turn
    progress : is told what is done
    """
    say = None if progress is None else lambda text: progress(text, 0, None)
    simulator, inputs = found.inference.simulator, found.file.inputs
    assert isinstance(simulator, TowSimulator)
    answer = concluded(simulator, found.inference, ranking, library, __version__, inputs, held, rng_of(inputs), say)
    return _with_lasting(answer, simulator)


def _with_lasting(found: Diagnosis, simulator: TowSimulator) -> Diagnosis:
    return replace(found, file=found.file.model_copy(update={"lasting_px": shown_px(simulator.runs)}))


def _reference(path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    file = read_result(path, DerivativesFile)
    absent = [name for name in DERIVATIVE_UNITS if name not in file.derivatives]
    if absent:
        raise InputError(path, f"derivatives.{absent[0]}", "missing; a reference holds all six derivatives")
    six = np.array([file.derivatives[name].value for name in DERIVATIVE_UNITS])
    sd = np.array([file.derivatives[name].std for name in DERIVATIVE_UNITS])
    return six, sd, file.speed_m_s


def write_model(path: Path, found: Diagnosed, fitted: Fitted | None = None) -> None:
    """The simulator that reproduces the tank: derivatives, what the line keeps and effect, as tables of a scenario.

    Parameters
    ----------
    path : of the file
    found : what was found
    fitted : which hypothesis; None: the headline
    """
    import tomlkit

    diagnosis = found.diagnosis
    if fitted is None:
        fitted = diagnosis.best.fitted if diagnosis.best is not None else diagnosis.ranking.base
    document = tomlkit.document()
    document.add(
        tomlkit.comment("Derivatives and unmodelled effects that reproduce these runs; put both into a scenario.toml.")
    )
    simulator = diagnosis.inference.simulator
    assert isinstance(simulator, TowSimulator)
    hull = tomlkit.table()
    for name, value in zip(simulator.shared_names, fitted.hypothesis.shared, strict=True):
        if name != COMPLIANCE:
            hull[name] = float(value)
    hull["speed_m_s"] = simulator.speed_m_s
    document["hull"] = hull
    line = tomlkit.table()
    line.add("line", "surge" if any(run.data.tow.line == "surge" for run in simulator.runs) else "constant")
    document["tow"] = line
    tables = tomlkit.aot()
    for effect, numbers in zip(fitted.hypothesis.effects, fitted.hypothesis.numbers, strict=True):
        table = tomlkit.table()
        table["name"] = effect.name
        if effect.variant and not effect.bound:
            table["form"] = effect.variant
        if effect.lag_s:
            table.comment(f"lag {effect.lag_s:g} s")
        own = tomlkit.inline_table()
        for parameter, number in zip(effect.parameters, numbers, strict=True):
            own[parameter.name] = float(number)
        table["numbers"] = own
        tables.append(table)
    if len(tables):
        document["effect"] = tables
    write_text(path, tomlkit.dumps(document))


__all__ = ["Diagnosed", "concluded_runs", "diagnose_folders", "diagnosed_runs", "library_of", "tows_of", "write_model"]
