"""Decisions on distances along an interval by their Lipschitz constant."""

from __future__ import annotations

from collections.abc import Callable


def may_reach(distance: Callable[[float], float], low: float, high: float, rate: float, level: float) -> bool:
    """True if a distance nearly reaches a level in an interval.

    False is certain.

    Args:
        distance: Distance as a function of the parameter [m].
        rate: Its Lipschitz constant: |d(a) - d(b)| <= rate |a - b|.
        level: The level [m].
    """
    left = [(low, high)]
    # Resolution of the decision about distances over a yaw interval [m].
    resolution = 1e-4
    while left:
        low, high = left.pop()
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        found = distance(middle)
        if found <= level:
            return True
        # Within the half-width the distance decreases by at most rate * half.
        if found - rate * half > level:
            continue
        if rate * half <= resolution:
            return True
        left += [(low, middle), (middle, high)]
    return False


def is_always_within(distance: Callable[[float], float], low: float, high: float, rate: float, level: float) -> bool:
    """True if a distance is at most a level over an interval.

    True is certain. See `may_reach`.
    """
    return not may_reach(lambda place: -distance(place), low, high, rate, -level)
