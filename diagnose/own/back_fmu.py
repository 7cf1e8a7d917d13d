"""The corrected model as an FMU (FMI 2.0, co-simulation) that wraps the old one, through pythonfmu.

Whoever runs it needs a Python with towline in it: the FMU has the old model, corrected.json and a few lines that join them.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...record.corrected_file import CorrectedFile
from ...record.errors import InputError
from ...record.files import replacing
from ...record.results import read_result, write_result
from ...simulate.model import Array
from .back import INNER, corrected_file, from_file
from .course import Grid, Put, Steps, changed_inputs, changed_outputs, held
from .gap import OwnGap
from .model import Missing, System
from .read import read_model

JSON_NAME, SETTING_NAME = "corrected.json", "steps.json"
START = "start_"
"""Before a state's name: the parameter of its start."""
SLAVE = '''"""Written by towline: the corrected model of {model}."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

from towline.diagnose.own.back_fmu import Wrapped


class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "{model}, corrected by towline"
        self.inside = Wrapped.of_folder(self.resources)
        for kind, words, values in self.inside.variables():
            causality = getattr(Fmi2Causality, kind)
            of = Fmi2Variability.fixed if kind == "parameter" else Fmi2Variability.continuous
            for name in values:
                get, put = (lambda values=values, name=name: values[name]), None
                if kind != "output":
                    def put(value, values=values, name=name):
                        values[name] = value
                self.register_variable(
                    Real(name, causality=causality, variability=of, description=words[name], getter=get, setter=put), nested=False
                )

    def exit_initialization_mode(self):
        self.inside.begin()

    def do_step(self, current_time, step_size):
        self.inside.step(step_size)
        return True
'''


class Wrapped:
    """A corrected model that is run step by step, its inputs as they are until the next.

    Parameters
    ----------
    system : the corrected model
    longest_s : its steps of integration are no longer

    Attributes
    ----------
    numbers, inputs, outputs : name -> value, as they are now; with the numbers each state's start, "start_NAME"

    Examples
    --------
    >>> from .model import Model, Number, Output, State
    >>> tank = Model([State("h", "m", 1.0)], [], [Number("a", "1/s", 0.5)], [Output("h", "m")], lambda t, x, u, p: [-p.a * x.h])
    >>> one = Wrapped(tank, 0.1)
    >>> one.begin()
    >>> one.step(1.0)
    >>> round(one.outputs["h"], 5)
    0.60653
    """

    def __init__(self, system: System, longest_s: float) -> None:
        self._system, self._longest_s = system, longest_s
        self.numbers = {n.name: float(n.start) for n in system.numbers}
        self.numbers |= {START + s.name: float(s.start) for s in system.states}
        self.inputs = {i.name: 0.0 for i in system.inputs}
        self.outputs = {o.name: 0.0 for o in system.outputs}
        self._steps: Steps | None = None
        self._grid: Grid | None = None
        self._given: list[Array] = []
        self._seen: list[Array] = []

    @classmethod
    def of_folder(cls, folder: str | Path) -> Wrapped:
        """What ``corrected_fmu`` has put into its resources."""
        folder = Path(folder)
        setting = json.loads((folder / SETTING_NAME).read_text())
        system = read_model(folder / setting["model"])
        made = from_file(read_result(folder / JSON_NAME, CorrectedFile), system, folder / JSON_NAME)
        return cls(made, float(setting["longest_s"]))

    def variables(self) -> list[tuple[str, dict[str, str], dict[str, float]]]:
        """Parameters, inputs, outputs: which, their units, their values."""
        units = {n.name: n.unit for n in self._system.numbers}
        units |= {START + s.name: s.unit for s in self._system.states}
        return [
            ("parameter", units, self.numbers),
            ("input", {i.name: i.unit for i in self._system.inputs}, self.inputs),
            ("output", {o.name: o.unit for o in self._system.outputs}, self.outputs),
        ]

    @property
    def _puts(self) -> list[Put]:
        return [Put(m, tuple(np.array([v]) for v in numbers)) for m, numbers in self._system.built_in]

    @property
    def _p(self) -> Array:
        return np.array([[self.numbers[n.name]] for n in self._system.numbers]).reshape(-1, 1)

    def begin(self) -> None:
        """To the start, with the numbers as they are now."""
        self._steps, self._grid = None, None
        start = np.array([[self.numbers[START + s.name]] for s in self._system.states]).reshape(-1, 1)
        self._given, self._seen = [self._now()], [start]
        self._show(Grid(self._longest_s, 1, 1))

    def step(self, step_s: float) -> None:
        """To the next time.

        Parameters
        ----------
        step_s : until there; always the same

        Raises
        ------
        InputError : it is another than before
        """
        if self._grid is None:
            inner = max(int(np.ceil(step_s / self._longest_s - 1e-9)), 1)
            self._grid = Grid(step_s, 1, inner, tuple(True for _ in self._system.inputs))
            equations = [q for q in self._puts if q.missing.equation]
            self._steps = Steps(self._system, self._grid, self._seen[0], self._p, equations)
        if abs(step_s / self._grid.step_s - 1) > 1e-9 or self._steps is None:
            raise InputError(
                self._system.name, "step", f"{step_s:g} s after steps of {self._grid.step_s:g} s; all must be alike"
            )
        # what was given until now, and goes on until the next
        self._given[-1] = self._now()
        self._given.append(self._given[-1])
        grid = Grid(step_s, len(self._given), self._grid.inner, self._grid.stays)
        halves = held(np.array(self._given), grid)[..., None]
        self._seen.append(self._steps.to_next(changed_inputs(self._system, grid, halves, self._puts)))
        self._show(grid)

    def _now(self) -> Array:
        return np.array([self.inputs[i.name] for i in self._system.inputs], dtype=float)

    def _show(self, grid: Grid) -> None:
        """Outputs where it is; of what they were before only where an effect remembers it."""
        puts = self._puts
        of_output = [q for q in puts if q.missing.output]
        at = len(self._seen) - 1
        first = 0 if of_output else at
        given, path = self._given, self._seen
        if at == 0:
            # no effect knows what one sample alone is: it stays for a while
            given, path, grid = given * 2, path * 2, Grid(grid.step_s, 2, 1, tuple(True for _ in self._system.inputs))
        halves = held(np.array(given), grid)[..., None]
        u = np.moveaxis(changed_inputs(self._system, grid, halves, puts)[:: 2 * grid.inner], 0, 1)[:, first:]
        x = np.array(path[first:]).transpose(1, 0, 2)
        seen = self._system.seen(grid.times_s[first:, None], x, u, self._p[:, None])
        part = Grid(grid.step_s, len(path) - first, grid.inner, grid.stays)
        last = changed_outputs(self._system, part, np.moveaxis(seen, 0, 1), of_output)[at - first, :, 0]
        self.outputs.update({o.name: float(v) for o, v in zip(self._system.outputs, last, strict=True)})


