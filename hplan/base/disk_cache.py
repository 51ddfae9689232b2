"""Results of expensive computations, kept on disk for later processes.

Files are named by a digest of all inputs, the computing code included, so they are never out of date. They carry a
checksum; a damaged file counts as missing. The cache is optional: if its folder cannot be read or written, results are
computed again.
"""

from __future__ import annotations

import hashlib
import io
import os
import secrets
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from hplan.base.arrays import frozen

#: Maximum size of the cache; the files that were not used for the longest time are removed [bytes].
_MOST_BYTES: Final = 500_000_000


def cache_folder() -> Path:
    """Folder of the cache: `$HPLAN_CACHE_DIR`, else `hplan` in the user's cache folder."""
    chosen = os.environ.get("HPLAN_CACHE_DIR")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "hplan")


def cached_arrays(
    parts: Iterable[bytes], code: Iterable[ModuleType], compute: Callable[[], Mapping[str, np.ndarray[Any, Any]]]
) -> Mapping[str, np.ndarray[Any, Any]]:
    """Arrays of a computation, from disk if they are there.

    Args:
        parts: All inputs of the computation, as bytes.
        code: The modules whose source determines the result.
        compute: Computes the arrays by name.

    Returns:
        The arrays, read-only.

    Examples:
        >>> import os, tempfile
        >>> import numpy as np
        >>> from hplan.base import disk_cache
        >>> os.environ["HPLAN_CACHE_DIR"] = tempfile.mkdtemp()
        >>> found = disk_cache.cached_arrays([b"two"], [disk_cache], lambda: {"square": np.array(4.0)})
        >>> float(disk_cache.cached_arrays([b"two"], [disk_cache], dict)["square"])
        4.0
        >>> del os.environ["HPLAN_CACHE_DIR"]
    """
    path = None
    with suppress(OSError, RuntimeError, TypeError):  # no home folder; code without a source file
        digest = hashlib.sha256()
        for part in (*parts, *(Path(module.__file__ or "").read_bytes() for module in code)):
            digest.update(len(part).to_bytes(8, "little"))
            digest.update(part)
        path = cache_folder() / f"{digest.hexdigest()[:40]}.npz"
    found = None if path is None else _read_arrays(path)
    if found is None:
        found = compute()
        if path is not None:
            with suppress(OSError):
                _write_arrays(path, found)
    return {name: frozen(np.asarray(array)) for name, array in found.items()}


def _read_arrays(path: Path) -> Mapping[str, np.ndarray[Any, Any]] | None:
    """Read a file of the cache; None if it is missing or damaged."""
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[32:]).digest() != content[:32]:
            return None
        with suppress(OSError):
            os.utime(path)
        with np.load(io.BytesIO(content[32:]), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError):
        return None


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Write a file of the cache at once, and remove old ones if the cache is too large."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}")
    try:
        temporary.write_bytes(hashlib.sha256(buffer.getvalue()).digest() + buffer.getvalue())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    files = sorted((found.stat().st_mtime_ns, found.stat().st_size, found) for found in path.parent.glob("*.npz"))
    excess = sum(size for _, size, _ in files) - _MOST_BYTES
    for _, size, old in files:
        if excess <= 0:
            break
        old.unlink(missing_ok=True)
        excess -= size
