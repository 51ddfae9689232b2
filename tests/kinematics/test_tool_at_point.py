"""Inverse kinematics of any robot at a point, from requested directions."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hplan.errors as errors
from hplan.kinematics.inverse_kinematics import SAME
from hplan.kinematics.tool_at_point import approach_angles, tool_at_point
from hplan.robot.model import Robot

POINT = (0.45, 0.25, 0.5)


@pytest.fixture(params=["picker", "seven", "lift", "panda"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10_000))
def test_configurations_are_at_the_point_and_within_limits(arm: Robot, seed: int) -> None:
    spread = np.random.default_rng(seed).random((2, arm.dof))
    start, q = arm.lower + (0.1 + 0.8 * spread) * (arm.upper - arm.lower)
    point = arm.tool_positions(q)
    found = tool_at_point(arm, point, start=start)
    assert np.abs(arm.tool_positions(found) - point).max() <= 1e-6
    assert (found >= arm.lower).all()
    assert (found <= arm.upper).all()
    times = (np.abs(found - start) / arm.velocity_limit).max(axis=1)
    assert (np.diff(times) >= -1e-8).all()
    apart = np.abs(found[:, None] - found).max(axis=2) + np.eye(len(times))
    assert apart.min() >= SAME
    assert not found.flags.writeable
    assert (tool_at_point(arm, point, start=start) == found).all()


def test_several_points_give_the_configurations_of_each(arm: Robot) -> None:
    spread = np.random.default_rng(2).random((3, arm.dof))
    points = arm.tool_positions(arm.lower + (0.1 + 0.8 * spread) * (arm.upper - arm.lower))
    each = [tool_at_point(arm, point, count=8) for point in points]
    points[1] = (20.0, 0.0, 0.0)  # out of reach
    np.testing.assert_array_equal(tool_at_point(arm, points, count=8), np.concatenate([each[0], each[2]]))


def test_directions_cover_the_sphere_where_the_arm_can_turn(picker: Robot) -> None:
    along = picker.forward_kinematics(tool_at_point(picker, (0.4, 0.2, 0.45)))[:, :3, 2]
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        assert (along @ axis).max() > np.cos(np.radians(25.0))


@pytest.mark.parametrize("asked", [(-30.0, 10.0), -90.0, (90.0, 180.0), (-400.0, 400.0)])
def test_angles_are_as_requested(picker: Robot, asked: float | tuple[float, float]) -> None:
    found = tool_at_point(picker, POINT, approach_deg=asked)
    outward = np.array([*POINT[:2], 0.0]) / np.hypot(*POINT[:2])
    for q, angle in zip(found, approach_angles(picker, found), strict=True):
        along = picker.forward_kinematics(q)[:3, 2]
        assert np.sin(angle) == pytest.approx(along[2], abs=1e-9)
        assert np.cos(angle) * (along @ outward) >= -1e-9
        low, high = (asked, asked) if isinstance(asked, float) else asked
        assert (np.degrees(angle) - low + 1e-4) % 360.0 <= high - low + 2e-4


def test_last_joint_stays_where_it_only_turns_the_tool_about_itself(picker: Robot) -> None:
    start = np.array([0.3, 0.8, 0.6, -0.4, 0.5, 0.2])
    found = tool_at_point(picker, POINT, start=start)
    assert (np.abs(found[:, -1] - 0.2) < 1e-9).mean() > 0.6


def test_locked_joints_stay(picker: Robot) -> None:
    start = np.array([0.3, 0.8, 0.6, -0.4, 0.5, 0.2])
    point = picker.tool_positions(np.array([0.3, 1.1, 0.9, 0.2, -0.5, 0.2]))
    found = tool_at_point(picker, point, start=start, locked=["shoulder_pan", "wrist_3"])
    assert (found[:, [0, 5]] == start[[0, 5]]).all()
    with pytest.raises(errors.UnreachableError, match="with shoulder_pan, shoulder_lift, elbow locked"):
        tool_at_point(picker, point, start=start, locked=["shoulder_pan", "shoulder_lift", "elbow"])


def test_no_search_beyond_stretched_arm(arm: Robot) -> None:
    with pytest.raises(errors.UnreachableError, match="beyond the reach of the stretched arm") as caught:
        tool_at_point(arm, (20.0, 0.0, 0.0))
    assert caught.value.reason == "too_far"
    reach = 20.0 - caught.value.data["excess_m"]
    middle = arm.model.jointPlacements[1].translation
    spread = arm.lower + np.random.default_rng(1).random((200, arm.dof)) * (arm.upper - arm.lower)
    assert np.linalg.norm(arm.tool_positions(spread) - middle, axis=1).max() <= reach + np.linalg.norm(middle)


def test_failed_search_is_no_proof(picker: Robot) -> None:
    with pytest.raises(errors.UnreachableError, match="does not prove") as caught:
        tool_at_point(picker, (1.1, 0.1, 0.1), approach_deg=180.0)
    assert caught.value.reason == "not_found"
