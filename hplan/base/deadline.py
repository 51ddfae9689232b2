"""Deadlines and cancellation, checked by Python code and by kernels.

A limit belongs to the call that it was begun in, and to what that calls in its own thread (a context variable), so that
it need not go through every function on the way. Python code calls `check_deadline` at its steps, which raises
`TimeIsUpError` once time is up. Kernels that may take longer than a millisecond take the array `until()` and call
`is_up` every so often; where it is, they return whatever they have, and **their caller calls `check_deadline` before it
uses that**. `is_up` stays true as long as the limit lasts, so nothing that was cut short is ever taken for a result.

Deadlines are compared with the clock, by kernels too. Whether a call is cancelled is polled by a thread of its own, as
kernels release Python's lock while they run.
"""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeAlias

import numba as nb
import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.kernels import inlined, kernel
from hplan.errors import HplanError, NotInTimeError, OptionError, PlanCancelledError

#: Says whether a call is cancelled: a function that returns a truth value, or an event that is set.
Cancel: TypeAlias = Callable[[], object] | threading.Event

#: The clock that deadlines are on. (Studies on a machine that others use too take that of the process's own work.)
CLOCK = time.CLOCK_MONOTONIC

#: What kernels take where there is no limit: the time on the clock [s], 1 once cancelled, and the clock.
NEVER: FloatArray = frozen(np.array([np.inf, 0.0, float(CLOCK)]))

_CURRENT: ContextVar[TimeLimit | None] = ContextVar("time_limit", default=None)


class TimeIsUpError(Exception):
    """Time is up, or the call is cancelled. It does not leave the call that began the limit."""


class TimeLimit:
    """A deadline, and whether it was cancelled.

    Attributes:
        deadline_s: How long there is in all; None for as long as it takes [s].
        until: (3,) what kernels take, as `NEVER`.
    """

    def __init__(self, deadline_s: float | None = None, *, until_cancelled: bool = False) -> None:
        """Begin now.

        Args:
            deadline_s: How long there is; None for as long as it takes [s].
            until_cancelled: True where it may be cancelled.
        """
        self._begin = clock_s()
        self.deadline_s = deadline_s
        # Later than any time on the clock, yet finite, so that kernels check for cancellation [s].
        late = 1e300 if until_cancelled else np.inf
        self._values = np.array([late if deadline_s is None else self._begin + deadline_s, 0.0, float(CLOCK)])
        self.until = frozen(self._values[:])
        self._failure: BaseException | None = None

    @property
    def elapsed_s(self) -> float:
        """Time since it began [s]."""
        return clock_s() - self._begin

    @property
    def left_s(self) -> float:
        """Time that is left, infinite without a deadline [s]."""
        return float(self._values[0]) - clock_s()

    @property
    def is_up(self) -> bool:
        """True once there is no time left, or it was cancelled."""
        deadline, cancelled, _ = self._values.tolist()
        return bool(cancelled > 0.0 or clock_s() >= deadline)

    @property
    def is_cancelled(self) -> bool:
        """True once it was cancelled."""
        return bool(self._values[1] > 0.0)

    def cancel(self, failure: BaseException | None = None) -> None:
        """Cancel the call; with an error, because the function that says whether to cancel has raised it."""
        self._failure = failure
        self._values[1] = 1.0

    def check_cancelled(self) -> None:
        """Return unless it was cancelled.

        Raises:
            PlanCancelledError: It was.
            BaseException: What the function raised that says whether it is.
        """
        if self._failure is not None:
            raise self._failure
        if self.is_cancelled:
            raise PlanCancelledError(self.elapsed_s)

    def error(self, tried: Sequence[str]) -> HplanError:
        """The error that says that time is up, and what was tried.

        Raises:
            PlanCancelledError: It was cancelled; time is not up.
            BaseException: As `check_cancelled`.
        """
        self.check_cancelled()
        return NotInTimeError(self.deadline_s or 0.0, self.elapsed_s, tried)

    def keep(self, seconds: float) -> None:
        """Time is up as much sooner from now on, to have that long afterwards [s]."""
        if self.deadline_s is not None:
            self._values[0] = self._begin + self.deadline_s - seconds


