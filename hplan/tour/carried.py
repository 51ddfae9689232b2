"""The arm as it carries fruit: with room for the thickest of them at its tool."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import readonly
from hplan.collision.collision_bodies import reuse_bodies
from hplan.robot.model import Robot

#: Name of the shape of what is carried.
CARRIED = "carried fruit"


def carrying(robot: Robot, radius: float) -> Robot:
    """The arm as it carries a fruit, as one that is so thick all along.

    Of a planar arm the last link is as thick as the fruit; any other has a ball at the tool frame, on the joint that
    carries it.

    Args:
        radius: Radius of the fruit [m].
    """
    if robot.planar is not None:
        widths = np.array(robot.arm.half_widths)
        widths[-1] = max(widths[-1], radius + abs(robot.arm.lateral[-1]))
        return robot.with_arm(replace(robot.arm, half_widths=readonly(widths)))
    number = robot.frame_number(robot.tool_frame)
    shapes = robot.collision_model.copy()
    placement = robot.model.frames[number].placement
    shapes.addGeometryObject(pin.GeometryObject(CARRIED, robot.tool_joint, number, placement, coal.Sphere(radius)))
    loaded = replace(robot, collision_model=shapes)
    reuse_bodies(loaded, robot)
    return loaded
