"""A taut line that falls slack and straightens with a jerk: its course from the radius, and its name from a reality of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towline.blind.one_case import case_of
from towline.blind.truth.cases import swum
from towline.blind.truth.folders import write_case
from towline.diagnose.tow.jerks import Radius, events, longer
from towline.diagnose.tow.slackness import SLACK_Z, jerk_effects
from towline.diagnose.tow.surging import PUSHES, STEP_S, Event, Push, Straight, Surged, Swinging, courses, surged
from towline.pipeline.diagnosing import diagnose_folders

TOW = Straight(1.28, 0.05, 1.85)
SPRING, DAMPING = 15.0, 0.2
BLOCK_S, SD_M = 0.35, 3e-4


def numbers(begin: float, length: float, hard: float) -> np.ndarray:
    return np.array([begin, *np.log([length, hard, 1.0, SPRING, DAMPING, 1.0])])


def course_of(event: Event) -> tuple[np.ndarray, Surged]:
    (found,) = courses([event])
    return found


def exact(
    push: Push,
    length: float,
    hard: float,
    t_s: np.ndarray,
    swings: tuple[float, float, float] = (0.0, 1.0, 1.0),
    line: tuple[float, float] = (SPRING, DAMPING),
) -> Surged:
    """The same motion by an integrator with error control, written down anew: ahead, m, and pull over the resistance.

    A carriage that slows is one here, and the model's own speed is a state, not how far it goes ahead.

    ``swings``: what a taut line pulls with beyond the resistance, how much the faster it shortens, cosine of its angle; ``line``:
    how it bounces, rad/s, and its damping.
    """
    (beyond, lighter, cosine), (stiff, damping) = swings, line
    # a carriage that goes slower by a squared half sine slows by half a sine's turn
    deep = hard * TOW.pull_m_s2 * length / np.pi if push.carriage else 0.0

    def of_carriage(t: float) -> float:
        return -deep * np.sin(np.pi * min(t / length, 1.0)) ** 2

    def held(ahead: float, speed: float) -> float:
        spring = max(TOW.pull_m_s2 * (1 + beyond) - stiff**2 * ahead, 0.0)
        return max(spring - min(spring / TOW.pull_m_s2, 1.0) * 2 * damping * stiff * speed, 0.0)

    def rates(t: float, state: np.ndarray) -> list[float]:
        ahead, faster = state
        carried = 0.0 if push.carriage else hard * float(push(np.array([t / length]))[0])
        slower = (1 + faster / TOW.speed_m_s) ** TOW.exponent - 1
        taut, past = TOW.pull_m_s2 * (1 + beyond), faster - of_carriage(t)
        return [past, TOW.pull_m_s2 * (cosine * carried - slower) + lighter * (held(ahead, past) - taut)]

    found = solve_ivp(rates, (0, t_s[-1]), [0.0, 0.0], t_eval=t_s, max_step=0.005, rtol=1e-8, atol=1e-10)
    pull = [held(ahead, faster - of_carriage(t)) for t, (ahead, faster) in zip(t_s, found.y.T, strict=True)]
    return Surged(found.y[0], found.y[1], np.zeros(len(t_s)), np.array(pull) / TOW.pull_m_s2)


@pytest.mark.once
@pytest.mark.parametrize("push", PUSHES[:4], ids=lambda p: p.words)
def test_surge_on_a_stiff_line_is_what_an_exact_integrator_makes_of_it(push: Push) -> None:
    _, found = course_of(Event(push, numbers(0.0, 2.5, 2.0), TOW, 0.0))
    t_s = STEP_S * (np.arange(len(found.ahead_m)) + 1)
    wanted = exact(push, 2.5, 2.0, t_s)
    assert wanted.ahead_m.max() > 2e-3  # it does fall slack
    # steps of the first order: a bounce is off by one of them, at up to the closing speed
    slack = np.abs(np.gradient(wanted.ahead_m, t_s)).max() * STEP_S
    assert np.abs(found.ahead_m - wanted.ahead_m).max() < 3 * slack
    # and by what the jerk gives in one
    jerk = np.abs(np.gradient(wanted.faster_m_s, t_s)).max() * STEP_S
    assert np.abs(found.faster_m_s - wanted.faster_m_s).max() < 3 * jerk
    # what the jerks give back is the momentum that was lost while the line was slack
    assert np.sum(found.pull - 1) * STEP_S == pytest.approx(np.sum(wanted.pull - 1) * STEP_S, abs=0.02 * 2.5)


def test_a_carriage_that_slows_comes_back_to_its_speed() -> None:
    """However unevenly: what slows it, summed, is by how much it is slower, and in the end nothing."""
    stop, share = Push(1, carriage=True), (np.arange(4000) + 0.5) / 4000
    for skew in (0.4, 1.0, 2.0):
        slows = np.concatenate([[0.0], np.cumsum(stop(share, skew)) / len(share)])
        np.testing.assert_allclose((slows[1:] + slows[:-1]) / 2, stop.slowed(share, skew), atol=1e-3)
        assert slows[-1] == pytest.approx(0.0, abs=1e-3)
        # slowest after a fifth of its time, its half, four fifths
        assert share[np.argmax(stop.slowed(share, skew))] == pytest.approx(skew**2 / (1 + skew**2), abs=1e-3)
    assert not Push(1).slowed(share).any()


def swinging(beyond: float, lighter: float, cosine: float) -> Straight:
    return replace(TOW, swinging=Swinging(*(np.array([value]) for value in (0.0, beyond, lighter, cosine))))


def test_a_model_that_swings_falls_slack_later_and_faster() -> None:
    """Its line pulls harder, and sideways, where its hull is lighter: by an integrator with error control, as above."""
    swings = (0.4, 1.6, 0.8)
    t_s, found = course_of(Event(Push(1), numbers(0.0, 2.5, 4.5), swinging(*swings), 0.0))
    wanted = exact(Push(1), 2.5, 4.5, t_s + STEP_S, swings)
    assert wanted.ahead_m.max() > 2e-3
    assert np.abs(found.ahead_m - wanted.ahead_m).max() < 3 * np.abs(np.gradient(wanted.ahead_m, t_s)).max() * STEP_S
    assert np.sum(found.pull - wanted.pull) * STEP_S == pytest.approx(0.0, abs=0.02 * 2.5)
    np.testing.assert_allclose(found.pushed, 4.5 * Push(1)((t_s + STEP_S / 2) / 2.5), atol=1e-9)


def test_a_push_that_leaves_the_line_taut_is_all_push() -> None:
    """What an equation of motion with a line that keeps its length makes of the push itself needs nothing beside it."""
    _, found = course_of(Event(Push(0), numbers(0.0, 2.5, 1.6), swinging(0.9, 3.0, 0.75), 0.0))
    assert found.pushed.max() == pytest.approx(1.6, rel=1e-3)
    assert np.abs(found.pull - (1 + 0.9 - 0.75 / 3.0 * found.pushed)).max() < 0.05 * 1.6
    # the stretch of the stiff line that it takes, and how fast that comes
    stretch = 1.6 * TOW.pull_m_s2 * 0.75 / 3.0 / SPRING**2
    assert np.abs(found.ahead_m).max() < 1.05 * stretch
    assert np.abs(found.faster_m_s).max() < 2 * stretch * np.pi / 2.5


def test_of_a_carriage_that_slows_a_little_the_line_tells_the_model() -> None:
    """The line stays taut: the model goes as the carriage does, and nothing pushes it."""
    _, found = course_of(Event(Push(1, carriage=True), numbers(0.0, 2.5, 0.5), TOW, 0.0))
    share = np.clip(STEP_S * (np.arange(len(found.pull)) + 0.5) / 2.5, 0.0, 1.0)
    deep = 0.5 * TOW.pull_m_s2 * 2.5 / np.pi
    # its spring gives a little, and rings
    assert np.abs(found.faster_m_s + deep * np.sin(np.pi * share) ** 2).max() < 0.05 * deep
    assert not found.pushed.any()
    assert found.pull.min() > 0.3


def test_the_jerk_gives_back_what_the_slack_line_did_not_pull() -> None:
    """Momentum: a wave carries as much back as ahead, so that over all of it the line's pull is the resistance."""
    even = replace(TOW, exponent=0.0)
    pull = surged([Push(1)], numbers(0.0, 2.0, 1.8)[None], [even]).pull
    assert pull.min() == 0.0
    assert pull.max() > 2.0
    lost = np.sum(np.minimum(pull - 1, 0)) * STEP_S
    assert np.sum(pull - 1) * STEP_S == pytest.approx(0.0, abs=0.02 * abs(lost))


