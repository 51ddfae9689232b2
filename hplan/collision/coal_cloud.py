r"""Point clouds in coal: lazily built bounding-volume trees over blocks of points.

coal takes 2 us per point to build a tree, but a motion comes near few blocks only: leaves of the cloud's own tree,
whose nodes have bounding balls. A shape of the arm lies in a box grown by a radius, a capsule in its axis grown by a
radius. The distance from the box to a ball, or to the nearest of its points, minus the radius is a lower bound of the
distance between the shape and the points. Another one is the distance along any direction in which the shape's corners
are ahead of a plane: that of the nearest points found so far, and one for each block, which GJK proposes. A block is
skipped if a bound is at least the minimum found before it, so the minimum over all points is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.base.deadline import check_deadline
from hplan.base.kernels import inline, kernel
from hplan.collision.coal_shapes import beyond_geometry, capsule_shapes, solid_shape, triangle_tree
from hplan.geometry.cloud import LEAF, Cloud
from hplan.geometry.cloud_tree import tree_of
from hplan.geometry.convex_distance import NEAREST, NO_TABLE, SEPARATING, WORK, Wanted, core_distance
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.planes import NO_PLANE, Plane, is_behind
from hplan.geometry.shape_outline import coal_distance
from hplan.geometry.sweep import STILL
from hplan.geometry.vectors import Vector
from hplan.scene.obstacles import Capsule, Solid

#: Size of the triangle that represents a point, and radius of a ball around it [m]. For triangles degenerated to
#: points, coal's distance from a ball is wrong.
_SPECK: Final = 1e-7
SPECK_RADIUS_M: Final = 2.0 * _SPECK
_SPECK_CORNERS: Final = _SPECK * np.array([[1.0, 0.0, 0.5], [-0.5, 0.75, -0.25], [-0.5, -0.75, -0.25]])

#: Relative tolerance of the distances by which GJK proposes a direction.
_ROUGH: Final = 1e-2

#: Radius of a capsule that represents its axis [m].
_THIN: Final = 1e-6

_NOWHERE: Final = np.zeros(3)

#: The blocks of the clouds in use.
_BLOCKS_OF_CLOUDS: WeakKeyDictionary[Cloud, PointBlocks] = WeakKeyDictionary()

_PLACE: Final = coal.Transform3s()
_REQUEST: Final = coal.DistanceRequest()


class BareShape(NamedTuple):
    """A shape without its swept radius, which coal ignores against triangles.

    Attributes:
        core: (2, 3) centre and half sizes of a box in the shape's frame that contains the shape when grown by
            `rounding` [m].
        corners: (n, 3) points whose hull contains the shape when grown by `rounding` [m].
        rounding: Radius of a ball or capsule, 0 for other shapes [m].
        radius: The swept radius that was removed [m].
        thin: For a capsule, one with almost no radius: for a shape in contact coal returns the depth of some point, not
            of the deepest one. None for other shapes.
    """

    geometry: coal.CollisionGeometry
    core: FloatArray
    corners: FloatArray
    rounding: float
    radius: float
    thin: BareShape | None = None

    @classmethod
    def strip(cls, shape: coal.CollisionGeometry) -> BareShape:
        """Strip the swept radius, if any, from a shape of the arm."""
        radius = float(shape.getSweptSphereRadius())
        if radius > 0.0:
            shape = shape.clone()
            shape.setSweptSphereRadius(0.0)
        thin = None
        if isinstance(shape, coal.Capsule) and shape.radius > _THIN:
            needle = coal.Capsule(_THIN, 2.0 * shape.halfLength)
            thin = cls(needle, *_core_box(needle), radius + shape.radius - _THIN)
        return cls(shape, *_core_box(shape), radius, thin)

    @classmethod
    def from_tree(cls, tree: coal.BVHModelBase) -> BareShape:
        """A surface of triangles."""
        return cls(tree, *_core_box(tree), 0.0)


class PointBlocks:
    """The points of a cloud, without their radius, in blocks of neighbours.

    The blocks are the leaves of the cloud's tree. Safe for use from several threads.

    Attributes:
        points: (n, 3) the points [m].
    """

    def __init__(self, points: FloatArray, nodes: FloatArray) -> None:
        """Take a cloud's points and tree nodes, as in `hplan.geometry.cloud.Cloud`."""
        self.points, self._nodes = points, nodes
        self._trees: dict[int, coal.BVHModelOBBRSS] = {}

    @classmethod
    def from_cloud(cls, cloud: Cloud) -> PointBlocks:
        """Return the blocks of a cloud, built once."""
        found = _BLOCKS_OF_CLOUDS.get(cloud)
        if found is None:
            points, tree = cloud.core, cloud.tree
            if len(tree) == 0:  # The points are unordered.
                points, tree = tree_of(points, LEAF)
            found = _BLOCKS_OF_CLOUDS[cloud] = cls(points, tree)
        return found

    def distance(self, shape: BareShape, placement: pin.SE3, most: float = math.inf) -> float:
        """Signed distance of a shape from the nearest point [m].

        In contact it is the signed distance from one of the points that the shape touches; for a capsule the nearest
        one, unless that lies on its axis. May be infinite if the distance exceeds `most`.
        """
        place, body = (placement.rotation, placement.translation), (shape.core, shape.corners)
        coal_place, result, cloud = coal.Transform3s(*place), coal.DistanceResult(), (self._nodes, self.points)
        most += shape.radius + shape.rounding
        bound, nearest = likely_block(place, body, cloud)
        least, towards, block, following = math.inf, _NOWHERE, nearest if bound < most else -1, 0
        while block >= 0 and least > 0.0:
            # coal continues from the minimum distance in its result and skips everything farther.
            found = coal.distance(shape.geometry, coal_place, self._tree(block), _PLACE, _REQUEST, result)
            if found < least:
                least, towards = found, result.normal
            limit = min(least + shape.rounding, most)
            block = following = next_block(place, body, cloud, (following, nearest), towards, limit)
            following += 1
        if least <= 0.0 and shape.thin is not None:
            return self.distance(shape.thin, placement)
        return least - shape.radius

    def _tree(self, block: int) -> coal.BVHModelOBBRSS:
        """Return the tree of a block's points as tiny triangles, built once."""
        tree = self._trees.get(block)
        if tree is None:
            first, last = self._nodes[block, :2].astype(np.int64)
            inside = self.points[first:last]
            corners = (inside[:, None] + _SPECK_CORNERS).reshape(-1, 3)
            tree = self._trees[block] = triangle_tree(corners, np.arange(len(corners)).reshape(-1, 3))
        return tree


