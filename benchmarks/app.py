"""The page in Chromium on a 720p recording: how long each interaction takes on the screen, and the memory of the processes.

    python benchmarks/app.py [--seconds 20] [--run FOLDER]

Renders the sample's MARINER tow at 1280 x 720, opens it with `towline app`, and does each thing many times. A time runs from the
key or the mouse button in the browser to the first frame drawn that shows the answer. Needs playwright and Chromium.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from browser import started

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"
LARGER = {
    "image_size_px = [800, 600]": "image_size_px = [1280, 720]",
    "fx_px = 920.0": "fx_px = 1104.0",
    "fy_px = 920.0": "fy_px = 1104.0",
    "cx_px = 399.5": "cx_px = 639.5",
    "cy_px = 299.5": "cy_px = 359.5",
}
WAIT_MS = 20_000
PAUSE_MS = 300
"""Between two jumps of the slider: a person looks."""
NOTED = """
window.began = 0;
for (const name of ["keydown", "pointerdown", "pointermove", "wheel", "change"])
  addEventListener(name, () => { window.began = performance.now(); }, true);
"""
"""Before the page's own scripts: when the person did the last thing."""
TIMED = f"""(until) => {{
  window.began = 0;
  const holds = new Function("return " + until);
  window.took = new Promise((done, failed) => {{
    setTimeout(() => failed(new Error("waited in vain for " + until)), {WAIT_MS});
    const look = () => window.began && holds() ? done(performance.now() - window.began) : requestAnimationFrame(look);
    look();
  }});
}}"""


