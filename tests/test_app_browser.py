"""The newcomer's way through the page, in Chromium: from a folder with a video to derivatives, by clicks and keys alone.

Folder of the screenshots: the environment variable TOWLINE_SHOTS, else pytest's own. Latencies are printed, not judged
(``benchmarks/app.py`` measures them).
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SIGMAS = 5.0
"""Each derivative lies within so many of its own standard deviations of the truth: one in two million is farther by chance."""
MOTION_M = 2e-3
"""y_CG of clicked datum points: 0.1 px of a pick is about 0.6 mm at the far points; the sample's own run is at 0.2 mm rms."""

MOVED = """() => {
  window.moved = [];
  const tops = new WeakMap();
  const look = () => {
    const panel = document.querySelector('.side, .whole'), here = document.querySelector('.step.here')?.innerText;
    for (const e of panel ? panel.querySelectorAll('input, button, .q-select') : []) {
      const box = e.getBoundingClientRect(), top = box.top + panel.scrollTop, before = tops.get(e);
      if (!box.height || box.width < 8) continue;  // not drawn
      if (before !== undefined && Math.abs(top - before) > 1)
        window.moved.push(`${here}: ${e.getAttribute('aria-label') || e.innerText || e.className}: ${before} -> ${top}`);
      tops.set(e, top);
    }
    requestAnimationFrame(look);
  };
  look();
}"""
"""Notes all that can be clicked and has moved down or up; a click there may be lost between press and release."""

PATIENCE_MS = 120_000
"""A recording is tracked in 6 s by two quiet cores, in 17 by two that others share: nothing is waited for longer than this."""

SHOWN = "Number(document.querySelector('.viewer').dataset.shown)"
"""The frame whose picture is seen."""

SLOW_PICTURES = """() => {
  const decode = HTMLImageElement.prototype.decode;
  HTMLImageElement.prototype.decode = function () {
    return new Promise((done) => setTimeout(done, 500)).then(() => decode.call(this));
  };
  window.quickPictures = () => { HTMLImageElement.prototype.decode = decode; };
}"""
"""A page on a slow line: every picture comes half a second after it was asked for."""

pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra test)")


class Served:
    """A running ``towline app``."""

    def __init__(self, folder: Path, errors: Path) -> None:
        ours = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
        self._errors = errors.open("w")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "towline", "app", str(folder), "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=ours,
        )
        assert self.process.stdout is not None
        found = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", self.process.stdout.readline())
        assert found, errors.read_text()
        self.address = found.group(0)

    def end(self) -> None:
        """As Ctrl+C does."""
        self.process.terminate()
        self.process.wait(15)
        self._errors.close()


class Person:
    """Clicks and types, keeps the time of each, and takes pictures."""

    def __init__(self, page: Any, shots: Path) -> None:
        self.page, self.shots, self.times = page, shots, {}
        shots.mkdir(parents=True, exist_ok=True)

    def shot(self, name: str) -> None:
        self.page.screenshot(path=str(self.shots / f"{name}.png"))

    def timed(self, name: str, act: Callable[[], Any], until: str) -> None:
        """``act``, then wait until the JavaScript expression holds."""
        begin = time.perf_counter()
        act()
        self.page.wait_for_function(until, polling="raf")
        self.times.setdefault(name, []).append(1e3 * (time.perf_counter() - begin))

    def fill(self, label: str, text: str) -> None:
        field = self.page.get_by_label(label, exact=True)
        field.fill(text)
        field.press("Tab")

    def screen(self, u_px: float, v_px: float) -> tuple[float, float]:
        """Where a place of the recording is on the screen."""
        box = self.page.locator(".viewer img").bounding_box()
        scale = box["width"] / 800
        return box["x"] + (u_px + 0.5) * scale, box["y"] + (v_px + 0.5) * scale

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()


