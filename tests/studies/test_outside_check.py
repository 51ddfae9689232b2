"""Contacts by coal alone: obstacles of each kind, the robot itself, and clouds, against distances to these shapes."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm
from studies.benchmark.motions import TimedMotion
from studies.benchmark.outside_check import OutsideCheck, of_scene

from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, PointCloud, Sphere


@pytest.fixture
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def obstacles_of(kind: str) -> list[Box | Sphere | Capsule | PointCloud]:
    if kind == "box":
        return [Box(name="it", center=(0.5, 0.3, 0.4), size=(0.3, 0.2, 0.4), rpy_deg=(20.0, -40.0, 70.0))]
    if kind == "sphere":
        return [Sphere(name="it", center=(0.5, 0.3, 0.4), radius=0.2)]
    if kind == "capsule":
        ends = {"from": (0.6, -0.2, 0.2), "to": (0.4, 0.5, 0.6)}
        return [Capsule.model_validate({"name": "it", "radius": 0.05, **ends})]
    points = np.random.default_rng(3).normal(size=(300, 3)) * 0.15 + [0.4, 0.2, 0.5]
    return [PointCloud.of("it", points, radius=0.02)]


@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "cloud"])
def test_obstacles_are_touched_where_distances_say_so(arm: Robot, kind: str) -> None:
    obstacles = obstacles_of(kind)
    check = OutsideCheck(arm, *of_scene(obstacles))
    q = np.random.default_rng(4).uniform(arm.lower, arm.upper, (150, arm.dof))
    found, own = check.touched(q)
    checker = CoalScene(arm, tuple(solid for obstacle in obstacles for solid in obstacle.solids))
    own_first = len(checker.pairs) - len(checker.own_others)
    distances = np.array([checker.pair_distances(row) for row in q])
    least = np.array([distances[:, :own_first].min(axis=1), distances[:, own_first:].min(axis=1)])
    for touched, distance in zip((found, own), least, strict=True):
        assert 0 < touched.sum() < len(q)
        clear = np.abs(distance) > 1e-5
        np.testing.assert_array_equal(touched[clear], distance[clear] < 0.0)
    if kind != "cloud":
        np.testing.assert_allclose([check.distance(row) for row in q[found == 0]], least[0][found == 0], atol=5e-6)


def test_a_motion_is_looked_at_each_millisecond(arm: Robot) -> None:
    check = OutsideCheck(arm, [(coal.Sphere(5.0), pin.SE3.Identity())])
    motion = TimedMotion(0.05, lambda clock: np.zeros((len(clock), arm.dof)) + 0.2)
    assert check.contacts(motion)[0] == 51
