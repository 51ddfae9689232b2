"""Contacts by coal alone: obstacles of each kind, the robot itself, clouds, what moves, against distances to these."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import coal_distances
from studies.moving import moving_scene
from studies.outside import OutsideCheck, TimedMotion, least_distance

from hplan.collision.coal_scene import CoalScene
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, Cylinder, PointCloud, Sphere


@pytest.fixture
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def obstacle_of(kind: str) -> Box | Sphere | Capsule | Cylinder | PointCloud:
    if kind == "box":
        return Box(name="it", center=(0.5, 0.3, 0.4), size=(0.3, 0.2, 0.4), rpy_deg=(20.0, -40.0, 70.0))
    if kind == "sphere":
        return Sphere(name="it", center=(0.5, 0.3, 0.4), radius=0.2)
    if kind == "cylinder":
        return Cylinder(name="it", center=(0.5, 0.3, 0.4), radius=0.15, length=0.5, rpy_deg=(20.0, -40.0, 70.0))
    if kind == "capsule":
        ends = {"from": (0.6, -0.2, 0.2), "to": (0.4, 0.5, 0.6)}
        return Capsule.model_validate({"name": "it", "radius": 0.05, **ends})
    points = np.random.default_rng(3).normal(size=(300, 3)) * 0.15 + [0.4, 0.2, 0.5]
    return PointCloud.of("it", points, radius=0.02)


@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "cylinder", "cloud"])
def test_obstacles_are_touched_where_distances_say_so(arm: Robot, kind: str) -> None:
    obstacle = obstacle_of(kind)
    check, checker = OutsideCheck(arm, [obstacle]), CoalScene(arm, tuple(obstacle.solids))
    q = np.random.default_rng(4).uniform(arm.lower, arm.upper, (100, arm.dof))
    found = np.array([check.touched(row) for row in q]).T
    own_first = len(checker.pairs) - len(checker.own_others)
    distances = np.array([checker.pair_distances(row) for row in q])
    least = np.array([distances[:, :own_first].min(axis=1), distances[:, own_first:].min(axis=1)])
    near = 2e-3 if kind == "cylinder" else 1e-5  # a cylinder is planned for as something larger
    for touched, distance in zip(found, least, strict=True):
        assert 0 < touched.sum() < len(q)
        clear = np.abs(distance) > near
        np.testing.assert_array_equal(touched[clear], distance[clear] < 0.0)


def test_a_motion_is_looked_at_each_millisecond(arm: Robot) -> None:
    check = OutsideCheck(arm, [Sphere(name="all", center=(0.0, 0.0, 0.0), radius=5.0)])
    motion = TimedMotion(0.05, lambda clock: np.zeros((len(clock), arm.dof)) + 0.2)
    assert check.contacts(motion)[0] == 51


@pytest.mark.parametrize("number", [1, 3])
def test_what_moves_is_where_it_is_at_each_time(robot: Robot, number: int) -> None:
    scene = moving_scene(robot, 0, number)
    start, goal = scene.start.configuration, scene.goal.configuration

    def positions(clock):
        return start + np.clip(clock / 2.0, 0.0, 1.0)[:, None] * (goal - start)

    times = np.linspace(0.0, 2.0, 9)
    wanted = min(
        coal_distances(robot, q, scene.at(time).obstacles).min()
        for time, q in zip(times.tolist(), positions(times), strict=True)
    )
    # The arm's own shapes lie within the capsules that the other one takes for its links.
    assert wanted - 1e-6 <= least_distance(robot, scene, positions, 2.0, 0.25) <= wanted + 0.05


def test_an_obstacle_that_cannot_be_placed_is_refused(arm: Robot) -> None:
    with pytest.raises(InputError, match="not looked at"):
        OutsideCheck(arm, ["tree"])