@pytest.fixture
def tank(tmp_path: Path, samples: Path) -> Path:
    """A folder with a video and nothing else."""
    folder = tmp_path / "afternoon" / "tow1"
    folder.mkdir(parents=True)
    shutil.copy(samples / "mariner" / "x1446" / "video.mp4", folder)
    return folder


@pytest.fixture
def served(tank: Path, tmp_path: Path) -> Iterator[Served]:
    made = Served(tank.parent, tmp_path / "errors.txt")
    yield made
    ended = made.process.poll()
    made.end()
    assert ended is None, f"the page's process ended by itself: {ended}"
    assert "Traceback" not in (tmp_path / "errors.txt").read_text()


@pytest.mark.slow
def test_from_a_video_to_derivatives(
    browsers: ModuleType, served: Served, tank: Path, samples: Path, tmp_path: Path
) -> None:
    sample = tomllib.loads((samples / "mariner" / "x1446" / "run.toml").read_text())
    shots = Path(os.environ.get("TOWLINE_SHOTS", tmp_path / "shots"))
    said: list[str] = []
    asked: list[str] = []
    with sync_api.sync_playwright() as playwright:
        browser = browsers.started(playwright)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        page.on("dialog", lambda d: said.append(d.message))
        page.on("pageerror", lambda e: said.append(str(e)))
        page.on("request", lambda r: asked.append(r.url))
        page.on("websocket", lambda w: asked.append(w.url))
        person = Person(page, shots)
        page.goto(served.address)
        page.locator(".head").wait_for()
        page.evaluate(MOVED)
        assert "token" not in page.url
        try:
            begin_a_run(person)
            fill_in_the_facts(person, sample)
            pick_the_datum(person, sample)
            pick_the_marks(person, sample)
            click_by_hand(person)
            moved = page.evaluate("window.moved")
            track(person)
            results(person)
        except sync_api.Error as error:
            person.shot("failed")
            shown_then = page.evaluate("document.body.innerText")
            errors = (tmp_path / "errors.txt").read_text()
            moved = page.evaluate("window.moved")
            error.add_note(f"the page then:\n{shown_then}\nsaid: {said}, moved: {moved}, server: {errors}")
            raise
        browser.close()
    assert said == []
    assert moved == []
    foreign = [url for url in asked if not re.match(r"(http|ws)://127\.0\.0\.1:\d+/|data:|blob:", url)]
    assert foreign == []
    for name, times in person.times.items():
        print(f"{name:34} {sorted(times)[len(times) // 2]:7.0f} ms median {max(times):7.0f} ms worst of {len(times)}")
    judge(tank, samples)


LATE = """() => {
  const given = Object.getOwnPropertyDescriptor(WebSocket.prototype, 'onmessage');
  const sleep = wait_ms => new Promise(done => setTimeout(done, wait_ms));
  Object.defineProperty(WebSocket.prototype, 'onmessage', { ...given, set(handle) {
    let before = Promise.resolve();
    given.set.call(this, event => {
      const late = String(event.data).includes('getAttribute');
      if (late) before = before.then(() => sleep(700));
      before = before.then(() => handle(event));
      if (late) before = before.then(() => sleep(100)).then(() => { window.late = (window.late ?? 0) + 1; });
    });
  }});
}"""
"""Holds back what puts the cursor into a field and all behind it, as a slow machine does; window.late counts what came late."""


@pytest.mark.slow
def test_a_cursor_that_comes_late_leaves_the_field_that_is_typed_into(
    browsers: ModuleType, served: Served, tmp_path: Path
) -> None:
    with sync_api.sync_playwright() as playwright:
        browser = browsers.started(playwright)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.add_init_script(f"({LATE})()")
        person = Person(page, tmp_path / "shots")
        page.goto(served.address)
        begin_a_run(person)
        page.keyboard.press("Escape")
        page.keyboard.press("4")
        page.wait_for_function(shown(0))
        page.mouse.click(*person.screen(430.8, 188.8))
        depth = page.get_by_label("depth of bow", exact=True)
        depth.click()
        page.keyboard.type("0.1")
        assert page.evaluate("window.late") is None, "the cursor was not late: nothing is shown by this test"
        page.wait_for_function("window.late === 1")
        page.keyboard.type("2")
        page.keyboard.press("Tab")
        assert depth.input_value() == "0.12"
        assert page.get_by_label("ahead of bow", exact=True).input_value() == ""
        page.mouse.click(*person.screen(415.8, 398.2))  # nobody types: the cursor comes
        page.wait_for_function("document.activeElement.getAttribute('aria-label') === 'ahead of stern'")
        page.keyboard.type("-1.2")
        assert page.get_by_label("ahead of stern", exact=True).input_value() == "-1.2"
        browser.close()


