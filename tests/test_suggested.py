"""Effects that a residual itself suggests: a bounce on a soft line, a camera turned between runs or in one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from towline.blind.one_case import case_of
from towline.blind.truth.folders import write_case
from towline.diagnose.effects import Effect, Seen
from towline.diagnose.inference.hypothesis import Hypothesis
from towline.diagnose.tow import springs
from towline.diagnose.tow.model import TowModel
from towline.diagnose.tow.shifts import shift_effects
from towline.diagnose.tow.springs import ring_fit, springing_effects
from towline.pipeline.diagnosing import diagnose_folders

RATE_HZ, DECAY_S, SIZE_M = 0.46, 0.09, 0.002

CREEPS = [
    "little by little in all runs",
    *(f"little by little, and no further from {share} of all runs on" for share in ("20%", "35%", "50%", "65%", "80%")),
    "ever slower, as what grows warm",
]
"""Courses of a camera that gives way."""


@pytest.fixture(scope="module")
def runs(tow_runs: Callable[[int, int], list]) -> list:
    return tow_runs(4, 3)


def left(
    runs: list, rng: np.random.Generator, line: list | None = None, distance: list | None = None
) -> list[np.ndarray]:
    """What a base fit might leave: the channels' own noise, and what is added to line and marker distance."""
    rows = []
    for k, run in enumerate(runs):
        rest = np.column_stack(
            [rng.normal(0, np.sqrt(np.median(np.diag(c))), len(run.centre_s)) for c in run.covariance]
        )
        rest[:, 2] += 0.0 if line is None else line[k]
        rest[:, 3] += 0.0 if distance is None else distance[k]
        rows.append(rest)
    return rows


def straight(t_s: np.ndarray) -> Seen:
    """Three straight tows with a pull of 1 N."""
    none = np.zeros((len(t_s), 3, 1))
    still = (none, none, none)
    return Seen(t_s[:, None, None], still, still, none, np.zeros((1, 1, 1)), np.ones((3, 1)), np.zeros((2, 1, 1, 4, 3)))


def ring(run, phase: float) -> np.ndarray:
    """A bounce as its blocks' means see it, from 200 samples each."""
    fine = run.centre_s[:, None] + run.step_s * (np.arange(200) / 200 - 0.4975)
    return (SIZE_M * np.exp(-DECAY_S * fine) * np.cos(2 * np.pi * RATE_HZ * fine + phase)).mean(axis=1)


@pytest.mark.slow
def test_noise_suggests_no_bounce_and_a_bounce_is_found_with_each_runs_own_phase(runs: list) -> None:
    rng = np.random.default_rng(5)
    assert springing_effects(runs, left(runs, rng)) == []
    phases = (0.3, 2.0, -1.1)
    found = springing_effects(runs, left(runs, rng, [ring(r, p) for r, p in zip(runs, phases, strict=True)]))
    assert [e.variant for e in found] == ["springs at 0.46, 0.46, 0.46 Hz", "bounces as its radius shows"]
    # four numbers a run are cheaper than a course
    assert 0 < found[0].cost < found[1].cost
    t_s = np.arange(0.0, 20.0, 0.05)
    seen = straight(t_s)
    bounce = found[0].stretch(seen, 0.0, 0.0, 1.0, 0.0)[:, :, 0]  # pyright: ignore[reportOptionalCall]
    for k, phase in enumerate(phases):
        true = SIZE_M * np.exp(-DECAY_S * t_s) * np.cos(2 * np.pi * RATE_HZ * t_s + phase)
        # four numbers from the blocks of its first 1/(2 decay) seconds, their noise at 4 sd
        noise = np.sqrt(np.median(np.diag(runs[k].covariance[2])))
        assert np.abs(bounce[:, k] - true).max() < 4 * noise * np.sqrt(4 * runs[k].step_s * 2 * DECAY_S)


