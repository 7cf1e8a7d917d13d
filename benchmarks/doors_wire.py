"""What a stranger of the same machine, and a page gone wrong, can do to a started app over its port."""

from __future__ import annotations

import json
import os
import re
import resource
import secrets
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

SAMPLE = Path(__file__).resolve().parent.parent / "sample_videos" / "mariner" / "x1446"
USUAL_FILES = 1024
"""That a process may open, where nobody set anything."""
MOST_MIB = 100.0
"""That strangers may make the app take."""
NOBODY = 65534
TRACEBACK = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    attack, result : in words
    tries : how often
    held : nothing was reached
    """

    attack: str
    tries: int
    result: str
    held: bool


class App:
    """A started ``towline app``.

    Parameters
    ----------
    folder : that it is started with
    errors : file that takes its standard error
    files : that its process may open
    environment : of the process beside this one's
    arguments : of the command
    """

    def __init__(
        self,
        folder: Path,
        errors: Path,
        files: int = USUAL_FILES,
        environment: dict[str, str] | None = None,
        arguments: tuple[str, ...] = ("--no-browser",),
    ) -> None:
        ours = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")} | (environment or {})
        self._errors, self._stream = errors, errors.open("w")
        command = [sys.executable, "-m", "towline", "app", str(folder), *arguments]
        self.process = subprocess.Popen(
            ["/bin/sh", "-c", f'ulimit -S -n {files}; exec "$@"', "sh", *command],
            stdout=subprocess.PIPE,
            stderr=self._stream,
            text=True,
            env=ours,
        )
        assert self.process.stdout is not None
        said = self.process.stdout.readline() + self.process.stdout.readline()
        found = re.search(r"(http://127\.0\.0\.1:(\d+)/\?token=(\S+))\n.* file (\S+) opens", said)
        assert found, said + errors.read_text()
        self.link, self.port, self.token = found.group(1), int(found.group(2)), found.group(3)
        self.file = Path(found.group(4))
        self.place = self.cookie = ""

    def enter(self) -> None:
        """Be let in as the browser is, by the private file's form."""
        token = re.search(r'value="([^"]+)"', self.file.read_text())
        assert token
        body = f"token={token.group(1)}"
        answer = self.ask("/", "POST", f"Origin: null\r\nContent-Length: {len(body)}\r\n", body)
        cookie, place = re.search(r"set-cookie: ([^;]+)", answer), re.search(r"url=(/[\w-]+)/", answer)
        assert cookie, answer
        assert place, answer
        self.cookie, self.place = cookie.group(1), place.group(1)

    def ask(self, path: str, method: str = "GET", head: str = "", body: str = "", wait_s: float = 15.0) -> str:
        """The whole answer to one request, headers and all."""
        request = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nConnection: close\r\n{head}\r\n{body}"
        with socket.create_connection(("127.0.0.1", self.port), wait_s) as wire:
            wire.sendall(request.encode("latin-1"))
            return _all(wire).decode("latin-1")

    def page(self, path: str = "/", method: str = "GET", head: str = "", body: str = "") -> str:
        """The answer to the session's own browser."""
        origin = f"Cookie: {self.cookie}\r\nOrigin: http://127.0.0.1:{self.port}\r\n"
        return self.ask(self.place + path, method, origin + head, body)

    def status(self, answer: str) -> int:
        """Of an answer; 0 = there was none."""
        parts = answer.split(" ", 2)
        return int(parts[1]) if len(parts) > 1 and parts[1].isdigit() else 0

    def mib(self, peak: bool = False) -> float:
        """Resident memory, or its largest so far."""
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        found = re.search(rf"{'VmHWM' if peak else 'VmRSS'}:\s+(\d+) kB", text)
        return int(found.group(1)) / 1024 if found else float("nan")

    def sockets(self) -> int:
        """Open ones."""
        count = 0
        for entry in Path(f"/proc/{self.process.pid}/fd").iterdir():
            with suppress(OSError):
                count += os.readlink(entry).startswith("socket:")
        return count

    def said(self) -> str:
        """On standard error so far."""
        self._stream.flush()
        return self._errors.read_text()

    def __enter__(self) -> App:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def end(self) -> None:
        """As Ctrl+C does."""
        self.process.terminate()
        self.process.wait(20)
        self._stream.close()


def _all(wire: socket.socket) -> bytes:
    """Until the other side hangs up."""
    got = b""
    try:
        while part := wire.recv(1 << 16):
            got += part
    except (ConnectionResetError, TimeoutError):
        pass
    return got


