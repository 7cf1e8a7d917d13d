"""The live page: what it shows of a tow and of a day, without a browser and, once, in Chromium."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from clips import remux

from towline.app.live_view import SHOWN_S, DayView, Live, Tail
from towline.live.kept import keep_day
from towline.live.tows import Standing, Wish
from towline.record.run import read_run
from towline.record.tables import read_motion
from towline.vision import read_frames

FILM_FRAMES = 130
"""Of the film that is played: 4.3 s, so that what is said before a tow is said once."""


def a_frame(index: int, y_m: float | None, t_s: float | None = None) -> dict[str, Any]:
    """A line of live.jsonl."""
    seen = None if y_m is None else [y_m, 1e-4, 3e-4]
    marks = {"bow": [1.0, 2.0, 0.1, 0.1], "stern": "not seen" if y_m is None else [1.0, 2.0, 0.1, 0.1]}
    return {
        "frame": index,
        "t_s": index / 30 if t_s is None else t_s,
        "latency_s": 0.012,
        "marks": marks,
        "y_cg_m": seen,
        "beta_rad": seen,
        "alpha_rad": None,
    }


def a_log(folder: Path, *records: dict[str, Any]) -> Tail:
    """A tow's log with these lines, and what is shown of it."""
    (folder / "out").mkdir(parents=True, exist_ok=True)
    with (folder / "out" / "live.jsonl").open("a") as stream:
        stream.writelines(json.dumps(record) + "\n" for record in records)
    tail = Tail(folder)
    tail.read()
    return tail


def test_the_plot_shows_the_last_half_minute_with_gaps_where_nothing_was_seen(tmp_path: Path) -> None:
    """Two minutes of frames; a mark lost for a second; two seconds at which nobody looked."""
    frames = [a_frame(k, None if 3000 <= k < 3030 else k / 30) for k in range(3600) if not 3200 <= k < 3260]
    curves = a_log(tmp_path, *frames).curves()
    times = np.array(curves["t"])
    assert 119 - SHOWN_S < times[0] < times[-1] <= 120
    assert len(times) <= 310
    assert [panel["label"].partition(",")[0] for panel in curves["panels"]] == ["β", "y_CG"]  # no line angle was told
    y = np.array(curves["panels"][1]["y"], float)
    seen = np.isfinite(y)
    assert y[seen] == pytest.approx(1e3 * times[seen], rel=1e-4)
    assert np.array(curves["panels"][1]["sd"], float)[seen] == pytest.approx(0.1)
    assert not seen[(times > 3002 / 30) & (times < 3028 / 30)].any()
    inside = (times > 3200 / 30) & (times < 3259 / 30)
    assert inside.sum() == 1  # a point without a value: no line goes across
    assert not seen[inside].any()


def test_the_end_of_a_log_says_what_was_named_and_what_is_in_order(tmp_path: Path) -> None:
    tail = a_log(
        tmp_path,
        {"ready": "bow", "t_s": 3.0, "good": False, "words": "not seen"},
        a_frame(90, None),
        {"event": "mark", "t_s": 3.1, "level": "fault", "words": "stern is lost"},
    )
    assert tail.ready == {"bow": ("not seen", False)}
    assert "not seen: stern" in tail.now()
    before = tail.version
    with (tmp_path / "out" / "live.jsonl").open("a") as stream:
        stream.write(json.dumps({"ready": "bow", "t_s": 5.0, "good": True, "words": "seen"}) + "\n")
    tail.read()
    assert tail.version == before + 1
    assert tail.ready == {"bow": ("seen", True)}
    assert [event["words"] for event in tail.events] == ["stern is lost"]
    assert tail.steady is None
    told = {"steady": "X_v 0.22 +- 0.01 m", "t_s": 9.0, "stands": True, "settled": True}
    tail = a_log(tmp_path, told)
    assert tail.steady == told
    assert Tail(tmp_path / "none").curves() == {}


