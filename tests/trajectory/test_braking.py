"""Stops that each joint makes on its own."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.robot.model import load_robot
from hplan.trajectory.braking import braking
from hplan.trajectory.trajectory import cubic_pieces

PARTS = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)
PERIOD = 4e-3


@settings(max_examples=60)
@given(speed=PARTS, push=PARTS, less=st.floats(0.1, 1.0))
def test_a_stop_goes_on_from_the_state_keeps_limits_and_ends_at_rest(speed, push, less):
    robot = load_robot()
    state = np.zeros(4), speed * robot.velocity_limit, push * robot.acceleration_limit
    found = braking(robot, *state, PERIOD, less * robot.acceleration_limit)
    assert found is not None
    for values, asked in zip((found.position, found.velocity, found.acceleration), state, strict=True):
        np.testing.assert_array_equal(values[0], asked)
    assert not found.velocity[-1].any()
    assert not found.acceleration[-1].any()
    most = np.maximum(less * robot.acceleration_limit, np.abs(state[2]))
    assert (np.abs(found.acceleration) <= most * (1.0 + 1e-9)).all()
    jerk = np.diff(found.acceleration, axis=0) / PERIOD
    assert (np.abs(jerk) <= robot.jerk_limit * (1.0 + 1e-6) + 1e-6).all()
    bezier, duration = cubic_pieces(found)
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    np.testing.assert_allclose(bent[:, 0], found.acceleration[:-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(bent[:, 1], found.acceleration[1:], rtol=0, atol=1e-6)


@settings(max_examples=30)
@given(speed=PARTS)
def test_a_stop_is_quick(speed):
    """Speed by acceleration, and the jerk's ramps of the slowest joint."""
    robot = load_robot()
    zero, fast = np.zeros(4), speed * robot.velocity_limit
    found = braking(robot, zero, fast, zero, PERIOD, robot.acceleration_limit)
    ramp = robot.acceleration_limit / robot.jerk_limit
    alone = np.where(
        np.abs(fast) > ramp * robot.acceleration_limit,
        np.abs(fast) / robot.acceleration_limit + ramp,
        2.0 * np.sqrt(np.abs(fast) / robot.jerk_limit),
    )
    assert alone.max() - 2.0 * PERIOD <= found.duration <= 1.1 * alone.max() + 8.0 * PERIOD


def test_a_joint_that_cannot_brake(robot):
    fast, zero = robot.velocity_limit, np.zeros(4)
    assert braking(robot, zero, fast, zero, PERIOD, np.full(4, 1e-6)) is None
