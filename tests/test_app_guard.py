"""Who may talk to the page, and what of a result it shows."""

from __future__ import annotations

import ast
import asyncio
import os
import re
import socket
import stat
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from towline.app.address import WaysIn
from towline.app.guard import MOST_BODY, Guard
from towline.app.places import page_file
from towline.record import InputError

# who may talk to it ---------------------------------------------------------------------------------------------------

HERE = "127.0.0.1:8123"


async def _served(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    taken = 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        taken += len(message.get("body", b""))
        if not message.get("more_body"):
            break
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": str(taken).encode()})


class Asks:
    """A guard and one who asks it."""

    def __init__(self) -> None:
        self.tokens = ["right"]
        self.guard = Guard(_served, self.taken, 8123)
        self.place = ""

    def taken(self, token: str) -> bool:
        """As ``WaysIn``: each token lets in once."""
        if token in self.tokens:
            self.tokens.remove(token)
            return True
        return False

    def page(self, path: str = "/", kind: str = "GET", body: list[bytes] | None = None, **head: str) -> Any:
        """Ask below the page's own place."""
        return self(self.place + path, kind, body, **head)

    def __call__(
        self, path: str = "/", kind: str = "GET", body: list[bytes] | None = None, **head: str
    ) -> tuple[int, dict[str, str]]:
        """Status (101: a web socket was accepted) and headers."""
        path, _, query = path.partition("?")
        names = {"host": HERE} | {name.replace("_", "-"): value for name, value in head.items()}
        scope = {
            "type": "websocket" if kind == "WS" else "http",
            "method": kind,
            "path": path,
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in names.items() if value],
        }
        parts, sent = [*(body or [b""])], []

        async def receive() -> Any:
            if not parts:
                return {"type": "http.disconnect"}
            return {"type": "http.request", "body": parts.pop(0), "more_body": bool(parts)}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self.guard(scope, receive, send))
        if not sent:
            return 0, {}
        if sent[0]["type"] == "websocket.accept":
            return 101, {}
        if sent[0]["type"] == "websocket.close":
            return 403, {}
        found = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
        on = re.search(r"url=(/[\w-]+)/", sent[1].get("body", b"").decode())
        return sent[0]["status"], found | ({"goes on to": on.group(1)} if on else {})

    def cookie(self) -> str:
        status, head = self("/?token=right")
        assert status == 200
        self.place = head["goes on to"]
        assert re.fullmatch(r"/[\w-]{43}", self.place)
        assert "HttpOnly" in head["set-cookie"]
        assert "SameSite=Strict" in head["set-cookie"]
        return head["set-cookie"].partition(";")[0]


def test_only_the_session_is_answered() -> None:
    asks = Asks()
    cookie, origin = asks.cookie(), f"http://{HERE}"
    assert asks.page("/", cookie=cookie)[0] == 200
    assert asks.page("/frame/1/2.jpg", cookie=f"other=1; {cookie}")[0] == 200
    assert asks.page("/", cookie=f"towline_8123=set by another port; {cookie}")[0] == 200
    assert asks.page("/", kind="WS", cookie=cookie, origin=origin)[0] == 101
    assert asks.page("/x", kind="POST", cookie=cookie, origin=origin)[0] == 200
    for path, kind, head in [  # with the cookie alone, as another port gets it
        ("/", "GET", {"cookie": cookie}),
        ("/frame/1/2.jpg", "GET", {"cookie": cookie}),
        ("/_nicegui_ws/socket.io/", "WS", {"cookie": cookie, "origin": origin}),
        ("/?token=right", "GET", {"cookie": cookie}),  # it was used
        (f"/{'x' * 43}/", "GET", {"cookie": cookie}),
        (asks.place[:-1] + "/", "GET", {"cookie": cookie}),
        ("//", "GET", {"cookie": cookie}),
    ]:
        assert asks(path, kind, **head)[0] == 403, (path, kind, head)
    for path, kind, head in [
        ("/", "GET", {}),
        ("/", "GET", {"cookie": "towline_8123=guess"}),
        ("/", "GET", {"cookie": "towline_8123=right"}),  # the token is no cookie
        ("/?token=wrong", "GET", {}),
        ("/frame/1/2.jpg?token=right", "GET", {}),
        ("/", "WS", {"origin": origin}),
        ("/", "WS", {"cookie": cookie}),
        ("/", "WS", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "WS", {"cookie": cookie, "origin": "http://127.0.0.1:8124"}),
        ("/", "WS", {"cookie": cookie, "origin": "null"}),
        ("/x", "POST", {"cookie": cookie}),
        ("/x", "POST", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "GET", {"cookie": cookie, "origin": "http://evil.example"}),
        ("/", "GET", {"cookie": cookie, "host": "evil.example:8123"}),
        ("/?token=right", "GET", {"host": "evil.example"}),
        ("/?token=right", "POST", {"origin": origin}),
        ("/result/key/page.html", "GET", {}),
    ]:
        assert asks.page(path, kind, **head)[0] == 403, (path, kind, head)
    other = Asks()
    other.cookie()
    assert other.page("/", cookie=cookie)[0] == 403  # another session's


