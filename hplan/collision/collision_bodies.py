r"""The collision geometry of a robot as convex bodies: the hull of a few points, grown by a radius, on a joint each.

Every body holds the URDF's shape that it stands for. Spheres, capsules and boxes are what they are. A cylinder is the
prism of `_SIDES` sides about it. Of a mesh it is the convex hull; a closed mesh that fills less than `_FILLED` of its
hull is cut into `_PIECES` convex pieces, whose union holds it (`hplan.scene.convex_decomposition`). A hull of more than
`MOST_POINTS` vertices keeps some of them, and grows by the distance of the farthest of the others.

Where a body is larger than the shape that coal judges by (`body_shapes`: the true cylinder, the hull with all of its
vertices), `CollisionBody.growth` says by how much at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray, Record, readonly
from hplan.errors import RobotFileError
from hplan.robot.model import Robot
from hplan.scene.convex_decomposition import convex_pieces
from hplan.scene.convex_shape import convex_hull_shape, convex_shape
from hplan.scene.solids import CUBE_CORNERS, hull_of, thickening

#: Joint of a body that no joint moves.
GROUND: Final = -1

#: Most points of a body.
MOST_POINTS: Final = 256

#: Sides of the prism about a cylinder.
_SIDES: Final = 24

#: A mesh whose hull has this much more volume is not convex.
_CONVEX: Final = 1e-3

#: A mesh that fills less of its hull is cut, into so many pieces at most.
_FILLED: Final = 0.8
_PIECES: Final = 4


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
        kind: `sphere`, `capsule`, `box`, `cylinder`, `mesh` (one that is convex), `mesh hull` or `mesh piece`.
        exact: True where it is the URDF's shape itself, up to rounding errors.
        growth: By how much it may stand out beyond the shape that coal judges by [m]; see `body_shapes`.
        shape: Place of the URDF's shape among the geometry objects of `Robot.collision_model`, -1 for another shape;
            pieces share one.
    """

    name: str
    joint: int
    core: FloatArray
    rounding: float
    kind: str
    exact: bool
    growth: float
    shape: int


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


def reuse_bodies(robot: Robot, before: Robot) -> None:
    """Take the bodies of a robot's first shapes from another one that has the same, as meshes take long to be cut.

    Args:
        robot: The robot, of which no bodies were made yet.
        before: One with the same links and joints, and with the first of its shapes.
    """
    first = len(before.collision_model.geometryObjects)
    robot.cached("collision_bodies", lambda: [*_made(before), *_bodies_from(robot, first)])


def _made(robot: Robot) -> list[tuple[CollisionBody, pin.GeometryObject]]:
    return robot.cached("collision_bodies", lambda: list(_bodies_from(robot, 0)))


def _bodies_from(robot: Robot, first: int) -> Iterator[tuple[CollisionBody, pin.GeometryObject]]:
    """The bodies of a robot's shapes from a number on."""
    for number, shape in list(enumerate(robot.collision_model.geometryObjects))[first:]:
        yield from bodies_of(robot, str(robot.model.frames[shape.parentFrame].name), shape, number)


class _Solid(NamedTuple):
    """A convex solid: kind, core, rounding, exactness and growth of a body, and the shape for coal."""

    kind: str
    core: FloatArray
    rounding: float
    exact: bool
    growth: float
    judged: coal.CollisionGeometry


def bodies_of(
    robot: Robot, name: str, shape: pin.GeometryObject, number: int = -1
) -> Iterator[tuple[CollisionBody, pin.GeometryObject]]:
    """The bodies of a shape that a robot's link has, each with its shape for coal.

    Raises:
        RobotFileError: As `collision_bodies`.
    """
    joint, place = int(shape.parentJoint), shape.placement
    solids = _mesh(shape.geometry) if isinstance(shape.geometry, coal.BVHModelBase) else (_primitive(shape.geometry),)
    for piece, solid in enumerate(solids):
        if solid is None:
            kind = type(shape.geometry).__name__
            raise RobotFileError(robot.urdf_path, f"link {name!r}: shape {kind} is not supported")
        core = readonly(solid.core @ place.rotation.T + place.translation)
        body = CollisionBody(name, joint - 1, core, solid.rounding, solid.kind, solid.exact, solid.growth, number)
        yield body, pin.GeometryObject(f"{name}:{number}:{piece}", joint, place, solid.judged)