@pytest.fixture
def filmed(tmp_path: Path, samples: Path) -> Path:
    """A run that is ready to be tracked: the first four seconds of a sample."""
    folder = tmp_path / "tow2"
    folder.mkdir()
    shutil.copy(samples / "mariner" / "x1446" / "video.mp4", folder)
    text = (samples / "mariner" / "x1446" / "run.toml").read_text()
    (folder / "run.toml").write_text(text.replace("[source]\n", "[source]\nspan_s = [0.0, 4.0]\n", 1))
    return folder


CLICK_PX = 1.5
"""A click at a zoom of 0.9 lands within a pixel of the screen of where it was meant, along each axis."""


@pytest.mark.slow
def test_tracks_are_played_and_set_right(browsers: ModuleType, filmed: Path, samples: Path, tmp_path: Path) -> None:
    """Play, jumps, a point moved and one removed, both taken back and done again, seeds, and tracking on from them."""
    shots = Path(os.environ.get("TOWLINE_SHOTS", tmp_path / "shots"))
    served = Served(filmed, tmp_path / "errors.txt")
    said: list[str] = []
    try:
        with sync_api.sync_playwright() as playwright:
            browser = browsers.started(playwright)
            page = browser.new_page(viewport={"width": 1366, "height": 768})
            page.set_default_timeout(PATIENCE_MS)
            page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
            page.on("pageerror", lambda e: said.append(str(e)))
            person = Person(page, shots)
            page.goto(served.address)
            page.locator(".head").wait_for()
            try:
                page.keyboard.press("6")
                page.wait_for_function(shown(0))
                person.press("Track")
                page.locator(".plots .curve").first.wait_for()
                page.evaluate(MOVED)
                play_and_jump(person)
                set_right(person, filmed)
                seed_and_track_on(person, filmed)
                moved = page.evaluate("window.moved")
            except sync_api.Error as error:
                person.shot("6-correct-failed")
                error.add_note(page.evaluate("document.body.innerText"))
                raise
            browser.close()
    finally:
        served.end()
    assert said == []
    assert moved == []
    assert "Traceback" not in (tmp_path / "errors.txt").read_text()
    judge_corrections(filmed, samples)


def play_and_jump(person: Person) -> None:
    page = person.page
    page.keyboard.press("Escape")
    page.keyboard.press("Space")
    page.wait_for_function(f"{SHOWN} > 12")
    here = stopped(page, 300, 500)
    page.keyboard.press("ArrowRight")
    page.wait_for_function(shown(here + 1))
    stop_where_it_is_seen(page)
    page.keyboard.press("]")
    page.get_by_text("2x", exact=True).wait_for()
    page.keyboard.press("[")
    page.get_by_text("1x", exact=True).wait_for()
    page.keyboard.press("n")
    page.get_by_text("No loss after this frame").wait_for()
    page.keyboard.press("w")
    page.get_by_text(re.compile(r"Worst 1 of \d+: (bow|stern), sigma")).wait_for()
    person.shot("6-played")


def stopped(page: sync_api.Page, after_ms: int, for_ms: int) -> int:
    """Stop what plays; the frame that is seen so long after, and no other for so long from then on."""
    page.keyboard.press("Space")
    page.wait_for_function("document.querySelector('[aria-label=\"Play\"]').innerText === 'Play'")
    page.wait_for_timeout(after_ms)
    here = page.evaluate(SHOWN)
    page.wait_for_timeout(for_ms)
    assert page.evaluate(SHOWN) == here
    return here


