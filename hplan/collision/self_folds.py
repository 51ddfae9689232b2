"""Parts of neighbouring links that must not fold into each other.

Two bodies on both sides of a revolute joint overlap around its axis at every angle, so the pair is not checked
(`hplan.collision.self_pairs.SelfPairs.hinged`). The part of either body that is farther from the axis than
`_FOLD_REACH` times their required distance (both radii and the clearance) must keep the clearance from the whole other
body. The factor is necessary because a link ends in a cap with its radius, and links that meet at an angle overlap up
to 1 / sin(angle) times their radii. Thus all angles down to 19.5 degrees are allowed.

The radius of a body is that of a bounding capsule. A part is cut off by a plane parallel to the axis and perpendicular
to the body's direction, and is rounded as the body is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.collision.coal_shapes import solid_shape
from hplan.collision.collision_bodies import (
    MOST_BODY_POINTS,
    CollisionBody,
    body_shapes,
    capsule_about,
    collision_bodies,
)
from hplan.collision.motion_coefficients import joint_axis
from hplan.collision.self_pairs import BEARING, SLACK, one_joint, rounded_up, self_pairs
from hplan.geometry.coal_hull import convex_hull_shape
from hplan.geometry.hull import hull_of
from hplan.geometry.shape_outline import outline
from hplan.robot.model import Robot
from hplan.scene.obstacles import Capsule

#: Neighbouring links may overlap up to this multiple of their required distance from their joint.
_FOLD_REACH: Final = 3.0

#: A body along the axis, up to this sine, has no parts beyond it.
_ALONG: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Fold(Record):
    """The part of a body beyond its joint, and the body that it must not touch.

    Attributes:
        body: The part.
        shape: The part in coal.
        whole: Index of the body that it was cut from, in `collision_bodies`.
        other: Index of the other body.
        farthest: Maximum distance of both at all joint values [m]; infinite if the full clearance is required.
    """

    body: CollisionBody
    shape: pin.GeometryObject
    whole: int
    other: int
    farthest: float


def folds(robot: Robot, deviation: float, clearance: float) -> tuple[Fold, ...]:
    """Parts of neighbouring bodies that can come nearer to each other than the clearance; cached.

    Args:
        robot: The robot.
        deviation: Maximum excess of joints over their limits [rad].
        clearance: Required clearance [m].
    """
    most_known = 32
    decide = robot.cache("folds", lambda: lru_cache(most_known)(partial(_folds, robot)))
    return decide(rounded_up(deviation), max(float(clearance), 0.0))


def _folds(robot: Robot, deviation: float, clearance: float) -> tuple[Fold, ...]:
    return tuple(
        fold
        for i, j, joint in self_pairs(robot).hinged
        for whole, other in ((i, j), (j, i))
        for fold in _parts_beyond(robot, (whole, other, joint), deviation, clearance)
    )


def _parts_beyond(robot: Robot, hinge: tuple[int, int, int], deviation: float, clearance: float) -> Iterator[Fold]:
    """Parts of the first body of a hinge that can come near the second."""
    whole, other, joint = hinge
    bodies, shapes = collision_bodies(robot), body_shapes(robot)
    (axis, slides), body = joint_axis(robot, joint), bodies[whole]
    if slides:
        return
    radii = sum(capsule_about(each.core)[2] + each.rounding for each in (body, bodies[other]))
    # The axis in the frame of the body's joint.
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.zeros(robot.dof))
    place = data.oMi[body.joint + 1].actInv(data.oMi[joint + 1])
    axis, origin = place.rotation @ axis, place.translation
    start, vector, _ = capsule_about(body.core)
    along = vector if np.linalg.norm(vector) > _ALONG else start - origin
    along = along - (along @ axis) * axis
    length = float(np.linalg.norm(along))
    if length <= _ALONG:
        return
    points, rounding = outline(shapes[whole], rim_from_outside=True)
    points = points @ shapes[whole].placement.rotation.T + shapes[whole].placement.translation
    for direction in (along / length, -along / length):
        part = _cut_above(points, points @ direction - (origin @ direction + _FOLD_REACH * (radii + clearance)))
        if not len(part):
            continue
        shape = _folded_shape(f"{body.name}:{whole}:beyond", shapes[whole].parentJoint, part, rounding)
        near = one_joint(robot, (shape, shapes[other]), joint, deviation)
        if near.is_always_within(0.0) or not near.may_reach(SLACK + clearance):
            continue
        level = max(clearance, BEARING)
        farthest = level if near.is_always_within(level) else np.inf
        yield Fold(_body(body, part, rounding), shape, whole, other, farthest)


def _cut_above(points: FloatArray, heights: FloatArray) -> FloatArray:
    """(m, 3) points whose hull is the part of a hull above a plane.

    There are none if nothing is higher than `SLACK`.

    Args:
        points: (n, 3) points of the hull [m].
        heights: (n,) their heights above the plane [m].
    """
    above = heights > 0.0
    if not heights.max() > SLACK:
        return np.zeros((0, 3))
    high, low = np.flatnonzero(above), np.flatnonzero(~above)
    share = heights[high][:, None] / (heights[high][:, None] - heights[low])
    cut = points[high][:, None] + share[..., None] * (points[low] - points[high][:, None])
    return np.vstack([points[high], cut.reshape(-1, 3)])


def _folded_shape(name: str, joint: int, points: FloatArray, rounding: float) -> pin.GeometryObject:
    """Coal shape of the hull of some points, grown by a radius."""
    if len(points) == 2:
        start, end = (tuple(point) for point in points.tolist())
        solid = solid_shape(Capsule(name=name, start=start, end=end, radius=rounding))
        return pin.GeometryObject(name, joint, solid.placement, solid.geometry)
    geometry: coal.CollisionGeometry = convex_hull_shape(points)
    geometry.setSweptSphereRadius(rounding)
    return pin.GeometryObject(name, joint, pin.SE3.Identity(), geometry)


def _body(body: CollisionBody, points: FloatArray, rounding: float) -> CollisionBody:
    """Collision body of the hull of some points of another, grown by a radius."""
    if len(points) == 2:
        return CollisionBody(body.name, body.joint, frozen(points), rounding, "capsule", True, 0.0, ())
    hull = hull_of(points, most=MOST_BODY_POINTS)
    growth = hull.rounding
    return CollisionBody(body.name, body.joint, hull.core, rounding + growth, "part", growth == 0.0, growth, ())
