"""Termination signals, raised as exceptions only at safe points of Python code.

Python runs a signal handler between any two of its instructions. An exception raised there may interrupt a compiler,
an import, a destructor or a callback of native code: the exception is lost, or the process crashes. So the handler
waits while such code runs, and checks again some milliseconds later. Other code that must run to its end is put into
`defer_signals`.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, NoReturn, TypeAlias

#: Ctrl-C, `kill`, and a closed terminal.
_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: While a signal is pending, the running code is checked with this period [s].
_POLL_S: Final = 0.01

#: Signals within this time of the first count as the same request; a later one is urgent [s].
_SAME_REQUEST_S: Final = 1.0

#: Packages, modules and functions that no exception may interrupt.
_UNSAFE_PACKAGES: Final = frozenset(
    ("numba", "llvmlite", "importlib", "_frozen_importlib", "_frozen_importlib_external", "ctypes", "weakref", "cffi")
)
_UNSAFE_MODULES: Final = frozenset(
    ("hplan.base.kernels", "hplan.base.kernel_turns", "hplan.base.kernel_digest", "hplan.base.forking")
)
_UNSAFE_FUNCTIONS: Final = frozenset(("__del__", "_release_lock", "register_at_fork"))

_Handler: TypeAlias = Callable[[int, FrameType | None], object] | int | None


class SignalError(BaseException):
    """A termination signal other than Ctrl-C, which raises `KeyboardInterrupt`.

    Attributes:
        number: Number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


#: Exceptions raised by signals.
INTERRUPTS: Final = (KeyboardInterrupt, SignalError)


def signal_of(error: BaseException) -> signal.Signals:
    """The signal that raised an exception of `INTERRUPTS`."""
    return signal.Signals(error.number) if isinstance(error, SignalError) else signal.SIGINT


class _Waiting:
    """The pending signal.

    Attributes:
        depth: Number of nested `defer_signals` blocks of the main thread.
        number: Number of the signal; 0 for none.
        first_s: Time of its arrival [s].
        raised_s: Time of the last raise [s]; infinite before the first.
        is_handled: True if this module handles signals.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.number = 0
        self.first_s = 0.0
        self.raised_s = float("inf")
        self.is_handled = False

    def reset(self) -> None:
        """Forget the pending signal."""
        self.number, self.raised_s = 0, float("inf")

    def come(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: raise it as soon as that is safe.

        A second signal more than `_SAME_REQUEST_S` after the first raises it at once, except in `defer_signals`. A
        signal more than `_SAME_REQUEST_S` after the raise ends the process.
        """
        now = time.monotonic()
        if not self.number:
            self.number, self.first_s = number, now
            self.look(frame)
        elif now > self.raised_s + _SAME_REQUEST_S:
            leave(128 + number)
        elif self.raised_s == float("inf") and now > self.first_s + _SAME_REQUEST_S and not self.depth:
            self.throw()

    def look(self, frame: FrameType | None) -> None:
        """Raise the signal if the running code allows it, else retry later."""
        if self.depth or not _is_safe(frame):
            signal.setitimer(signal.ITIMER_REAL, _POLL_S)
        else:
            self.throw()

    def throw(self) -> NoReturn:
        """Raise the signal."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        self.raised_s = time.monotonic()
        if self.number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SignalError(self.number)

    def look_again(self, _: int, frame: FrameType | None) -> None:
        """Handler of the retry timer."""
        if self.number and self.raised_s == float("inf"):
            self.look(frame)


_WAITING = _Waiting()


def _is_safe(frame: FrameType | None) -> bool:
    """True if an exception may be raised in a frame.

    No caller of the frame may be code that must run to its end.
    """
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if (
            name in _UNSAFE_MODULES
            or name.partition(".")[0] in _UNSAFE_PACKAGES
            or frame.f_code.co_name in _UNSAFE_FUNCTIONS
        ):
            return False
        frame = frame.f_back
    return True


@contextmanager
def handling_signals() -> Iterator[None]:
    """Inside, termination signals are raised at safe points; custom handlers stay."""
    if threading.current_thread() is not threading.main_thread() or _WAITING.is_handled:
        yield
        return
    usual: tuple[_Handler, ...] = (signal.SIG_DFL, signal.default_int_handler)
    mine = {number: signal.getsignal(number) for number in (*_ENDING, signal.SIGALRM)}
    mine = {number: handler for number, handler in mine.items() if handler in usual}
    if signal.SIGALRM not in mine:  # the caller has a timer of its own
        yield
        return
    _WAITING.reset()
    _WAITING.is_handled = True
    try:
        for number in mine:
            signal.signal(number, _WAITING.look_again if number == signal.SIGALRM else _WAITING.come)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in mine.items():
            signal.signal(number, handler)
        _WAITING.is_handled = False


@contextmanager
def defer_signals() -> Iterator[None]:
    """Inside, `handling_signals` raises no signal in the main thread.

    A pending signal is raised afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _WAITING.depth += 1
    try:
        yield
    finally:
        _WAITING.depth -= 1


@contextmanager
def children_not_interrupted() -> Iterator[None]:
    """Processes started inside ignore Ctrl-C at the terminal; their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave(status: int) -> NoReturn:
    """End the process immediately, without cleanup.

    Interrupted native code must not be torn down piece by piece.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (AttributeError, OSError, ValueError):
            continue
    os._exit(status)
