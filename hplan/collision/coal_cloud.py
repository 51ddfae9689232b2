r"""Point clouds in coal: lazily built bounding-volume trees over blocks of points.

coal takes 2 us per point to build a tree, but a motion comes near few blocks only: leaves of the cloud's own tree,
whose nodes have bounding balls. A shape of the arm lies in a box grown by a radius, a capsule in its axis grown by a
radius. The distance from the box to a ball, or to the nearest of its points, minus the radius is a lower bound of the
distance between the shape and the points. Another one is the distance along the direction of the nearest points found
so far, in which the shape's corners are ahead of a plane. A block is skipped if a bound is at least the minimum found
before it, so the minimum over all points is exact.
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
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.planes import NO_PLANE, Plane, is_behind
from hplan.geometry.shape_outline import coal_distance
from hplan.geometry.vectors import Vector
from hplan.scene.obstacles import Capsule, Solid

#: Size of the triangle that represents a point, and radius of a ball around it [m]. For triangles degenerated to
#: points, coal's distance from a ball is wrong.
_SPECK: Final = 1e-7
SPECK_RADIUS_M: Final = 2.0 * _SPECK
_SPECK_CORNERS: Final = _SPECK * np.array([[1.0, 0.0, 0.5], [-0.5, 0.75, -0.25], [-0.5, -0.75, -0.25]])

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
        place = placement.rotation, placement.translation
        coal_place, result = coal.Transform3s(*place), coal.DistanceResult()
        least, bound, block, towards = math.inf, -math.inf, -1, _NOWHERE
        while True:
            limit = min(least, most + shape.radius) + shape.rounding
            bound, block = nearest_block(
                place, (shape.core, shape.corners), (self._nodes, self.points), (bound, block), towards, limit
            )
            if block < 0 or least <= 0.0:
                if least <= 0.0 and shape.thin is not None:
                    return self.distance(shape.thin, placement)
                return least - shape.radius
            # coal continues from the minimum distance in its result and skips everything farther.
            found = coal.distance(shape.geometry, coal_place, self._tree(block), _PLACE, _REQUEST, result)
            if found < least:
                least, towards = found, result.normal

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
def nearest_block(
    place: tuple[FloatArray, FloatArray],
    body: tuple[FloatArray, FloatArray],
    cloud: tuple[FloatArray, FloatArray],
    after: tuple[float, int],
    towards: FloatArray,
    limit: float,
) -> tuple[float, int]:
    """Find the leaf that may be nearest to a placed box.

    Args:
        place: (3, 3) rotation and (3,) translation of the box's frame.
        body: (2, 3) centre and half sizes of the box in that frame, and (n, 3) corners of the hull that matters of it.
        cloud: (k, 7) the tree, as in `hplan.geometry.cloud.Cloud`, and its (n, 3) points.
        after: Result of the previous call; leaves up to it in the order of bound and index are skipped.
        towards: (3,) direction from the hull to what is probably the nearest of the cloud; zeros if it is unknown.
        limit: Leaves whose ball, or points, are at least this far from the box, or from the hull in that direction, are
            skipped [m].

    Returns:
        The distance from the box to the ball that contains the leaf's points, negative if the box overlaps the ball,
        and the leaf's index; -1 if no leaf is left.
    """
    (rotation, translation), (core, corners), (nodes, points) = place, body, cloud
    plane = _plane_behind(rotation, translation, corners, towards)
    while True:
        bound, leaf = _next_leaf(place, core, nodes, after, plane, limit)
        if leaf < 0:
            return bound, leaf
        least = math.inf
        for p in range(int(nodes[leaf, 0]), int(nodes[leaf, 1])):
            point = points[p, 0], points[p, 1], points[p, 2]
            if not is_behind(plane, point, limit + SPECK_RADIUS_M):
                least = min(least, _square_from_box(rotation, translation, core, point))
        if math.sqrt(least) * (1.0 - 1e-12) - SPECK_RADIUS_M < limit:
            return bound, leaf
        after = bound, leaf


@kernel
def _plane_behind(rotation: FloatArray, translation: FloatArray, corners: FloatArray, towards: FloatArray) -> Plane:
    """Plane that a placed hull is ahead of, and touches; its normal is opposite to a direction."""
    x, y, z = -towards[0], -towards[1], -towards[2]
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
def _next_leaf(
    place: tuple[FloatArray, FloatArray], core: FloatArray, nodes: FloatArray, after: tuple[float, int], plane: Plane,
    limit: float,
) -> tuple[float, int]:  # fmt: skip
    """Find the leaf whose ball is nearest to a placed box; arguments and result as of `nearest_block`."""
    (rotation, translation), least, found, number = place, limit, -1, 0
    if after[1] < 0 and plane[1] == -math.inf and nodes.shape[0] > 0:
        # A leaf that is rather near, so that most balls need not be opened.
        bound = _descent_bound(rotation, translation, core, nodes)
        least = min(least, bound + 1e-12 * (1.0 + abs(bound)))
    # Ends and bounds of the nodes above: this node's ball may extend beyond theirs, its points do not.
    above, height = np.empty((64, 2)), 0
    while number < nodes.shape[0]:
        while height > 0 and number >= above[height - 1, 0]:
            height -= 1
        node = nodes[number]
        if is_behind(plane, (node[3], node[4], node[5]), node[6] + limit + SPECK_RADIUS_M):
            number = int(node[2])
            continue
        bound = _ball_bound(rotation, translation, core, node)
        if height > 0:
            bound = max(bound, above[height - 1, 1])
        is_leaf = nodes[number, 2] == number + 1
        if bound < least and is_leaf and (bound > after[0] or (bound == after[0] and number > after[1])):
            least, found = bound, number
        if is_leaf or bound >= least:
            number = int(nodes[number, 2])
        else:
            above[height, 0], above[height, 1] = nodes[number, 2], bound
            height, number = height + 1, number + 1
    return (limit, -1) if found < 0 else (least, found)


@kernel
def _descent_bound(rotation: FloatArray, translation: FloatArray, core: FloatArray, nodes: FloatArray) -> float:
    """Bound of the leaf reached by always taking the nearer child [m]."""
    number, bound = 0, _ball_bound(rotation, translation, core, nodes[0])
    while nodes[number, 2] > number + 1:
        end, number = nodes[number, 2], number + 1
        nearer, second = _ball_bound(rotation, translation, core, nodes[number]), int(nodes[number, 2])
        if second < end:
            other = _ball_bound(rotation, translation, core, nodes[second])
            if other < nearer:
                number, nearer = second, other
        bound = max(bound, nearer)
    return bound


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
