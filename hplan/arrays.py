"""Array types, and the one way to make an array read-only."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
ShortArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]
WordArray: TypeAlias = NDArray[np.uint64]

_T = TypeVar("_T", bound=np.generic)


def readonly(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A contiguous read-only array of its own with the given values."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def frozen(array: NDArray[_T]) -> NDArray[_T]:
    """The same array, made read-only; for results that nothing else holds."""
    array.setflags(write=False)
    return array
