"""The run that would tell the best two hypotheses apart: a few designs, simulated under both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...simulate.model import Tow, alpha_from_y
from ..inference.discern import distance_left
from ..inference.evidence import STEEP, Array, Fitted, Inference
from ..inference.hypothesis import Hypothesis
from .columns import OWN, own_numbers
from .model import TowModel
from .noise import tow_noise
from .start import straight_pull
from .tow_run import TowRun
from .towed import TowSimulator, own_sds

LINES = (0.55, 1.0, 1.6)
"""Lengths of line, over the campaign's usual one, that are tried for the next run."""
SPEEDS = (0.7, 1.0, 1.4)
"""The same of the speed."""
RELEASES = ((0.15, 0.0), (0.30, 0.0), (0.45, 0.0), (0.0, 0.05))
"""Where the tow point is across the tank, m, and heading rad at release. Far out brings out what grows faster than linearly;
let go with 6 degrees of heading on a straight line, a bare hull turns over before its line pulls it back.
"""
POINT_SHIFTS_M = (-0.1, 0.1)
"""Tow points that are tried: so much before the foremost and behind the aftmost."""
STEEPEST_RAD = 0.6
"""Of line and heading: beyond, a line no longer pulls as a tow's (and a model let go there may turn over)."""


@dataclass(frozen=True)
class Design:
    """A run to make, and how far it would set the two hypotheses apart.

    Attributes
    ----------
    tow_point_m, line_length_m, speed_m_s, y_m, beta_rad : settings
    distance : expected D
    differs : what is unlike the runs made: words
    """

    tow_point_m: float
    line_length_m: float
    speed_m_s: float
    y_m: float
    beta_rad: float
    distance: float
    differs: str


def next_run(inference: Inference, first: Fitted, second: Fitted) -> Design | None:
    """The design with the largest expected distance, what the runs made already tell taken into account.

    Parameters
    ----------
    inference : of the runs made
    first : the best hypothesis, fitted
    second : the next one

    Returns
    -------
    design : or None, where none of them is a tow, or where the first has run off: what it says of the derivatives is no spread
    """
    model = inference.simulator
    if not isinstance(model, TowSimulator):
        return None
    pattern = max(model.runs, key=lambda r: len(r.centre_s))
    runs, settings = _designs(model.runs, pattern)
    trial = TowModel(runs, model.speed_m_s, model.shared_names, model.hull)
    count = len(model.shared_names)
    one, two = (_taken_over(f.hypothesis, settings) for f in (first, second))
    spread = first.solved.covariance[:count, :count]
    try:
        known = np.linalg.cholesky(spread + 1e-12 * np.diag(np.diag(spread)))
        begun = [trial.begun(_without_camera(h)) for h in (one, two)]
        linear = trial.linear(begun)
    except (FloatingPointError, np.linalg.LinAlgError):
        return None
    best: Design | None = None
    # along the motion itself: where a path of long steps is not closed, it may run off, and what it answers is no number
    noise, own_sd = tow_noise(runs, trial.pushed(replace(begun[0], path=linear[0].path))), own_sds(runs)
    for index, (x_t, line, speed, y, beta) in enumerate(settings):
        residual, slope = linear[0].rows[index]
        other = linear[1].rows[index][0]
        if not _is_tow(residual, runs[index]):
            continue
        # of a run that came as motion nothing else is measured
        told = np.isfinite(runs[index].values)
        if not np.isfinite(other[told]).all() or not (np.abs(slope[told]) < STEEP).all():
            continue
        apart = other - residual
        white, j = noise.whitened(index, first.forces, (apart, slope))
        n = 2 * len(pattern.centre_s)
        white, own, shared = white[:n], j[:n, count : count + len(OWN)], j[:n, :count]
        # the new run's own numbers are fitted to it, the derivatives as far as they are not known
        columns = np.concatenate([own * own_sd[index], shared @ known], axis=1)
        distance = distance_left(white, columns)
        if best is None or distance > best.distance:
            best = Design(
                x_t, line, speed, y, beta, distance, differing([r.data.tow for r in model.runs], settings[index])
            )
    return best


