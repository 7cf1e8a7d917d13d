"""A flash as a clock tie: found in a film, told to a part of a frame by the exposures, weighed against the motion."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import av
import numpy as np
import pytest
from clips import drawn

from towline.geometry.cameras.flash import FINE, GAIN_SHARE, Lit, flash_offset, tie_of
from towline.geometry.cameras.motion import JointMotion, joint_motion
from towline.geometry.cameras.words import cameras_file
from towline.geometry.motion import run_datum
from towline.geometry.poses import poses_from_tracks
from towline.record import InputError
from towline.record.run import cameras_of
from towline.vision import read_frames
from towline.vision.flash import brightness, flashes

NOISE = 1e-3
"""Of a picture's brightness, over what the flash adds to a frame that it fills."""


def light(begin_s: float, end_s: float, t_s: np.ndarray, exposure_s: float) -> np.ndarray:
    """The share of each exposure in which the flash burns."""
    overlap = np.minimum(t_s + exposure_s / 2, end_s) - np.maximum(t_s - exposure_s / 2, begin_s)
    return np.clip(overlap, 0, None) / exposure_s


def level(rng: np.random.Generator, begin_s: float, end_s: float, step_s: float, exposure_s: float) -> Any:
    """Times and brightness of six seconds of film, of a camera at a phase of its own."""
    t_s = rng.uniform(0, step_s) + np.arange(round(6 / step_s)) * step_s
    share = light(begin_s, end_s, t_s, exposure_s) * (1 + GAIN_SHARE * rng.normal(size=len(t_s)))
    return t_s, 0.2 + 0.1 * share + 0.1 * NOISE * rng.normal(size=len(t_s))


@pytest.mark.once
@pytest.mark.parametrize("known", [True, False])
def test_the_offset_by_a_flash_is_as_uncertain_as_it_says(known: bool) -> None:
    """48 flashes of up to 0.12 s, two cameras at rates and exposures of their own: the rms of z scatters by 1/sqrt(96) = 0.1. Half
    of them are told better than light that is anywhere in one frame of either, 30 a second: e sqrt(2 / 12)."""
    rng, z, sds = np.random.default_rng(4), [], []
    while len(z) < 48:
        begin_s, long_s, offset_s = (
            rng.uniform(2.5, 3.0),
            np.exp(rng.uniform(*np.log([0.003, 0.12]))),
            rng.uniform(-0.5, 0.5),
        )
        steps = 1 / rng.choice([25.0, 30.0, 50.0], 2)
        exposures = steps * rng.uniform(0.1, 1.0, 2)
        lit = []
        for step_s, exposure_s, shift_s in zip(steps, exposures, (0.0, offset_s), strict=True):
            seen = level(rng, begin_s - shift_s, begin_s - shift_s + long_s, step_s, exposure_s)
            lit.append(flashes(*seen, exposure_s if known else 0.0))
        if not all(len(found) == 1 for found in lit):
            continue  # between two exposures: nobody saw it
        told, sd = flash_offset(lit[0][0], lit[1][0])
        z.append((told - offset_s) / sd)
        sds.append(sd)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.3)
    assert np.median(sds) < np.sqrt(2 / 12) / 30


@pytest.mark.slow
def test_a_flash_that_fills_frames_is_not_said_to_be_told_better_than_it_is() -> None:
    """40 flashes of 0.1 s, exposed all the time at 30 a second: the rms of z scatters by 1/sqrt(80) = 0.11, none is beyond 4. On a
    grid of lengths wider than what both cameras tell together it is 1.4, one in a hundred beyond 5."""
    rng, z = np.random.default_rng(3), []
    for _ in range(40):
        begin_s, offset_s = rng.uniform(2.5, 3.0), rng.uniform(-0.5, 0.5)
        lit = [
            flashes(*level(rng, begin_s - shift_s, begin_s - shift_s + 0.1, 1 / 30, 1 / 30), 1 / 30)[0]
            for shift_s in (0.0, offset_s)
        ]
        told, sd = flash_offset(*lit)
        z.append((told - offset_s) / sd)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.33)
    assert np.abs(z).max() < 4


