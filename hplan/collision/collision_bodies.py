r"""Collision geometry of a robot as convex hulls with a radius.

Each body is carried by one joint and contains its URDF shape. Spheres, capsules and boxes are exact. URDF has no
capsules: a cylinder with a ball of its radius at either end, on the same link, is one. Any other cylinder becomes its
circumscribed prism with `_SIDES` sides, and a mesh its convex hull. A closed mesh that fills less than `_FILLED` of
its hull is decomposed into at most `_PIECES` convex pieces, whose union contains it
(`hplan.geometry.convex_decomposition`). A hull with more than `MOST_BODY_POINTS` vertices is reduced to some of them,
and grown by the maximum distance of the others.

A body may be larger than its shape in coal (`body_shapes`: the true cylinder, the hull with all vertices);
`CollisionBody.growth` is an upper bound of the difference.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray, Record, readonly
from hplan.collision.coal_meshes import ClosedMesh
from hplan.errors import RobotFileError
from hplan.geometry.coal_hull import convex_hull_shape, convex_shape
from hplan.geometry.convex_decomposition import convex_pieces
from hplan.geometry.hull import CUBE_CORNERS, hull_of, thickening_shifts
from hplan.robot.model import Robot, made_once

#: Joint index of bodies that no joint moves.
GROUND: Final = -1

#: Maximum number of points of a body.
MOST_BODY_POINTS: Final = 256

#: Tolerance of centre and radius of a ball at the end of a cylinder [m].
_SAME: Final = 1e-9

#: Number of sides of the prism around a cylinder.
_SIDES: Final = 24

#: Minimum volume fraction of the hull outside a mesh for the mesh to count as not convex.
_CONVEX: Final = 1e-3

#: A mesh that fills less than this fraction of its hull is decomposed; maximum number of pieces.
_FILLED: Final = 0.8
_PIECES: Final = 4


@dataclass(frozen=True, eq=False)
class CollisionBody(Record):
    """A convex body on a joint.

    The hull of its core points, grown by its rounding.

    Attributes:
        name: Name of its link in the URDF; several bodies may have the same name.
        joint: Index in `Robot.joint_names` of the joint that carries it; `GROUND` (-1) if no joint moves it.
        core: (n, 3) points in that joint's frame (Pinocchio's; for the ground, `base_link`) [m], at most
            `MOST_BODY_POINTS`: one for a sphere, two for a capsule, eight for a box in the order of
            `hplan.geometry.hull.CUBE_CORNERS`, and the vertices of the hull for all others.
        rounding: Radius around the core [m].
        kind: `sphere`, `capsule`, `box`, `cylinder`, `mesh` (a convex one), `mesh hull` or `mesh piece`.
        exact: True if it equals the URDF's shape, up to rounding errors.
        growth: Upper bound of its excess over its shape in coal [m]; see `body_shapes`.
        shapes: Indices of the URDF's shapes that it contains, or contains a piece of, in the geometry objects of
            `Robot.collision_model`: one, three for a capsule, none for another shape.
    """

    name: str
    joint: int
    core: FloatArray
    rounding: float
    kind: str
    exact: bool
    growth: float
    shapes: tuple[int, ...]


def collision_bodies(robot: Robot) -> tuple[CollisionBody, ...]:
    """Bodies of a robot, including the ground's, in geometry-object order; cached.

    A capsule is at the place of its cylinder.

    Raises:
        RobotFileError: A shape has a kind that URDF does not define, or a mesh has no volume and cannot be thickened.
    """
    return tuple(body for body, _ in _build_bodies(robot))


def body_shapes(robot: Robot) -> tuple[pin.GeometryObject, ...]:
    """Coal shape of each of the `collision_bodies`, in the same order; cached.

    It is the URDF's shape itself, the capsule of a cylinder and two balls, or the convex hull of a mesh (or of its
    piece) with all vertices. Names are the bodies' names with a number.
    """
    return tuple(shape for _, shape in _build_bodies(robot))


@made_once
def closed_meshes(robot: Robot) -> dict[int, ClosedMesh]:
    """Meshes of the bodies that contain more than the URDF's closed mesh, by identity of their `body_shapes`."""
    loaded = robot.loaded
    shapes, found = list(loaded.collision_model.geometryObjects), dict[int, ClosedMesh]()
    by_shape = dict[int, ClosedMesh | None]()
    for body, shape in _build_bodies(loaded):
        if body.kind in ("mesh hull", "mesh piece") and body.shapes:
            number = body.shapes[0]
            if number not in by_shape:
                by_shape[number] = _closed_mesh(shapes[number].geometry)
            mesh = by_shape[number]
            if mesh is not None:
                found[id(shape)] = mesh
    return found


