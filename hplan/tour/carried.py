"""Robot model of an arm that carries fruit."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import pinocchio as pin

from hplan.collision.collision_bodies import reuse_bodies
from hplan.robot.model import Robot

#: Name of the collision shape of the carried fruit.
CARRIED = "carried fruit"


def carrying(robot: Robot, radius: float, frames: Sequence[str] = ()) -> Robot:
    """Return the arm with a carried fruit in its collision geometry.

    The fruit is a ball at the tool frame, attached to the joint that carries the frame.

    Args:
        radius: Radius of the fruit [m].
        frames: Tool frames of the loaded arms of a composite robot.
    """
    shapes = robot.collision_model.copy()
    for frame in frames or (robot.tool_frame,):
        number = robot.frame_number(frame)
        at = robot.model.frames[number]
        name = f"{CARRIED} {frame}" if frames else CARRIED
        shapes.addGeometryObject(pin.GeometryObject(name, at.parentJoint, number, at.placement, coal.Sphere(radius)))
    loaded = robot.with_shapes(shapes)
    reuse_bodies(loaded, robot)
    return loaded
