"""Selections with reproducible tie-breaking on every machine.

Mathematically equal numbers differ in their last bits if sums are taken in another order, as in NumPy and OpenBLAS on
different processors. A selection compares such numbers rounded to a grid: then they are equal, and the smaller index
wins. Sums of grid numbers are exact in any order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray

#: Grid spacing: a power of two, far above rounding errors and far below relevant sizes (1 nm, 1 nrad, 1 ns).
RASTER = 2.0**-30


def on_raster(values: ArrayLike) -> FloatArray:
    """Round to the nearest multiples of 2^-30; non-finite values are kept.

    Args:
        values: (...) numbers with magnitudes below about 2^22; larger ones have no digits below the grid.
    """
    rounded: FloatArray = np.array(values, dtype=np.float64)
    rounded /= RASTER
    np.rint(rounded, out=rounded)
    rounded *= RASTER
    return rounded


def argsort(values: ArrayLike) -> IntArray:
    """(n,) indices that sort values in ascending order; ties by index."""
    return np.argsort(on_raster(values), kind="stable")


def argmin(values: ArrayLike) -> int:
    """Index of the minimum; the first of tied values."""
    return int(np.argmin(on_raster(values)))


def argmax(values: ArrayLike) -> int:
    """Index of the maximum; the first of tied values."""
    return int(np.argmax(on_raster(values)))
