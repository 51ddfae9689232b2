r"""Clouds in coal: trees of bounding volumes over blocks of their points, built when a block is first asked.

coal takes 2 us a point to build a tree, but a motion comes near a few blocks alone: leaves of the cloud's own tree,
whose nodes have balls about their points. A shape of the arm lies in a box grown by a radius, a capsule in its axis.
The distance of the box from a ball, less the radius, bounds that of the points from the shape from below, so a block
with a bound that is no smaller than a distance found already is passed over, and the least distance over all is exact.
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
from hplan.base.kernels import kernel
from hplan.collision.coal_shapes import beyond_geometry, capsule_shapes, solid_shape, triangle_tree
from hplan.robot.base_shapes import coal_distance
from hplan.scene.cloud_tree import tree_of
from hplan.scene.obstacles import Capsule, Solid
from hplan.scene.solids import LEAF, Cloud

#: Size of the triangle that stands for a point [m]. Of triangles that are mere points, coal's distance from a ball is
#: wrong.
_SPECK: Final = 1e-7
_CORNERS: Final = _SPECK * np.array([[1.0, 0.0, 0.5], [-0.5, 0.75, -0.25], [-0.5, -0.75, -0.25]])

#: Radius of a capsule that stands for its axis [m].
_THIN: Final = 1e-6

#: The blocks of clouds that are in use.
_KNOWN: WeakKeyDictionary[Cloud, PointBlocks] = WeakKeyDictionary()

_PLACE: Final = coal.Transform3s()
_REQUEST: Final = coal.DistanceRequest()


class BareShape(NamedTuple):
    """A shape without the radius that is swept about it: coal knows none where it is asked about triangles.

    Attributes:
        core: (2, 3) centre and half sizes of a box in its own frame, which holds it, grown by `rounding` [m].
        rounding: Its radius where it is round [m].
        radius: What was swept about it [m].
        thin: Of a capsule one with hardly any radius: of a shape that is in contact coal says of one point how deep it
            is, and not of the deepest. None of other shapes.
    """

    geometry: coal.CollisionGeometry
    core: FloatArray
    rounding: float
    radius: float
    thin: BareShape | None = None

    @classmethod
    def of(cls, shape: coal.CollisionGeometry) -> BareShape:
        """A shape of the arm; one that nothing is swept about is itself."""
        radius = float(shape.getSweptSphereRadius())
        if radius > 0.0:
            shape = shape.clone()
            shape.setSweptSphereRadius(0.0)
        thin = None
        if isinstance(shape, coal.Capsule) and shape.radius > _THIN:
            needle = coal.Capsule(_THIN, 2.0 * shape.halfLength)
            thin = cls(needle, *_core_box(needle), radius + shape.radius - _THIN)
        return cls(shape, *_core_box(shape), radius, thin)


class PointBlocks:
    """The points of a cloud, without their radius, in blocks of neighbours: the leaves of its tree.

    Several threads may ask at once.
    """

    def __init__(self, points: FloatArray, nodes: FloatArray) -> None:
        """Take a cloud's points, and the nodes of its tree, as `hplan.scene.solids.Cloud` has them."""
        self._points, self._nodes = points, nodes
        self._trees: dict[int, coal.BVHModelOBBRSS] = {}

    @classmethod
    def of(cls, cloud: Cloud) -> PointBlocks:
        """The blocks of a cloud, cut once."""
        found = _KNOWN.get(cloud)
        if found is None:
            points, tree = cloud.core, cloud.tree
            if len(tree) == 0:  # its points are in no order
                points, tree = tree_of(points, LEAF)
            found = _KNOWN[cloud] = cls(points, tree)
        return found

    def distance(self, shape: BareShape, placement: pin.SE3, most: float = math.inf) -> float:
        """Signed distance of a shape from the nearest point [m]; in contact that of one of those that it touches.

        Of a capsule it is the nearest, as long as that is not on its axis. Infinite, it may be, where it is more than
        `most`.
        """
        place = placement.rotation, placement.translation
        coal_place, result = coal.Transform3s(*place), coal.DistanceResult()
        least, bound, block = math.inf, -math.inf, -1
        while True:
            limit = min(least, most + shape.radius) + shape.rounding
            bound, block = nearest_block(place, shape.core, self._nodes, (bound, block), limit)
            if block < 0 or least <= 0.0:
                if least <= 0.0 and shape.thin is not None:
                    return self.distance(shape.thin, placement)
                return least - shape.radius
            # coal goes on from the least distance in its result, and passes over what is farther.
            least = min(least, coal.distance(shape.geometry, coal_place, self._tree(block), _PLACE, _REQUEST, result))

    def _tree(self, block: int) -> coal.BVHModelOBBRSS:
        """The points of a block as tiny triangles about them, built once."""
        tree = self._trees.get(block)
        if tree is None:
            first, last = self._nodes[block, :2].astype(np.int64)
            inside = self._points[first:last]
            corners = (inside[:, None] + _CORNERS).reshape(-1, 3)
            tree = self._trees[block] = triangle_tree(corners, np.arange(len(corners)).reshape(-1, 3))
        return tree


