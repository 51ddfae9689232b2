"""The arm as solids for camera models, and its workspace ball."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.collision import reach
from hplan.collision.collision_bodies import GROUND, collision_bodies
from hplan.collision.obstacle_rows import convex_solid
from hplan.robot.base_shapes import base_shapes
from hplan.robot.model import Robot, made_once
from hplan.scene.obstacle_kind import posed
from hplan.scene.obstacles import Solid


def arm_solids(robot: Robot, q: FloatArray) -> tuple[Solid, ...]:
    """Collision bodies of a robot at a (dof,) configuration.

    Each body's solid is cached and only its pose is changed.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    for number, body in enumerate(collision_bodies(robot)):
        make = partial(convex_solid, body.name, body.core, body.rounding)
        solid = robot.cached(("body_solid", number), make)
        if body.joint != GROUND:
            place = data.oMi[body.joint + 1]
            solid = posed(solid, place.rotation, place.translation)
        found.append(solid)
    return tuple(found)


@made_once
def reach_ball(robot: Robot) -> FloatArray:
    """(4,) centre and radius of a ball around the workspace [m].

    It contains arm, turret and pedestal at all configurations.
    """
    if robot.planar is None:
        return reach.reach_ball(robot)
    arm = robot.arm
    # The centre is on the yaw axis at shoulder height, so that yaw does not change the distances.
    ahead, across = robot.shoulder_from_axis if robot.has_yaw else (0.0, 0.0)
    foot = robot.yaw_axis if robot.has_yaw else robot.plane_origin[:2]
    centre = np.array([*foot, robot.plane_origin[2]])
    axes = np.hypot(abs(ahead) + np.cumsum(arm.lengths), np.abs(across + arm.lateral))
    radius = float((axes + arm.half_widths).max())
    for shape in base_shapes(robot):
        radius = max(radius, float(np.linalg.norm(shape.core - centre, axis=1).max()) + shape.rounding)
    return frozen(np.append(centre, radius))
