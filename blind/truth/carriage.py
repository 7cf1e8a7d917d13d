"""The carriage's speed, and waves that carry the model ahead of it."""

from __future__ import annotations

import numpy as np

from .lanes import Array, Lanes

CRESTS = 3.0
"""Crests of a train of waves that slackens the line."""
QUICK = 0.2
"""Share of its time in which a carriage that fails suddenly slows; it takes the rest to come back."""


def speed_at(q: Lanes, t: float) -> Array:
    """Carriage speed: a drift, a drive that sticks and slips, a drive that fails for a moment.

    Nothing more is needed: the model's own inertia meets it through the line.

    Parameters
    ----------
    q : numbers
    t : time, s

    Returns
    -------
    m/s ``(n,)``
    """
    speed = q["speed"]
    if q.has("speed_drift.share"):
        settle = np.maximum(q["speed_drift.settle_s"], 1.0)
        span = 1 - np.exp(-q["duration"] / settle)
        speed = speed + q["speed"] * q["speed_drift.share"] * ((1 - np.exp(-t / settle)) / span - 0.5)
    if q.has("speed_drift.ramp_share"):
        end = np.maximum(q["speed_drift.ramp_end"] * q["duration"], 1.0)
        speed = speed + q["speed"] * q["speed_drift.ramp_share"] * (np.minimum(t / end, 1.0) - 0.5)
    if q.has("speed_drift.swing_share"):
        phase = 2 * np.pi * t / np.maximum(q["speed_drift.swing_s"], 5.0) + q["speed_drift.swing_phase"]
        speed = speed + q["speed"] * q["speed_drift.swing_share"] / 2 * np.sin(phase)
    if q.has("stick_slip.share"):
        for k in (1, 2, 3):
            w = 2 * np.pi * k * q["stick_slip.rate_hz"]
            speed = speed + q["speed"] * q["stick_slip.share"] * (-1) ** (k + 1) / k * np.sin(w * t)
    if q.has("slack_line.surplus"):
        share, length = _of_event(q, t)
        fastest = q["slack_line.surplus"] * q["tension"] / q["surge_mass"]
        dip = fastest * length / (2 * np.pi) * (1 - np.cos(2 * np.pi * share))
        speed = speed - np.where(q["slack_line.carriage"] > 0.5, dip, 0.0)
    if q.has("slack_line.brake"):
        share, length = _of_event(q, t)
        first = QUICK * length
        # half a cosine down in the first part, whose steepest is brake R/(m - X_udot); half a cosine up in the rest
        deep = q["slack_line.brake"] * q["tension"] / q["surge_mass"] * 2 * first / np.pi
        down = (1 - np.cos(np.pi * np.minimum(share / QUICK, 1.0))) / 2
        back = (1 - np.cos(np.pi * np.maximum(share - QUICK, 0.0) / (1 - QUICK))) / 2
        speed = speed - deep * (down - back)
    return speed


def push(q: Lanes, t: float) -> Array:
    """What carries the model ahead, N along the hull ``(n,)``: a following wave, a train of waves, somebody's hand.

    Parameters
    ----------
    q : numbers
    t : time, s
    """
    found = np.zeros(q.n)
    if q.has("slack_line.surplus"):
        wave = q["slack_line.surplus"] * q["tension"] * np.sin(2 * np.pi * _of_event(q, t)[0])
        found = found + np.where(q["slack_line.carriage"] > 0.5, 0.0, wave)
    if q.has("slack_line.crest"):
        share = _of_event(q, t)[0]
        envelope = np.sin(np.pi * share) ** 2
        found = found + q["slack_line.crest"] * q["tension"] * envelope * np.sin(2 * np.pi * CRESTS * share)
    if q.has("slack_line.shove"):
        found = found + q["slack_line.shove"] * q["tension"] * np.sin(np.pi * _of_event(q, t)[0]) ** 2
    return found


def _of_event(q: Lanes, t: float) -> tuple[Array, Array]:
    """How far a slackening is (0 to 1, held there), and how long it lasts."""
    length = np.maximum(q["slack_line.length_s"], 0.1)
    return np.clip((t - q["slack_line.begin_s"]) / length, 0.0, 1.0), length
