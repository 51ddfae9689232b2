"""Checks of the arrays that public functions are given, as `hplan.base.arguments` for other values."""

from __future__ import annotations

from typing import Any

import numpy as np

from hplan.base.arrays import FloatArray, readonly
from hplan.errors import InputError


def numbers(option: str, values: Any, shape: tuple[int | None, ...]) -> FloatArray:
    """A read-only array of finite numbers; None in the shape stands for any count.

    Raises:
        InputError: It is none.
    """
    words = ", ".join("n" if count is None else str(count) for count in shape)
    expected = f"({words},), a list of finite numbers" if len(shape) == 1 else f"({words}) finite numbers"
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{option}: expected {expected}, got rows of different lengths", option=option) from error
    if array.size and array.dtype.kind not in "fiu":
        raise InputError(f"{option}: expected {expected}, got {_short(values)}", option=option)
    fits = array.ndim == len(shape) and all(
        wanted is None or wanted == count for wanted, count in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise InputError(f"{option} has shape {array.shape}, expected {expected}", option=option)
    with np.errstate(over="ignore"):  # of longer floats
        result = readonly(array)
    if not np.isfinite(result).all():
        place = np.argwhere(~np.isfinite(result))[0].tolist()
        raise InputError(
            f"{option} holds a value that is not finite: {result[tuple(place)]} at {place}", option=option, place=place
        )
    return result


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
