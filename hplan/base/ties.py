"""Choices that come out the same on every machine.

Numbers that are equal by their meaning differ in their last bits where sums are taken in another order, as NumPy and
OpenBLAS do from processor to processor. A choice compares such numbers on a raster: then they are equal, and the one
with the smaller index is taken. Sums of numbers on the raster are exact, in any order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray

#: Spacing of the raster: a power of two, far above rounding errors and far below what matters (1 nm, 1 nrad, 1 ns).
RASTER = 2.0**-30


def on_raster(values: ArrayLike) -> FloatArray:
    """The nearest multiples of 2^-30; what is not finite stays as it is.

    Args:
        values: (...) numbers below 2^22 or so in size; larger ones have no digits below the raster.
    """
    rounded: FloatArray = np.array(values, dtype=np.float64)
    rounded /= RASTER
    np.rint(rounded, out=rounded)
    rounded *= RASTER
    return rounded


def argsort(values: ArrayLike) -> IntArray:
    """(n,) indices of values in ascending order, of those that tie the smaller index first."""
    return np.argsort(on_raster(values), kind="stable")


def argmin(values: ArrayLike) -> int:
    """Index of the smallest value, the first of those that tie."""
    return int(np.argmin(on_raster(values)))


def argmax(values: ArrayLike) -> int:
    """Index of the largest value, the first of those that tie."""
    return int(np.argmax(on_raster(values)))
