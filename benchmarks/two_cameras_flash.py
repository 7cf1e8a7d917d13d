"""Flashes before two cameras, and the tows of ``two_cameras_cases`` with one flash: offsets against the truth.

The light is a formula: a flash burns evenly from one moment to another, an exposure gets its share of it, each to 5 % of itself,
with noise of a thousandth of what a full frame gets.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from two_cameras_cases import Case

from towline.geometry.cameras.flash import EXPOSURES, GAIN_SHARE, Lit, flash_offset
from towline.geometry.cameras.motion import JointMotion
from towline.vision.flash import flashes

RISE, NOISE = 0.1, 1e-4
KINDS: tuple[tuple[str, tuple[float, float], float | None, float | None, bool], ...] = (
    ("0.1 s, exposed all the time", (30.0, 30.0), 1.0, 0.1, True),
    ("0.1 s, half of the time", (30.0, 30.0), 0.5, 0.1, True),
    ("0.1 s, a tenth of the time, 30 and 25/s", (30.0, 25.0), 0.1, 0.1, True),
    ("0.1 s, exposed all the time, not stated", (30.0, 30.0), 1.0, 0.1, False),
    ("0.1 s, any exposures, not stated", (30.0, 30.0), None, 0.1, False),
    ("2 ms, exposed all the time", (30.0, 30.0), 1.0, 0.002, True),
    ("2 ms to 0.3 s, exposed all the time", (30.0, 30.0), 1.0, None, True),
)
"""Words, frames/s, share of a frame's time that is exposed (None: each camera's its own, of ``EXPOSURES``), length of the flash
(None: as likely for every factor), the exposure is stated."""
LONG_S, LENGTHS_S = 0.1, (0.002, 0.3)


def seen(rng: np.random.Generator, t_s: np.ndarray, begin_s: float, long_s: float, exposure_s: float) -> np.ndarray:
    """Brightness of frames, whose times are on the flash's clock."""
    over = np.minimum(t_s + exposure_s / 2, begin_s + long_s) - np.maximum(t_s - exposure_s / 2, begin_s)
    share = np.clip(over, 0, None) / min(exposure_s, long_s)
    return 0.2 + RISE * share * (1 + GAIN_SHARE * rng.normal(size=len(t_s))) + NOISE * rng.normal(size=len(t_s))


def flash_rows(count: int, seed: int) -> None:
    """Print what flashes alone tell."""
    print(f"\n== flash: {count} flashes of each kind, two cameras, offsets up to 0.5 s")
    print(f"{'':42}{'seen by both':>13}{'offset rms':>12}{'stated':>9}{'z':>6}")
    for words, rates, share, long_s, known in KINDS:
        rng, off, sds = np.random.default_rng(seed), [], []
        for _ in range(count):
            begin_s, offset_s, lit = rng.uniform(2.5, 3.0), rng.uniform(-0.5, 0.5), []
            burns_s = float(np.exp(rng.uniform(*np.log(LENGTHS_S)))) if long_s is None else long_s
            for rate, shift_s in zip(rates, (0.0, offset_s), strict=True):
                own_s = rng.uniform(0, 1 / rate) + np.arange(6 * rate) / rate
                exposure_s = (float(rng.choice(EXPOSURES)) if share is None else share) / rate
                level = seen(rng, own_s + shift_s, begin_s, burns_s, exposure_s)
                lit.append(flashes(own_s, level, exposure_s if known else 0.0))
            if all(len(found) == 1 for found in lit):
                told_s, sd_s = flash_offset(lit[0][0], lit[1][0])
                off.append(told_s - offset_s)
                sds.append(sd_s)
        error, sd = np.array(off), np.array(sds)
        rms, z = np.sqrt((error**2).mean()), np.sqrt(((error / sd) ** 2).mean())
        print(
            f"{words:42}{len(error):6d} of {count:3d}{1e3 * rms:9.2f} ms{1e3 * np.median(sd):6.2f} ms{z:6.2f}",
            flush=True,
        )


def lit_by(case: Case, rng: np.random.Generator) -> tuple[list[Lit], list[Lit]]:
    """A flash in the middle of a tow as each camera sees it, exposed all the time."""
    begin_s, found = rng.uniform(20.0, 40.0), []
    for index, tracks in enumerate(case.tracks):
        own_s = np.unique(tracks["t_s"])
        first_s = own_s if index == 0 else case.offset_s + (1 + case.rate) * own_s
        step_s = float(np.median(np.diff(own_s)))
        found.append(flashes(own_s, seen(rng, first_s, begin_s, LONG_S, step_s), step_s))
    return found[0], found[1]


def tied_rows(cases: list[Case], joined: Callable[[Case, tuple[list[Lit], list[Lit]]], JointMotion], seed: int) -> None:
    """Print offsets of tows by the motion, by a flash, and by both."""
    rng, rows, against = np.random.default_rng(seed), [], 0
    for case in cases:
        found = joined(case, lit_by(case, rng))
        assert found.flash is not None
        assert found.flash.by_motion is not None
        against += not found.flash.agrees
        at = np.array(found.flash.known.at_s)
        true = case.offset_s + case.rate * float(at)
        clock = found.match.clock
        both = float(clock.first(at)) - float(at), float(clock.sd_at(at))
        flash = found.flash.known.offset_s, found.flash.known.sd_s
        rows.append([(value - true, sd) for value, sd in (found.flash.by_motion, flash, both)])
    table = np.array(rows)
    print(
        f"\n== flash in {len(cases)} tows of 60 s, two marks, at the flash; flash and motion contradict one another in {against}"
    )
    for place, words in enumerate(("by the motion", "by the flash", "by both")):
        error, sd = table[:, place].T
        rms, z = np.sqrt((error**2).mean()), np.sqrt(((error / sd) ** 2).mean())
        within = int((np.abs(error) < 1e-3).sum())
        print(
            f"{words:16}{1e3 * rms:6.2f} ms rms, within 1 ms {within} of {len(cases)}, stated {1e3 * np.median(sd):.2f}, z {z:.2f}"
        )


__all__ = ["flash_rows", "tied_rows"]