def run_folder(folder: Path) -> Path:
    """The sample's run, without results and truth."""
    folder.mkdir(parents=True)
    for name in ("video.mp4", "run.toml"):
        shutil.copy(SAMPLE / name, folder)
    return folder


@contextmanager
def quiet(app: App) -> Iterator[Callable[[], float]]:
    """Gives the growth of the resident memory at its peak, MiB, from here on."""
    time.sleep(1.0)
    Path(f"/proc/{app.process.pid}/clear_refs").write_text("5")  # the peak begins anew
    before = app.mib()
    yield lambda: app.mib(peak=True) - before


# many and endless -----------------------------------------------------------------------------------------------------


def idle_connections(app: App, count: int, sent: bytes = b"", hold_s: float = 3.0) -> Row:
    """Open connections that say nothing (or only begin to), and see whether the session's own browser is served meanwhile."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(max(soft, count + 200), hard), hard))
    times: list[float] = []
    with quiet(app) as grown, ExitStack() as stack:
        for number in range(count):
            wire = stack.enter_context(socket.socket())
            wire.settimeout(10)
            wire.connect(("127.0.0.1", app.port))
            if sent:
                with suppress(OSError):
                    wire.sendall(sent)
            if number % (count // 10) == count // 10 - 1:
                times.append(_served(app))
        end = time.monotonic() + hold_s
        while time.monotonic() < end:
            times.append(_served(app))
            time.sleep(0.2)
        most, took = grown(), max(times)
        left = app.sockets()
    what = "begun requests" if sent else "idle connections"
    held = took < 5 and most < MOST_MIB and TRACEBACK not in app.said()
    words = f"own page served {len(times)} times in at most {1e3 * took:.0f} ms, {left} sockets open, {most:+.0f} MiB"
    return Row(f"{count:,} {what}", count, words, held)


FLOOD = """
import socket, sys, time
port, until, made, kept = int(sys.argv[1]), time.time() + float(sys.argv[2]), 0, []
while time.time() < until:
    try:
        kept.append(socket.create_connection(("127.0.0.1", port), 5))
        made += 1
    except OSError:
        pass
    if len(kept) > 300:
        kept.pop(0).close()
print(made)
"""


def flood(app: App, for_s: float = 5.0) -> Row:
    """Two processes that connect as fast as they can, while the session's own browser asks on new connections."""
    command = [sys.executable, "-c", FLOOD, str(app.port), str(for_s)]
    with quiet(app) as grown:
        floods = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
        times = []
        while any(process.poll() is None for process in floods):
            times.append(_served(app))
        made = sum(int(process.communicate()[0]) for process in floods)
        most = grown()
    held = max(times) < 5 and most < MOST_MIB and TRACEBACK not in app.said()
    words = f"own page served {len(times)} of {len(times)} times in at most {1e3 * max(times):.0f} ms, {most:+.0f} MiB"
    return Row("connections made as fast as can be", made, words, held)


def _served(app: App) -> float:
    """Seconds that the page took to come; infinite where it did not."""
    begin = time.perf_counter()
    try:
        good = app.status(app.page("/frame/1/0.jpg")) == 200
    except OSError:
        good = False
    return time.perf_counter() - begin if good else float("inf")


