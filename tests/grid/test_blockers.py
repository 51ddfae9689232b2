"""What blocks: the pairs of link and obstacle on the border of the reached region."""

from __future__ import annotations

import numpy as np
import pytest
from studies.planar_cspace import arm_sections, joint_grid

from hplan.grid.blockers import _grown, blockers
from hplan.grid.occupancy import occupancy
from hplan.robot.model import Robot
from hplan.scene.obstacles import Sphere


@pytest.mark.parametrize("shape", [(7,), (6, 5), (5, 6, 4), (3, 4, 3, 4)])
def test_grown_takes_in_all_neighbours(shape: tuple[int, ...]) -> None:
    mask = np.random.default_rng(0).random(shape) < 0.05
    mask[(0,) * len(shape)] = True
    expected = np.zeros(shape, dtype=bool)
    for node in np.argwhere(mask):
        expected[tuple(slice(max(0, i - 1), i + 2) for i in node)] = True
    np.testing.assert_array_equal(_grown(mask), expected)


def test_only_what_touches_the_reached_region_counts(robot: Robot) -> None:
    """One ball stops the upper arm; another is behind it, out of reach of what the start reaches."""
    balls = [
        Sphere(name="near", center=(0.5, 0.0, 0.85), radius=0.1),
        Sphere(name="behind", center=(-1.0, 0.0, 1.6), radius=0.1),
    ]
    sections = arm_sections(robot, balls)
    grid = joint_grid(robot.arm, np.radians(3.0))
    reached = ~occupancy(robot.arm, sections, grid).occupied
    reached[10:] = False  # the start's side of the near ball
    found = blockers(robot.arm, sections, grid, reached)
    assert {blocker["obstacle"] for blocker in found} == {"near"}
    assert found[0]["link"] == "upper_arm"
    assert found[0]["slices_deg"] == [0.0, 90.0]
    assert [blocker["cells"] for blocker in found] == sorted((blocker["cells"] for blocker in found), reverse=True)


def test_slices_are_those_of_the_occupied_border(robot: Robot) -> None:
    sections = arm_sections(robot, [Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15)])
    grid = joint_grid(robot.arm, np.radians(3.0))
    free = ~occupancy(robot.arm, sections, grid).occupied
    free[..., 11:] = False
    found = blockers(robot.arm, sections, grid, free)
    assert found
    for blocker in found:
        low, high = blocker["slices_deg"]
        assert 0.0 <= low <= high <= 33.0
