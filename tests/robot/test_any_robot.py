"""Robots by name, trees of joints, SRDF entries; dynamics against Pinocchio, durations."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pinocchio as pin
import pytest
from any_arms import LIFT, limb, loaded_arm
from arm_variants import VARIANTS, load_variant
from hypothesis import given
from hypothesis import strategies as st
from toy_urdf import seven_axis_arm, six_axis_arm

from hplan.base.data_files import robot_names, shipped_limits, shipped_robots
from hplan.base.yaml_text import read_yaml
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.self_pairs import self_pairs
from hplan.errors import InputError, RobotFamilyError, RobotFileError, RobotFileWarning
from hplan.planar.family_reader import family_of, is_planar
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.files import NAMED_ROBOTS, named_robot, read_srdf
from hplan.robot.limits import least_duration_between, rest_to_rest
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
    assert not is_planar(robot)
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
    with pytest.raises(ValueError, match="hplan has no robot with this name; there are harvester, "):
        Scene(name="any", robot="ur6", **ends)


def test_without_the_package_its_extra_is_named(monkeypatch):
    monkeypatch.setattr("hplan.robot.files.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'hplan\[robots\]'") as caught:
        named_robot("panda")
    assert caught.value.data == {"robot": "panda", "extra": "robots"}
    with pytest.raises(RobotFileError, match="with the extra `robots`: panda, ur10, ur3, ur5"):
        load_robot("pandas")


def test_joints_off_the_chain_move_on_request(tmp_path):
    """By default those up to the tool move; all of a tree may."""
    assert load_robot(TREE).joint_names == ("column", "left")
    whole = load_robot(TREE, joints=["column", "left", "right"])
    assert whole.joint_names == ("column", "left", "right")
    assert not is_planar(whole)
    with pytest.raises(RobotFamilyError, match="joint 'right': it is a JointModelP"):
        assert family_of(whole)
    with pytest.raises(InputError, match="joints: left, column, right; expected in the robot's order: column, left, r"):
        load_robot(TREE, joints=["left", "column", "right"])
    assert whole.tool_joint == 2


def test_filter_groups_of_drake():
    """As of an iiwa of Drake's, whose wrist of cylinders touches itself nearly everywhere."""
    links = ("link_5", "link_6", "link_7")
    members = "".join(f'<drake:member link="{link}"/>' for link in links)
    ignored = '<drake:ignored_collision_filter_group name="wrist"/>'
    group = f'<drake:collision_filter_group name="wrist">{members}{ignored}</drake:collision_filter_group>'
    arm = seven_axis_arm().replace("</robot>", group + "</robot>")
    robot = load_robot(arm)
    assert {pair[:2] for pair in robot.may_touch} == set(itertools.combinations(links, 2))
    bodies, pairs = collision_bodies(robot), self_pairs(robot)
    checked = {frozenset((bodies[i].name, bodies[j].name)) for i, j in pairs.checked}
    assert frozenset(("link_5", "link_7")) not in checked
    before = self_pairs(load_robot(seven_axis_arm()))
    assert any({bodies[i].name, bodies[j].name} == {"link_5", "link_7"} for i, j in before.checked)
    assert load_robot(arm.replace(ignored, "")).may_touch == ()
    assert load_robot(arm.replace('group name="wrist">', 'group name="wrist" ignore="true">')).may_touch == ()
    with pytest.raises(RobotFileError, match="link of <drake:member> is 'link_9', expected one of base_link, link_1"):
        load_robot(arm.replace('<drake:member link="link_5"/>', '<drake:member link="link_9"/>'))
    with pytest.raises(RobotFileError, match="is 'hand', expected one of wrist"):
        load_robot(arm.replace('filter_group name="wrist"/>', 'filter_group name="hand"/>'))


def test_srdf(tmp_path):
    path = tmp_path / "some.srdf"
    path.write_text(
        '<robot name="x"><group name="arm"/><disable_collisions link1="a" link2="b" reason="Adjacent"/>'
        '<disable_collisions link1="a" link2="c" reason="Never"/><disable_collisions link1="b" link2="d"/>'
        '<disable_collisions link1="b" link2="e" reason="NotInSampling"/></robot>'
    )
    assert read_srdf(path) == (("a", "b", "Adjacent"), ("b", "d", "by the SRDF"))
    with pytest.raises(
        RobotFileError, match="it is for another robot: none of its pairs, 'a' and 'b' first, is of links"
    ):
        load_robot(LIFT, srdf=path)
    path.write_text(path.read_text().replace('"a"', '"turn_link"').replace('"b"', '"out_link"'))
    assert load_robot(LIFT, srdf=path).may_touch == read_srdf(path)
    path.write_text('<robot name="x"><group name="arm"/></robot>')
    assert load_robot(LIFT, srdf=path).may_touch == ()
    path.write_text(LIFT)
    with pytest.raises(RobotFileError, match="it is a URDF because it has a <link>; expected an SRDF"):
        read_srdf(path)
    path.write_text('<robot name="x"><disable_collisions link1="a"/></robot>')
    with pytest.raises(RobotFileError, match="line 1: <disable_collisions> does not name two links"):
        read_srdf(path)
    with pytest.raises(RobotFileError, match="No such file"):
        load_robot(LIFT, srdf=tmp_path / "none.srdf")


