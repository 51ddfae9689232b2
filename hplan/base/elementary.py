"""Functions of arrays that give the same last bit whatever vector instructions a processor has.

NumPy's own arctan2, arccos, absolute value and product of complex numbers have code of their own for AVX2 and for
AVX512, and so results of their own. These are the C library's, element by element. (NumPy's sine, cosine and complex
exponential already are.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import ComplexArray, FloatArray
from hplan.base.kernels import kernel


def arctan2(y: ArrayLike, x: ArrayLike) -> FloatArray:
    """Angles of points (x, y), in [-pi, pi]; the arrays broadcast."""
    rows, columns = np.broadcast_arrays(np.asarray(y, dtype=np.float64), np.asarray(x, dtype=np.float64))
    angles: FloatArray = _arctan2(np.array(rows.ravel()), np.array(columns.ravel())).reshape(rows.shape)
    return angles


def arccos(cosines: FloatArray) -> FloatArray:
    """Angles in [0, pi]; NaN for what is no cosine."""
    angles: FloatArray = _arccos(np.array(cosines.ravel())).reshape(cosines.shape)
    return angles


def argument(points: ComplexArray) -> FloatArray:
    """Angles of complex numbers, in [-pi, pi]."""
    return arctan2(points.imag, points.real)


def modulus(points: ComplexArray) -> FloatArray:
    """Absolute values of complex numbers (of a size whose square is a number)."""
    distances: FloatArray = np.sqrt(points.real * points.real + points.imag * points.imag)
    return distances


def product(first: ComplexArray, second: ComplexArray) -> ComplexArray:
    """Products of complex numbers; the arrays broadcast."""
    a, b, c, d = first.real, first.imag, second.real, second.imag
    products: ComplexArray = np.empty(np.broadcast_shapes(first.shape, second.shape), dtype=np.complex128)
    products.real, products.imag = a * c - b * d, a * d + b * c
    return products


@kernel
def _arctan2(y: FloatArray, x: FloatArray) -> FloatArray:
    angles = np.empty(len(y))
    for i in range(len(y)):
        angles[i] = math.atan2(y[i], x[i])
    return angles


@kernel
def _arccos(cosines: FloatArray) -> FloatArray:
    angles = np.empty(len(cosines))
    for i in range(len(cosines)):
        angles[i] = math.acos(cosines[i])
    return angles
