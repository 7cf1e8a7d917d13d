"""The uncertainty budget of a batch of tows: the fit's own lines, the camera's by their origins, what others say, the diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..geometry.motion import lens_covariance
from ..geometry.origins import deck_shapes, origins_of
from ..identify.budget import (
    Budget,
    Component,
    ModeOrigin,
    Shape,
    absent,
    budget_of,
    repeats_of,
)
from ..identify.budget.carried import carried_on
from ..identify.budget.components import INFINITE
from ..identify.budget.water import FORMULA, density_slope_kg_m3_deg, fresh_water_density_kg_m3
from ..identify.data import RunData, measured_rows
from ..record.budget_file import (
    BudgetFile,
    BudgetInputs,
    BudgetWater,
)
from ..record.errors import EstimationError, InputError
from ..record.gap_file import GapFile
from ..record.results import read_result
from ..record.run import refuse_two_cameras
from ..record.toml import read_toml
from ..simulate.model import DERIVATIVE_UNITS
from .analysis import Identified
from .budget_result import DENSITY, budget_file
from .draws import rng_of
from .stages import RunMotion, fit_run_datum


def budget_batch(
    answer: Identified,
    inputs: Path | None = None,
    gap: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> BudgetFile:
    """The budget of a fit.

    Parameters
    ----------
    answer : of ``analysis.identify_batch``
    inputs : file that says more of the lines (``BudgetInputs``), or None
    gap : gap.json of the same runs; None or not there: the model's form is no line
    progress : is told what is done

    Raises
    ------
    EstimationError : these runs do not determine all six derivatives, or were fitted in the innovations form
    InputError : the inputs file names no line, or gap.json cannot be read
    """
    say = progress or (lambda _: None)
    budget = budget_lines(answer, inputs, gap, say)
    say("budget: repeats")
    repeats = repeats_of(answer.fit, answer.data)
    say("budget: stability, turning, zigzag")
    carried = carried_on(budget, answer.fit.speed_m_s, answer.result.length_pp_m, rng_of(answer.result.inputs))
    return budget_file(answer, budget, repeats, carried)


def budget_lines(
    answer: Identified,
    inputs: Path | None = None,
    gap: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Budget:
    """The budget's lines with their matrices; parameters and errors as ``budget_batch``.

    Parameters
    ----------
    answer, inputs, gap : as ``budget_batch`` takes
    say : is told what is done
    """
    open_ones = [name for name in DERIVATIVE_UNITS if name not in answer.result.derivatives]
    if open_ones:
        raise EstimationError(
            f"{', '.join(open_ones)}: not determined by these runs; there is no budget of what has no value"
        )
    for m in answer.runs:
        refuse_two_cameras(m.run, "towline budget")
    said = None if inputs is None else read_toml(inputs, BudgetInputs)
    say("budget: the camera's lines")
    modes = _modes(answer.runs, answer.data)
    shapes = _shapes(answer.runs, answer.data)
    say("budget: sensitivities")
    budget = budget_of(answer.fit, answer.data, modes, shapes)
    budget = budget.with_components(*_outside(answer, budget), *_model_form(answer, budget, gap))
    if said is None or inputs is None:
        return budget
    if said.water is not None:
        budget = _by_temperature(budget, said.water, answer.result.density_kg_m3)
    return _told(budget, said, inputs)


# the camera's side ----------------------------------------------------------------------------------------------------


def _modes(runs: Sequence[RunMotion], data: Sequence[RunData]) -> dict[str, tuple[ModeOrigin, ...]]:
    """Key of common modes -> where they come from; a key of motion from outside is not there."""
    found: dict[str, tuple[ModeOrigin, ...]] = {}
    for m, d in zip(runs, data, strict=True):
        if m.tracks is None or not d.shared:
            continue
        fit = fit_run_datum(m.run)
        origins = origins_of(m.run, fit, len(d.common), len(d.lag))
        if origins.camera:
            found[d.common_key] = tuple(_camera(m, fit, name, weight) for name, weight in origins.camera.items())
        if origins.lag:
            found[d.lag_key] = tuple(_lag(name, weight) for name, weight in origins.lag.items())
    return found


def _camera(m: RunMotion, fit, name: str, weight: np.ndarray) -> ModeOrigin:
    file, priors = m.run.file, m.run.file.priors
    if name == "picks":
        sigma = float(np.sqrt(np.mean(fit.sigma_px**2)))
        points = f"sigma_px of {len(fit.sigma_px)} points"
        if fit.widened > 1:
            return ModeOrigin(
                "datum picks", name, weight, f"{points}, {fit.widened:.1f} times: their own residuals", sigma * fit.widened, "px",
                "A", float(fit.degrees),
            )  # fmt: skip
        return ModeOrigin("datum picks", name, weight, f"run.toml [[datum]] {points}", sigma, "px")
    if name == "places":
        sd = float(np.sqrt(np.mean([p.tank_sd_m**2 for p in file.datum])))
        return ModeOrigin("datum picks", "places of the points", weight, "run.toml [[datum]] tank_sd_m", sd, "m")
    if name == "lens":
        calibration = None if file.camera is None else file.camera.calibration
        if calibration is not None:
            from ..record.lens_file import read_lens

            views = len(read_lens(m.run.path(calibration)).views)
            return ModeOrigin(
                "lens",
                "calibration",
                weight,
                f"{calibration}, {views} views",
                evaluation="A",
                degrees=max(views - 1.0, 1.0),
            )
        if file.camera is None:
            return ModeOrigin(
                "lens", "square pixels, principal point", weight, "no [camera]: the picture's centre is assumed"
            )
        return ModeOrigin("lens", "lens", weight, "run.toml [camera] sd")
    mode = int(np.argmax(np.diag(weight)))
    source, key = (
        ("deck height", "marker_depth_sd_m") if name.startswith("depth_m") else ("marks' places", "marker_place_sd_m")
    )
    return ModeOrigin(source, name, weight, f"run.toml [priors] {key}", getattr(priors, key), "m", mode=mode)


def _lag(name: str, weight: np.ndarray) -> ModeOrigin:
    said = {
        "codec": "how far predicted pictures may hold a mark back, by the tracks' own check (vision.md)",
        "phase": "how far a mark's own picture may differ from the fitted spot, by its place in its pixel (geometry.phase)",
        "surroundings": "how far what stands beside a mark may pull it (geometry.pull)",
    }
    source, title = _TITLES[name]
    return ModeOrigin(source, title, weight, said[name])


_TITLES = {
    "codec": ("codec and slow noise", "lag of predicted pictures"),
    "phase": ("pixel phase", "place of a mark in its pixel"),
    "surroundings": ("surroundings of the marks", "pull of what stands beside a mark"),
}


def _shapes(runs: Sequence[RunMotion], data: Sequence[RunData]) -> list[Shape]:
    """What the camera's side takes as exact, by what an error of it does to all runs together."""
    each: list[dict[str, np.ndarray]] = []
    for m, d in zip(runs, data, strict=True):
        shapes = {} if m.tracks is None or not len(d.common) else deck_shapes(m.run, m.tracks, fit_run_datum(m.run))
        rows = measured_rows(m.run, m.motion) if shapes else None
        each.append({name: shape[rows, :2] for name, shape in shapes.items()})
    names = list(dict.fromkeys(name for one in each for name in one))
    return [
        Shape(
            "deck height" if name.startswith("depth") else "marks' places",
            name,
            "m",
            tuple(one.get(name) for one in each),
        )
        for name in names
    ]


