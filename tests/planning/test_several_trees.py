"""Several pairs of trees: the quickest path of every class first."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.optimization.shortcut import shorten
from hplan.optimization.smooth_path import START_SHORTCUTS
from hplan.planning.definition import Problem, check_problem
from hplan.planning.sampling.rrt_connect import TreeEffort, tree_path
from hplan.planning.sampling.several_trees import PromisingPath, TreesEffort, path_time, promising_paths
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene import Sphere

MARGIN = 2e-4
START, GOAL = np.array([0.0, 1.2, 0.3, 0.3]), np.array([0.0, 0.1, 0.3, 0.3])
ALONE = TreesEffort(3, 50_000)


@pytest.fixture
def blocked(robot: Robot) -> tuple[Problem, World]:
    world = World.of(robot, [Sphere(name="ball", center=(1.6, 0.0, 1.6), radius=0.25)], clearance=0.005)
    return check_problem(world, START, GOAL), world


def found(robot: Robot, blocked: tuple[Problem, World], effort: TreesEffort) -> list[PromisingPath]:
    return promising_paths(blocked[0], blocked[1].field, robot.velocity_limit, MARGIN, effort)


def test_anywhere_each_pair_is_one_that_grows_alone(robot: Robot, blocked: tuple[Problem, World]) -> None:
    problem, world = blocked
    velocity = robot.velocity_limit
    grown = (tree_path(problem, world.field, velocity, MARGIN, TreeEffort(50_000, seed))[0] for seed in range(3))
    alone = [path for path in grown if path is not None]
    times = [path_time(shorten(path, world.field, margin=MARGIN, rounds=START_SHORTCUTS), velocity) for path in alone]
    paths = found(robot, blocked, ALONE)
    assert [path.seconds for path in paths] == pytest.approx(sorted(times), abs=1e-9)
    assert all(any(np.array_equal(path.waypoints, other) for other in alone) for path in paths)
