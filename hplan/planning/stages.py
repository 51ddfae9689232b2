"""Stages of a plan: names, times and progress callbacks.

The current clock is a context variable, as deadlines are: it belongs to the call that started it and need not be passed
through every function.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeAlias

from hplan.base.deadline import check_deadline
from hplan.base.log import LOG

#: Stages of a plan, in order.
STAGES = (
    "grasps", "trees", "cspace", "layers", "sparse", "fallback", "postprocess", "timing", "certificate", "bound",
    "export",
)  # fmt: skip

#: Called with the name of each stage as it begins.
Progress: TypeAlias = Callable[[str], None]


def no_progress(_: str) -> None:
    """Ignore the stages."""


class StageClock:
    """Wall-clock time of each stage [s], accumulated over repeated stages.

    Attributes:
        seconds: Time by stage [s].
        progress: Called with the name of each stage as it begins.
    """

    def __init__(self, progress: Progress = no_progress) -> None:
        self._start = time.perf_counter()
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage and time the block as part of it."""
        self.progress(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            took_s = time.perf_counter() - start
            self.add(name, took_s)
            LOG.debug("stage %s: %.3g ms", name, 1e3 * took_s)

    def add(self, name: str, seconds: float) -> None:
        """Add time that was measured elsewhere."""
        self.seconds[name] += seconds

    def describe(self) -> list[str]:
        """Return a phrase for each stage that ran, with its time."""
        return [f"{name} for {1e3 * seconds:.3g} ms" for name, seconds in self.seconds.items() if seconds > 0.0]

    def as_ms(self) -> dict[str, float]:
        """Return the times by stage and their total [ms]."""
        table = {name: round(1e3 * seconds, 4) for name, seconds in self.seconds.items()}
        return {**table, "total": round(1e3 * (time.perf_counter() - self._start), 4)}


_CURRENT_CLOCK: ContextVar[StageClock | None] = ContextVar("stage_clock", default=None)


@contextmanager
def stage_clock(progress: Progress = no_progress) -> Iterator[StageClock]:
    """Time the stages of the block with a clock of their own."""
    clock = StageClock(progress)
    token = _CURRENT_CLOCK.set(clock)
    try:
        yield clock
    finally:
        _CURRENT_CLOCK.reset(token)


def current_clock() -> StageClock:
    """Return the clock of the innermost `stage_clock`, or a new one."""
    return _CURRENT_CLOCK.get() or StageClock()


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Check the deadline, announce a stage and time the block.

    Raises:
        TimeIsUpError: The deadline has passed.
    """
    check_deadline()
    with current_clock().stage(name):
        yield
