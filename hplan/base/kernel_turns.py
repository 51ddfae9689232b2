"""Processes that compile kernels beside one another: each kernel by one of them, and told to whoever shows progress.

This imports nothing heavy, so that a command can ask to be told before numba is there.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

#: Each is called before a kernel is compiled, with its name and how many kernels were called so far, this one included.
LISTENERS: list[Callable[[str, int], None]] = []

#: How long another process is waited for, and how often it is asked whether it is done [s].
_PATIENCE_S, _ASKED_S = 120.0, 0.05


def wait_for_turn(folder: Path, name: str) -> bool:
    """Wait until no other process compiles what will be a file of this name; this one does then, until `end_turn`.

    A process that ends gives its turns back. One that takes too long is no longer waited for.

    Returns:
        True if another process did: the file may be there now.

    Raises:
        OSError: Nothing can be written there.
    """
    begin = time.monotonic()
    waited = False
    while time.monotonic() - begin < _PATIENCE_S:
        try:
            fcntl.lockf(_opened(folder), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(name))
            break
        except (BlockingIOError, PermissionError):
            waited = True
            time.sleep(_ASKED_S)
    return waited


def end_turn(folder: Path, name: str) -> None:
    """Let others have what `wait_for_turn` waited for.

    Raises:
        OSError: Nothing can be written there.
    """
    fcntl.lockf(_opened(folder), fcntl.LOCK_UN, 1, _place(name))


@lru_cache
def _opened(folder: Path) -> int:
    """Kept open: closing it would end all turns of this process."""
    folder.mkdir(parents=True, exist_ok=True)
    # Of its bytes one is locked for each kernel.
    return os.open(folder / "turns.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _place(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6])
