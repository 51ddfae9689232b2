"""Deadlines and cancellation, checked by Python code and by kernels.

A limit belongs to the call that starts it and to its callees in the same thread (a context variable), so functions
need not pass it on. Python code calls `check_deadline` at its steps, which raises `TimeIsUpError` after the deadline.
Kernels that may take longer than a millisecond take the array `until()` and call `is_up` regularly; if it is true,
they return an incomplete result, and **their caller calls `check_deadline` before it uses that result**. `is_up` stays
true until the limit ends, so an incomplete result is never used.

Deadlines are compared with the clock, in kernels too. A separate thread polls for cancellation, which works because
kernels release Python's global interpreter lock.
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
from hplan.base.kernels import inline, kernel
from hplan.errors import HplanError, NotInTimeError, OptionError, PlanCancelledError

#: Cancels a call: a function that returns a true value, or an event that is set.
Cancel: TypeAlias = Callable[[], object] | threading.Event

#: The clock of deadlines. (Benchmarks on a shared machine use the process's CPU clock instead.)
CLOCK = time.CLOCK_MONOTONIC

#: Argument of kernels without a limit: deadline on the clock [s], 1 if cancelled, id of the clock.
NEVER: FloatArray = frozen(np.array([np.inf, 0.0, float(CLOCK)]))

_CURRENT: ContextVar[TimeLimit | None] = ContextVar("time_limit", default=None)


class TimeIsUpError(Exception):
    """The deadline has passed or the call is cancelled.

    The call that starts the limit catches it.
    """


class TimeLimit:
    """A deadline with a cancellation flag.

    Attributes:
        deadline_s: Duration of the limit [s]; None for no deadline.
        until: (3,) array for kernels, as `NEVER`.
    """

    def __init__(self, deadline_s: float | None = None, *, until_cancelled: bool = False) -> None:
        """Start the limit now.

        Args:
            deadline_s: Duration of the limit [s]; None for no deadline.
            until_cancelled: True if the call can be cancelled.
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
        """Time since the start [s]."""
        return clock_s() - self._begin

    @property
    def left_s(self) -> float:
        """Remaining time, infinite without a deadline [s]."""
        return float(self._values[0]) - clock_s()

    @property
    def is_up(self) -> bool:
        """True after the deadline or after cancellation."""
        deadline, cancelled, _ = self._values.tolist()
        return bool(cancelled > 0.0 or clock_s() >= deadline)

    @property
    def is_cancelled(self) -> bool:
        """True after cancellation."""
        return bool(self._values[1] > 0.0)

    def cancel(self, failure: BaseException | None = None) -> None:
        """Cancel the call; `failure` is the exception of the cancel function."""
        self._failure = failure
        self._values[1] = 1.0

    def check_cancelled(self) -> None:
        """Return unless the call is cancelled.

        Raises:
            PlanCancelledError: The call is cancelled.
            BaseException: The cancel function has raised it.
        """
        if self._failure is not None:
            raise self._failure
        if self.is_cancelled:
            raise PlanCancelledError(self.elapsed_s)

    def error(self, tried: Sequence[str]) -> HplanError:
        """Return the error for a passed deadline, with the methods tried.

        Raises:
            PlanCancelledError: The call is cancelled; the deadline has not passed.
            BaseException: The cancel function has raised it.
        """
        self.check_cancelled()
        return NotInTimeError(self.deadline_s or 0.0, self.elapsed_s, tried)

    def keep(self, seconds: float) -> None:
        """Reserve time: the deadline moves to `seconds` before the original one."""
        if self.deadline_s is not None:
            self._values[0] = self._begin + self.deadline_s - seconds


