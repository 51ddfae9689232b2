"""Tasks on any `concurrent.futures` executor, with retries after lost workers.

Results come in the order of completion.
"""

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

from hplan.base.arguments import check_integer
from hplan.base.interrupts import INTERRUPTS, children_not_interrupted
from hplan.errors import OptionError, WorkersLostError

_T = TypeVar("_T")
_R = TypeVar("_R")

#: An executor, or a function that makes one; only the latter can replace a broken executor.
Pool: TypeAlias = Executor | Callable[[], Executor]

#: Maximum number of submitted tasks: for each worker, and in total if the number of workers is unknown.
_AHEAD, _AT_ONCE = 2, 256


def pool_of(executor: Pool | None, workers: int | None) -> tuple[Pool, int]:
    """Return executor or factory, and the maximum number of submitted tasks.

    Args:
        executor: The requested executor; None for processes of this machine, or this process alone for one worker.
        workers: Number of workers; None for one per processor, or for the number of the executor.

    Raises:
        OptionError: `executor` is neither an executor nor a function, or `workers` is not a positive integer.
    """
    if workers is not None:
        check_integer("workers", workers, 1)
    if executor is None:
        count = len(os.sched_getaffinity(0)) if workers is None else workers
        if count == 1:
            return _Here, 1
        # Forked children would inherit locks held by this process's threads.
        return lambda: ProcessPoolExecutor(count, mp_context=get_context("spawn")), _AHEAD * count
    if not isinstance(executor, Executor) and not callable(executor):
        raise OptionError("executor", executor, "an Executor of concurrent.futures, or a function that creates one")
    return executor, _AT_ONCE if workers is None else _AHEAD * workers


def outcomes(task: Callable[[_T], _R], given: Sequence[_T], pool: Pool, at_once: int) -> Iterator[tuple[int, _R]]:
    """Run a task on values; yield (index, result) in completion order.

    A task whose worker is lost runs again, after all waiting tasks. An exception of a task is raised here.

    Args:
        task: A picklable function.
        given: The values.
        pool: The executor or its factory (`pool_of`).
        at_once: Maximum number of submitted tasks.

    Raises:
        WorkersLostError: At the end, if tasks lost their workers three times, or a given executor is broken.
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
                        future = executor.submit(_run_task, task, given[number], losses)
                except BrokenExecutor:
                    is_broken = True
                else:
                    running[future] = waiting.popleft()
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, losses = running.pop(future)
                error = _is_lost_worker(future)
                if error is None:
                    yield number, future.result()
                elif not _is_loss(error):
                    raise error
                elif losses + 1 < 3:  # maximum number of attempts
                    waiting.append((number, losses + 1))
                else:
                    lost.append(number)
                is_broken |= isinstance(error, BrokenExecutor)
            if is_broken and not running:
                if isinstance(pool, Executor):
                    lost += [number for number, _ in waiting]
                    break
                executor, is_broken = pool(), False
    except (*INTERRUPTS, GeneratorExit):  # the caller was interrupted, or takes no more results
        if isinstance(executor, ProcessPoolExecutor) and executor is not pool:
            for process in list((executor._processes or {}).values()):
                process.terminate()  # else this process would wait for their tasks
            executor.shutdown(cancel_futures=True)  # frees its semaphores, which the system would report as leaked
        raise
    finally:
        if executor is not pool:
            executor.shutdown(wait=False, cancel_futures=True)
    if lost:
        raise WorkersLostError(sorted(lost), len(given))


def _run_task(task: Callable[[_T], _R], value: _T, _: int) -> _R:
    """Run a task.

    The number of losses as an argument makes a retry a distinct call for executors that cache results.
    """
    return task(value)


def _is_lost_worker(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _is_loss(error: BaseException) -> bool:
    """True if the exception reports a lost worker.

    Dask has its own class for it.
    """
    is_dask_s = any(kind.__name__ == "KilledWorker" for kind in type(error).__mro__)
    return is_dask_s or isinstance(error, BrokenExecutor | CancelledError)


class _Here(Executor):
    """Executor that runs each task in this process, on submission."""

    def submit(self, fn: Callable[..., _R], /, *args: Any, **kwargs: Any) -> Future[_R]:
        """Run a task."""
        future: Future[_R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