CHUNKED = b"POST / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nTransfer-Encoding: chunked\r\n\r\n"
ENDLESS = {
    "headers": (b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n", b"x-a: " + b"b" * 8000 + b"\r\n"),
    "one header": (b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nx-a: ", b"b" * 8192),
    "address": (b"GET /?token=", b"b" * 8192),
    "body": (b"POST / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Length: 99999999999\r\n\r\n", b"b" * 8192),
    "body in chunks": (CHUNKED, b"2000\r\n" + b"b" * 8192 + b"\r\n"),
    "trailers": (CHUNKED + b"0\r\n", b"x-a: " + b"b" * 8000 + b"\r\n"),
    "requests, answers unread": (b"", b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" * 50),
    "web socket's headers": (b"GET /_nicegui_ws/socket.io/ HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nConnection: Upgrade\r\n"
                             b"Upgrade: websocket\r\n", b"x-a: " + b"b" * 8000 + b"\r\n"),
    "bytes that are no HTTP": (b"", bytes(range(256)) * 32),
}  # fmt: skip


def endless(app: App, what: str, wires: int = 8, for_s: float = 3.0) -> Row:
    """Several connections that send without end (and connect again when hung up on)."""
    first, more = (part.replace(b"%d", str(app.port).encode()) for part in ENDLESS[what])
    sent, over = [0] * wires, time.monotonic() + for_s

    def send(number: int) -> None:
        while time.monotonic() < over:
            try:
                with socket.create_connection(("127.0.0.1", app.port), 5) as wire:
                    wire.sendall(first)
                    while time.monotonic() < over:
                        wire.sendall(more)
                        sent[number] += len(more)
            except OSError:
                pass

    threads = [threading.Thread(target=send, args=(number,)) for number in range(wires)]
    with quiet(app) as grown:
        for thread in threads:
            thread.start()
        times = []
        while time.monotonic() < over:
            times.append(_served(app))
            time.sleep(0.1)
        for thread in threads:
            thread.join()
        most = grown()
    times.append(_served(app))
    held = max(times) < 5 and most < MOST_MIB and TRACEBACK not in app.said()
    words = (
        f"{sum(sent) / 1e6:.0f} MB taken off the wire, own page in at most {1e3 * max(times):.0f} ms, {most:+.0f} MiB"
    )
    return Row(f"endless {what}, {wires} at a time", wires, words, held)


def slow_heads(app: App, count: int = 50, for_s: float = 13.0) -> Row:
    """A byte of a header every second: all are hung up on."""
    wires = []
    for _ in range(count):
        wire = socket.create_connection(("127.0.0.1", app.port), 5)
        wire.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{app.port}\r\nx: ".encode())
        wires.append(wire)
    began, ended = time.monotonic(), 0.0
    alive = list(wires)
    while alive and time.monotonic() - began < for_s:
        time.sleep(1.0)
        for wire in list(alive):
            try:
                wire.sendall(b"a")
            except OSError:
                alive.remove(wire)
                ended = time.monotonic() - began
    for wire in wires:
        wire.close()
    return Row("headers a byte a second", count, f"{count - len(alive)} hung up on within {ended:.0f} s", not alive)


# nonsense -------------------------------------------------------------------------------------------------------------

NUMBERS = (
    "1" * 21,
    "-1",
    "9" * 5000,
    "1e5",
    "0x10",
    "%00",
    "..%2f..",
    "NaN",
    "٣",
    " 1",
    "+1",
    "1_0",
    "18446744073709551616",
)


def absurd_addresses(app: App) -> Row:
    """Frame numbers and other parts of addresses that are none, asked by the session's own browser."""
    paths = [f"/frame/1/{n}.jpg" for n in NUMBERS] + [f"/frame/{n}/0.jpg" for n in NUMBERS]
    paths += [f"/top/1/{n}/0.jpg" for n in NUMBERS] + [f"/top/1/0/{n}.jpg" for n in NUMBERS]
    paths += [f"/{name}" for name in ("frame", "%ff%fe", "x" * 8000, "..", "//evil.example/", "?" + "a=b&" * 2000)]
    answers = [app.status(app.page(path.encode().decode("latin-1"))) for path in paths]
    worst = max(answers)
    counts = ", ".join(f"{answers.count(code)} times {code}" for code in sorted(set(answers)))
    held = worst < 500 and TRACEBACK not in app.said()
    return Row("frame numbers of 21 digits, absurd addresses", len(paths), counts, held)


UPGRADE = "Upgrade: websocket\r\nConnection: Upgrade\r\n"
VERSION = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
HANDSHAKES = (
    UPGRADE,
    f"{UPGRADE}Sec-WebSocket-Version: 99\r\nSec-WebSocket-Key: x\r\n",
    "Upgrade: h2c\r\nConnection: Upgrade\r\n",
    f"{UPGRADE}Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: \xff\xfe\r\n",
    f"{UPGRADE}{VERSION}Host: two\r\n",
    "Content-Length: 5\r\nContent-Length: 6\r\n",
    "Transfer-Encoding: chunked\r\nContent-Length: 6\r\n",
    "Cookie: \x00\r\n",
    "Cookie: \xff\xfe=\xff; ;;=;\r\n",
    "Origin: \xff\r\n",
)


NO_HTTP = (
    b"\r\n\r\n",
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
)


def absurd_requests(app: App) -> Row:
    """Handshakes and headers that are wrong, by a stranger and by the session's own browser."""
    own = f"Cookie: {app.cookie}\r\nOrigin: http://127.0.0.1:{app.port}\r\n"
    answers = []
    for path in ("/", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket", "/result/x/y"):
        for head in HANDSHAKES:
            answers.append(app.status(app.ask(path, head=head)))
            answers.append(app.status(app.ask(app.place + path, head=own + head)))
    for raw in NO_HTTP:
        with socket.create_connection(("127.0.0.1", app.port), 12) as wire:
            wire.sendall(raw)
            answers.append(app.status(_all(wire).decode("latin-1")))
    counts = ", ".join(f"{answers.count(code)} times {code or 'hung up'}" for code in sorted(set(answers)))
    held = max(answers) < 500 and TRACEBACK not in app.said() and _served(app) < 5
    return Row("wrong handshakes, headers and requests", len(answers), counts, held)


EVENTS: tuple[object, ...] = (
    ["event"], ["event", None], ["event", {}], ["event", {"client_id": 5}], ["event", {"client_id": "CLIENT"}],
    ["event", {"client_id": "CLIENT", "id": {}, "args": []}], ["event", {"client_id": "CLIENT", "id": 3, "args": ["{"]}],
    ["event", {"client_id": "CLIENT", "id": "9" * 500, "listener_id": "x", "args": ["1"]}],
    ["event", {"client_id": ["CLIENT"], "id": 1}], ["event", 1, 2, 3], ["ack", {"client_id": "CLIENT"}],
    ["ack", {"client_id": "CLIENT", "next_message_id": "x"}], ["log", {"client_id": "CLIENT", "level": "?", "message": 1}],
    ["handshake", {}], ["handshake", None], ["handshake", {"client_id": "CLIENT"}], ["handshake", "x" * 10000],
    ["javascript_response", {}], ["javascript_response", {"client_id": "CLIENT"}], ["no such event", 1], [], {}, 7, None,
    [["event"]], [{"a": 1}], ["disconnect"], ["connect"],
)  # fmt: skip
FRAMES = (
    "", "4", "42", "4" * 50, "45-", "451-[", "4999999999999-[]", "42[", '42["event",', "42" + "[" * 3000,
    "4a", "9", "x", "0", "1x", "2probe",
    "5", "6",
    "41", "40/other,", "40{}", '40{"a":', "43", '4399999999999999999999["x"]', "44", "46-", "b4AAAA", "\x00", "\ud7ff",
    '42/other,["event",{}]',
)  # fmt: skip
LISTENERS = (
    None,
    {},
    [],
    "",
    "9" * 400,
    "-" + "9" * 30,
    1e308,
    True,
    {"u": "x"},
    {"u": 1, "v": {}, "zoom": None, "frame": "1" * 21},
    [[[]]],
    "\x00",
)


def absurd_messages(app: App) -> Row:
    """Messages over the session's own socket: no JSON, parts missing, parts of another kind, to every listener of the page."""
    from websockets.sync.client import connect

    page = app.page("/").partition("\r\n\r\n")[2]
    client = re.search(r"'client_id': '([^']+)'", page)
    assert client, page[:2000]
    events = [json.dumps(event).replace("CLIENT", client.group(1)) for event in EVENTS]
    sends: list[str | bytes] = [*FRAMES, *(f"42{event}" for event in events), b"", b"\x04\xff", b"\x00" * 500]
    number = 0
    for found, listener in re.findall(r'"(\d+)":\{"tag"|"listener_id":"([^"]+)"', page):
        number = int(found) if found else number
        for value in LISTENERS if listener else ():
            told = {"client_id": client.group(1), "id": number, "listener_id": listener, "args": [json.dumps(value)]}
            sends.append("42" + json.dumps(["event", told]))
    url = f"ws://127.0.0.1:{app.port}{app.place}/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    url += f"&implicit_handshake=false&client_id={client.group(1)}"
    head = {"Cookie": app.cookie, "Origin": f"http://127.0.0.1:{app.port}"}
    done = 0
    while done < len(sends):
        with connect(url, additional_headers=head, origin=None, open_timeout=10) as wire:  # type: ignore[arg-type]
            wire.recv(5)
            wire.send("40{}")
            wire.recv(5)
            tab = {"client_id": client.group(1), "tab_id": "t", "document_id": "d", "next_message_id": 0}
            wire.send("42" + json.dumps(["handshake", tab]))
            try:
                while done < len(sends):
                    wire.send(sends[done])
                    done += 1
                    time.sleep(0.002)
            except Exception:  # hung up on: the next one on a new socket
                done += 1
    time.sleep(1.0)
    lines = [line for line in app.said().splitlines() if line.strip()]
    held = TRACEBACK not in app.said() and _served(app) < 5
    return Row("messages of the socket that are none", len(sends), f"dropped; {len(lines)} lines, no traceback", held)


# secrets --------------------------------------------------------------------------------------------------------------


def cookie_alone(app: App, cookie: str) -> Row:
    """With what another port of the machine is sent by the browser."""
    own = f"Cookie: {cookie}\r\nOrigin: http://127.0.0.1:{app.port}\r\n"
    paths = [
        "/",
        "//",
        "/frame/1/0.jpg",
        "/top/1/0/0.jpg",
        "/result/1/report.html",
        "/run.toml",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
    ]
    paths += [
        f"/{cookie.partition('=')[2]}/",
        f"/?token={cookie.partition('=')[2]}",
        f"/{secrets.token_urlsafe(32)}/",
        f"/?token={app.token}x",
    ]
    answers = [app.status(app.ask(path, head=own)) for path in paths]
    socket_head = own + UPGRADE + VERSION
    answers.append(app.status(app.ask("/_nicegui_ws/socket.io/?EIO=4&transport=websocket", head=socket_head)))
    held = all(answer in (403, 404) for answer in answers)
    return Row(
        "the page's cookie on another port, then used",
        len(answers),
        f"{len(answers)} refused" if held else f"{answers}",
        held,
    )


def listed_processes(folder: Path, errors: Path) -> Row:
    """What a user who lists processes learns while the app opens a browser; tried as another user where that can be."""
    seen: set[str] = set()
    browser = folder.parent / "browser.sh"
    browser.write_text(f'#!/bin/sh\necho "$@" > {folder.parent}/opened\nexec sleep 5\n')
    browser.chmod(0o755)
    stop = threading.Event()

    def look() -> None:
        while not stop.is_set():
            for entry in Path("/proc").iterdir():
                if entry.name.isdigit():
                    with suppress(OSError):
                        seen.add((entry / "cmdline").read_text().replace("\0", " "))
            time.sleep(0.02)

    looker = threading.Thread(target=look)
    looker.start()
    with App(folder, errors, environment={"BROWSER": f"{browser} %s"}, arguments=()) as app:
        end = time.monotonic() + 10
        while not (folder.parent / "opened").exists() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(0.2)
        stop.set()
        looker.join()
        opened = (folder.parent / "opened").read_text().strip()
        in_file = re.findall(r'value="([^"]+)"', app.file.read_text())
        listed = any(secret in line for line in seen for secret in (app.token, *in_file))
        closed = (
            stat.S_IMODE(app.file.stat().st_mode) == 0o600 and stat.S_IMODE(app.file.parent.stat().st_mode) == 0o700
        )
        as_another = ""
        if os.geteuid() == 0:
            other = subprocess.run(
                ["cat", str(app.file)], user=NOBODY, group=NOBODY, extra_groups=[], capture_output=True, check=False
            )
            closed &= other.returncode != 0 and not other.stdout
            as_another = ", another user may not read it"
        app.enter()
        used = app.status(app.ask(f"/?token={in_file[0]}"))
        held = not listed and closed and opened.startswith("file://") and used == 403
    gone = not app.file.parent.exists()
    words = (
        f"{len(seen)} command lines seen: a file's path, no token{as_another}; a used token: {used}; gone at the end"
    )
    return Row("another user lists processes", len(seen), words, held and gone)


# saving ---------------------------------------------------------------------------------------------------------------

SAVES = """
import sys
from pathlib import Path
from towline.app.document import Document
document = Document.open(Path(sys.argv[1]))
print("ready", flush=True)
for k in range(100000):
    document.set(("tow", "speed_m_s"), 1.0 + (k % 100) / 1000)
    document.save()
"""


def killed_saves(kills: int) -> Row:
    """kill -9 at any moment of saving without end; the file is whole, its permissions stand, what is left goes."""
    import random
    import tomllib

    with tempfile.TemporaryDirectory() as place:
        folder = run_folder(Path(place) / "run")
        path = folder / "run.toml"
        path.chmod(0o600)
        target = folder / "kept.toml"
        path.rename(target)
        path.symlink_to("kept.toml")
        whole = left = 0
        draw = random.Random(1)
        for _ in range(kills):
            process = subprocess.Popen([sys.executable, "-c", SAVES, str(folder)], stdout=subprocess.PIPE)
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(draw.uniform(0.0, 0.05))
            process.send_signal(signal.SIGKILL)
            process.wait()
            speed = tomllib.loads(target.read_text())["tow"]["speed_m_s"]
            whole += 0.9 < speed < 1.5 and path.is_symlink() and stat.S_IMODE(target.stat().st_mode) == 0o600
        found = list(folder.glob(".kept-*.tmp.toml"))
        left = len(found)
        for old in found:
            os.utime(old, (time.time() - 3600,) * 2)
        from towline.app.document import Document

        Document.open(folder)
        after = len(list(folder.glob(".kept-*.tmp.toml")))
    words = f"whole, 0600 and still a link {whole} times; {left} temporary files, {after} after the next opening"
    return Row("kill -9 while run.toml is saved", kills, words, whole == kills and not after)
