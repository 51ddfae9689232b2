r"""Motion-bound coefficients: configuration-independent bounds of each body's motion by each joint.

A point of the core of body :math:`b` at distance :math:`\rho` from the axis of joint :math:`j` moves with speed
:math:`\rho |\dot q_j|` if only that joint moves and is revolute, and with :math:`|\dot q_j|` if it is prismatic. Let
:math:`R_{bj}` be the maximum distance over all points of the core and all configurations (1 for a prismatic joint, 0
for a joint that does not carry the body). Then no point of the core travels farther than

.. math:: \sum_j R_{bj} \int |\dot q_j| \, dt.

The signed distance of two convex bodies is the maximum separation of their supporting planes, so it changes by no more
than the travel of both bodies. The signed distance of rounded bodies is the distance of their cores minus both radii.

**The maximum distance** is computed from the body inward. Rotated about the axis of the joint that carries the body,
its points sweep rings, given by the points' radii and heights; only the convex hull of these matters. Rotated about a
parallel axis, a ring sweeps a ring that is larger by the distance of the axes. Before the rotation about any other
axis, each ring is enclosed in its circumscribed polygon with `_CORNERS` corners, and those corners, in the frame of the
previous joint, are the points to rotate. Prismatic joints move the points to the ends of their range. The distance from
an axis is a convex function, so its maximum over a hull is attained at one of the points. The limits of revolute joints
are not used.

**A cylinder about the axis of its own joint** is the same at every value of that joint, like a ball or a capsule there:
the coefficient is the distance of its own axis from the joint's, at most `ON_AXIS`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, frozen, readonly
from hplan.collision.collision_bodies import CollisionBody, collision_bodies
from hplan.geometry.polygon import convex_hull
from hplan.robot.dynamics import joint_axis as model_joint_axis
from hplan.robot.model import Robot, made_once

#: Number of corners of the polygon around a ring.
_CORNERS: Final = 64

#: Two axes within this distance of each other, over the length of a body, are one [m].
ON_AXIS: Final = 1e-6

#: Maximum sine of the angle between parallel axes.
_PARALLEL: Final = 1e-12

#: Rounding errors of a radius, as a fraction of it.
_ROUND_OFF: Final = 1e-12


@made_once
def reach(robot: Robot, beyond: float = 0.0) -> FloatArray:
    """Motion-bound coefficients: maximum distance of each core from each joint axis.

    For a body that is larger than its URDF shape, the bound covers the core and the whole shape.

    Args:
        robot: The robot.
        beyond: Maximum excess of prismatic joints over their limits [m].

    Returns:
        (bodies, dof) bounds [m]; 0 if the joint does not move the body, 1 for a prismatic joint. Thus
        `reach @ abs(dq)` bounds the displacement of any point of each core. Bodies are in the order of
        `collision_bodies`.
    """
    return frozen(reach_of(robot, collision_bodies(robot), beyond))


def reach_of(robot: Robot, bodies: Sequence[CollisionBody], beyond: float = 0.0) -> FloatArray:
    """Motion-bound coefficients (see `reach`) of the given bodies, (bodies, dof)."""
    rows = np.array([points_reach(robot, body.core, body.joint, beyond) for body in bodies]).reshape(-1, robot.dof)
    # The URDF shape of a body that is not exact may have points beyond the core; they are within the rounding.
    beyond_core = np.array([0.0 if body.exact else body.rounding for body in bodies])[:, None]
    found: FloatArray = rows + np.where((rows > 0.0) & ~np.array(robot.slides), beyond_core, 0.0)
    for row, body in zip(found, bodies, strict=True):
        if body.kind == "cylinder" and body.joint >= 0:
            away = _from_axis(robot, body, body.joint)
            row[body.joint] = away if away <= ON_AXIS else row[body.joint]
    return found


def _from_axis(robot: Robot, body: CollisionBody, joint: int) -> float:
    """Distance of a round body's own axis from a joint's axis [m]; infinite for other bodies and for sliding joints.

    The joint is the body's own, or one that is attached to the same joint or to the ground as the body.
    """
    axis, slides = joint_axis(robot, joint)
    if slides or body.kind not in ("sphere", "capsule", "cylinder"):
        return math.inf
    ends = body.core.reshape(2, -1, 3).mean(axis=1) if body.kind == "cylinder" else body.core
    if body.joint != joint:
        place = robot.model.jointPlacements[joint + 1]
        ends = (ends - place.translation) @ place.rotation
    return float(np.linalg.norm(ends - (ends @ axis)[:, None] * axis, axis=1).max())


def joints_between(robot: Robot, one: CollisionBody, other: CollisionBody) -> tuple[int, ...]:
    """Joints that determine the distance of two bodies, from the outermost one inward.

    They are those that carry one of the two alone, without a joint about whose axis a body next to it is round.
    """
    a, b = carriers(robot, one.joint), carriers(robot, other.joint)
    found = [joint for joint in (*a, *b) if (joint in a) != (joint in b)]
    for body in (one, other):
        # The joints next to a body on the way to the other one.
        for joint in [joint for joint in found if body.joint in (joint, int(robot.model.parents[joint + 1]) - 1)]:
            if _from_axis(robot, body, joint) <= ON_AXIS:
                found.remove(joint)
    return tuple(found)


@made_once
def is_moved(robot: Robot) -> BoolArray:
    """(bodies,) True for the bodies that some joint moves.

    Bodies on the ground do not move, nor does a shape that is round about the axis of the only joint that carries it.
    """
    return readonly((reach(robot) > ON_AXIS).any(axis=1), np.bool_)


def points_reach(robot: Robot, points: FloatArray, joint: int, beyond: float = 0.0) -> FloatArray:
    """Motion-bound coefficients of points on a joint, (dof,); cached.

    Args:
        robot: The robot.
        points: (n, 3) points in the joint's frame [m].
        joint: The joint; -1 for the ground.
        beyond: Maximum excess of prismatic joints over their limits [m].
    """
    key = "reach", points.tobytes(), joint, beyond
    return robot.cache(key, lambda: frozen(_carry_points(robot, points, joint, beyond)[0]))


@made_once
def workspace_ball(robot: Robot) -> FloatArray:
    """(4,) centre in `base_link` and radius of a workspace ball [m].

    It contains all bodies at all configurations.
    """
    return _ball_about(robot, np.array(robot.model.jointPlacements[1].translation))


@made_once
def tight_reach_ball(robot: Robot) -> FloatArray:
    """(4,) the smaller of `workspace_ball` and a ball about the second joint's foot on the first axis [m]."""
    ball, first = workspace_ball(robot), robot.model.jointPlacements[1]
    axis, slides = joint_axis(robot, 0)
    if slides or robot.dof < 2 or robot.model.parents[2] != 1:
        return ball
    along = float(axis @ robot.model.jointPlacements[2].translation)
    raised = _ball_about(robot, first.translation + first.rotation @ (along * axis))
    return raised if raised[3] < ball[3] else ball


