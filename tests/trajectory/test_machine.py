"""Robots of any joints: which of them move, where the others stand, and the limits."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from toy_urdf import LIMIT, urdf

from hplan.errors import InputError, JointLimitError
from hplan.trajectory import time_waypoints
from hplan.trajectory.machine import ENDLESS, limits_of, read_machine


@pytest.fixture
def load(write):
    """A robot from the opening tags of its joints."""
    return lambda *joints, **options: read_machine(write("robot.urdf", urdf(*joints)), **options)


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
