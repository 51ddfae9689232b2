"""Isaac Lab's planner interface, with a stand-in for its environment and articulation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hplan.adapters.isaaclab import MotionPlanner
from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.robot.model import Robot, load_robot
from hplan.scene.obstacles import Obstacle, Sphere


class Tensor(np.ndarray):
    """An array with the methods of a tensor that the planner uses."""

    def new_tensor(self, values: FloatArray) -> Tensor:
        return np.asarray(values).view(Tensor)

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> Tensor:
        return self

    def numpy(self) -> FloatArray:
        return np.asarray(self)


def tensor(values: Any) -> Tensor:
    return np.asarray(values, dtype=np.float64).view(Tensor)


START = np.radians([0.0, 50.0, 40.0, 30.0])


@pytest.fixture
def obstacles() -> list[Obstacle]:
    return []


@pytest.fixture
def planner(robot: Robot, obstacles: list[Obstacle]) -> MotionPlanner:
    """A planner of the second of two environments."""
    articulation = SimpleNamespace(
        joint_names=list(robot.joint_names), data=SimpleNamespace(joint_pos=tensor([np.zeros(4), START]))
    )
    return MotionPlanner(
        SimpleNamespace(step_dt=0.1), articulation, env_id=1, load=lambda hold: load_robot(hold=hold),
        obstacles=lambda: obstacles,
    )  # fmt: skip


def target(robot: Robot, yaw_deg: float) -> Tensor:
    return tensor(robot.forward_kinematics(START + np.radians(yaw_deg) * np.eye(4)[0]))


def test_waypoints_lead_to_the_target_step_by_step(robot: Robot, planner: MotionPlanner) -> None:
    goal = target(robot, 40.0)
    assert planner.update_world_and_plan_motion(goal, step_size=0.01)
    assert planner.last is not None
    assert planner.last.certificate.verified
    poses = planner.get_planned_poses()
    followed = []
    while planner.has_next_waypoint():
        followed.append(planner.get_next_waypoint_ee_pose())
    assert len(followed) == len(poses) == int(np.ceil(planner.last.trajectory.duration / 0.1))
    assert all(isinstance(pose, Tensor) for pose in followed)
    np.testing.assert_allclose(followed[-1], goal, atol=2e-6)
    q = planner.last.trajectory.positions([0.1])[0]
    np.testing.assert_allclose(followed[0], robot.forward_kinematics(q), atol=1e-9)


def test_obstacles_are_asked_for_before_each_plan(
    robot: Robot, planner: MotionPlanner, obstacles: list[Obstacle]
) -> None:
    goal = target(robot, 40.0)
    assert planner.update_world_and_plan_motion(goal)
    obstacles.append(Sphere(name="ball", center=tuple(np.asarray(goal)[:3, 3].tolist()), radius=0.05))
    assert not planner.update_world_and_plan_motion(goal)
    assert planner.last is None
    assert not planner.has_next_waypoint()


def test_plan_is_forgotten(robot: Robot, planner: MotionPlanner) -> None:
    assert planner.update_world_and_plan_motion(target(robot, 40.0))
    planner.reset_plan()
    assert not planner.has_next_waypoint()
    assert planner.get_planned_poses() == []
    with pytest.raises(IndexError):
        planner.get_next_waypoint_ee_pose()
    assert planner.get_planner_info() == {"name": "hplan", "env_id": 1, "debug": False}


def test_wrong_target_is_refused(planner: MotionPlanner) -> None:
    with pytest.raises(InputError, match="target_pose"):
        planner.update_world_and_plan_motion(np.eye(3))
