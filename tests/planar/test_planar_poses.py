"""Pose goals and pose sequences of planar arms, by the inverse kinematics of all arms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.errors import UnreachableError
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

START, END = (0.3, 0.4, 0.5, 0.6), (1.2, 0.9, 0.3, 0.8)
QUICK = PlanOptions(effort="quick")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot()


def goal_at(pose: FloatArray) -> Goal:
    turn = pin.Quaternion(pose[:3, :3]).coeffs().tolist()
    return Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=tuple(turn))


def scene_of(robot: Robot, goal: Goal) -> Scene:
    """A ball blocks the straight motion from `START` to `END`."""
    middle = robot.tool_positions(0.5 * (np.array(START) + np.array(END)))
    ball = Sphere(name="ball", center=tuple(middle.tolist()), radius=0.08)
    return Scene(name="pose", start=Start(joints_rad=START), goal=goal, obstacles=(ball,))


def test_pose_is_reached_around_an_obstacle(robot: Robot) -> None:
    pose = robot.forward_kinematics(END)
    scene = scene_of(robot, goal_at(pose))
    found = hplan.plan(robot, scene, QUICK)
    assert found.certificate.verified
    assert robot.forward_kinematics(found.trajectory.position[-1]) == pytest.approx(pose, abs=2e-6)
    assert certify(robot, scene, found.trajectory).verified


def test_approach_to_pose_is_along_last_link(robot: Robot) -> None:
    pose = robot.forward_kinematics(END)
    found = hplan.plan(robot, scene_of(robot, goal_at(pose)), PlanOptions(effort="quick", standoff=0.05))
    assert [phase.name for phase in found.phases] == ["transit", "approach"]
    assert found.grasp is not None
    back = pose[:3, 3] - robot.tool_positions(found.grasp.standoff)
    assert back == pytest.approx(0.05 * pose[:3, 0], abs=1e-5)  # the link points along the x axis of `tool0`


def test_pose_out_of_the_arm_plane_is_refused_with_advice(robot: Robot) -> None:
    pose = robot.forward_kinematics(END)
    pose[:3, :3] = pose[:3, :3] @ pin.rpy.rpyToMatrix(0.1, 0.0, 0.0)  # about the last link, which no joint can do
    with pytest.raises(UnreachableError, match="4 joints reach few poses exactly"):
        hplan.plan(robot, scene_of(robot, goal_at(pose)), QUICK)


def test_straight_lines_through_poses_in_the_arm_plane(robot: Robot) -> None:
    start = (0.2, 0.6, 0.6, 0.6)
    poses = np.repeat(robot.forward_kinematics(start)[None], 2, axis=0)
    poses[:, 2, 3] += [0.1, -0.05]
    scene = Scene(name="poses", start=Start(joints_rad=start), goal=Goal(joints_rad=start))
    found = hplan.plan_poses(robot, scene, poses, QUICK)
    assert found.certificate.verified
    assert robot.forward_kinematics(found.trajectory.position[-1]) == pytest.approx(poses[-1], abs=1e-4)
    assert all(phase["deviation_m"] < 1e-3 for phase in found.report["poses"]["phases"])
