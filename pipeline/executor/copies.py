"""Independent pieces of a diagnosis on two cores: half of them in a forked copy of the process.

A copy has everything that was worked out so far without being sent it; only its answers come back. Threads gain nothing here (the
arrays are small, and Python's lock passes hands all the time).
"""

from __future__ import annotations

import io
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from ...record.each import Tell, in_turn
from ...record.errors import TowlineError
from .processes import end_with, undisturbed

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def side_by_side(work: Callable[[Item], Answer], items: Sequence[Item], known: Sequence[object] = ()) -> list[Answer]:
    """``work`` of every item, in their order; what is answered does not depend on how many go at once.

    Parameters
    ----------
    work : what is done of an item
    items : in their order
    known : objects that answers may hold and that are not sent: they stand for themselves
    """
    if len(items) < 2 or not _two_cores():
        return [work(item) for item in items]
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    copy = fork.Process(target=_copied, args=(os.getpid(), here, there, work, items[1::2], known), daemon=True)
    try:
        with undisturbed():
            copy.start()
    except OSError:  # no memory for a copy
        here.close()
        return [work(item) for item in items]
    finally:
        there.close()
    try:
        own = [work(item) for item in items[0::2]]
        try:
            others = _Unpickler(io.BytesIO(here.recv_bytes()), known).load()
        except EOFError:
            # the copy is gone (killed for memory, say): nothing is lost but time
            others = [work(item) for item in items[1::2]]
    finally:
        copy.terminate()
        copy.join()
        here.close()
    if isinstance(others, Exception):
        raise others
    answers: list[Any] = [None] * len(items)
    answers[0::2], answers[1::2] = own, others
    return answers


def with_a_copy(call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], tell: Tell | None = None) -> list[Any]:
    """``Each`` by this process and a copy of it.

    Parameters
    ----------
    call : what is called
    arguments : of each call
    tell : is told how far it is; the copy is taken to be as far as this process
    """
    here, done = os.getpid(), 0

    def work(one: tuple[Any, ...]) -> Any:
        nonlocal done
        answer = call(*one)
        if tell is not None and os.getpid() == here:
            done += 1
            tell(min(2 * done, len(arguments)))
        return answer

    return side_by_side(work, arguments) if len(arguments) > 1 and _two_cores() else in_turn(call, arguments, tell)


def _two_cores() -> bool:
    """Whether a copy has a core of its own, on a system that copies safely; one of several workers makes no more."""
    if sys.platform != "linux" or multiprocessing.parent_process() is not None:
        return False
    return len(os.sched_getaffinity(0)) > 1


def _copied(
    parent: int,
    here: Connection,
    there: Connection,
    work: Callable[[Item], Answer],
    items: Sequence[Item],
    known: Sequence[object],
) -> None:
    """In the copy: it ends with its parent, whose end of the pipe it does not keep open."""
    here.close()
    end_with(parent)
    with suppress(BrokenPipeError):
        _answer(there, work, items, known)


def _answer(there: Connection, work: Callable[[Item], Answer], items: Sequence[Item], known: Sequence[object]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process is told, and ends this one
    try:
        answer: list[Any] | Exception = [work(item) for item in items]
    except (TowlineError, ArithmeticError, ValueError, MemoryError) as error:
        answer = error
    buffer = io.BytesIO()
    _Pickler(buffer, known).dump(answer)
    there.send_bytes(buffer.getvalue())


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._places = {id(thing): place for place, thing in enumerate(known)}

    def persistent_id(self, obj: object) -> int | None:
        return self._places.get(id(obj))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, known: Sequence[object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, pid: int) -> object:
        return self._known[pid]


__all__ = ["side_by_side", "with_a_copy"]
