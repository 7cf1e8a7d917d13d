"""The diagnosis of a model of one's own: from the engine's answer to the user's words, units and stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...record import gap_file as record_file
from ...record.gap_file import GapFile
from ..gap import Diagnosis, diagnosed
from ..inference.evidence import Fitted
from ..inference.noise import FORCE_SD_N
from ..inference.spread import Spread, one_by_one
from .designs import Design
from .experiment import Experiment, Open, experiments, open_hypotheses
from .model import Missing, System
from .records import Records
from .simulator import OwnSimulator
from .words import sentences


@dataclass(frozen=True)
class OwnGap:
    """A model, diagnosed.

    Attributes
    ----------
    file : gap.json
    diagnosis : what is behind it
    system : the model
    simulator : with its records
    notes : what was done with the records
    proposed : the record to make next, of those that were given to choose from
    """

    file: GapFile
    diagnosis: Diagnosis
    system: System
    simulator: OwnSimulator
    notes: tuple[str, ...]
    proposed: Design | None = None

    @property
    def fitted(self) -> Fitted:
        """The headline, or the model as it is."""
        best = self.diagnosis.best
        return best.fitted if best is not None else self.diagnosis.ranking.base

    @property
    def put_in(self) -> list[tuple[Missing, tuple[float, ...]]]:
        """What the headline puts in, with its numbers."""
        h = self.fitted.hypothesis
        return [
            (self.simulator.missing[e.name], tuple(float(v) for v in numbers))
            for e, numbers in zip(h.effects, h.numbers, strict=True)
        ]


def own_gap(
    system: System,
    records: Records,
    tool: str,
    inputs: dict[str, str],
    held: Sequence[int] | None = None,
    rng: np.random.Generator | None = None,
    progress: Callable[[str], None] | None = None,
    spread: Spread = one_by_one,
    without: Sequence[str] = (),
    designs: Sequence[Design] = (),
    law: bool = False,
) -> OwnGap:
    """Diagnose a model of one's own.

    Parameters
    ----------
    system : the model
    records : of ``records.read_records``
    tool, inputs : for the file
    held : records kept aside for the shrink; None: each in turn
    rng : of the bootstrap
    progress : is told in a sentence what is done
    spread : does what is independent
    without : names of effects that are not offered
    designs : records that could be made next (``designs.designs_of``)
    law : terms of the states are offered, too

    Raises
    ------
    EstimationError : no course of the model follows the records
    """
    say = progress or (lambda _: None)
    say("where the fit begins")
    simulator = OwnSimulator(system, records.records, records.size, without, law)
    library = simulator.library
    say(f"{len(library)} effects are offered")
    found = diagnosed(simulator, library, tool, inputs, held, rng, say, spread)
    base = found.ranking.base
    file = found.file
    stages = {simulator.stage_of(m) for m in simulator.missing.values()} | {file.where.stage}
    share = {k: v for k, v in file.where.share.items() if k in stages and k}
    file = file.model_copy(
        update={
            "where": file.where.model_copy(update={"share": share}),
            "noise": _random(simulator, found.best.fitted if found.best is not None else base),
            "noise_without": _random(simulator, base),
        }
    )
    titles = {e.name: e.title for e in library}
    tried: list[Experiment] = []
    if designs and len(found.ranking.set95) > 1:
        say("what to record next")
        here = open_hypotheses(found.ranking)
        tried = experiments(simulator, here, designs)
        file = file.model_copy(update={"next_experiment": _proposed(here, tried, titles)})
    file = file.model_copy(update={"sentences": sentences(file, found.held, found.ranking.rest, titles)})
    return OwnGap(file, found, system, simulator, records.notes, tried[0].design if tried else None)


def _proposed(
    here: Sequence[Open], tried: Sequence[Experiment], titles: Mapping[str, str]
) -> record_file.NextExperiment | None:
    if not tried:
        return None
    names = [" and ".join(titles.get(n) or n for n in one.names) or "nothing missing" for one in here]
    best = tried[0]
    return record_file.NextExperiment(
        open=[list(one.names) for one in here],
        tried=[
            record_file.Experiment(name=e.design.name, settings=e.design.settings, told=e.told, distance=e.distance)
            for e in tried
        ],
        why=f"{best.design.name}; it tells two of what is open ({', '.join(names[:-1])} or {names[-1]}) apart with a probability "
        f"of {best.told:.2f} (expected D {best.distance:.0f}; 20 is enough)",
    )


def _random(simulator: OwnSimulator, fitted: Fitted) -> dict[str, float]:
    """Random changes of each rate, per second, and how long they last; of a model without equations, of its outputs."""
    sizes = [fitted.forces.side_n / FORCE_SD_N, fitted.forces.moment_n_m / FORCE_SD_N]
    found = {name: float(sizes[min(k, 1)] * usual) for k, (name, usual) in enumerate(simulator.dynamic.items())}
    return {**(found or {"outputs": float(sizes[0])}), "time_s": simulator.times_s[fitted.forces.time]}


__all__ = ["OwnGap", "own_gap"]
