"""Paths along recent motions: what is remembered, and where it leads."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from planned import on_cubics, posed, task

from hplan.collision.coal_scene import CoalScene
from hplan.planning.effort import efforts_of
from hplan.planning.options import PlanOptions
from hplan.planning.path_finder import path_along_recent
from hplan.planning.plan import plan
from hplan.planning.problem import Problem, SearchMemory, merge_problems
from hplan.planning.recent_paths import recent_path, with_motion, with_path
from hplan.planning.solver import motions
from hplan.planning.specialist import presets_of
from hplan.robot.model import Robot
from hplan.scene.obstacles import Sphere
from hplan.trajectory.trajectory import Trajectory

LEFT, RIGHT = (40.0, 45.0, 40.0, 30.0), (-40.0, 45.0, 40.0, 30.0)
OPTIONS = PlanOptions(effort="quick", at_once=True)


@pytest.fixture(scope="module")
def ball(robot: Robot) -> Sphere:
    """A ball in the way from one side to the other."""
    motion = plan(robot, task(RIGHT, LEFT)).trajectory
    return Sphere(name="ball", center=middle(robot, motion), radius=0.3)


@pytest.fixture(scope="module")
def around(robot: Robot, ball: Sphere) -> Trajectory:
    """A motion around the ball."""
    return plan(robot, task(RIGHT, LEFT, [ball])).trajectory


def middle(robot: Robot, motion: Trajectory) -> tuple[float, float, float]:
    x, y, z = robot.tool_positions(motion.position[[motion.samples // 2]])[0].tolist()
    return x, y, z


def back(robot: Robot, obstacles: list[Sphere], known: Trajectory, goal: tuple[float, ...] = RIGHT) -> Problem:
    """The problem of going back from near the end of a motion that is known."""
    start = tuple(angle + 2.0 for angle in LEFT)
    problem = posed(robot, task(start, goal, obstacles), OPTIONS)
    first = efforts_of(presets_of(robot), OPTIONS)[0]
    return replace(problem, effort=first, memory=SearchMemory(with_motion((), known, robot)))


def assert_path(robot: Robot, problem: Problem, path: np.ndarray) -> None:
    np.testing.assert_array_equal(path[0], problem.start)
    assert (problem.goals == path[-1]).all(axis=1).any()
    checker = CoalScene(robot, problem.scene.solids)
    for first, second in pairwise(path):
        for part in np.linspace(0.0, 1.0, 20):
            assert checker.distances(first + part * (second - first)).min() > 0.0


def test_it_leads_around_what_blocks_the_straight_line(robot: Robot, ball: Sphere, around: Trajectory) -> None:
    problem = back(robot, [ball], around)
    assert not problem.field.is_clear(np.stack([problem.start, problem.goal]), 1e-4)
    path = recent_path(problem, 1e-4)
    assert path is not None
    assert_path(robot, problem, path)
    found = [motion for _, motion in motions(problem)]
    assert found[0].origin == "recent"
    assert found[0].certificate.verified
    assert next(motion.origin for _, motion in motions(replace(problem, memory=SearchMemory()))) != "recent"


def test_edges_that_became_blocked_are_not_taken(robot: Robot, ball: Sphere, around: Trajectory) -> None:
    other = Sphere(name="other", center=middle(robot, around), radius=0.1)
    assert recent_path(back(robot, [ball, other], around), 1e-4) is None


def test_it_leads_to_a_goal_that_is_near(robot: Robot, ball: Sphere, around: Trajectory) -> None:
    near, far = (back(robot, [ball], around, goal) for goal in (RIGHT, (-150.0, 45.0, 40.0, 30.0)))
    assert recent_path(far, 1e-4) is None
    both = merge_problems([far, near])
    path = path_along_recent(both)
    assert path is not None
    assert path.goal == 1
    assert_path(robot, both, path.waypoints)


def test_locked_joints_keep_their_values(robot: Robot, ball: Sphere, around: Trajectory) -> None:
    moved = int(np.ptp(around.position[:, 1:], axis=0).argmax()) + 1
    assert np.ptp(around.position[:, moved]) > 0.05
    problem = posed(robot, task(LEFT, RIGHT, [ball], locked_joints=(robot.joint_names[moved],)), OPTIONS)
    known = with_motion((), around, robot)
    assert recent_path(replace(problem, memory=SearchMemory(known)), 1e-4) is None
    problem = posed(robot, task(LEFT, RIGHT, [ball]), OPTIONS)
    assert recent_path(replace(problem, memory=SearchMemory(known)), 1e-4) is not None


def test_motions_that_lead_nowhere_else_are_not_remembered(robot: Robot, around: Trajectory) -> None:
    known = with_motion((), around, robot)
    assert len(known) == 1
    np.testing.assert_array_equal(known[0][[0, -1]], around.position[[0, -1]])
    part = around.cut_before(around.samples // 3)
    assert with_motion(known, part, robot) == known
    steps = np.linspace(0.0, around.duration, len(known[0]))
    assert np.ptp(np.abs(np.diff(known[0], axis=0)).max(axis=1)) < np.ptp(
        np.abs(np.diff(on_cubics(around, steps), axis=0)).max(axis=1)
    )
    for yaw in range(0, 180, 15):
        goal = (float(yaw), 60.0, 20.0, 30.0)
        known = with_motion(known, plan(robot, task((yaw - 10.0, 60.0, 20.0, 30.0), goal)).trajectory, robot)
    assert len(known) == 8
    np.testing.assert_array_equal(known[-1][-1], np.radians(goal))


def test_all_corners_of_a_path_are_remembered(robot: Robot) -> None:
    corners = np.random.default_rng(5).uniform(robot.lower, robot.upper, (40, robot.dof))
    (known,) = with_path((), corners, robot)
    rows = [int(np.abs(known - corner).sum(axis=1).argmin()) for corner in corners]
    np.testing.assert_allclose(known[rows], corners, atol=1e-12)
    assert rows == sorted(rows)
    for (first, second), (begin, end) in zip(pairwise(corners), pairwise(rows), strict=True):
        parts = (known[begin : end + 1] - first) / (second - first)  # the same for all joints on a segment
        assert np.ptp(parts, axis=1).max() < 1e-9
    assert with_path((known,), corners, robot) == (known,)
