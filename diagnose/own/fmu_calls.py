"""Calls into an FMU's library, as few and as short as they can be: FMI 2.0 and 3.0, model exchange and co-simulation."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...record.errors import InputError
from ...simulate.model import Array

FAILED = 2
"""A status from this on says that a call gave nothing (FMI: discard, error, fatal)."""
_C, _D, _P, _N, _I = ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
_B = ctypes.c_bool
_CALLS: dict[int, dict[str, tuple[str, tuple[Any, ...]]]] = {
    2: {
        "time": ("fmi2SetTime", (_C, _D)),
        "states": ("fmi2SetContinuousStates", (_C, _P, _N)),
        "rates": ("fmi2GetDerivatives", (_C, _P, _N)),
        "put": ("fmi2SetReal", (_C, _P, _N, _P)),
        "take": ("fmi2GetReal", (_C, _P, _N, _P)),
        "step": ("fmi2DoStep", (_C, _D, _D, _I)),
    },
    3: {
        "time": ("fmi3SetTime", (_C, _D)),
        "states": ("fmi3SetContinuousStates", (_C, _P, _N)),
        "rates": ("fmi3GetContinuousStateDerivatives", (_C, _P, _N)),
        "put": ("fmi3SetFloat64", (_C, _P, _N, _P, _N)),
        "take": ("fmi3GetFloat64", (_C, _P, _N, _P, _N)),
        "step": ("fmi3DoStep", (_C, _D, _D, _B, _P, _P, _P, _P)),
    },
}
"""What is called of each version, and its arguments, as the standards have them."""


@dataclass(frozen=True)
class Library:
    """Where an FMU's code is.

    Attributes
    ----------
    path : of the FMU, for errors
    folder : where it is unpacked
    version : 2 or 3
    exchange : for model exchange; else co-simulation
    token, identifier : as in modelDescription.xml
    numbers, inputs, outputs, states : value references
    """

    path: str
    folder: Path
    version: int
    exchange: bool
    token: str
    identifier: str
    numbers: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    states: tuple[int, ...]


class References:
    """Value references as a call takes them.

    Parameters
    ----------
    those : the references
    """

    def __init__(self, those: Sequence[int]) -> None:
        self._kept = np.array(those, dtype=np.uint32)
        self.at, self.count = self._kept.ctypes.data, len(those)


class Calls:
    """One FMU, as many instances of it as simulations go side by side.

    Parameters
    ----------
    library : where its code is
    """

    def __init__(self, library: Library) -> None:
        self.library = library
        self._made: list[Any] = []
        self._components: list[Any] = []
        self._numbers_of: list[bytes] = []
        self._last: Array | None = None
        self._stands: tuple[tuple[float, int], Array] | None = None
        self._raw: dict[str, Callable[..., int]] = {}
        refs = (library.numbers, library.inputs, library.outputs, library.states)
        self._of_numbers, self._of_inputs, self._of_outputs, self._of_states = map(References, refs)
        weakref.finalize(self, _freed, self._made)

    # instances ------------------------------------------------------------------------------------------------------

    def _one_more(self) -> Any:
        from fmpy.fmi2 import FMU2Model, FMU2Slave
        from fmpy.fmi3 import FMU3Model, FMU3Slave

        kinds: dict[tuple[int, bool], Any] = {
            (2, True): FMU2Model,
            (2, False): FMU2Slave,
            (3, True): FMU3Model,
            (3, False): FMU3Slave,
        }
        library = self.library
        try:
            made = kinds[library.version, library.exchange](
                guid=library.token,
                unzipDirectory=str(library.folder),
                modelIdentifier=library.identifier,
                instanceName=f"towline_{len(self._made)}",
            )
            made.instantiate()
        except Exception as error:  # fmpy raises plain ones
            raise InputError(library.path, "", f"does not start: {' '.join(str(error).split())}") from None
        if not self._raw:
            for name, (symbol, kinds_of) in _CALLS[library.version].items():
                if hasattr(made.dll, symbol):
                    self._raw[name] = ctypes.CFUNCTYPE(_I, *kinds_of)((symbol, made.dll))
        self._made.append(made)
        self._components.append(made.component)
        self._numbers_of.append(b"")
        return made

    def _begin(self, made: Any, p: Array, u: Array, start: Array) -> bool:
        """Initialized with numbers (q,), first inputs (m,) and, for co-simulation, starts (s,); whether it was."""
        version = self.library.version
        try:
            if getattr(made, "towline_begun", False):
                made.reset()
            made.towline_begun = True
            if version == 2:
                made.setupExperiment(startTime=0.0)
            for references, values in ((self._of_numbers, p), (self._of_states, start), (self._of_inputs, u)):
                if len(values):
                    self._put(made.component, references, np.ascontiguousarray(values, dtype=float))
            if version == 2:
                made.enterInitializationMode()
            else:
                made.enterInitializationMode(startTime=0.0)
            made.exitInitializationMode()
            if self.library.exchange:
                for _ in range(10):
                    more = made.newDiscreteStates()[0] if version == 2 else made.updateDiscreteStates()[0]
                    if not more:
                        break
                made.enterContinuousTimeMode()
        except Exception:  # numbers that it refuses
            return False
        return True

    def _put(self, component: Any, references: References, values: Array) -> int:
        args = (component, references.at, references.count, values.ctypes.data)
        return self._raw["put"](*args) if self.library.version == 2 else self._raw["put"](*args, references.count)

    def _ready(self, p: Array) -> None:
        """As many instances as columns of p (q, k), each with its numbers."""
        if p is self._last:
            return
        for k in range(p.shape[1]):
            made = self._made[k] if k < len(self._made) else self._one_more()
            own = np.ascontiguousarray(p[:, k])
            if self._numbers_of[k] != own.tobytes() + b"!":
                nothing = np.zeros(0)
                if not self._begin(made, own, np.zeros(len(self.library.inputs)), nothing):
                    self._numbers_of[k] = b""
                    continue
                self._numbers_of[k] = own.tobytes() + b"!"
        self._last, self._stands = p, None

    # model exchange -------------------------------------------------------------------------------------------------

    def rates(self, t: float, x: Array, u: Array, p: Array) -> Array:
        """Rates (s, k) of states (s, k), inputs (m, k) and numbers (q, k)."""
        self._ready(p)
        return self._called(t, x, u, len(x), self._raw["rates"])

    def autonomous(self, x: Array, p: Array) -> Array:
        """Rates (s, n, k) of states (s, n, k) and numbers (q, k) of an FMU that knows no time, its inputs 0: the fewest calls.

        All instances are asked at once, one time after the other, and nothing but their states is set in between.
        """
        self._ready(p)
        size, count, k = x.shape
        xs, found = np.ascontiguousarray(x.transpose(1, 2, 0)), np.empty((count, k, size))
        components, sizes, nothing = self._components[:k], (size,) * k, np.zeros((len(self.library.inputs), k))
        set_states, ask = self._raw["states"], self._raw["rates"]
        found[0] = self._called(0.0, x[:, 0], nothing, size, ask).T
        self._ready(p)
        step, width = 8 * size, 8 * size * k
        for index in range(1, count):
            own, to = (
                range(a.ctypes.data + width * index, a.ctypes.data + width * (index + 1), step) for a in (xs, found)
            )
            bad = max(map(set_states, components, own, sizes))
            if max(bad, *map(ask, components, to, sizes)) >= FAILED:
                found[index] = self._called(0.0, x[:, index], nothing, size, ask).T
                self._ready(p)
        return found.transpose(2, 0, 1)

    def taken(self, t: float, x: Array, u: Array, p: Array) -> Array:
        """Outputs (c, k) of the same."""
        self._ready(p)
        return self._called(t, x, u, self._of_outputs.count, self._outputs_of)

    def _outputs_of(self, component: Any, at: int, count: int) -> int:
        args = (component, self._of_outputs.at, count, at)
        return self._raw["take"](*args) if self.library.version == 2 else self._raw["take"](*args, count)

    def _called(self, t: float, x: Array, u: Array, count: int, ask: Callable[[Any, int, int], int]) -> Array:
        (states, k), inputs = x.shape, len(u)
        xs, us, found = np.ascontiguousarray(x.T), np.ascontiguousarray(u.T), np.empty((k, count))
        of_x, of_u, of_found = (
            range(a.ctypes.data, a.ctypes.data + a.nbytes + 1, 8 * a.shape[1] or 1) for a in (xs, us, found)
        )
        components, set_states = self._components[:k], self._raw["states"]
        # of the four calls of a Runge-Kutta step two are at a time, and with inputs, that stand there already
        if self._stands is None or self._stands[0] != (t, k) or not np.array_equal(self._stands[1], us):
            set_time, put = self._raw["time"], self._raw["put"]
            references, more = self._of_inputs.at, (inputs,) if self.library.version == 3 else ()
            for component, u_at in zip(components, of_u if inputs else of_found, strict=False):
                set_time(component, t)
                if inputs:
                    put(component, references, inputs, u_at, *more)
            self._stands = (t, k), us
        bad = [
            set_states(component, x_at, states) | ask(component, at, count)
            for component, x_at, at in zip(components, of_x, of_found, strict=False)
        ]
        for column, status in enumerate(bad):
            if status >= FAILED or not self._numbers_of[column]:
                found[column] = np.nan
                self._numbers_of[column] = b""
                self._last = None
                self._stands = None
        return found.T

    # co-simulation --------------------------------------------------------------------------------------------------

    def course(self, t: Array, start: Array, u: Array, p: Array) -> Array:
        """Outputs (c, n, k) at times (n,) of starts (s, k), inputs between them (m, n - 1, k) and numbers (q, k)."""
        made = self._made[0] if self._made else self._one_more()
        n, k, count = len(t), p.shape[1], self._of_outputs.count
        found = np.full((k, n, count), np.nan)
        inputs = np.ascontiguousarray(np.broadcast_to(u, (len(u), n - 1, k)).transpose(2, 1, 0))
        step, two = self._raw["step"], self.library.version == 2
        flags = np.zeros(8)
        more = [flags.ctypes.data + 8 * index for index in range(4)]
        gaps = np.diff(t)
        for column in range(k):
            if not self._begin(made, p[:, column], inputs[column, 0], start[:, column]):
                continue
            component, at = made.component, found[column].ctypes.data
            u_at = inputs[column].ctypes.data
            bad = self._outputs_of(component, at, count)
            for index in range(n - 1):
                if len(u):
                    own = (component, self._of_inputs.at, len(u), u_at + 8 * len(u) * index)
                    bad |= self._raw["put"](*own) if two else self._raw["put"](*own, len(u))
                now, length = float(t[index]), float(gaps[index])
                bad |= step(component, now, length, 1) if two else step(component, now, length, True, *more)
                if bad >= FAILED:
                    break
                bad |= self._outputs_of(component, at + 8 * count * (index + 1), count)
        return np.moveaxis(found, (0, 1, 2), (2, 1, 0))


def _freed(made: list[Any]) -> None:
    for one in made:
        free = getattr(one, "fmi2FreeInstance", None) or one.fmi3FreeInstance
        free(one.component)


__all__ = ["Calls", "Library"]