def seen(
    push: Push,
    begin: float,
    length: float,
    hard: float,
    t_s: np.ndarray,
    rng: np.random.Generator,
    width_s: float = BLOCK_S,
    sd_m: float = SD_M,
    line: tuple[float, float] = (SPRING, DAMPING),
) -> np.ndarray:
    """Means of the exact course, with noise."""
    fine = np.arange(0.0, 20.0, 0.002)
    ahead = exact(push, length, hard, fine, line=line).ahead_m
    at = t_s[:, None] - begin + width_s * ((np.arange(50) + 0.5) / 50 - 0.5)
    return np.interp(at, fine, ahead, left=0.0, right=0.0).mean(axis=1) + rng.normal(0, sd_m, len(t_s))


@pytest.mark.once
@pytest.mark.parametrize(("waves", "length", "hard"), [(0, 2.0, 1.7), (1, 2.0, 1.6), (3, 6.0, 2.0)])
def test_an_event_is_found_in_the_radius_with_its_time_length_and_strength(
    waves: int, length: float, hard: float
) -> None:
    rng, t_s = np.random.default_rng(4), BLOCK_S * (np.arange(125) + 0.5)
    (found,) = events([Radius(t_s, seen(Push(waves), 14.0, length, hard, t_s, rng), SD_M, TOW)])
    best = next(e for e in found if e.push == Push(waves))
    assert found[0].gain > SLACK_Z**2 / 2
    assert best.gain > found[0].gain - 5
    # what pushes less than the resistance shows nowhere: the middle is told, length and strength go together
    assert abs(best.begin_s + best.length_s / 2 - 14.0 - length / 2) < 0.1 * length
    # what the line does not pull, and gives back, is what matters of it
    t, course = course_of(best)
    fine = np.arange(0.0, 20.0, STEP_S)
    held = exact(Push(waves), length, hard, fine).pull
    told = np.interp(fine + 14.0, t, course.pull - 1, left=0.0, right=0.0)
    slow = np.ones(50) / 50
    course, wanted = (np.convolve(x, slow, "same") for x in (told, held - 1))
    assert np.corrcoef(course, wanted)[0, 1] > 0.9


