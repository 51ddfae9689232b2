"""mplib's calls as ManiSkill's solutions make them."""

from __future__ import annotations

import inspect
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import ArrayLike

from hplan.adapters import mplib
from hplan.adapters.full_configuration import FullConfigurations
from hplan.base.arrays import FloatArray
from hplan.errors import InputError, RobotFileError, RobotFileWarning
from hplan.robot.model import Robot, load_robot

cmeel: Any = pytest.importorskip("cmeel", reason="example-robot-data is not installed (extra `robots`)")

SHARE = Path(cmeel.__path__[0]).parent / "cmeel.prefix" / "share" / "example-robot-data" / "robots"

#: Configuration before a table, fingers open, and names in the order of the URDF.
START = np.array([0.0, 0.2, 0.0, -2.0, 0.0, 2.2, 0.785, 0.04, 0.04])


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda")


@pytest.fixture(scope="module")
def planner(panda: Robot) -> mplib.Planner:
    """A planner as ManiSkill's Panda solver sets it up, in a world about the base."""
    made = mplib.Planner(
        urdf=str(panda.urdf_path), srdf="", move_group="panda_hand_tcp", joint_vel_limits=np.full(7, 0.9),
        joint_acc_limits=np.full(7, 0.9),
    )  # fmt: skip
    made.set_base_pose(BASE)
    return made


def row(pose: FloatArray) -> FloatArray:
    """x, y, z, qw, qx, qy, qz of a matrix."""
    return np.concatenate([pose[:3, 3], np.roll(pin.Quaternion(pose[:3, :3]).coeffs(), 1)])


#: The base is shifted and turned in the world.
BASE = np.array([-0.6, 0.1, 0.2, np.cos(0.4), 0.0, 0.0, np.sin(0.4)])


def in_world(pose: FloatArray) -> FloatArray:
    """The row in the world of a pose in the base frame."""
    base = pin.XYZQUATToSE3(np.concatenate([BASE[:3], np.roll(BASE[3:], -1)]))
    return row(base.homogeneous @ pose)


def lowered(panda: Robot, *, by_m: float) -> FloatArray:
    """The pose of the tool at the start, lower and aside."""
    pose = np.array(panda.forward_kinematics(START[:7]))
    pose[:3, 3] += [0.05, 0.1, -by_m]
    return pose


def test_pose_in_the_world_is_reached_within_the_given_limits(panda: Robot, planner: mplib.Planner) -> None:
    pose = lowered(panda, by_m=0.1)
    found = planner.plan_qpos_to_pose(in_world(pose), START, time_step=0.05, use_point_cloud=False, wrt_world=True)
    assert found["status"] == "Success"
    assert found["certificate"].verified
    np.testing.assert_allclose(panda.forward_kinematics(found["position"][-1]), pose, atol=2e-6)
    np.testing.assert_allclose(found["position"][0], START[:7])
    assert np.abs(found["velocity"]).max() <= 0.9 * 1.001
    assert np.abs(found["acceleration"]).max() <= 0.9 * 1.001
    np.testing.assert_allclose(np.diff(found["time"])[:-1], 0.05)
    assert found["time"][-1] == found["duration"]


def test_screw_moves_the_tool_on_a_straight_line(panda: Robot, planner: mplib.Planner) -> None:
    pose = lowered(panda, by_m=0.15)
    found = planner.plan_screw(in_world(pose), START, time_step=0.02)
    assert found["status"] == "Success"
    at = np.array([panda.forward_kinematics(q)[:3, 3] for q in found["position"]])
    along = (pose[:3, 3] - at[0]) / np.linalg.norm(pose[:3, 3] - at[0])
    off = (at - at[0]) - np.outer((at - at[0]) @ along, along)
    assert np.linalg.norm(off, axis=1).max() < 1e-3


def test_points_count_if_asked_for(panda: Robot, planner: mplib.Planner) -> None:
    pose = lowered(panda, by_m=0.1)
    target = in_world(pose)
    planner.update_point_cloud(target[None, :3], radius=0.05)
    assert planner.plan_qpos_to_pose(target, START, use_point_cloud=False)["status"] == "Success"
    blocked = planner.plan_qpos_to_pose(target, START, use_point_cloud=True)
    assert "point cloud" in blocked["status"]
    planner.update_point_cloud(np.zeros((0, 3)))
    assert planner.plan_qpos_to_pose(target, START, use_point_cloud=True)["status"] == "Success"


