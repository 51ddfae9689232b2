r"""Convex shapes of the arm's base: pedestal and turret.

The pedestal is fixed; the turret turns with the yaw.

Both include the fixed links attached to them: a cabinet, a counterweight, a camera mast. A shape that is round about
the yaw axis is the same at every yaw. A turn by :math:`\Delta\psi` moves any point of another shape by at most
:math:`|\Delta\psi| \, r`, with :math:`r` the shape's largest distance from the axis. The signed distance of two convex
bodies is the maximum separation of their supporting planes over all directions, so it changes by no more than that,
also in contact. `hplan.geometry.lipschitz` decides with this bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.geometry.shape_outline import coal_distance, outline, solid_geometry
from hplan.planar.family_reader import family_of
from hplan.robot.model import Robot, made_once

#: Carriers of base shapes that a link can touch: bodies that turn with the arm plane, and fixed bodies.
TURRET: Final = -1
GROUND_CARRIER: Final = -2


@dataclass(frozen=True, eq=False)
class BaseShape:
    """A convex shape of the base; a mesh's convex hull.

    Attributes:
        number: Index among the geometry objects of `Robot.collision_model`.
        carrier: `TURRET` or `GROUND`.
        placed: Geometry object of the filled shape, attached to its joint.
        placement: Pose in `base_link` at yaw 0.
        core: (k, 3) points in `base_link` at yaw 0 whose hull, grown by `rounding`, contains the shape [m]; for a round
            shape, the hull of the points' sweep about the yaw axis contains it.
        rounding: Radius about the core [m].
        is_round: True if the shape is invariant under turns about the yaw axis.
        axis: (3,) foot of the yaw axis in `base_link` [m].
        links: Links that can touch the shape, set by `hplan.planar.self_contact`.
    """

    number: int
    name: str
    carrier: int
    placed: pin.GeometryObject
    placement: pin.SE3
    core: FloatArray
    rounding: float
    is_round: bool
    axis: FloatArray
    links: tuple[int, ...] = ()

    #: The shape is the hull of its core grown by its rounding.
    is_point_set: ClassVar[Literal[False]] = False

    @property
    def follows_arm_plane(self) -> bool:
        """True if its section is the same at every yaw.

        This holds for round shapes and for shapes that turn with the plane.
        """
        return self.is_round or self.carrier == TURRET

    def distance_from(self, point: FloatArray) -> float:
        """Distance from a (3,) point [m]; at most 0 inside.

        Both are at yaw 0.
        """
        ball, at = coal.Sphere(_SPECK_RADIUS), pin.SE3(np.eye(3), point)
        return coal_distance(self.placed.geometry, self.placement, ball, at) + _SPECK_RADIUS


#: Radius of the ball that represents a point [m].
_SPECK_RADIUS = 1e-3


@made_once
def base_shapes(robot: Robot) -> tuple[BaseShape, ...]:
    """Shapes of pedestal and turret in URDF order.

    Without a yaw the turret is fixed.
    """
    objects = enumerate(robot.collision_model.geometryObjects)
    return tuple(
        _base_shape(robot, number) for number, shape in objects if shape.parentJoint <= family_of(robot).yaw_joints
    )


def _base_shape(robot: Robot, number: int) -> BaseShape:
    family = family_of(robot)
    shape = robot.collision_model.geometryObjects[number]
    placement = robot.model.jointPlacements[shape.parentJoint] * shape.placement
    axis = np.append(family.yaw_axis, 0.0)
    is_round = family.has_yaw and _is_round(shape.geometry, pin.SE3(placement.rotation, placement.translation - axis))
    points, rounding = outline(shape, rim_from_outside=not is_round)
    return BaseShape(
        number=number,
        name=str(robot.model.frames[shape.parentFrame].name),
        carrier=GROUND_CARRIER if shape.parentJoint == 0 else TURRET,
        placed=pin.GeometryObject(f"body:{number}", shape.parentJoint, shape.placement, solid_geometry(shape)),
        placement=placement,
        core=frozen(points @ placement.rotation.T + placement.translation),
        rounding=float(rounding),
        is_round=is_round,
        axis=frozen(axis),
    )


def _is_round(geometry: coal.CollisionGeometry, placement: pin.SE3) -> bool:
    """True if a shape is round about the vertical through the origin.

    The vertical then contains the centre of a sphere, or the axis of a cylinder or capsule.
    """
    if isinstance(geometry, coal.Sphere):
        half_length = 0.0
    elif isinstance(geometry, coal.Capsule | coal.Cylinder):
        half_length = max(float(geometry.halfLength), float(geometry.radius))
    else:
        return False
    tilt = float(np.hypot(*placement.rotation[:2, 2]))
    # A shape is round about the yaw axis if its own axis is everywhere within this distance of it [m].
    return float(np.hypot(*placement.translation[:2])) + tilt * half_length <= 1e-6
