"""Checks of public function arguments: each returns the value or raises `OptionError`.

The error names the option, its value and the expected value. These functions check values, not calls: a wrong number
of arguments is Python's own `TypeError`. Arrays are checked by `hplan.base.arrays.numbers`; this module does not
import NumPy, because commands check paths before NumPy is loaded.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, TypeVar

from hplan.errors import OptionError

_T = TypeVar("_T")

#: A number in a file: digits 0 to 9, point, exponent; not `1_0`, `infinity`, `0x1` or digits of other scripts.
DECIMAL: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


#: Maximum number of names that an error lists.
_MOST_NAMES: Final = 12


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return advice for a misspelt name: the closest known name, or all."""
    names = list(known)
    close = get_close_matches(name, names, 1)
    return f"did you mean {close[0]!r}?" if close else f"there are {list_names(names) or 'none'}"


def list_names(names: Sequence[str]) -> str:
    """The names as text, separated by commas; of many only the first ones and the number of the others."""
    shown = names if len(names) <= _MOST_NAMES else names[: _MOST_NAMES - 2]
    return ", ".join(shown) + ("" if shown is names else f" and {len(names) - len(shown)} more")


def is_number(value: object) -> bool:
    """True for a finite real number; False for a bool."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the range of float
        return False


def number(option: str, value: Any, expected: str, accepts: Callable[[float], bool] = lambda _: True) -> float:
    """Return a finite number that satisfies `accepts`."""
    if not (is_number(value) and accepts(float(value))):
        raise OptionError(option, value, expected)
    return float(value)


def by_name(option: str, value: Any, expected: str, accepts: Callable[[float], bool]) -> Any:
    """Return a finite number that satisfies `accepts`, or a mapping of them.

    Raises:
        OptionError: `value` is neither.
    """
    if not isinstance(value, Mapping) or not value:
        return number(option, value, expected, accepts)
    return {str(name): number(f"{option}[{name!r}]", each, expected, accepts) for name, each in value.items()}


def check_between(option: str, value: Any, low: float, high: float) -> float:
    """Return a number in the closed interval [low, high]."""
    return number(option, value, f"a number between {low:g} and {high:g}", lambda value: low <= value <= high)


def check_integer(option: str, value: Any, least: int, most: int | None = None) -> int:
    """Return an integer from `least` to `most`; None for no maximum."""
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_whole or value < least or (most is not None and value > most):
        raise OptionError(option, value, f"a whole number >= {least}" + ("" if most is None else f" and <= {most}"))
    return int(value)


def truth(option: str, value: Any) -> bool:
    """Return a bool."""
    if not isinstance(value, bool):
        raise OptionError(option, value, "True or False")
    return bool(value)


def text(option: str, value: Any, expected: str = "a nonempty text") -> str:
    """Return a non-empty string."""
    if not (isinstance(value, str) and value):
        raise OptionError(option, value, expected)
    return value


def one_of(option: str, value: Any, choices: Sequence[str]) -> str:
    """Return one of the strings in `choices`."""
    if not (isinstance(value, str) and value in choices):
        raise OptionError(option, value, f"one of {', '.join(choices)}")
    return value


def instance(option: str, value: Any, kind: type[_T], where_from: str = "") -> _T:
    """Return an instance of `kind`; the error names its source, `where_from`."""
    if not isinstance(value, kind):
        raise OptionError(option, value, f"a {kind.__name__}{f', as from {where_from}' if where_from else ''}")
    return value


def function(option: str, value: Any) -> Any:
    """Return a callable."""
    if not callable(value):
        raise OptionError(option, value, "a function")
    return value


def file_path(option: str, value: Any) -> Path:
    """Return a path from a string or path-like object."""
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str) or not text or "\0" in text:
        raise OptionError(option, value, "the path of a file")
    return Path(text)


def folder_path(option: str, value: Any) -> Path:
    """Return the path of an existing folder."""
    path = file_path(option, value)
    if not path.is_dir():
        raise OptionError(option, str(path), "an existing folder")
    return path


def decimal(text: str) -> float | None:
    """Return the finite number in a text cell, or None; ignores blanks."""
    word = text.strip(" \t")
    value = float(word) if DECIMAL.fullmatch(word) else math.inf
    return value if math.isfinite(value) else None


def check_each(option: str, values: Any, expected: str, check: Callable[[str, Any], _T]) -> tuple[_T, ...]:
    """Return a tuple of checked values; the error names the index.

    A string is rejected, not split into letters.
    """
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise OptionError(option, values, expected)
    try:
        listed = list(values)
    except Exception as error:  # a zero-dimensional array, or any exception of the object itself
        raise OptionError(option, values, expected) from error
    return tuple(check(f"{option}[{index}]", value) for index, value in enumerate(listed))


def list_between(option: str, values: Any, low: float, high: float) -> tuple[float, ...]:
    """Return numbers in the closed interval [low, high]."""
    return check_each(option, values, "a list of numbers", lambda name, value: check_between(name, value, low, high))


def list_of(option: str, values: Any, kind: Any, what: str) -> tuple[Any, ...]:
    """Return several instances of a class."""
    if type(values) is tuple and all(isinstance(item, kind) for item in values):
        return values

    def check(place: str, item: Any) -> Any:
        if not isinstance(item, kind):
            raise OptionError(place, item, f"one of a list of {what}")
        return item

    return check_each(option, values, f"a list of {what}", check)
