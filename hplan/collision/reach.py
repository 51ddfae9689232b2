r"""Motion-bound coefficients: how far each joint can move each body, whatever the configuration.

A point of the core of body :math:`b` that lies at distance :math:`\rho` from the axis of joint :math:`j` moves with
speed :math:`\rho |\dot q_j|` when that joint alone turns, and with :math:`|\dot q_j|` when it slides. With
:math:`R_{bj}` the largest such distance over all points of the core and all configurations (1 of a joint that slides, 0
of one that does not carry the body), no point of the core travels farther than

.. math:: \sum_j R_{bj} \int |\dot q_j| \, dt.

Since the signed distance of two convex bodies is the largest separation of their supporting planes, it changes by no
more than both bodies travel; and that of bodies with roundings is that of their cores, less both.

**The distance** is found from the body inward. Its points, turned about the axis of the joint that carries it, sweep
rings; those are the rings of the points' radii and heights, of which the convex hull counts alone. Turned about a
parallel axis, a ring sweeps one that is larger by the distance of the axes. Before it is turned about another one, each
ring is put in the polygon of `_CORNERS` corners about it; those corners, seen from the joint before, are the points
that are turned. Joints that slide move the points to the ends of their range. A distance from an axis is a convex
function, so its largest value over a hull is that at one of the points. Joint limits of joints that turn are not made
use of.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.base.planar_geometry import convex_hull
from hplan.collision.collision_bodies import CollisionBody, collision_bodies
from hplan.robot.model import Robot, made_once

#: Corners of the polygon about a ring.
_CORNERS: Final = 64

#: Axes are parallel that differ in direction by no more than this.
_PARALLEL: Final = 1e-12

#: Rounding errors of a radius, as a fraction of it.
_ROUND_OFF: Final = 1e-12


@made_once
def reach(robot: Robot, beyond: float = 0.0) -> FloatArray:
    """Motion-bound coefficients: upper bounds of the distance of any point of each core from each joint's axis.

    Of a body that is larger than the shape that it stands for, the core and all of the shape are meant.

    Args:
        beyond: How far joints that slide may be beyond their limits [m].

    Returns:
        (bodies, dof) bounds [m]; 0 where the joint does not move the body, 1 for a joint that slides, so that
        `reach @ abs(dq)` bounds how far any point of each core moves. Bodies are in the order of `collision_bodies`.
    """
    return frozen(reach_of(robot, collision_bodies(robot), beyond))


def reach_of(robot: Robot, bodies: Sequence[CollisionBody], beyond: float = 0.0) -> FloatArray:
    """As `reach`, of some bodies."""
    rows = np.array([points_reach(robot, body.core, body.joint, beyond) for body in bodies]).reshape(-1, robot.dof)
    # The shape that a body stands for has points of its own beyond the core, but where it is the core and a ball.
    beyond_core = np.array([0.0 if body.exact else body.rounding for body in bodies])[:, None]
    found: FloatArray = rows + np.where((rows > 0.0) & ~np.array(robot.slides), beyond_core, 0.0)
    return found


def points_reach(robot: Robot, points: FloatArray, joint: int, beyond: float = 0.0) -> FloatArray:
    """A row of `reach`, of points that a joint carries; found once for the same ones.

    Args:
        points: (n, 3) points in the joint's frame [m].
        joint: The joint; -1 for the ground.
        beyond: How far joints that slide may be beyond their limits [m].
    """
    key = "reach", points.tobytes(), joint, beyond
    return robot.cached(key, lambda: frozen(_carried(robot, points, joint, beyond)[0]))


@made_once
def reach_ball(robot: Robot) -> FloatArray:
    """(4,) centre, in `base_link`, and radius of a ball that holds all bodies at all configurations [m]."""
    bodies = collision_bodies(robot)
    held = [_carried(robot, body.core, body.joint, 0.0)[1] for body in bodies]
    # Distances from where the first joint is are kept as it turns.
    centre = np.array(robot.model.jointPlacements[1].translation)
    far = [np.linalg.norm(points - centre, axis=1).max() for points in held]
    largest = max((float(away) + body.rounding for away, body in zip(far, bodies, strict=True)), default=0.0)
    return frozen(np.append(centre, largest * (1.0 + _ROUND_OFF)))


class _Rings(NamedTuple):
    """Rings about an axis: a place on it and its direction, both (3,), and (n,) radii and heights."""

    place: FloatArray
    axis: FloatArray
    radius: FloatArray
    height: FloatArray

    @classmethod
    def about(cls, axis: FloatArray, radius: FloatArray, height: FloatArray) -> _Rings:
        """Those of given ones that hold them all, about an axis through the origin."""
        profile = np.column_stack([radius, height])
        profile = _outline(np.vstack([profile, profile * [-1.0, 1.0]]))
        return cls(np.zeros(3), axis, *profile[profile[:, 0] >= 0.0].T)

    @property
    def corners(self) -> FloatArray:
        """Points whose hull holds them."""
        across = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), self.axis).toRotationMatrix()
        angles = (np.arange(_CORNERS) + 0.5) * (2.0 * math.pi / _CORNERS)
        ring = self.radius / math.cos(math.pi / _CORNERS)
        rings = [np.outer(np.cos(angles), ring), np.outer(np.sin(angles), ring), np.tile(self.height, (_CORNERS, 1))]
        found: FloatArray = self.place + np.stack(rings, axis=-1).reshape(-1, 3) @ across.T
        return found


def _carried(robot: Robot, points: FloatArray, joint: int, beyond: float) -> tuple[FloatArray, FloatArray]:
    """A row of `reach`, and points in `base_link` whose hull holds the given ones at all configurations."""
    found, rings = np.zeros(robot.dof), None
    for carrier in carriers(robot, joint):
        axis, slides = joint_axis(robot, carrier)
        if rings is not None and not slides and np.linalg.norm(np.cross(rings.axis, axis)) <= _PARALLEL:
            along = float(rings.place @ axis)
            away = float(np.linalg.norm(rings.place - along * axis))
            rings = _Rings.about(axis, rings.radius + away, along + float(rings.axis @ axis) * rings.height)
        else:
            points = points if rings is None else rings.corners
            if slides:
                ends = np.array([robot.lower[carrier] - beyond, robot.upper[carrier] + beyond])
                points, rings = (points[:, None] + ends[:, None] * axis).reshape(-1, 3), None
            else:
                height = points @ axis
                rings = _Rings.about(axis, np.linalg.norm(points - height[:, None] * axis, axis=1), height)
        found[carrier] = 1.0 if rings is None else float(rings.radius.max()) * (1.0 + _ROUND_OFF)
        placement = robot.model.jointPlacements[carrier + 1]
        if rings is None:
            points = points @ placement.rotation.T + placement.translation
        else:
            place = placement.rotation @ rings.place + placement.translation
            rings = rings._replace(place=place, axis=placement.rotation @ rings.axis)
    return found, points if rings is None else rings.corners


def largest_sway(robot: Robot, deviation: FloatArray) -> FloatArray:
    """Tracking-error displacement bound: of any part of a robot from its place, with joints off by `deviation` at most.

    Of an arm of the planar family that of its links' axes (`PlanarFamily.sway`), of any other that of its bodies.

    Args:
        deviation: (..., dof) deviations [rad, m].

    Returns:
        (...) distances [m].
    """
    if robot.planar is not None:
        found: FloatArray = robot.planar.sway(deviation).max(axis=-1)
        return found
    sways: FloatArray = (deviation @ reach(robot).T).max(axis=-1, initial=0.0)
    return sways


def joint_axis(robot: Robot, joint: int) -> tuple[FloatArray, bool]:
    """The (3,) unit axis of a joint in its own frame, and whether it slides along it; else it turns about it."""
    moved = robot.model.joints[joint + 1]
    data = moved.createData()
    moved.calc(data, np.zeros(1))
    slide, turn = np.array(data.S, dtype=np.float64).reshape(2, 3)
    return (slide, True) if slide.any() else (turn, False)


def carriers(robot: Robot, joint: int) -> tuple[int, ...]:
    """The joints that move what a joint carries: itself first, then those below it to the base; none of the ground."""
    found = []
    while joint >= 0:
        found.append(joint)
        joint = int(robot.model.parents[joint + 1]) - 1
    return tuple(found)


def _outline(points: FloatArray) -> FloatArray:
    """The vertices of the convex hull of (n, 2) points, up to rounding errors."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # they are in line
        return convex_hull(points)