def test_a_long_flash_is_told_to_a_part_of_the_frame_and_a_short_one_to_its_exposure() -> None:
    """Four frames, exposed all the time at 30 a second: its ends are told to 5 % of a frame each. One frame in each camera: a
    flash of length d begins anywhere in e - d of each, in all (e - d)^2 ways, whose difference has the variance (e - d)^2 / 6;
    over all d, each as likely as its double, from the grid's least one."""
    step_s, rng = 1 / 30, np.random.default_rng(1)
    t_s = 3 + np.arange(-30, 30) * step_s

    def of(begin_s: float, end_s: float, shift_s: float, exposure_s: float, bright: float = 0.1) -> Lit:
        rise = light(begin_s, end_s, t_s + shift_s, exposure_s) + NOISE * rng.normal(size=len(t_s))
        [lit] = flashes(t_s, 0.5 + bright * rise, exposure_s)
        return lit

    offset_s, sd_s = flash_offset(of(3.01, 3.13, 0.0, step_s), of(3.01, 3.13, 0.007, step_s))
    assert abs(offset_s - 0.007) < 5 * sd_s
    assert sd_s < 0.05 * step_s
    begin_s = t_s[31] - 1e-4
    offset_s, sd_s = flash_offset(*(of(begin_s, begin_s + 1e-3, shift_s, step_s, 1.0) for shift_s in (0.0, 0.003)))
    assert abs(offset_s - 0.003) < step_s
    least = 0.5 / FINE
    d = least + (1 - least) * (np.arange(2000) + 0.5) / 2000
    assert sd_s == pytest.approx(step_s * np.sqrt(((1 - d) ** 4 / 6 / d).sum() / ((1 - d) ** 2 / d).sum()), rel=0.1)


def test_only_flashes_are_taken_for_flashes() -> None:
    """A slow change of light, noise, a lamp that stays on, a dark moment, a flash cut by the film's end: none of them is one."""
    rng, t_s = np.random.default_rng(2), np.arange(300) / 30
    slow = 0.3 + 0.01 * np.sin(t_s) + 1e-3 * rng.normal(size=300)
    assert flashes(t_s, slow) == []
    assert flashes(t_s, slow + 0.1 * (t_s > 5)) == []
    assert flashes(t_s, slow - 0.1 * ((t_s > 5) & (t_s < 5.1))) == []
    assert flashes(t_s, slow + 0.1 * (t_s > 9.95)) == []
    assert flashes(t_s[:4], slow[:4]) == []
    found = flashes(t_s, slow + 0.1 * ((t_s > 5) & (t_s < 5.12)) + 0.05 * (np.abs(t_s - 8) < 0.01))
    assert [round(lit.middle_s, 1) for lit in found] == [5.1, 8.0]


def test_a_flash_in_two_films_ties_their_clocks(tmp_path: Path) -> None:
    """Compressed films at 30 and 25 pictures a second; the flash begins 1.21 s and 0.83 s after their beginnings."""
    lit = []
    for name, rate, begin_s in (("a", 30, 1.21), ("b", 25, 0.83)):
        t_s = np.arange(3 * rate) / rate
        shares = light(begin_s, begin_s + 0.11, t_s, 1 / rate)
        path = tmp_path / f"{name}.mp4"
        with av.open(str(path), "w") as target:
            stream = target.add_stream("libx264", rate=Fraction(rate), options={"crf": "20"})
            stream.width, stream.height, stream.pix_fmt = 160, 96, "yuv420p"
            for share in shares:
                planes = drawn(0)
                planes[:96] = np.minimum(planes[:96] * 0.6 + 60 * share, 235).astype(np.uint8)
                target.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))
            target.mux(stream.encode(None))
        [one] = flashes(*brightness(read_frames(path)), 1 / rate)
        lit.append(one)
    offset_s, sd_s = flash_offset(*lit)
    assert abs(offset_s - 0.38) < 4 * sd_s
    assert sd_s < 0.003


