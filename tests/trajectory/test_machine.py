"""Robots of any joints: which of them move, where the others stand, and the limits."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from toy_urdf import LIMIT, urdf

from hplan.errors import InputError, JointLimitError, RobotFileError
from hplan.robot.files import read_models
from hplan.trajectory import time_waypoints
from hplan.trajectory.machine import ENDLESS, limits_of, read_machine


@pytest.fixture
def load(write):
    """A robot from the opening tags of its joints."""
    return lambda *joints, **options: read_machine(write("robot.urdf", urdf(*joints)), **options)


def test_machine_has_the_joints_in_order(toy):
    assert toy.joint_names == ("a", "b")
    assert toy.held == {}
    np.testing.assert_array_equal(toy.model.velocityLimit, [2, 2])


def test_prismatic_joint_moves(load):
    machine = load(f'<joint name="slide" type="prismatic">{LIMIT}', f'<joint name="turn" type="revolute">{LIMIT}')
    motion = time_waypoints(machine.model, [[0, 0], [0.5, 1]], limits_of(machine.model, 5.0))
    np.testing.assert_array_equal(motion.position[-1], [0.5, 1.0])


def test_continuous_joint_counts_past_a_turn(load):
    machine = load('<joint name="spin" type="continuous"><limit velocity="2" effort="60"/>')
    assert (machine.model.nq, machine.model.nv) == (1, 1)
    assert machine.model.upperPositionLimit[0] == ENDLESS
    motion = time_waypoints(machine.model, [[0.0], [20.0]], limits_of(machine.model, 5.0))
    assert motion.position[-1, 0] == 20.0
    # Gravity repeats with each turn.
    twin = pin.rnea(machine.model, machine.model.createData(), np.array([20.0 - 6 * math.pi]), np.zeros(1), np.zeros(1))
    assert motion.torque[-1, 0] == pytest.approx(twin[0])


def test_limits_that_the_urdf_does_not_give(load):
    machine = load('<joint name="spin" type="continuous">')
    with pytest.raises(InputError, match=r"'spin' has no velocity limit") as caught:
        limits_of(machine.model, 5.0)
    assert caught.value.data["joint"] == "spin"
    machine = load('<joint name="spin" type="continuous"><limit velocity="2" effort="1"/>')
    machine.model.effortLimit[0] = np.inf
    with pytest.raises(InputError, match="no torque limit"):
        limits_of(machine.model, 5.0)
    assert limits_of(machine.model, 5.0, torque=False).torque is None


@pytest.mark.parametrize("value", [math.nan, -1.0, [1.0, -2.0]])
def test_limits_out_of_range(toy, value):
    with pytest.raises(InputError, match="acceleration limit is"):
        limits_of(toy.model, value)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joint_of_several_coordinates_is_refused_and_can_stay(load, kind):
    joints = (f'<joint name="base" type="{kind}">', f'<joint name="a" type="revolute">{LIMIT}')
    with pytest.raises(InputError, match=f"'base' cannot be moved or held: it is {kind}"):
        load(*joints)
    machine = load(*joints, joints=["a"])
    assert machine.joint_names == ("a",)
    assert machine.held == {"base": None}


def test_mimic_is_held_with_the_one_it_mimics(load):
    joints = [f'<joint name="{name}" type="revolute">{LIMIT}' for name in ("arm", "finger", "other")]
    joints[2] += '<mimic joint="finger"/>'
    machine = load(*joints)
    assert machine.joint_names == ("arm",)
    assert machine.held == {"finger": 0.0, "other": 0.0}
    for name in ("finger", "other"):
        with pytest.raises(InputError, match=f"'{name}' cannot be moved: .* move as one"):
            load(*joints, joints=[name])


def test_what_mimics_a_held_joint_follows_it(load):
    joints = [f'<joint name="{name}" type="revolute">{LIMIT}' for name in ("arm", "finger", "other")]
    joints[2] += '<mimic joint="finger" multiplier="-0.5" offset="0.1"/>'
    assert load(*joints, hold={"finger": 0.4}).held == {"finger": 0.4, "other": pytest.approx(-0.1)}
    with pytest.raises(InputError, match="'other' cannot be held by itself, for it mimics 'finger'"):
        load(*joints, hold={"other": 0.4})


def test_a_continuous_joint_that_stands_needs_no_limits(load):
    machine = load('<joint name="a" type="continuous">', f'<joint name="b" type="revolute">{LIMIT}', joints=["b"])
    assert (machine.joint_names, machine.held) == (("b",), {"a": 0.0})


def test_held_joints_stand_where_told(load):
    wide, narrow = LIMIT, LIMIT.replace('lower="-3"', 'lower="0.5"')
    joints = [f'<joint name="a" type="revolute">{wide}', f'<joint name="b" type="revolute">{narrow}']
    assert load(*joints, joints=["a"]).held == {"b": 0.5}
    machine = load(*joints, joints=["a"], hold={"b": math.pi / 2})
    # The second link points up: both centres of mass, at 0.2 and 0.4 m.
    still = time_waypoints(machine.model, [[0.0]], limits_of(machine.model, 1.0))
    assert still.torque[0, 0] == pytest.approx(9.81 * (0.2 + 0.4))
    with pytest.raises(JointLimitError, match="hold: joint 'b'"):
        load(*joints, joints=["a"], hold={"b": 0.0})
    with pytest.raises(InputError, match="cannot both"):
        load(*joints, joints=["a"], hold={"a": 0.0})
    for name in ("c", "l1"):
        with pytest.raises(InputError, match=f"no joint '{name}'"):
            load(*joints, joints=[name])
    with pytest.raises(InputError, match="no joint is to move"):
        load(*joints, joints=[])


def test_link_and_joint_of_one_name(write):
    machine = read_machine(write("toy.urdf", urdf(chain=("l2", "l1"))), joints=["l1"])
    assert machine.joint_names == ("l1",)
    assert machine.held == {"l2": 0.0}


def test_what_programs_add_to_robots_of_others_may_stay(write):
    """As in the URDFs of the Panda, ANYmal, PR2 and SO-101."""
    text = urdf().replace("<limit", '<dynamics damping="1" D="1"/><limit gear_velocity="5"')
    text = text.replace('<link name="l0"/>', '<link name="l0"><self_filter/><origin/><sensor/></link>')
    text = text.replace('ixx="0.01"', 'ixx="0.5"')
    machine = read_machine(write("others.urdf", text))
    assert machine.model.inertias[1].inertia[0, 0] == 0.5
    with pytest.raises(RobotFileError, match="<self_filter> in <link> means nothing"):
        read_models(write("ours.urdf", text))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "No such file"),
        ("<robot", "malformed XML"),
        ("<sdf/>", "root element is <sdf>"),
        (urdf().replace('name="b"', 'name="a"'), "'a' is defined twice"),
        (urdf().replace("<limit", "<limits"), "line 1: joint 'a': <limits> in <joint> means nothing"),
        (urdf().replace('<child link="l2"/>', '<child link="l1"/>'), "Pinocchio refuses it"),
        (urdf().replace('lower="-3"', 'lower="-3,0"'), "lower of <limit> is '-3,0', expected a finite number"),
        (urdf().replace('<mass value="1"/>', '<mass value="1_0"/>'), "value of <mass> is '1_0'"),
        (urdf().replace('xyz="0.4 0 0"', 'xyz="0.4 0"'), "xyz of <origin> is '0.4 0', expected 3 finite numbers"),
        (urdf().replace("<mass", "<Mass"), "<Mass> in <inertial> means nothing"),
        (urdf().replace("<origin xyz", "<origin xzy"), "xzy of <origin> means nothing"),
        (urdf().replace('"b"', '"b&#10;c"'), "is called 'b\\\\nc'"),
    ],
)
def test_bad_robot_file(tmp_path, write, text, reason):
    path = tmp_path / "none.urdf" if text is None else write("bad.urdf", text)
    with pytest.raises(RobotFileError, match=reason):
        read_machine(path)
