"""The arm as solids that a camera sees, and how far it reaches.

A planar arm is its links, as capsules where they are, and the hulls of turret and pedestal; any other robot is its
collision bodies.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.collision import reach
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.obstacle_rows import convex_solid
from hplan.robot.base_shapes import TURRET, base_shapes
from hplan.robot.model import Robot
from hplan.scene.obstacles import Capsule, Solid

#: Places and radii no farther apart than this are the same [m].
SAME_M = 1e-6


def arm_solids(robot: Robot, q: FloatArray) -> tuple[Solid, ...]:
    """The arm at a (dof,) configuration: links of planar arms, then turret and pedestal; or its bodies.

    A link that is a capsule is that; of others the planner's capsule would hold points that are not the arm's.
    """
    if robot.planar is None:
        return _bodies(robot, q)
    exact = robot.cached("links_that_are_capsules", lambda: _are_capsules(robot))
    capsules = link_capsules(robot, q)
    others = [] if all(exact) else _bodies(robot, q)
    links: list[Solid] = []
    for k, capsule in enumerate(capsules):
        joint = robot.arm_slice.start + k
        bodies = zip(collision_bodies(robot), others, strict=False)
        links += [capsule] if exact[k] else [solid for body, solid in bodies if body.joint == joint]
    return (*links, *_base_solids(robot, robot.yaw_of(q)))


def link_capsules(robot: Robot, q: FloatArray) -> list[Capsule]:
    """The planner's capsules of a planar arm's links, which hold all that moves with them."""
    origin, (forward, upward, normal) = robot.plane_at(robot.yaw_of(q))
    arm = robot.arm
    points = origin + arm.joint_points(q[robot.arm_slice]) @ np.stack([forward, upward])
    links = []
    for k, name in enumerate(arm.link_names):
        offset = arm.lateral[k] * normal
        ends = {"from": tuple((points[k] + offset).tolist()), "to": tuple((points[k + 1] + offset).tolist())}
        links.append(Capsule.model_validate({"name": name, **ends, "radius": float(arm.half_widths[k])}))
    return links


def _are_capsules(robot: Robot) -> tuple[bool, ...]:
    """Of each link whether the capsule that holds it is its shape: it has balls of that size at both ends."""
    q = np.zeros(robot.dof)
    bodies, solids = collision_bodies(robot), _bodies(robot, q)
    found = []
    for k, capsule in enumerate(link_capsules(robot, q)):
        own = [solid for body, solid in zip(bodies, solids, strict=True) if body.joint == robot.arm_slice.start + k]
        balls = [solid.core[0] for solid in own if len(solid.core) == 1 and solid.rounding >= capsule.radius - SAME_M]
        ends = [any(np.abs(ball - end).max() <= SAME_M for ball in balls) for end in capsule.core]
        found.append(all(ends))
    return tuple(found)


def _bodies(robot: Robot, q: FloatArray) -> tuple[Solid, ...]:
    """The collision bodies of a robot; what no joint moves is made once."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    for number, body in enumerate(collision_bodies(robot)):
        if body.joint < 0:
            make = partial(convex_solid, body.name, body.core, body.rounding)
            found.append(robot.cached(("ground_solid", number), make))
        else:
            place = data.oMi[body.joint + 1]
            found.append(convex_solid(body.name, body.core @ place.rotation.T + place.translation, body.rounding))
    return tuple(found)


def _base_solids(robot: Robot, yaw: float) -> tuple[Solid, ...]:
    """Turret and pedestal; what is the same at every yaw is made once."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    found = []
    for shape in base_shapes(robot):
        if shape.carrier != TURRET or shape.is_round:
            make = partial(convex_solid, shape.name, shape.points, shape.rounding)
            found.append(robot.cached(("base_solid", shape.number), make))
        else:
            points = shape.axis + (shape.points - shape.axis) @ turn.T
            found.append(convex_solid(shape.name, points, shape.rounding))
    return tuple(found)


def reach_ball(robot: Robot) -> FloatArray:
    """(4,) centre and radius of a ball that holds arm, turret and pedestal at all configurations [m]."""
    return robot.cached("reach_ball", lambda: _reach_ball(robot))


def _reach_ball(robot: Robot) -> FloatArray:
    if robot.planar is None:
        return reach.reach_ball(robot)
    arm = robot.arm
    # About the yaw axis, at the height of the shoulder: turning keeps distances from there.
    ahead, across = robot.shoulder_from_axis if robot.has_yaw else (0.0, 0.0)
    foot = robot.yaw_axis if robot.has_yaw else robot.plane_origin[:2]
    centre = np.array([*foot, robot.plane_origin[2]])
    axes = np.hypot(abs(ahead) + np.cumsum(arm.lengths), np.abs(across + arm.lateral))
    radius = float((axes + arm.half_widths).max())
    for shape in base_shapes(robot):
        radius = max(radius, float(np.linalg.norm(shape.points - centre, axis=1).max()) + shape.rounding)
    return frozen(np.append(centre, radius))
