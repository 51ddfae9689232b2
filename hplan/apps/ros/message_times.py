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
    """Seconds as whole nanoseconds: the nearest ones to the very number given.

    Args:
        option: What it is, for the error.
        seconds: A time that a message can hold [s].

    Raises:
        OptionError: It is none.
    """
    # The latest time that a message can hold: its seconds are a 32 bit number [s].
    latest_s = 2.0**31 - 1.0
    return round(Fraction(between(option, seconds, 0.0, latest_s)) * SECOND_NS)


def message_time(nanoseconds: int) -> dict[str, int]:
    """Nanoseconds as `builtin_interfaces/msg/Time`, and as `Duration`, which looks alike."""
    sec, nanosec = divmod(nanoseconds, SECOND_NS)
    return {"sec": sec, "nanosec": nanosec}


def seconds_of(where: str, content: Any) -> float:
    """Seconds of a `Time` or `Duration`.

    Raises:
        InputError: It is none; names where it stands.
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
