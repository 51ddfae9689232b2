"""Straight lines of the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import VARIANTS, axis_points, link_axes, load_variant
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hplan.errors as errors
from hplan.base.arrays import readonly
from hplan.kinematics.planar_inverse_kinematics import reach
from hplan.kinematics.straight_approach import STRAIGHT, ApproachPath, standoffs
from hplan.kinematics.straight_line import STEP_M, TURNING, StraightLine, lines_back
from hplan.kinematics.tool_at_point import tool_at_point
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.trajectory.retime import time_path

EXACT = 1e-9
LONG = [name for name, (_, _, _, axes) in VARIANTS.items() if len(axes) >= 3]

GOAL = np.array([0.3, 0.5, 0.7, 0.4])


@pytest.fixture(scope="module")
def variants(tmp_path_factory):
    return {name: load_variant(name, tmp_path_factory.mktemp("arm")) for name in VARIANTS}


def last_link(robot, q):
    """Unit vector of the last link as Pinocchio places it."""
    start, end = link_axes(robot, q)[-1]
    return (end - start) / np.linalg.norm(end - start)


def random_approaches(robot, seed, count, standoff):
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.lower, robot.upper, (400, robot.dof))
    feasible = np.flatnonzero(standoffs(robot, q, standoff).feasible)[:count]
    assert len(feasible) == count
    return [ApproachPath(robot, q[i], standoff) for i in feasible]


def assert_straight(path: ApproachPath):
    robot = path.robot
    goal, direction = axis_points(robot, path.goal)[-1], last_link(robot, path.goal)
    s = np.linspace(0.0, path.end, 41)
    for q, distance in zip(path.evaluate(s), path.standoff * (1.0 - s / path.end), strict=True):
        np.testing.assert_allclose(axis_points(robot, q)[-1], goal - distance * direction, rtol=0.0, atol=EXACT)
        np.testing.assert_allclose(last_link(robot, q), direction, rtol=0.0, atol=EXACT)
    q = path.evaluate(np.linspace(0.0, path.end, 2001))
    assert ((q >= robot.lower) & (q <= robot.upper)).all()
    np.testing.assert_array_equal(q[-1], path.goal)
    assert np.abs(np.diff(q, axis=0)).max() < 0.1


def assert_derivatives_match(path, rtol=1e-5):
    """Against central differences, which have room to differ where the curve is sharp."""
    step = 1e-5 * path.end
    s = np.linspace(2 * step, path.end - 2 * step, 201)
    for order in (1, 2):
        low, high = (path.evaluate(s + shift, order - 1) for shift in (-step, step))
        exact = path.evaluate(s, order)
        third = np.abs(np.gradient(np.gradient(exact, s, axis=0), s, axis=0)).max(axis=0)
        np.testing.assert_allclose((high - low) / (2 * step), exact, rtol=rtol, atol=1e-6 * (1 + third.max() * step))


@pytest.mark.parametrize("name", LONG)
def test_straight_with_the_last_link_at_its_angle(variants, name):
    for path in random_approaches(variants[name], 0, 6, 0.12):
        assert_straight(path)
        assert_derivatives_match(path)


@pytest.mark.parametrize("name", LONG)
@settings(max_examples=3, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_largest_standoff_against_dense_sampling(variants, name, seed):
    """Within the largest stand-off nothing is passed; just beyond it something is."""
    rng = np.random.default_rng(seed)
    # Limits tight enough that each of the joints is sometimes the first to come to one.
    share = rng.uniform(0.2, 0.6)
    robot = replace(
        variants[name], lower=readonly(share * variants[name].lower), upper=readonly(share * variants[name].upper)
    )
    q = rng.uniform(robot.lower, robot.upper, (8, robot.dof))
    wanted = 0.6
    found = standoffs(robot, q, wanted)
    free = [robot.dof - robot.arm.link_count + k for k in (0, 1, robot.arm.link_count - 1)]
    for goal, largest, feasible, start in zip(q, found.largest, found.feasible, found.configurations, strict=True):
        assert feasible == (largest == wanted)
        np.testing.assert_allclose(
            axis_points(robot, start)[-1],
            axis_points(robot, goal)[-1] - largest * last_link(robot, goal),
            rtol=0.0,
            atol=EXACT,
        )
        if largest > 1e-6:
            path = ApproachPath(robot, goal, largest * (1.0 - 1e-9))
            assert_straight(path)
            points = robot.arm.joint_points(path.evaluate(np.linspace(0.0, path.end, 301))[:, robot.arm_slice])
            moving = [joint - (robot.dof - robot.arm.link_count) for joint in free]
            a, b, c = (points[:, k] for k in moving)
            cross = (b - a)[:, 0] * (c - b)[:, 1] - (b - a)[:, 1] * (c - b)[:, 0]
            sine = np.abs(cross) / np.linalg.norm(b - a, axis=1) / np.linalg.norm(c - b, axis=1)
            assert sine.min() > np.sin(STRAIGHT) - 1e-9
        if not feasible:
            beyond = standoffs(robot, goal[None], min(wanted, largest + 1e-4))
            assert not beyond.feasible[0]
            assert beyond.largest[0] == pytest.approx(largest, abs=1e-9)


def test_elbow_in_the_way(variants):
    """Backwards towards the stretched arm; and a goal with the arm stretched has no approach."""
    robot = variants["upright on a yaw"]
    goal = np.array([0.0, 0.0, 0.2, 1.4])
    found = standoffs(robot, goal[None], 2.0)
    assert not found.feasible[0]
    path = ApproachPath(robot, goal, found.largest[0])
    assert path.evaluate(0.0)[2] == pytest.approx(STRAIGHT, abs=1e-9)
    assert_straight(path)
    assert_derivatives_match(path, rtol=1e-4)
    none = standoffs(robot, np.array([[0.0, 0.1, 0.0, 0.3]]), 0.1)
    assert not none.feasible[0]
    assert none.largest[0] == 0.0


def test_standoffs_of_candidates(robot):
    position = robot.tool_positions(GOAL)
    candidates = reach(robot, position).configurations
    found = standoffs(robot, candidates, 0.1)
    assert found.feasible.any()
    assert not found.feasible.all()
    for q, feasible, start in zip(candidates, found.feasible, found.configurations, strict=True):
        if feasible:
            np.testing.assert_allclose(ApproachPath(robot, q, 0.1).evaluate(0.0), start, rtol=0.0, atol=1e-12)
    assert standoffs(robot, np.empty((0, 4)), 0.1).feasible.shape == (0,)


# Timing


@pytest.mark.parametrize("goal", [GOAL, np.array([0.0, 0.3, STRAIGHT, 1.0])])
def test_timed(robot, goal):
    """A plain approach, and one that ends with the elbow as straight as is allowed: limits kept, tool on the line."""
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    path = ApproachPath(robot, goal, 0.1)
    motion = time_path(path, robot.model, limits)
    np.testing.assert_allclose(motion.position[0], path.evaluate(0.0), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(motion.position[-1], path.evaluate(path.end), rtol=0.0, atol=1e-12)
    assert (np.abs(motion.velocity) <= limits.velocity * 1.001).all()
    assert (np.abs(motion.acceleration) <= limits.acceleration * 1.001).all()
    assert 0.05 < motion.duration < 3.0
    direction = last_link(robot, goal)
    away = robot.tool_positions(motion.position) - robot.tool_positions(goal)
    beside = away - (away @ direction)[:, None] * direction
    assert np.linalg.norm(beside, axis=1).max() < 1e-3


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