def _closed_mesh(mesh: coal.CollisionGeometry) -> ClosedMesh | None:
    """The closed surface of a mesh; None if it is open, or no mesh."""
    if not isinstance(mesh, coal.BVHModelBase):
        return None
    vertices, faces = np.asarray(mesh.vertices(), dtype=np.float64), _faces_of(mesh)
    if not _is_closed(faces):
        return None
    return ClosedMesh(vertices, _orient_triangles(vertices, faces), _connected_parts(len(vertices), faces))


def reuse_bodies(robot: Robot, before: Robot) -> None:
    """Reuse the bodies of another robot for a robot's first shapes.

    This saves the decomposition of the meshes, which is slow.

    Args:
        robot: The robot; its bodies must not have been computed yet.
        before: A robot with the same links and joints, whose shapes are the first shapes of `robot`.
    """
    first = len(before.collision_model.geometryObjects)
    robot.cache("collision_bodies", lambda: [*_build_bodies(before), *_bodies_from(robot, first)])


def _build_bodies(robot: Robot) -> list[tuple[CollisionBody, pin.GeometryObject]]:
    loaded = robot.loaded
    return loaded.cache("collision_bodies", lambda: list(_bodies_from(loaded, 0)))


def _bodies_from(robot: Robot, first: int) -> Iterator[tuple[CollisionBody, pin.GeometryObject]]:
    """Bodies of a robot's shapes from index `first` on."""
    shapes = list(robot.collision_model.geometryObjects)
    capsules = dict[int, tuple[int, ...]]()
    for number in range(first, len(shapes)):
        balls = _balls_at_ends(shapes, number, first)
        if balls and not set(balls) & set(itertools.chain(*capsules.values())):
            capsules[number] = (number, *balls)
    within = set(itertools.chain(*capsules.values()))
    for number in range(first, len(shapes)):
        shape, parts = shapes[number], capsules.get(number, (number,))
        if number in within and number not in capsules:
            continue
        if number in capsules:
            tube = shape.geometry
            capsule = coal.Capsule(float(tube.radius), 2.0 * float(tube.halfLength))
            shape = pin.GeometryObject(shape.name, shape.parentJoint, shape.parentFrame, shape.placement, capsule)
        yield from bodies_of(robot, str(robot.model.frames[shape.parentFrame].name), shape, parts)


def _balls_at_ends(shapes: Sequence[pin.GeometryObject], number: int, first: int) -> tuple[int, ...]:
    """Indices of the two balls that make a cylinder a capsule; empty without them.

    The balls have the cylinder's radius and are at its ends, up to `_SAME`, on the same link.

    Args:
        shapes: The shapes of a robot.
        number: Index of the shape in question.
        first: Index of the first shape that may be a ball.
    """
    tube = shapes[number]
    if not isinstance(tube.geometry, coal.Cylinder):
        return ()
    found = list[int]()
    for side in (-1.0, 1.0):
        end = tube.placement.act(np.array([0.0, 0.0, side * float(tube.geometry.halfLength)]))
        for other in range(first, len(shapes)):
            ball = shapes[other]
            if not isinstance(ball.geometry, coal.Sphere) or ball.parentFrame != tube.parentFrame:
                continue
            off = float(np.linalg.norm(ball.placement.translation - end))
            if other not in found and off + abs(float(ball.geometry.radius) - float(tube.geometry.radius)) <= _SAME:
                found.append(other)
                break
    return tuple(found) if len(found) == 2 else ()