@pytest.mark.slow
def test_what_a_ring_costs_is_what_searching_noise_for_one_finds(runs: list, monkeypatch: pytest.MonkeyPatch) -> None:
    """Odds of e^1.5 for a ring, as its evidence has them, are reached by noise in e^-1.5 of the campaigns at most (Markov)."""
    monkeypatch.setattr(springs, "CLEAR", -np.inf)
    rng, sure, odds = np.random.default_rng(12), 1.5, list[float]()
    for _ in range(40):
        base = left(runs, rng)
        (found,) = [e for e in springing_effects(runs, base) if e.variant.startswith("springs")]
        fine = runs[0].step_s * (np.arange(200) / 200 - 0.4975)
        explained = 0.0
        for k, run in enumerate(runs):
            seen = straight((run.centre_s[:, None] + fine).ravel())
            bounce = found.stretch(seen, 0.0, 0.0, 1.0, 0.0)[:, k, 0].reshape(-1, 200).mean(axis=1)  # pyright: ignore
            plain = np.column_stack([np.ones_like(run.centre_s), run.centre_s])
            rest, gone = (
                x - plain @ np.linalg.lstsq(plain, x, rcond=None)[0] for x in (base[k][:, 2], base[k][:, 2] - bounce)
            )
            explained += float(rest @ rest - gone @ gone) / run.usual_sd(2) ** 2
        odds.append(explained / 2 - found.cost)
    expected = len(odds) * np.exp(-sure)
    assert sum(one > sure for one in odds) < expected + 4 * np.sqrt(expected)


def test_a_bounce_that_is_no_ring_is_taken_as_it_goes(runs: list) -> None:
    """Its height and pace wander: the whole course is followed to the noise of the numbers that say it."""
    rng, height_m = np.random.default_rng(9), 0.004

    def course(t: np.ndarray, phase: float) -> np.ndarray:
        return height_m * (1 + 0.3 * np.sin(0.3 * t)) * np.cos(2 * np.pi * 0.7 * t + phase + 0.5 * np.sin(0.4 * t))

    def seen_of(run, phase: float) -> np.ndarray:
        return course(run.centre_s[:, None] + run.step_s * (np.arange(200) / 200 - 0.4975), phase).mean(axis=1)

    base = left(runs, rng, [seen_of(r, p) for p, r in enumerate(runs)])
    ring, whole = springing_effects(runs, base)
    assert whole.variant == "bounces as its radius shows"
    t_s = np.arange(3.0, 40.0, 0.05)
    seen = straight(t_s)
    for k, run in enumerate(runs):
        noise = np.sqrt(np.median(np.diag(run.covariance[2])))
        off = [
            float(np.std(e.stretch(seen, 0.0, 0.0, 1.0, 0.0)[:, k, 0] - course(t_s, k)))  # pyright: ignore[reportOptionalCall]
            for e in (ring, whole)
        ]
        # a block's mean flattens 0.7 Hz by a tenth, which is put back with the noise
        assert off[1] < 1.3 * noise
        assert off[0] > 3 * noise


def test_a_step_in_line_and_distance_suggests_when_the_camera_turned(runs: list) -> None:
    rng, at_s = np.random.default_rng(6), 21.37
    found = shift_effects(runs, left(runs, rng))
    # a post that was moved before a run, a camera that was turned before one, or little by little
    since = [f"from {r.name} on" for r in runs[1:]]
    assert [e.variant for e in found if e.name == "datum_bias"] == since
    assert [e.variant for e in found if e.name == "camera_shift"] == [*since, *CREEPS]
    run = runs[1]
    share = np.clip((run.centre_s + run.step_s / 2 - at_s) / run.step_s, 0, 1)
    step = [np.zeros(len(r.centre_s)) if r is not run else 0.002 * share for r in runs]
    offered = shift_effects(runs, left(runs, rng, step, [-s for s in step]))
    found = next(e for e in offered if e.variant.startswith(f"from {run.name}, 21.") and e.variant.endswith(" s on"))
    assert found.when is not None
    np.testing.assert_allclose(found.when(run.name, run.centre_s), share, atol=0.15)
    assert not found.when(runs[0].name, run.centre_s).any()
    assert found.when(runs[2].name, run.centre_s).all()


