"""The hull of another towing simulator, an FMU: what the diagnosis of tows takes in place of towline's own equations of the hull.

The line, the camera and the clock stay towline's; how the hull answers speeds and forces is the FMU's. Its states are u_m_s, v_m_s
and r_rad_s, its inputs ahead_n, side_n, moment_n_m (and rudder_rad), its parameters the six derivatives by towline's names; what
else it has, a cubic term for one, stands as the FMU has it. A name may stand behind others and a dot, as ship.hull.v_m_s does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...record.errors import InputError
from ...simulate.model import DERIVATIVE_UNITS, Array, Hull, Tow
from .fmu import FmuModel, read_fmu

STATES = ("u_m_s", "v_m_s", "r_rad_s")
FORCES = ("ahead_n", "side_n", "moment_n_m")
RUDDER, RESISTANCE = "rudder_rad", "resistance_n"
CROSSED = ("y_rdot", "n_vdot")
"""Cross added masses that an effect adds stand beside what the FMU has."""
PUSHED_N = 100.0
"""Forces by which it is asked how it answers one: its answer is linear, whatever the size."""
SAME = 1e-6
"""Its answer to a force may differ by this share between two motions."""
MOTIONS = ((1.0, 0.0, 0.0), (1.3, 0.2, 0.1))
"""Those two: u, v, r."""


class FmuHull:
    """A hull as ``tow.rates.OtherHull``: asked for the hulls of all runs and columns, it says how they answer.

    Parameters
    ----------
    model : for model exchange

    Attributes
    ----------
    rudder : place of its rudder angle among its inputs; None: it has none

    Raises
    ------
    InputError : it lacks a state, an input or a parameter that is needed, or its answer to a force changes with its motion
    """

    def __init__(self, model: FmuModel) -> None:
        self._model = model
        if model.whole:
            raise InputError(model.name, "", "runs by itself (co-simulation); a hull must be an FMU for model exchange")
        self._states = [_of(model.name, "state", name, model.states) for name in STATES]
        self._forces = [_of(model.name, "input", name, model.inputs) for name in FORCES]
        rudders = [k for k, one in enumerate(model.inputs) if _last(one.name, RUDDER)]
        self.rudder = rudders[0] if rudders else None
        for name in DERIVATIVE_UNITS:
            _of(model.name, "parameter", name, model.numbers)
        if len(model.states) > len(STATES):
            more = next(one.name for k, one in enumerate(model.states) if k not in self._states)
            raise InputError(model.name, f"state {more}", f"a hull's states are {', '.join(STATES)}; it has one more")
        self._check(np.array([[n.start] for n in model.numbers]))

    def __call__(self, hull: Hull, tow: Tow, runs: int, columns: int) -> _Answers:
        """Of hulls side by side.

        Parameters
        ----------
        hull : the derivatives at its speed; fields that broadcast to (runs, columns)
        tow : R of each, at that speed
        runs, columns : how many
        """
        told: dict[str, Any] = {k: v for k, v in vars(hull).items() if k not in CROSSED}
        told[RESISTANCE] = tow.tension_n
        rows = []
        for number in self._model.numbers:
            value = next((v for name, v in told.items() if v is not None and _last(number.name, name)), number.start)
            rows.append(np.broadcast_to(value, (runs, columns)).ravel())
        table = np.array(rows, dtype=float).reshape(-1, runs * columns)
        crossed = None
        if np.any(hull.y_rdot) or np.any(hull.n_vdot):
            crossed = np.broadcast_arrays(hull.y_rdot, hull.n_vdot, np.zeros((runs, columns)))[:2]
        return _Answers(self, table, (runs, columns), crossed)

    def rates(self, speeds: Array, table: Array) -> Array:
        """u', v', r' (3, n, k) at u, v, r (3, n, k) of hulls with parameters (q, k), nothing pushing."""
        x = np.empty_like(speeds)
        x[self._states] = speeds
        return self._model.calls.autonomous(x, table)[self._states]

    def driven(self, speeds: Array, inputs: Mapping[int, Any], table: Array) -> Array:
        """The same with inputs, by their places in the FMU, (n, k) each."""
        found = np.empty_like(speeds)
        for n in range(speeds.shape[1]):
            x, u = np.empty_like(speeds[:, n]), np.zeros((len(self._model.inputs), table.shape[1]))
            x[self._states] = speeds[:, n]
            for k, values in inputs.items():
                u[k] = values[n]
            found[:, n] = self._model.derivatives(0.0, x, u, table)[self._states]
        return found

    def answers(self, table: Array, motion: Sequence[float]) -> Array:
        """(k, 3, 3): what a unit force ahead, a side force and a moment change of u', v', r', at a motion."""
        speeds = np.tile(np.array(motion)[:, None, None], (1, 1, table.shape[1]))
        base = self.driven(speeds, {}, table)
        found = [(self.driven(speeds, {k: [PUSHED_N]}, table) - base)[:, 0] / PUSHED_N for k in self._forces]
        return np.array(found).transpose(2, 1, 0)

    def _check(self, table: Array) -> None:
        one, other = (self.answers(table, motion)[0] for motion in MOTIONS)
        if not (np.isfinite(one).all() and np.linalg.matrix_rank(one) == len(FORCES)):
            raise InputError(self._model.name, "", f"does not answer {', '.join(FORCES)} by {', '.join(STATES)}")
        if np.abs(one - other).max() > SAME * np.abs(one).max():
            raise InputError(
                self._model.name, "", "its answer to a force changes with its motion; a hull's masses must not"
            )


