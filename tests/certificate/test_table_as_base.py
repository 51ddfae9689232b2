"""A static, far from convex base: an obstacle under a table is outside it."""

from __future__ import annotations

import pytest
import trimesh
from any_arms import limb
from planned import straight

from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import base_contacts
from hplan.errors import InputError
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Robot:
    legs = [
        trimesh.creation.box(bounds=[(x, y, 0.0), (x + 0.1, y + 0.1, 0.5)]) for x in (-0.5, 0.4) for y in (-0.5, 0.4)
    ]
    path = tmp_path_factory.mktemp("table") / "table.obj"
    trimesh.util.concatenate([trimesh.creation.box(bounds=[(-0.5, -0.5, 0.5), (0.5, 0.5, 0.6)]), *legs]).export(path)
    table = f'<collision><geometry><mesh filename="{path}"/></geometry></collision>'
    return load_robot(
        f'<robot name="on_a_table"><link name="base_link">{table}</link>'
        + limb("slide", "base_link", "prismatic", "0 0 1", "0 0 1.2", '<box size="0.1 0.1 0.1"/>', "0 1")
        + '<joint name="tip" type="fixed"><parent link="slide_link"/><child link="tool0"/></joint><link name="tool0"/>'
        "</robot>"
    )


def certified(robot: Robot, ball: Sphere):
    scene = Scene(name="s", start=Start(joints_rad=(0.2,)), goal=Goal(joints_rad=(0.4,)), obstacles=(ball,))
    return certify(robot, scene, straight(robot, (0.2,), (0.4,), 2.0, 10.0))


def test_obstacle_under_table_is_not_in_contact(robot):
    below = Sphere(name="ball", center=(0.0, 0.0, 0.25), radius=0.1)
    in_leg = Sphere(name="ball", center=(0.45, 0.45, 0.25), radius=0.04)
    assert base_contacts(robot, [below]) == ()
    assert certified(robot, below).verified
    assert {(found.link, found.obstacle) for found in base_contacts(robot, [in_leg])} == {("base_link", "ball")}
    assert not certified(robot, in_leg).verified
    scene = Scene(name="s", start=Start(joints_rad=(0.2,)), goal=Goal(joints_rad=(0.4,)), obstacles=(in_leg,))
    with pytest.raises(InputError, match=r"'ball' is .* mm deep in the robot's 'base_link', which does not move"):
        plan(robot, scene)


@pytest.mark.parametrize(("to", "shown"), [(0.2, True), (0.35, False)])
def test_obstacle_moving_under_table_hits_its_leg(robot, to, shown):
    rolls = Track(times_s=(0.0, 1.9), shifts_m=((0.0, 0.0, 0.0), (to, to, 0.0)))
    found = certified(robot, Sphere(name="ball", center=(0.0, 0.0, 0.25), radius=0.1, track=rolls))
    assert found.verified == shown
    assert shown or all("comes into the robot's 'base_link'" in violation for violation in found.violations)