@pytest.mark.parametrize("at_s", [21.31, 21.37, 21.52])
@pytest.mark.parametrize("size_m", [0.01, 0.1])
def test_a_gross_turn_is_timed_as_finely_as_it_shows(runs: list, size_m: float, at_s: float) -> None:
    """Its share of the block it is in is known to that block's noise over the step, and to what two straight lines beside it, of
    six blocks each, leave open: half as much variance. What a step does goes on changing as the model moves.
    """
    rng, run = np.random.default_rng(8), runs[1]
    share = np.clip((run.centre_s + run.step_s / 2 - at_s) / run.step_s, 0, 1)
    course = size_m * share * (1 + 0.02 * (run.centre_s - at_s))
    step = [np.zeros(len(r.centre_s)) if r is not run else course for r in runs]
    offered = shift_effects(runs, left(runs, rng, step, [-s for s in step]))
    found = next(e for e in offered if e.variant.startswith(f"from {run.name}, 21.") and e.variant.endswith(" s on"))
    assert found.when is not None
    sd = np.sqrt(1.5) / np.hypot(size_m / run.usual_sd(2), size_m / run.usual_sd(3))
    np.testing.assert_allclose(found.when(run.name, run.centre_s), share, atol=4 * sd)


@pytest.mark.parametrize("size_m", [0.0, 0.01])
def test_a_turn_that_shows_across_the_tank_alone_is_found_by_its_jump(runs: list, size_m: float) -> None:
    """Line and marker distance stay as they are. What a model does that the base lacks, half a centimetre of slow motion, is no
    jump, though it is as large.
    """
    rng, run, at_s = np.random.default_rng(11), runs[1], 22.4
    rows = left(runs, rng)
    for row, each in zip(rows, runs, strict=True):
        row[:, 0] += 0.005 * np.sin(0.5 * each.centre_s)
        row[:, 1] += 0.003 * np.sin(0.7 * each.centre_s)
    share = np.clip((run.centre_s + run.step_s / 2 - at_s) / run.step_s, 0, 1)
    rows[1][:, 0] += size_m * share
    found = [e for e in shift_effects(runs, rows) if e.name == "camera_shift" and f"{run.name}, " in e.variant]
    if not size_m:
        assert found == []
        return
    turned = next(e for e in found if e.variant.startswith("from"))
    assert turned.when is not None
    # noise of its block, and at most twice as much variance of the curves beside it
    np.testing.assert_allclose(
        turned.when(run.name, run.centre_s), share, atol=4 * np.sqrt(3) * run.usual_sd(0) / size_m
    )


def test_a_mark_that_is_lost_for_a_while_is_no_turned_camera(runs: list) -> None:
    """Beside its mean, what a base lacks is far off before and after it: that is no jump."""
    rows = left(runs, np.random.default_rng(12))
    for row, each in zip(rows, runs, strict=True):
        row[:, 0] += 0.02 * np.sin(0.5 * each.centre_s)
    rows[1][40:60, :2] = np.nan
    found = [e for e in shift_effects(runs, rows) if e.name == "camera_shift" and " s on" in e.variant]
    assert found == []


def test_a_camera_that_was_turned_for_a_while_is_offered_with_both_its_times(runs: list) -> None:
    rng, run, (begin, end) = np.random.default_rng(6), runs[1], (14.3, 27.9)
    inside = [np.clip((run.centre_s + run.step_s / 2 - t) / run.step_s, 0, 1) for t in (begin, end)]
    step = [0.002 * (inside[0] - inside[1]) if r is run else np.zeros(len(r.centre_s)) for r in runs]
    offered = shift_effects(runs, left(runs, rng, step, [-s for s in step]))
    (found,) = [e for e in offered if e.variant.startswith(f"in {run.name}")]
    assert found.when is not None
    shares = [found.when(r.name, r.centre_s) for r in runs]
    assert not shares[0].any()
    assert not shares[2].any()
    # to a block at either end
    assert np.abs(shares[1] - (inside[0] - inside[1])).sum() < 2.5


