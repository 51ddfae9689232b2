"""A planning problem for a given robot: two checked configurations and the joints that may move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray, Record, readonly
from hplan.errors import InputError
from hplan.planning.joint_ranges import narrowed
from hplan.planning.world import World


@dataclass(frozen=True, eq=False)
class Problem(Record):
    """Start, goal, and the joints that may move between them.

    Attributes:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        movable: Indices of the joints that may move.
        lower: (dof,) joint limits, or where turret and folded neighbours let the joint go from the start
            (`hplan.planning.joint_ranges`); a joint that may not move has its start value as both.
        upper: (dof,) the same.
        spare_clearance: Least clearance of start and goal beyond the one to keep [m]; inf without obstacles.
        turns: True if the base may turn, or the robot is a general (non-planar) arm.
    """

    start: FloatArray
    goal: FloatArray
    movable: IntArray
    lower: FloatArray
    upper: FloatArray
    spare_clearance: float
    turns: bool

    @property
    def is_empty(self) -> bool:
        """True if start and goal are the same configuration."""
        return bool(np.abs(self.goal - self.start).max() < 1e-9)


def check_problem(world: World, start: ArrayLike, goal: ArrayLike, *, locked_joints: Sequence[str] = ()) -> Problem:
    """Check two configurations and locked joints against an arm and what it must keep clear of.

    Args:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        locked_joints: Names of joints that keep their start value.

    Raises:
        InputError: A configuration that is none; a locked joint that the robot does not have, or whose goal differs
            from its start.
        JointLimitError: Start or goal outside the limits.
        ConfigurationInCollisionError: Start or goal in collision, or closer to an obstacle than the clearance to
            keep; names link, obstacle and depth.
        NoPathError: No motion leads from start to goal, as turret or neighbouring links block a joint in between.
    """
    robot = world.robot
    first = robot.check_configuration(start, "start")
    last = robot.check_configuration(goal, "goal")
    locked = robot.locked_mask(locked_joints)
    for joint in np.flatnonzero(locked & (np.abs(last - first) > 1e-9)):
        name = robot.joint_names[joint]
        raise InputError(
            f"joint {name!r} is locked at {first[joint]:.6g} rad, but the goal wants it at {last[joint]:.6g} rad",
            joint=name,
        )
    clearance = min(world.check_clear(first, "start"), world.check_clear(last, "goal"))
    if robot.planar is None:
        # Of hulls, coal's distances are good to its tolerance, and the last digits depend on what it was asked before.
        in_kernels = float(world.field.along([first, last]).min())
        clearance = in_kernels if in_kernels > 0.0 else clearance
    last = readonly(np.where(locked, first, last))
    ranges = narrowed(world.checker, first, last, clearance)
    return Problem(
        start=first,
        goal=last,
        movable=readonly(np.flatnonzero(~locked), np.int64),
        lower=readonly(np.where(locked, first, ranges.lower)),
        upper=readonly(np.where(locked, first, ranges.upper)),
        spare_clearance=clearance,
        turns=robot.planar is None or (robot.has_yaw and not locked[0]),
    )
