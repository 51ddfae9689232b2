"""Times of ROS messages: whole seconds, and nanoseconds from 0 to 999,999,999."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, Final

from hplan.base.arguments import between
from hplan.errors import InputError

#: Nanoseconds in a second.
SECOND_NS: Final = 1_000_000_000


def time_ns(option: str, seconds: Any) -> int:
    """Convert seconds to the nearest whole nanoseconds, without intermediate rounding.

    Args:
        option: Name of the value, for the error.
        seconds: The time [s].

    Raises:
        OptionError: `seconds` is not a number in [0, 2^31 - 1], the range of a message's time.

    Examples:
        >>> time_ns("stamp_s", 0.1)
        100000000
    """
    # A message has its seconds in a signed 32-bit integer.
    latest_s = 2.0**31 - 1.0
    return round(Fraction(between(option, seconds, 0.0, latest_s)) * SECOND_NS)


def message_time(nanoseconds: int) -> dict[str, int]:
    """Convert nanoseconds to a `builtin_interfaces/msg/Time` or `Duration`.

    Examples:
        >>> message_time(1_500_000_000)
        {'sec': 1, 'nanosec': 500000000}
    """
    sec, nanosec = divmod(nanoseconds, SECOND_NS)
    return {"sec": sec, "nanosec": nanosec}


def seconds_of(where: str, content: Any) -> float:
    """Convert a `Time` or `Duration` message to seconds.

    Args:
        where: Place of the value in the message, for the error.
        content: The message as a dict.

    Raises:
        InputError: `content` is not a valid time with `sec` and `nanosec`; names its place.

    Examples:
        >>> seconds_of("header.stamp", {"sec": 1, "nanosec": 500_000_000})
        1.5
    """
    parts = []
    for key, most in (("sec", 2**31 - 1), ("nanosec", SECOND_NS - 1)):
        value = content.get(key) if isinstance(content, Mapping) else None
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
            raise InputError(
                f"{where}: expected sec and nanosec, whole numbers with nanosec below 1e9; got {content!r}"
            )
        parts.append(value)
    return float(parts[0] + Fraction(parts[1], SECOND_NS))
