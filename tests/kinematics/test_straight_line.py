"""Straight approaches of any robot: the tool keeps to its line and its axis, smoothly."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm

import hplan.errors as errors
from hplan.kinematics.straight_line import STEP_M, TURNING, StraightLine, lines_back
from hplan.kinematics.tool_at_point import tool_at_point
from hplan.robot.model import Robot

POINT = (0.45, 0.25, 0.5)


@pytest.fixture(params=["picker", "seven", "panda"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


@pytest.mark.parametrize("keeps_turn", [False, True])
def test_the_tool_keeps_to_its_line(arm: Robot, keeps_turn: bool) -> None:
    goals = tool_at_point(arm, POINT, count=16).configurations
    lines = lines_back(arm, goals, 0.1, keeps_turn=keeps_turn)
    whole = lines.reached == len(lines.distances)
    assert whole.mean() > 0.5
    assert np.diff(lines.distances).max() <= STEP_M + 1e-12
    for goal, rows in zip(goals[whole][:12], lines.rows[whole], strict=False):
        path = StraightLine(arm, goal, 0.1, keeps_turn=keeps_turn)
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
    path = StraightLine(picker, tool_at_point(picker, POINT).configurations[0], 0.1)
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
    goal = tool_at_point(picker, POINT).configurations[:1]
    lines = lines_back(picker, goal, 0.05, locked=["wrist_3"])
    assert lines.reached[0] == len(lines.distances)
    assert (lines.rows[0, :, 5] == goal[0, 5]).all()
    with pytest.raises(errors.InputError, match="nobody"):
        lines_back(picker, goal, 0.05, locked=["nobody"])


def test_a_line_ends_where_the_arm_does(picker: Robot) -> None:
    goal = tool_at_point(picker, POINT, approach_deg=180.0).configurations[:1]
    lines = lines_back(picker, goal, 3.0)
    reached = int(lines.reached[0])
    assert 1 < reached < len(lines.distances)
    assert (lines.rows[0, reached:] == lines.rows[0, reached - 1]).all()
    steps = np.abs(np.diff(lines.rows[0, :reached], axis=0)).max(axis=1)
    assert (steps <= TURNING * np.diff(lines.distances[:reached]) + 1e-12).all()
    with pytest.raises(errors.ApproachError, match="drawn back by") as caught:
        StraightLine(picker, goal[0], 3.0).evaluate(0.0)
    assert caught.value.largest_standoff_m == pytest.approx(lines.distances[reached - 1])


def test_joints_that_slide_draw_the_tool_back(tmp_path_factory: pytest.TempPathFactory) -> None:
    lift = loaded_arm("lift", tmp_path_factory)
    q = 0.5 * (lift.lower + lift.upper)
    lines = lines_back(lift, q[None], 0.05)
    drawn = lift.tool_positions(lines.rows[0, : lines.reached[0]])
    axis = lift.forward_kinematics(q)[:3, 2]
    assert np.abs(drawn - drawn[0] + lines.distances[: lines.reached[0], None] * axis).max() < 1e-6
