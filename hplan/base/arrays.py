"""Array types, read-only arrays, frozen dataclasses with arrays, array checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import PurePath
from types import EllipsisType, MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hplan.errors import InputError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
ShortArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]
WordArray: TypeAlias = NDArray[np.uint64]
ComplexArray: TypeAlias = NDArray[np.complex128]

#: A structured array: kernels read a field of a row as an attribute, NumPy a whole column by its name.
TableArray: TypeAlias = np.ndarray[Any, np.dtype[Any]]

_T = TypeVar("_T", bound=np.generic)

#: A `repr` shows arrays and lists with more items by their sizes.
MOST_SHOWN = 8


def readonly(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a contiguous read-only copy of the values."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def frozen(array: NDArray[_T]) -> NDArray[_T]:
    """Make an array itself read-only; for arrays without another owner."""
    array.setflags(write=False)
    return array


def as_array(values: Any) -> NDArray[Any]:
    """Return `np.asarray(values)`, with NaN for masked values.

    Raises:
        ValueError: `values` cannot become an array, for example rows of different lengths; any exception of the object.
    """
    try:
        if isinstance(values, np.ma.MaskedArray) and np.ma.getmaskarray(values).any():
            values = np.ma.filled(values.astype(np.float64), np.nan)
        return np.asarray(values)
    except Exception as error:
        raise ValueError(str(error)) from error


def numbers(
    option: str, values: Any, shape: tuple[int | EllipsisType | None, ...], *, most: float = np.inf
) -> FloatArray:
    """Return a read-only array of finite numbers with the given shape.

    In `shape`, None matches any length and a leading `...` any number of axes.

    Raises:
        InputError: `values` has another shape, or a value is not a finite number or has a magnitude above `most`.
    """
    try:
        array = as_array(values)
    except ValueError as error:
        reason = f"{option}: expected {_describe_shape(shape)}, got rows of different lengths"
        raise InputError(reason, option=option) from error
    if array.size and array.dtype.kind not in "fiu":
        reason = f"{option}: expected {_describe_shape(shape)}, got {_shorten_repr(values)}"
        raise InputError(reason, option=option)
    last = shape[1:] if shape[:1] == (...,) else shape
    fits = (array.ndim == len(shape) or (last is not shape and array.ndim >= len(last))) and all(
        wanted is None or wanted == count for wanted, count in zip(reversed(last), reversed(array.shape), strict=False)
    )
    if not fits:
        raise InputError(f"{option} has shape {array.shape}, expected {_describe_shape(shape)}", option=option)
    if array.dtype == np.float64:
        result = readonly(array)
    else:
        with np.errstate(over="ignore"):  # float128 values may overflow float64
            result = readonly(array)
    if not np.isfinite(result).all():
        place = np.argwhere(~np.isfinite(result))[0].tolist()
        raise InputError(
            f"{option} holds a value that is not finite: {result[tuple(place)]} at {place}", option=option, place=place
        )
    if most < np.inf and (np.abs(result) > most).any():
        place = np.argwhere(np.abs(result) > most)[0].tolist()
        reason = f"{option} holds {result[tuple(place)]:g} at {place}, expected at most {most:g}"
        raise InputError(reason, option=option, place=place)
    return result


def _describe_shape(shape: tuple[int | EllipsisType | None, ...]) -> str:
    words = ", ".join("n" if count is None else "..." if count is ... else str(count) for count in shape)
    return f"({words},), a list of finite numbers" if len(shape) == 1 else f"({words}) finite numbers"


def _shorten_repr(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


class Unquoted(str):
    """A string whose `repr` has no quotes: placeholder for a long value."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def _brief(value: object) -> str:
    """Short `repr`: small values as in Python, others by type and size."""
    if isinstance(value, np.ndarray):
        if value.ndim <= 1 and value.size <= MOST_SHOWN:
            return np.array2string(value, precision=6, separator=", ", max_line_width=10_000)
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, str | bool | int | float | complex | PurePath | type(None)):
        return _shorten_repr(value)
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        if len(value) > MOST_SHOWN:
            return f"<{len(value)} items>"
        opening, closing = ("(", ",)" if len(value) == 1 else ")") if isinstance(value, tuple) else "[]"
        return f"{opening}{', '.join(map(_brief, value))}{closing}"
    if isinstance(value, Mapping):
        return f"<{len(value)} keys>" if value else "{}"
    return f"{type(value).__name__}(...)"


class Record:
    """Base of frozen dataclasses: pickles and copies fields, keeps arrays read-only.

    NumPy drops the read-only flag in a pickle; `__setstate__` restores it. Cached properties are not pickled. `repr` is
    short for any field: arrays by their shapes, other objects by their classes.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        """Set the inherited `__repr__` on the class, so that `@dataclass` keeps it."""
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        shown = (field.name for field in fields(self) if field.repr)  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(f'{name}={_brief(getattr(self, name))}' for name in shown)})"

    def __getstate__(self) -> dict[str, tuple[Any, bool]]:
        """Return each field's value and whether to make it read-only again."""
        state = {}
        for field in fields(self):  # type: ignore[arg-type]  # subclasses are dataclasses
            value = getattr(self, field.name)
            if isinstance(value, MappingProxyType):
                state[field.name] = dict(value), True
            else:
                held = value if isinstance(value, tuple) else (value,)  # named tuples of arrays
                state[field.name] = value, any(isinstance(x, np.ndarray) and not x.flags.writeable for x in held)
        return state

    def __setstate__(self, state: dict[str, tuple[Any, bool]]) -> None:
        """Restore the fields without checks; the constructor has checked them."""
        for name, (value, read_only) in state.items():
            if read_only:
                if isinstance(value, tuple):
                    value = type(value)(*map(frozen, value))
                else:
                    value = frozen(value) if isinstance(value, np.ndarray) else MappingProxyType(value)
            object.__setattr__(self, name, value)
