r"""Clouds in coal: trees of bounding volumes over blocks of their points, built when a block is first asked.

coal takes 2 us a point to build a tree, but a motion comes near a few blocks alone. A block has a ball about its
points; a shape of the arm lies in its local axis-aligned box. The distance of the ball from the box bounds the distance
of the points from the shape from below, so a block with a bound that is no smaller than a distance found already is
passed over, and the least distance over all blocks is exact.
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
from hplan.scene.cloud_tree import parts_of, tree_of
from hplan.scene.obstacles import Capsule, Solid
from hplan.scene.solids import Cloud

#: Most points of a block.
_BLOCK: Final = 64

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
        box: Its `local_box`.
        radius: What was swept about it [m].
        thin: Of a capsule one with hardly any radius: of a shape that is in contact coal says of one point how deep it
            is, and not of the deepest. None of other shapes.
    """

    geometry: coal.CollisionGeometry
    box: FloatArray
    radius: float
    thin: BareShape | None = None

    @property
    def core_box(self) -> tuple[FloatArray, FloatArray, float]:
        """Centre and half sizes of a box in the shape's frame, and the radius about it: together they hold it."""
        shape, (centre, half) = self.geometry, self.box
        rounding = float(shape.radius) if isinstance(shape, (coal.Sphere, coal.Capsule)) else 0.0
        return centre, np.maximum(half - rounding, 0.0), self.radius + rounding

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
            thin = cls(needle, local_box(needle), radius + shape.radius - _THIN)
        return cls(shape, local_box(shape), radius, thin)


class PointBlocks:
    """The points of a cloud, without their radius, in blocks of neighbours.

    Several threads may ask at once.

    Attributes:
        balls: (blocks, 4) centre and radius of a ball about the points of each block [m].
    """

    def __init__(self, points: FloatArray, tree: FloatArray) -> None:
        """Cut points into blocks.

        Args:
            points: (n, 3) points in the order of the tree, n > 0 [m].
            tree: Its nodes, as in `hplan.scene.solids.Cloud`.
        """
        blocks = parts_of(tree, _BLOCK)
        self._points, self._spans = points, blocks[:, :2].astype(np.int64)
        # Rounding errors, and the specks, never make a ball too small.
        self.balls: FloatArray = blocks[:, 3:] * (1.0, 1.0, 1.0, 1.0 + 1e-12) + (0.0, 0.0, 0.0, 2.0 * _SPECK)
        self._trees: dict[int, coal.BVHModelOBBRSS] = {}

    @classmethod
    def of(cls, cloud: Cloud) -> PointBlocks:
        """The blocks of a cloud, cut once."""
        found = _KNOWN.get(cloud)
        if found is None:
            points, tree = cloud.core, cloud.tree
            if len(tree) == 0:  # its points are in no order
                points = points.copy()
                tree = tree_of(points, _BLOCK)
            found = _KNOWN[cloud] = cls(points, tree)
        return found

    def distance(self, shape: BareShape, placement: pin.SE3) -> float:
        """Signed distance of a shape from the nearest point [m]; in contact that of one of those that it touches.

        Of a capsule it is the nearest, as long as that is not on its axis.
        """
        rotation, translation = placement.rotation, placement.translation
        bounds = _lower_bounds(rotation, translation, shape.box, self.balls)
        place, result = coal.Transform3s(rotation, translation), coal.DistanceResult()
        least = math.inf
        while True:
            block = int(bounds.argmin())
            if bounds[block] >= least or least <= 0.0:
                if least <= 0.0 and shape.thin is not None:
                    return self.distance(shape.thin, placement)
                return least - shape.radius
            bounds[block] = math.inf
            # coal goes on from the least distance in its result, and passes over what is farther.
            least = min(least, coal.distance(shape.geometry, place, self._tree(block), _PLACE, _REQUEST, result))

    def _tree(self, block: int) -> coal.BVHModelOBBRSS:
        """The points of a block as tiny triangles about them, built once."""
        tree = self._trees.get(block)
        if tree is None:
            inside = self._points[slice(*self._spans[block])]
            corners = (inside[:, None] + _CORNERS).reshape(-1, 3)
            tree = self._trees[block] = triangle_tree(corners, np.arange(len(corners)).reshape(-1, 3))
        return tree


def local_box(shape: coal.CollisionGeometry) -> FloatArray:
    """(2, 3) centre and half sizes of the axis-aligned box about a shape, in its own frame [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    return np.stack([0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-12)])


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


def distance_from(obstacle: Solid) -> Callable[[coal.CollisionGeometry, pin.SE3], float]:
    """The signed distance of a shape in its place from an obstacle [m]; the obstacle's own shape is made once."""
    solid = obstacle_shape(obstacle)
    if isinstance(solid, PointBlocks):
        beyond = beyond_geometry(obstacle)
        return lambda shape, placement: solid.distance(BareShape.of(shape), placement) - beyond
    return lambda shape, placement: coal_distance(shape, placement, solid.geometry, solid.placement)


@kernel
def _lower_bounds(rotation: FloatArray, translation: FloatArray, box: FloatArray, balls: FloatArray) -> FloatArray:
    """(k,) distances of balls from a box in its place; of one that reaches into it, less than 0.

    Args:
        rotation: (3, 3) of the box's frame.
        translation: (3,) of the box's frame.
        box: (2, 3) its centre and half sizes there.
        balls: (k, 4) centre and radius.
    """
    bounds = np.empty(balls.shape[0])
    for ball in range(balls.shape[0]):
        x, y, z = balls[ball, 0] - translation[0], balls[ball, 1] - translation[1], balls[ball, 2] - translation[2]
        square = 0.0
        for axis in range(3):
            along = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
            beyond = max(0.0, abs(along - box[0, axis]) - box[1, axis])
            square += beyond * beyond
        bounds[ball] = math.sqrt(square) - balls[ball, 3]
    return bounds
