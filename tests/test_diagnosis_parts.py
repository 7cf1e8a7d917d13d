"""Single parts of the diagnosis by hand: windows, next runs, covariances, steps, what it says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from towline.diagnose import gap, scan
from towline.diagnose import where as place
from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.effects.hull import CURRENT
from towline.diagnose.gap import _next
from towline.diagnose.held_out import _drawn, _gap, _share, _sums
from towline.diagnose.hypothesis import Hypothesis
from towline.diagnose.hypothesis import Path as Motion
from towline.diagnose.inference import Inference
from towline.diagnose.next_run import _differs
from towline.diagnose.scan import Leftover
from towline.diagnose.slackness import slack_effects
from towline.diagnose.tow_data import LINE_SD_M, SLOW_PX, SLOW_S, SLOW_UNSEEN_PX, _covariances, _shutter
from towline.diagnose.tow_model import _with_lags
from towline.diagnose.tow_seen import TowSeen
from towline.diagnose.tow_start import _scatter
from towline.diagnose.where import _band, _drops, _shortest, _stages
from towline.diagnose.words import _changed
from towline.geometry.checks.bundle import half_sine
from towline.simulate import Hull, Start, simulate_full
from towline.simulate.model import Tow


def test_a_lag_that_a_path_does_not_know_begins_as_the_velocities() -> None:
    states = np.arange(6.0 * 5 * 2).reshape(6, 5, 2)
    path = Motion((0.5,), states)
    assert _with_lags(path, (0.5,)) is states
    more = _with_lags(path, (0.2, 0.5))
    np.testing.assert_array_equal(more, states[[0, 1, 2, 3, 2, 3, 4, 5]])


def test_a_next_run_is_told_by_what_differs_from_those_made() -> None:
    tows = [SimpleNamespace(data=SimpleNamespace(tow=Tow(1.28, 0.91, x, 3.96))) for x in (1.45, 1.6, 1.75)]
    runs: Any = tows
    assert _differs(runs, (1.6, 0.91, 1.28, 0.2, 0.0)) == "released at y 0.20 m"
    assert _differs(runs, (1.9, 0.91, 1.28, 0.2, 0.0)) == "a tow point at 1.90 m, released at y 0.20 m"
    assert _differs(runs, (1.4, 1.4, 1.28, -0.1, np.radians(5))) == (
        "a line of 1.40 m, a tow point at 1.40 m, released at y -0.10 m and 5 degrees heading"
    )
    assert _differs(runs, (1.75, 0.91, 0.9, 0.2, 0.0)) == "0.90 m/s, released at y 0.20 m"


def test_a_rolling_shutter_sees_a_lower_mark_later() -> None:
    """x, y, heading and marker distance by the rates of x, y, heading, against marks that are moved on by their rows' lateness."""
    body, height = np.array([[1.0, 0.1], [-0.8, -0.2]]), 400.0
    pose, rows = np.array([2.0, 0.3, 0.2]), np.array([300.0, 150.0])

    def places(pose: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec([0, 0, pose[2]]).as_matrix()[:2, :2]
        return body @ turn.T + pose[:2]

    def rigid(place: np.ndarray) -> np.ndarray:
        """Heading of the line through both, and the mean place: what equal weights give to first order."""
        line, own = place[0] - place[1], body[0] - body[1]
        heading = np.arctan2(line[1], line[0]) - np.arctan2(own[1], own[0])
        middle = places(np.array([0.0, 0.0, heading])).mean(axis=0)
        return np.array([*(place.mean(axis=0) - middle), heading, np.hypot(*line)])

    def slope(function: Any, at: np.ndarray, step: float) -> np.ndarray:
        return np.stack([(function(at + e) - function(at - e)) / (2 * step) for e in step * np.eye(len(at))], axis=-1)

    gain = slope(lambda flat: rigid(flat.reshape(2, 2)), places(pose).ravel(), 1e-6)
    line = places(pose)[0] - places(pose)[1]
    found = SimpleNamespace(
        place_m=places(pose)[None],
        pixel_px=np.stack([np.full(2, 50.0), rows], axis=1)[None],
        markers=[SimpleNamespace(body_m=tuple(b)) for b in body],
        rigid=SimpleNamespace(pose=pose[None], gain=gain[:3].reshape(3, 2, 2)[None]),
    )
    run: Any = SimpleNamespace(file=SimpleNamespace(camera=SimpleNamespace(image_size_px=(640, int(height)))))
    answer = _shutter(found, (line / np.hypot(*line))[None], run)[0]
    late = rows / height - 0.5

    def shown(rate: np.ndarray) -> np.ndarray:
        return rigid(np.stack([places(pose + rate * late[i])[i] for i in range(2)]))

    np.testing.assert_allclose(answer, slope(shown, np.zeros(3), 1e-5), atol=1e-6)


def test_slack_windows_are_those_of_the_radius_clearest_run_first() -> None:
    """Half sines of 6 mm and 3 mm in a radius good to 0.5 mm: each window to 0.4 s, one run, then both."""
    t, rng = np.arange(0.25, 40, 0.5), np.random.default_rng(7)
    dips = [(0.003, 12.0, 15.0), None, (0.006, 25.0, 29.5)]
    rows, runs = [], []
    for dip in dips:
        radius = rng.normal(0, 5e-4, len(t))
        if dip is not None:
            radius -= dip[0] * half_sine(t, dip[1], dip[2])
        rows.append((np.column_stack([0 * t, 0 * t, radius]), None))
        runs.append(SimpleNamespace(centre_s=t, usual_sd=lambda _: 5e-4))
    base: Any = SimpleNamespace(linear=SimpleNamespace(rows=rows))
    found = [e for e in slack_effects(runs, base) if not e.variant.startswith("wave")]
    windows = [re.findall(r"run (\d) ([0-9.]+)-([0-9.]+) s", e.variant) for e in found]
    assert [[int(w[0]) for w in one] for one in windows] == [[3], [1, 3]]
    for run, begin, end in windows[1]:
        dip = dips[int(run) - 1]
        assert dip is not None
        assert (float(begin), float(end)) == pytest.approx(dip[1:], abs=0.4)
    calm = [(np.zeros((len(t), 3)) + rng.normal(0, 5e-4, (len(t), 3)), None) for _ in dips]
    none: Any = SimpleNamespace(linear=SimpleNamespace(rows=calm))
    assert slack_effects(runs, none) == []


def test_the_bias_that_an_effect_had_made_is_said() -> None:
    def hull(**values: float) -> dict[str, SimpleNamespace]:
        return {k: SimpleNamespace(value=v) for k, v in values.items()}

    file: Any = SimpleNamespace(derivatives={"before": hull(y_v=-55.0, n_r=-57.0), "after": hull(y_v=-50.0, n_r=-60.0)})
    assert _changed(file) == "Left out, it biases the derivatives by up to 10 % (y_v)."
    file = SimpleNamespace(derivatives={"before": hull(y_v=-50.2), "after": hull(y_v=-50.0)})
    assert _changed(file) == ""
    assert _changed(SimpleNamespace(derivatives={})) == ""


def test_the_taut_line_ends_at_the_tow_point_wherever_it_stands() -> None:
    """Radius of (X_T, Y_T) about the post, by hand for three poses and two runs."""
    stated = np.array([[0.91, 1.6, 0.03, 0.1], [1.2, 1.4, 0.0, 0.0]])
    sensor: Any = SimpleNamespace(_stated=stated)
    x, y, beta = np.array([-2.4, -2.3, -2.5]), np.array([0.1, -0.2, 0.3]), np.array([0.05, -0.1, 0.2])
    found = TowSeen._line(sensor, *(np.tile(one[:, None, None], (1, 2, 1)) for one in (x, y, beta)))
    for run, (length, x_t, y_t, post) in enumerate(stated):
        for k in range(3):
            turn = np.array([[np.cos(beta[k]), -np.sin(beta[k])], [np.sin(beta[k]), np.cos(beta[k])]])
            place = np.array([x[k], y[k]]) + turn @ [x_t, y_t] - [post, 0.0]
            assert found[k, run, 0] == pytest.approx(np.hypot(*place) - length, rel=1e-12)


def test_each_block_has_its_own_variance_and_a_lost_one_the_usual() -> None:
    """Beside the slow error that all share: stated sigmas that grow over the run, one of them missing, one nothing."""
    own = np.linspace(1e-6, 4e-6, 9)
    given = np.tile(own[:, None], (1, 4))
    given[3], given[5] = np.nan, 0.0
    given[:, 3] = np.nan  # a channel that was never seen
    flat: Any = SimpleNamespace(variance=np.full((20, 4), 1e-6), sigma_px=0.1)
    centre = np.arange(9) * 0.5
    found = _covariances(centre, given, flat, None, 0.5)
    slow = 1e-3 / 0.1 * SLOW_UNSEEN_PX
    for channel in range(3):
        sd = np.hypot(slow, LINE_SD_M) if channel == 2 else slow
        whole = np.where(np.isin(np.arange(9), (3, 5)), np.nanmedian(given[:, channel]), own)
        shared = sd**2 * np.exp(-np.abs(centre[:, None] - centre) / SLOW_S)
        np.testing.assert_allclose(found[channel], np.diag(whole) + shared, rtol=1e-12)
    np.testing.assert_array_equal(found[3], np.eye(9))


def test_a_step_is_shortened_to_what_the_numbers_may_move() -> None:
    """By the one that would go too far: 40 % of a derivative, three standard deviations of an effect."""
    sds = np.array([q.sd for q in CURRENT.parameters])
    h = Hypothesis(np.array([100.0, -50.0]), np.zeros((1, 3)), (CURRENT,), (np.zeros(2),))
    engine: Any = SimpleNamespace(simulator=SimpleNamespace(least=1.0), fixed=lambda h: len(h.shared))

    def stepped(shared: Sequence[float], numbers: Sequence[float], share: float = 1.0) -> Hypothesis:
        moved: Any = SimpleNamespace(moved=lambda *parts: parts)
        solved = SimpleNamespace(shared=np.array([*shared, *(np.array(numbers) * sds)]), own=np.ones((1, 3)))
        fitted: Any = SimpleNamespace(hypothesis=h, solved=solved, linear=SimpleNamespace(slopes=moved))
        return Inference.stepped(engine, fitted, share)

    free = stepped([10.0, 5.0], [1.0, -2.0])
    np.testing.assert_allclose(free.shared, [110.0, -45.0])
    np.testing.assert_allclose(free.numbers[0], sds * [1.0, -2.0])
    np.testing.assert_allclose(free.own, 1.0)
    np.testing.assert_allclose(stepped([10.0, 5.0], [1.0, -2.0], 0.5).shared, [105.0, -47.5])
    far = stepped([10.0, -60.0], [1.0, -2.0])  # three times what is let
    np.testing.assert_allclose(far.shared, [100.0 + 10 / 3, -70.0])
    np.testing.assert_allclose(far.numbers[0], sds * [1 / 3, -2 / 3])
    wide = stepped([10.0, 5.0], [1.0, -12.0])  # four times
    np.testing.assert_allclose(wide.numbers[0], sds * [0.25, -3.0])
    np.testing.assert_allclose(wide.own, 0.25)


def test_the_next_run_tells_the_headline_from_its_nearest_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    design = SimpleNamespace(
        tow_point_m=1.6, line_length_m=0.9, speed_m_s=1.2, y_m=0.2, beta_rad=0.0, distance=30.0, differs="1.20 m/s"
    )
    asked = []
    monkeypatch.setattr(gap, "next_run", lambda _, first, second: asked.append((first, second)) or design)

    def candidate(evidence: float, *names: str) -> Any:
        return SimpleNamespace(names=names, effects=names, log_evidence=evidence, fitted="+".join(names))

    pair, near, far = candidate(9.0, "a", "b"), candidate(7.0, "c"), candidate(2.0, "d")
    ranking: Any = SimpleNamespace(candidates=[pair, far, near], base="none")
    nothing: Any = None
    found = _next(nothing, ranking, pair)
    assert asked.pop() == ("a+b", "c")
    assert found is not None
    assert found.why.startswith("1.20 m/s: ")
    assert " a from c " in found.why
    found = _next(nothing, ranking, None)
    assert asked.pop() == ("none", "c")
    assert found is not None
    assert " no gap from c " in found.why
    assert _next(nothing, SimpleNamespace(candidates=[pair], base="none"), pair) is None  # pyright: ignore[reportArgumentType]


def test_how_far_marks_scatter_about_a_smooth_course() -> None:
    """Noise of twice and five times what is stated about a cubic; too few blocks say nothing of it."""
    rng, n = np.random.default_rng(5), 400
    t = 0.5 * np.arange(n)
    course = np.column_stack([0.2 * np.cos(0.05 * (t - 80)), 1e-6 * (t - 80) ** 3])
    values = np.full((n, 4), np.nan)
    values[:, :2] = course + rng.normal(size=(n, 2)) * [2e-3, 5e-4]
    values[160, 0] = np.nan  # where both stand still

    def run(count: int, step_s: float) -> Any:
        covariance = np.stack([np.eye(count) * 1e-6, np.eye(count) * 1e-8])
        return SimpleNamespace(values=values[:count], covariance=covariance, step_s=step_s)

    # a cubic over seven blocks takes four of their numbers: of the middle one (1 - 1/3) of its variance is left
    np.testing.assert_allclose(_scatter(run(n, 0.5)), np.array([2.0, 5.0]) * np.sqrt(2 / 3), rtol=0.1)
    np.testing.assert_array_equal(_scatter(run(6, 0.5)), [1.0, 1.0])
    assert (_scatter(run(7, 0.5)) != 1.0).all()
    np.testing.assert_array_equal(_scatter(run(4, 2.0)), [1.0, 1.0])  # at least five blocks, however long
    assert (_scatter(run(5, 2.0)) != 1.0).all()


def test_the_shortest_stretch_that_holds_a_share() -> None:
    course = np.array([0.0, 1.0, 0.0, 3.0, 4.0, 2.0, 0.0, 0.0])
    assert _shortest(course, 0.4) == (4, 5)
    assert _shortest(course, 0.6) == (3, 5)
    assert _shortest(course, 0.95) == (1, 6)
    assert _shortest(course, 1.0) == (1, 6)
    assert _shortest(np.zeros(5), 0.6) == (0, 5)
    assert _shortest(np.array([2.0, 0.0, 0.0]), 0.6) == (0, 1)


@pytest.mark.parametrize("hertz", [0.11, 0.4])
def test_the_band_is_that_of_what_the_headline_changes(hertz: float) -> None:
    """A wave of 1 mm on a constant, in y of two runs of 60 and 40 s: its frequency within the resolution of the longer one."""
    rng, step_s = np.random.default_rng(3), 0.5
    runs, before, after = [], [], []
    for n in (120, 80):
        t = step_s * np.arange(n)
        rest = rng.normal(size=(n, 4))
        wave = np.zeros((n, 4))
        wave[:, 0] = 1e-3 * np.sin(2 * np.pi * hertz * t + 1.0) + 3e-3
        wave[:, 2] = rng.normal(size=n)  # neither line nor distance counts
        later = rest + wave
        later[5] = np.nan
        before.append((rest, None))
        after.append((later, None))
        covariance = np.stack([np.eye(n) * v for v in (1e-6, 1e-6, 1e-6, 1e-6)])
        runs.append(SimpleNamespace(centre_s=t, covariance=covariance))
    inference: Any = SimpleNamespace(simulator=SimpleNamespace(runs=runs, step_s=step_s))
    one, two = (SimpleNamespace(linear=SimpleNamespace(rows=rows)) for rows in (before, after))
    low, high = _band(inference, one, two)  # pyright: ignore[reportArgumentType]
    assert low <= hertz <= high
    assert high - low < 3 / 60


def test_a_hull_effect_is_in_sway_and_yaw_by_its_numbers() -> None:
    """By the squares of what each is in units of its usual size; an effect of another stage is wholly there."""
    both = Effect(
        "both",
        "sway",
        (Parameter("y_a", "", 2.0, none=1.0), Parameter("n_b", "", 0.5), Parameter("moment_c", "", 1.0)),
        "",
        "",
    )
    seen = Effect("seen", "camera", (Parameter("n_d", "", 1.0), Parameter("e", "", 1.0)), "", "")
    single = Effect("single", "yaw", (Parameter("y_f", "", 1.0),), "", "")
    numbers = (np.array([5.0, 1.0, -2.0]), np.array([1.0, 2.0]), np.array([3.0]))
    one: Any = SimpleNamespace(
        effects=(both, seen, single), fitted=SimpleNamespace(hypothesis=SimpleNamespace(numbers=numbers))
    )
    assert _stages(one, both) == pytest.approx({"sway": 4 / 12, "yaw": 8 / 12})
    assert _stages(one, seen) == {"camera": 1.0}
    assert _stages(one, single) == {"yaw": 1.0}
    none: Any = SimpleNamespace(
        effects=(both,), fitted=SimpleNamespace(hypothesis=SimpleNamespace(numbers=(np.array([1.0, 0.0, 0.0]),)))
    )
    assert _stages(none, both) == {"sway": 1.0}


def test_what_is_left_over_is_paid_for_where_it_was_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best tile of all, less the price of looking everywhere."""
    tiles = [Leftover(13.0, "a", (1.0, 2.0)), Leftover(31.5, "b", (4.0, 6.0))]
    monkeypatch.setattr(scan, "_rest", lambda *_: [])
    monkeypatch.setattr(scan, "_bursts", lambda *_: tiles)
    monkeypatch.setattr(scan, "_bands", lambda *_: [Leftover(20.0, band_hz=(0.3,))])
    simulator = SimpleNamespace(step_s=0.5, runs=[SimpleNamespace(name="a")])
    nothing: Any = None
    inference: Any = SimpleNamespace(simulator=simulator)
    assert scan.leftover(inference, nothing) == Leftover(31.5 - scan.COST, "b", (4.0, 6.0))
    monkeypatch.setattr(scan, "_bursts", lambda *_: [])
    monkeypatch.setattr(scan, "_bands", lambda *_: [])
    assert scan.leftover(inference, nothing) == Leftover(-scan.COST)


def test_a_static_record_gives_blocks_its_size_and_its_memory() -> None:
    """Stated sigmas say how the noise changes over the picture, the static record how large it is and how long it lasts."""
    rng, step_s, per = np.random.default_rng(6), 0.5, 10
    memory_s, share = 2.0, 0.4
    count = 40_000
    kept = np.exp(-step_s / memory_s)
    slow = np.asarray(lfilter([np.sqrt(1 - kept**2)], [1.0, -kept], rng.normal(size=count)))
    means = 1e-3 * (np.sqrt(1 - share) * slow + np.sqrt(share) * rng.normal(size=count))
    values = np.tile(np.repeat(means, per)[:, None], (1, 4))
    t = step_s / per * np.arange(count * per)
    still: Any = SimpleNamespace(t_s=t, values=values, variance=np.full((count * per, 4), 4e-6), sigma_px=0.1)
    series: Any = SimpleNamespace(variance=np.full((90, 4), 4e-6), sigma_px=0.1)
    given = np.tile(np.linspace(2e-7, 8e-7, 9)[:, None], (1, 4))
    centre = np.arange(9) * step_s
    found = _covariances(centre, given, series, still, step_s)
    # 4e-6 a frame are 4e-7 a block of ten: the record's 1e-6 is 2.5 times that
    size = given[:, 0] * 1e-6 / 4e-7
    lag = np.abs(centre[:, None] - centre)
    unseen = 2e-3 / 0.1 * SLOW_PX
    colour = (1 - share) * np.exp(-lag / memory_s) + share * np.eye(9)
    wanted = np.sqrt(np.outer(size, size)) * colour + unseen**2 * np.exp(-lag / SLOW_S)
    # its correlations are known to 1 %, and so what is left after eight blocks to some 8 %
    np.testing.assert_allclose(found[0], wanted, rtol=0.15)
    np.testing.assert_allclose(np.diag(found[1]), np.diag(wanted), rtol=0.1)


def test_the_drop_of_a_run_is_the_sum_of_its_channels_squares_before_less_after() -> None:
    rng = np.random.default_rng(4)
    rests = {name: [rng.normal(size=3 * n) for n in (7, 5)] for name in ("base", "after")}

    def left(linear: str, forces: str, shared: str, own: int, index: int) -> np.ndarray:
        assert (forces, shared, own) == ("after's", linear, 10 * index)
        return rests[linear][index]

    runs = [SimpleNamespace(name=f"r{n}", centre_s=np.zeros(n)) for n in (7, 5)]
    inference: Any = SimpleNamespace(
        simulator=SimpleNamespace(runs=runs),
        left=left,
        solve=lambda grams, *_: SimpleNamespace(shared=grams, own=[0, 10]),
    )
    one, two = (SimpleNamespace(forces=f"{n}'s", grams=n, linear=n, hypothesis=n) for n in ("base", "after"))
    found = _drops(inference, one, two)  # pyright: ignore[reportArgumentType]
    assert list(found) == ["r7", "r5"]
    for index, n in enumerate((7, 5)):
        before, later = (rests[name][index].reshape(3, n) for name in ("base", "after"))
        np.testing.assert_allclose(found[f"r{n}"], (before**2).sum(axis=0) - (later**2).sum(axis=0))


@pytest.mark.parametrize(
    ("before", "after", "share"),
    [(2.0, 1.0, 1.0), (2.0, np.sqrt(2.5), 0.5), (2.0, 0.7, 1.0), (2.0, 3.0, 0.0), (1.0, 1.0, 0.0), (0.6, 0.5, 0.0)],
)
def test_a_gap_shrinks_by_the_share_of_its_excess_that_goes(before: float, after: float, share: float) -> None:
    assert _share(before, after) == pytest.approx(share)


def test_a_gap_is_over_the_values_less_what_each_run_was_free_in() -> None:
    parts = [np.full(20, 2.0), np.full(30, 1.0)]
    assert _gap(parts, 6) == pytest.approx(np.sqrt((80 + 30) / (50 - 12)))
    assert _gap(parts, 100) == pytest.approx(np.sqrt(110))  # nothing left to judge by: at least one


def test_a_bootstraps_draw_of_alike_stretches_is_the_gap_itself() -> None:
    """Squares that do not change over time: whatever is drawn, each run counts with its own."""
    parts = [
        _sums(np.full(4 * 40, 2.0), np.full(4 * 40, 1.0), 40),
        _sums(np.full(2 * 60, 3.0), np.full(2 * 60, 1.0), 60),
    ]
    assert [(n, k) for _, n, k in parts] == [(160, 40), (120, 60)]
    found = {_drawn(parts, 5, np.random.default_rng(seed)) for seed in range(40)}
    wanted = set()
    for one, two in ((2, 0), (1, 1), (0, 2)):
        total = 160 * one + 120 * two - 10
        wanted.add((np.sqrt((640 * one + 1080 * two) / total), np.sqrt((160 * one + 120 * two) / total)))
    assert np.array(sorted(found)) == pytest.approx(np.array(sorted(wanted)))


def test_the_rates_of_what_is_seen_are_those_of_the_pose() -> None:
    """By differences along a simulated tow with its tow point aside: x, y and heading as the camera sees them."""
    hull = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
    tow, t = Tow(1.28, 0.91, 1.548, 3.96, tow_point_offset_m=0.04), np.arange(0, 20, 0.01)
    motion = simulate_full(hull, tow, Start(y_cg_m=0.3, beta_rad=0.05), t)
    path = motion[["alpha_rad", "beta_rad", "v_m_s", "r_rad_s"]].to_numpy().T
    sensor: Any = SimpleNamespace(_shutter=None)
    seen = TowSeen._see(sensor, t, path, tow)
    np.testing.assert_allclose(seen.pose[1], motion["y_cg_m"], atol=1e-9)
    for pose, rate in zip(seen.pose, seen.rate, strict=True):
        np.testing.assert_allclose(rate[1:-1], np.gradient(pose, t)[1:-1], atol=2e-5)
    assert np.abs(seen.rate[0]).max() > 1e-2
    np.testing.assert_allclose(seen.side, np.sin(path[0] + path[1]))
    bow = np.column_stack([seen.pose[0], seen.pose[1]])
    arm = np.column_stack(
        [1.548 * np.cos(path[1]) - 0.04 * np.sin(path[1]), 1.548 * np.sin(path[1]) + 0.04 * np.cos(path[1])]
    )
    np.testing.assert_allclose(np.linalg.norm(bow + arm - tow.post_m, axis=1), 0.91, rtol=1e-9)


def test_where_counts_what_is_in_no_library_by_the_free_forms_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place, "_drops", lambda *_: {"a": np.array([0.0, 4.0, 0.0]), "b": np.array([-1.0, 2.0, 0.0])})
    monkeypatch.setattr(place, "_band", lambda *_: (0.1, 0.2))
    seen = Effect("seen", "camera", (Parameter("k", "", 1.0),), "", "")
    free = Effect("free", "line", (Parameter("f", "", 1.0),), "", "")

    def one(*effects: Effect) -> Any:
        numbers = tuple(np.ones(1) for _ in effects)
        return SimpleNamespace(effects=effects, fitted=SimpleNamespace(hypothesis=SimpleNamespace(numbers=numbers)))

    inference: Any = SimpleNamespace(simulator=SimpleNamespace(step_s=0.5))
    ranking: Any = SimpleNamespace(
        candidates=[one(seen), one(seen, free)],
        probabilities=np.array([0.1, 0.2]),
        free=one(free),
        p_unknown=0.6,
        base=None,
    )
    found = place.where(inference, ranking, None)
    assert found.share == pytest.approx({"camera": 0.2, "clock": 0.0, "line": 0.7, "sway": 0.0, "yaw": 0.0})
    assert found.stage == "line"
    assert found.runs == pytest.approx({"a": 0.8, "b": 0.2})
    assert found.span_s == (0.5, 1.0)
    assert found.band_hz == (0.1, 0.2)
    ranking.p_unknown, ranking.free = 0.0, None
    calm = place.where(inference, ranking, None)
    assert (calm.stage, calm.runs, calm.span_s) == ("", {}, (0.0, 0.0))


def test_a_line_in_the_spectrum_of_all_runs_and_a_burst_in_one_are_where_they_are() -> None:
    rng, step_s = np.random.default_rng(8), 0.5
    t = step_s * np.arange(120)
    rest = [rng.normal(size=(120, 2)) + 1.2 * np.sin(2 * np.pi * 0.25 * t + p)[:, None] for p in (0.1, 2.0, 4.0)]
    narrow, wide = scan._bands(rest, step_s)
    assert narrow.band_hz == pytest.approx((0.25, 0.25))
    assert wide.band_hz[1] - wide.band_hz[0] == pytest.approx(2 / 60)
    assert wide.band_hz[0] <= 0.25 <= wide.band_hz[1]
    assert narrow.log_evidence > wide.log_evidence > 10
    calm = [rng.normal(size=(120, 2)) for _ in range(2)]
    calm[1][40:46] *= 4
    bursts = scan._bursts(calm, ["a", "b"], step_s)
    best = max(bursts, key=lambda b: b.log_evidence)
    assert (best.run, best.span_s) == ("b", (20.0, 23.0))
    assert max(b.log_evidence for b in bursts if b.run == "a") < 0
