"""A scene posed to a robot: what is taken, what is refused, and why."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hplan.collision.coal_scene import CoalScene
from hplan.errors import ConfigurationInCollisionError, InputError
from hplan.planning.definition import Problem, check_problem
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene


def pose(robot: Robot, scene: Scene, **changes: Any) -> Problem:
    changed = Scene.model_validate({**vars(scene), **changes})
    world = World.of(robot, changed.solids, clearance=changed.clearance)
    ends = changed.start.configuration, changed.goal.configuration
    return check_problem(world, *ends, locked_joints=changed.locked_joints)


def test_reference_scene(robot: Robot, scene: Scene) -> None:
    problem = pose(robot, scene)
    np.testing.assert_array_equal(problem.start, np.zeros(4))
    np.testing.assert_allclose(np.degrees(problem.goal), [0, 45, 60, 70], rtol=0, atol=1e-12)
    assert problem.movable.tolist() == [1, 2, 3]
    assert (problem.lower[0], problem.upper[0]) == (0.0, 0.0)
    np.testing.assert_array_equal(problem.lower[1:], robot.lower[1:])
    np.testing.assert_array_equal(problem.upper[1:], robot.upper[1:])
    assert not problem.is_empty


def test_spare_clearance_is_the_lesser_of_both_ends(robot: Robot, scene: Scene) -> None:
    checker = CoalScene(robot, scene.solids)
    problem = pose(robot, scene)
    ends = [checker.distances(q).min() for q in (problem.start, problem.goal)]
    assert problem.spare_clearance == min(ends)
    assert pose(robot, scene, clearance=0.02).spare_clearance == pytest.approx(min(ends) - 0.02)


def test_locked_joints_keep_their_start_value(robot: Robot, scene: Scene) -> None:
    problem = pose(robot, scene, start={"joints_deg": (0.0, 0.0, 60.0, 0.0)}, locked_joints=("base_yaw", "elbow"))
    assert problem.movable.tolist() == [1, 3]
    assert problem.lower[2] == problem.upper[2] == problem.start[2] == problem.goal[2]


def test_the_base_may_turn_unless_it_is_locked(robot: Robot, scene: Scene) -> None:
    free = pose(robot, scene, goal={"joints_deg": (10.0, 45.0, 60.0, 70.0)}, locked_joints=())
    assert free.movable.tolist() == [0, 1, 2, 3]
    assert free.turns
    assert (free.lower[0], free.upper[0]) == (robot.lower[0], robot.upper[0])
    assert not pose(robot, scene).turns


def test_uncertainty_and_tracking_error_take_from_the_spare_clearance(robot: Robot, scene: Scene) -> None:
    ends = scene.start.configuration, scene.goal.configuration
    plain = check_problem(World.of(robot, scene.solids), *ends).spare_clearance
    blurred = [solid.model_copy(update={"sigma": 0.01}) for solid in scene.solids]
    world = World.of(robot, blurred, clearance=0.005, tracking_error=1e-3, sigmas=2.0)
    checker = CoalScene(robot, scene.solids)
    sways = robot.sway(1e-3)[:, None]  # each link its own
    expected = min((checker.distances(robot.check_configuration(q, "")) - sways).min() for q in ends) - 0.005 - 0.02
    assert plain - 0.005 - 0.02 - sways.max() < expected < plain - 0.005 - 0.02
    assert check_problem(world, *ends).spare_clearance == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"locked_joints": ("knee",)}, "locked_joints names 'knee'; the robot has base_yaw, shoulder, elbow, wrist"),
        ({"locked_joints": ("wrist",)}, "joint 'wrist' is locked at 0 rad, but the goal wants it at 1.22173 rad"),
        ({"goal": {"joints_deg": (1.0, 45.0, 60.0, 70.0)}}, "joint 'base_yaw' is locked at 0 rad"),
        ({"goal": {"joints_deg": (0.0, 45.0)}}, "goal: expected 4 joint values"),
    ],
)
def test_refusals(robot: Robot, scene: Scene, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        pose(robot, scene, **changes)
    assert error.value.message.startswith(message)
    assert error.value.data


@pytest.mark.parametrize(
    ("which", "center", "link"), [("start", (2.0, 0.0, 0.6), "hand"), ("goal", (0.3, 0.0, 0.9), "upper_arm")]
)
def test_in_collision(robot: Robot, scene: Scene, which: str, center: Any, link: str) -> None:
    ball = {"kind": "sphere", "name": "ball", "center": center, "radius": 0.1}
    with pytest.raises(ConfigurationInCollisionError) as error:
        pose(robot, scene, obstacles=(ball,))
    assert (error.value.which, error.value.link, error.value.obstacle) == (which, link, "ball")
    assert error.value.depth_m > 0.1
