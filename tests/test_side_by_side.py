"""Pieces of a diagnosis on two cores: the answers of one, whatever happens to the other."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import sys

import pytest

from towline.pipeline.executor.copies import _answer, _Unpickler, side_by_side
from towline.record import EstimationError

TWO = pytest.mark.skipif(
    sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="the system copies no process, or has one core"
)


def test_answers_stand_in_the_items_order_and_known_things_stand_for_themselves() -> None:
    known = [lambda: 1, lambda: 2]  # functions that no pickle takes
    answers = side_by_side(lambda k: (k * k, known[k % 2]), range(5), known)
    assert [a for a, _ in answers] == [0, 1, 4, 9, 16]
    assert all(thing is known[k % 2] for k, (_, thing) in enumerate(answers))


@TWO
def test_half_is_done_elsewhere() -> None:
    assert len(set(side_by_side(lambda _: os.getpid(), range(4)))) == 2


@TWO
def test_a_copy_that_dies_costs_only_time() -> None:
    here = os.getpid()

    def work(item: int) -> int:
        if os.getpid() != here:
            os.kill(os.getpid(), 9)
        return item

    assert side_by_side(work, range(4)) == [0, 1, 2, 3]


@pytest.mark.parametrize("bad", [0, 1])
def test_an_error_comes_through_from_either_side(bad: int) -> None:
    def work(item: int) -> int:
        if item == bad:
            raise EstimationError(f"item {item} cannot be fitted")
        return item

    with pytest.raises(EstimationError, match=f"item {bad} cannot"):
        side_by_side(work, range(2))


def test_what_a_copy_sends_is_its_answers_or_its_error() -> None:
    """In this process, so that nothing but the sending is tested: known things go as their places."""
    known = [lambda: 1, lambda: 2]
    interrupt = signal.getsignal(signal.SIGINT)
    for work, wanted in (
        (lambda k: (known[k], [k]), [(known[1], [1]), (known[0], [0])]),
        (lambda k: 1 / (k - 1), ZeroDivisionError),
        (lambda k: int("no"), ValueError),
    ):
        here, there = multiprocessing.get_context("fork").Pipe(duplex=False)
        try:
            _answer(there, work, [1, 0], known)
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        finally:
            signal.signal(signal.SIGINT, interrupt)
        sent = here.recv_bytes()
        found = _Unpickler(io.BytesIO(sent), known).load()
        if isinstance(wanted, list):
            assert found == wanted
            assert found[0][0] is known[1]
        else:
            assert isinstance(found, wanted)
    _, there = multiprocessing.get_context("fork").Pipe(duplex=False)
    try:
        with pytest.raises(KeyError):  # a fault of ours is not answered
            _answer(there, lambda k: {}[k], [1], known)
    finally:
        signal.signal(signal.SIGINT, interrupt)


def test_one_item_or_a_worker_makes_no_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    here = os.getpid()
    assert side_by_side(lambda _: os.getpid(), [0]) == [here]
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: "another")
    assert side_by_side(lambda _: os.getpid(), range(4)) == [here] * 4
    monkeypatch.undo()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert side_by_side(lambda _: os.getpid(), range(4)) == [here] * 4
