"""The web page served on this machine only: start address, routes of pictures and reports, and the end of it all."""

from __future__ import annotations

import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..live.picture import PICTURE
from ..record.errors import InputError, TowlineError
from ..record.files import read_bytes
from .address import HOST, WaysIn
from .guard import Guard
from .messages import heed_only_whole_messages, one_line_each
from .places import page_file
from .session import Session
from .wire import MOST_HEAD, Strangers, most_strangers, protocol

MOST_FRAMES = 10**8
"""Numbers beyond it are no frame's: a month of film at 30 frames/s."""
MOST_PICTURE_BYTES = 1 << 20
"""Of a small picture of a tow that is filmed."""
BACKLOG = 64
"""Connections that are taken at once; they are looked at before the next ones."""
EXIT_TERMINATED = 143
"""A shell's code for an end by SIGTERM: 128 + 15."""
TRIES, TRY_S = 400, 0.05
"""The page's address is told when it answers: asked so often, at such intervals, for 20 s."""
WARM = (
    "geometry",
    "vision.datum_find",
    "vision.spots.search",
    "report.topview",
    "report.scale_grid",
    "pipeline.stages",
)
"""Rooms imported while the person looks at the first page."""


def serve(
    start: Path, open_run: bool, port: int, say: Callable[[str, Path], None], browser: bool, debug: bool = False
) -> None:
    """Serve the page until Ctrl+C.

    Parameters
    ----------
    start : folder to begin in
    open_run : open it as a run at once
    port : 0 = any free one
    say : told the address that is good once and the private file that opens the page each time, once it answers
    browser : open it in the browser
    debug : faults of the program's own with their traceback

    Raises
    ------
    TowlineError : NiceGUI is absent, the run cannot be opened, or the port is taken
    """
    try:
        import nicegui  # noqa: F401
    except ModuleNotFoundError:
        raise TowlineError(
            "the page needs the package nicegui, which is not there: pip install 'towline[app]'"
        ) from None
    # ended from outside as by Ctrl+C: the process of the jobs ends with this one
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(EXIT_TERMINATED))
    session = Session(start)
    if open_run:
        session.open(start)
    port = _free_port(port)
    ways = WaysIn(port)
    try:
        _run(session, port, ways, lambda: _started(port, ways, say, browser), debug)
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        ways.close()
        session.worker.close()
        session.filming.close()
        session.close()


def _free_port(port: int) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise TowlineError(
                f"port {port} on {HOST} cannot be used ({error.strerror}); give another --port"
            ) from None
        return int(probe.getsockname()[1])


def _started(port: int, ways: WaysIn, say: Callable[[str, Path], None], browser: bool) -> None:
    """Say the ways in once somebody answers there."""
    for _ in range(TRIES):
        try:
            socket.create_connection((HOST, port), TRY_S).close()
            break
        except OSError:
            time.sleep(TRY_S)
    say(ways.link, ways.file)
    if browser:
        import webbrowser

        # the file, not the address: other users of the machine read the arguments of a browser's process
        webbrowser.open(ways.file.as_uri())


def _run(session: Session, port: int, ways: WaysIn, started: Callable[[], None], debug: bool) -> None:
    from nicegui import app, core, ui

    from .page_datum import DatumStep
    from .page_facts import FactsStep
    from .page_hand import HandStep
    from .page_live import LiveStep
    from .page_marks import MarksStep
    from .page_results import ResultsStep
    from .page_run import RunStep
    from .page_track import TrackStep
    from .page_window import Window

    add_routes(app, session)

    def root() -> None:
        Window(session, [RunStep, FactsStep, DatumStep, MarksStep, HandStep, TrackStep, ResultsStep, LiveStep]).build()

    def begin() -> None:
        threading.Thread(target=started, daemon=True).start()
        threading.Thread(target=_warm, args=(session,), daemon=True).start()

    strangers = Strangers(most_strangers())
    app.on_startup(begin)
    app.on_startup(lambda: one_line_each(debug))
    app.add_middleware(Guard, taken=ways.taken, port=port, known=strangers.known)
    heed_only_whole_messages(core.sio)
    ui.run(
        root,
        host=HOST,
        port=port,
        title="towline",
        dark=False,
        reload=False,
        show=False,
        show_welcome_message=False,
        tailwind=False,
        gzip_middleware_factory=None,
        reconnect_timeout=20.0,
        uvicorn_logging_level="error",
        http=protocol(strangers),
        h11_max_incomplete_event_size=MOST_HEAD,
        loop="asyncio",
        backlog=min(BACKLOG, strangers.most),
        ws_max_size=1 << 20,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=2,
    )


def _warm(session: Session) -> None:
    from importlib import import_module

    for name in WARM:
        import_module(f"..{name}", __package__)
    import numpy as np

    from ..vision.recording import Frame
    from ..vision.spots.candidates import find_candidates
    from .snap import snapped

    # what is imported at a first call
    dot = np.full((80, 80), 60, dtype=np.uint8)
    dot[38:43, 38:43] = 200
    snapped(Frame(0, 0.0, dot, None), (40.0, 40.0), lossy=True)
    find_candidates(dot)
    session.worker.warm()


def add_routes(app: Any, session: Session) -> None:
    """Pictures of the open run, and reports that were made or asked for; nothing else of the disk is served.

    Parameters
    ----------
    app : of the server
    session : what the page works on
    """
    from fastapi import Response
    from fastapi.responses import FileResponse, PlainTextResponse

    @app.get("/frame/{opened}/{index}.jpg")
    def frame(opened: int, index: int) -> Response:
        frames = session.frames
        if frames is None or opened != session.opened or not 0 <= index < MOST_FRAMES:
            return PlainTextResponse("no such frame", 404)
        try:
            data, sure = frames.jpeg(index)
        except (TowlineError, ValueError) as error:
            return PlainTextResponse(str(error), 404)
        if not sure:
            session.unsure = index
        return Response(
            data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=600" if sure else "no-store"}
        )

    @app.get("/top/{opened}/{version}/{index}.jpg")
    def top(opened: int, version: int, index: int) -> Response:
        import cv2

        frames = session.frames
        if frames is None or opened != session.opened or session.document is None or not 0 <= index < MOST_FRAMES:
            return PlainTextResponse("no such frame", 404)
        try:
            seen = session.from_above(index)
        except TowlineError as error:
            return PlainTextResponse(str(error), 404)
        if seen is None:
            return Response(status_code=204)
        data = cv2.imencode(".jpg", seen, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get("/live/{place}/{version}.jpg")
    def live(place: int, version: int) -> Response:
        tail = None if session.live is None else session.live.tail
        cameras = (session.document.cameras if session.document is not None else ()) or ("",)
        try:
            folder = None if tail is None or not 0 <= place < len(cameras) else tail.folder / "out" / cameras[place]
            data = b"" if folder is None else read_bytes(folder / PICTURE, MOST_PICTURE_BYTES)
        except (TowlineError, OSError):
            data = b""
        if not data:
            return PlainTextResponse("no picture", 404)
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get("/result/{key}/{name:path}")
    def result(key: str, name: str) -> Response:
        page = session.pages.get(key)
        if page is None:
            return PlainTextResponse("no such report", 404)
        try:
            path = page_file(page, name)
        except InputError as error:
            return PlainTextResponse(str(error), 404)
        kind = "text/html" if name == page.name else "text/plain"
        return FileResponse(path, media_type=f"{kind}; charset=utf-8", headers={"Cache-Control": "no-store"})


__all__ = ["serve"]