# beside the fit -------------------------------------------------------------------------------------------------------


def _outside(answer: Identified, budget: Budget) -> list[Component]:
    """Sources that are in no equation of the fit: each says so."""
    size = len(budget.names)
    found = []
    film = [m for m in answer.runs if m.tracks is not None]
    for m in answer.runs:
        if m.tracks is None:
            why = "this run came as motion, which says nothing of its camera"
            found.append(
                replace(absent("camera", "datum, lens, deck height, marks' places", why, size), run=m.run.name)
            )
    if film and all(lens_covariance(m.run) is None for m in film) and all(m.run.file.camera for m in film):
        found.append(absent("lens", "lens", "[camera] has neither sd nor calibration: taken as exact", size))
    model = answer.runs[0].run.model
    if model.dry_mass_kg is None and model.yaw_inertia_kg_m2 is None and model.gyration_k2_m2 is None:
        why = "not stated, and not needed: they only part Y_vdot and N_rdot from m' and I'"
    else:
        why = "in no equation of the six: they are in Y_vdot and N_rdot of derivatives.json with their own sd"
    found.append(absent("mass and inertia", "dry mass, yaw inertia", why, size))
    why = "in no equation of the six; in the primes, which go as 1/rho; a degree of water is about 0.2 kg/m3 at 20 degrees"
    flat = np.zeros((size, size))
    source = "density and temperature"
    found.append(Component(source, DENSITY, "", "B", None, "kg/m3", flat[0], flat, INFINITE, why, "not included"))
    why = "forces are those of the water as it was; nothing is corrected for its temperature"
    found.append(absent("density and temperature", "viscosity", why, size))
    return found


