"""Pieces of a diagnosis on two cores: the answers of one, whatever happens to the other."""

from __future__ import annotations

import multiprocessing
import os
import signal

import pytest

from towline.pipeline.executor.copies import side_by_side, with_a_copy
from towline.record import EstimationError


@pytest.mark.usefixtures("two_cores")
def test_answers_stand_in_the_items_order_and_known_things_stand_for_themselves() -> None:
    known = [lambda: 1, lambda: 2]  # functions that no pickle takes
    answers = side_by_side(lambda k: (k * k, known[k % 2]), range(5), known)
    assert [a for a, _ in answers] == [0, 1, 4, 9, 16]
    assert all(thing is known[k % 2] for k, (_, thing) in enumerate(answers))


@pytest.mark.usefixtures("two_cores")
def test_half_is_done_elsewhere() -> None:
    assert len(set(side_by_side(lambda _: os.getpid(), range(4)))) == 2


@pytest.mark.usefixtures("two_cores")
def test_a_copy_that_dies_costs_only_time() -> None:
    here = os.getpid()

    def work(item: int) -> int:
        if os.getpid() != here:
            os.kill(os.getpid(), 9)
        return item

    assert side_by_side(work, range(4)) == [0, 1, 2, 3]


@pytest.mark.usefixtures("two_cores")
@pytest.mark.parametrize("bad", [0, 1])
@pytest.mark.parametrize("error", [EstimationError, ZeroDivisionError, ValueError, MemoryError, KeyError])
def test_an_error_comes_through_from_either_side(bad: int, error: type[Exception]) -> None:
    """A plain one as it is; a fault of ours (a KeyError) is made again in this process, with its whole trace."""

    def work(item: int) -> int:
        if item == bad:
            raise error(f"item {item} cannot be fitted")
        return item

    with pytest.raises(error, match=f"item {bad} cannot"):
        side_by_side(work, range(2))


@pytest.mark.usefixtures("two_cores")
def test_an_interrupt_is_left_to_this_process() -> None:
    """The copy does not die of a Ctrl-C, which a terminal sends to both."""
    here = os.getpid()

    def work(item: int) -> bool:
        return os.getpid() != here and signal.getsignal(signal.SIGINT) is signal.SIG_IGN

    assert side_by_side(work, range(2)) == [False, True]


@pytest.mark.usefixtures("two_cores")
def test_one_item_or_a_worker_makes_no_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    here = os.getpid()
    assert side_by_side(lambda _: os.getpid(), [0]) == [here]
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: "another")
    assert side_by_side(lambda _: os.getpid(), range(4)) == [here] * 4
    monkeypatch.undo()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert side_by_side(lambda _: os.getpid(), range(4)) == [here] * 4


@pytest.mark.usefixtures("two_cores")
def test_calls_with_a_copy_answer_in_their_order_and_say_how_far_they_are() -> None:
    heard: list[int] = []
    assert with_a_copy(pow, [(k, 2) for k in range(5)], heard.append) == [0, 1, 4, 9, 16]
    assert heard == sorted(heard)
    assert heard[-1] == 5
    assert with_a_copy(pow, [(3, 2)]) == [9]
    assert with_a_copy(pow, []) == []
