"""Cells in contact whole: every configuration of an excluded cell is in contact by coal."""

from __future__ import annotations

import numpy as np
import pytest
from planned import task

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.planning.definition import check_problem
from hplan.planning.lower_bound.duration_bound import _joint_motions, _obstacles
from hplan.planning.lower_bound.planar_search import PlanarSearch, Resolution, TimedGrid
from hplan.planning.options import PlanOptions
from hplan.planning.task import PlanningCache
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere


def bits(search: PlanarSearch) -> BoolArray:
    """(counts) True for cells that are not excluded."""
    words = search.free.view(np.uint8)
    found = np.unpackbits(words, axis=-1, bitorder="little")[..., : search.grid.counts[0]]
    return np.moveaxis(found, -1, 0).astype(np.bool_)


def configurations(search: PlanarSearch, joints: list[int], cells: FloatArray) -> FloatArray:
    """Configurations at places counted in cells along the axes."""
    q = np.zeros((len(cells), 4))
    q[:, joints] = search.grid.lower + cells * search.grid.sizes
    return q


OBSTACLES = {
    "sphere": Sphere(name="a", center=(1.0, 0.0, 1.9), radius=0.15),
    "capsule": Capsule(name="a", start=(0.9, -0.5, 1.5), end=(1.2, 0.6, 1.9), radius=0.06),
    "cylinder": Cylinder(name="a", center=(1.1, 0.0, 1.7), length=0.3, radius=0.1, rpy_deg=(20.0, 40.0, 0.0)),
    "box": Box(name="a", center=(1.2, 0.0, 1.6), size=(0.3, 0.4, 0.2), rpy_deg=(10.0, 20.0, 30.0)),
}


@pytest.mark.parametrize(
    ("kind", "first"), [("sphere", 0), ("capsule", 1), ("cylinder", 2), ("box", 0), ("sphere", 1), ("box", 2)]
)
def test_excluded_cells_are_in_contact_whole_and_most_others_are_not(robot: Robot, kind: str, first: int) -> None:
    scene = task([0, 5, 0, 0], [0, 80, 5, 5], [OBSTACLES[kind]], locked_joints=("base_yaw",), clearance=0.01)
    world = PlanningCache(robot).world(scene, PlanOptions())
    problem = check_problem(world, np.radians([0, 5, 0, 0]), np.radians([0, 5, 85, 85]), locked_joints=["base_yaw"])
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, jerk=robot.jerk_limit)
    order = np.array([first, *(k for k in range(3) if k != first)]) + 1
    motions = _joint_motions(world, problem, limits)
    grid = TimedGrid.of(motions.only(order), 2.5, Resolution(30))
    search = PlanarSearch.of(robot, _obstacles(world), problem.start, order, grid)
    free, random = bits(search), np.random.default_rng(first)
    checker = CoalScene(robot, scene.solids)
    excluded = np.argwhere(~free)
    assert 0.02 * free.size < len(excluded) < 0.9 * free.size
    some = excluded[random.integers(len(excluded), size=300)]
    corner = np.round(random.uniform(size=(300, 3)) * 2.0) / 2.0  # corners and middles of edges, faces and the cell
    q = configurations(search, order.tolist(), some + np.clip(corner, 1e-6, 1.0 - 1e-6))
    assert all(checker.distances(one).min() < scene.clearance for one in q)
    others = np.argwhere(free)
    middles = configurations(search, order.tolist(), others[random.integers(len(others), size=300)] + 0.5)
    in_contact = [checker.distances(one).min() < scene.clearance for one in middles]
    assert np.mean(in_contact) < 0.25  # those at the surface


def test_no_obstacle_is_taken_for_larger_than_it_is(robot: Robot) -> None:
    """A cylinder least of all, of which kernels see the prism about it."""
    random = np.random.default_rng(9)
    for solid in OBSTACLES.values():
        scene = task([0, 5, 0, 0], [0, 80, 5, 5], [solid], clearance=0.01)
        field, checker = _obstacles(PlanningCache(robot).world(scene, PlanOptions())), CoalScene(robot, scene.solids)
        for q in random.uniform(robot.lower, robot.upper, (200, 4)) * [0.05, 1.0, 1.0, 1.0]:
            apart = checker.distances(q)[:, 0]
            assert (field.link_clearances(q) >= np.minimum(apart - 0.01, 0.1) - 1e-9 - 2e-6)[apart > 0.0].all()
