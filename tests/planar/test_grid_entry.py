"""Grids of a plan: nodes joined to start and goal, and errors if these are enclosed."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from planned import frame_about_upper_arm, posed, task

import hplan.planar.grids
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import NoPathError
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid_entry import joined_nodes
from hplan.planar.grids import GridAttempt, count_nodes, grid_occupancy
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.planning.solver import best_motion
from hplan.robot.model import Robot
from hplan.scene.obstacles import Sphere

STEP = np.radians(9.0)
PLANAR = slice(1, None)
MARGIN = 1e-3


@pytest.fixture(scope="module")
def grid(robot):
    return Grid.from_limits(robot.lower[PLANAR], robot.upper[PLANAR], STEP)


def joined(robot, grid, q, obstacles=(), occupied=(), yaw=0.0):
    """Nodes joined to planar joint angles, as tuples."""
    mask = np.zeros(grid.shape, dtype=bool)
    for node in occupied:
        mask[tuple(node)] = True
    field = ClearanceField.build(robot, obstacles)
    template = np.array([yaw, *q])
    nodes = joined_nodes(Occupancy.from_mask(grid, mask), template, np.array([1, 2, 3]), field, MARGIN)
    found = [tuple(int(i) for i in node) for node in nodes]
    np.testing.assert_array_equal(template, [yaw, *q])
    return found


def far_from_the_node(grid, node, q):
    return math.dist(grid.coordinates(np.array(node)), q)


@pytest.mark.parametrize("node", [(0, 0, 0), (4, 3, 7), (10, 10, 10)])
@pytest.mark.parametrize("off", [0.0, 1e-9, -1e-7 * STEP])
def test_on_a_node(robot, grid, node, off):
    q = grid.coordinates(np.array(node)) + off
    assert joined(robot, grid, q) == [node]
    assert joined(robot, grid, q, occupied=[node]) == []


def test_off_a_node_all_within_reach_come_the_nearest_first(robot, grid):
    q = (np.array([4.3, 5.0, 6.8])) * STEP
    found = joined(robot, grid, q)
    assert found[0] == (4, 5, 7)
    expected = itertools.product(range(3, 7), range(4, 7), range(5, 9))
    assert sorted(found) == sorted(expected)
    distances = [far_from_the_node(grid, node, q) for node in found]
    assert all(one <= other + 1e-12 for one, other in itertools.pairwise(distances))
    assert joined(robot, grid, q) == found


def test_of_nodes_equally_far_the_first_comes_first(robot, grid):
    """The second axis is half-way between nodes, and with equal steps mirrored offsets are as far as each other."""
    found = joined(robot, grid, np.array([4.3, 4.5, 6.3]) * STEP)
    place = {node: number for number, node in enumerate(found)}
    assert len(found) == 64
    for i, j, k in found:
        for other in ((i, 9 - j, k), (k - 2, j, i + 2)):
            assert (place[i, j, k] < place[other]) == ((i, j, k) < other) or other == (i, j, k)


def test_occupied_nodes_are_left_out(robot, grid):
    q = np.array([4.3, 5.2, 6.8]) * STEP
    every = joined(robot, grid, q)
    assert joined(robot, grid, q, occupied=every[:1]) == every[1:]
    assert joined(robot, grid, q, occupied=every[2:9]) == every[:2] + every[9:]
    assert joined(robot, grid, q, occupied=every) == []


def test_motions_in_contact_are_left_out(robot, grid):
    """A ball just above the hand: nodes with the shoulder higher are free by the mask, but not reached."""
    q = np.array([4.4, 0.02, 0.03]) * STEP
    angle = q.sum()
    tip = np.array([2.2 * np.cos(angle), 0, 0.6 + 2.2 * np.sin(angle)])
    ball = Sphere(name="ball", center=tuple(tip + 0.2 * np.array([-np.sin(angle), 0, np.cos(angle)])), radius=0.1)
    checker = CoalScene(robot, [ball])
    assert checker.distances([0, *q]).min() > MARGIN
    every, found = joined(robot, grid, q), joined(robot, grid, q, [ball])
    assert 0 < len(found) < len(every)
    assert found == [node for node in every if node in found]
    for node in every:
        there = np.array([0, *grid.coordinates(np.array(node))])
        least = min(checker.distances(x).min() for x in np.linspace([0, *q], there, 400))
        if node in found:
            assert least >= 0.5 * MARGIN
        else:
            assert least < MARGIN + 1e-3
    # With the base turned away nothing blocks the arm.
    assert joined(robot, grid, q, [ball], yaw=1.0) == every


def turned_by(robot: Robot, yaw_deg: float, step_deg: float = 1.0) -> Problem:
    scene = task((0.0, 30.0, 20.0, 20.0), (yaw_deg, 30.0, 20.0, 20.0))
    return posed(robot, scene, PlanOptions(step_deg=step_deg))


@pytest.mark.parametrize("attempt", [GridAttempt(2.0, 4.0), GridAttempt(4.0, 45.0), GridAttempt(4.0, 360.0)])
def test_cells_are_those_of_the_grid(robot: Robot, attempt: GridAttempt) -> None:
    one = turned_by(robot, 60.0)
    assert count_nodes(one, attempt) == pytest.approx(grid_occupancy(one, attempt).grid.size, rel=0.15)


def test_closed_on_the_finest_grid_that_fits_names_its_step(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = task((60.0, 20.0, 20.0, 20.0), (0.0, 70.0, 20.0, 20.0), frame_about_upper_arm(60.0, 20.0))
    locked = scene.model_copy(update={"locked_joints": ("base_yaw",), "goal": scene.goal})
    locked = locked.model_copy(update={"goal": type(scene.goal)(joints_deg=(60.0, 70.0, 20.0, 20.0))})
    for one in (posed(robot, scene, PlanOptions(step_deg=3.0)), posed(robot, locked)):
        widest = GridAttempt(1.0, 360.0)
        monkeypatch.setattr(hplan.planar.grids, "MOST_CELLS", 0.5 * count_nodes(one, widest))
        with pytest.raises(NoPathError, match=r"the grid's step is (4|1)\.5 deg") as caught:
            best_motion(one)
        assert caught.value.data["step_deg"] == 1.5 * one.options.step_deg
        assert caught.value.blockers
