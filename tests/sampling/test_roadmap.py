"""Quick ways: clear, no slower than any way by one configuration, and None where there is none."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from any_arms import loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.arrays import FloatArray
from hplan.problem.definition import Problem, check_problem
from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.sampling.roadmap import BEYOND_S, BRIEF, CORNER_S, FARTHEST, WIDE, low_discrepancy, quick_path
from hplan.scene.obstacles import Box, Solid, Sphere

START, GOAL = np.radians([-40.0, 30.0, 30.0, 20.0]), np.radians([40.0, 30.0, 30.0, 20.0])
MARGIN = 1e-3


def posed(
    robot: Robot, solids: list[Solid], start: FloatArray = START, goal: FloatArray = GOAL
) -> tuple[Problem, World]:
    world = World.of(robot, solids)
    return check_problem(world, start, goal), world


def way_of(robot: Robot, solids: list[Solid]) -> FloatArray | None:
    problem, world = posed(robot, solids)
    return quick_path(problem, world.field, robot.velocity_limit, MARGIN)


def lasting(robot: Robot, way: FloatArray) -> float:
    """Time of a way as it is reckoned."""
    return float((np.abs(np.diff(way, axis=0)) / robot.velocity_limit).max(axis=1).sum() + CORNER_S * (len(way) - 1))


def balls(rng: np.random.Generator, count: int) -> list[Solid]:
    """Balls about the arm's reach, none on the turret."""
    found: list[Solid] = []
    while len(found) < count:
        center = rng.uniform([-1.6, -1.6, 0.2], [1.6, 1.6, 1.8])
        if math.hypot(center[0], center[1]) > 0.6:
            found.append(
                Sphere(name=f"ball {len(found)}", center=tuple(center.tolist()), radius=float(rng.uniform(0.03, 0.2)))
            )
    return found


def test_straight_where_nothing_is_in_the_way(robot: Robot) -> None:
    way = way_of(robot, [])
    assert way is not None
    np.testing.assert_array_equal(way, [START, GOAL])


