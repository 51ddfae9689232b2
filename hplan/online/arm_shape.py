"""The arm as solids that a camera sees, and how far it reaches.

A planar arm is its links, as capsules where they are, and the hulls of turret and pedestal; any other robot is its
collision bodies.
"""

from __future__ import annotations

import math
from collections.abc import Container
from functools import partial

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.collision import reach
from hplan.collision.collision_bodies import GROUND, collision_bodies
from hplan.collision.obstacle_rows import convex_solid
from hplan.robot.base_shapes import TURRET, base_shapes
from hplan.robot.model import Robot, made_once
from hplan.scene.obstacle_kind import posed
from hplan.scene.obstacles import Capsule, Solid

#: Places and radii no farther apart than this are the same [m].
_SAME_M = 1e-6


def arm_solids(robot: Robot, q: FloatArray) -> tuple[Solid, ...]:
    """The arm at a (dof,) configuration: links of planar arms, then turret and pedestal; or its bodies.

    A link that is a capsule is that; of others the planner's capsule would hold points that are not the arm's.
    """
    if robot.planar is None:
        return _bodies(robot, q)
    exact = _are_capsules(robot)
    capsules = [capsule for capsule, is_exact in zip(link_capsules(robot, q), exact, strict=True) if is_exact]
    others = {robot.arm_slice.start + k for k, is_exact in enumerate(exact) if not is_exact}
    return (*capsules, *(_bodies(robot, q, others) if others else ()), *_base_solids(robot, robot.yaw_of(q)))


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


@made_once
def _are_capsules(robot: Robot) -> tuple[bool, ...]:
    """Of each link whether the capsule that holds it is its shape: balls of that size at both ends, a tube between."""
    q, found = np.zeros(robot.dof), []
    for joint, capsule in enumerate(link_capsules(robot, q), robot.arm_slice.start):
        kinds = [body.kind for body in collision_bodies(robot) if body.joint == joint]
        own = list(zip(kinds, _bodies(robot, q, {joint}), strict=True))
        balls = [
            solid.core[0] for kind, solid in own if kind == "sphere" and solid.rounding >= capsule.radius - _SAME_M
        ]
        ends = [any(np.abs(ball - end).max() <= _SAME_M for ball in balls) for end in capsule.core]
        tubes = [_is_tube(solid.core, capsule) for kind, solid in own if kind == "cylinder"]
        found.append(all(ends) and any(tubes))
    return tuple(found)


def _is_tube(core: FloatArray, capsule: Capsule) -> bool:
    """Whether a cylinder, which the capsule holds, reaches from end to end of it and is as thick."""
    start, end = capsule.core
    length = float(np.linalg.norm(end - start))
    along = (core - start) @ ((end - start) / length)
    across = np.linalg.norm(core - start - along[:, None] * ((end - start) / length), axis=1)
    is_foot, is_head = along <= _SAME_M, along >= length - _SAME_M
    return bool(np.all(across >= capsule.radius) and is_foot.any() and is_head.any() and np.all(is_foot | is_head))


def _bodies(robot: Robot, q: FloatArray, joints: Container[int] | None = None) -> tuple[Solid, ...]:
    """The collision bodies of a robot, or those that some joints carry; each is made once and put where it is."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    for number, body in enumerate(collision_bodies(robot)):
        if joints is not None and body.joint not in joints:
            continue
        make = partial(convex_solid, body.name, body.core, body.rounding)
        solid = robot.cached(("body_solid", number), make)
        if body.joint != GROUND:
            place = data.oMi[body.joint + 1]
            solid = posed(solid, place.rotation, place.translation)
        found.append(solid)
    return tuple(found)


def _base_solids(robot: Robot, yaw: float) -> tuple[Solid, ...]:
    """Turret and pedestal; each is made once and put where it is."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    found = []
    for shape in base_shapes(robot):
        make = partial(convex_solid, shape.name, shape.points, shape.rounding)
        solid = robot.cached(("base_solid", shape.number), make)
        if shape.carrier == TURRET and not shape.is_round:
            solid = posed(solid, turn, shape.axis - turn @ shape.axis)
        found.append(solid)
    return tuple(found)


@made_once
def reach_ball(robot: Robot) -> FloatArray:
    """(4,) centre and radius of a ball that holds arm, turret and pedestal at all configurations [m]."""
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
