"""Check that a trajectory has its scene's start, goal and locked joints."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.certificate.goal_contact import THERE, arrival_distance, instant_at
from hplan.kinematics.tool_at_point import approach_angles
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene

#: Tolerance of joint values and of approach angles [rad; m for prismatic joints].
TASK_TOLERANCE = 1e-5

#: Tolerance of the rotation between the goal frame and the goal pose [rad].
_ROTATION_TOLERANCE = 1e-3


def task_violations(robot: Robot, scene: Scene, bezier: FloatArray, times: FloatArray | None = None) -> Iterator[str]:
    """Messages about unsolved parts of the scene's task.

    The motion must start at the start and end at the goal: at its joint values, with the tool at its position, or with
    the frame at its pose, within 1 mm and 0.001 rad or the goal's rotation tolerance. The tool must be at a goal fruit
    at some sample, since a picking motion goes back. At a goal position or fruit the tool must have the required
    approach angle. Locked joints must not move.

    Args:
        robot: The arm.
        scene: The scene with the task.
        bezier: (segments, 4 or 6, dof) Bezier points of the motion's segments.
        times: (samples,) times of the samples on the clock of the scene's tracks; a moving goal fruit counts as reached
            only once it rests. None if it does not move [s].

    Raises:
        InputError: Start, goal or locked joints of the scene do not fit the robot.
    """
    rows = np.vstack([bezier[:, 0], bezier[-1:, -1]])
    start = robot.check_configuration(robot.joints_of(scene.start, "start"), "start")
    yield from _describe_joint_difference(robot, "begins", rows[0], start, "start")
    locked = np.flatnonzero(robot.locked_mask(scene.locked_joints))
    for joint in locked.tolist():
        moved = np.abs(bezier[..., joint] - start[joint]).max()
        if not moved <= TASK_TOLERANCE:
            yield f"joint {robot.joint_names[joint]!r} is locked, but moves by {moved:.4g} rad"
    goal = robot.joints_of(scene.goal, "goal", scene.start)
    if goal is not None:
        asked = robot.check_configuration(robot.turned_near(goal, rows[-1]), "goal")
        yield from _describe_joint_difference(robot, "ends", rows[-1], asked, "goal")
        return
    pose = scene.goal.pose
    if pose is not None:
        yield from _describe_pose_difference(robot, scene.goal, pose, rows[-1])
        return
    resting = scene.resting_goal_fruit
    if resting is None:
        row, what, within = len(rows) - 1, "position", THERE
        away = instant_at(robot, rows[-1:], np.array(scene.goal.position))[1]
    else:
        fruit, rests_s = resting
        first = 0 if times is None else int(np.searchsorted(times, rests_s))
        if first >= len(rows):
            yield f"the motion ends before fruit {fruit.name!r} comes to rest at {rests_s:.6g} s"
            return
        row, away = instant_at(robot, rows[first:], fruit.center)
        row, what, within = row + first, f"fruit {fruit.name!r}", arrival_distance(fruit)
    if not away <= within:
        when = "ends with the tool" if resting is None else "brings the tool no closer than"
        yield f"the motion {when} {1e3 * away:.4g} mm from the goal, {what}"
    else:
        yield from _approach(robot, scene, rows[row])


def _describe_joint_difference(robot: Robot, what: str, q: FloatArray, asked: FloatArray, which: str) -> Iterator[str]:
    """Message about a motion that starts or ends at other joint values."""
    off = np.abs(q - asked)
    joint = int(off.argmax())
    if not off[joint] <= TASK_TOLERANCE:
        yield f"the motion {what} with joint {robot.joint_names[joint]!r} {off[joint]:.4g} rad from the scene's {which}"


def _describe_pose_difference(robot: Robot, goal: Goal, pose: FloatArray, q: FloatArray) -> Iterator[str]:
    """Message about a frame that is not at the goal pose, within its tolerance."""
    there, tolerance = robot.forward_kinematics(q, goal.frame), goal.rotation_tolerance
    away, off = float(np.linalg.norm(there[:3, 3] - pose[:3, 3])), there[:3, :3] - pose[:3, :3]
    # The Frobenius norm of the difference of two rotations is sqrt(8) sin(angle / 2).
    turned = 2.0 * float(np.arcsin(min(np.linalg.norm(off) / np.sqrt(8.0), 1.0)))
    is_turned, allowed = turned <= _ROTATION_TOLERANCE, ""
    if tolerance is not None:
        vector = pin.log3(pose[:3, :3].T @ there[:3, :3])
        is_turned = bool((np.abs(vector) <= tolerance + _ROTATION_TOLERANCE).all())
        about = ", ".join(f"{angle:.4g}" for angle in np.degrees(vector))
        allowed = f", about its axes ({about}) deg; allowed: {goal.rotation_tolerance_deg}"
    if not (away <= THERE and is_turned):
        off_by = f"{1e3 * away:.4g} mm and {turned:.4g} rad"
        yield f"the motion ends with {goal.frame or robot.tool_frame!r} {off_by} from the pose of the goal{allowed}"


def _approach(robot: Robot, scene: Scene, q: FloatArray) -> Iterator[str]:
    """Message about a tool without the goal's approach angle."""
    if scene.goal.approach_deg is None:
        return
    asked = np.radians(np.atleast_1d(scene.goal.approach_deg))
    low, width = asked[0], asked[-1] - asked[0]
    direction = float(approach_angles(robot, q[None])[0])
    beyond = (direction - low + TASK_TOLERANCE) % (2.0 * np.pi)
    if beyond > width + 2.0 * TASK_TOLERANCE:
        angle = np.degrees(np.pi - (np.pi - direction) % (2.0 * np.pi))
        wanted = " to ".join(f"{end:g}" for end in np.degrees(asked[[0, -1] if width > 0.0 else [0]]))
        yield f"the tool is at {angle:.4g} deg at the goal; required: {wanted} deg"