@pytest.mark.slow
def test_a_short_stop_is_told_from_waves_by_parts_of_a_block_and_not_by_whole_ones() -> None:
    """A stop that shows for half a second holds two means of a block: a train of waves fits them as well."""
    course = np.arange(0.0, 6.0, STEP_S)
    wanted = exact(Push(1), 1.7, 1.8, course).pull

    def told(width_s: float, sd_m: float) -> tuple[np.ndarray, np.ndarray]:
        t_s, radii = width_s * (np.arange(round(45 / width_s)) + 0.5), []
        for seed in range(6):
            shown = seen(Push(1), 14.0, 1.7, 1.8, t_s, np.random.default_rng(seed), width_s, sd_m)
            shown[:: round(4 / width_s)] = np.nan  # a frame without its marks here and there
            radii.append(Radius(t_s, shown, sd_m, TOW))
        ahead, off = [], []
        for found in events(radii):
            stop = next(e for e in found if e.push == Push(1))
            ahead.append(stop.gain - max(e.gain for e in found if e.push.waves != 1))
            at_s, told = course_of(stop)
            pull = np.interp(course + 14.0, at_s, told.pull - 1, left=0.0, right=0.0)
            off.append(np.abs(np.cumsum(pull + 1 - wanted)).max() * STEP_S)
        return np.array(ahead), np.array(off)

    (block, block_off), (parts, parts_off) = told(BLOCK_S, SD_M), told(BLOCK_S / 4, 1.2 * SD_M)
    assert block.max() < SLACK_Z
    assert parts.min() > 2 * SLACK_Z
    # what the line has not pulled so far, in resistances times seconds: told no worse by parts
    assert parts_off.mean() < block_off.mean()