def _core_box(shape: coal.CollisionGeometry) -> tuple[FloatArray, FloatArray, float]:
    """Box or hull that, grown by a radius, contains a shape [m].

    (2, 3) centre and half sizes of the box in the shape's own frame, (n, 3) corners of the hull, and the radius.
    """
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    rounding = float(shape.radius) if isinstance(shape, coal.Sphere | coal.Capsule) else 0.0
    half = np.maximum(0.5 * (high - low) * (1.0 + 1e-12) - rounding, 0.0)
    box = np.stack([0.5 * (low + high), half])
    corners = np.array(shape.points()) if isinstance(shape, coal.ConvexBase) else box[0] + CUBE_CORNERS * half
    return box, corners, rounding


def obstacle_shape(obstacle: Solid) -> pin.GeometryObject | PointBlocks:
    """The obstacle as coal sees it; a cloud without its radius (`beyond_geometry`)."""
    return PointBlocks.from_cloud(obstacle) if isinstance(obstacle, Cloud) else solid_shape(obstacle)


def obstacle_shapes(obstacles: Sequence[Solid]) -> list[pin.GeometryObject | PointBlocks]:
    """Convert many obstacles by `obstacle_shape`, capsules in one batch."""
    capsules = iter(capsule_shapes([obstacle for obstacle in obstacles if type(obstacle) is Capsule]))
    shapes: list[pin.GeometryObject | PointBlocks] = []
    for obstacle in obstacles:
        check_deadline()
        shapes.append(next(capsules) if type(obstacle) is Capsule else obstacle_shape(obstacle))
    return shapes


def distance_from(obstacle: Solid, most: float = math.inf) -> Callable[[coal.CollisionGeometry, pin.SE3], float]:
    """Return the distance function of an obstacle.

    It returns the signed distance of a placed shape from the obstacle [m]. The obstacle's own shape is built once. The
    distance may be infinite if it exceeds `most`.
    """
    solid = obstacle_shape(obstacle)
    if isinstance(solid, PointBlocks):
        beyond = beyond_geometry(obstacle)
        return lambda shape, placement: solid.distance(BareShape.strip(shape), placement, most + beyond) - beyond
    return lambda shape, placement: coal_distance(shape, placement, solid.geometry, solid.placement)


