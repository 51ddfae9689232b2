"""Elementary functions with the same last bit for all vector instruction sets.

NumPy has separate AVX2 and AVX-512 code for arctan2, arccos, absolute value and complex products, with different
results. These functions call the C library element by element. (NumPy's sine, cosine and complex exponential already
agree.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import ComplexArray, FloatArray

_ATAN2, _ACOS = np.frompyfunc(math.atan2, 2, 1), np.frompyfunc(math.acos, 1, 1)


def arctan2(y: ArrayLike, x: ArrayLike) -> FloatArray:
    """Angles of points (x, y) in [-pi, pi]; the arrays broadcast."""
    return np.asarray(_ATAN2(y, x), dtype=np.float64)


def arccos(cosines: FloatArray) -> FloatArray:
    """Angles in [0, pi]; cosines outside [-1, 1] are clamped."""
    return np.asarray(_ACOS(np.minimum(np.maximum(cosines, -1.0), 1.0)), dtype=np.float64)


def argument(points: ComplexArray) -> FloatArray:
    """Angles of complex numbers in [-pi, pi]."""
    return arctan2(points.imag, points.real)


def modulus(points: ComplexArray) -> FloatArray:
    """Absolute values of complex numbers; their squares must not overflow."""
    distances: FloatArray = np.sqrt(points.real * points.real + points.imag * points.imag)
    return distances


def product(first: ComplexArray, second: ComplexArray) -> ComplexArray:
    """Products of complex numbers; the arrays broadcast."""
    a, b, c, d = first.real, first.imag, second.real, second.imag
    products: ComplexArray = np.empty(np.broadcast_shapes(first.shape, second.shape), dtype=np.complex128)
    products.real, products.imag = a * c - b * d, a * d + b * c
    return products
