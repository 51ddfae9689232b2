"""Signals that end a program, raised as exceptions only where Python code can be left.

Python runs a signal's handler between any two of its instructions. An exception that is raised there may leave a
compiler, an import, a destructor or a callback of native code half done: it is lost, or the process crashes. So inside
of these the handler waits, and asks again some milliseconds later. Other code that must run to its end is put into
`uninterrupted`.
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

#: Ctrl-C, `kill`, and a terminal that is closed.
_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: While a signal waits, the code that runs is looked at this often [s].
_POLL_S: Final = 0.01

#: Signals that come within this time of the first are the same wish; a later one is urgent [s].
_SAME_S: Final = 1.0

#: Packages in whose code no exception is raised, and functions.
_UNSAFE_PACKAGES: Final = frozenset(
    ("numba", "llvmlite", "importlib", "_frozen_importlib", "_frozen_importlib_external", "ctypes", "weakref", "cffi")
)
_UNSAFE_MODULES: Final = frozenset(
    ("hplan.base.kernels", "hplan.base.kernel_turns", "hplan.base.kernel_digest", "hplan.base.forking")
)
_UNSAFE_FUNCTIONS: Final = frozenset(("__del__", "_release_lock", "register_at_fork"))

_Handler: TypeAlias = Callable[[int, FrameType | None], object] | int | None


class SignalError(BaseException):
    """A signal other than that of Ctrl-C has ended the program; that one raises `KeyboardInterrupt`.

    Attributes:
        number: The signal's number.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


#: Errors that signals raise.
INTERRUPTS: Final = (KeyboardInterrupt, SignalError)


def signal_of(error: BaseException) -> signal.Signals:
    """The signal that has raised an error of `INTERRUPTS`."""
    return signal.Signals(error.number) if isinstance(error, SignalError) else signal.SIGINT


class _Waiting:
    """The signal that has come, and whether it has been raised.

    Attributes:
        depth: Number of blocks of `uninterrupted` that the main thread is in.
        number: The signal; 0 for none.
        first_s: When it came [s].
        raised_s: When it was last raised; infinite if it has not been [s].
        is_handled: Whether signals are handled by this module.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.number = 0
        self.first_s = 0.0
        self.raised_s = float("inf")
        self.is_handled = False

    def reset(self) -> None:
        """Forget a signal that has come."""
        self.number, self.raised_s = 0, float("inf")

    def come(self, number: int, frame: FrameType | None) -> None:
        """Take a signal: raise it, now or as soon as that is safe; at the third one end the process."""
        now = time.monotonic()
        if not self.number:
            self.number, self.first_s = number, now
            self.look(frame)
        elif now > self.raised_s + _SAME_S:
            leave(128 + number)
        elif self.raised_s == float("inf") and now > self.first_s + _SAME_S and not self.depth:
            self.throw()

    def look(self, frame: FrameType | None) -> None:
        """Raise the signal if that is safe in the code that runs, else look again later."""
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
        """The timer's handler."""
        if self.number and self.raised_s == float("inf"):
            self.look(frame)


_WAITING = _Waiting()


def _is_safe(frame: FrameType | None) -> bool:
    """True if an exception may be raised in a frame: no caller of it is in code that must not be left."""
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
    """Inside, signals that end the program are raised at safe places; other handlers stay in place."""
    if threading.current_thread() is not threading.main_thread() or _WAITING.is_handled:
        yield
        return
    usual: tuple[_Handler, ...] = (signal.SIG_DFL, signal.default_int_handler)
    mine = {number: signal.getsignal(number) for number in (*_ENDING, signal.SIGALRM)}
    mine = {number: handler for number, handler in mine.items() if handler in usual}
    if signal.SIGALRM not in mine:  # the caller's own timer
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
def uninterrupted() -> Iterator[None]:
    """Inside, no signal is raised in the main thread, if `handling_signals` handles them; it is raised afterwards."""
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
    """Processes started inside are not interrupted by Ctrl-C at the terminal; their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave(status: int) -> NoReturn:
    """End the process at once: interrupted native code must not be torn down piece by piece."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (AttributeError, OSError, ValueError):
            continue
    os._exit(status)
