"""Time limits, in Python code and in kernels."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Callable

import pytest

from hplan.base.arrays import FloatArray
from hplan.base.deadline import NEVER, TimeIsUpError, check_deadline, current, is_up, kernel_time_limit, time_limit
from hplan.base.kernels import kernel
from hplan.errors import PlanCancelledError

#: Number of loops of the kernel below if nothing stops it: most of a minute.
LOOPS = 10**11

#: Maximum duration of a kernel that must return at once; generous, since one that does not takes far longer [s].
SOON = 5.0


def count_and_look() -> None:
    _count(kernel_time_limit(), LOOPS)
    check_deadline()


@kernel
def _count(until: FloatArray, most: int) -> int:
    """Count until time is up."""
    count = 0
    while count < most:
        count += 1
        if count & 1023 == 0 and is_up(until):
            break
    return count


def test_without_a_limit_kernels_go_on_to_their_end() -> None:
    check_deadline()
    assert current() is None
    assert kernel_time_limit() is NEVER
    assert _count(kernel_time_limit(), 5000) == 5000


def test_kernel_comes_back_at_the_deadline() -> None:
    begin = time.monotonic()
    with time_limit(0.02) as limit:
        assert _count(kernel_time_limit(), LOOPS) < LOOPS
        assert limit.is_up
        assert not limit.is_cancelled
        with pytest.raises(TimeIsUpError):
            check_deadline()
    assert 0.02 <= time.monotonic() - begin < SOON
    check_deadline()


def test_limit_holds_for_its_own_thread_alone() -> None:
    found: list[object] = []
    with time_limit(1e-9):
        other = threading.Thread(target=lambda: found.append((current(), check_deadline())))
        other.start()
        other.join()
    assert found == [(None, None)]


def test_time_can_be_reserved_for_later_work() -> None:
    with time_limit(1e3) as limit:
        limit.keep(1e4)
        with pytest.raises(TimeIsUpError):
            check_deadline()
        limit.keep(1.0)
        check_deadline()
        assert 1e2 < limit.left_s < 1e3


def _event_set_by_a_timer() -> threading.Event:
    event = threading.Event()
    threading.Timer(0.02, event.set).start()
    return event


@pytest.mark.parametrize("of", [lambda event: event, lambda event: event.is_set], ids=["event", "function"])
def test_kernel_comes_back_once_it_is_cancelled(of: Callable[[threading.Event], object]) -> None:
    begin = time.monotonic()
    with pytest.raises(PlanCancelledError) as error, time_limit(cancel=of(_event_set_by_a_timer())):
        count_and_look()
    assert 0.0 < error.value.elapsed_s <= time.monotonic() - begin < SOON


def test_cancelled_work_is_not_started() -> None:
    event = threading.Event()
    event.set()
    with pytest.raises(PlanCancelledError), time_limit(cancel=event):
        pytest.fail("it was begun")


def test_another_thread_ticks_while_a_kernel_runs() -> None:
    ticks, done = [0], threading.Event()

    def tick() -> None:
        while not done.wait(1e-3):
            ticks[0] += 1

    other = threading.Thread(target=tick)
    other.start()
    with time_limit(0.3):
        before = ticks[0]
        _count(kernel_time_limit(), LOOPS)
        after = ticks[0]
    done.set()
    other.join()
    assert after - before >= 5  # a kernel that held the lock would leave it none


def test_garbage_waits_until_a_short_deadline_is_over() -> None:
    assert gc.isenabled()
    with time_limit(0.5):
        assert not gc.isenabled()
        with time_limit(0.1):
            pass
        assert not gc.isenabled()
    assert gc.isenabled()
    with time_limit(1e3):
        assert gc.isenabled()
    with pytest.raises(ZeroDivisionError), time_limit(0.5):
        raise ZeroDivisionError
    assert gc.isenabled()


def test_garbage_is_left_alone_until_the_last_thread_is_out() -> None:
    entered, leave = threading.Event(), threading.Event()

    def within() -> None:
        with time_limit(0.9):
            entered.set()
            leave.wait(10.0)

    with time_limit(0.9):
        other = threading.Thread(target=within)
        other.start()
        assert entered.wait(10.0)
    assert not gc.isenabled()  # the other one is within its own
    leave.set()
    other.join()
    assert gc.isenabled()
    gc.disable()
    try:
        with time_limit(0.9):
            pass
        assert not gc.isenabled()  # as set by the program
    finally:
        gc.enable()


def test_garbage_of_calls_does_not_grow_old() -> None:
    """Reference cycles of a call are collected by the next call, without a full collection."""

    class Held:
        pass

    gone: list[int] = []
    gc.collect()
    for number in range(20):
        with time_limit(1e-3):  # no time is left for one
            held = Held()
            held.itself = held
            weakref.finalize(held, gone.append, number)
        del held
    assert gone[:19] == list(range(19))