@pytest.mark.slow
@pytest.mark.parametrize("line", [(12.0, 0.15), (29.0, 0.1)], ids=["slow", "quick"])
def test_a_bounce_of_any_pace_hides_no_stop(line: tuple[float, float]) -> None:
    """A model that bounces ten times on a stiff line is out of step with all but one pace, and no step leads back: the stop is
    found nearly as well as the truth fits. Bounces begun at 15 rad/s alone were up to a tenth behind.
    """
    t_s = BLOCK_S / 4 * (np.arange(500) + 0.5)
    exactly = seen(Push(1), 14.0, 1.9, 1.8, t_s, np.random.default_rng(0), BLOCK_S / 4, 0.0, line)
    for seed in range(2):
        shown = exactly + np.random.default_rng(seed).normal(0, SD_M, len(t_s))
        (found,) = events([Radius(t_s, shown, SD_M, TOW)])
        stop = next(e for e in found if e.push == Push(1))
        truth = 0.5 * float((shown**2 - (shown - exactly) ** 2).sum()) / SD_M**2
        # steps of the first order bend a bounce a little
        assert stop.gain > 0.95 * truth
        assert abs(stop.begin_s + stop.length_s / 2 - 14.95) < 0.25


def test_the_radius_in_parts_of_a_block(tow_runs: Callable[[int, int], list]) -> None:
    """Means of the frames' radius, NaN where none was measured; a slow camera has no more parts than frames."""
    (run,) = tow_runs(4, 1)
    frame_s = 0.04 * np.arange(len(run.centre_s) * run.step_s / 0.04)
    course = 1e-3 * np.sin(frame_s)
    course[(frame_s > 10) & (frame_s < 11)] = np.nan
    t_s, means, sd_m = replace(run, frame_s=frame_s, radius_m=course).radius_by_parts(4)
    assert t_s[1] - t_s[0] == pytest.approx(run.step_s / 4)
    seen_at = np.isfinite(means)
    assert (~seen_at).sum() == pytest.approx(1 / (run.step_s / 4), abs=2)
    assert ((t_s[~seen_at] > 9.9) & (t_s[~seen_at] < 11.1)).all()
    # the frames of a part lie within half of it
    np.testing.assert_allclose(means[seen_at], 1e-3 * np.sin(t_s[seen_at]), atol=1e-3 * run.step_s / 8)
    assert sd_m == pytest.approx(2 * run.usual_sd(2))
    slow_s = run.step_s * (np.arange(len(run.centre_s)) + 0.5)
    t_s, means, sd_m = replace(run, frame_s=slow_s, radius_m=np.cos(slow_s)).radius_by_parts(4)
    np.testing.assert_allclose(t_s, slow_s)
    np.testing.assert_allclose(means, np.cos(slow_s))
    assert sd_m == run.usual_sd(2)


def test_noise_holds_no_event() -> None:
    t_s = BLOCK_S * (np.arange(125) + 0.5)
    rests = [np.random.default_rng(k).normal(0, SD_M, 125) for k in range(40)]
    gains = [e.gain for own in events([Radius(t_s, rest, SD_M, TOW) for rest in rests]) for e in own[:1]]
    assert max(gains, default=0.0) < SLACK_Z**2 / 2 / 2


def lasting(rng: np.random.Generator, count: int, sd_m: float) -> np.ndarray:
    """Noise of which a half lasts a second and a half, as marks in compressed video have it."""
    kept = np.exp(-BLOCK_S / 1.5)
    slow = np.zeros(count)
    for k in range(1, count):
        slow[k] = kept * slow[k - 1] + np.sqrt(1 - kept**2) * rng.normal()
    return sd_m * np.sqrt(0.5) * (slow + rng.normal(size=count))


@pytest.mark.slow
def test_what_lasts_in_the_noise_is_no_reason_to_search_and_hides_no_event() -> None:
    t_s = BLOCK_S * (np.arange(125) + 0.5)
    still = [lasting(np.random.default_rng(k), 125, SD_M) for k in range(40)]

    def loud(slack: np.ndarray | float) -> float:
        return float(np.mean([not Radius(t_s, slack + rest, SD_M, TOW).quiet for rest in still]))

    # a line that is slack for a second, 6 mm ahead
    slack = seen(Push(1), 14.0, 2.0, 1.6, t_s, np.random.default_rng(7), sd_m=0.0)
    assert loud(0.0) < 0.1
    assert loud(slack) == 1.0
    # three tenths of that, which hold half a chi-square of 38, are looked at as well
    assert 0.5 * np.sum((0.3 * slack / SD_M) ** 2) < 40
    assert loud(0.3 * slack) == 1.0
    ((found, *_),) = events([Radius(t_s, slack + still[0], SD_M, TOW)])
    assert abs(found.begin_s + found.length_s / 2 - 15.0) < 1.0


