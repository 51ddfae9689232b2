"""Voxelized solid: voxels on or inside its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.scene.solids import Hull


@dataclass(frozen=True, eq=False)
class SolidVoxels:
    """Distance field of a solid, for the excess of its convex parts.

    Attributes:
        origin: (3,) centre of the first voxel [m].
        edge: Edge length of a voxel [m].
        distance: Distance of each voxel centre from the nearest centre of a solid voxel [m].
        tolerance: Maximum accepted excess of a part [m].
    """

    origin: FloatArray
    edge: float
    distance: FloatArray
    tolerance: float

    @classmethod
    def of(cls, triangles: FloatArray) -> SolidVoxels:
        """Voxelize a closed surface; the edge length is half the tolerance."""
        from scipy import ndimage

        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        # Accepted excess: 5 mm, or a fraction of the mesh's longest side if that is more.
        tolerance = max(5e-3, 0.02 * float((high - low).max()))
        edge = 0.5 * tolerance
        origin = low - 0.5 * edge
        shape = tuple((np.ceil((high - low) / edge) + 2).astype(int).tolist())
        solid: BoolArray = np.zeros(shape, dtype=np.bool_)
        for points in _covering_points(triangles, 0.7 * edge):
            solid[tuple(np.rint((points - origin) / edge).astype(int).T)] = True
        distance = edge * ndimage.distance_transform_edt(~ndimage.binary_fill_holes(solid))
        return cls(origin, edge, distance, tolerance)

    @property
    def blur(self) -> float:
        """Maximum error of a distance between centres: one voxel diagonal [m].

        It is half a diagonal at either end.
        """
        return float(np.sqrt(3.0) * self.edge)

    def excess(self, hull: Hull) -> float:
        """Excess of a hull over the solid [m].

        It is the maximum distance over voxels within half a diagonal of the hull.
        """
        margin = 0.5 * self.blur + hull.rounding
        low = np.floor((hull.core.min(axis=0) - margin - self.origin) / self.edge).astype(int)
        high = np.ceil((hull.core.max(axis=0) + margin - self.origin) / self.edge).astype(int) + 1
        low, high = np.maximum(low, 0), np.minimum(high, self.distance.shape)
        near = self.distance[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        index = np.argwhere(near > 0.5 * self.tolerance)
        # Farthest first, so that the first voxel in the hull is the answer.
        far = near[tuple(index.T)]
        order = np.argsort(-far, kind="stable")
        for k in range(0, len(order), 20_000):
            some = order[k : k + 20_000]
            centers = self.origin + self.edge * (index[some] + low)
            within = (centers @ hull.planes[:, :3].T <= hull.planes[:, 3] + margin).all(axis=1)
            if within.any():
                return float(far[some[int(within.argmax())]])
        return 0.5 * self.tolerance


def _covering_points(triangles: FloatArray, spacing: float) -> list[FloatArray]:
    """Points on all triangles, at most `spacing` apart [m].

    Triangles are bisected along the longest side until they are small enough.
    """
    found = [triangles.reshape(-1, 3)]
    while len(triangles):
        sides = np.linalg.norm(triangles - triangles[:, [1, 2, 0]], axis=2)
        triangles = triangles[sides.max(axis=1) > spacing]
        sides = sides[sides.max(axis=1) > spacing]
        turn = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(triangles, turn[:, :, None], axis=1)
        middle = 0.5 * (corners[:, 0] + corners[:, 1])
        found.append(middle)
        first = np.stack([corners[:, 0], middle, corners[:, 2]], axis=1)
        second = np.stack([middle, corners[:, 1], corners[:, 2]], axis=1)
        triangles = np.concatenate([first, second])
    return found