def _model_form(answer: Identified, budget: Budget, gap: Path | None) -> list[Component]:
    """What the diagnosis says is missing: the derivatives' move by it, as an error that was not corrected.

    With probability p the effect is there and the estimate off by the difference d of the two fits, so that the mean square error
    about what is stated is p d d'.
    """
    source, size = "model form", len(budget.names)

    def none(why: str) -> list[Component]:
        return [absent(source, "what the equations leave out", why, size)]

    if gap is None or not gap.is_file():
        return none("no gap.json of these runs: towline diagnose looks for it")
    file = read_result(gap, GapFile)
    if sorted(file.runs) != sorted(d.name for d in answer.data):
        return none(f"{gap.name} is of other runs: {', '.join(file.runs)}")
    if any(file.inputs.get(key, digest) != digest for key, digest in answer.result.inputs.items()):
        return none(f"{gap.name} is older than these runs' inputs: diagnose them again")
    before, after = file.derivatives.get("before", {}), file.derivatives.get("after", {})
    if file.verdict == "no_gap":
        return none(f"the diagnosis finds nothing missing (probability {file.p_no_gap:.2f})")
    if not file.ranking or not set(DERIVATIVE_UNITS) <= set(after):
        return none(f"the diagnosis says {file.verdict}: something is missing, and what it does is not known")
    row = file.ranking[0]
    moved = np.zeros(size)
    moved[:6] = [(after[n].value / before[n].value - 1) * budget.value[i] for i, n in enumerate(DERIVATIVE_UNITS)]
    name = " + ".join(row.effects)
    origin = f"{gap.name}: probability {row.named:.2f}, not corrected for"
    return [
        Component(
            source, name, "", "B", float(np.sqrt(row.named)), "of the effect", moved, row.named * np.outer(moved, moved), INFINITE,
            origin, "added",
        )
    ]  # fmt: skip


def _by_temperature(budget: Budget, water: BudgetWater, stated_kg_m3: float | None) -> Budget:
    """The density's line by the water's temperature; where run.toml states another density, its origin says so."""
    at, sd = water.temperature_deg_c, water.temperature_sd_deg_c
    density = fresh_water_density_kg_m3(at)
    origin = f"fresh water of {at:g} +- {sd:g} degrees ({FORMULA}): {density:.2f} kg/m3"
    std = abs(density_slope_kg_m3_deg(at)) * sd
    if stated_kg_m3 is not None and abs(stated_kg_m3 - density) > std:
        origin += f"; run.toml states {stated_kg_m3:g}, which is not corrected for: state this one"
    lines = tuple(c.known(std, "B", INFINITE, origin) if c.name == DENSITY else c for c in budget.components)
    return replace(budget, components=lines)


def _told(budget: Budget, said: BudgetInputs, path: Path) -> Budget:
    """The budget with what the inputs file says of its lines.

    Raises
    ------
    InputError : it names a line that is not there, or an sd that belongs into [priors]
    """
    lines = list(budget.components)
    for k, entry in enumerate(said.input):
        at = [i for i, c in enumerate(lines) if c.source == entry.source and entry.name in (None, c.name)]
        key = f"input[{k}]"
        if not at:
            known = sorted({c.source if c.source != entry.source else f"{c.source}: {c.name}" for c in lines})
            raise InputError(
                path, f"{key}.source", f"no line {entry.source!r} {entry.name or ''}; there are {', '.join(known)}"
            )
        degrees = INFINITE if entry.degrees is None else entry.degrees
        for i in at:
            line = lines[i]
            if entry.std is None:
                lines[i] = replace(
                    line, evaluation=entry.evaluation, degrees=degrees, origin=entry.origin or line.origin
                )
            elif line.included or line.sensitivity is None:
                raise InputError(
                    path, f"{key}.std",
                    f"{line.source}, {line.name}: its standard uncertainty is in the fit already ({line.origin}); state it there"
                    if line.included else f"{line.source}, {line.name}: it has no sensitivity ({line.origin})",
                )  # fmt: skip
            else:
                lines[i] = line.known(entry.std, entry.evaluation, degrees, entry.origin or f"{path.name} input[{k}]")
    return replace(budget, components=tuple(lines))


__all__ = ["budget_batch", "budget_lines"]
