"""Which corners of a convex hull are neighbours, as numbers for kernels: the farthest one without a look at all.

A corner that lies no less far in a direction than all of its neighbours is the farthest of all, so a walk from corner
to corner, always to the farthest neighbour, ends there (`hplan.collision.convex_distance.farthest_corner`). The table
also holds a corner to begin with for each of the eight octants that a direction can lie in.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.solids import CUBE_CORNERS

#: With fewer corners all of them are compared.
FEW: Final = 16

#: Corners to begin with.
OCTANTS: Final = 8


def corner_table(corners: FloatArray, first: int, table: int, faces: IntArray | None = None) -> FloatArray:
    """The table of the corners of a hull.

    Args:
        corners: (n, 3) corners.
        first: Place of their first coordinate among the numbers that kernels are given, x, y, z of each in turn.
        table: Place of the table among them.
        faces: (m, 3) triangles of the hull's corners, where they are known.

    Returns:
        Numbers: for each octant (1 for x > 0, 2 for y > 0, 4 for z > 0, added) the place of a corner; for each corner,
        and last for one after them, the place in the table where its neighbours begin; the places of the neighbours.
        Empty where there are `FEW` corners, or they lie in one plane: then all are compared.
    """
    if len(corners) <= FEW:
        return np.zeros(0)
    # A corner of no triangle would have no neighbours.
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
