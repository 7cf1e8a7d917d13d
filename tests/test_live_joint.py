"""Two live cameras of one tow, joined while it is filmed: against the truth, before and after the second one's clock is told."""

from __future__ import annotations

import copy
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

from towline.geometry.motion import run_datum
from towline.live.joint import ARRIVAL_SD_S, Joint
from towline.record.run import cameras_of

SHORT_S = 25.0
"""Of a tow here: about two swings."""
FARTHEST_SD = 5.0
"""No value is farther from the truth: by chance one in two million, and neighbouring frames share most of their error."""
NAMES = ("y_cg_m", "beta_rad", "alpha_rad")


def values(rows: pd.DataFrame, name: str) -> np.ndarray:
    """(n, 2) value and the standard deviation of all that is unsure of it; NaN where there is none."""
    found = [(np.nan,) * 3 if value is None else value for value in rows[name]]
    value, own, common = np.array(found, dtype=float).T
    return np.column_stack([value, np.hypot(own, common)])


def off(case: Any, rows: pd.DataFrame) -> np.ndarray:
    """(n, 2) y and heading, less the truth, in their standard deviations."""
    truth = case.truth(rows["t_s"].to_numpy())
    found = [
        (values(rows, name)[:, 0] - truth[:, k]) / values(rows, name)[:, 1]
        for k, name in ((1, NAMES[0]), (2, NAMES[1]))
    ]
    return np.column_stack(found)


@pytest.fixture(scope="module")
def case(pairs: ModuleType) -> Any:
    return pairs.random_case(3, duration_s=SHORT_S)


@pytest.fixture(scope="module")
def told(case: Any, live_joint: ModuleType) -> Any:
    return live_joint.filmed(case, np.random.default_rng(1), every_s=0.25)


@pytest.mark.slow
def test_joint_values_are_as_unsure_as_they_say(case: Any, told: Any) -> None:
    """Of every frame, before the clock is told and after it, by one camera and by both."""
    rows = told.rows
    assert set(rows["camera"]) == {"port", "starboard", "port+starboard"}
    assert set(rows["camera"][~rows["told"]]) <= {
        "port",
        "starboard",
    }  # until the clock is told none is weighed with the other
    assert rows["told"].iloc[-1]
    assert np.abs(off(case, rows)).max() < FARTHEST_SD
    both, alone = (values(rows[rows["camera"] == name], "y_cg_m")[:, 1] for name in ("port+starboard", "port"))
    assert np.median(both) < np.median(alone)


@pytest.mark.slow
def test_every_frame_is_told_once_and_soon(case: Any, told: Any) -> None:
    """Each frame of the first camera in which one of the two saw the model, in order, within a second of its last byte; after the
    first one's end each of the other's."""
    rows, (first, second) = told.rows, case.tracks
    assert (np.diff(rows["t_s"]) > 0).all()
    assert rows["joint"].tolist() == list(range(len(rows)))
    seen = np.unique(first["t_s"][first["status"] == "measured"])
    there = rows[rows["camera"].isin(["port", "port+starboard"])]
    assert there["t_s"].to_numpy() == pytest.approx(seen, abs=1e-6)
    later = case.offset_s + (1 + case.rate) * np.unique(second["t_s"])
    assert (rows["t_s"] > first["t_s"].max()).sum() == pytest.approx((later > first["t_s"].max()).sum(), abs=1)
    assert (rows["now_s"] - rows["arrived_s"]).quantile(0.99) < 1.0


def test_the_clock_is_said_when_it_is_told(case: Any, told: Any) -> None:
    """First by when pictures came, to what that is worth; then by the motion, better and better."""
    first, *_, last = told.clock
    assert not first["told"]
    assert "not told yet" in first["cameras"][0]
    assert abs(first["offset_s"][0] - case.offset_s) < 2 * ARRIVAL_SD_S
    assert first["offset_s"][1] == ARRIVAL_SD_S
    known = [said for said in told.clock if said["told"]]
    for said in known:
        assert abs(said["offset_s"][0] - case.offset_s) < FARTHEST_SD * said["offset_s"][1]
    assert known[-1]["offset_s"][1] < known[0]["offset_s"][1]
    assert last["agree"]
    assert "starboard's clock shows 0 when port's shows" in last["cameras"][0]


def fed(
    case: Any, lines: list[list[dict[str, Any]]], by_arrival: bool = True, until_s: float = np.inf
) -> tuple[Joint, Any, Any]:
    """All lines whose pictures came until then, at once: the joint, what it says of the clocks, its rows."""
    joint = Joint(case.run, [run_datum(view, None) for view in cameras_of(case.run)], by_arrival)
    for place in (0, 1):
        joint.add(place, [line for line in lines[place] if line["arrived_s"] <= until_s])
    said = joint.match()
    return joint, said, pd.DataFrame(joint.rows())


def without_marks(lines: list[dict[str, Any]], until_s: float) -> list[dict[str, Any]]:
    """The first so many seconds without a mark."""
    unseen = {"bow": "covered", "stern": "covered"}
    return [line | {"marks": unseen} if line["t_s"] < until_s else line for line in lines]


