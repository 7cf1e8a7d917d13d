"""Two live cameras of one tow, joined while it is filmed: joint values against the truth.

The tows are those of ``two_cameras_cases``: pixel tracks through two cameras of OpenCV's that are not synchronised. Their frames
come as ``live.jsonl`` has them, each some time after it was taken (a camera's own delay, up to ``DELAY_S``, and jitter), and the
joint is asked ten times a second of that clock, as while a tow is filmed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from two_cameras_cases import Case

from towline.geometry.motion import run_datum
from towline.live.joint import Joint
from towline.record.run import cameras_of

DELAY_S, JITTER_S = 0.3, 0.02
"""Between a picture and its last byte here: a camera's own, evenly up to the first; and of every picture, exponential."""
ASKED_S = 0.1
NAMES = ("y_cg_m", "beta_rad", "alpha_rad")
HAND_S = 0.5
DEGREE = float(np.degrees(1.0))


@dataclass(frozen=True)
class Told:
    """What was said of one tow: the joint's lines, and what was said of the clock, each with when it was said."""

    rows: pd.DataFrame
    clock: list[dict[str, Any]]


def lines_of(case: Case, rng: np.random.Generator) -> list[list[dict[str, Any]]]:
    """Each camera's frames as ``live.jsonl`` has them."""
    found = []
    for place, tracks in enumerate(case.tracks):
        delay = rng.uniform(0, DELAY_S)
        lines: list[dict[str, Any]] = []
        names = tracks["marker"].unique().tolist()
        count = tracks["frame"].nunique()
        places = tracks[["u_px", "v_px", "sigma_u_px", "sigma_v_px"]].to_numpy().reshape(count, len(names), 4)
        own_s = tracks["t_s"].to_numpy().reshape(count, len(names))[:, 0]
        taken_s = own_s if place == 0 else case.offset_s + (1 + case.rate) * own_s
        here_s = np.maximum.accumulate(taken_s + delay + rng.exponential(JITTER_S, count))
        for frame, (t_s, arrived_s, each) in enumerate(zip(own_s.tolist(), here_s.tolist(), places, strict=True)):
            marks = {
                name: [float(v) for v in four] if np.isfinite(four).all() else "not there"
                for name, four in zip(names, each, strict=True)
            }
            lines.append({"frame": frame, "t_s": t_s, "arrived_s": arrived_s, "marks": marks, "light": 0.3})
        found.append(lines)
    return found


def heard(
    lines: list[list[dict[str, Any]]], every_s: float = ASKED_S
) -> Iterator[tuple[float, list[list[dict[str, Any]]]]]:
    """What came of each until then, again and again."""
    at, now_s = [0, 0], min(each[0]["arrived_s"] for each in lines)
    while any(k < len(each) for k, each in zip(at, lines, strict=True)):
        now_s += every_s
        new = []
        for place, each in enumerate(lines):
            first = at[place]
            while at[place] < len(each) and each[at[place]]["arrived_s"] <= now_s:
                at[place] += 1
            new.append(each[first : at[place]])
        yield now_s, new


def filmed(case: Case, rng: np.random.Generator, by_arrival: bool = True, every_s: float = ASKED_S) -> Told:
    """All that is said of a case while it comes."""
    fits = [run_datum(view, None) for view in cameras_of(case.run)]
    joint = Joint(case.run, fits, by_arrival)
    rows: list[dict[str, Any]] = []
    clock = []
    for now_s, new in heard(lines_of(case, rng), every_s):
        for place in (0, 1):
            joint.add(place, new[place])
        said = joint.match()
        if said is not None:
            clock.append({**said, "now_s": now_s})
        rows += [{**row, "now_s": now_s} for row in joint.rows()]
    rows += [{**row, "now_s": now_s} for row in joint.rows(ended=True)]
    return Told(pd.DataFrame(rows), clock)
