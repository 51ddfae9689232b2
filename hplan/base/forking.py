"""Safe forks of a process with several threads.

A forked child has one thread and a copy of every lock: a lock held by another thread is never released. A fork in the
middle of an LLVM call would also corrupt LLVM. So a fork waits until no thread compiles or loads a kernel, and hplan's
own locks are reset in the child.
"""

from __future__ import annotations

import gc
import os
from functools import cached_property
from typing import Any, TypeVar
from weakref import WeakSet

from llvmlite.binding import ffi
from numba.core.compiler_lock import global_compiler_lock

L = TypeVar("L")

_RENEWED: WeakSet[Any] = WeakSet()


def renewed_in_children(lock: L) -> L:
    """Register a `threading` lock that is reset in forked children; returns it."""
    _RENEWED.add(lock)
    return lock


def _hold() -> None:
    global_compiler_lock.acquire()
    ffi.lib._lock.__enter__()


def _release() -> None:
    ffi.lib._lock.__exit__(None, None, None)
    global_compiler_lock.release()


def _renew() -> None:
    _release()
    # Before Python 3.12 a cached property has one lock for all objects. `gc.get_objects` does not list frozen objects.
    was_frozen = gc.get_freeze_count() > 0
    gc.unfreeze()
    computing = [each.__dict__.get("lock") for each in gc.get_objects() if type(each) is cached_property]
    if was_frozen:
        gc.freeze()
    for lock in (*_RENEWED, *computing):
        if lock is not None:
            lock._at_fork_reinit()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_parent=_release, after_in_child=_renew)
