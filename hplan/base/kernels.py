"""How functions are compiled: by numba, once, and kept on disk beside their source."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba as nb
import numpy as np

from hplan.base.kernel_cache import keep_on_disk

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A compiled function, for Python and other kernels to call.

    It gets no entry for C, which would take a fifteenth of the time to compile. Division by zero gives inf or NaN, as
    in NumPy: looking for zeros would keep loops from being made fast. Every combination of argument types is
    compiled on its own. Read-only arrays are a type of their own, and so is every number written out in a call from
    kernel to kernel; so a kernel is called with the same kinds everywhere.
    """
    compiled: Callable[P, R] = nb.njit(no_cfunc_wrapper=True, error_model="numpy")(function)
    keep_on_disk(compiled)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function put into each kernel that calls it: for a few lines with many arguments, which cost more than they do.

    Kernels on disk are not made anew when what they take from another file changes: inlined functions, constants.
    """
    compiled: Callable[P, R] = nb.njit(inline="always")(function)
    keep_on_disk(compiled)
    return compiled


def any_int(number: int) -> int:
    """A constant that kernels may pass to one another without having the one called compiled for this very number."""
    return cast(int, np.int64(number))