def _core_box(shape: coal.CollisionGeometry) -> tuple[FloatArray, float]:
    """(2, 3) centre and half sizes of a box in a shape's own frame, and the radius about it: they hold it [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    rounding = float(shape.radius) if isinstance(shape, coal.Sphere | coal.Capsule) else 0.0
    half = np.maximum(0.5 * (high - low) * (1.0 + 1e-12) - rounding, 0.0)
    return np.stack([0.5 * (low + high), half]), rounding


def obstacle_shape(obstacle: Solid) -> pin.GeometryObject | PointBlocks:
    """An obstacle as coal is asked about it; a cloud without its radius (`beyond_geometry`)."""
    return PointBlocks.of(obstacle) if isinstance(obstacle, Cloud) else solid_shape(obstacle)


def obstacle_shapes(obstacles: Sequence[Solid]) -> list[pin.GeometryObject | PointBlocks]:
    """As `obstacle_shape`, of many."""
    capsules = iter(capsule_shapes([obstacle for obstacle in obstacles if type(obstacle) is Capsule]))
    shapes: list[pin.GeometryObject | PointBlocks] = []
    for obstacle in obstacles:
        check_deadline()
        shapes.append(next(capsules) if type(obstacle) is Capsule else obstacle_shape(obstacle))
    return shapes


def distance_from(obstacle: Solid, most: float = math.inf) -> Callable[[coal.CollisionGeometry, pin.SE3], float]:
    """The signed distance of a shape in its place from an obstacle [m]; the obstacle's own shape is made once.

    Infinite, it may be, where it is more than `most`.
    """
    solid = obstacle_shape(obstacle)
    if isinstance(solid, PointBlocks):
        beyond = beyond_geometry(obstacle)
        return lambda shape, placement: solid.distance(BareShape.of(shape), placement, most + beyond) - beyond
    return lambda shape, placement: coal_distance(shape, placement, solid.geometry, solid.placement)


@kernel
def nearest_block(
    place: tuple[FloatArray, FloatArray], core: FloatArray, nodes: FloatArray, after: tuple[float, int], limit: float
) -> tuple[float, int]:
    """The leaf of a tree that a box in its place may be nearest to.

    Args:
        place: (3, 3) rotation and (3,) translation of the box's frame.
        core: (2, 3) its centre and half sizes there.
        nodes: (k, 7) the tree, as in `hplan.scene.solids.Cloud`.
        after: What was found before: what is no farther is passed over.
        limit: So is what is no nearer than this [m].

    Returns:
        The distance of the box from a ball that holds the leaf's points, less than 0 where it reaches into that, and
        the leaf's number; -1 where there is none left.
    """
    (rotation, translation), least, found, number = place, limit, -1, 0
    # Ends and bounds of the nodes above: this one's ball may stand out of theirs, its points do not.
    above, height = np.empty((64, 2)), 0
    while number < nodes.shape[0]:
        node = nodes[number]
        while height > 0 and number >= above[height - 1, 0]:
            height -= 1
        x, y, z = node[3] - translation[0], node[4] - translation[1], node[5] - translation[2]
        square = 0.0
        for axis in range(3):
            along = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
            beyond = max(0.0, abs(along - core[0, axis]) - core[1, axis])
            square += beyond * beyond
        # Rounding errors, and the specks, never make a ball too small.
        bound = math.sqrt(square) - (node[6] * (1.0 + 1e-12) + 2.0 * _SPECK)
        if height > 0:
            bound = max(bound, above[height - 1, 1])
        is_leaf = node[2] == number + 1
        if bound < least and is_leaf and (bound > after[0] or (bound == after[0] and number > after[1])):
            least, found = bound, number
        if is_leaf or bound >= least:
            number = int(node[2])
        else:
            above[height, 0], above[height, 1] = node[2], bound
            height, number = height + 1, number + 1
    return least, found
