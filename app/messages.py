"""Messages that are none of the page's, and the faults they make: dropped, one line each."""

from __future__ import annotations

import functools
import inspect
import logging
import sys
from typing import Any

LOGGERS = ("nicegui", "uvicorn", "uvicorn.error", "uvicorn.asgi", "asyncio", "engineio.server", "socketio.server")
"""Of the machinery below the page."""
SAID = logging.getLogger("towline.app")


class OneLine(logging.Formatter):
    """What happened, and where, in one line; the traceback only where it is asked for.

    Parameters
    ----------
    debug : with the traceback
    """

    def __init__(self, debug: bool) -> None:
        super().__init__()
        self._debug = debug

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        if self._debug:
            return super().format(record)
        words = " ".join(record.getMessage().split())
        error = record.exc_info[1] if record.exc_info else None
        if error is None:
            return f"towline app: {words}"
        return (
            f"towline app: {type(error).__name__}: {' '.join(str(error).split())}{_place(error)} (--debug shows more)"
        )


def _place(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ""
    code = trace.tb_frame.f_code
    return f", in {code.co_name}, line {trace.tb_lineno} of {code.co_filename.replace(chr(92), '/').rpartition('/')[2]}"


def one_line_each(debug: bool) -> None:
    """Have the machinery say what goes wrong in one line each, on standard error.

    Parameters
    ----------
    debug : with tracebacks
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine(debug))
    for name in (*LOGGERS, SAID.name):
        logger = logging.getLogger(name)
        logger.handlers[:] = [handler]
        logger.propagate = False


def heed_only_whole_messages(sio: Any) -> None:
    """Wrap what takes messages from the socket: one that lacks a part, or has one of another kind, is dropped with a line."""
    from socketio.exceptions import ConnectionRefusedError as Refused

    for handlers in sio.handlers.values():
        for name, call in list(handlers.items()):
            if name != "disconnect":
                handlers[name] = _whole(name, call, Refused)


def _whole(name: str, call: Any, refused: type[Exception]) -> Any:
    @functools.wraps(call)
    async def taken(*parts: Any) -> Any:
        try:
            answer = call(*parts)
            return await answer if inspect.isawaitable(answer) else answer
        except refused:
            raise
        except Exception as error:
            SAID.error("a message %r that is none of the page's was dropped (%s)", name, _kind(error))
            if name == "connect":
                raise refused("no such page") from None
            return None

    return taken


def _kind(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:100]}"


__all__ = ["OneLine", "heed_only_whole_messages", "one_line_each"]