class _Solid(NamedTuple):
    """A convex solid: attributes of a `CollisionBody`, and its shape in coal."""

    kind: str
    core: FloatArray
    rounding: float
    exact: bool
    growth: float
    judged: coal.CollisionGeometry


def bodies_of(
    robot: Robot, name: str, shape: pin.GeometryObject, numbers: tuple[int, ...] = ()
) -> Iterator[tuple[CollisionBody, pin.GeometryObject]]:
    """Bodies of one shape of a link, with their shapes in coal.

    Raises:
        RobotFileError: The shape has a kind that URDF does not define, or is a mesh without volume that cannot be
            thickened.
    """
    joint, place = int(shape.parentJoint), shape.placement
    solids = _mesh(shape.geometry) if isinstance(shape.geometry, coal.BVHModelBase) else (_primitive(shape.geometry),)
    for piece, solid in enumerate(solids):
        if solid is None:
            kind = type(shape.geometry).__name__
            raise RobotFileError(robot.urdf_path, f"link {name!r}: shape {kind} is not supported")
        core = readonly(solid.core @ place.rotation.T + place.translation)
        body = CollisionBody(name, joint - 1, core, solid.rounding, solid.kind, solid.exact, solid.growth, numbers)
        yield body, pin.GeometryObject(f"{name}:{numbers[0] if numbers else -1}:{piece}", joint, place, solid.judged)


def _primitive(geometry: coal.CollisionGeometry) -> _Solid | None:
    """Convex solid of a primitive shape; None for unknown kinds.

    Known are the kinds that URDF defines, and convex hulls of held objects.
    """
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
    if isinstance(geometry, coal.ConvexBase):  # a piece of a held object
        core = np.array(geometry.points(), dtype=np.float64).reshape(-1, 3)
        return _hull("mesh piece", core, float(geometry.getSweptSphereRadius()), geometry, MOST_BODY_POINTS)
    return None


def _mesh(mesh: coal.BVHModelBase) -> tuple[_Solid, ...]:
    """Hull of a mesh, or the hulls of its convex pieces."""
    points = np.asarray(mesh.vertices(), dtype=np.float64).tobytes()
    return _of_mesh(points, _faces_of(mesh).tobytes(), MOST_BODY_POINTS)


def _faces_of(mesh: coal.BVHModelBase) -> IntArray:
    """(m, 3) vertex indices of the triangles of a mesh."""
    corners = (mesh.tri_indices(number) for number in range(mesh.num_tris))
    return np.array([[three[0], three[1], three[2]] for three in corners], dtype=np.int64)


# Cached by content: the arms of a workcell, alone and combined into one robot, have the same meshes.
@lru_cache(maxsize=64)
def _of_mesh(points: bytes, triangles: bytes, most: int) -> tuple[_Solid, ...]:
    """Hulls of a mesh or of its convex pieces.

    Each has at most `most` points.

    Args:
        points: (n, 3) vertices as bytes of float64 [m].
        triangles: (m, 3) vertex indices as bytes of int64.
        most: Maximum number of points of a hull.
    """
    vertices = np.frombuffer(points, dtype=np.float64).reshape(-1, 3)
    faces = np.frombuffer(triangles, dtype=np.int64).reshape(-1, 3)
    thicker = (vertices[:, None] + thickening_shifts(vertices)).reshape(-1, 3)
    judged, is_closed = convex_hull_shape(vertices), _is_closed(faces)
    if is_closed:
        faces = _orient_triangles(vertices, faces)
    filled = float(_volumes(vertices, faces).sum()) / float(judged.computeVolume())
    if filled < _FILLED and is_closed:
        pieces = convex_pieces(vertices, faces, most=_PIECES).hulls
        return tuple(_hull("mesh piece", piece.core, piece.rounding, convex_shape(piece), most) for piece in pieces)
    convex = filled >= 1.0 - _CONVEX
    hull = _hull("mesh" if convex else "mesh hull", thicker, 0.0, judged, most)
    return (hull._replace(exact=convex and hull.growth == 0.0),)


