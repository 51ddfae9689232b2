"""Robots by name, trees of joints, and what an SRDF says."""

from __future__ import annotations

import re

import pytest
from any_arms import LIFT, limb, loaded_arm
from toy_urdf import six_axis_arm

from hplan.base.data_files import robot_names, shipped_limits, shipped_robots
from hplan.base.yaml_text import read_yaml
from hplan.errors import InputError, RobotFamilyError, RobotFileError
from hplan.robot.files import NAMED_ROBOTS, named_robot, read_srdf
from hplan.robot.model import load_robot
from hplan.scene.model import Goal, Scene, Start

#: Two arms on a column.
TREE = (
    '<robot name="tree"><link name="base_link"/>'
    + limb("column", "base_link", "revolute", "0 0 1", "0 0 0.1", '<box size="0.1 0.1 0.4"/>')
    + limb("left", "column_link", "revolute", "0 1 0", "0 0.3 0.2", '<sphere radius="0.05"/>')
    + limb("right", "column_link", "prismatic", "0 1 0", "0 -0.3 0.2", '<sphere radius="0.05"/>', "0 0.3")
    + '<joint name="flange" type="fixed"><parent link="left_link"/><child link="tool0"/></joint><link name="tool0"/>'
    "</robot>"
)


@pytest.mark.parametrize("name", ["panda", "ur3", "ur5", "ur10"])
def test_robots_by_name(name, tmp_path_factory):
    robot = loaded_arm(name, tmp_path_factory)
    assert robot.planar is None
    assert robot.dof == (7 if name == "panda" else 6)
    assert (robot.acceleration_limit > 0.0).all()
    assert (robot.velocity_limit > 0.0).all()
    assert (robot.torque_limit > 0.0).all()
    if name == "panda":
        assert robot.jerk_limit.tolist() == [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]
        assert robot.held == {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
        assert load_robot("panda", hold={"panda_finger_joint1": 0.03}).held["panda_finger_joint2"] == 0.03
        assert load_robot("panda", tool_frame="panda_hand").tool_frame == "panda_hand"


def test_names_are_known_to_scenes():
    assert set(robot_names()) == {*shipped_robots(), *NAMED_ROBOTS}
    ends = {"start": Start(joints_rad=(0.0,)), "goal": Goal(joints_rad=(0.0,))}
    assert Scene(name="any", robot="ur5", **ends).robot == "ur5"
    with pytest.raises(ValueError, match="no robot has that name in hplan; there are harvester, "):
        Scene(name="any", robot="ur6", **ends)


def test_without_the_package_its_extra_is_named(monkeypatch):
    monkeypatch.setattr("hplan.robot.files.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'hplan\[robots\]'") as caught:
        named_robot("panda")
    assert caught.value.data == {"robot": "panda", "extra": "robots"}
    with pytest.raises(RobotFileError, match="with the extra `robots`: panda, ur10, ur3, ur5"):
        load_robot("pandas")


def test_joints_beside_the_chain_move_when_asked(tmp_path):
    """By default those up to the tool move; all of a tree may."""
    assert load_robot(TREE).joint_names == ("column", "left")
    whole = load_robot(TREE, joints=["column", "left", "right"])
    assert whole.joint_names == ("column", "left", "right")
    assert whole.planar is None
    with pytest.raises(RobotFamilyError, match="joint 'right': it is a JointModelP"):
        assert whole.arm
    with pytest.raises(InputError, match="joints: left, column, right; expected in the robot's order: column, left, r"):
        load_robot(TREE, joints=["left", "column", "right"])
    assert whole.tool_joint == 2


def test_srdf(tmp_path):
    path = tmp_path / "some.srdf"
    path.write_text(
        '<robot name="x"><group name="arm"/><disable_collisions link1="a" link2="b" reason="Adjacent"/>'
        '<disable_collisions link1="a" link2="c" reason="Never"/><disable_collisions link1="b" link2="d"/>'
        '<disable_collisions link1="b" link2="e" reason="NotInSampling"/></robot>'
    )
    assert read_srdf(path) == (("a", "b", "Adjacent"), ("b", "d", "by the SRDF"))
    with pytest.raises(RobotFileError, match="it is another robot's: of its pairs, 'a' and 'b' first, none is of this"):
        load_robot(LIFT, srdf=path)
    path.write_text(path.read_text().replace('"a"', '"turn_link"').replace('"b"', '"out_link"'))
    assert load_robot(LIFT, srdf=path).may_touch == read_srdf(path)
    path.write_text('<robot name="x"><group name="arm"/></robot>')
    assert load_robot(LIFT, srdf=path).may_touch == ()
    path.write_text(LIFT)
    with pytest.raises(RobotFileError, match="it is a URDF, for it has a <link>; expected an SRDF"):
        read_srdf(path)
    path.write_text('<robot name="x"><disable_collisions link1="a"/></robot>')
    with pytest.raises(RobotFileError, match="line 1: <disable_collisions> names no two links"):
        read_srdf(path)
    with pytest.raises(RobotFileError, match="No such file"):
        load_robot(LIFT, srdf=tmp_path / "none.srdf")


def test_a_tool_frame_that_is_missing_is_told_before_joints_that_only_it_lets_move():
    """Without it no chain is known, and fingers that mimic one another would seem to be of the arm."""
    finger = '<joint name="finger" type="revolute"><parent link="base_link"/><child link="finger_link"/>'
    limit = '<axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="1"/>'
    mimics = f'{finger}{limit}<mimic joint="wrist"/></joint><link name="finger_link"/></robot>'
    with pytest.raises(RobotFileError, match=r"frame 'flange0': .* is missing; the links are base_link, .*--tool-f"):
        load_robot(LIFT.replace("</robot>", mimics), tool_frame="flange0")


def test_limits_that_ship_are_taken_by_the_name_of_their_robot():
    text, limits = six_axis_arm(), shipped_limits("ur5")
    with pytest.raises(RobotFileError, match=r"or the name of a robot whose limits ship: harvester, .*ur5"):
        load_robot(text)
    with pytest.raises(RobotFileError, match=r"ur5\.limits\.yaml: .*joints missing"):
        load_robot(text, limits="ur5")
    theirs = read_yaml(limits.read_text())[0]["acceleration_rad_s2"]
    for ours, name in zip(re.findall(r'joint name="(\w+)" type="revolute"', text), theirs, strict=True):
        text = text.replace(f'"{ours}"', f'"{name}"')
    assert load_robot(text, limits="ur5").acceleration_limit.tolist() == list(theirs.values())


def test_a_mesh_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "hand.stl").write_bytes(b"")
    mesh = f'<mesh filename="{tmp_path}/hand.stl"/>'
    with pytest.raises(RobotFileError, match=r"refuses it: Could not load resource \S+hand.stl File is empty \("):
        load_robot(LIFT.replace('<box size="0.05 0.1 0.2"/>', mesh))
