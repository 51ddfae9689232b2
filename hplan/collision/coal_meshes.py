"""Distances of closed meshes in coal, without their convex hulls or pieces.

A mesh is a bounding-volume tree of triangles, so its distance is that of its surface. It is the distance of the solid
inside if the other shape is not wholly inside: if both surfaces are apart, it is so if none of its points is. A cloud
is inside if one of its points is. A mesh in another shape is in contact with it already, unless that is a mesh too.
"""

from __future__ import annotations

from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.coal_cloud import BareShape, PointBlocks
from hplan.collision.coal_shapes import triangle_tree
from hplan.geometry.convex_decomposition import winding_numbers
from hplan.geometry.hull import Hull, hull_of, thickening_shifts

#: A point with at least this winding number is inside, as in `hplan.geometry.convex_decomposition`.
_INSIDE = 0.25


class ClosedMesh:
    """A closed surface and the solid inside, in the frame of its geometry.

    Attributes:
        shape: Its triangles in coal.
        corners: (k, 3) a vertex of each connected part [m].
    """

    def __init__(self, vertices: FloatArray, faces: IntArray, parts: IntArray) -> None:
        """Take a surface without edges of a single triangle.

        Args:
            vertices: (n, 3) vertices [m].
            faces: (m, 3) triangles, each connected part facing outward.
            parts: (m,) number of the connected part of each triangle.
        """
        self._triangles = vertices[faces]
        self.shape = BareShape.from_tree(triangle_tree(vertices, faces))
        self.corners: FloatArray = self._triangles[np.unique(parts, return_index=True)[1], 0]

    @cached_property
    def _hull(self) -> Hull:
        corners = self._triangles.reshape(-1, 3)
        return hull_of((corners[:, None] + thickening_shifts(corners)).reshape(-1, 3))

    def contains(self, points: FloatArray) -> bool:
        """True if one of (n, 3) points is inside."""
        normals, offsets = self._hull.planes[:, :3], self._hull.planes[:, 3] + self._hull.rounding
        low, high = self._hull.core.min(axis=0), self._hull.core.max(axis=0)
        near = points[((points >= low - self._hull.rounding) & (points <= high + self._hull.rounding)).all(axis=1)]
        near = near[(near @ normals.T <= offsets).all(axis=1)]
        return bool((np.abs(winding_numbers(near, self._triangles)) > _INSIDE).any())

    def distance(self, place: pin.SE3, other: ClosedMesh | BareShape, other_place: pin.SE3) -> float:
        """Distance from another solid, each at its pose [m]; -inf in contact."""
        shape = other if isinstance(other, BareShape) else other.shape
        least = coal.distance(
            self.shape.geometry, _transform(place), shape.geometry, _transform(other_place), _REQUEST,
            coal.DistanceResult(),
        ) - shape.radius  # fmt: skip
        to_mesh = place.inverse() * other_place
        if not least > 0.0 or self.contains(_moved(to_mesh, _points_of(other))):
            return -np.inf
        if isinstance(other, ClosedMesh) and other.contains(_moved(to_mesh.inverse(), self.corners)):
            return -np.inf
        return float(least)

    def cloud_distance(self, place: pin.SE3, cloud: PointBlocks) -> float:
        """Distance from the points of a cloud, in whose frame the mesh is at a pose [m]; -inf in contact."""
        least = cloud.distance(self.shape, place)
        is_contact = not least > 0.0 or self.contains(_moved(place.inverse(), cloud.points))
        return -np.inf if is_contact else least


_REQUEST = coal.DistanceRequest()


def _transform(place: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(place.rotation, place.translation)


def _moved(place: pin.SE3, points: FloatArray) -> FloatArray:
    found: FloatArray = points @ place.rotation.T + place.translation
    return found


def _points_of(other: ClosedMesh | BareShape) -> FloatArray:
    """(k, 3) a point of each connected part of a solid, in its own frame [m]."""
    if isinstance(other, ClosedMesh):
        return other.corners
    if isinstance(other.geometry, coal.ConvexBase):
        return np.array(other.geometry.points(), dtype=np.float64).reshape(-1, 3)[:1]
    return np.zeros((1, 3))  # primitives have their middle there