def stop_where_it_is_seen(page: sync_api.Page) -> None:
    """Pictures that take half a second each: the clock is frames ahead of the one that is seen, where it is stopped."""
    page.evaluate(SLOW_PICTURES)
    begin = page.evaluate(SHOWN)
    page.keyboard.press("Space")
    page.wait_for_function(f"{SHOWN} > {begin + 3}")
    here = stopped(page, 100, 1200)  # two pictures
    page.evaluate("window.quickPictures()")
    page.keyboard.press("ArrowRight")
    page.wait_for_function(shown(here + 1))
    page.get_by_text(re.compile(rf"^frame {here + 1} ")).wait_for()


def set_right(person: Person, filmed: Path) -> None:
    page = person.page
    page.get_by_role("radio", name="Correct").click()
    page.keyboard.press("Escape")
    at(person, 25)
    page.keyboard.press("m")
    page.mouse.click(*person.screen(440.0, 200.0))
    by_hand = "[...document.querySelectorAll('.viewer .over .label')].some(e => e.textContent === 'bow by hand')"
    page.wait_for_function(by_hand)
    page.get_by_text("1 point by hand, not saved").wait_for()
    page.keyboard.press("Control+z")
    page.get_by_text("Nothing corrected").wait_for()
    page.wait_for_function(f"!({by_hand})")
    page.keyboard.press("Control+y")
    page.wait_for_function(by_hand)
    sigma = page.get_by_label("Sigma of a correction", exact=True)
    sigma.click()
    page.keyboard.press("Delete")  # of the text, not of a point
    page.keyboard.press("x")
    sigma.fill("0.8")
    sigma.press("Tab")
    page.keyboard.press("Escape")
    page.get_by_text("1 point by hand, not saved").wait_for()
    page.keyboard.press("x")
    at(person, 50)
    page.keyboard.press("Delete")
    page.get_by_text("1 point by hand, 1 removed, not saved").wait_for()
    page.get_by_text("stern removed").wait_for()
    person.shot("6-correct")
    page.keyboard.press("Control+s")
    page.wait_for_function(pill("Saved"))
    written = tomllib.loads((filmed / "corrections.toml").read_text())
    assert [(p["frame"], p["marker"], p["sigma_px"]) for p in written["point"]] == [
        (25, "bow", pytest.approx(1.0, rel=0.5))
    ]
    assert [(p["frame"], p["marker"]) for p in written["removed"]] == [(50, "stern")]


def seed_and_track_on(person: Person, filmed: Path) -> None:
    page = person.page
    at(person, 75)
    page.keyboard.press("d")
    page.keyboard.press("x")
    for mark, place in (("bow", (421.9, 189.4)), ("stern", (414.5, 399.5))):
        page.mouse.click(*person.screen(*place))
        label = f"[...document.querySelectorAll('.viewer .over .label')].some(e => e.textContent === '{mark} seed')"
        page.wait_for_function(label)
    person.shot("6-seeded")
    person.press("Track on from here")
    page.get_by_text("Track done in").wait_for()
    page.get_by_text(re.compile(r"bow: measured in \d+ frames, set by hand in 1")).wait_for()
    page.wait_for_function(pill("Saved"))
    person.shot("6-tracked-on")
    page.keyboard.press("Escape")
    page.keyboard.press("Home")
    page.wait_for_function(shown(0))
    page.keyboard.press("n")
    page.wait_for_function(shown(50))
    page.get_by_text("Loss 1 of 1: stern lost for 1 frame: removed by hand").wait_for()


