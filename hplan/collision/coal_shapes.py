"""Coal shapes of obstacles, as Pinocchio geometry objects."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.geometry.cloud import Cloud
from hplan.geometry.coal_hull import convex_shape
from hplan.geometry.hull import Hull
from hplan.scene.obstacle_kind import Convex
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: The axis of coal's capsules.
_UP = np.array([0.0, 0.0, 1.0])

_UNTURNED = np.eye(3)
_AT_ORIGIN = pin.SE3.Identity()


def capsule_shapes(capsules: Sequence[Capsule]) -> list[pin.GeometryObject]:
    """Capsule obstacles as fixed geometry objects, with vectorized placements.

    For hundreds of capsules this takes less than half the time of `solid_shape`.
    """
    if not capsules:
        return []
    start, end = np.array([(capsule.start, capsule.end) for capsule in capsules]).transpose(1, 0, 2)
    axes, centres = end - start, 0.5 * (start + end)
    lengths = np.sqrt((axes * axes).sum(axis=1))
    x, y, z = (axes / np.maximum(lengths, 1e-300)[:, None]).T
    upright = z > -0.5  # for axes that point down the quaternion would consist of rounding errors
    half = np.sqrt(np.where(upright, 2.0 * (1.0 + z), 1.0))
    turns = np.column_stack([0.5 * half, -y / half, x / half]).tolist()
    shapes = []
    for number, (capsule, length) in enumerate(zip(capsules, lengths.tolist(), strict=True)):
        check_deadline()
        if not (upright[number] and length > 0.0):
            shapes.append(solid_shape(capsule))
            continue
        w, i, j = turns[number]
        placement = pin.SE3(pin.Quaternion(w, i, j, 0.0), centres[number])
        shape = coal.Capsule(float(capsule.radius), length)
        shapes.append(pin.GeometryObject(f"obstacle:{capsule.name}", 0, placement, shape))
    return shapes


def solid_shape(obstacle: Convex | Hull) -> pin.GeometryObject:
    """A convex obstacle as a fixed geometry object."""
    placement = _AT_ORIGIN
    if isinstance(obstacle, Sphere):
        placement, shape = pin.SE3(_UNTURNED, np.array(obstacle.center)), coal.Sphere(float(obstacle.radius))
    elif isinstance(obstacle, Capsule):
        placement, length = _segment_placement(np.array(obstacle.start), np.array(obstacle.end))
        shape = coal.Capsule(float(obstacle.radius), length)
    elif isinstance(obstacle, Cylinder):
        placement = pin.SE3(obstacle.rotation, np.array(obstacle.center))
        shape = coal.Cylinder(float(obstacle.radius), float(obstacle.length))
    elif isinstance(obstacle, Box):
        placement = pin.SE3(obstacle.rotation, np.array(obstacle.center))
        shape = coal.Box(*(float(size) for size in obstacle.size))
    else:
        shape = convex_shape(obstacle.hull)
    return pin.GeometryObject(f"obstacle:{obstacle.name}", 0, placement, shape)


def beyond_geometry(obstacle: Solid) -> float:
    """Excess of an obstacle over its geometry in coal [m].

    It is the radius of a cloud's points, which have none in coal, and 0 for all other obstacles.
    """
    return obstacle.rounding if isinstance(obstacle, Cloud) else 0.0


def triangle_tree(points: FloatArray, faces: IntArray) -> coal.BVHModelOBBRSS:
    """Bounding-volume tree of triangles: (n, 3) points [m], (m, 3) point indices."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(points))
    tree.addVertices(np.array(points))
    tree.addTriangles(faces.astype(np.int32))
    tree.endModel()
    return tree


def _segment_placement(start: FloatArray, end: FloatArray) -> tuple[pin.SE3, float]:
    """Placement at a segment's middle, z along it; its length [m]."""
    axis = end - start
    length = math.sqrt(axis @ axis)  # as `np.linalg.norm`, in a tenth of the time
    if length == 0.0:
        return pin.SE3(_UNTURNED, 0.5 * (start + end)), length
    return pin.SE3(pin.Quaternion.FromTwoVectors(_UP, axis / length), 0.5 * (start + end)), length
