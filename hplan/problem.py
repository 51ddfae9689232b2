"""From a scene to a planning problem for a given robot: two checked configurations and the joints that may move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.arrays import FloatArray, IntArray, readonly
from hplan.collision import CollisionScene, check_clear
from hplan.errors import InputError
from hplan.robot import Robot
from hplan.scene import Scene


@dataclass(frozen=True, eq=False)
class Problem:
    """Where to go from and to, and with which joints.

    Attributes:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        movable: Indices of the joints that may move.
        lower: (dof,) joint limits; a joint that may not move has its start value as both.
        upper: (dof,) joint limits.
        clearance: Clearance to keep [m]: the scene's, and what the tracking error may take.
        spare_clearance: Least clearance of start and goal beyond that [m]; inf without obstacles.
    """

    start: FloatArray
    goal: FloatArray
    movable: IntArray
    lower: FloatArray
    upper: FloatArray
    clearance: float
    spare_clearance: float

    @property
    def is_empty(self) -> bool:
        """Whether start and goal are the same configuration."""
        return bool(np.abs(self.goal - self.start).max() < 1e-9)


def pose_problem(robot: Robot, scene: Scene, judge: CollisionScene, *, tracking_error: float = 0.0) -> Problem:
    """Check start, goal and locked joints of a scene against a robot.

    Args:
        robot: The arm.
        scene: Obstacles and task.
        judge: The scene in coal.
        tracking_error: Deviation of any joint that the motion has to allow for [rad].

    Raises:
        InputError: A locked joint that the robot does not have, or whose goal differs from its start; a goal that is
            not given by joints; a base that would have to turn.
        JointLimitError: Start or goal outside the limits.
        ConfigurationInCollisionError: Start or goal in collision, or closer to an obstacle than the clearance to
            keep; names link, obstacle and depth.
    """
    start = robot.check_configuration(_joints(scene, "start"), "start")
    goal = robot.check_configuration(_joints(scene, "goal"), "goal")
    unknown = [name for name in scene.locked_joints if name not in robot.joint_names]
    if unknown:
        raise InputError(
            f"locked_joints names {unknown[0]!r}; the robot has {', '.join(robot.joint_names)}", joint=unknown[0]
        )
    locked = np.array([name in scene.locked_joints for name in robot.joint_names])
    for joint in np.flatnonzero(locked & (np.abs(goal - start) > 1e-9)):
        name = robot.joint_names[joint]
        raise InputError(
            f"joint {name!r} is locked at {start[joint]:.6g} rad, but the goal wants it at {goal[joint]:.6g} rad",
            joint=name,
        )
    if robot.has_yaw and abs(goal[0] - start[0]) > 1e-9:
        raise InputError(
            f"start and goal differ in {robot.joint_names[0]!r}; planning with a turning base is not available yet",
            joint=robot.joint_names[0],
        )
    if robot.has_yaw:
        locked[0] = True
    clearance = scene.clearance + float(robot.sway(tracking_error).max())
    spare = min(check_clear(judge, start, clearance, "start"), check_clear(judge, goal, clearance, "goal"))
    return Problem(
        start=start,
        goal=readonly(np.where(locked, start, goal)),
        movable=readonly(np.flatnonzero(~locked), np.int64),
        lower=readonly(np.where(locked, start, robot.lower)),
        upper=readonly(np.where(locked, start, robot.upper)),
        clearance=clearance,
        spare_clearance=spare,
    )


def _joints(scene: Scene, which: str) -> FloatArray:
    """Joint values of start or goal [rad]."""
    target = scene.start if which == "start" else scene.goal
    joints = target.joints()
    if joints is None:
        raise InputError(
            f"{which}: a tool position or a fruit needs inverse kinematics, not available yet; give joints_deg",
            which=which,
        )
    return joints