def test_missing_tool_frame_is_reported_before_its_joints():
    """Without it the chain is missing, and mimicking fingers would seem to be joints of the arm."""
    finger = '<joint name="finger" type="revolute"><parent link="base_link"/><child link="finger_link"/>'
    limit = '<axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="1"/>'
    mimics = f'{finger}{limit}<mimic joint="wrist"/></joint><link name="finger_link"/></robot>'
    with pytest.raises(RobotFileError, match=r"frame 'flange0': .* is missing; the links are base_link, .*--tool-f"):
        load_robot(LIFT.replace("</robot>", mimics), tool_frame="flange0")


def test_limits_that_ship_are_taken_by_the_name_of_their_robot():
    text, limits = six_axis_arm(), shipped_limits("ur5")
    with pytest.warns(RobotFileWarning, match=r"or the name of a robot whose limits ship with hplan: harvester, .*ur5"):
        load_robot(text)
    with pytest.raises(RobotFileError, match=r"ur5\.limits\.yaml: .*joints missing"):
        load_robot(text, limits="ur5")
    theirs = read_yaml(limits.read_text())[0]["acceleration_rad_s2"]
    for ours, name in zip(re.findall(r'joint name="(\w+)" type="revolute"', text), theirs, strict=True):
        text = text.replace(f'"{ours}"', f'"{name}"')
    assert load_robot(text, limits="ur5").acceleration_limit.tolist() == list(theirs.values())


def test_mesh_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "hand.stl").write_bytes(b"")
    mesh = f'<mesh filename="{tmp_path}/hand.stl"/>'
    with pytest.raises(RobotFileError, match=r"refuses it: Could not load resource \S+hand.stl File is empty \("):
        load_robot(LIFT.replace('<box size="0.05 0.1 0.2"/>', mesh))


def random_inertia(rng):
    points = rng.normal(size=(20, 3))
    spread = points.T @ points / 20
    return pin.Inertia(rng.uniform(0.1, 5.0), rng.normal(size=3), np.trace(spread) * np.eye(3) - spread)


