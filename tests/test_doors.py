"""The doors of the started app: strangers on its port, a hostile run folder in a real browser, two windows.

The attacks are those of ``benchmarks/doors.py``.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from towline.app.messages import OneLine
from towline.app.wire import MOST_HEAD, Strangers
from towline.app.worker import Worker

pytest.importorskip("nicegui", reason="nicegui is not installed (the extra app)")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and sockets are counted in /proc")


@pytest.fixture(scope="module")
def hall(doors_wire: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A started app whose run is open, and which the session's own browser has entered."""
    place = tmp_path_factory.mktemp("doors")
    app = doors_wire.App(doors_wire.run_folder(place / "hall" / "x1446"), place / "errors.txt")
    app.enter()
    yield app
    ended = app.process.poll()
    app.end()
    assert ended is None, f"the page's process ended by itself: {ended}"
    assert doors_wire.TRACEBACK not in (place / "errors.txt").read_text()


def held(row: Any) -> None:
    assert row.held, f"{row.attack}: {row.result}"


# many and endless -----------------------------------------------------------------------------------------------------


@linux
@pytest.mark.slow
@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: "])
def test_idle_connections_shut_nobody_out(doors_wire: ModuleType, hall: Any, sent: bytes) -> None:
    """More than the process may open files for."""
    held(doors_wire.idle_connections(hall, 2000, sent, hold_s=1.0))


@linux
@pytest.mark.slow
def test_strangers_are_hung_up_on_in_time(doors_wire: ModuleType, hall: Any) -> None:
    held(doors_wire.slow_heads(hall, 20))


ENDLESS = (
    "headers",
    "one header",
    "address",
    "body",
    "body in chunks",
    "trailers",
    "requests, answers unread",
    "web socket's headers",
    "bytes that are no HTTP",
)


@linux
@pytest.mark.slow
@pytest.mark.parametrize("what", ENDLESS)
def test_what_never_ends_takes_no_memory(doors_wire: ModuleType, hall: Any, what: str) -> None:
    assert tuple(doors_wire.ENDLESS) == ENDLESS
    held(doors_wire.endless(hall, what, wires=4, for_s=1.5))


@pytest.mark.slow
@linux
def test_a_long_head_is_refused(hall: Any) -> None:
    fits = hall.ask(f"/?token={'x' * (MOST_HEAD // 2)}")
    assert hall.status(fits) == 403
    assert hall.status(hall.ask("/", head=f"x: {'y' * 40 * MOST_HEAD}\r\n")) in (0, 400)  # 0: hung up while it was sent
    assert hall.status(hall.page("/")) == 200


class Wire:
    """A transport that keeps whether it was hung up on."""

    gone = False

    def abort(self) -> None:
        self.gone = True


class Clock:
    """A loop that keeps what is to be called later."""

    def __init__(self) -> None:
        self.calls: list[Any] = []

    def call_later(self, after_s: float, call: Callable[..., None], *arguments: Any) -> Any:
        entry = [lambda: call(*arguments), True]
        self.calls.append(entry)

        class Handle:
            def cancel(self) -> None:
                entry[1] = False

        return Handle()

    def pass_by(self) -> None:
        for call, wanted in self.calls:
            if wanted:
                call()


def test_of_too_many_strangers_the_oldest_goes_and_who_is_known_stays() -> None:
    strangers, clock = Strangers(most=3), Clock()
    wires = [Wire() for _ in range(6)]
    for number, wire in enumerate(wires):
        strangers.came(("127.0.0.1", number), wire, clock)  # type: ignore[arg-type]
        if number == 0:
            strangers.known(("127.0.0.1", 0))
    assert [wire.gone for wire in wires] == [False, True, True, False, False, False]
    assert len(strangers) == 3
    strangers.known(("127.0.0.1", 5))
    clock.pass_by()
    assert [wire.gone for wire in wires] == [False, True, True, True, True, False]
    assert len(strangers) == 0


# nonsense -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@linux
def test_absurd_numbers_and_addresses_are_refused(doors_wire: ModuleType, hall: Any) -> None:
    held(doors_wire.absurd_addresses(hall))


@linux
@pytest.mark.slow
def test_wrong_handshakes_and_headers_are_refused(doors_wire: ModuleType, hall: Any) -> None:
    held(doors_wire.absurd_requests(hall))


@linux
@pytest.mark.slow
def test_messages_that_are_none_are_a_line_each(doors_wire: ModuleType, hall: Any) -> None:
    held(doors_wire.absurd_messages(hall))
    said = hall.said().splitlines()
    assert said
    assert all(line.startswith("towline app: ") for line in said)
    assert any(
        "a message 'event' that is none of the page's was dropped (KeyError: 'client_id')" in line for line in said
    )


def test_a_fault_is_one_line_and_a_traceback_only_where_it_is_asked_for() -> None:
    try:
        {}["client_id"]
    except KeyError:
        record = logging.LogRecord("nicegui", logging.ERROR, "x.py", 1, "no\nsuch %s", ("page",), sys.exc_info())
    line = OneLine(debug=False).format(record)
    assert "\n" not in line
    assert "KeyError: 'client_id', in test_a_fault" in line
    assert "Traceback" in OneLine(debug=True).format(record)


# secrets --------------------------------------------------------------------------------------------------------------


@linux
@pytest.mark.slow
def test_who_lists_processes_learns_nothing(doors_wire: ModuleType, tmp_path: Path) -> None:
    folder = doors_wire.run_folder(tmp_path / "hall" / "x1446")
    held(doors_wire.listed_processes(folder, tmp_path / "errors.txt"))


# in a browser ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def context(doors_browser: ModuleType) -> Iterator[Any]:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra test)")
    with doors_browser.chromium() as made:
        yield made


@linux
@pytest.mark.slow
def test_a_hostile_report_reaches_nothing(doors_browser: ModuleType, hall: Any, context: Any, tmp_path: Path) -> None:
    """In the frame and in a tab of its own; and the links in out/ that lead out of the run folder."""
    folder = tmp_path / "hostile" / "x1446"
    doors_browser.run_folder(folder)
    with doors_browser.App(folder, tmp_path / "errors.txt") as app:
        for row in doors_browser.hostile_report(app, context, folder):
            held(row)


@linux
@pytest.mark.slow
def test_the_cookie_is_worthless_to_another_port(
    doors_wire: ModuleType, doors_browser: ModuleType, hall: Any, context: Any
) -> None:
    cookie = doors_browser.other_port(hall, context)
    assert cookie, "the browser hands it to every port of the machine: if not, this test shows nothing"
    held(doors_wire.cookie_alone(hall, cookie))


@linux
@pytest.mark.slow
def test_text_typed_in_one_window_is_not_lost_when_another_saves(
    doors_wire: ModuleType, doors_browser: ModuleType, context: Any, tmp_path: Path
) -> None:
    folder = doors_wire.run_folder(tmp_path / "two" / "x1446")
    with doors_wire.App(folder, tmp_path / "errors.txt") as app:
        for row in doors_browser.two_windows(app, context, folder):
            held(row)
    assert doors_wire.TRACEBACK not in (tmp_path / "errors.txt").read_text()


# jobs -----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_diagnose_button_says_what_it_found_or_why_not(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    """Also over one run alone."""
    worker = Worker()
    try:
        assert worker.start("diagnose", [motion_run(tmp_path / "one")])
        end = time.monotonic() + 200
        while (status := worker.poll()).running:
            assert time.monotonic() < end
            time.sleep(0.1)
    finally:
        worker.close()
    assert "fault of the program" not in status.error
    assert status.found is not None or status.error