def _designs(made: Sequence[TowRun], pattern: TowRun) -> tuple[list[TowRun], list[tuple[float, ...]]]:
    tow = pattern.data.tow
    points = [r.data.tow.tow_point_m for r in made]
    usual = float(np.median(points))
    choices = [(usual, f, 1.0, *release) for f in LINES for release in RELEASES]
    choices += [(usual, 1.0, s, *release) for s in SPEEDS if s != 1.0 for release in RELEASES]
    choices += [
        (x + shift, 1.0, 1.0, *RELEASES[1]) for x, shift in zip((min(points), max(points)), POINT_SHIFTS_M, strict=True)
    ]
    runs, settings = [], []
    for x_t, f, s, across, beta in choices:
        y = across - x_t * float(np.sin(beta))
        here = replace(
            tow,
            tow_point_m=x_t,
            line_length_m=f * tow.line_length_m,
            speed_m_s=s * tow.speed_m_s,
            tension_n=s**2 * straight_pull(pattern)[0],
            rudder_rad=0.0,
            post_amplitude_m=0.0,
        )
        if across > here.line_length_m * np.sin(STEEPEST_RAD):
            continue
        values = np.where(np.isfinite(pattern.values).any(axis=0), 0.0, np.nan) * np.ones_like(pattern.values)
        data = replace(pattern.data, tow=here, tension=None, speed=None)
        runs.append(replace(pattern, name=f"design {len(runs)}", data=data, values=values, marks=None))
        settings.append((x_t, here.line_length_m, here.speed_m_s, y, beta))
    return runs, settings


def _is_tow(residual: Array, run: TowRun) -> bool:
    """Whether a design's motion (measured as nothing: the residual is minus it) stays that of a towed model."""
    y, beta = -residual[:, 0], -residual[:, 1]
    alpha = alpha_from_y(y, beta, run.data.tow)
    told = np.isfinite(run.values)
    return bool(np.isfinite(residual[told]).all() and (np.abs([alpha, beta]) < STEEPEST_RAD).all())


def _taken_over(h: Hypothesis, settings: Sequence[tuple[float, ...]]) -> Hypothesis:
    """The hypothesis with the designs' own numbers."""
    own = np.zeros((len(settings), len(OWN)))
    ratio = h.own[:, OWN.index("tension")] / np.maximum(h.own[:, OWN.index("speed")], 1e-6) ** 2
    pull = float(np.median(ratio))
    for i, (x_t, line, speed, y, beta) in enumerate(settings):
        alpha = float(np.arcsin(np.clip((y + x_t * np.sin(beta)) / line, -0.99, 0.99)))
        own[i] = own_numbers(alpha=alpha, beta=beta, tension=pull * speed**2, tow_point=x_t, line=line, speed=speed)
    return replace(h, own=own, path=None)


def _without_camera(h: Hypothesis) -> Hypothesis:
    """Camera faults, windows and bounces belong to the runs made."""
    kept = [(e, n) for e, n in zip(h.effects, h.numbers, strict=True) if e.correct is None and not e.bound]
    return replace(h, effects=tuple(e for e, _ in kept), numbers=tuple(n for _, n in kept))


def differing(tows: Sequence[Tow], setting: tuple[float, ...]) -> str:
    """Say in words what of a proposed run is unlike the runs made.

    Parameters
    ----------
    tows : of the runs made
    setting : tow point m, line length m, speed m/s, y m and beta rad at release

    Returns
    -------
    words : line and speed where they differ from the median by more than 5 %, a tow point outside those made, and the release
    """
    x_t, line, speed, y, beta = setting
    words = []
    if abs(line / np.median([t.line_length_m for t in tows]) - 1) > 0.05:
        words.append(f"a line of {line:.2f} m")
    if abs(speed / np.median([t.speed_m_s for t in tows]) - 1) > 0.05:
        words.append(f"{speed:.2f} m/s")
    if not min(t.tow_point_m for t in tows) - 1e-6 <= x_t <= max(t.tow_point_m for t in tows) + 1e-6:
        words.append(f"a tow point at {x_t:.2f} m")
    words.append(f"released at y {y:.2f} m" + (f" and {np.degrees(beta):.0f} degrees heading" if beta else ""))
    return ", ".join(words)