def random_model(seed):
    """A tree of joints that turn and slide about any axis, gravity and rotors in any direction and size."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    kinds = [
        pin.JointModelRX,
        pin.JointModelRY,
        pin.JointModelRZ,
        pin.JointModelPX,
        pin.JointModelPY,
        pin.JointModelPZ,
        lambda: pin.JointModelRevoluteUnaligned(unit(rng)),
        lambda: pin.JointModelPrismaticUnaligned(unit(rng)),
    ]
    for number in range(int(rng.integers(1, 8))):
        parent = int(rng.integers(0, model.njoints))
        place = pin.SE3(pin.Quaternion(*unit(rng, 4)).toRotationMatrix(), rng.normal(size=3))
        joint = model.addJoint(parent, kinds[rng.integers(len(kinds))](), place, f"j{number}")
        model.appendBodyToJoint(joint, random_inertia(rng), pin.SE3.Random())
    model.armature = rng.uniform(0.0, 2.0, model.nv)
    model.gravity.linear = rng.normal(scale=5.0, size=3)
    return model


def unit(rng, size=3):
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def assert_as_pinocchio(model, rng, count=20):
    dynamics, data = InverseDynamics.build(model), model.createData()
    q = np.array([pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)) for _ in range(count)])
    v, a = 3.0 * rng.normal(size=(2, count, model.nv))
    expected = [pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(dynamics.torques(q, v, a), expected, rtol=1e-10, atol=1e-10)
    gravity = [pin.computeGeneralizedGravity(model, data, row) for row in q]
    np.testing.assert_allclose(dynamics.gravity(q), gravity, rtol=1e-10, atol=1e-10)
    return dynamics


@pytest.mark.parametrize("name", VARIANTS)
def test_arms_of_the_family(name, tmp_path):
    dynamics = assert_as_pinocchio(load_variant(name, tmp_path).model, np.random.default_rng(0))
    assert dynamics.bodies is not None


def test_harvester(robot):
    assert_as_pinocchio(robot.model, np.random.default_rng(1), 200)


@pytest.mark.parametrize("seed", range(30))
def test_random_trees(seed):
    dynamics = assert_as_pinocchio(random_model(seed), np.random.default_rng(seed))
    assert dynamics.bodies is not None


def test_joints_without_one_fixed_axis_are_left_to_pinocchio():
    model = pin.buildSampleModelHumanoid()
    assert assert_as_pinocchio(model, np.random.default_rng(2)).bodies is None
    wheel = pin.Model()
    wheel.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "wheel")
    assert InverseDynamics.build(wheel).bodies is None


def test_no_rows_and_rows_with_gaps(robot):
    dynamics = InverseDynamics.build(robot.model)
    assert dynamics.torques(np.empty((0, 4)), np.empty((0, 4)), np.empty((0, 4))).shape == (0, 4)
    q, v, a = np.random.default_rng(3).normal(size=(3, 10, 4))
    np.testing.assert_array_equal(dynamics.torques(q[::2], v[::2], a[::2]), dynamics.torques(q, v, a)[::2])
    wide = np.asfortranarray(q)
    np.testing.assert_array_equal(dynamics.torques(wide, v, a), dynamics.torques(q, v, a))


def test_robot_cannot_be_changed(robot):
    with pytest.raises(ValueError, match="read-only"):
        InverseDynamics.build(robot.model).bodies[0, 0, 0] = 1.0


LIMIT = st.floats(0.05, 50.0)


def acceleration_phase(speed: float, acceleration: float, jerk: float) -> float:
    """Time from rest to a speed: the acceleration grows, stays, goes back [s]."""
    if speed <= acceleration**2 / jerk:
        return 2.0 * math.sqrt(speed / jerk)
    return speed / acceleration + acceleration / jerk


def plain(distance: float, velocity: float, acceleration: float, jerk: float) -> float:
    """The duration by the greatest speed that there is room for, found by bisection."""
    low, high = 0.0, velocity
    if velocity * acceleration_phase(velocity, acceleration, jerk) <= distance:
        low = velocity
    else:
        for _ in range(200):
            middle = 0.5 * (low + high)
            if middle * acceleration_phase(middle, acceleration, jerk) <= distance:
                low = middle
            else:
                high = middle
    growing = acceleration_phase(low, acceleration, jerk)
    return 2.0 * growing + (distance - low * growing) / low


@given(distance=st.floats(1e-3, 100.0), velocity=LIMIT, acceleration=LIMIT, jerk=st.floats(0.05, 1e4))
def test_duration_with_jerk(distance: float, velocity: float, acceleration: float, jerk: float) -> None:
    found = rest_to_rest(np.array([distance]), velocity, acceleration, jerk)
    assert found[0] == pytest.approx(plain(distance, velocity, acceleration, jerk), rel=1e-9)


@given(turn=st.floats(-3.0, 3.0), first=st.floats(-1.0, 1.0), last=st.floats(-1.0, 1.0), velocity=st.floats(0.3, 3.0))
def test_duration_between_speeds_suffices_and_less_does_not(
    turn: float, first: float, last: float, velocity: float
) -> None:
    """The speeds are between those of the two motions that accelerate at once and brake as late as possible."""
    speeds, push = velocity * np.array([first, last]), 1.7
    found_s = float(least_duration_between(np.array([turn]), (speeds[:1], speeds[1:]), velocity, push)[0])

    def largest_excess(duration_s: float) -> float:
        clock = np.linspace(0.0, duration_s, 4001)
        ramps = push * np.stack([clock, duration_s - clock])
        highest = np.minimum((speeds[:, None] + ramps).min(axis=0), velocity)
        lowest = np.maximum((speeds[:, None] - ramps).max(axis=0), -velocity)
        too_fast = abs(speeds[1] - speeds[0]) - push * duration_s
        return float(max(turn - np.trapezoid(highest, clock), np.trapezoid(lowest, clock) - turn, too_fast))

    assert largest_excess(found_s) <= 1e-5
    assert found_s < 1e-3 or largest_excess(0.999 * found_s - 1e-3) > 0.0


@given(distance=st.floats(1e-3, 100.0), velocity=LIMIT, acceleration=LIMIT)
def test_no_jerk_limit_is_a_very_high_one(distance: float, velocity: float, acceleration: float) -> None:
    found = rest_to_rest(np.array([distance, 0.0]), velocity, acceleration)
    assert found[0] == pytest.approx(plain(distance, velocity, acceleration, 1e12), rel=1e-4)
    assert found[1] == 0.0
