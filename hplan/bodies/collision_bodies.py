r"""The collision geometry of a robot as convex bodies: the hull of a few points, grown by a radius, on a joint each.

Every body holds the URDF's shape that it stands for. Spheres, capsules and boxes are what they are. A cylinder is the
prism of `_SIDES` sides about it. Of a mesh it is the convex hull, which of a mesh that is not convex is larger than it;
a hull of more than `MOST_POINTS` vertices keeps some of them, and grows by the distance of the farthest of the others.

Where such a body is larger than the shape that coal judges by (`body_shapes`: the true cylinder, the hull with all of
its vertices), `CollisionBody.growth` says by how much at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, Record, readonly
from hplan.errors import RobotFileError
from hplan.robot.model import Robot
from hplan.scene.convex_shape import convex_hull_shape
from hplan.scene.solids import CUBE_CORNERS, hull_of, thickening

#: Joint of a body that no joint moves.
GROUND: Final = -1

#: Most points of a body.
MOST_POINTS: Final = 64

#: Sides of the prism about a cylinder.
_SIDES: Final = 24

#: A mesh whose hull has this much more volume is not convex.
_CONVEX: Final = 1e-3


@dataclass(frozen=True, eq=False)
class CollisionBody(Record):
    """A convex body that a joint carries: the hull of its core, grown by its rounding.

    Attributes:
        name: Name of its link in the URDF; several bodies may have one.
        joint: Place in `Robot.joint_names` of the joint that carries it; `GROUND` (-1) where none does.
        core: (n, 3) points in that joint's frame (Pinocchio's; of the ground, in `base_link`), at most `MOST_POINTS`:
            one of a sphere, two of a capsule, eight of a box, with which (-1, -1, -1) ... (1, 1, 1) are meant in the
            order of `hplan.scene.solids.CUBE_CORNERS`; vertices of the hull of all others [m].
        rounding: Radius about the core [m].
        kind: `sphere`, `capsule`, `box`, `cylinder`, `mesh` (one that is convex) or `mesh hull`.
        exact: True where it is the URDF's shape itself, up to rounding errors.
        growth: By how much it may stand out beyond the shape that coal judges by [m]; see `body_shapes`.
        shape: Place of the URDF's shape among the geometry objects of `Robot.collision_model`.
    """

    name: str
    joint: int
    core: FloatArray
    rounding: float
    kind: str
    exact: bool
    growth: float
    shape: int

    @property
    def is_point_set(self) -> bool:
        """False: it is the hull of its core grown by its rounding."""
        return False


def collision_bodies(robot: Robot) -> tuple[CollisionBody, ...]:
    """The bodies of a robot, those of the ground too, in the order of its geometry objects; made once.

    Raises:
        RobotFileError: A shape that is none of a URDF's kinds, or a mesh without a volume that cannot be thickened.
    """
    return tuple(body for body, _ in _made(robot))


def body_shapes(robot: Robot) -> tuple[pin.GeometryObject, ...]:
    """What coal is to judge by in place of each of the `collision_bodies`, in the same order; made once.

    The URDF's shape itself, of a mesh its convex hull with all vertices. Names are those of the bodies, with a number.
    """
    return tuple(shape for _, shape in _made(robot))


def _made(robot: Robot) -> list[tuple[CollisionBody, pin.GeometryObject]]:
    def make() -> list[tuple[CollisionBody, pin.GeometryObject]]:
        objects = robot.collision_model.geometryObjects
        return [_body(robot, number, shape) for number, shape in enumerate(objects)]

    return robot.once("collision_bodies", make)


def _body(robot: Robot, number: int, shape: pin.GeometryObject) -> tuple[CollisionBody, pin.GeometryObject]:
    """A body, and its shape for coal."""
    geometry, name = shape.geometry, str(robot.model.frames[shape.parentFrame].name)
    rounding = growth = 0.0
    exact, judged = True, geometry
    if isinstance(geometry, coal.Sphere):
        kind, core, rounding = "sphere", np.zeros((1, 3)), float(geometry.radius)
    elif isinstance(geometry, coal.Capsule):
        kind, core, rounding = "capsule", np.array([[0, 0, -1.0], [0, 0, 1.0]]), float(geometry.radius)
        core = core * float(geometry.halfLength)
    elif isinstance(geometry, coal.Box):
        kind, core = "box", CUBE_CORNERS * np.asarray(geometry.halfSide)
    elif isinstance(geometry, coal.Cylinder):
        kind, core, exact = "cylinder", _prism(float(geometry.radius), float(geometry.halfLength)), False
        growth = float(geometry.radius) * (1.0 / math.cos(math.pi / _SIDES) - 1.0)
    elif isinstance(geometry, coal.BVHModelBase):
        vertices = np.asarray(geometry.vertices(), dtype=np.float64)
        judged = convex_hull_shape(vertices)
        hull = hull_of((vertices[:, None] + thickening(vertices)).reshape(-1, 3), most=MOST_POINTS)
        core, rounding = hull.core, hull.rounding
        convex = _is_convex(geometry, judged)
        kind, exact, growth = "mesh" if convex else "mesh hull", convex and rounding == 0.0, rounding
    else:
        raise RobotFileError(robot.urdf_path, f"link {name!r}: shape {type(geometry).__name__} is not supported")
    placed = readonly(core @ shape.placement.rotation.T + shape.placement.translation)
    body = CollisionBody(name, int(shape.parentJoint) - 1, placed, rounding, kind, exact, growth, number)
    return body, pin.GeometryObject(f"{name}:{number}", shape.parentJoint, shape.placement, judged)


def _prism(radius: float, half_length: float) -> FloatArray:
    """(2 `_SIDES`, 3) corners of the prism about a cylinder along z."""
    angles = np.arange(_SIDES) * (2.0 * math.pi / _SIDES)
    rim = radius / math.cos(math.pi / _SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners: FloatArray = np.vstack([np.c_[rim, np.full(_SIDES, end)] for end in (-half_length, half_length)])
    return corners


def _is_convex(mesh: coal.BVHModelBase, hull: coal.Convex) -> bool:
    """True if a mesh is as large as its hull."""
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    corners = (mesh.tri_indices(number) for number in range(mesh.num_tris))
    faces = np.array([[three[0], three[1], three[2]] for three in corners])
    a, b, c = (vertices[faces[:, corner]] - vertices[0] for corner in range(3))
    volume = float((a * np.cross(b, c)).sum()) / 6.0
    return bool(volume >= (1.0 - _CONVEX) * float(hull.computeVolume()))
