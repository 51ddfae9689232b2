"""Functions compiled by numba, once, and kept on disk next to their source.

numba ends the program where neither the package's folder nor the user's cache can be written, and where a file of the
cache is damaged. Neither keeps a kernel from being compiled, so it is, and a `KernelCacheWarning` says so once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba as nb
import numpy as np
from numba.core.caching import FunctionCache

P = ParamSpec("P")
R = TypeVar("R")

#: Warnings given already.
_GIVEN: set[str] = set()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A compiled function, for Python and other kernels to call.

    It gets no entry for C, which would take a fifteenth of the time to compile. Division by zero gives inf or NaN, as
    in NumPy: looking for zeros would keep loops from being made fast. Python's lock is released while one runs, so that
    other threads go on. Every combination of argument types is
    compiled on its own. Read-only arrays are a type of their own, and so is every number written out in a call from
    kernel to kernel; so a kernel is called with the same kinds everywhere. Arrays go in named tuples; one taken out of
    a tuple, or given to an inlined function, is counted at about 10 ns: before a loop, not in it.
    """
    compiled: Callable[P, R] = nb.njit(no_cfunc_wrapper=True, error_model="numpy", nogil=True)(function)
    _keep_on_disk(compiled)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function put into each kernel that calls it: for a few lines with many arguments, which cost more than they do.

    Kernels on disk are not made anew when what they take from another file changes: inlined functions, constants.
    """
    compiled: Callable[P, R] = nb.njit(inline="always")(function)
    _keep_on_disk(compiled)
    return compiled


def any_int(number: int) -> int:
    """A constant that kernels may pass to one another without having the one called compiled for this very number."""
    return cast(int, np.int64(number))


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be read from disk or kept there."""


def _keep_on_disk(compiled: Any) -> None:
    """Let a function that numba compiles be kept on disk, where there is a place for it.

    Args:
        compiled: What `numba.njit` returns; a plain function where compiling is switched off.
    """
    if not hasattr(compiled, "enable_caching"):
        return
    try:
        compiled._cache = _DiskCache(compiled.py_func)
    except (OSError, RuntimeError) as error:
        _warn_once(
            "kept",
            "compiled kernels cannot be kept: neither the package's folder nor the user's cache folder can be written "
            f"({error}). They are compiled in every run, which takes most of a minute; NUMBA_CACHE_DIR names another "
            "folder",
        )


def can_be_kept(compiled: Any) -> bool:
    """True if there is a place on disk for what a function is compiled to."""
    return isinstance(getattr(compiled, "_cache", None), _DiskCache)


def is_kept(compiled: Callable[..., Any]) -> bool:
    """True if a function, as it stands in its file, is on disk, compiled for this processor.

    numba itself is asked, which knows the source by its content (older ones: by its time and size). The times of the
    files on disk say nothing: a copy may keep them, an installer may set them.
    """
    cache = getattr(compiled, "_cache", None)
    return isinstance(cache, _DiskCache) and cache.holds_any(compiled.targetctx.codegen())  # type: ignore[attr-defined]


class _DiskCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, no fault of which ends the program."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code compiled for these types; None where there is none, or none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # whatever reading a damaged pickle raises
            self._report("read", error)
            self._forget()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for these types, if that can be done."""
        try:
            try:
                super().save_overload(sig, data)
            except Exception:  # the index is damaged; with nothing in it, it is written anew
                self.flush()
                super().save_overload(sig, data)
        except Exception as error:  # no room, no permission
            self._report("written", error)

    def holds_any(self, codegen: Any) -> bool:
        """True if there is anything for a processor."""
        try:
            overloads = self._cache_file._load_index()
        except Exception:  # whatever reading a damaged pickle raises
            return False
        return any(target == codegen.magic_tuple() for _, target, _ in overloads)

    def _forget(self) -> None:
        try:
            self.flush()
        except OSError as error:
            self._report("written", error)

    def _report(self, how: str, error: Exception) -> None:
        reason = f"{type(error).__name__}: {error}"
        _warn_once(how, f"compiled kernels in {self.cache_path} cannot be {how} ({reason}); they are compiled anew")


def _warn_once(what: str, message: str) -> None:
    """Warn of what cannot be done with kernels on disk, for the first kernel alone."""
    if what not in _GIVEN:
        _GIVEN.add(what)
        warnings.warn(message, KernelCacheWarning, stacklevel=2)
