"""Array types, the one way to make an array read-only, and the base of frozen dataclasses that hold such arrays."""

from __future__ import annotations

from dataclasses import fields
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
ShortArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]
WordArray: TypeAlias = NDArray[np.uint64]
ComplexArray: TypeAlias = NDArray[np.complex128]

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


class Record:
    """Base of frozen dataclasses: pickled and copied by their fields, what was read-only is so again.

    NumPy forgets in a pickle that an array was read-only. Cached properties stay behind.
    """

    def __getstate__(self) -> dict[str, tuple[Any, bool]]:
        """The value of each field, and whether it is to be made read-only again."""
        state = {}
        for field in fields(self):  # type: ignore[arg-type]  # subclasses are dataclasses
            value = getattr(self, field.name)
            if isinstance(value, MappingProxyType):
                state[field.name] = dict(value), True
            else:
                state[field.name] = value, isinstance(value, np.ndarray) and not value.flags.writeable
        return state

    def __setstate__(self, state: dict[str, tuple[Any, bool]]) -> None:
        """Take the fields over as they are; they were checked when they were first given."""
        for name, (value, read_only) in state.items():
            if read_only:
                value = frozen(value) if isinstance(value, np.ndarray) else MappingProxyType(value)
            object.__setattr__(self, name, value)
