"""What would be measured of a simulated tow: means over blocks' frames of y, heading, taut-line radius and marker distance, and
of a load cell's pull where one stood in the line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Array, Tow, full_x_cg, full_x_cg_rate, full_y_cg, full_y_cg_rate
from ..effects import SMALLEST_COSINE, Late, Seen
from ..inference.shooting import STATE_STEP
from .channels import PULL
from .columns import PAID_STATES, STATES, Numbers, columns_of
from .fields import Fields, tow_of
from .numbers import COMPLIANCE
from .rates import TowRates, line_rates
from .tow_run import TowRun
from .variations import Variations, joined

POINTS, MIDDLE = 6, 2.5
"""Of Lagrange's interpolation, quintic, and their middle."""
LAGRANGE = np.linalg.inv(np.vander(np.arange(POINTS) - MIDDLE, POINTS, increasing=True)).T
"""(points, powers): the polynomial that is 1 at a point and 0 at the others, in powers of the place from their middle."""
ALONG_SHARE = 0.01
"""Of a number's own step: motions go further than their numbers."""


class TowSeen:
    """The measurement of a campaign.

    Parameters
    ----------
    runs : with one block length
    fields : of the runs
    node_s : (nodes,), every half block
    """

    def __init__(self, runs: Sequence[TowRun], fields: Fields, node_s: Array) -> None:
        self._runs, self._fields, self._node_s = list(runs), fields, node_s
        self._step_s, self._celled = runs[0].step_s, runs[0].celled
        tows = [r.data.tow for r in runs]
        self._stated = np.array(
            [[t.line_length_m, t.tow_point_m, t.tow_point_offset_m, t.post_m[0]] for t in tows], dtype=float
        )
        self._shutter = np.zeros((2, len(node_s), len(runs), 4, 3))
        for i, run in enumerate(runs):
            nodes = np.clip((np.arange(len(node_s)) - 1) // 2, 0, run.shutter.shape[1] - 1)
            self._shutter[:, :, i] = np.nan_to_num(run.shutter[:, nodes])

    def slopes(
        self, group: Variations, path: Array, changes: Array, lates: tuple[Late, ...]
    ) -> list[tuple[Array, Array]]:
        """Values (n, c) and slopes (n, c, numbers) of every run.

        Parameters
        ----------
        path : (states, nodes, runs); changes : (nodes, runs, states, numbers) of it
        """
        direct = group.seen()
        beside, _ = joined([group.columns(direct, 0)], lates)
        with np.errstate(all="ignore"):
            # each state is moved, or, where what is seen depends on the past, the whole path along with each number
            if group.remembers:
                small = ALONG_SHARE * group.steps[None, :, None, :]
                series, moved = self._moved(group, path, (small * changes).transpose(2, 0, 1, 3), lates)
                slope = moved / small
            else:
                series, slope = self._by_motion(group, path, changes, lates)
            # the motion is the same in these columns
            shown = self._series(beside, path[..., None])
            own = (shown[..., 1:] - shown[..., :1]) / group.steps[None, None][..., direct]
            slope[..., direct] += own.transpose(0, 2, 1, 3)
        answers = []
        for i, run in enumerate(self._runs):
            late = _late(beside, run)
            mean = self._means(run, late[..., 0], len(series))
            change, rate = mean(slope[:, i]), mean.rate(series[:, :, i, 0])
            later = (late[..., 1:] - late[..., :1]) / group.steps[i, list(direct)]
            change[:, :, list(direct)] += rate[..., None] * later
            answers.append((mean(series[:, :, i, 0]), change))
        return answers

    def by_motion(self, group: Variations, path: Array, changes: Array, lates: tuple[Late, ...]) -> list[Array]:
        """Change (n, c, k) of every run's values with k changes of the motion itself.

        Parameters
        ----------
        path : (states, nodes, runs)
        changes : (nodes, runs, states, k) of it
        """
        with np.errstate(all="ignore"):
            series, slope = self._by_motion(group, path, changes, lates)
        return [self._means(run, 0.0, len(series))(slope[:, i]) for i, run in enumerate(self._runs)]

    def _by_motion(
        self, group: Variations, path: Array, changes: Array, lates: tuple[Late, ...]
    ) -> tuple[Array, Array]:
        """Series at every node, and its slopes (nodes, runs, c, k) by changes of the motion."""
        stepped = STATE_STEP * np.eye(len(path))[:, None, None, :]
        series, moved = self._moved(group, path, stepped, lates)
        return series, moved / STATE_STEP @ changes

    def _moved(self, group: Variations, path: Array, moves: Array, lates: tuple[Late, ...]) -> tuple[Array, Array]:
        """Series of a path, and by how much moves (states, nodes, runs, k) of it change it: (nodes, runs, c, k)."""
        numbers, _ = joined([group.columns((), moves.shape[3])], lates)
        whole = np.repeat(path[..., None], numbers.width, axis=3)
        whole[..., 1:] += moves
        series = self._series(numbers, whole)
        return series, (series[..., 1:] - series[..., :1]).transpose(0, 2, 1, 3)

    def values(self, numbers: Numbers, path: Array) -> list[list[Array]]:
        """Values of every column and run (n, c) along paths (states, nodes, runs, columns)."""
        with np.errstate(all="ignore"):
            series = self._series(numbers, path)
        answers: list[list[Array]] = [[] for _ in range(series.shape[3])]
        for i, run in enumerate(self._runs):
            late = _late(numbers, run)
            for column, found in enumerate(answers):
                found.append(self._means(run, late[..., column], len(series))(series[:, :, i, column]))
        return answers

    def _means(self, run: TowRun, late: Array | float, nodes: int) -> _Means:
        """Of a run whose channels are seen so much later, (n, c) s."""
        at, node_s = np.broadcast_to(late, run.values.shape), self._step_s / 2
        camera = _Mean(run.centre_s + at[:, 0], run.spread_s2, node_s, nodes)
        return _Means(
            camera, _Mean(run.cell_s + at[:, PULL], run.cell_spread_s2, node_s, nodes) if run.celled else None
        )

    def _series(self, numbers: Numbers, path: Array) -> Array:
        """(nodes, c, runs, columns) at every node."""
        tow = tow_of(self._fields, numbers)
        t_s = self._node_s[:, None, None]
        seen = self._see(t_s, path, tow, numbers.lawful)
        # a line with a law of its own has all that it gives in its length
        gives = COMPLIANCE in self._fields.names and not numbers.lawful
        stretched = self._fields.surge.any() and any(a.effect.stretch is not None for a in numbers.active)
        whole = []
        if gives or stretched or self._celled:
            beyond, pull = TowRates(self._fields, numbers, tow).pulls(t_s, path)
            seen = replace(seen, beyond_n=np.where(self._fields.surge, beyond, 0.0))
            whole = [pull] if self._celled else []
        x, y, beta = seen.pose
        more = np.zeros((4, *y.shape))
        if gives:
            _stretched(more, slice(None), seen, numbers.shared[self._fields.names.index(COMPLIANCE)] * seen.beyond_n)
        for a in numbers.active:
            if a.effect.stretch is None and a.effect.observe is None:
                continue
            here = columns_of(seen, a.columns)
            if a.effect.stretch is not None:
                _stretched(more, a.columns, here, a.effect.stretch(here, *a.numbers))
            if a.effect.observe is not None:
                for channel, change in enumerate(a.effect.observe(here, *a.numbers)):
                    more[channel][..., a.columns] += change
        x, y, beta = x + more[0], y + more[1] + numbers.own[:, 4], beta + more[2] + numbers.own[:, 5]
        return np.stack([y, beta, self._line(x, y, beta), more[3], *whole], axis=1)

    def _line(self, x: Array, y: Array, beta: Array) -> Array:
        """Radius of the stated tow point about the stated post, minus the stated length."""
        length, x_t, y_t, post = (self._stated[:, k, None] for k in range(4))
        cosine, sine = np.cos(beta), np.sin(beta)
        return np.hypot(x + x_t * cosine - y_t * sine - post, y + x_t * sine + y_t * cosine) - length

    def _see(self, t_s: Array, path: Array, tow: Tow, lawful: bool) -> Seen:
        alpha, beta, _, r = path[:STATES]
        post_rate, side = tow.post_motion(t_s)[1], np.sin(alpha + beta)
        if lawful:
            tow = replace(tow, line_length_m=tow.line_length_m + path[STATES])
        turn, along = line_rates(t_s, tuple(path[: PAID_STATES if lawful else STATES]), tow)
        x, y = full_x_cg(alpha, beta, tow), full_y_cg(t_s, alpha, beta, tow)
        x_rate = full_x_cg_rate(alpha, beta, turn, r, tow) - np.cos(alpha) * along
        y_rate = full_y_cg_rate(alpha, beta, turn, r, tow) + np.sin(alpha) * along + post_rate
        rates = (x_rate, y_rate, r)
        return Seen(
            t_s,
            (x, y, beta),
            rates,
            side,
            alpha,
            tow.tension_n,
            self._shutter,
            line_length_m=tow.line_length_m,
            speed_m_s=tow.speed_m_s,
            **{name: self._fields.fixed[name] for name in ("length_pp_m", "half_width_m", "duration_s")},
        )


def _stretched(more: Array, columns: slice, seen: Seen, longer: Array) -> None:
    """A line that gives lets the model surge along its own heading."""
    heading = seen.pose[2]
    back = longer / np.clip(np.cos(seen.alpha_rad + heading), SMALLEST_COSINE, None)
    more[0][..., columns] -= back * np.cos(heading)
    more[1][..., columns] -= back * np.sin(heading)


def _late(numbers: Numbers, run: TowRun) -> Array:
    """By how much every block of a run is seen later, (n, c, columns) s: by the camera's clock, the cell's channel by its own."""
    late = np.zeros((len(run.centre_s), run.values.shape[1], numbers.width))
    for a in numbers.active:
        if a.effect.clock is not None:
            late[:, :PULL, a.columns] += a.effect.clock(run.centre_s[:, None], *a.numbers)[:, None]
        if a.effect.cell is not None and run.celled:
            late[:, PULL, a.columns] += a.effect.cell(run.name, run.cell_s[:, None], *a.numbers)
    return late


@dataclass(frozen=True)
class _Means:
    """Means of all channels: the camera's, and the load cell's over its own samples, where there is one."""

    camera: _Mean
    cell: _Mean | None

    def __call__(self, series: Array) -> Array:
        """(nodes, c, ...) to (n, c, ...)."""
        return self._both(series, _Mean.__call__)

    def rate(self, series: Array) -> Array:
        """The same of its rate."""
        return self._both(series, _Mean.rate)

    def _both(self, series: Array, how: Callable[[_Mean, Array], Array]) -> Array:
        if self.cell is None:
            return how(self.camera, series)
        return np.concatenate([how(self.camera, series[:, :PULL]), how(self.cell, series[:, PULL:])], axis=1)


class _Mean:
    """Means over the frames of blocks, from values at the nodes: by polynomials through six of them.

    Eight or nine frames do not spread as a whole block does: that moves a mean by half the curvature times the difference.

    Parameters
    ----------
    centre_s, spread_s2 : (n,) mean and variance of the frames' times
    node_s : between nodes
    nodes : how many there are
    """

    def __init__(self, centre_s: Array, spread_s2: Array, node_s: float, nodes: int) -> None:
        place = np.clip(centre_s / node_s, -1, nodes)
        self._first = np.clip(np.floor(place).astype(int) - 2, 0, nodes - POINTS)
        u, width = place - self._first - MIDDLE, spread_s2 / node_s**2
        powers = np.array([u**k for k in range(POINTS)])
        slopes = np.array([k * u ** max(k - 1, 0) for k in range(POINTS)])
        bends = np.array([k * (k - 1) * u ** max(k - 2, 0) for k in range(POINTS)])
        self._weights = LAGRANGE @ (powers + 0.5 * width * bends)
        self._slopes = LAGRANGE @ slopes / node_s

    def __call__(self, series: Array) -> Array:
        """(nodes, ...) to (n, ...)."""
        return self._sum(self._weights, series)

    def rate(self, series: Array) -> Array:
        """The same of its rate."""
        return self._sum(self._slopes, series)

    def _sum(self, weights: Array, series: Array) -> Array:
        shape = (-1, *[1] * (series.ndim - 1))
        answer = np.zeros((len(self._first), *series.shape[1:]))
        for k, w in enumerate(weights):
            answer += w.reshape(shape) * series[self._first + k]
        return answer


__all__ = ["TowSeen"]