def _ball_about(robot: Robot, centre: FloatArray) -> FloatArray:
    """(4,) smallest ball about a (3,) point on the first joint's axis that contains all bodies at all configurations.

    Distances from the point do not change when the joint rotates.
    """
    bodies = collision_bodies(robot)
    held = [_carry_points(robot, body.core, body.joint, 0.0)[1] for body in bodies]
    far = [np.linalg.norm(points - centre, axis=1).max() for points in held]
    largest = max((float(away) + body.rounding for away, body in zip(far, bodies, strict=True)), default=0.0)
    return frozen(np.append(centre, largest * (1.0 + _ROUND_OFF)))


class _Rings(NamedTuple):
    """Rings around an axis.

    (3,) point and direction of the axis, (n,) radii and heights.
    """

    place: FloatArray
    axis: FloatArray
    radius: FloatArray
    height: FloatArray

    @classmethod
    def around_axis(cls, axis: FloatArray, radius: FloatArray, height: FloatArray) -> _Rings:
        """Rings on the convex hull of the given ones.

        Around an axis through the origin.
        """
        profile = np.column_stack([radius, height])
        profile = _hull_outline(np.vstack([profile, profile * [-1.0, 1.0]]))
        return cls(np.zeros(3), axis, *profile[profile[:, 0] >= 0.0].T)

    @property
    def corners(self) -> FloatArray:
        """(n, 3) points whose convex hull contains the rings."""
        across = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), self.axis).toRotationMatrix()
        angles = (np.arange(_CORNERS) + 0.5) * (2.0 * math.pi / _CORNERS)
        ring = self.radius / math.cos(math.pi / _CORNERS)
        rings = [np.outer(np.cos(angles), ring), np.outer(np.sin(angles), ring), np.tile(self.height, (_CORNERS, 1))]
        found: FloatArray = self.place + np.stack(rings, axis=-1).reshape(-1, 3) @ across.T
        return found