# against the motion ---------------------------------------------------------------------------------------------------


def views(case: Any) -> tuple[list[Any], list[Any]]:
    poses, mappings = [], []
    for view, tracks in zip(cameras_of(case.run), case.tracks, strict=True):
        fit = run_datum(view, None)
        mappings.append(fit.mapping)
        poses.append(poses_from_tracks(view, tracks, fit.mapping, fit, None, pulled=True))
    return poses, mappings


def lit_at(case: Any, moment_s: float, off_s: float = 0.0) -> tuple[list[Lit], list[Lit]]:
    """A flash of 0.1 s at a moment of the first clock, as both cameras see it; the second one's is off by so much."""
    found = []
    for index, tracks in enumerate(case.tracks):
        own_s = np.unique(tracks["t_s"])
        first_s = own_s if index == 0 else case.offset_s + (1 + case.rate) * own_s
        step_s = float(np.median(np.diff(own_s)))
        begin_s = moment_s + (off_s if index else 0.0)
        found.append(flashes(own_s, 0.2 + 0.1 * light(begin_s, begin_s + 0.1, first_s, step_s), step_s))
    return found[0], found[1]


@pytest.fixture(scope="module")
def case(pairs: ModuleType) -> Any:
    return pairs.random_case(3, duration_s=25.0)


@pytest.fixture(scope="module")
def by_motion(case: Any) -> JointMotion:
    return joint_motion(case.run, *views(case))


def test_a_flash_counts_beside_the_motion_by_its_weight(case: Any, by_motion: JointMotion) -> None:
    lit = lit_at(case, 12.0)
    found = joint_motion(case.run, *views(case), lit)
    assert found.flash is not None
    assert found.flash.agrees
    motion, flash, both = (
        by_motion.match.clock.sd_at(np.array(found.flash.known.at_s)),
        found.flash.known.sd_s,
        found.match.clock.sd_at(np.array(found.flash.known.at_s)),
    )
    # no less sure than the weights say; a little surer, since the flash tells pulls and lags, too
    weighed = (motion**-2 + flash**-2) ** -0.5
    assert 0.7 * weighed < both < 1.02 * weighed
    there = np.array(12.0 - case.offset_s)
    assert abs(found.match.clock.first(there) - case.offset_s - (1 + case.rate) * there) < 4 * both
    file = cameras_file(case.run, found, "test", {})
    assert file.flash_used
    assert any("they agree" in sentence and "a flash that both cameras saw" in sentence for sentence in file.sentences)


def test_a_flash_that_contradicts_the_motion_is_said_and_left_out(case: Any, by_motion: JointMotion) -> None:
    found = joint_motion(case.run, *views(case), lit_at(case, 12.0, off_s=0.06))
    assert found.match.clock.offset_s == by_motion.match.clock.offset_s
    file = cameras_file(case.run, found, "test", {})
    assert not file.flash_used
    assert file.flash_s is not None
    assert any("they do not agree" in sentence and "the motion's is taken" in sentence for sentence in file.sentences)


def test_flashes_far_apart_by_the_motion_are_not_one(case: Any, by_motion: JointMotion) -> None:
    one, two = lit_at(case, 8.0)[0], lit_at(case, 14.0)[1]
    assert tie_of(one, two, by_motion.match.clock) is None
    assert tie_of(one, [], by_motion.match.clock) is None


def test_a_flash_tells_the_clock_where_the_model_stands_still(pairs: ModuleType) -> None:
    still = pairs.random_case(5, duration_s=15.0, still=True)
    with pytest.raises(InputError, match="state offset_s"):
        joint_motion(still.run, *views(still))
    found = joint_motion(still.run, *views(still), lit_at(still, 7.0))
    assert found.match.clock.offset_s == pytest.approx(still.offset_s, abs=0.008)  # and 7 s of a rate off by 1e-4
    assert any("the flash alone does" in s for s in cameras_file(still.run, found, "test", {}).sentences)
