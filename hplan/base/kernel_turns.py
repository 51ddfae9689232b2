"""Locks that let concurrent processes compile each kernel once; progress listeners.

Imports no heavy module, so that a command can register a listener before numba is loaded.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

#: Each is called before a kernel is compiled, with its name and the number of kernels called up to and including it.
LISTENERS: list[Callable[[str, int], None]] = []

#: Maximum waiting time for another process, and polling period [s].
_PATIENCE_S, _ASKED_S = 120.0, 0.05


def wait_for_turn(folder: Path, name: str) -> bool:
    """Lock a file name against other processes until `end_turn`; wait if locked.

    The operating system releases the locks of a process that ends. After `_PATIENCE_S` the wait is given up.

    Returns:
        True if another process held the lock: the file may exist now.

    Raises:
        OSError: The folder is not writable.
    """
    begin = time.monotonic()
    waited = False
    while time.monotonic() - begin < _PATIENCE_S:
        try:
            fcntl.lockf(_open_lock_file(folder), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(name))
            break
        except (BlockingIOError, PermissionError):
            waited = True
            time.sleep(_ASKED_S)
    return waited


def end_turn(folder: Path, name: str) -> None:
    """Release the lock of `wait_for_turn`.

    Raises:
        OSError: The folder is not writable.
    """
    fcntl.lockf(_open_lock_file(folder), fcntl.LOCK_UN, 1, _place(name))


@lru_cache
def _open_lock_file(folder: Path) -> int:
    """Open the lock file, for good: closing it would release all locks."""
    folder.mkdir(parents=True, exist_ok=True)
    # Each kernel locks one byte.
    return os.open(folder / "turns.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _place(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6])