@kernel
def likely_block(
    place: tuple[FloatArray, FloatArray], body: tuple[FloatArray, FloatArray], cloud: tuple[FloatArray, FloatArray]
) -> tuple[float, int]:
    """Find the leaf that is probably the nearest to a placed hull: the nearest one as the hull of its points.

    Args:
        place: (3, 3) rotation and (3,) translation of the hull's frame.
        body: (2, 3) centre and half sizes of a box in that frame that contains the hull, and (n, 3) its corners.
        cloud: (k, 7) the tree, as in `hplan.geometry.cloud.Cloud`, and its (n, 3) points.

    Returns:
        A lower bound of the distance of all points from the box [m], and the leaf's index; infinity and -1 for a cloud
        without points.
    """
    (rotation, translation), (core, corners), (nodes, points) = place, body, cloud
    number, found, bound, least, work = 0, -1, math.inf, math.inf, np.empty(WORK)
    if len(nodes) > 0:
        found = _descend(rotation, translation, core, nodes)
        least = _separation(place, corners, points, (int(nodes[found, 0]), int(nodes[found, 1])), math.inf, work)
        bound = _ball_bound(rotation, translation, core, nodes[found])
    while number < len(nodes):
        away = _ball_bound(rotation, translation, core, nodes[number])
        is_leaf = nodes[number, 2] == number + 1
        if is_leaf or away >= least:
            bound = min(bound, away)
        if away >= least:
            number = int(nodes[number, 2])
            continue
        if is_leaf and number != found:
            lot = int(nodes[number, 0]), int(nodes[number, 1])
            if not _is_beyond(place, core, points, lot, NO_PLANE, least):
                apart = _separation(place, corners, points, lot, least, work)
                if apart < least:
                    least, found = apart, number
        number += 1
    return bound, found


@kernel
def next_block(
    place: tuple[FloatArray, FloatArray],
    body: tuple[FloatArray, FloatArray],
    cloud: tuple[FloatArray, FloatArray],
    after: tuple[int, int],
    towards: FloatArray,
    limit: float,
) -> int:
    """Find the next leaf, in the order of the tree, with points that may be nearer to a placed hull than a limit.

    Args:
        place: (3, 3) rotation and (3,) translation of the hull's frame.
        body: (2, 3) centre and half sizes of a box in that frame that contains the hull, and (n, 3) its corners.
        cloud: (k, 7) the tree, as in `hplan.geometry.cloud.Cloud`, and its (n, 3) points.
        after: The first node of the search, and a leaf that does not count.
        towards: (3,) direction from the hull to what is probably the nearest of the cloud; zeros if it is unknown.
        limit: The limit [m].

    Returns:
        The leaf's index; -1 if no leaf is left.
    """
    (rotation, translation), (core, corners), (nodes, points), (number, seen) = place, body, cloud, after
    away, work = (-towards[0], -towards[1], -towards[2]), np.empty(WORK)
    plane = _plane_behind(rotation, translation, corners, away)
    while number < len(nodes):
        node = nodes[number]
        if (
            is_behind(plane, (node[3], node[4], node[5]), node[6] + limit + SPECK_RADIUS_M)
            or _ball_bound(rotation, translation, core, node) >= limit
        ):
            number = int(node[2])
            continue
        if node[2] == number + 1 and number != seen:
            lot = int(node[0]), int(node[1])
            if not _is_beyond(place, core, points, lot, plane, limit):
                _separation(place, corners, points, lot, limit + SPECK_RADIUS_M, work)
                apart = work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2]
                other = _plane_behind(rotation, translation, corners, apart)
                if not _is_beyond(place, core, points, lot, other, limit):
                    return number
        number += 1
    return -1