def at(person: Person, frame: int) -> None:
    """To a multiple of 25, by keys."""
    page = person.page
    page.keyboard.press("Home")
    page.wait_for_function(shown(0))
    for step in range(1, frame // 25 + 1):
        page.keyboard.press("Shift+ArrowRight")
        page.wait_for_function(shown(25 * step))


def judge_corrections(filmed: Path, samples: Path) -> None:
    from towline.record.tables import read_motion, read_tracks

    written = tomllib.loads((filmed / "corrections.toml").read_text())
    assert {s["marker"]: s["frame"] for s in written["seed"]} == {"bow": 75, "stern": 75}
    tracks = read_tracks(filmed / "out" / "tracks.csv").set_index(["marker", "frame"])
    assert tracks.loc[("bow", 25), "status"] == "by_hand"
    assert abs(tracks.loc[("bow", 25), "u_px"] - 440.0) < CLICK_PX
    assert tracks.loc[("stern", 50), "status"] == "lost"
    truth = read_tracks(samples / "mariner" / "x1446" / "truth" / "tracks.csv").set_index(["marker", "frame"])
    for name in ("bow", "stern"):
        rows = tracks.loc[name].loc[75:]
        apart = rows[["u_px", "v_px"]] - truth.loc[name].loc[rows.index, ["u_px", "v_px"]]
        assert (rows["status"] == "measured").all()
        assert (apart.abs().to_numpy() < 5 * rows[["sigma_u_px", "sigma_v_px"]].to_numpy()).mean() > 0.99
    motion = read_motion(filmed / "out" / "motion.csv")
    assert motion["sigma_y_cg_m"][25] > 5 * motion["sigma_y_cg_m"].median()  # the hand's
    assert motion["status"][50] == "lost"


def begin_a_run(person: Person) -> None:
    person.page.get_by_text("1 video, no run yet").wait_for()
    person.shot("1-run")
    person.press("Begin a run tow1")
    person.page.get_by_label("tow.speed_m_s", exact=True).wait_for()


def fill_in_the_facts(person: Person, sample: dict[str, Any]) -> None:
    page = person.page
    person.fill("tow.speed_m_s", "1280")
    page.get_by_text("1280 is outside 0 .. 30 m/s (carriage speed; is it in mm/s?)").wait_for()
    person.shot("2-facts-wrong")
    for key in ("speed_m_s", "line_length_m", "tow_point_m", "tension_n"):
        person.fill(f"tow.{key}", str(sample["tow"][key]))
    for key in ("length_pp_m", "mass_kg"):
        person.fill(f"model.{key}", str(sample["model"][key]))
    person.fill("water.tank_width_m", str(sample["water"]["tank_width_m"]))
    person.press("Picture size from the video")
    page.wait_for_function("document.querySelector('[aria-label=\"camera.image_size_px\"]').value === '800, 600'")
    for key in ("fx_px", "fy_px", "cx_px", "cy_px"):
        person.fill(f"camera.{key}", str(sample["camera"][key]))
    person.fill("camera.distortion", " ".join(map(str, sample["camera"]["distortion"])))
    person.timed("typed value taken", lambda: person.fill("tow.tension_n", "4.1"), pill("Not saved"))
    page.keyboard.press("Escape")
    person.timed("undo", lambda: page.keyboard.press("Control+z"), value("tow.tension_n", "3.96"))
    person.timed("redo", lambda: page.keyboard.press("Control+y"), value("tow.tension_n", "4.1"))
    person.timed("undo", lambda: page.keyboard.press("Control+z"), value("tow.tension_n", "3.96"))
    person.shot("2-facts")


def pick_the_datum(person: Person, sample: dict[str, Any]) -> None:
    page = person.page
    page.keyboard.press("Escape")
    person.timed("step with a frame", lambda: page.keyboard.press("3"), shown(0))
    for number, point in enumerate(sample["datum"], 1):
        u, v = person.screen(*point["pixel_px"])
        page.mouse.move(u, v)
        person.timed("click of a datum point", lambda u=u, v=v: page.mouse.click(u, v), rows(number))
        x, y, depth = point["tank_m"]
        name = f"point {number}"
        for axis, number_m in (("x", x), ("y", y), ("depth", depth)):
            if number_m:  # a depth of 0 is left empty
                person.fill(f"{axis} of {name}", str(number_m))
        if number == 1:
            page.mouse.move(u + 3, v + 2)
            person.shot("3-datum-first")
    page.get_by_text(re.compile(r"The points fit to 0\.\d\d px rms")).wait_for()
    page.wait_for_function(
        "document.querySelector('img.top').complete && document.querySelector('img.top').naturalWidth > 100"
    )
    person.shot("3-datum")
    left_over = "document.querySelector('.left-over').innerText"
    change = f"{left_over} !== {page.evaluate(left_over)!r}"
    person.timed("residuals after a typed place", lambda: person.fill("x of point 1", "-0.5"), change)
    person.shot("3-datum-bad-place")
    page.keyboard.press("Escape")
    page.keyboard.press("Control+z")
    page.wait_for_function(value_js("x of point 1", "-0.55"))
    person.timed("zoom", lambda: page.mouse.wheel(0, -600), "document.querySelector('.viewer img').clientWidth > 1500")
    person.shot("3-datum-zoomed")
    page.keyboard.press("0")
    hostile = "<img src=x onerror=alert(1)>'\"`"
    person.fill("name 1", hostile)
    page.keyboard.press("Escape")
    page.wait_for_function(f"document.querySelector('.viewer .over .label').textContent === {hostile!r}")
    page.keyboard.press("2")
    page.keyboard.press("3")
    page.get_by_label(f"x of {hostile}", exact=True).wait_for()
    page.keyboard.press("Control+z")
    page.get_by_label("x of point 1", exact=True).wait_for()
    person.timed("save", lambda: page.keyboard.press("Control+s"), pill("Saved"))


def pick_the_marks(person: Person, sample: dict[str, Any]) -> None:
    page = person.page
    page.keyboard.press("4")
    page.wait_for_function(shown(0))
    places = {"bow": (430.8, 188.8), "stern": (415.8, 398.2)}  # as a person sees them in the first frame
    for mark in sample["marker"]:
        name = mark["name"]
        u, v = person.screen(*places[name])
        page.mouse.click(u, v)
        page.get_by_label(f"ahead of {name}", exact=True).wait_for()
        person.fill(f"ahead of {name}", str(mark["body_m"][0]))
        person.fill(f"depth of {name}", str(mark["depth_m"]))
        page.get_by_label(f"colour of {name}", exact=True).click()
        page.get_by_role("option", name="red", exact=True).click()
    page.get_by_text("2 of 2 marks found").wait_for()
    person.shot("4-marks")


def click_by_hand(person: Person) -> None:
    """Three frames of clicks, one taken back; nothing of it is kept."""
    page = person.page
    page.keyboard.press("Escape")
    page.keyboard.press("5")
    page.get_by_text("Click: bow").wait_for()
    for frame in (0, 15, 30):
        page.wait_for_function(shown(frame))
        page.mouse.click(*person.screen(430.8, 188.8))
        page.get_by_text("Click: stern").wait_for()
        next_one = shown(frame + 15)
        person.timed("second click, next frame", lambda: page.mouse.click(*person.screen(415.8, 398.2)), next_one)
    person.timed("click taken back", lambda: page.keyboard.press("Control+z"), shown(30))
    page.get_by_text("2 frames done, 5 clicks").wait_for()
    person.shot("5-by-hand")
    for _ in range(5):
        page.keyboard.press("Control+z")
    page.get_by_text("0 frames done, 0 clicks").wait_for()


def track(person: Person) -> None:
    page = person.page
    page.keyboard.press("Escape")
    page.keyboard.press("6")
    page.wait_for_function(shown(0))
    begin = time.perf_counter()
    person.press("Track")
    page.locator(".bar .fill").wait_for()
    frame = 0
    for _ in range(5):  # the page stays alive meanwhile
        frame += 1
        person.timed("frame while tracking", lambda: page.keyboard.press("ArrowRight"), shown(frame))
    person.shot("6-tracking")
    page.locator(".plots .curve").first.wait_for()
    page.get_by_text(re.compile(r"motion in \d+ of 1200 frames")).wait_for()
    person.times["track 1200 frames"] = [1e3 * (time.perf_counter() - begin)]
    for _ in range(10):
        frame += 1
        person.timed("frame by arrow key", lambda: page.keyboard.press("ArrowRight"), shown(frame))
    person.timed("25 frames by shift and arrow", lambda: page.keyboard.press("Shift+ArrowRight"), shown(frame + 25))
    person.timed("last frame", lambda: page.keyboard.press("End"), shown(1199))
    person.timed("first frame", lambda: page.keyboard.press("Home"), shown(0))
    box = page.locator(".plots").bounding_box()
    for share in (0.3, 0.5, 0.7, 0.9):
        x, y = box["x"] + share * box["width"], box["y"] + 0.5 * box["height"]
        before = page.locator(".viewer").get_attribute("data-shown")
        until = f"document.querySelector('.viewer').dataset.shown !== '{before}'"
        person.timed("frame by the plot's cursor", lambda x=x, y=y: page.mouse.move(x, y), until)
    page.wait_for_timeout(250)
    person.shot("6-track")
    slider = page.locator(".scrub .q-slider").bounding_box()
    for share in (0.2, 0.8, 0.5):
        before = page.locator(".viewer").get_attribute("data-shown")
        x, y = slider["x"] + share * slider["width"], slider["y"] + slider["height"] / 2
        until = f"document.querySelector('.viewer').dataset.shown !== '{before}'"
        person.timed("frame by the slider", lambda x=x, y=y: page.mouse.click(x, y), until)


def results(person: Person) -> None:
    page = person.page
    page.keyboard.press("Escape")
    page.keyboard.press("7")
    person.press("Check")
    page.get_by_text("Check done in").wait_for()
    page.get_by_text(re.compile("tow1: (sound|fault|unknown)")).wait_for()
    page.frame_locator("iframe.result").locator("h1").wait_for()
    person.shot("7-check")
    person.press("Identify")
    page.get_by_text("Identify done in").wait_for()
    page.get_by_label("Identify result").wait_for()
    assert page.locator("table.found tr").count() == 6
    page.frame_locator("iframe.result").locator("h1").wait_for()
    person.shot("7-identify")


def judge(tank: Path, samples: Path) -> None:
    """What the person got, against the truth that the sample was drawn from."""
    import json

    import numpy as np

    from towline.record import read_run
    from towline.record.tables import read_motion

    truth = samples / "mariner" / "x1446" / "truth"
    read_run(tank)
    motion, true = read_motion(tank / "out" / "motion.csv"), read_motion(truth / "motion.csv")
    apart = motion["y_cg_m"].to_numpy() - np.interp(motion["t_s"], true["t_s"], true["y_cg_m"])
    assert len(motion) == 1200
    assert np.sqrt(np.mean(apart**2)) < MOTION_M
    found = json.loads((tank / "out" / "derivatives.json").read_text())["derivatives"]
    right = json.loads((truth / "derivatives.json").read_text())["derivatives"]
    for name, value in found.items():
        print(f"{name:16} {value['value']:9.2f} +- {value['std']:.2f}   true {right[name]:9.2f}")
    assert (tank / "out" / "check.html").is_file()
    for name, value in found.items():
        assert abs(value["value"] - right[name]) < SIGMAS * value["std"], name


def shown(frame: int) -> str:
    return f"document.querySelector('.viewer')?.dataset.shown === '{frame}'"


def pill(text: str) -> str:
    return f"document.querySelector('.pill').innerText === '{text}'"


def value(label: str, text: str) -> str:
    return value_js(label, text)


def value_js(label: str, text: str) -> str:
    return f"document.querySelector('[aria-label=\"{label}\"]')?.value === '{text}'"


def rows(count: int) -> str:
    return f"document.querySelectorAll('.datumrow.prow').length === {count}"