@pytest.mark.slow
def test_a_radius_that_drifts_holds_no_event() -> None:
    """A heavy line's sag goes with the pull of a slow tow, for as long as it swings: nothing carries a model for 20 s."""
    t_s = BLOCK_S * (np.arange(125) + 0.5)
    drift = 3e-3 * np.sin(np.pi * np.clip((t_s - 8.0) / 22.0, 0.0, 1.0)) ** 2
    radius = Radius(t_s, drift + np.random.default_rng(3).normal(0, SD_M, 125), SD_M, TOW)
    assert not radius.quiet
    (found,) = events([radius])
    assert all(e.length_s < 10.0 for e in found)
    for event in found:
        assert all(e.length_s < 10.0 for own in longer([radius], [event]) for e in own)
    # beside a slack line in another run each answer is of its own run
    slack = Radius(t_s, seen(Push(1), 14.0, 2.0, 1.6, t_s, np.random.default_rng(7)), SD_M, TOW)
    _, (likely, *_) = events([radius, slack])
    assert abs(likely.begin_s + likely.length_s / 2 - 15.0) < 0.5


def test_taut_runs_suggest_nothing(tow_runs: Callable[[int, int], list]) -> None:
    runs = tow_runs(4, 3)
    rng = np.random.default_rng(5)
    left = [
        np.column_stack([rng.normal(0, run.usual_sd(c), len(run.centre_s)) for c in range(run.values.shape[1])])
        for run in runs
    ]
    assert jerk_effects(runs, left) == []


@pytest.mark.slow
def test_a_slack_line_is_named_in_a_reality_of_its_own(tmp_path: Path) -> None:
    """blind/truth shares no code with the diagnosis: three degrees of freedom, a spring of its own stiffness, a train of waves."""
    case = case_of("case-x", "effect", ["slack_line"], [12, 1], False)
    event = {"slack_line.begin_s@1": 12.0, "slack_line.length_s@1": 6.0, "slack_line.crest@1": 2.0}
    case = replace(case, numbers=event, runs=case.runs[:2], extra={}, history=False, duration_s=24.0)
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis.file
    assert found.verdict in ("effect", "form_not_exact")
    assert "slack_line" in found.ranking[0].effects
    assert "run 2" in found.ranking[0].form
    assert max(found.where.runs, key=lambda name: found.where.runs[name]).endswith("-2")


@pytest.mark.slow
def test_the_same_push_is_found_in_a_run_whose_line_it_leaves_taut(tmp_path: Path) -> None:
    """One of two tows swings so far that the shove never slackens its line: no radius shows it, and it moves the model far."""
    case = case_of("case-x", "effect", ["slack_line"], [777, 2], forms={"slack_line": "shove"})
    case = replace(case, runs=case.runs[:2], extra={}, history=False, duration_s=24.0)
    pull = swum(case).tension_n[50:]
    assert pull[:, 0].min() == 0.0
    assert pull[:, 1].min() > 0.5
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis.file
    assert found.verdict in ("effect", "form_not_exact")
    assert "slack_line" in found.ranking[0].effects
    assert "run 1" in found.ranking[0].form
    assert "run 2" in found.ranking[0].form


@pytest.mark.slow
def test_a_carriage_that_stops_at_once_is_told_from_waves(tmp_path: Path) -> None:
    """It slows in a fifth of the time in which it comes back (blind/truth: two halves of cosines, which no push here has)."""
    case = case_of("case-x", "effect", ["slack_line"], [777, 1], forms={"slack_line": "sudden stop"})
    event = {f"slack_line.{key}@1": value for key, value in (("begin_s", 12.0), ("length_s", 2.2), ("brake", 2.3))}
    case = replace(case, numbers=event, runs=case.runs[:2], extra={}, history=False, duration_s=24.0)
    found = diagnose_folders(write_case(tmp_path, case)).diagnosis.file
    assert found.verdict == "effect"
    assert found.ranking[0].effects == ["slack_line"]
    assert found.ranking[0].form.startswith("a stop of the carriage, run 2")


