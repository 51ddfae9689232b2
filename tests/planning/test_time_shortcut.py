"""Shortcuts in time: clear, never slower, the same every time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hplan.base.arrays import FloatArray
from hplan.planning.definition import check_problem
from hplan.planning.sampling.rrt_connect import TreeEffort, tree_path
from hplan.planning.sampling.time_shortcut import CORNER_S, path_time, quicken
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene import Sphere

MARGIN = 2e-4
START, GOAL = np.array([0.0, 1.2, 0.3, 0.3]), np.array([0.0, 0.1, 0.3, 0.3])


@pytest.fixture(scope="module")
def world(robot: Robot) -> World:
    return World.of(robot, [Sphere(name="ball", center=(1.6, 0.0, 1.6), radius=0.25)], clearance=0.005)


def tree(robot: Robot, world: World, seed: int) -> FloatArray:
    problem = check_problem(world, START, GOAL)
    path, _ = tree_path(problem, world.field, robot.velocity_limit, MARGIN, TreeEffort(50_000, seed))
    assert path is not None
    return path


def plain_time(path: FloatArray, velocity: FloatArray) -> float:
    """Segment by segment, the slowest joint of each."""
    legs = [max(abs(b - a) / v for a, b, v in zip(p, q, velocity, strict=True)) for p, q in pairwise(path)]
    return sum(legs) + CORNER_S * (len(path) - 2)


@pytest.mark.parametrize("seed", range(6))
def test_clear_and_quicker(robot: Robot, world: World, seed: int) -> None:
    path, velocity = tree(robot, world, seed), robot.velocity_limit
    before = plain_time(path, velocity)
    assert path_time(path, velocity) == pytest.approx(before, rel=1e-12)
    quick = quicken(path, world.field, velocity, margin=MARGIN)
    np.testing.assert_array_equal(quick[[0, -1]], path[[0, -1]])
    assert world.field.is_clear(quick, 0.5 * MARGIN)
    assert plain_time(quick, velocity) < before
    assert (np.abs(np.diff(quick, axis=0)).max(axis=1) > 0.0).all()
    fewer = [plain_time(quicken(path, world.field, velocity, margin=MARGIN, rounds=n), velocity) for n in (0, 5, 20)]
    assert fewer[0] == pytest.approx(before, rel=1e-12)
    assert fewer == sorted(fewer, reverse=True)
    np.testing.assert_array_equal(quick, quicken(path, world.field, velocity, margin=MARGIN))
    assert not quick.flags.writeable


def test_straight_where_nothing_is_in_the_way(robot: Robot) -> None:
    """Detours of whatever shape come down to the straight motion."""
    empty = World.of(robot, [])
    rng = np.random.default_rng(4)
    for count in (1, 3, 8):
        detour = np.concatenate([[START], rng.uniform(robot.lower, robot.upper, (count, 4)), [GOAL]])
        quick = quicken(detour, empty.field, robot.velocity_limit, margin=MARGIN, rounds=400)
        least = float((np.abs(GOAL - START) / robot.velocity_limit).max())
        assert path_time(quick, robot.velocity_limit) <= 1.05 * least


def test_two_waypoints_stay(robot: Robot, world: World) -> None:
    path = np.stack([START, GOAL])
    np.testing.assert_array_equal(quicken(path, world.field, robot.velocity_limit, margin=MARGIN), path)