@kernel
def _is_beyond(
    place: tuple[FloatArray, FloatArray],
    core: FloatArray,
    points: FloatArray,
    lot: tuple[int, int],
    plane: Plane,
    limit: float,
) -> bool:
    """True if points are all at least `limit` [m] behind a plane, or from a placed box.

    Args:
        place: Place of the box, as of `next_block`.
        core: (2, 3) the box.
        points: (n, 3) points.
        lot: The range of those that are meant.
        plane: A plane that the hull in the box is ahead of.
        limit: The distance [m].
    """
    (rotation, translation), (first, last), least = place, lot, math.inf
    for p in range(first, last):
        point = points[p, 0], points[p, 1], points[p, 2]
        if not is_behind(plane, point, limit + SPECK_RADIUS_M):
            least = min(least, _square_from_box(rotation, translation, core, point))
    return math.sqrt(least) * (1.0 - 1e-12) - SPECK_RADIUS_M >= limit


@kernel
def _separation(
    place: tuple[FloatArray, FloatArray],
    corners: FloatArray,
    points: FloatArray,
    lot: tuple[int, int],
    enough: float,
    work: FloatArray,
) -> float:
    """About the distance of a placed hull from the hull of some points, by GJK [m].

    The direction from the points to the hull along which they are about the farthest apart is written to the buffer at
    `SEPARATING`; zeros if there is none.

    Args:
        place: Place of the hull, as of `next_block`.
        corners: (n, 3) its corners.
        points: (n, 3) points.
        lot: The range of those that are meant.
        enough: A direction along which they are so far apart suffices [m].
        work: (WORK,) buffer.
    """
    (r, t), (first, last) = place, lot
    pose = r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2], t[0], t[1], t[2]
    span, other = (0, corners.size, NO_TABLE), (3 * first, 3 * last, NO_TABLE)
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = 0.0, 0.0, 0.0
    wanted = Wanted(enough, -math.inf, _ROUGH, 0.0, STILL)
    return core_distance(corners.reshape(-1), span, pose, points.reshape(-1), other, wanted, work)


@kernel
def _plane_behind(rotation: FloatArray, translation: FloatArray, corners: FloatArray, normal: Vector) -> Plane:
    """Plane that a placed hull is ahead of, and touches, by a normal of any length; `NO_PLANE` for zeros."""
    x, y, z = normal
    length, height = math.sqrt(x * x + y * y + z * z), math.inf
    if not length > 0.0:
        return NO_PLANE
    n = (x / length, y / length, z / length)
    a = rotation[0, 0] * n[0] + rotation[1, 0] * n[1] + rotation[2, 0] * n[2]
    b = rotation[0, 1] * n[0] + rotation[1, 1] * n[1] + rotation[2, 1] * n[2]
    c = rotation[0, 2] * n[0] + rotation[1, 2] * n[1] + rotation[2, 2] * n[2]
    for k in range(corners.shape[0]):
        height = min(height, a * corners[k, 0] + b * corners[k, 1] + c * corners[k, 2])
    return n, height + n[0] * translation[0] + n[1] * translation[1] + n[2] * translation[2]


@kernel
def _descend(rotation: FloatArray, translation: FloatArray, core: FloatArray, nodes: FloatArray) -> int:
    """Index of the leaf reached by always taking the nearer child."""
    number = 0
    while nodes[number, 2] > number + 1:
        end, number = nodes[number, 2], number + 1
        second = int(nodes[number, 2])
        if second < end:
            nearer = _ball_bound(rotation, translation, core, nodes[number])
            if _ball_bound(rotation, translation, core, nodes[second]) < nearer:
                number = second
    return number


@inline
def _ball_bound(rotation: FloatArray, translation: FloatArray, core: FloatArray, node: FloatArray) -> float:
    """Lower bound of the distance of a placed box from the points of a node [m]."""
    square = _square_from_box(rotation, translation, core, (node[3], node[4], node[5]))
    # Rounding errors, and the triangles' size, never make a ball too small.
    bound: float = math.sqrt(square) - (node[6] * (1.0 + 1e-12) + SPECK_RADIUS_M)
    return bound


@inline
def _square_from_box(rotation: FloatArray, translation: FloatArray, core: FloatArray, point: Vector) -> float:
    """Squared distance of a point from a placed box [m2]."""
    x, y, z = point[0] - translation[0], point[1] - translation[1], point[2] - translation[2]
    square = 0.0
    for axis in range(3):
        along = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
        beyond = max(0.0, abs(along - core[0, axis]) - core[1, axis])
        square += beyond * beyond
    return square