def shown_by(run, slack: np.ndarray, frame_s: np.ndarray):
    """The run as if its frames had shown this radius."""
    values = run.values.copy()
    values[:, 2] = [slack[np.abs(frame_s - t) < run.step_s / 2].mean() for t in run.centre_s]
    return replace(run, values=values, frame_s=frame_s, radius_m=slack)


def middle_of(variant: str) -> float:
    """Of the last event that is named."""
    begin, end = (float(word) for word in variant.split()[-2].split("-"))
    return (begin + end) / 2


@pytest.mark.slow
def test_what_hardly_shows_in_one_run_is_tried_as_what_shows_in_another(tow_runs: Callable[[int, int], list]) -> None:
    """A carriage stops at the same place of its rails; a radius of a millimetre says little of when and how long."""
    runs, rng = tow_runs(4, 2), np.random.default_rng(11)
    frame_s = 0.04 * np.arange(int(min(run.centre_s[-1] for run in runs) / 0.04))
    course = seen(Push(1), 14.0, 2.4, 2.2, frame_s, rng, 0.04, 0.0)
    radii = [-share * course + rng.normal(0, 1e-3, len(course)) for share in (1.0, 0.15)]
    shown = [shown_by(run, radius, frame_s) for run, radius in zip(runs, radii, strict=True)]
    left = [np.zeros_like(run.values) for run in shown]
    for run, residual in zip(shown, left, strict=True):
        residual[:, 2] = run.values[:, 2]
    spans = [effect.variant.split(", ", 1)[1] for effect in jerk_effects(shown, left)]
    both = [span.replace("run 1 ", "").replace("run 2 ", "").split(", ") for span in spans if "run 2" in span]
    # each as its own radius says, and both alike
    assert any(len(each) == 2 and each[0] != each[1] for each in both)
    assert any(len(each) == 2 and each[0] == each[1] for each in both)


@pytest.mark.slow
def test_an_event_is_sought_beside_what_the_fit_explains_only_where_that_explains_something(
    tow_runs: Callable[[int, int], list],
) -> None:
    """A fit without effects bends to a jerk of several centimetres: its own radius is then no measure of the taut line."""
    (run,) = tow_runs(4, 1)
    rng = np.random.default_rng(8)
    frame_s = 0.04 * np.arange(int(run.centre_s[-1] / 0.04))
    shown = shown_by(run, -seen(Push(1), 14.0, 2.4, 2.2, frame_s, rng, 0.04, 1e-3), frame_s)
    block = shown.values[:, 2]

    def told(explained: np.ndarray) -> str:
        left = np.zeros_like(shown.values)
        left[:, 2] = block - explained
        return jerk_effects([shown], [left])[0].variant

    bent = 0.02 * np.sin(run.centre_s / 2) + 0.01 * np.cos(1.7 * run.centre_s)
    flat = told(np.zeros(len(block)))
    assert told(bent) == flat
    assert abs(middle_of(flat) - 15.2) < 0.3
    # what is there all the time, as a line's stretch, is the fit's: the event is the same
    shown = shown_by(run, shown.radius_m + np.interp(frame_s, run.centre_s, bent), frame_s)
    block = shown.values[:, 2]
    assert abs(middle_of(told(bent)) - 15.2) < 0.3


def test_an_event_that_runs_off_is_none_and_ends_no_search() -> None:
    """A radius that goes up and down by a centimetre as slowly as a tow lasts, on a line that swings to 15 degrees and pulls a
    model of which it takes little to go ahead: some steps of the fits to it run off beyond all numbers."""
    t_s, swung_s = 0.0865 * np.arange(520) + 0.043, 0.173 * np.arange(269)
    turn = 2 * np.pi * swung_s / 9.0
    swinging = Swinging(
        swung_s, -0.03 + 0.11 * np.sin(turn), -1.6 + 0.09 * np.sin(turn + 1), 0.98 + 0.018 * np.sin(turn + 1)
    )
    slow = 0.01 * np.sin(2 * np.pi * (t_s - 5) / 40) + np.random.default_rng(1).normal(0, SD_M, len(t_s))
    (found,) = events([Radius(t_s, slow, SD_M, Straight(1.1, 0.053, 1.85, swinging))])
    assert all(np.isfinite(event.gain) and np.isfinite(event.numbers).all() for event in found)
