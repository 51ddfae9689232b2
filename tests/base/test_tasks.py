"""Tasks on executors: each done once, whatever happens to the workers."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

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


def test_on_threads_none_is_left_out() -> None:
    with ThreadPoolExecutor(3) as threads:
        assert sorted(outcomes(squared, range(50), *pool_of(threads, 3))) == [(i, i * i) for i in range(50)]


def test_the_tasks_of_a_killed_worker_run_again(tmp_path: Path) -> None:
    given = [(i, tmp_path / "once" if i == 3 else None) for i in range(8)]
    found = list(outcomes(squared_unless, given, *pool_of(None, 2)))
    assert sorted(found) == [(i, i * i) for i in range(8)]
    assert (tmp_path / "once").read_text() == "xx"


def test_a_task_that_kills_its_workers_keeps_no_other_from_its_end(tmp_path: Path) -> None:
    given = [(i, tmp_path / "always" if i == 0 else None) for i in range(6)]
    ends = outcomes(squared_unless, given, lambda: ProcessPoolExecutor(1, get_context("fork")), 1)
    assert [next(ends) for _ in range(5)] == [(i, i * i) for i in range(1, 6)]
    with pytest.raises(WorkersLostError) as caught:
        next(ends)
    assert caught.value.tasks == [0]
    assert (tmp_path / "always").read_text() == "xxx"


def test_a_broken_executor_of_others_cannot_be_mended(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, get_context("fork")) as pool, pytest.raises(WorkersLostError, match="2 of 2"):
        list(outcomes(squared_unless, [(0, tmp_path / "always"), (1, None)], pool, 1))


def test_an_error_of_a_task_is_raised() -> None:
    with pytest.raises(OptionError, match="another"):
        list(outcomes(refused, [1, 2], *pool_of(None, 1)))


@pytest.mark.parametrize(("executor", "workers"), [(3, None), (None, 0), (None, 1.5)])
def test_what_is_no_executor(executor: object, workers: int | None) -> None:
    with pytest.raises(OptionError):
        pool_of(executor, workers)  # type: ignore[arg-type]
