"""Collision-free configurations for a pose goal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.base.deadline import check_deadline
from hplan.errors import BlockedError, ConfigurationInCollisionError, InputError, TiltedError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning.world import World
from hplan.scene.model import Goal

#: Numbers of starts of the inverse kinematics, tried in order until a configuration is collision-free; and the same for
#: callers that have other means.
STARTS, FEW_STARTS = (64, 512), (64,)


def configurations_at(
    world: World, goal: Goal, start: FloatArray, locked: Sequence[str] = (), starts: Sequence[int] = FEW_STARTS
) -> FloatArray:
    """Return collision-free configurations with a frame at the goal pose, within its tolerance, nearest first.

    Args:
        world: The arm among its obstacles.
        goal: The goal, with a pose.
        start: (dof,) start configuration.
        locked: Names of joints that keep their start values.
        starts: Numbers of starts of the inverse kinematics, tried in order until a configuration is collision-free.

    Returns:
        (k, dof) configurations, k >= 1, by distance from the start; more may exist
        (`hplan.kinematics.inverse_kinematics`).

    Raises:
        InputError: The goal has no pose, or an unknown frame.
        UnreachableError: No configuration was found, obstacles ignored.
        TiltedError: The tool has to stay upright, and is not at the pose.
        BlockedError: Obstacles, or parts of the arm, block every configuration found; names them.
    """
    robot, pose = world.robot, goal_pose(goal)
    for seeds in starts:
        found = inverse_kinematics(
            robot, pose, start=start, frame=goal.frame, seeds=seeds, locked=locked,
            rotation_tolerance_rad=goal.rotation_tolerance,
        )  # fmt: skip
        tilted: TiltedError | None = None
        clear: list[FloatArray] = []
        blocked: Counter[tuple[str, str]] = Counter()
        largest = -np.inf
        for q in found:
            check_deadline()
            try:
                world.check_clear(q, "goal")
            except ConfigurationInCollisionError as error:
                blocked[error.link, error.obstacle] += 1
                largest = max(largest, -error.depth_m)
            except TiltedError as error:
                tilted = error.with_traceback(None)
            else:
                clear.append(q)
        if clear:
            break
    if not clear and tilted is not None and not blocked:
        raise tilted
    if not clear:
        obstacles = [
            {"obstacle": obstacle, "link": link, "configurations": count}
            for (link, obstacle), count in blocked.most_common()
        ]
        raise BlockedError("the pose", len(found), obstacles, best_clearance_m=float(largest))
    return frozen(np.array(clear))


def goal_pose(goal: Goal) -> FloatArray:
    """Return the (4, 4) pose of a goal.

    Raises:
        InputError: The goal has no pose.
    """
    if goal.pose is None:
        raise InputError("expected a goal with position and quaternion_xyzw")
    return goal.pose


def goal_at(pose: FloatArray) -> Goal:
    """Return the goal of the tool frame at a (4, 4) pose in `base_link`.

    Raises:
        SceneError: Its upper left part is not a rotation.

    Examples:
        >>> from hplan.planning.pose_goal import goal_at
        >>> goal_at(np.eye(4)).quaternion_xyzw
        (0.0, 0.0, 0.0, 1.0)
    """
    turn = pin.Quaternion(pose[:3, :3]).coeffs().tolist()
    return Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=tuple(turn))