class _Garbage:
    """Postpones Python's garbage collection while any thread has a short deadline.

    Allocations during a call make a collection due, which would run in the last lines of the call. So the last call to
    end collects the youngest generation itself, and everything only if its remaining time suffices. Objects that the
    call holds until it returns are not garbage yet: the first call to start collects them after the call before (0.1
    ms). Otherwise they would move to the oldest generation, and the next full collection would take long.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._inside: list[TimeLimit] = []
        self._was_enabled = False
        self._all_s = 0.1

    def hold(self, limit: TimeLimit) -> None:
        """A short deadline starts."""
        with self._lock:
            if not self._inside:
                self._was_enabled = gc.isenabled()
                if self._was_enabled:
                    gc.collect(1)
                gc.disable()
            self._inside.append(limit)

    def release(self, limit: TimeLimit) -> None:
        """A short deadline ends."""
        with self._lock:
            self._inside.remove(limit)
            if self._inside or not self._was_enabled:
                return
            calls, begin = gc.get_count()[2], clock_s()
            # A due full collection waits for a call with enough remaining time, for at most this number of calls.
            postponed = 1000
            if calls > postponed or (calls > gc.get_threshold()[2] and limit.left_s > 2.0 * self._all_s):
                gc.collect()
                self._all_s = clock_s() - begin
            else:
                gc.collect(0)
            gc.enable()

    def begin_in_child(self) -> None:
        """Reset in a forked child, which has only the thread that forked."""
        was_held, self._lock = bool(self._inside), threading.RLock()
        self._inside = [limit for limit in self._inside if limit is _CURRENT.get()]
        if was_held and not self._inside and self._was_enabled:
            gc.enable()


_GARBAGE = _Garbage()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_GARBAGE.begin_in_child)


@contextmanager
def time_limit(deadline_s: float | None = None, cancel: Cancel | None = None) -> Iterator[TimeLimit]:
    """Start a time limit for the block; an outer limit takes precedence.

    Args:
        deadline_s: Duration of the limit [s]; None for no deadline.
        cancel: Cancels the call; a separate thread polls it every millisecond.

    Raises:
        OptionError: `cancel` is neither a function nor an event.
        PlanCancelledError: The call is cancelled.
        TimeIsUpError: The deadline has passed.
        BaseException: `cancel` has raised it.
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
    # Below this deadline garbage collection is postponed (`_Garbage`); with many objects it takes 0.1 s [s].
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
    """Call the cancel function, and cancel the limit if it says so."""
    try:
        if cancel.is_set() if isinstance(cancel, threading.Event) else cancel():
            limit.cancel()
    except BaseException as failure:  # an exception of the caller's function is raised in the planning thread
        limit.cancel(failure)


def _watch(limit: TimeLimit, cancel: Cancel, done: threading.Event) -> None:
    """Poll the cancel function until the limit ends."""
    # Polling period of cancellation [s].
    while not (limit.is_cancelled or done.wait(1e-3)):
        _ask(limit, cancel)


def current() -> TimeLimit | None:
    """Limit of the current call; None without a limit."""
    return _CURRENT.get()


def kernel_time_limit() -> FloatArray:
    """(3,) argument of kernels for the limit of the current call."""
    limit = _CURRENT.get()
    return NEVER if limit is None else limit.until


def is_over() -> bool:
    """True after the deadline or cancellation; for optional work."""
    limit = _CURRENT.get()
    return limit is not None and limit.is_up


def check_deadline() -> None:
    """Return unless the deadline has passed or the call is cancelled.

    Raises:
        TimeIsUpError: The deadline has passed, or the call is cancelled.
    """
    if is_over():
        raise TimeIsUpError


def clock_s() -> float:
    """Time on the clock of deadlines [s]."""
    return time.clock_gettime(CLOCK)


if nb.config.DISABLE_JIT:

    def _seconds(clock: int) -> float:
        return time.clock_gettime(clock)

else:
    # By its name, not its address, so that kernels that call it can be cached on disk.
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
    """True after the deadline or cancellation (finite limit; takes 0.2 us)."""
    up: bool = until[1] > 0.0 or _seconds(int(until[2])) >= until[0]
    return up


@inline
def is_up(until: FloatArray) -> bool:
    """True after the deadline or cancellation."""
    up: bool = until[0] < np.inf and _is_up(until)
    return up