def test_requests_are_bounded_and_pages_stay_at_home() -> None:
    asks = Asks()
    mine = {"cookie": asks.cookie(), "origin": f"http://{HERE}"}
    assert asks.page("/x", "POST", content_length=str(MOST_BODY + 1), **mine)[0] == 413
    assert asks.page("/x", "POST", content_length="-5", **mine)[0] == 413
    half = b"x" * (MOST_BODY // 2 + 1)
    assert asks.page("/x", "POST", body=[half], **mine)[0] == 200
    assert asks.page("/x", "POST", body=[half, half], **mine)[0] == 0  # cut off
    head = asks.page("/", **mine)[1]
    policy = head["content-security-policy"]
    assert "default-src 'self'" in policy
    assert not re.search(r"https?://(?!127\.0\.0\.1:8123|localhost:8123)", policy)
    assert head["x-content-type-options"] == "nosniff"


def test_a_token_may_come_by_a_form_of_the_private_file() -> None:
    asks = Asks()
    assert asks("/", "POST", body=[b"token=wrong"], origin="null")[0] == 403
    assert asks("/", "POST", body=[b"token=right", b"x" * MOST_BODY], origin="null")[0] == 403
    assert asks("/", "POST", body=[b"token=right"], content_length=str(MOST_BODY), origin="null")[0] == 403
    assert asks("/", "POST", body=[b"&" * 2000 + b"token=right"], origin="null")[0] == 403
    status, head = asks("/", "POST", body=[b"token=", b"right"], origin="null")
    assert status == 200
    assert "SameSite=Strict" in head["set-cookie"]
    assert asks("/", "POST", body=[b"token=right"], origin="null")[0] == 403  # once


def test_the_private_file_opens_the_page_each_time() -> None:
    ways = WaysIn(8123)
    try:
        if os.name == "posix":
            assert stat.S_IMODE(ways.file.stat().st_mode) == 0o600
            assert stat.S_IMODE(ways.file.parent.stat().st_mode) == 0o700
        tokens = []
        for _ in range(3):
            page = ways.file.read_text()
            assert 'action="http://127.0.0.1:8123/"' in page
            tokens += re.findall(r'value="([\w-]{43})"', page)
            assert not ways.taken("")
            assert ways.taken(tokens[-1])
            assert not ways.taken(tokens[-1])
        assert len(set(tokens)) == 3
        printed = ways.link.partition("token=")[2]
        assert printed not in tokens
        assert ways.taken(printed)
        assert not ways.taken(printed)
    finally:
        ways.close()
    assert not ways.file.parent.exists()


def test_results_stand_alone() -> None:
    """Their address is all that they need; they may nothing, and the page's secrets are in nothing that they see."""
    asks = Asks()
    asks.cookie()
    status, head = asks("/result/key/report.html")
    assert status == 200
    policy = head["content-security-policy"].split("; ")
    assert "sandbox" in policy  # no script, no origin, no form, no window of its own
    assert {"default-src 'none'", "connect-src 'none'", "form-action 'none'", "base-uri 'none'"} <= set(policy)
    assert not any("script" in rule for rule in policy)
    assert "set-cookie" not in head
    assert asks("/result/key/report.html", "POST", origin=f"http://{HERE}")[0] == 405
    assert asks("/result/key/report.html", host="evil.example")[0] == 403
    assert asks("/result/key/report.html", kind="WS", origin=f"http://{HERE}")[0] == 403


def test_only_known_parts_of_a_result_are_shown(tmp_path: Path) -> None:
    out = tmp_path / "run" / "out"
    (out / "report_figures").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("no")
    for name in ("report.html", "report_figures/motion.csv", "motion.csv", "other.html"):
        (out / name).write_text("yes")
    page = out / "report.html"
    assert page_file(page, "report.html").read_text() == "yes"
    assert page_file(page, "report_figures/motion.csv").read_text() == "yes"
    names = [
        "other.html",
        "motion.csv",
        "../run.toml",
        "../out/x.csv",
        "/etc/passwd",
        "a/b/c.csv",
        "x\0/y.csv",
        "",
        ".",
        "a\\b/c.csv",
    ]
    try:
        (out / "notes.html").symlink_to(tmp_path / "secret.csv")
        (out / "report_figures" / "link.csv").symlink_to(tmp_path / "secret.csv")
        (out / "door").symlink_to(tmp_path)
        names += ["report_figures/link.csv", "door/secret.csv"]
        with pytest.raises(InputError, match="leads out"):
            page_file(out / "notes.html", "notes.html")
        (tmp_path / "run2").mkdir()
        (tmp_path / "run2" / "out").symlink_to(out)
        with pytest.raises(InputError, match="leads out"):
            page_file(tmp_path / "run2" / "out" / "report.html", "report.html")
    except OSError:
        pass  # links cannot be made here
    for name in names:
        with pytest.raises(InputError):
            page_file(page, name)


def test_the_served_page_refuses_strangers(run_folder: Path) -> None:
    pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
    process = subprocess.Popen(
        [sys.executable, "-m", "towline", "app", str(run_folder), "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
        env={k: v for k, v in os.environ.items() if not k.startswith("PYTEST")},
    )
    try:
        assert process.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", process.stdout.readline())
        assert address
        port = int(address.group(1))
        base = f"http://127.0.0.1:{port}"

        def status(path: str, **head: str) -> int:
            request = urllib.request.Request(base + path, headers={k.replace("_", "-"): v for k, v in head.items()})
            try:
                return urllib.request.build_opener(_Stay()).open(request, timeout=10).status
            except urllib.error.HTTPError as error:
                return error.code

        assert status("/") == 403
        assert status("/frame/1/0.jpg") == 403
        assert status("/_nicegui_ws/socket.io/?EIO=4&transport=polling") == 403
        door = urllib.request.urlopen(f"{base}/?token={address.group(2)}", timeout=10)
        cookie = door.headers["set-cookie"].partition(";")[0]
        place = re.search(r"url=(/[\w-]+)/", door.read().decode()).group(1)  # pyright: ignore
        assert status(f"/?token={address.group(2)}") == 403  # good once
        assert status(f"{place}/", Cookie=cookie) == 200
        assert status(f"{place}/frame/1/0.jpg", Cookie=cookie) == 200
        assert status(f"{place}/frame/1/0.jpg", Cookie=cookie, Origin="http://evil.example") == 403
        for path in ("/", "/frame/1/0.jpg", f"{place[:-1]}/"):
            assert status(path, Cookie=cookie) == 403, path
        assert status("/result/1/report.html") == 404
        for number in ("-3", "1" * 21, "9" * 5000):
            assert 400 <= status(f"{place}/frame/1/{number}.jpg", Cookie=cookie) < 500, number
            assert 400 <= status(f"{place}/top/1/0/{number}.jpg", Cookie=cookie) < 500, number
        assert status(f"{place}/frame/7/0.jpg", Cookie=cookie) == 404
        for path in (
            "/result/../run.toml",
            f"{place}/frame/1/..%2f..%2frun.toml",
            f"{place}/run.toml",
            f"{place}/_nicegui/3/static/../../run.toml",
        ):
            request = urllib.request.Request(base + path, headers={"Cookie": cookie})
            try:
                answer = urllib.request.urlopen(request, timeout=10).read()
            except urllib.error.HTTPError as error:
                answer = error.read()
            assert b"cx_px = 399.5" not in answer, path
        for origin, wanted in ((base, b"101"), ("http://evil.example", b"403"), ("", b"403")):
            assert wanted in _upgrade(port, cookie, origin, place), origin
        assert b"403" in _upgrade(port, "", base, place)
        assert b"403" in _upgrade(port, cookie, base, "")
        with socket.socket() as outside:  # on this machine's other addresses nobody listens
            outside.settimeout(2)
            with pytest.raises(OSError):
                outside.connect(("127.0.0.2", port))
    finally:
        process.terminate()
        process.wait(15)


class _Stay(urllib.request.HTTPRedirectHandler):
    """Redirections are not followed."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _upgrade(port: int, cookie: str, origin: str, place: str) -> bytes:
    """First line that answers the wish for a web socket."""
    lines = [
        f"GET {place}/_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1",
        f"Host: 127.0.0.1:{port}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    ]
    lines += [f"Cookie: {cookie}"] if cookie else []
    lines += [f"Origin: {origin}"] if origin else []
    with socket.create_connection(("127.0.0.1", port), 10) as wire:
        wire.sendall("\r\n".join([*lines, "", ""]).encode())
        return wire.recv(200).partition(b"\r\n")[0]


def test_only_pages_stand_on_nicegui(root: Path) -> None:
    for path in (root / "app").glob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            heavy = {n.split(".")[0] for n in names} & {"nicegui", "cv2", "av", "matplotlib", "fastapi", "starlette"}
            assert not heavy or (heavy == {"nicegui"} and path.name.startswith("page_")), path.name


@pytest.mark.slow
def test_without_nicegui_the_command_says_so(run_folder: Path) -> None:
    code = (
        "import sys; sys.modules['nicegui'] = None\n"
        "from towline.cli import main\n"
        f"sys.exit(main(['app', {str(run_folder)!r}, '--no-browser']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "pip install 'towline[app]'" in done.stderr
    assert "Traceback" not in done.stderr
