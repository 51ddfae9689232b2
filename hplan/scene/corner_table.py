"""Adjacency tables of hull vertices for kernels: support points by hill climbing.

A vertex at least as far in a direction as all its neighbours is the support point. So a walk from vertex to vertex,
always to the farthest neighbour, ends there (`hplan.collision.convex_distance.farthest_corner`). The table also holds
a start vertex for each of the eight octants of directions.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.solids import CUBE_CORNERS

#: Up to this number of vertices, all of them are compared.
FEW: Final = 16

#: Number of start vertices.
OCTANTS: Final = 8


def corner_table(corners: FloatArray, first: int, table: int, faces: IntArray | None = None) -> FloatArray:
    """Return the adjacency table of a hull's vertices.

    Args:
        corners: (n, 3) vertices.
        first: Index of the first vertex coordinate in the kernel's number array, x, y, z of each vertex in turn.
        table: Index of the table in that array.
        faces: (m, 3) triangles of the hull; None if unknown.

    Returns:
        Numbers: for each octant (index 1 for x > 0, 2 for y > 0, 4 for z > 0, added) the index of a vertex; for each
            vertex, and one past the last, the index of its first neighbour in the table; the indices of the neighbours.
            Empty for at most `FEW` vertices, or vertices in one plane: then all are compared.
    """
    if len(corners) <= FEW:
        return np.zeros(0)
    # A vertex without a triangle would have no neighbours.
    if faces is None or not (np.bincount(faces.ravel(), minlength=len(corners)) > 0).all():
        from scipy.spatial import ConvexHull, QhullError

        try:
            faces = ConvexHull(corners).simplices
        except QhullError:
            return np.zeros(0)
    are_neighbours = np.zeros((len(corners), len(corners)), dtype=np.bool_)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        are_neighbours[faces[:, a], faces[:, b]] = are_neighbours[faces[:, b], faces[:, a]] = True
    here, there = np.nonzero(are_neighbours)
    begin = np.searchsorted(here, np.arange(len(corners) + 1))
    signs = CUBE_CORNERS[np.lexsort(CUBE_CORNERS.T)]  # x changes fastest
    octants = ties.on_raster(corners @ signs.T).argmax(axis=0)
    lists = table + OCTANTS + len(begin)
    return np.concatenate([first + 3 * octants, lists + begin, first + 3 * there]).astype(np.float64)
