"""Which corners of a convex hull are neighbours, as numbers for kernels: the farthest one without a look at all.

A corner that lies no less far in a direction than all of its neighbours is the farthest of all, so a walk from corner
to corner, always to the farthest neighbour, ends there (`hplan.collision.convex_distance.farthest_corner`). The table
also holds a corner to begin with for each of the eight octants that a direction can lie in.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray
from hplan.scene.solids import CUBE_CORNERS

#: With fewer corners all of them are compared.
FEW: Final = 16

#: Corners to begin with.
OCTANTS: Final = 8


def corner_table(corners: FloatArray, first: int, table: int) -> FloatArray:
    """The table of the corners of a hull.

    Args:
        corners: (n, 3) corners.
        first: Place of their first coordinate among the numbers that kernels are given, x, y, z of each in turn.

    Returns:
        Numbers: for each octant (1 for x > 0, 2 for y > 0, 4 for z > 0, added) the place of a corner; for each corner,
        and last for one after them, the place in the table where its neighbours begin; the places of the neighbours.
        Empty where there are `FEW` corners, or they lie in one plane: then all are compared.
    """
    if len(corners) <= FEW:
        return np.zeros(0)
    from scipy.spatial import ConvexHull, QhullError

    try:
        simplices = ConvexHull(corners).simplices
    except QhullError:
        return np.zeros(0)
    sides = np.concatenate([simplices[:, [a, b]] for a, b in ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1))])
    here, there = np.divmod(np.unique(sides[:, 0].astype(np.int64) * len(corners) + sides[:, 1]), len(corners))
    begin = np.searchsorted(here, np.arange(len(corners) + 1))
    signs = CUBE_CORNERS[np.lexsort(CUBE_CORNERS.T)]  # x changes fastest
    octants = ties.on_raster(corners @ signs.T).argmax(axis=0)
    lists = table + OCTANTS + len(begin)
    return np.concatenate([first + 3 * octants, lists + begin, first + 3 * there]).astype(np.float64)
