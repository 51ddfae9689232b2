"""A path of straight motions that was given: its waypoints, checked, and the scene from its first to its last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray, Record, frozen, numbers
from hplan.errors import InputError, MovingObstacleError
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start

#: Waypoints nearer to each other than this, joint by joint, are one; ends so near to the scene's are those [rad].
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class GivenPath(Record):
    """Waypoints within the joint limits, no two neighbours the same.

    Attributes:
        points: (m, dof) waypoints, m >= 2.
        numbers: (m,) their numbers among those that were given, counted from 1; of repeated ones the first.
    """

    points: FloatArray
    numbers: IntArray
    count: int


def given_path(robot: Robot, waypoints: ArrayLike) -> GivenPath:
    """Check waypoints; those that repeat the one before are left out.

    Args:
        waypoints: (n, dof) configurations, start to goal.

    Raises:
        InputError: No (n, dof) array of finite numbers, fewer than two waypoints, or all the same.
        JointLimitError: A waypoint outside the joint limits; names it, counted from 1, and the joint.
    """
    points = numbers("waypoints", waypoints, (None, robot.dof))
    if len(points) < 2:
        raise InputError(f"waypoints: expected two or more, got {len(points)}", count=len(points))
    points = np.array([robot.check_configuration(q, f"waypoint {number + 1}") for number, q in enumerate(points)])
    kept = [0]
    for number in range(1, len(points)):
        if np.abs(points[number] - points[kept[-1]]).max() > SAME:
            kept.append(number)
    if len(kept) < 2:
        raise InputError(f"waypoints: all {len(points)} are the same; there is no motion to make", count=len(points))
    return GivenPath(frozen(points[kept]), frozen(np.array(kept, dtype=np.int64) + 1), len(points))


def scene_along(robot: Robot, scene: Scene, path: GivenPath) -> Scene:
    """The scene with the ends of a path as start and goal; the same scene where these are its own.

    Args:
        scene: What is around it; a fruit that is its goal is an obstacle as all others are.

    Raises:
        InputError: Joints that are locked move along the path, or the scene's start is in motion.
        MovingObstacleError: Something in the scene moves.
    """
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    if scene.start.is_moving:
        raise InputError("the scene's start is in motion, and the motion along a given path begins at rest")
    for joint in np.flatnonzero(robot.locked_mask(scene.locked_joints)).tolist():
        off = np.abs(path.points[:, joint] - path.points[0, joint])
        if off.max() > SAME:
            number, name = int(path.numbers[int((off > SAME).argmax())]), robot.joint_names[joint]
            raise InputError(
                f"waypoint {number}: joint {name!r} is locked, but moves by {off.max():.6g} rad along the path",
                joint=name,
                waypoint=number,
            )
    own = robot.joints_of(scene.start, "start"), robot.joints_of(scene.goal, "goal")
    ends = zip(own, path.points[[0, -1]], strict=True)
    if all(own is not None and own.shape == end.shape and np.abs(own - end).max() <= SAME for own, end in ends):
        return scene
    start, goal = (tuple(path.points[end].tolist()) for end in (0, -1))
    return scene.copy_unchecked({"start": Start(joints_rad=start), "goal": Goal(joints_rad=goal)})
