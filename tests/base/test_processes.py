"""Tasks that worker processes do, and children that are forked."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

import pytest
from numba.core.compiler_lock import global_compiler_lock

import hplan
from hplan.base.deadline import time_limit
from hplan.base.kernels import kernel
from hplan.base.tasks import outcomes, pool_of
from hplan.errors import OptionError, WorkersLostError


def squared(number: int) -> int:
    return number * number


def squared_unless(given: tuple[int, Path | None]) -> int:
    """The square; the first call with a file that is not there yet makes it and kills its process."""
    number, mark = given
    if mark is not None:
        with mark.open("a") as file:
            file.write("x")
        if mark.name == "always" or len(mark.read_text()) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def refused(number: int) -> int:
    raise OptionError("number", number, "another")


def test_here_tasks_come_in_their_order() -> None:
    assert list(outcomes(squared, range(5), *pool_of(None, 1))) == [(i, i * i) for i in range(5)]


def test_all_tasks_run_on_threads() -> None:
    with ThreadPoolExecutor(3) as threads:
        assert sorted(outcomes(squared, range(50), *pool_of(threads, 3))) == [(i, i * i) for i in range(50)]


def test_tasks_of_a_killed_worker_run_again(tmp_path: Path) -> None:
    given = [(i, tmp_path / "once" if i == 3 else None) for i in range(8)]
    found = list(outcomes(squared_unless, given, *pool_of(None, 2)))
    assert sorted(found) == [(i, i * i) for i in range(8)]
    assert (tmp_path / "once").read_text() == "xx"


def test_task_that_kills_its_workers_keeps_no_other_from_its_end(tmp_path: Path) -> None:
    given = [(i, tmp_path / "always" if i == 0 else None) for i in range(6)]
    ends = outcomes(squared_unless, given, lambda: ProcessPoolExecutor(1, get_context("fork")), 1)
    assert [next(ends) for _ in range(5)] == [(i, i * i) for i in range(1, 6)]
    with pytest.raises(WorkersLostError) as caught:
        next(ends)
    assert caught.value.tasks == [0]
    assert (tmp_path / "always").read_text() == "xxx"


def test_broken_executor_of_others_cannot_be_mended(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, get_context("fork")) as pool, pytest.raises(WorkersLostError, match="2 of 2"):
        list(outcomes(squared_unless, [(0, tmp_path / "always"), (1, None)], pool, 1))


def test_error_of_a_task_is_raised() -> None:
    with pytest.raises(OptionError, match="another"):
        list(outcomes(refused, [1, 2], *pool_of(None, 1)))


@pytest.mark.parametrize(("executor", "workers"), [(3, None), (None, 0), (None, 1.5)])
def test_objects_that_are_not_executors_are_refused(executor: object, workers: int | None) -> None:
    with pytest.raises(OptionError):
        pool_of(executor, workers)  # type: ignore[arg-type]


#: A child that takes longer hangs [s].
PATIENCE_S = 120.0


def child_works(work: Callable[[], object]) -> bool:
    """True if a forked child completes some work."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            os._exit(1)
    begin = time.monotonic()
    while time.monotonic() - begin < PATIENCE_S:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


@contextmanager
def elsewhere(held: AbstractContextManager[object], seconds: float = PATIENCE_S) -> Iterator[None]:
    """Another thread holds a context, for a time or until the block ends."""
    inside, done = threading.Event(), threading.Event()

    def hold() -> None:
        with held:
            inside.set()
            done.wait(seconds)

    thread = threading.Thread(target=hold)
    thread.start()
    inside.wait()
    try:
        yield
    finally:
        done.set()
        thread.join()


@kernel
def _plus_one(x: float) -> float:
    return x + 1.0


def test_while_another_thread_compiles() -> None:
    """The fork waits: LLVM's own state could not be mended."""
    begin = time.monotonic()
    with elsewhere(global_compiler_lock, 0.3):
        assert child_works(lambda: _plus_one(1.0))
    assert time.monotonic() - begin >= 0.3


class _Slow:
    @cached_property
    def value(self) -> int:
        return 1

    @cached_property
    def slow(self) -> int:
        return 2


@pytest.mark.skipif(not hasattr(_Slow.__dict__["value"], "lock"), reason="cached properties have no locks any more")
@pytest.mark.parametrize("is_frozen", [False, True])
def test_while_another_thread_computes_a_cached_property(is_frozen: bool) -> None:
    """With or without objects frozen for the collector, as after loading kernels ahead."""
    if is_frozen:
        gc.freeze()
    with elsewhere(_Slow.__dict__["value"].lock):
        assert child_works(lambda: _Slow().value)


def test_garbage_is_collected_in_the_child() -> None:
    def collected() -> None:
        assert gc.isenabled()

    def still_not() -> None:
        assert not gc.isenabled()

    with elsewhere(time_limit(0.5)):
        assert not gc.isenabled()
        assert child_works(collected)
    with time_limit(0.5):
        assert child_works(still_not)
    assert gc.isenabled()


def test_with_the_planner_that_another_thread_plans_with() -> None:
    """At any moment of a plan; the child plans the same motion."""
    planner = hplan.Planner(hplan.load_robot(), hplan.load_scene())
    expected = planner.plan().motion.trajectory.position
    done = threading.Event()

    def plan() -> None:
        while not done.is_set():
            planner.plan()

    def same() -> None:
        with time_limit(PATIENCE_S):
            assert (planner.plan().motion.trajectory.position == expected).all()

    thread = threading.Thread(target=plan)
    thread.start()
    try:
        assert all(child_works(same) for _ in range(2))
    finally:
        done.set()
        thread.join()


INTERRUPTED = """
import os, signal, sys, time
from hplan.base.interrupts import INTERRUPTS, handling_signals, leave
from hplan.base.tasks import outcomes, pool_of

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with handling_signals():
        try:
            for _ in outcomes(time.sleep, [0.01, 60.0, 60.0], *pool_of(None, 2)):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(5.0)
        except INTERRUPTS:
            leave(130)
"""


def test_interrupted_pool_leaves_nothing_and_says_nothing(tmp_path: Path) -> None:
    """Its processes end at once, and the system reports no leaked semaphores."""
    (tmp_path / "job.py").write_text(INTERRUPTED)
    begin, here = time.monotonic(), {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "job.py"], cwd=tmp_path, env=here, capture_output=True, text=True, timeout=90, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    assert time.monotonic() - begin < 30.0
