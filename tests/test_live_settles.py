"""A steady tow while it settles: where it will rest, X_v with its standard deviation, and when that stands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from towline.identify.settling import FORM, STANDS, Settling, neutral_point, settling
from towline.identify.steady import SteadyState, steady_state
from towline.live.resting import Marks, may_settle, told_of
from towline.live.session import Wanted
from towline.live.tows import Day
from towline.record.run import Run, read_run

HOLE5 = Path(__file__).resolve().parent.parent / "sample_videos" / "leander_steady" / "hole5"
X_V_M = -1.490076 / -6.804


@pytest.fixture(scope="module")
def towed(live_settles: ModuleType) -> dict[float, tuple[Run, pd.DataFrame, np.ndarray]]:
    """A frigate at three tow points, rudder over, let go 4 degrees aside; 0.05 degrees of white noise; its true rest."""
    hull, usual, length, _ = live_settles.HULLS["frigate"]
    rng, t_s = np.random.default_rng(5), np.arange(0, 60, 0.08)
    found = {}
    for point in (0.40, 0.50, 0.62):
        tow = replace(usual, tow_point_m=point, rudder_rad=np.radians(-8))
        angles = live_settles.swum(hull, tow, np.radians(4), t_s) + np.radians(0.05) * rng.normal(size=(len(t_s), 2))
        run = live_settles.run_of(f"x{point}", tow, length)
        found[point] = run, live_settles.motion_of(t_s, angles), live_settles.rest_of(hull, tow)
    return found


def until(motion: pd.DataFrame, seconds: float) -> pd.DataFrame:
    return motion[motion["t_s"] < seconds]


def test_where_a_tow_will_rest_is_told_before_it_has_settled(towed: Any) -> None:
    """By its standard deviation (4 of them), which shrinks; it says where it will rest, and in the end that it rests."""
    run, motion, rest = towed[0.40]
    before, sds = [], []
    for seconds in (12.0, 18.0, 26.0, 60.0):
        part = until(motion, seconds)
        now = settling(run, part, None)
        assert now.state is not None
        sd = np.sqrt(np.diag(now.state.covariance))
        off = np.array([now.state.alpha_rad, now.state.beta_rad]) - rest
        assert (np.abs(off) < 4 * sd).all()
        before.append(now.settled)
        sds.append(sd[0])
        assert now.settled == ("settled:" in now.words)
        assert now.settled or "it will rest at alpha" in now.words
    assert before == [False, False, False, True] or before == [False, False, True, True]
    assert (np.diff(sds[:3]) < 0).all()
    assert sds[-1] < np.radians(0.05)
    assert settling(run, until(motion, 4.0), None).state is None  # no half of the slowest swing has passed


def test_the_form_of_the_fit_errs_by_less_than_is_said(live_settles: ModuleType) -> None:
    """MARINER at 2.2 m, whose four roots are two swings, for 12 s, without noise to speak of: within 2 of what ``FORM`` grants;
    off by a tenth of a degree, of which the noise makes a hundredth at most."""
    hull, usual, length, _ = live_settles.HULLS["MARINER"]
    tow, t_s = replace(usual, tow_point_m=2.2, rudder_rad=np.radians(-10)), np.arange(0, 12, 0.04)
    noise = np.radians(0.005) * np.random.default_rng(1).normal(size=(len(t_s), 2))
    angles = live_settles.swum(hull, tow, np.radians(5), t_s) + noise
    now = settling(live_settles.run_of("m", tow, length), live_settles.motion_of(t_s, angles), None)
    assert now.state is not None
    assert not now.settled
    off = abs(now.state.alpha_rad - live_settles.rest_of(hull, tow)[0])
    granted = np.sqrt(now.state.covariance[0, 0])
    assert off < 2 * granted
    assert granted < FORM * np.radians(5)
    assert off > np.radians(0.1)


def test_samples_whose_noise_lasts_count_for_as_many_as_are_independent(live_settles: ModuleType) -> None:
    """First-order noise of 0.5 s at 25 Hz: n (1 - p) / (1 + p) of n samples, to a factor of 2, as 60 s of it tell."""
    hull, usual, length, _ = live_settles.HULLS["frigate"]
    tow, t_s = replace(usual, tow_point_m=0.5, rudder_rad=np.radians(-8)), np.arange(0, 60, 0.04)
    fall = float(np.exp(-0.04 / 0.5))
    slow = lfilter([1], [1, -fall], np.random.default_rng(7).normal(size=(len(t_s), 2)), axis=0)
    angles = live_settles.rest_of(hull, tow) + np.radians(0.05) * np.sqrt(1 - fall**2) * slow
    now = settling(live_settles.run_of("m", tow, length), live_settles.motion_of(t_s, angles), None)
    assert now.settled
    assert now.state is not None
    assert now.independent is not None
    span = now.state.span_s[1] - now.state.span_s[0]
    expected = span / 0.04 * (1 - fall) / (1 + fall)
    assert expected / 2 < now.independent < 2 * expected


def test_x_v_stands_when_longer_tells_no_more(towed: Any) -> None:
    """With one tow before it at 0.62 m: none from one tow point alone; X_v within 3.5 of its sd; it stands when the rig's errors
    are what is left, and at once where the wish is met."""
    before = [steady_state(*towed[0.62][:2], None)]
    run, motion, _ = towed[0.50]
    early, late = (settling(run, until(motion, seconds), None) for seconds in (12.0, 60.0))
    alone = neutral_point(late, [])
    assert alone.x_v_m is None
    assert "another tow point" in alone.words
    for now in (early, late):
        found = neutral_point(now, before)
        assert found.x_v_m is not None
        assert abs(found.x_v_m.value - X_V_M) < 3.5 * found.x_v_m.std
    assert "settling" in neutral_point(early, before).words
    assert neutral_point(late, before).stands
    assert late.state is not None
    # the rig is known exactly, the noise is all there is: longer tells it better, unless the wish is met
    exact = [replace(s, tow_point_sd_m=0.0, tension_sd_rel=0.0) for s in (*before, late.state)]
    exact[0] = replace(exact[0], covariance=exact[0].covariance / 100)
    noisy = replace(late, state=exact[1])
    found = neutral_point(noisy, exact[:1])
    assert not found.stands
    assert "longer tells it better" in found.words
    assert found.interval_m is not None
    half = float(np.diff(found.interval_m)[0] / 2)
    assert neutral_point(noisy, exact[:1], 1.01 * half).stands
    assert not neutral_point(noisy, exact[:1], 0.99 * half).stands
    assert STANDS < 1


def test_a_tow_without_a_side_force_gives_no_x_v(towed: Any) -> None:
    run, motion, _ = towed[0.50]
    still = motion.assign(alpha_rad=motion["alpha_rad"].to_numpy()[::-1] * 0 + 1e-3, beta_rad=1e-3)
    found = neutral_point(settling(run, still, None), [])
    assert found.x_v_m is None
    assert "rudder over" in found.words
    assert neutral_point(Settling("too short"), []).words == "no X_v yet: too short"


@pytest.mark.slow
def test_live_lines_say_where_the_film_will_rest(towed: Any) -> None:
    """The sample film's true marks as ``live.jsonl`` has them, one lost for a second: alpha at rest by the truth's last second."""
    run, truth = read_run(HOLE5), pd.read_csv(HOLE5 / "truth" / "motion.csv")
    assert may_settle(run)
    assert not may_settle(replace(run, file=run.file.model_copy(update={"kind": "free"})))
    rng, marks = np.random.default_rng(2), pd.read_csv(HOLE5 / "truth" / "tracks.csv")
    records: list[dict[str, Any]] = []
    for frame, rows in marks[marks["frame"] % 3 == 0].groupby("frame"):
        t_s = float(rows["t_s"].iloc[0])
        seen = {r.marker: [*(r.u_px, r.v_px) + 0.05 * rng.normal(size=2), 0.05, 0.05] for r in rows.itertuples()}
        records.append({"frame": frame, "t_s": t_s, "marks": seen | ({"bow": "covered"} if 5 < t_s < 6 else {})})
    none: list[SteadyState] = []
    first, whole = Marks(run), Marks(run)
    first.add(iter(r for r in records if r["t_s"] < 12))
    whole.add(iter([{"event": "mark", "t_s": 5.0}, *records]))
    early, late = told_of(run, first, none, None), told_of(run, whole, none, None)
    assert told_of(run, Marks(run), none, None) is None
    assert early is not None
    assert late is not None
    assert (early["settled"], late["settled"]) == (False, True)
    rest = truth["alpha_rad"].iloc[-25:].mean()
    for told in (early, late):
        value, sd = told["alpha_rad"]
        assert abs(value - rest) < 4 * np.hypot(sd, np.radians(0.2))  # camera and datum err by some tenths of a degree
        assert "another tow point" in told["steady"]
        assert not told["stands"]
    other = steady_state(*towed[0.62][:2], None)
    # its rudder and its pull are other ones than the film's: brought to the film's tension, it serves to have a second tow point
    known = told_of(run, whole, [replace(other, tension_n=run.tow.tension_n, tow_point_m=0.9)], 1.0)
    assert known is not None
    assert known["x_v_m"] is not None
    assert known["stands"]


def test_the_plans_wish_for_x_v_is_waited_for(tmp_path: Path) -> None:
    from test_live_day import PLAN

    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN.format(percent="1.0\nx_v_m = 0.004") + "\n[limits]\nwall_m = 0.1\n")
    assert Day(plan).wanted == Wanted(0.1, 0.004)
    assert Day().wanted == Wanted()