def _hull(kind: str, points: FloatArray, rounding: float, judged: coal.CollisionGeometry, most: int) -> _Solid:
    """Hull of (n, 3) points with at most `most` vertices.

    It is grown by a radius.
    """
    hull = hull_of(points, most=most)
    return _Solid(kind, hull.core, hull.rounding + rounding, False, hull.rounding, judged)


def _is_closed(faces: IntArray) -> bool:
    """True if each edge joins exactly two triangles, in opposite directions."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max(initial=0)) + 1
    there, back = (np.sort(edges[:, start] * count + edges[:, 1 - start]) for start in (0, 1))
    return bool((np.diff(there) > 0).all()) and np.array_equal(there, back)


def _volumes(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(m,) signed volumes of the tetrahedra over the triangles of a surface.

    Their sum is the enclosed volume, positive if the triangles face outward.
    """
    a, b, c = (vertices[faces[:, corner]] - vertices[0] for corner in range(3))
    volumes: FloatArray = (a * np.cross(b, c)).sum(axis=1) / 6.0
    return volumes


def _orient_triangles(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles of a closed surface, with every connected part facing outward.

    Parts face inward if a scale mirrors them or if they bound a cavity. Cavities then count as solid.
    """
    part = _connected_parts(len(vertices), faces)
    inside_out = np.bincount(part, weights=_volumes(vertices, faces)) < 0.0
    return np.where(inside_out[part][:, None], faces[:, ::-1], faces)


def _connected_parts(vertices: int, faces: IntArray) -> IntArray:
    """(m,) number of the connected part of each triangle of a surface with this many vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    linked = coo_array((np.ones(len(rows)), (rows, columns)), shape=(vertices, vertices))
    part: IntArray = connected_components(linked, directed=False)[1][faces[:, 0]]
    return part


def _prism(radius: float, half_length: float) -> FloatArray:
    """(2 `_SIDES`, 3) corners of a cylinder's circumscribed prism along z."""
    angles = np.arange(_SIDES) * (2.0 * math.pi / _SIDES)
    rim = radius / math.cos(math.pi / _SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners: FloatArray = np.vstack([np.c_[rim, np.full(_SIDES, end)] for end in (-half_length, half_length)])
    return corners


def ball_about(core: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of a nearly minimum enclosing ball of some points."""
    centre = core.mean(axis=0)
    if len(core) <= 2:
        return centre, float(np.linalg.norm(core - centre, axis=1).max())
    centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
    for step in range(1, 200):
        # Move towards the farthest point by decreasing steps (Badoiu and Clarkson 2003).
        away = core - centre
        centre = centre + away[(away**2).sum(axis=1).argmax()] / (step + 1.0)
    boxed = 0.5 * (core.min(axis=0) + core.max(axis=0))
    radii = [float(np.linalg.norm(core - middle, axis=1).max()) for middle in (centre, boxed)]
    return (centre, radii[0]) if radii[0] < radii[1] else (boxed, radii[1])


def capsule_about(core: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Start, vector and radius of a bounding capsule of some points.

    The segment has the direction of the maximum spread of the points; its ends are moved inward by the radius.
    """
    middle = core.mean(axis=0)
    direction = np.linalg.svd(core - middle, full_matrices=False)[2][0]
    along = (core - middle) @ direction
    aside = core - middle - np.outer(along, direction)
    centre = 0.5 * (aside.min(axis=0) + aside.max(axis=0))
    radius = float(np.linalg.norm(aside - centre, axis=1).max())
    low, high = float(along.min()) + radius, float(along.max()) - radius
    if len(core) <= 2:
        low, high = float(along.min()), float(along.max())
    if low > high:
        low = high = 0.5 * (low + high)
    start = middle + centre + low * direction
    vector = (high - low) * direction
    length = high - low
    at = np.clip((core - start) @ direction, 0.0, length)
    needed = float(np.linalg.norm(core - start - np.outer(at, direction), axis=1).max())
    return start, vector, needed
