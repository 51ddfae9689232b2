"""Starts and goals by joint name and unit."""

from __future__ import annotations

import numpy as np
import pytest

from hplan import PlanOptions, certify, load_robot, load_scene, plan
from hplan.certificate.digests import scene_digest
from hplan.errors import InputError, SceneError
from hplan.robot.model import Robot
from hplan.scene import Goal, Start, dump_scene, parse_scene

RAIL = """<robot name="rail"><link name="base"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="500" acceleration="2"/></joint><link name="cart"/>
<joint name="shoulder" type="revolute"><parent link="cart"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="50" acceleration="2"/></joint>
<link name="arm"><collision><geometry><sphere radius="0.05"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="tool" type="fixed"><parent link="arm"/><child link="tool0"/></joint><link name="tool0"/></robot>"""


@pytest.fixture(scope="module")
def rail() -> Robot:
    return load_robot(RAIL)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"rail_m": 0.3, "shoulder_deg": 40}, [0.3, np.radians(40)]),
        ({"rail_mm": 300, "shoulder_rad": 0.5}, [0.3, 0.5]),
        ({"shoulder": 0.5, "rail": 0.3}, [0.3, 0.5]),
    ],
)
def test_names_have_units(rail, given, expected):
    np.testing.assert_allclose(rail.joints_of(Start(joints=given), "start"), expected)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rail_deg": 3.0, "shoulder": 0.0}, "'rail_deg' has the wrong unit; expected rail_m or rail_mm"),
        ({"rail": 0.0, "shoulder_mm": 1.0}, "expected shoulder_deg or shoulder_rad"),
        ({"rail": 0.0, "sholder_deg": 1.0}, "did you mean 'shoulder'"),
        ({"rail": 0.0, "rail_mm": 1.0, "shoulder": 0.0}, "joint 'rail' is given twice"),
        ({"rail": 0.0}, "no value for shoulder"),
    ],
)
def test_wrong_names_and_units_are_refused(rail, given, message):
    with pytest.raises(InputError, match=message):
        rail.joints_of(Start(joints=given), "start")


def test_scene_with_names_is_planned_certified_and_saved(robot):
    listed = load_scene()
    degrees = dict(zip(robot.joint_names, np.degrees(listed.start.configuration), strict=True))
    start = Start(joints={f"{name}_deg": value for name, value in degrees.items()})
    last = listed.goal.configuration
    ends = zip(robot.joint_names, last, listed.start.configuration, strict=True)
    moved = {name: value for name, value, kept in ends if value != kept}
    named = listed.with_values(start=start, goal=Goal(joints=moved))
    result = plan(robot, named, PlanOptions(effort="quick"))
    np.testing.assert_allclose(result.trajectory.position[-1], last, atol=1e-9)
    assert certify(robot, named, result.trajectory).verified
    assert parse_scene(dump_scene(named)) == named
    other = named.with_values(goal=Goal(joints={**moved, "wrist_deg": 1.0}))
    assert scene_digest(other) != scene_digest(named)


def test_one_kind_of_values_is_given():
    with pytest.raises(SceneError, match="exactly one of"):
        Goal(joints={"a": 1.0}, joints_deg=(1.0,))
    with pytest.raises(SceneError, match="joint goal fixes the approach"):
        Goal(joints={"a": 1.0}, approach_deg=3.0)
