"""Paths of others, timed for any URDF."""

from __future__ import annotations

import csv
import importlib.util
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from toy_urdf import LIMIT, urdf

from hplan.errors import InputError, JointLimitError, TimingError
from hplan.robot.limits import Limits
from hplan.trajectory import (
    largest_path_deviation,
    limit_shares,
    limits_of,
    read_kinematics,
    read_waypoints,
    time_waypoints,
)
from hplan.trajectory.timing import ENDLESS
from hplan.trajectory.trajectory import read_csv

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "time_waypoints.py"


@pytest.fixture(scope="session")
def script():
    spec = importlib.util.spec_from_file_location("time_waypoints_script", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# The CSV


def test_waypoints_in_any_order_with_other_columns(write):
    path = write("w.csv", "\ufefftime_s, b ,a_pos_rad,note\r\n0,1,2,x\r\n\r\n1,-3e-1,4,y\r\n")
    np.testing.assert_array_equal(read_waypoints(path, ("a", "b")), [[2, 1], [4, -0.3]])


# The motion


def check_by_differencing(model: pin.Model, motion, limits: Limits, allowed: float = 1.001) -> None:
    """Check limits of samples, of their differences, and torques by inverse dynamics."""
    step = np.diff(motion.time)[:, None]
    change = np.diff(motion.position, axis=0) / step
    assert (np.abs(change) <= allowed * limits.velocity).all()
    assert (np.abs(np.diff(change, axis=0) / step[1:]) <= allowed * limits.acceleration).all()
    assert (np.abs(motion.velocity) <= allowed * limits.velocity).all()
    assert (np.abs(motion.acceleration) <= allowed * limits.acceleration).all()
    np.testing.assert_allclose(
        np.diff(motion.velocity, axis=0) / step, 0.5 * (motion.acceleration[1:] + motion.acceleration[:-1]), atol=1e-8
    )
    data = model.createData()
    rows = zip(motion.position, motion.velocity, motion.acceleration, strict=True)
    torque = np.array([pin.rnea(model, data, *row) for row in rows])
    np.testing.assert_allclose(torque, motion.torque, atol=1e-9)
    if limits.torque is not None:
        assert (np.abs(torque) <= allowed * limits.torque).all()
    for values in (motion.velocity, motion.acceleration):
        assert np.abs(values[[0, -1]]).max() == 0.0


CORNERS = np.array([[0.0, 0.0], [1.0, 0.5], [0.2, 1.5], [0.21, 1.5], [-1.0, -1.0], [1.0, 0.5]])


@pytest.mark.parametrize("deviation", [1e-4, 0.005, 0.1])
def test_motion_keeps_its_limits_and_is_fast(toy, deviation):
    limits = limits_of(toy, [4.0, 6.0])
    motion = time_waypoints(toy, CORNERS, limits, deviation_rad=deviation)
    check_by_differencing(toy, motion, limits)
    np.testing.assert_array_equal(motion.position[[0, -1]], CORNERS[[0, -1]])
    assert largest_path_deviation(motion.position, CORNERS) <= deviation
    assert limit_shares(motion, limits).bound >= 0.9


@pytest.mark.parametrize("waypoints", [[[0.3, 0.2]], [[0.3, 0.2]] * 4, [[0.3, 0.2], [0.3, 0.2 + 1e-9]]])
def test_no_motion_is_an_empty_motion(toy, waypoints):
    motion = time_waypoints(toy, waypoints, limits_of(toy, 0.0))
    assert motion.samples == 1
    assert motion.torque[0, 0] > 0.0


@pytest.mark.parametrize("size", [1e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("acceleration", [0.5, 50.0])
def test_small_motions(toy, size, acceleration):
    limits = limits_of(toy, acceleration)
    motion = time_waypoints(toy, [[0, 0], [size, size / 3]], limits, deviation_rad=1e-4)
    check_by_differencing(toy, motion, limits)
    np.testing.assert_array_equal(motion.position[-1], [size, size / 3])


def test_reversal_and_a_detour_within_the_deviation(toy):
    limits = limits_of(toy, 4.0)
    way = [[0, 0], [1, 1], [0, 0]]
    motion = time_waypoints(toy, way, limits)
    check_by_differencing(toy, motion, limits)
    assert motion.position.max() >= 1.0 - math.radians(1.0)
    assert time_waypoints(toy, [[0, 0], [1e-3, 0], [0, 0]], limits).samples == 1


@pytest.mark.parametrize(
    ("change", "joint", "cause"),
    [
        ({"velocity": [2.0, 0.0]}, "b", "velocity limit of zero"),
        ({"acceleration": [0.0, 1.0]}, "a", "acceleration limit of zero"),
        ({"torque": [60.0, 0.0]}, "b", "torque limit of zero"),
        ({"torque": [1.0, 60.0]}, "a", "static torque exceeds the limit"),
        ({"jerk": [10.0, 0.0]}, "b", "jerk limit of zero"),
    ],
)
def test_untimeable_path_names_joint_and_cause(toy, change, joint, cause):
    limits = {"velocity": [2.0, 2.0], "acceleration": [4.0, 4.0], "torque": [60.0, 60.0]} | change
    with pytest.raises(TimingError, match=f"'{joint}'") as caught:
        time_waypoints(toy, CORNERS, Limits(**{key: np.array(value) for key, value in limits.items()}))
    assert (caught.value.joint, caught.value.cause) == (joint, cause)


def test_joint_at_rest_may_have_limits_of_zero(toy):
    limits = Limits(np.array([2.0, 0.0]), np.array([4.0, 0.0]), np.array([60.0, 60.0]))
    motion = time_waypoints(toy, [[0, 1], [1, 1]], limits)
    assert np.ptp(motion.position[:, 1]) == 0.0
    assert limit_shares(motion, limits).velocity[1] == 0.0


# The script


def run(script, capsys, *arguments) -> tuple[int, str, str]:
    status = script.main([str(argument) for argument in arguments])
    return status, *capsys.readouterr()


@pytest.fixture
def files(write):
    return write("toy.urdf", urdf()), write("w.csv", "b,a\n0,0\n1,0.5\n-1,0.5\n")


def test_script_writes_the_csv(script, capsys, files, tmp_path):
    out = tmp_path / "o.csv"
    status, text, _ = run(script, capsys, *files, "--acceleration", 4, "--out", out)
    assert status == 0
    motion = read_csv(out)
    assert motion.joint_names == ("a", "b")
    np.testing.assert_array_equal(motion.position[-1], [0.5, -1.0])
    for word in ("w.csv", "toy", f"{motion.duration:.3f} s", "1 deg allowed", "at a limit"):
        assert word in text
    # hplan's output can be timed again.
    status, text, _ = run(script, capsys, files[0], out, "--acceleration", 4, "--out", tmp_path / "o2.csv", "--quiet")
    assert (status, text) == (0, "")
    assert read_csv(tmp_path / "o2.csv").duration == pytest.approx(motion.duration, rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        ((), 2, "--acceleration = None"),
        (("--acceleration", "-1"), 2, "--acceleration = -1.0"),
        (("--acceleration", "0"), 4, "acceleration limit is 0"),
        (("--acceleration", "4", "--rate", "0"), 2, "rate_hz"),
        (("--acceleration", "4", "--speed", "2"), 2, "speed"),
        (("--acceleration", "4", "--deviation", "0"), 2, "deviation_rad"),
        (("--acceleration", "4", "--joints", "c"), 2, "no moving joint 'c'"),
        (("--acceleration", "4", "--joints", "a", "--hold", "b"), 2, "--hold = 'b'"),
        (("--limits", "none.yaml"), 2, "No such file"),
    ],
)
def test_script_failures(script, capsys, files, tmp_path, arguments, status, reason):
    out = tmp_path / "o.csv"
    out.write_text("an earlier result")
    result, _, text = run(script, capsys, *files, *arguments, "--force", "--out", out)
    assert result == status
    assert reason in text
    assert out.read_text() == "an earlier result"


def test_script_does_not_overwrite_its_input(script, capsys, files, tmp_path):
    before = files[1].read_bytes()
    for out, reason in ((files[1], "a file other than"), (tmp_path / "none" / "o.csv", "folder does not exist")):
        status, _, text = run(script, capsys, *files, "--acceleration", 4, "--out", out)
        assert status == 2
        assert reason in text
    assert files[1].read_bytes() == before


# Robots of others


def others_robot(name: str) -> Path:
    """A URDF of the package example-robot-data, which holds data only."""
    cmeel = pytest.importorskip("cmeel", reason="example-robot-data is not installed (extra `robots`)")
    path = Path(cmeel.__file__).parents[1] / "cmeel.prefix/share/example-robot-data/robots" / name
    if not path.exists():
        pytest.skip("example-robot-data is not installed (extra `robots`)")
    return path


@pytest.mark.parametrize(
    ("name", "joints", "held"),
    [
        ("ur_description/urdf/ur5_robot.urdf", 6, 0),
        ("panda_description/urdf/panda.urdf", 7, 2),
        ("kinova_description/robots/kinova.urdf", 6, 0),  # three of its joints are continuous
    ],
)
def test_other_arms(name, joints, held, script, capsys, tmp_path):
    model, others = read_kinematics(others_robot(name))
    joint_names = list(model.names)[1:]
    assert (len(joint_names), len(others)) == (joints, held)
    rng = np.random.default_rng(0)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    waypoints = rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (6, joints))
    limits = limits_of(model, 8.0)
    motion = time_waypoints(model, waypoints, limits)
    check_by_differencing(model, motion, limits)
    assert largest_path_deviation(motion.position, waypoints) <= math.radians(1.0)
    assert limit_shares(motion, limits).bound >= 0.9
    with (tmp_path / "w.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([joint_names, *waypoints.tolist()])
    out = tmp_path / "o.csv"
    assert run(script, capsys, others_robot(name), tmp_path / "w.csv", "--acceleration", 8, "--out", out)[0] == 0
    np.testing.assert_array_equal(read_csv(out).position, motion.position)


@pytest.fixture
def load(write):
    """A robot from the opening tags of its joints."""
    return lambda *joints, **options: read_kinematics(write("robot.urdf", urdf(*joints)), **options)


def test_continuous_joint_counts_past_a_turn(load):
    model, _ = load('<joint name="spin" type="continuous"><limit velocity="2" effort="60"/>')
    assert (model.nq, model.nv) == (1, 1)
    assert model.upperPositionLimit[0] == ENDLESS
    motion = time_waypoints(model, [[0.0], [20.0]], limits_of(model, 5.0))
    assert motion.position[-1, 0] == 20.0
    # Gravity repeats with each turn.
    twin = pin.rnea(model, model.createData(), np.array([20.0 - 6 * math.pi]), np.zeros(1), np.zeros(1))
    assert motion.torque[-1, 0] == pytest.approx(twin[0])


def test_limits_that_the_urdf_does_not_give(load):
    model, _ = load('<joint name="spin" type="continuous">')
    with pytest.raises(InputError, match=r"'spin' has no velocity limit") as caught:
        limits_of(model, 5.0)
    assert caught.value.data["joint"] == "spin"
    model, _ = load('<joint name="spin" type="continuous"><limit velocity="2" effort="1"/>')
    model.effortLimit[0] = np.inf
    with pytest.raises(InputError, match="no torque limit"):
        limits_of(model, 5.0)
    assert limits_of(model, 5.0, torque=False).torque is None


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joint_of_several_coordinates_is_refused_and_can_stay(load, kind):
    joints = (f'<joint name="base" type="{kind}">', f'<joint name="a" type="revolute">{LIMIT}')
    with pytest.raises(InputError, match=f"'base' cannot be moved or held: it is {kind}"):
        load(*joints)
    model, held = load(*joints, joints=["a"])
    assert tuple(model.names)[1:] == ("a",)
    assert held == {"base": None}


def test_mimic_is_held_with_the_one_it_mimics(load):
    *one, other = [f'<joint name="{name}" type="revolute">{LIMIT}' for name in ("arm", "finger", "other")]
    joints = [*one, other + '<mimic joint="finger"/>']
    model, held = load(*joints)
    assert tuple(model.names)[1:] == ("arm",)
    assert held == {"finger": 0.0, "other": 0.0}
    for name in ("finger", "other"):
        with pytest.raises(InputError, match=f"'{name}' cannot be moved: .* move as one"):
            load(*joints, joints=[name])
    # The mimicking joint follows if the other is elsewhere.
    joints = [*one, other + '<mimic joint="finger" multiplier="-0.5" offset="0.1"/>']
    assert load(*joints, hold={"finger": 0.4})[1] == {"finger": 0.4, "other": pytest.approx(-0.1)}
    with pytest.raises(InputError, match="'other' cannot be held by itself because it mimics 'finger'"):
        load(*joints, hold={"other": 0.4})


def test_held_joints_are_at_given_positions(load):
    wide, narrow = LIMIT, LIMIT.replace('lower="-3"', 'lower="0.5"')
    joints = [f'<joint name="a" type="revolute">{wide}', f'<joint name="b" type="revolute">{narrow}']
    assert load(*joints, joints=["a"])[1] == {"b": 0.5}
    model, _ = load(*joints, joints=["a"], hold={"b": math.pi / 2})
    # The second link points up: both centres of mass, at 0.2 and 0.4 m.
    still = time_waypoints(model, [[0.0]], limits_of(model, 1.0))
    assert still.torque[0, 0] == pytest.approx(9.81 * (0.2 + 0.4))
    with pytest.raises(JointLimitError, match="hold: joint 'b'"):
        load(*joints, joints=["a"], hold={"b": 0.0})
    with pytest.raises(InputError, match="cannot both"):
        load(*joints, joints=["a"], hold={"a": 0.0})
    for name in ("c", "l1"):
        with pytest.raises(InputError, match=f"no moving joint '{name}'"):
            load(*joints, joints=[name])
    with pytest.raises(InputError, match="there is no joint to move"):
        load(*joints, joints=[])
