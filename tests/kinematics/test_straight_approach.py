"""Straight lines of the tool."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import VARIANTS, link_axes, load_variant

import hplan.errors as errors
from hplan.kinematics.straight_line import STEP_M, TURNING, ToolLine, lines_back
from hplan.kinematics.tool_at_point import tool_at_point
from hplan.planar.inverse_kinematics import reach
from hplan.robot.limits import Limits
from hplan.robot.model import Robot, load_robot
from hplan.trajectory.retime import time_path

LONG = [name for name, (_, _, _, axes) in VARIANTS.items() if len(axes) >= 3]


@pytest.mark.parametrize("name", LONG)
def test_planar_arm_keeps_its_last_link_on_the_line(name: str, tmp_path) -> None:
    """Among goals all over the joint ranges; the last link is where Pinocchio places it."""
    robot = load_variant(name, tmp_path)
    goals = np.random.default_rng(0).uniform(robot.lower, robot.upper, (40, robot.dof))
    lines = lines_back(robot, goals, 0.12)
    whole = np.flatnonzero(lines.reached == len(lines.distances))
    assert len(whole) > 8
    for goal in goals[whole[:8]]:
        path = ToolLine(robot, goal, 0.12)
        (start, tip), s = link_axes(robot, goal)[-1], np.linspace(0.0, path.end, 41)
        along = (tip - start) / np.linalg.norm(tip - start)
        configurations = path.evaluate(s)
        assert ((configurations >= robot.lower) & (configurations <= robot.upper)).all()
        for q, distance in zip(configurations, path.standoff * (1.0 - s / path.end), strict=True):
            start, end = link_axes(robot, q)[-1]
            np.testing.assert_allclose(end, tip - distance * along, rtol=0.0, atol=1e-4)
            np.testing.assert_allclose((end - start) / np.linalg.norm(end - start), along, rtol=0.0, atol=1e-3)


def test_no_line_begins_where_the_elbow_is_straight() -> None:
    """Joint speeds are unbounded there; nearby, limits and line are kept."""
    robot = load_robot("orchard_harvester")
    goals = np.array([[1.6, 0.38, 0.0, 1.2], [1.6, 0.38, 0.1, 1.2]])
    lines = lines_back(robot, goals, 0.1)
    assert lines.reached.tolist() == [1, len(lines.distances)]
    assert (lines.rows[0] == goals[0]).all()
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    path = ToolLine(robot, goals[1], 0.1)
    motion = time_path(path, robot.model, limits)
    assert (np.abs(motion.velocity) <= limits.velocity * 1.001).all()
    assert (np.abs(motion.acceleration) <= limits.acceleration * 1.001).all()
    tool = robot.tool_positions(motion.position)
    away, along = tool - tool[-1], (tool[0] - tool[-1]) / np.linalg.norm(tool[0] - tool[-1])
    assert np.linalg.norm(away - (away @ along)[:, None] * along, axis=1).max() < 1e-3


def test_some_configurations_at_a_point_have_a_line(robot: Robot) -> None:
    candidates = reach(robot, robot.tool_positions([0.3, 0.5, 0.7, 0.4])).configurations
    lines = lines_back(robot, candidates, 0.1)
    whole = lines.reached == len(lines.distances)
    assert whole.any()
    assert not whole.all()
    assert len(lines_back(robot, np.empty((0, 4)), 0.1).reached) == 0


POINT = (0.45, 0.25, 0.5)


@pytest.fixture(params=["picker", "seven", "panda"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


@pytest.mark.parametrize("keeps_turn", [False, True])
def test_tool_keeps_to_its_line(arm: Robot, keeps_turn: bool) -> None:
    goals = tool_at_point(arm, POINT, count=16)
    lines = lines_back(arm, goals, 0.1, keeps_turn=keeps_turn)
    whole = lines.reached == len(lines.distances)
    assert whole.mean() > 0.5
    assert np.diff(lines.distances).max() <= STEP_M + 1e-12
    for goal, rows in zip(goals[whole][:12], lines.rows[whole], strict=False):
        path = ToolLine(arm, goal, 0.1, keeps_turn=keeps_turn)
        poses = arm.forward_kinematics(path.evaluate(np.linspace(0.0, path.end, 120)))
        axis, away = poses[-1, :3, 2], poses[:, :3, 3] - poses[-1, :3, 3]
        assert np.abs(away @ axis + 0.1 * np.linspace(1.0, 0.0, 120)).max() < 1e-3
        assert np.linalg.norm(away - (away @ axis)[:, None] * axis, axis=1).max() < 1e-3
        assert np.linalg.norm(poses[:, :3, 2] - axis, axis=1).max() < 1e-2
        if keeps_turn:
            assert np.abs(poses[:, :3, 0] - poses[-1, :3, 0]).max() < 1e-2
        assert path.evaluate(path.end) == pytest.approx(goal, abs=0.0)
        assert path.evaluate(0.0) == pytest.approx(rows[-1], abs=0.0)


def test_derivatives_are_those_of_the_path(picker: Robot) -> None:
    path = ToolLine(picker, tool_at_point(picker, POINT)[0], 0.1)
    s, h = np.linspace(0.02, 0.98, 33) * path.end, 1e-5
    for order in (0, 1):
        slope = (path.evaluate(s + h, order) - path.evaluate(s - h, order)) / (2.0 * h)
        assert np.abs(slope - path.evaluate(s, order + 1)).max() < 1e-4
    steps = np.linalg.norm(np.diff(path.evaluate(np.linspace(0.0, path.end, 20_000)), axis=0), axis=1)
    assert path.length == pytest.approx(steps.sum(), rel=1e-6)
    assert path.breaks[0] == 0.0
    assert path.breaks[-1] == path.end
    assert (np.diff(path.breaks) > 0.0).all()


def test_locked_joints_stay(picker: Robot) -> None:
    goal = tool_at_point(picker, POINT)[:1]
    lines = lines_back(picker, goal, 0.05, locked=["wrist_3"])
    assert lines.reached[0] == len(lines.distances)
    assert (lines.rows[0, :, 5] == goal[0, 5]).all()
    with pytest.raises(errors.InputError, match="nobody"):
        lines_back(picker, goal, 0.05, locked=["nobody"])


def test_line_ends_where_the_arm_does(picker: Robot) -> None:
    goal = tool_at_point(picker, POINT, approach_deg=180.0)[:1]
    lines = lines_back(picker, goal, 3.0)
    reached = int(lines.reached[0])
    assert 1 < reached < len(lines.distances)
    assert (lines.rows[0, reached:] == lines.rows[0, reached - 1]).all()
    steps = np.abs(np.diff(lines.rows[0, :reached], axis=0)).max(axis=1)
    assert (steps <= TURNING * np.diff(lines.distances[:reached]) + 1e-12).all()
    with pytest.raises(errors.ApproachError, match="withdrawn by") as caught:
        ToolLine(picker, goal[0], 3.0).evaluate(0.0)
    assert caught.value.largest_standoff_m == pytest.approx(lines.distances[reached - 1])


def test_joints_that_slide_draw_the_tool_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    lift = loaded_arm("lift", tmp_path_factory)
    q = 0.5 * (lift.lower + lift.upper)
    lines = lines_back(lift, q[None], 0.05)
    drawn = lift.tool_positions(lines.rows[0, : lines.reached[0]])
    axis = lift.forward_kinematics(q)[:3, 2]
    assert np.abs(drawn - drawn[0] + lines.distances[: lines.reached[0], None] * axis).max() < 1e-6