def clear_by_one_point(robot: Robot, world: World, problem: Problem) -> list[float]:
    """Times of all clear ways by one of the roadmap's points, one after the other, and of the straight one."""
    start, goal = problem.start, problem.goal
    span = float((np.abs(goal - start) / robot.velocity_limit).max())
    beyond = np.minimum(robot.velocity_limit * max(BRIEF.beyond * span, BEYOND_S), FARTHEST)
    lower = np.maximum(np.minimum(start, goal) - beyond, problem.lower)
    upper = np.minimum(np.maximum(start, goal) + beyond, problem.upper)
    points = lower + low_discrepancy(BRIEF.points, robot.dof) * (upper - lower)
    single = [np.stack([start, point, goal]) for point in points] + [np.stack([start, goal])]
    return [lasting(robot, one) for one in single if world.field.is_clear(one, MARGIN)]


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 40))
def test_clear_and_no_slower_than_by_one_configuration(robot: Robot, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    solids = balls(rng, count)
    world = World.of(robot, solids)
    if min(world.field.clearance(q) for q in (START, GOAL)) < 0.01:
        return
    problem = check_problem(world, START, GOAL)
    way = quick_path(problem, world.field, robot.velocity_limit, MARGIN)
    clear = clear_by_one_point(robot, world, problem)
    if way is None:
        assert not clear
        return
    assert world.field.is_clear(way, MARGIN)
    np.testing.assert_array_equal(way[[0, -1]], [START, GOAL])
    assert ((way >= problem.lower - 1e-12) & (way <= problem.upper + 1e-12)).all()
    assert lasting(robot, way) <= min(clear, default=math.inf) + 1e-9


@settings(max_examples=12)
@given(seed=st.integers(0, 10**6))
def test_the_same_of_an_arm_that_is_no_planar_one(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    arm = loaded_arm("toy", tmp_path_factory)
    generator = np.random.default_rng(seed)
    world = World.of(arm, balls(generator, 12))
    start = 0.6 * generator.uniform(arm.lower, arm.upper)
    goal = np.clip(start + generator.uniform(-1.0, 1.0, arm.dof), arm.lower, arm.upper)
    if min(world.field.clearance(q) for q in (start, goal)) < 0.01:
        return
    problem = check_problem(world, start, goal)
    way = quick_path(problem, world.field, arm.velocity_limit, MARGIN)
    clear = clear_by_one_point(arm, world, problem)
    assert way is not None or not clear
    assert way is None or (
        world.field.is_clear(way, MARGIN) and lasting(arm, way) <= min(clear, default=math.inf) + 1e-9
    )


def test_around_a_wall(robot: Robot) -> None:
    """A plate across the way from yaw -40 to 40 deg: the arm passes above it."""
    wall = Box(name="wall", center=(1.0, 0.0, 0.5), size=(0.9, 0.02, 1.0))
    way = way_of(robot, [wall])
    assert way is not None
    assert len(way) > 2
    _, world = posed(robot, [wall])
    assert not world.field.is_clear(np.stack([START, GOAL]), MARGIN)
    assert world.field.is_clear(way, MARGIN)


def test_only_ways_that_are_quick_enough(robot: Robot) -> None:
    problem, world = posed(robot, [Box(name="wall", center=(1.0, 0.0, 0.5), size=(0.9, 0.02, 1.0))])
    for effort in (BRIEF, WIDE):
        way = quick_path(problem, world.field, robot.velocity_limit, MARGIN, effort)
        assert way is not None
        time = lasting(robot, way)
        for least, found in ((time + 1e-6, True), (time - 1e-6, False)):
            again = quick_path(problem, world.field, robot.velocity_limit, MARGIN, effort, quicker_than_s=least)
            assert (again is not None) == found


def test_none_where_the_goal_is_shut_in(robot: Robot) -> None:
    """x."""
    ahead = np.array([math.cos(GOAL[0]), math.sin(GOAL[0]), 0.0])
    beyond = np.array([-ahead[1], ahead[0], 0.0])
    plates = [
        Box(
            name=f"plate {side}",
            center=tuple((0.9 * ahead + side * 0.25 * beyond + [0.0, 0.0, 1.2]).tolist()),
            size=(1.0, 0.02, 4.0),
            rpy_deg=(0.0, 0.0, math.degrees(GOAL[0])),
        )
        for side in (-1.0, 1.0)
    ]
    assert way_of(robot, list(plates)) is None


def test_locked_joints_stay(robot: Robot) -> None:
    wall = Box(name="wall", center=(1.0, 0.0, 0.5), size=(0.9, 0.02, 1.0))
    world = World.of(robot, [wall])
    problem = check_problem(world, START, GOAL, locked_joints=[robot.joint_names[3]])
    way = quick_path(problem, world.field, robot.velocity_limit, MARGIN)
    assert way is not None
    assert np.ptp(way[:, 3]) == 0.0


def test_same_way_every_time(robot: Robot) -> None:
    solids = balls(np.random.default_rng(3), 30)
    first, second = way_of(robot, solids), way_of(robot, solids)
    assert (first is None) == (second is None)
    if first is not None and second is not None:
        np.testing.assert_array_equal(first, second)
        assert not first.flags.writeable


@pytest.mark.parametrize("dimensions", [1, 2, 4, 6])
def test_points_are_spread_evenly(dimensions: int) -> None:
    points = low_discrepancy(4096, dimensions)
    assert points.shape == (4096, dimensions)
    assert ((points >= 0.0) & (points < 1.0)).all()
    for corner in itertools.product((0, 1), repeat=dimensions):
        inside = ((points >= 0.5 * np.array(corner)) & (points < 0.5 * np.array(corner) + 0.5)).all(axis=1)
        assert inside.mean() == pytest.approx(0.5**dimensions, rel=0.3)