@pytest.mark.parametrize("until_the_end", [True, False])
def test_a_camera_turned_for_one_end_of_a_run_is_offered_as_either(runs: list, until_the_end: bool) -> None:
    """Of a run of two halves nothing in it says which was the one: the other runs do, when both are fitted."""
    rng, run, at_s = np.random.default_rng(6), runs[1], 24.6
    late = np.clip((run.centre_s + run.step_s / 2 - at_s) / run.step_s, 0, 1)
    turned = late if until_the_end else 1 - late
    step = [0.002 * turned if r is run else np.zeros(len(r.centre_s)) for r in runs]
    offered = shift_effects(runs, left(runs, rng, step, [-s for s in step]))
    found = [e for e in offered if e.variant.startswith(f"in {run.name}")]
    shares = [[e.when(r.name, r.centre_s) for r in runs] for e in found if e.when is not None]
    assert len(shares) == 2
    assert min(np.abs(own[1] - turned).sum() for own in shares) < 1.5
    assert not any(own[k].any() for own in shares for k in (0, 2))


def test_little_by_little_goes_on_from_run_to_run(runs: list) -> None:
    offered = {e.variant: e for e in shift_effects(runs, left(runs, np.random.default_rng(7)))}
    found = offered["little by little in all runs"]
    assert found.when is not None
    shares = np.concatenate([found.when(r.name, r.centre_s) for r in runs])
    assert (np.diff(shares) > 0).all()
    assert (shares[0], shares[-1]) == pytest.approx((0.0, 1.0), abs=0.01)
    # what gave way and then stands, or gives way ever less, is near one that is offered, wherever that was: a tenth off at most
    courses = [
        np.concatenate([e.when(r.name, r.centre_s) for r in runs]) for e in offered.values() if e.when and e.form > 0
    ]
    truths = [np.minimum(shares / at, 1.0) for at in (0.28, 0.42, 0.6, 0.9)]
    truths += [1 - np.exp(-shares / time) for time in (0.2, 0.5)]
    for truth in truths:
        # the size of the turn is found
        left_over = [truth - course * (course @ truth) / (course @ course) for course in courses]
        assert min(np.sqrt(np.mean(rest**2)) for rest in left_over) < 0.1 * np.sqrt(np.mean(truth**2))


def put_right(runs: list, cases: ModuleType, effect: Effect, numbers: np.ndarray) -> list[np.ndarray]:
    """What was seen, with an effect's fault taken out."""
    tows = [r.data.tow for r in runs]
    own = np.array([[0.1, 0, 0, 0, 0, 0, t.tension_n, t.tow_point_m, t.line_length_m, t.speed_m_s, 0, 0] for t in tows])
    return TowModel(runs, 1.28).measured(Hypothesis(np.array(cases.SIX), own, (effect,), (numbers,)))


def test_a_turned_camera_changes_only_what_was_seen_since(runs: list, cases: ModuleType) -> None:
    offered = shift_effects(runs, left(runs, np.random.default_rng(7)))
    effect = next(e for e in offered if e.name == "camera_shift" and e.variant == f"from {runs[2].name} on")
    turn = np.array([0.001, 0.0, 0.0])
    seen_since, seen_ever = (put_right(runs, cases, e, turn) for e in (effect, replace(effect, when=None)))
    for run, since, ever in zip(runs, seen_since, seen_ever, strict=True):
        np.testing.assert_array_equal(since, ever if run is runs[2] else run.values)
        assert np.nanmax(np.abs(ever - run.values)) > 1e-4