class _Garbage:
    """Python's garbage, which is not collected while any thread is within a short deadline.

    What is allocated within one makes a collection due, which would run in the last lines of the call. So the last one
    to leave collects the youngest itself, everything only where the time left is enough for that. What the call holds
    until it returns is no garbage yet: the first one to begin collects it after the call before (0.1 ms), or it would
    grow old, and the next collection of everything would take long.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._inside: list[TimeLimit] = []
        self._was_enabled = False
        self._all_s = 0.1

    def hold(self, limit: TimeLimit) -> None:
        """A short deadline begins."""
        with self._lock:
            if not self._inside:
                self._was_enabled = gc.isenabled()
                if self._was_enabled:
                    gc.collect(1)
                gc.disable()
            self._inside.append(limit)

    def release(self, limit: TimeLimit) -> None:
        """A short deadline is over."""
        with self._lock:
            self._inside.remove(limit)
            if self._inside or not self._was_enabled:
                return
            calls, begin = gc.get_count()[2], clock_s()
            # A collection of all garbage that is due waits for a call with time left for it, for as many calls at most.
            postponed = 1000
            if calls > postponed or (calls > gc.get_threshold()[2] and limit.left_s > 2.0 * self._all_s):
                gc.collect()
                self._all_s = clock_s() - begin
            else:
                gc.collect(0)
            gc.enable()

    def begin_in_child(self) -> None:
        """The process is a child: of the threads that were within a deadline only the one that forked is in it."""
        was_held, self._lock = bool(self._inside), threading.RLock()
        self._inside = [limit for limit in self._inside if limit is _CURRENT.get()]
        if was_held and not self._inside and self._was_enabled:
            gc.enable()


_GARBAGE = _Garbage()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_GARBAGE.begin_in_child)


@contextmanager
def time_limit(deadline_s: float | None = None, cancel: Cancel | None = None) -> Iterator[TimeLimit]:
    """Begin a limit, which lasts as long as what runs inside; within another one that one counts.

    Args:
        deadline_s: How long there is; None for as long as it takes [s].
        cancel: Says whether the call is cancelled; asked about every millisecond by a thread of its own.

    Raises:
        OptionError: `cancel` is neither a function nor an event.
        PlanCancelledError: It is cancelled.
        TimeIsUpError: Time is up.
        BaseException: What the function has raised.
    """
    if cancel is not None and not (callable(cancel) or isinstance(cancel, threading.Event)):
        raise OptionError("cancel", cancel, "a function without arguments, or a threading.Event")
    outer = _CURRENT.get()
    if outer is not None:
        yield outer
        return
    limit = TimeLimit(deadline_s, until_cancelled=cancel is not None)
    done = threading.Event()
    if cancel is not None:
        _ask(limit, cancel)
        threading.Thread(target=_watch, args=(limit, cancel, done), daemon=True, name="hplan-cancel").start()
    token = _CURRENT.set(limit)
    # Within shorter deadlines Python's garbage is not collected, which takes a tenth of a second where there are many
    # objects (`_Garbage`) [s].
    uncollected_s = 1.0
    is_short = deadline_s is not None and deadline_s <= uncollected_s
    if is_short:
        _GARBAGE.hold(limit)
    try:
        limit.check_cancelled()
        yield limit
        limit.check_cancelled()
    except (TimeIsUpError, HplanError):
        limit.check_cancelled()
        raise
    finally:
        if is_short:
            _GARBAGE.release(limit)
        _CURRENT.reset(token)
        done.set()


def _ask(limit: TimeLimit, cancel: Cancel) -> None:
    """Find out whether the call is cancelled."""
    try:
        if cancel.is_set() if isinstance(cancel, threading.Event) else cancel():
            limit.cancel()
    except BaseException as failure:  # whatever a foreign function raises belongs to the thread that plans
        limit.cancel(failure)


def _watch(limit: TimeLimit, cancel: Cancel, done: threading.Event) -> None:
    """Ask again and again, until the limit is over."""
    # How often cancellation is polled [s].
    while not (limit.is_cancelled or done.wait(1e-3)):
        _ask(limit, cancel)


def current() -> TimeLimit | None:
    """The limit of the call that this belongs to; None for none."""
    return _CURRENT.get()


def until() -> FloatArray:
    """(3,) what kernels take, for the limit of the call that this belongs to."""
    limit = _CURRENT.get()
    return NEVER if limit is None else limit.until


def is_over() -> bool:
    """True if there is no time left, or the call is cancelled: for what may end with less."""
    limit = _CURRENT.get()
    return limit is not None and limit.is_up


def check_deadline() -> None:
    """Return if there is time left, and the call is not cancelled.

    Raises:
        TimeIsUpError: There is none, or it is.
    """
    if is_over():
        raise TimeIsUpError


def clock_s() -> float:
    """Time on the clock that deadlines are on [s]."""
    return time.clock_gettime(CLOCK)


if nb.config.DISABLE_JIT:

    def _seconds(clock: int) -> float:
        return time.clock_gettime(clock)

else:
    # By its name, not its address, so that kernels which ask it can be kept on disk.
    _clock_gettime = nb.types.ExternalFunction("clock_gettime", nb.int32(nb.int32, nb.types.voidptr))

    @kernel
    def _seconds(clock: int) -> float:
        """Time on a clock [s]."""
        parts = np.empty(2, dtype=np.int64)
        _clock_gettime(clock, parts.ctypes)
        seconds: float = parts[0] + 1e-9 * parts[1]
        return seconds


@kernel
def _is_up(until: FloatArray) -> bool:
    """As `is_up` where there is a limit; takes 0.2 us."""
    up: bool = until[1] > 0.0 or _seconds(int(until[2])) >= until[0]
    return up


@inlined
def is_up(until: FloatArray) -> bool:
    """True once there is no time left, or the call is cancelled."""
    up: bool = until[0] < np.inf and _is_up(until)
    return up