class _Answers:
    """``simulate.model.Answering`` of runs and columns."""

    def __init__(
        self, hull: FmuHull, table: Array, shape: tuple[int, int], crossed: Sequence[Array] | None = None
    ) -> None:
        self._hull, self._table, self._shape = hull, table, shape
        answers = hull.answers(table, MOTIONS[0])
        self._changed = None
        if crossed is not None:
            # cross added masses that an effect gives it stand beside its own masses
            masses = np.linalg.inv(answers)
            whole = masses.copy()
            whole[:, 1, 2] -= crossed[0].ravel()
            whole[:, 2, 1] -= crossed[1].ravel()
            answers = np.linalg.inv(whole)
            self._changed = (answers @ masses).transpose(1, 2, 0).reshape(3, 3, *shape)
        self._answer = answers.transpose(1, 2, 0).reshape(3, 3, *shape)

    def free(self, u: Any, v: Any, r: Any, rudder_rad: Any, more: tuple[Any, ...]) -> tuple[Any, Any, Any]:
        """Of ``Answering``."""
        shape = np.broadcast_shapes(self._shape, np.shape(u), np.shape(v), np.shape(r), np.shape(rudder_rad))
        speeds = np.stack([np.broadcast_to(one, shape).reshape(-1, self._table.shape[1]) for one in (u, v, r)])
        if self._hull.rudder is not None and np.any(rudder_rad):
            over = {self._hull.rudder: np.broadcast_to(rudder_rad, shape).reshape(speeds.shape[1:])}
            rates = self._hull.driven(speeds, over, self._table).reshape(3, *shape)
        else:
            rates = self._hull.rates(speeds, self._table).reshape(3, *shape)
        if self._changed is not None:
            rates = np.einsum("ij...,j...->i...", self._changed, rates)
        side, moment, *ahead = more
        pushed = self.pulled(ahead[0] if ahead else 0.0, side, moment)
        return rates[0] + pushed[0], rates[1] + pushed[1], rates[2] + pushed[2]

    def pulled(self, ahead: Any, side: Any, moment: Any) -> tuple[Any, Any, Any]:
        """Of ``Answering``."""
        a, b = self._answer, (ahead, side, moment)
        return tuple(sum(a[i, j] * b[j] for j in range(3)) for i in range(3))  # pyright: ignore[reportReturnType]


def read_hull(path: Path) -> FmuHull:
    """Read the hull of another towing simulator.

    Parameters
    ----------
    path : of an FMU for model exchange

    Raises
    ------
    InputError : it cannot be read, or is no such hull
    """
    return FmuHull(read_fmu(path))


def _last(name: str, wanted: str) -> bool:
    """Whether a name is that, or ends with it behind others."""
    return name == wanted or name.endswith(f"_{wanted}")


def _of(path: str, kind: str, name: str, those: Sequence[Any]) -> int:
    found = [k for k, one in enumerate(those) if _last(one.name, name)]
    if len(found) != 1:
        there = ", ".join(one.name for one in those) or "none"
        what = "missing" if not found else "is there twice"
        raise InputError(path, f"{kind} {name}", f"{what}; the hull's FMU has {there}")
    return found[0]


__all__ = ["FmuHull", "read_hull"]
