"""Given waypoints of straight motions, validated, and the scene between their ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray, Record, frozen, numbers
from hplan.errors import InputError, MovingObstacleError
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start

#: Waypoints closer to each other than this in every joint are one; the same holds for path ends and the scene's start
#: and goal [rad].
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class GivenPath(Record):
    """Waypoints within the joint limits, without consecutive repetitions.

    Attributes:
        points: (m, dof) waypoints, m >= 2.
        numbers: (m,) their numbers among the given ones, counted from 1; for repeated ones the first.
        count: Number of given waypoints, repetitions included.
    """

    points: FloatArray
    numbers: IntArray
    count: int


def given_path(robot: Robot, waypoints: ArrayLike) -> GivenPath:
    """Validate waypoints and drop consecutive repetitions.

    Args:
        waypoints: (n, dof) configurations, start to goal.

    Raises:
        InputError: `waypoints` is not an (n, dof) array of finite numbers, has fewer than two, or all are the same.
        JointLimitError: A waypoint violates the joint limits; names it, counted from 1, and the joint.
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
    """The scene with the ends of a path as start and goal.

    The same scene if they are its own.

    Args:
        scene: The obstacles; a fruit that is its goal is an obstacle like all others.

    Raises:
        InputError: A locked joint moves along the path, or the scene's start is in motion.
        MovingObstacleError: The scene has a moving obstacle or a moving base.
    """
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    if scene.start.is_moving:
        raise InputError("the scene's start is in motion, but the motion along a given path begins at rest")
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