def test_before_the_clock_is_told_the_other_stands_in_as_badly_as_its_time_is_known(
    case: Any, live_joint: ModuleType
) -> None:
    """The first camera sees nothing for the first 11 s, the second from about 6 s on: its frames stand for both, and what its clock
    leaves open, 0.2 s of the model's way, is in their standard deviation."""
    lines = live_joint.lines_of(case, np.random.default_rng(2))
    _, said, rows = fed(case, [without_marks(lines[0], 11.0), lines[1]], until_s=11.0)
    assert said is not None
    assert not said["told"]
    assert set(rows["camera"]) == {"starboard", ""}
    rows = rows[rows["camera"] == "starboard"]
    assert len(rows) > 20
    assert np.abs(off(case, rows)).max() < FARTHEST_SD
    t_s = rows["t_s"].to_numpy()
    speed = np.abs(case.truth(t_s + 0.5) - case.truth(t_s - 0.5))[:, 1]
    moving = speed > 0.03
    assert moving.any()
    assert values(rows, "y_cg_m")[moving, 1] == pytest.approx(ARRIVAL_SD_S * speed[moving], rel=0.15)


def test_of_too_few_pictures_it_is_said(case: Any, live_joint: ModuleType) -> None:
    """A machine that looks at one picture of each camera in ten: after 8 s some 20 of the slower one, none of which is sure."""
    lines = [each[::10] for each in live_joint.lines_of(case, np.random.default_rng(2))]
    joint, said, _ = fed(case, lines, until_s=8.0)
    assert said is not None
    assert not said["told"]
    assert "starboard's clock is not told yet: of one camera only" in said["cameras"][0]
    assert "pictures were looked at so far" in said["cameras"][0]
    assert not joint.told


def test_films_that_are_played_tell_nothing_by_when_they_come(case: Any, live_joint: ModuleType) -> None:
    """Both are played from their beginning at once, whatever their clocks: the first one alone until the motion tells."""
    lines = [
        [line | {"arrived_s": line["t_s"]} for line in each]
        for each in live_joint.lines_of(case, np.random.default_rng(3))
    ]
    _, said, rows = fed(case, lines, by_arrival=False, until_s=6.0)
    assert said is not None
    assert said["offset_s"] is None
    assert set(rows["camera"]) == {"port"}
    _, said, rows = fed(case, lines, by_arrival=False)
    assert said is not None
    assert abs(said["offset_s"][0] - case.offset_s) < FARTHEST_SD * said["offset_s"][1]
    assert "port+starboard" in set(rows["camera"])
    assert np.abs(off(case, rows)).max() < FARTHEST_SD


def test_a_camera_that_is_gone_is_not_waited_for(case: Any, live_joint: ModuleType) -> None:
    lines = live_joint.lines_of(case, np.random.default_rng(4))
    gone = [line for line in lines[1] if line["arrived_s"] < 15.0]
    _, _, rows = fed(case, [lines[0], gone], until_s=18.0)
    assert rows["t_s"].max() == pytest.approx(max(line["t_s"] for line in lines[0] if line["arrived_s"] <= 18.0))
    assert rows["camera"].iloc[-1] == "port"
    _, _, rows = fed(case, [[line for line in lines[0] if line["arrived_s"] < 10.0], lines[1]], until_s=14.0)
    last_s = max(line["t_s"] for line in lines[1] if line["arrived_s"] <= 14.0)
    assert rows["t_s"].max() == pytest.approx(case.offset_s + last_s, abs=3 * ARRIVAL_SD_S)
    assert rows["camera"].iloc[-1] == "starboard"


@pytest.mark.once
@pytest.mark.parametrize("flash", [False, True])
def test_a_model_at_rest_tells_no_clock_but_a_flash_does(
    pairs: ModuleType, live_joint: ModuleType, flash: bool
) -> None:
    """A flash of 0.1 s at a moment that both see, which lights the frames it falls into by how much of their time it lasts."""
    still = pairs.random_case(4, duration_s=10.0, still=True)
    lines = copy.deepcopy(live_joint.lines_of(still, np.random.default_rng(5)))
    for place, each in enumerate(lines if flash else []):
        step_s = each[1]["t_s"] - each[0]["t_s"]
        for line in each:
            middle_s = line["t_s"] if place == 0 else still.offset_s + (1 + still.rate) * line["t_s"]
            lit_s = min(middle_s + step_s / 2, 6.1) - max(middle_s - step_s / 2, 6.0)
            line["light"] += 0.2 * max(lit_s, 0.0) / step_s
    _, said, rows = fed(still, lines)
    assert said is not None
    assert said["told"] == flash
    assert np.nanmax(np.abs(off(still, rows))) < FARTHEST_SD
    if flash:
        assert abs(said["offset_s"][0] - still.offset_s) < FARTHEST_SD * said["offset_s"][1] < 0.05
        assert "a flash that both cameras saw" in " ".join(said["cameras"])
    else:
        assert "the motion tells it to" in said["cameras"][0]
        assert "port+starboard" not in set(rows["camera"])


@pytest.mark.slow
def test_sources_that_stamp_nothing_are_put_on_their_cameras_beats(case: Any, live_joint: ModuleType) -> None:
    """Each picture late by 6 ms on average: the clock is told as well as of cameras that stamp their own, and joint values hold."""
    rng = np.random.default_rng(4)
    without = live_joint.unstamped(case, live_joint.lines_of(case, rng, live_joint.UNSTAMPED_S))
    told = live_joint.told_of(live_joint.joint_of(case), without.lines, every_s=0.25)
    known = [said for said in told.clock if said["told"]]
    assert known
    for said in known:
        assert abs(said["offset_s"][0] - without.offset_s) < FARTHEST_SD * said["offset_s"][1]
    rows = told.rows[told.rows["told"]]
    truth = case.truth(rows["t_s"].to_numpy() - without.zero_s)
    y = values(rows, "y_cg_m")
    assert np.abs((y[:, 0] - truth[:, 1]) / y[:, 1]).max() < FARTHEST_SD
    assert (np.diff(told.rows["t_s"]) > 0).all()
