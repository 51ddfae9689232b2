"""The arm as it carries fruit: with room for the thickest of them at its tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import readonly
from hplan.collision.collision_bodies import reuse_bodies
from hplan.robot.model import Robot

#: Name of the shape of what is carried.
CARRIED = "carried fruit"


def carrying(robot: Robot, radius: float, frames: Sequence[str] = ()) -> Robot:
    """The arm as it carries a fruit, as one that is so thick all along.

    Of a planar arm the last link is as thick as the fruit; any other has a ball at the tool frame, on the joint that
    carries it.

    Args:
        radius: Radius of the fruit [m].
        frames: Of several arms as one robot the tool frames of those that carry.
    """
    if robot.planar is not None:
        widths = np.array(robot.arm.half_widths)
        widths[-1] = max(widths[-1], radius + abs(robot.arm.lateral[-1]))
        return robot.with_arm(replace(robot.arm, half_widths=readonly(widths)))
    shapes = robot.collision_model.copy()
    for frame in frames or (robot.tool_frame,):
        number = robot.frame_number(frame)
        at = robot.model.frames[number]
        name = f"{CARRIED} {frame}" if frames else CARRIED
        shapes.addGeometryObject(pin.GeometryObject(name, at.parentJoint, number, at.placement, coal.Sphere(radius)))
    loaded = replace(robot, collision_model=shapes)
    reuse_bodies(loaded, robot)
    return loaded
