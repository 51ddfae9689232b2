"""Tasks on any executor of `concurrent.futures`, in the order in which they end; those of lost workers run again."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing import get_context
from typing import Any, TypeAlias, TypeVar

from hplan.base.arguments import whole
from hplan.base.interrupts import INTERRUPTS, children_not_interrupted
from hplan.errors import OptionError, WorkersLostError

_T = TypeVar("_T")
_R = TypeVar("_R")

#: What runs tasks: an executor, or what makes one; only the latter can take the place of one that is broken.
Pool: TypeAlias = Executor | Callable[[], Executor]

#: Tasks that are handed over at a time, for each worker that there is; on an executor that does not say, in all.
_AHEAD, _AT_ONCE = 2, 256


def pool_of(executor: Pool | None, workers: int | None) -> tuple[Pool, int]:
    """What runs tasks, and how many are handed to it at a time.

    Args:
        executor: What was asked for; None for processes of this machine, or this one alone where one worker is wanted.
        workers: How many work at once; None for one on each processor, or as many as the executor has.

    Raises:
        OptionError: Neither an executor nor a function that makes one, or no number of workers.
    """
    if workers is not None:
        whole("workers", workers, 1)
    if executor is None:
        count = len(os.sched_getaffinity(0)) if workers is None else workers
        if count == 1:
            return _Here, 1
        # Forked children would have the locks of this process's threads as they stand.
        return lambda: ProcessPoolExecutor(count, mp_context=get_context("spawn")), _AHEAD * count
    if not isinstance(executor, Executor) and not callable(executor):
        raise OptionError("executor", executor, "an Executor of concurrent.futures, or a function that makes one")
    return executor, _AT_ONCE if workers is None else _AHEAD * workers


def outcomes(task: Callable[[_T], _R], given: Sequence[_T], pool: Pool, at_once: int) -> Iterator[tuple[int, _R]]:
    """Run a task on each of several values; gives the number of each and what came of it, as they end.

    A task whose worker is lost runs again, after all others that wait. What a task raises is raised here.

    Args:
        task: A function that can be pickled.
        pool: What runs them (`pool_of`).
        at_once: How many are handed over at a time.

    Raises:
        WorkersLostError: At the end, where tasks have lost their workers too often, or the executor that was given is
            broken.
    """
    executor = pool if isinstance(pool, Executor) else pool()
    waiting = deque((number, 0) for number in range(len(given)))
    running: dict[Future[_R], tuple[int, int]] = {}
    lost, is_broken = list[int](), False
    try:
        while waiting or running:
            while waiting and len(running) < at_once and not is_broken:
                number, losses = waiting[0]
                try:
                    with children_not_interrupted():
                        future = executor.submit(_run, task, given[number], losses)
                except BrokenExecutor:
                    is_broken = True
                else:
                    running[future] = waiting.popleft()
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, losses = running.pop(future)
                error = _fault(future)
                if error is None:
                    yield number, future.result()
                elif not _is_loss(error):
                    raise error
                elif losses + 1 < 3:  # so often a task may lose its worker
                    waiting.append((number, losses + 1))
                else:
                    lost.append(number)
                is_broken |= isinstance(error, BrokenExecutor)
            if is_broken and not running:
                if isinstance(pool, Executor):
                    lost += [number for number, _ in waiting]
                    break
                executor, is_broken = pool(), False
    except INTERRUPTS:
        if isinstance(executor, ProcessPoolExecutor) and executor is not pool:
            for process in list((executor._processes or {}).values()):
                process.terminate()  # else this process would end after their tasks
        raise
    finally:
        if executor is not pool:
            executor.shutdown(wait=False, cancel_futures=True)
    if lost:
        raise WorkersLostError(sorted(lost), len(given))


def _run(task: Callable[[_T], _R], value: _T, _: int) -> _R:
    """Run a task; how often it was lost makes it another one to those that keep what came of calls."""
    return task(value)


def _fault(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _is_loss(error: BaseException) -> bool:
    """Whether it says that a worker is lost, as Dask does by an error of its own."""
    is_dask_s = any(kind.__name__ == "KilledWorker" for kind in type(error).__mro__)
    return is_dask_s or isinstance(error, BrokenExecutor | CancelledError)


class _Here(Executor):
    """Runs each task in this process, when it is handed over."""

    def submit(self, fn: Callable[..., _R], /, *args: Any, **kwargs: Any) -> Future[_R]:
        """Run a task."""
        future: Future[_R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