def test_a_slow_turn_has_its_mean_share_of_each_block(runs: list, cases: ModuleType) -> None:
    """Of blocks that hold an end of it, too; and what was seen is put right by that share of the whole turn."""
    step = [np.where(r is runs[1], 0.002, 0.0) * (r.centre_s > 21.0) for r in runs]
    offered = shift_effects(runs, left(runs, np.random.default_rng(6), step, [-s for s in step]))
    effect = next(e for e in offered if e.variant.startswith("slowly") and e.variant.endswith("over about 3 s"))
    run, middle_s, over_s = runs[1], 20.13, 2.34
    assert effect.when is not None
    got = effect.when(run.name, run.centre_s, middle_s, over_s)
    within = run.step_s * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    exact = np.clip((run.centre_s[:, None] + within - middle_s) / over_s + 0.5, 0, 1).mean(axis=1)
    np.testing.assert_allclose(got, exact, atol=1e-6)
    turn, when = np.array([0.001, -0.002, 0.003]), [middle_s, over_s]
    always = next(e for e in offered if e.name == "camera_shift" and e.variant == f"from {runs[1].name} on")
    slowly, whole = (put_right(runs, cases, e, n) for e, n in ((effect, np.r_[turn, when]), (always, turn)))
    np.testing.assert_array_equal(slowly[0], runs[0].values)
    np.testing.assert_allclose(slowly[1] - run.values, exact[:, None] * (whole[1] - run.values), atol=1e-9)
    np.testing.assert_array_equal(slowly[2], whole[2])


@pytest.mark.slow
def test_a_camera_that_turned_slowly_is_named_with_its_begin_and_end(tmp_path: Path) -> None:
    """Drawn by the blind check: one that took 3 or 9 s instead of its own 4.9 s leaves 6 % over, too much to be it."""
    case = case_of("slowly", "effect", ["camera_shift"], [777, 5], forms={"camera_shift": "slowly"})
    best = diagnose_folders(write_case(tmp_path, case)).diagnosis.file.ranking[0]
    assert best.effects == ["camera_shift"]
    assert best.probability > 0.95
    true, found = case.numbers, best.parameters
    over_s = true["camera_shift.over_s"]
    middle_s = true["camera_shift.time_s"] + over_s / 2
    for name, value in (("middle_s", middle_s), ("over_s", over_s)):
        number = found[f"camera_shift.{name}"]
        assert number.value == pytest.approx(value, abs=4 * number.std)


def test_without_marks_or_a_lens_no_turn_is_suggested(runs: list) -> None:
    """A turn is taken out of pixels through the lens; one run without is enough."""
    base = left(runs, np.random.default_rng(8))
    assert len([e for e in shift_effects(runs, base) if e.name == "camera_shift"]) == 2 + len(CREEPS)
    assert shift_effects([runs[0], replace(runs[1], marks=None), runs[2]], base) == []
    marks = runs[1].marks
    file = marks.run.file.model_copy(update={"camera": None})
    bare = replace(runs[1], marks=replace(marks, run=replace(marks.run, file=file)))
    # a post is moved without any lens
    assert {e.name for e in shift_effects([runs[0], bare, runs[2]], base)} == {"datum_bias"}


@pytest.mark.parametrize("level", [(0.0, 0.0), (5.0, -0.3)])
def test_a_ring_is_explained_beside_a_constant_and_a_trend(level: tuple[float, float]) -> None:
    """Exact: its size and phase, and of the squares just those that constant and trend leave of it."""
    t = 0.5 * np.arange(90) + 0.25
    true, decay, rate = 3.0 * np.exp(0.7j), 0.08, 2.6
    wave = np.real(true * np.exp((-decay + 1j * rate) * t))
    explained, size = ring_fit(t, level[0] + level[1] * t + wave, decay, rate)
    assert size == pytest.approx(true, rel=1e-9)
    plain = np.column_stack([np.ones_like(t), t])
    left_ = wave - plain @ np.linalg.lstsq(plain, wave, rcond=None)[0]
    assert explained == pytest.approx(left_ @ left_, rel=1e-9)