def check_wrappable(system: System, missing: Sequence[tuple[Missing, Sequence[float]]] = ()) -> None:
    """Say why a model cannot be wrapped step by step.

    Parameters
    ----------
    system : the model
    missing : what is put in, with its numbers

    Raises
    ------
    InputError : it runs by itself, what is missing needs the future or is no code, or pythonfmu is not installed
    """
    if system.whole:
        raise InputError(
            system.name, "--fmu", "runs by itself (co-simulation): what is missing stands in corrected.json alone"
        )
    for m, numbers in missing:
        if not (m.equation or m.input or m.output):
            raise InputError(
                system.name, f"--fmu: {m.name}", "is of the clock by which it was recorded, and no part of the model"
            )
        if m.name.endswith("_delay") and numbers[0] < 0:
            raise InputError(
                system.name, f"--fmu: {m.name}", "comes earlier than it is written down: no FMU knows what will come"
            )
    try:
        import pythonfmu as _  # noqa: F401
    except ImportError:
        raise InputError("--fmu", "", "writing an FMU needs pythonfmu: pip install 'towline[fmu]'") from None


def corrected_fmu(gap: OwnGap, model: Path, out: Path) -> None:
    """Write the corrected model as an FMU.

    Parameters
    ----------
    gap : what was found
    model : the old model's file
    out : the FMU

    Raises
    ------
    InputError : as of ``check_wrappable``
    """
    check_wrappable(gap.system, gap.put_in)
    from pythonfmu import FmuBuilder

    name = "corrected_" + re.sub(r"\W", "_", model.stem)
    setting = {
        "model": model.name,
        "longest_s": min(gap.simulator.longest_step_s, gap.simulator.blocks[0].record.step_s / INNER),
    }
    with tempfile.TemporaryDirectory(prefix="towline_fmu_") as folder, replacing(out) as target:
        here = Path(folder)
        (here / f"{name}.py").write_text(SLAVE.format(name=name, model=model.name))
        (here / SETTING_NAME).write_text(json.dumps(setting))
        write_result(here / JSON_NAME, corrected_file(gap))
        files: list[Any] = [here / SETTING_NAME, here / JSON_NAME, model]
        made = FmuBuilder.build_FMU(
            here / f"{name}.py", here / "made.fmu", files, canHandleVariableCommunicationStepSize=False
        )
        target.write_bytes(Path(made).read_bytes())


__all__ = ["Wrapped", "check_wrappable", "corrected_fmu"]
