"""Least durations against motions put together from their phases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hplan.robot.limits import rest_to_rest

LIMIT = st.floats(0.05, 50.0)


def acceleration_phase(speed: float, acceleration: float, jerk: float) -> float:
    """Time from rest to a speed: the acceleration grows, stays, goes back [s]."""
    if speed <= acceleration**2 / jerk:
        return 2.0 * math.sqrt(speed / jerk)
    return speed / acceleration + acceleration / jerk


def plain(distance: float, velocity: float, acceleration: float, jerk: float) -> float:
    """The duration by the greatest speed that there is room for, found by bisection."""
    low, high = 0.0, velocity
    if velocity * acceleration_phase(velocity, acceleration, jerk) <= distance:
        low = velocity
    else:
        for _ in range(200):
            middle = 0.5 * (low + high)
            if middle * acceleration_phase(middle, acceleration, jerk) <= distance:
                low = middle
            else:
                high = middle
    growing = acceleration_phase(low, acceleration, jerk)
    return 2.0 * growing + (distance - low * growing) / low


@given(distance=st.floats(1e-3, 100.0), velocity=LIMIT, acceleration=LIMIT, jerk=st.floats(0.05, 1e4))
def test_duration_with_jerk(distance: float, velocity: float, acceleration: float, jerk: float) -> None:
    found = rest_to_rest(np.array([distance]), velocity, acceleration, jerk)
    assert found[0] == pytest.approx(plain(distance, velocity, acceleration, jerk), rel=1e-9)


@given(distance=st.floats(1e-3, 100.0), velocity=LIMIT, acceleration=LIMIT)
def test_no_jerk_limit_is_a_very_high_one(distance: float, velocity: float, acceleration: float) -> None:
    found = rest_to_rest(np.array([distance, 0.0]), velocity, acceleration)
    assert found[0] == pytest.approx(plain(distance, velocity, acceleration, 1e12), rel=1e-4)
    assert found[1] == 0.0