def test_attached_box_counts_if_asked_for(panda: Robot, planner: mplib.Planner) -> None:
    pose = lowered(panda, by_m=0.1)
    below = np.array(pose)
    below[2, 3] -= 0.2
    planner.update_point_cloud(in_world(below)[None, :3], radius=0.02)
    planner.update_attached_box([0.04, 0.04, 0.4], [0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0])
    free = planner.plan_qpos_to_pose(in_world(pose), START, use_point_cloud=True)
    assert free["status"] == "Success"
    held = planner.plan_qpos_to_pose(in_world(pose), START, use_point_cloud=True, use_attach=True)
    assert "attached box" in held["status"]
    planner.update_point_cloud(np.zeros((0, 3)))


def test_fingers_are_where_the_configuration_has_them(panda: Robot, planner: mplib.Planner) -> None:
    """A cloud beside the tool touches open fingers, and leaves room for closed ones."""
    pose = np.array(panda.forward_kinematics(START[:7]))
    beside = pose[:3, 3] + pose[:3, 1] * 0.055
    planner.update_point_cloud(
        in_world(np.block([[np.eye(3), beside[:, None]], [np.zeros((1, 3)), 1.0]]))[None, :3], 5e-3
    )
    target, closed = in_world(lowered(panda, by_m=-0.1)), np.append(START[:7], [0.0, 0.0])
    assert planner.plan_qpos_to_pose(target, closed, use_point_cloud=True)["status"] == "Success"
    assert "point cloud" in planner.plan_qpos_to_pose(target, START, use_point_cloud=True)["status"]
    planner.update_point_cloud(np.zeros((0, 3)))


@pytest.mark.parametrize(
    ("qpos", "words"), [(np.zeros(5), "expected 9 values, or 7 of the arm alone"), ([np.nan] * 7, "finite")]
)
def test_wrong_configuration_is_named(planner: mplib.Planner, qpos: ArrayLike, words: str) -> None:
    assert words in planner.plan_qpos_to_pose(BASE, qpos)["status"]


def test_assumed_accelerations_are_told_once() -> None:
    """Robots with other held joints tell nothing again."""
    urdf = str(SHARE / "so_arm_description/urdf/so100.urdf")
    with pytest.warns(RobotFileWarning, match="acceleration limits"):
        made = mplib.Planner(urdf, "gripper", package_keyword_replacement=str(SHARE.parents[1]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for jaw in (0.1, 0.2):
            made.plan_qpos_to_pose(BASE, [0.0, 1.5, -1.4, -1.4, 0.0, jaw])


def test_wrong_pose_is_refused(planner: mplib.Planner) -> None:
    with pytest.raises(InputError, match="quaternion"):
        planner.plan_qpos_to_pose(np.zeros(7), START)


def test_masked_joints_keep_their_values(panda: Robot, planner: mplib.Planner) -> None:
    q = np.array(START[:7])
    q[[1, 3]] += [0.2, 0.15]
    mask = [name == "panda_joint1" for name in planner.user_joint_names]
    found = planner.plan_qpos_to_pose(in_world(panda.forward_kinematics(q)), START, mask)
    assert found["status"] == "Success"
    assert np.ptp(found["position"][:, 0]) < 1e-9


def test_parameters_are_those_of_mplib() -> None:
    real: Any = pytest.importorskip("mplib", reason="mplib is not installed: pip install mplib==0.1.1")
    if not hasattr(real.Planner, "plan_qpos_to_pose"):
        pytest.skip("this mplib has another interface: pip install mplib==0.1.1")
    for call in ("set_base_pose", "update_point_cloud", "update_attached_box", "plan_qpos_to_pose", "plan_screw"):
        theirs = [*inspect.signature(getattr(real.Planner, call)).parameters]
        ours = [*inspect.signature(getattr(mplib.Planner, call)).parameters]
        assert [name for name in theirs if name in ours] == ours, call


def test_values_far_beyond_the_limits_are_not_clipped() -> None:
    robot = load_robot()
    full = FullConfigurations(lambda _: robot, robot.joint_names)
    assert full.arm_at([0.0, -0.005, 0.3, 0.2]) == (0.0, 0.0, 0.3, 0.2)
    assert full.arm_at([0.0, -1.0, 0.3, 3.0]) == (0.0, -1.0, 0.3, 3.0)


def test_missing_files_and_joints_are_named(panda: Robot, tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match="No such file"):
        mplib.Planner(str(tmp_path / "none.urdf"), "panda_hand")
    with pytest.raises(InputError, match="expected panda_joint1, "):
        mplib.Planner(str(panda.urdf_path), "panda_hand", user_joint_names=["a", "b"])