def _carry_points(robot: Robot, points: FloatArray, joint: int, beyond: float) -> tuple[FloatArray, FloatArray]:
    """Motion-bound coefficients of points, and a hull of their workspace.

    The hull is given by points in `base_link`; it contains the given points at all configurations.
    """
    found, rings = np.zeros(robot.dof), None
    for carrier in carriers(robot, joint):
        axis, slides = joint_axis(robot, carrier)
        if rings is not None and not slides and np.linalg.norm(np.cross(rings.axis, axis)) <= _PARALLEL:
            along = float(rings.place @ axis)
            away = float(np.linalg.norm(rings.place - along * axis))
            rings = _Rings.around_axis(axis, rings.radius + away, along + float(rings.axis @ axis) * rings.height)
        else:
            points = points if rings is None else rings.corners
            if slides:
                ends = np.array([robot.lower[carrier] - beyond, robot.upper[carrier] + beyond])
                points, rings = (points[:, None] + ends[:, None] * axis).reshape(-1, 3), None
            else:
                height = points @ axis
                rings = _Rings.around_axis(axis, np.linalg.norm(points - height[:, None] * axis, axis=1), height)
        found[carrier] = 1.0 if rings is None else float(rings.radius.max()) * (1.0 + _ROUND_OFF)
        placement = robot.model.jointPlacements[carrier + 1]
        if rings is None:
            points = points @ placement.rotation.T + placement.translation
        else:
            place = placement.rotation @ rings.place + placement.translation
            rings = rings._replace(place=place, axis=placement.rotation @ rings.axis)
    return found, points if rings is None else rings.corners


def largest_sway(robot: Robot, deviation: FloatArray) -> FloatArray:
    """Maximum tracking displacement bound of any part of a robot.

    Args:
        robot: The robot.
        deviation: (..., dof) maximum joint deviations [rad, m].

    Returns:
        (...) displacement bounds [m].
    """
    sways: FloatArray = (deviation @ reach(robot).T).max(axis=-1, initial=0.0)
    return sways


def joint_axis(robot: Robot, joint: int) -> tuple[FloatArray, bool]:
    """(3,) unit axis of a joint, and whether it is prismatic.

    In the joint's own frame.
    """
    return model_joint_axis(robot.model, joint + 1)


def carriers(robot: Robot, joint: int) -> tuple[int, ...]:
    """Joints from the given one, itself first, to the base.

    Empty for the ground.
    """
    found = []
    while joint >= 0:
        found.append(joint)
        joint = int(robot.model.parents[joint + 1]) - 1
    return tuple(found)


def _hull_outline(points: FloatArray) -> FloatArray:
    """Vertices of the convex hull of (n, 2) points.

    Up to rounding errors.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # the points are collinear
        return convex_hull(points)
