"""Clouds of balls of one radius.

Points in one voxel of a grid may be merged into one ball. Its radius grows by their maximum distance from its centre,
at most `MERGE_ERROR`, so the new balls contain the old ones. The points are stored in the order of a tree
(`hplan.geometry.cloud_tree`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen

#: Maximum growth of a ball by merging [m].
MERGE_ERROR: Final = 1e-3

#: Maximum number of points in a leaf of a cloud's tree.
LEAF: Final = 16


@dataclass(frozen=True, eq=False)
class Cloud(Record):
    """Many balls of one radius.

    Attributes:
        name: Name of the object that it belongs to.
        core: (n, 3) centres [m], in the order of the tree.
        rounding: Radius of every ball [m].
        tree: (nodes, 7) tree in preorder: first centre and one past the last; index of the next node that is not a
            descendant; centre and radius of a ball that bounds its centres [m].
        sigma: Standard deviation of its position [m].
        yields: Maximum deflection [m].
    """

    name: str
    core: FloatArray
    rounding: float
    tree: FloatArray
    sigma: float = 0.0
    yields: float = 0.0

    #: Each core point is a separate ball; `excess` is the maximum distance from the object [m].
    is_point_set: ClassVar[Literal[True]] = True
    excess: ClassVar[float] = 0.0
    #: It counts for all links, and is no part of a limb (`hplan.scene.obstacle_kind.Convex`).
    meets: ClassVar[Literal["all"]] = "all"
    contact_limit: ClassVar[None] = None
    is_limb: ClassVar[Literal[False]] = False

    @classmethod
    def from_points(cls, name: str, points: FloatArray, radius: float, sigma: float = 0.0) -> Cloud:
        """Return balls about (n, 3) points, n > 0, possibly merged.

        Points are merged if that reduces their number considerably.
        """
        # The diagonal of a voxel with this edge is twice the maximum error.
        core, growth = merge_points(np.array(points, dtype=np.float64, order="C"), 2.0 * MERGE_ERROR / math.sqrt(3.0))
        return cls.from_all_points(name, core, radius + growth, sigma)

    @classmethod
    def from_all_points(cls, name: str, points: FloatArray, radius: float, sigma: float = 0.0) -> Cloud:
        """Return balls about all (n, 3) points, n > 0."""
        from hplan.geometry.cloud_tree import tree_of  # compiled: numba is loaded only for clouds

        core, tree = tree_of(np.ascontiguousarray(points, dtype=np.float64), LEAF)
        return cls(name, frozen(core), radius, frozen(tree), sigma)


def merge_points(points: FloatArray, edge: float) -> tuple[FloatArray, float]:
    """Merge the points of each voxel if that reduces their number considerably.

    The merged point is the centre of their bounding box.

    Args:
        points: (n, 3) points [m].
        edge: Edge length of a voxel [m].

    Returns:
        (m, 3) merged points, and the maximum distance of an old point from its merged one [m].
    """
    cells = np.floor(points / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    sizes = tuple((cells.max(axis=0) + 1).tolist())
    if math.prod(sizes) >= 2**63:  # the points are kilometres apart
        return points, 0.0
    keys = np.ravel_multi_index(tuple(cells.T), sizes)
    order = np.argsort(keys)
    firsts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    # Points are merged if at most this fraction of the balls remains.
    worth_merging = 0.7
    if len(firsts) > worth_merging * len(points):
        return points, 0.0
    points = np.take(points, order, axis=0)
    middles: FloatArray = 0.5 * (np.minimum.reduceat(points, firsts) + np.maximum.reduceat(points, firsts))
    away = points - np.repeat(middles, np.diff(firsts, append=len(points)), axis=0)
    return middles, float(np.linalg.norm(away, axis=1).max())