def rendered(folder: Path, seconds: float) -> Path:
    """The sample's tow, larger and shorter."""
    text = (SAMPLE / "scenario.toml").read_text()
    for old, new in (*LARGER.items(), ("duration_s = 40.0", f"duration_s = {seconds}")):
        assert old in text, old
        text = text.replace(old, new)
    scenario = folder / "scenario.toml"
    scenario.write_text(text)
    command = [sys.executable, "-m", "towline", "render", str(scenario), "-o", str(folder / "run")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "run"


def peak_mib(process: int) -> float:
    """Largest resident memory of a process so far."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    return int(found.group(1)) / 1024 if found else float("nan")


def children_of(process: int) -> list[int]:
    """Processes that it started."""
    return [int(c) for task in Path(f"/proc/{process}/task").iterdir() for c in (task / "children").read_text().split()]


class Person:
    """Does a thing and keeps how long its answer took."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.times: dict[str, list[float]] = {}

    def timed(self, name: str, act: Callable[[], Any], until: str) -> None:
        """``act``, until the JavaScript expression holds on the screen."""
        self.page.evaluate(TIMED, until)
        act()
        self.times.setdefault(name, []).append(float(self.page.evaluate("window.took")))

    def frame(self) -> int:
        """The one that is shown."""
        return int(self.page.evaluate("document.querySelector('.viewer').dataset.shown"))

    def screen(self, u_px: float, v_px: float) -> tuple[float, float]:
        """Where a place of the recording is on the screen."""
        box = self.page.locator(".viewer img").bounding_box()
        scale = box["width"] / 1280
        return box["x"] + (u_px + 0.5) * scale, box["y"] + (v_px + 0.5) * scale


def shown(frame: int) -> str:
    return f"document.querySelector('.viewer')?.dataset.shown === '{frame}'"


def other_frame(frame: int) -> str:
    return f"document.querySelector('.viewer').dataset.shown !== '{frame}'"


def scrub(person: Person, last: int) -> None:
    """Keys, slider."""
    page = person.page
    page.keyboard.press("Home")
    page.wait_for_function(shown(0))
    frame = 0
    for _ in range(30):
        frame += 1
        person.timed("frame on, arrow key", lambda: page.keyboard.press("ArrowRight"), shown(frame))
    for _ in range(10):
        frame += 25
        person.timed("25 frames on, shift and arrow", lambda: page.keyboard.press("Shift+ArrowRight"), shown(frame))
    for _ in range(5):
        person.timed("last frame, End", lambda: page.keyboard.press("End"), shown(last))
        person.timed("first frame, Home", lambda: page.keyboard.press("Home"), shown(0))
    jump(person, "any frame, slider", "true")


def jump(person: Person, name: str, also: str) -> None:
    """The slider, here and there; ``also`` must hold when the frame is shown."""
    page = person.page
    box = page.locator(".scrub .q-slider").bounding_box()
    for share in (0.9, 0.1, 0.5, 0.3, 0.7, 0.2, 0.95, 0.4, 0.6, 0.8):
        x, y = box["x"] + share * box["width"], box["y"] + box["height"] / 2
        person.timed(name, lambda x=x, y=y: page.mouse.click(x, y), f"{other_frame(person.frame())} && {also}")
        page.wait_for_timeout(PAUSE_MS)


def datum(person: Person, points: list[dict[str, Any]]) -> None:
    """Points picked again, places typed, undone and done again."""
    page = person.page
    page.keyboard.press("3")
    page.get_by_text(re.compile("The points fit to")).wait_for()
    page.keyboard.press("Home")
    page.wait_for_function(shown(0))
    left_over = "document.querySelectorAll('.left-over')[{}].innerText"
    for number, point in enumerate(points):
        page.get_by_label(f"Pick {point['name']} again", exact=True).click()
        page.keyboard.press("0")
        page.wait_for_timeout(200)
        x, y = person.screen(*point["pixel_px"])
        page.mouse.move(x + 1, y + 1)
        one = left_over.format(number)
        changed = f"{one} !== {page.evaluate(one)!r}"
        person.timed("click of a datum point: new residuals", lambda x=x, y=y: page.mouse.click(x + 1, y + 1), changed)
    for number, point in enumerate(points):
        field = page.get_by_label(f"x of {point['name']}", exact=True)
        one = left_over.format(number)
        for millimetres in (3, 0):  # a little off, and back
            field.fill(f"{point['tank_m'][0] + millimetres / 1000:.3f}")
            changed = f"{one} !== {page.evaluate(one)!r}"
            person.timed("typed place: new residuals", lambda f=field: f.press("Tab"), changed)
    page.keyboard.press("Escape")
    first = "document.querySelector('[aria-label=\"x of " + points[-1]["name"] + "\"]')?.value"
    for _ in range(5):
        before = page.evaluate(first)
        person.timed("undo", lambda: page.keyboard.press("Control+z"), f"{first} !== '{before}'")
        before = page.evaluate(first)
        person.timed("redo", lambda: page.keyboard.press("Control+y"), f"{first} !== '{before}'")
    page.mouse.move(*person.screen(640, 360))
    width = "document.querySelector('.viewer img').clientWidth"
    for way in (-300, -300, 300, 300):
        before = page.evaluate(width)
        person.timed("zoom, wheel", lambda way=way: page.mouse.wheel(0, way), f"{width} !== {before}")
    page.keyboard.press("0")
    grid = "document.querySelectorAll('.viewer .over polyline').length"
    for _ in range(4):
        before = page.evaluate(grid)
        person.timed("grid on, off", lambda: page.keyboard.press("g"), f"{grid} !== {before}")
    person.timed(
        "save", lambda: page.keyboard.press("Control+s"), "document.querySelector('.pill').innerText === 'Saved'"
    )


def marks(person: Person) -> None:
    """What the detector sees in each further frame."""
    page = person.page
    page.keyboard.press("4")
    page.get_by_text("2 of 2 marks found").wait_for()
    spots = "document.querySelectorAll('.viewer .over .spot').length"
    for _ in range(8):
        frame = person.frame() + 25
        until = f"{shown(frame)} && {spots} > 0"
        person.timed("next frame with the detector's view", lambda: page.keyboard.press("Shift+ArrowRight"), until)
    jump(person, "any frame with the detector's view", f"{spots} > 0")


def hand(person: Person) -> None:
    """Pairs of clicks."""
    page = person.page
    page.keyboard.press("5")
    page.get_by_text("Click: bow").wait_for()
    page.wait_for_function(shown(0))
    what = "document.querySelector('.side .big').innerText"
    for frame in range(0, 150, 15):
        page.wait_for_function(shown(frame))
        page.mouse.move(*person.screen(600, 300))
        person.timed("click by hand", lambda: page.mouse.click(*person.screen(600, 300)), f"{what} === 'Click: stern'")
        go_on = lambda: page.mouse.click(*person.screen(600, 500))  # noqa: E731
        person.timed("second click, 15 frames on", go_on, shown(frame + 15))
    for _ in range(20):
        page.keyboard.press("Control+z")
    page.get_by_text("0 clicks").wait_for()


def track(person: Person, frames: int) -> None:
    """The job, frames meanwhile, then the plots' cursor."""
    page = person.page
    page.keyboard.press("6")
    page.keyboard.press("Home")
    page.wait_for_function(shown(0))
    begin = time.perf_counter()
    page.get_by_role("button", name="Track", exact=True).click()
    page.locator(".bar .fill").wait_for()
    frame = 0
    while page.locator(".plots .curve").count() == 0:
        frame += 1
        person.timed("frame on, while tracking", lambda: page.keyboard.press("ArrowRight"), shown(frame))
    print(f"tracking {frames} frames: {time.perf_counter() - begin:.1f} s")
    box = page.locator(".plots").bounding_box()
    for step in range(30):
        share = 0.15 + 0.8 * ((step * 7) % 30) / 30
        x, y = box["x"] + share * box["width"], box["y"] + 0.5 * box["height"]
        until = other_frame(person.frame())
        person.timed("any frame, cursor on the plots", lambda x=x, y=y: page.mouse.move(x, y), until)
    page.mouse.move(5, 5)
    person.times |= {f"{k}, with marks": v for k, v in _arrows(person).items()}


def _arrows(person: Person) -> dict[str, list[float]]:
    page = person.page
    page.wait_for_timeout(300)
    frame = person.frame()
    for _ in range(20):
        frame -= 1
        person.timed("frame back, arrow key", lambda: page.keyboard.press("ArrowLeft"), shown(frame))
    return {"frame back, arrow key": person.times.pop("frame back, arrow key")}


def main() -> int:
    """Render, serve, do, print."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the recording")
    parser.add_argument("--run", type=Path, help="a run rendered before by this script")
    options = parser.parse_args()
    import tomllib

    with tempfile.TemporaryDirectory() as name:
        made = options.run or rendered(Path(name), options.seconds)
        folder = Path(name) / "hall" / "tow"
        folder.mkdir(parents=True)
        for file in ("run.toml", "video.mp4"):
            shutil.copy(made / file, folder)
        content = tomllib.loads((folder / "run.toml").read_text())
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "towline", "app", str(folder), "--no-browser"], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        address = re.search(r"http://\S+", process.stdout.readline())
        assert address
        print(f"start to address: {time.perf_counter() - begin:.1f} s")
        try:
            with sync_playwright() as playwright:
                browser = started(playwright)
                page = browser.new_page(viewport={"width": 1366, "height": 768})
                page.set_default_timeout(WAIT_MS)
                page.add_init_script(NOTED)
                begin = time.perf_counter()
                page.goto(address.group(0))
                page.get_by_label("tow.speed_m_s", exact=True).wait_for()
                print(f"page to first field: {time.perf_counter() - begin:.1f} s")
                page.keyboard.press("3")
                page.wait_for_function(shown(0))
                page.keyboard.press("End")
                page.wait_for_function("Number(document.querySelector('.viewer').dataset.shown) > 0")
                page.wait_for_timeout(3000)
                last = person_last(page)
                person = Person(page)
                scrub(person, last)
                datum(person, content["datum"])
                marks(person)
                hand(person)
                track(person, last + 1)
                browser.close()
            loads = ", ".join(f"{load:.1f}" for load in os.getloadavg())
            print(f"{last + 1} frames of 1280 x 720; {os.cpu_count()} cores, load {loads}")
            print(f"{'interaction':44}{'median':>9}{'worst':>9}{'times':>7}")
            for what, times in person.times.items():
                print(f"{what:44}{statistics.median(times):6.0f} ms{max(times):6.0f} ms{len(times):7d}")
            print(f"peak memory of the page's process: {peak_mib(process.pid):.0f} MiB")
            for child in children_of(process.pid):
                print(f"peak memory of a process it started: {peak_mib(child):.0f} MiB")
        finally:
            process.terminate()
            process.wait(15)
    return 0


def person_last(page: Any) -> int:
    """Number of the last frame, once the recording is read."""
    page.keyboard.press("End")
    page.wait_for_timeout(500)
    return int(page.evaluate("document.querySelector('.viewer').dataset.shown"))


if __name__ == "__main__":
    raise SystemExit(main())