def test_two_cameras_are_shown_as_one_course_with_what_each_says(tmp_path: Path) -> None:
    """Values of both together with all that is unsure of them; what was named, what is in order and what is not seen by each
    camera; in the list of tows, too."""
    tow = tmp_path / "tow-01"
    for name, y_m in (("port", 0.3), ("starboard", None)):
        (tow / "out" / name).mkdir(parents=True)
        told = [
            {"ready": "datum", "t_s": 3.0, "good": True, "words": "stands"},
            a_frame(90, y_m),
            {"event": "mark", "t_s": 3.0, "level": "fault", "words": "stern is lost"},
        ]
        lines = told if y_m is None else told[:2]
        (tow / "out" / name / "live.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))

    def joint(number: int, camera: str) -> dict[str, Any]:
        y = [0.2, 3e-4, 4e-4] if camera else None
        row = {"joint": number, "t_s": number / 30, "latency_s": 0.2, "camera": camera, "told": True}
        return row | {"y_cg_m": y, "beta_rad": y, "alpha_rad": None}

    clock = {"cameras": ["the clock", "they agree"], "t_s": 2.0, "told": True, "agree": True}
    tail = a_log(tow, *(joint(k, "port+starboard") for k in range(60)), clock, joint(60, ""), joint(61, "port"))
    assert tail.cameras == ("port", "starboard")
    assert tail.pair == clock
    assert "by port" in tail.now()
    assert "y_CG +200.0 ± 0.5 mm" in tail.now()
    assert "not seen by starboard: stern" in tail.now()
    assert set(tail.ready) == {"port: datum", "starboard: datum"}
    assert [event["words"] for event in tail.events] == ["starboard: stern is lost"]
    panels = tail.curves()["panels"]
    assert [len(panel["y"]) for panel in panels] == [62, 62]
    assert panels[1]["y"][60] is None
    assert panels[1]["sd"][0] == pytest.approx(0.5)
    (tow / "run.toml").write_text("")
    (row,) = DayView(tmp_path).rows()
    assert row.seconds == pytest.approx(61 / 30)
    assert row.named == ("starboard: 3.0 s: stern is lost",)


def test_a_day_is_shown_from_what_lies_on_the_disk(tmp_path: Path, samples: Path) -> None:
    """A static record, a tow with something named, and where the day stands; a page that was begun anew shows the same."""
    day = tmp_path / "day-2026-11-25"
    for name in ("static-01", "tow-01", "tow-02"):
        (day / name).mkdir(parents=True)
        shutil.copy(samples / "mariner" / "x1446" / "run.toml", day / name)
        os.utime(day / name / "run.toml", (0, 10 * len(name) + int(name[-1])))
    a_log(day / "tow-02", a_frame(0, 0.1), a_frame(60, 0.1))
    a_log(day / "tow-02", {"event": "camera", "t_s": 1.0, "level": "warning", "words": "it moved"})
    view = DayView(day)
    assert [(r.folder.name, r.seconds, r.named) for r in view.rows()] == [
        ("static-01", None, ()),
        ("tow-01", None, ()),
        ("tow-02", 2.0, ("1.0 s: it moved",)),
    ]
    assert view.standing() == (None, "")
    before = view.version
    keep_day(day, Standing(("tow-01",), None, "too short", {"tow-02": "no marks"}, (Wish("y_v", None, 2.0),)))
    assert view.version != before
    standing, wrong = view.standing()
    assert standing is not None
    assert (standing.repeat, standing.problem, wrong) == ({"tow-02": "no marks"}, "too short", "")
    assert standing.derivatives["y_v"].wished_percent == 2.0
    (day / "day.json").write_text("{")
    assert "day.json" in DayView(day).standing()[1]
    (tmp_path / "set-up").mkdir()
    live = Live.beside(tmp_path / "set-up", "2026-11-25")
    live.follow(None)
    assert live.day.folder == day
    assert live.tail is not None
    assert live.tail.folder == view.last()


@pytest.fixture
def hall(tmp_path: Path, samples: Path) -> Path:
    """A set-up, a film of some seconds, a plan, and a day with one tow."""
    mariner, rng = samples / "mariner", np.random.default_rng(3)
    setup = tmp_path / "set-up"
    shutil.copytree(mariner / "x1446", setup, ignore=shutil.ignore_patterns("out", "truth"))
    remux(setup / "video.mp4", tmp_path / "film.mp4", lambda index, _: index < FILM_FRAMES)
    from test_live_day import PLAN

    (tmp_path / "plan.toml").write_text(PLAN.format(percent=0.1))
    tow = tmp_path / "today" / "tow-01"
    tow.mkdir(parents=True)
    text = (mariner / "x1751" / "run.toml").read_text().replace('video = "video.mp4"', 'motion = "motion.csv"')
    (tow / "run.toml").write_text(text.replace('name = "mariner-x1751"', 'name = "mariner tow-01"'))
    motion = read_motion(mariner / "x1751" / "truth" / "motion.csv").iloc[::3][["t_s", "y_cg_m", "beta_rad"]]
    motion["y_cg_m"] += 1e-3 * rng.normal(size=len(motion))
    motion["beta_rad"] += 2e-3 * rng.normal(size=len(motion))
    motion.to_csv(tow / "motion.csv", index=False)
    return tmp_path


@pytest.mark.slow
def test_a_tow_is_filmed_fitted_and_survives_reload_and_kill(browsers: ModuleType, hall: Path, tmp_path: Path) -> None:
    """By clicks: a tow filmed to its source's end and fitted with the day's first one; another one during which the page's process
    is killed: begun anew, it shows the day as it was, with the new tow in it."""
    pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra test)")
    from test_app_browser import Served

    shots = Path(os.environ.get("TOWLINE_SHOTS", tmp_path / "shots"))
    shots.mkdir(parents=True, exist_ok=True)
    served = Served(hall / "set-up", tmp_path / "errors.txt")
    said: list[str] = []
    day = hall / "today"
    with sync_api.sync_playwright() as playwright:
        browser = browsers.started(playwright)

        def opened(address: str) -> Any:
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.set_default_timeout(60_000)
            page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
            page.on("pageerror", lambda e: said.append(str(e)))
            page.goto(address)
            page.locator(".head").wait_for()
            page.keyboard.press("8")
            return page

        def filled(page: Any) -> None:
            for label, path in (("Source", hall / "film.mp4"), ("Day", day), ("Plan", hall / "plan.toml")):
                page.get_by_label(label, exact=True).fill(str(path))
            page.get_by_label("Plan", exact=True).press("Tab")

        try:
            page = opened(served.address)
            page.get_by_role("button", name="Film a tow", exact=True).click()
            page.get_by_text("Say where the pictures come from: Source").wait_for()
            filled(page)
            page.get_by_label("Tows of the day").get_by_text("tow-01").wait_for()
            page.get_by_role("button", name="Film a tow", exact=True).click()
            page.locator(".plots .curve").first.wait_for()
            page.get_by_text("Being filmed.").wait_for()
            picture = page.get_by_alt_text("The tow as the camera sees it")
            picture.wait_for()
            page.wait_for_function("document.querySelector('.livebox img').naturalWidth === 640")
            first = picture.get_attribute("src")
            page.wait_for_function(
                "(old) => document.querySelector('.livebox img').getAttribute('src') !== old", arg=first
            )
            page.screenshot(path=str(shots / "8-filming.png"))
            page.reload()
            page.locator(".head").wait_for()
            page.keyboard.press("8")
            assert page.get_by_label("Source", exact=True).input_value() == str(hall / "film.mp4")
            page.locator(".plots .curve").first.wait_for()
            page.get_by_text(re.compile(r"130 pictures recorded.* Fitted, .* after its end")).wait_for()
            assert "bow: seen in 100 %" in page.get_by_label("Readiness").inner_text()
            wishes = page.get_by_label("Against the wish").inner_text()
            assert len(re.findall(r"not yet|met", wishes)) == 6
            page.get_by_text(re.compile(r"Not enough yet. The tow that helps most: X_T 1\.\d{3} m")).wait_for()
            page.get_by_text("The last picture.").wait_for()
            page.screenshot(path=str(shots / "8-fitted.png"))
            page.get_by_role("button", name="Film a tow", exact=True).click()
            page.get_by_text("Filming tow-03").wait_for()
            page.locator("[aria-label='Values now']", has_text="tow-03").wait_for()
            served.process.kill()
            served.process.wait()
            page.close()
            said.clear()  # a page whose server was killed says so
            served = Served(hall / "set-up", tmp_path / "errors.txt")
            page = opened(served.address)
            filled(page)
            page.get_by_text("tow-03").first.wait_for()
            assert page.get_by_label("Against the wish").inner_text() == wishes
            page.screenshot(path=str(shots / "8-anew.png"))
            browser.close()
        finally:
            served.end()
    assert said == []
    assert "Traceback" not in (tmp_path / "errors.txt").read_text()
    assert read_run(day / "tow-03").file.source.video == "film.ts"
    assert len(list(read_frames(day / "tow-03" / "film.ts"))) > 0
