"""The use of position limits: the largest that the cubics between rows have, no more and no less."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_urdf import urdf

from hplan.certificate.limit_use import limit_use
from hplan.robot.model import load_robot
from hplan.trajectory.trajectory import Trajectory, cubic_pieces, cubic_states

ROBOT = load_robot(
    urdf().replace('"l0"', '"base_link"').replace('"l2"', '"tool0"').replace("effort=", 'acceleration="9" effort=')
)

numbers = st.floats(-2.0, 2.0) | st.sampled_from([0.0, 1e-9, -1e-9, 1.0])
rows = st.lists(st.tuples(numbers, numbers, numbers, numbers, st.floats(0.01, 2.0)), min_size=2, max_size=4)


def trajectory(time, position, velocity) -> Trajectory:
    none = np.zeros_like(position)
    return Trajectory(ROBOT.joint_names, time, position, velocity, none, none)


def position_use(motion: Trajectory) -> float:
    return limit_use(ROBOT, motion, *cubic_pieces(motion)).position


@settings(max_examples=60)
@given(rows)
def test_it_is_what_is_seen_at_many_times(values):
    table = np.array(values)
    motion = trajectory(np.concatenate([[0.0], np.cumsum(table[1:, 4])]), table[:, :2], 3.0 * table[:, 2:4])
    clock = np.concatenate([np.linspace(*ends, 1001) for ends in pairwise(motion.time)])
    seen = cubic_states(motion.time, motion.position, motion.velocity, clock)[0]
    most = float((np.abs(seen - 0.5 * (ROBOT.lower + ROBOT.upper)) / (0.5 * (ROBOT.upper - ROBOT.lower))).max())
    assert most - 1e-12 <= position_use(motion) <= most + 1e-5


def test_a_swing_that_turns_before_the_limit_keeps_it():
    """Its Bezier points are beyond the limit of 3 rad, and it is not."""
    motion = trajectory(np.array([0.0, 1.0]), np.array([[2.9, 0.0], [2.9, 0.0]]), np.array([[0.39, 0.0], [-0.39, 0.0]]))
    assert np.abs(cubic_pieces(motion)[0]).max() > 3.0
    assert position_use(motion) == pytest.approx((2.9 + 0.39 / 4.0) / 3.0)


@pytest.mark.parametrize("fast", [1e10, 1e160, 1e300])
def test_numbers_that_are_huge_in_between_are_seen(fast):
    motion = trajectory(np.array([0.0, 1.0]), np.zeros((2, 2)), np.array([[fast, 0.0], [0.0, 0.0]]))
    assert position_use(motion) >= 0.01 * fast


def test_what_overflows_is_no_use():
    motion = trajectory(np.array([0.0, 1e200]), np.zeros((2, 2)), np.array([[1e200, 0.0], [0.0, 0.0]]))
    assert position_use(motion) == np.inf
