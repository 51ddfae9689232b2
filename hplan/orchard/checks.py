"""Checks of the numbers that orchards are made from."""

from __future__ import annotations

from numbers import Real
from typing import Any

from hplan.base.arguments import whole
from hplan.errors import OptionError


def check_number(option: str, value: Any, low: float, high: float) -> float:
    """A number in a range, its ends included; NaN is in none.

    Raises:
        OptionError: It is none.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    if not (real and low <= value <= high):
        raise OptionError(option, value, f"a number between {low:g} and {high:g}")
    return float(value)


def check_numbers(option: str, values: Any, low: float, high: float) -> tuple[float, ...]:
    """A list of numbers in a range.

    Raises:
        OptionError: It is no list, or one of them is out of the range.
    """
    if isinstance(values, (str, bytes)) or not hasattr(values, "__iter__"):
        raise OptionError(option, values, "a list of numbers")
    return tuple(check_number(f"{option}[{index}]", value, low, high) for index, value in enumerate(values))


def keep_count(options: Any, option: str, least: int, most: int | None) -> None:
    """Check a field of a frozen dataclass and keep it as an int.

    Raises:
        OptionError: As `whole`.
    """
    object.__setattr__(options, option, whole(option, getattr(options, option), least, most))


def keep_number(options: Any, option: str, low: float, high: float) -> None:
    """Check a field of a frozen dataclass and keep it as a float.

    Raises:
        OptionError: As `check_number`.
    """
    object.__setattr__(options, option, check_number(option, getattr(options, option), low, high))