def _primitive(geometry: coal.CollisionGeometry) -> _Solid | None:
    """A shape that is no mesh; None for one that URDF does not know."""
    if isinstance(geometry, coal.Sphere):
        return _Solid("sphere", np.zeros((1, 3)), float(geometry.radius), True, 0.0, geometry)
    if isinstance(geometry, coal.Capsule):
        core = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]) * float(geometry.halfLength)
        return _Solid("capsule", core, float(geometry.radius), True, 0.0, geometry)
    if isinstance(geometry, coal.Box):
        return _Solid("box", CUBE_CORNERS * np.asarray(geometry.halfSide), 0.0, True, 0.0, geometry)
    if isinstance(geometry, coal.Cylinder):
        radius = float(geometry.radius)
        growth = radius * (1.0 / math.cos(math.pi / _SIDES) - 1.0)
        return _Solid("cylinder", _prism(radius, float(geometry.halfLength)), 0.0, False, growth, geometry)
    return None


def _mesh(mesh: coal.BVHModelBase) -> tuple[_Solid, ...]:
    """The hull of a mesh, or of its pieces."""
    corners = (mesh.tri_indices(number) for number in range(mesh.num_tris))
    faces = np.array([[three[0], three[1], three[2]] for three in corners], dtype=np.int64)
    return _of_mesh(np.asarray(mesh.vertices(), dtype=np.float64).tobytes(), faces.tobytes(), MOST_POINTS)


# Meshes whose bodies are kept: arms beside each other, and all of them as one robot, have the same.
@lru_cache(maxsize=64)
def _of_mesh(points: bytes, triangles: bytes, most: int) -> tuple[_Solid, ...]:
    """The hull of a mesh, or of its pieces, of so many points at most: of its vertices and its triangles."""
    vertices = np.frombuffer(points, dtype=np.float64).reshape(-1, 3)
    faces = np.frombuffer(triangles, dtype=np.int64).reshape(-1, 3)
    thicker = (vertices[:, None] + thickening(vertices)).reshape(-1, 3)
    judged, is_closed = convex_hull_shape(vertices), _is_closed(faces)
    if is_closed:
        faces = _outward(vertices, faces)
    filled = float(_volumes(vertices, faces).sum()) / float(judged.computeVolume())
    if filled < _FILLED and is_closed:
        pieces = convex_pieces(vertices, faces, most=_PIECES).hulls
        return tuple(_hull("mesh piece", piece.core, piece.rounding, convex_shape(piece), most) for piece in pieces)
    convex = filled >= 1.0 - _CONVEX
    hull = _hull("mesh" if convex else "mesh hull", thicker, 0.0, judged, most)
    return (hull._replace(exact=convex and hull.growth == 0.0),)


def _hull(kind: str, points: FloatArray, rounding: float, judged: coal.CollisionGeometry, most: int) -> _Solid:
    """The hull of (n, 3) points, grown by a radius, of so many points at most."""
    hull = hull_of(points, most=most)
    return _Solid(kind, hull.core, hull.rounding + rounding, False, hull.rounding, judged)


def _is_closed(faces: IntArray) -> bool:
    """True if each edge of a surface is one of two triangles, which go along it in opposite senses."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = ({tuple(edge) for edge in directed.tolist()} for directed in (edges, edges[:, ::-1]))
    return len(there) == len(edges) and there == back


def _volumes(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(m,) volumes of the pyramids over the triangles of a surface; their sum is what it encloses, as seen outwards."""
    a, b, c = (vertices[faces[:, corner]] - vertices[0] for corner in range(3))
    volumes: FloatArray = (a * np.cross(b, c)).sum(axis=1) / 6.0
    return volumes


def _outward(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles of a closed surface, those of parts that are inside out turned: mirrored by a scale, or hollows.

    Hollows count as solid.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    linked = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(vertices), len(vertices)))
    part = connected_components(linked, directed=False)[1][faces[:, 0]]
    inside_out = np.bincount(part, weights=_volumes(vertices, faces)) < 0.0
    return np.where(inside_out[part][:, None], faces[:, ::-1], faces)


def _prism(radius: float, half_length: float) -> FloatArray:
    """(2 `_SIDES`, 3) corners of the prism about a cylinder along z."""
    angles = np.arange(_SIDES) * (2.0 * math.pi / _SIDES)
    rim = radius / math.cos(math.pi / _SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners: FloatArray = np.vstack([np.c_[rim, np.full(_SIDES, end)] for end in (-half_length, half_length)])
    return corners


def ball_about(core: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of a ball that holds some points, not much larger than the smallest."""
    centre = core.mean(axis=0)
    if len(core) <= 2:
        return centre, float(np.linalg.norm(core - centre, axis=1).max())
    centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
    for step in range(1, 200):
        # Towards the farthest point, by ever less (Badoiu and Clarkson 2003).
        away = core - centre
        centre = centre + away[(away**2).sum(axis=1).argmax()] / (step + 1.0)
    boxed = 0.5 * (core.min(axis=0) + core.max(axis=0))
    radii = [float(np.linalg.norm(core - middle, axis=1).max()) for middle in (centre, boxed)]
    return (centre, radii[0]) if radii[0] < radii[1] else (boxed, radii[1])
