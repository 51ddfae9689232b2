"""Start and goal joined to the grid: the free nodes nearby that a straight motion, shown clear, leads to."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.clearance_field import ClearanceField
from hplan.search.grid import Occupancy

#: A configuration this near to a node stands on it [steps].
ON_NODE = 1e-6

#: How many nodes away a joint may be led, to either side.
REACH = 2


def joined_nodes(
    occupancy: Occupancy, q: FloatArray, axes: IntArray, field: ClearanceField, margin: float
) -> Iterator[IntArray]:
    """The free nodes that a straight motion shown clear leads to, the nearest first.

    Args:
        occupancy: Which nodes are free.
        q: (dof,) configuration; joints that are no axis of the grid keep their values.
        axes: (d,) the joint behind each axis of the grid.
        field: Arm and obstacles.
        margin: Clearance asked for wherever the motion is evaluated [m].

    Yields:
        (d,) node indices within `REACH` steps; only the configuration's own node where it stands on one.
    """
    grid = occupancy.grid
    position = grid.position(q[axes])
    nearest = grid.nearest(q[axes])
    if np.abs(position - nearest).max() <= ON_NODE:
        if occupancy.is_free(nearest):
            yield nearest
        return
    low, high = np.floor(position).astype(int) - REACH + 1, np.ceil(position).astype(int) + REACH - 1
    ranges = [range(max(0, a), min(count - 1, b) + 1) for a, b, count in zip(low, high, grid.shape, strict=True)]
    nodes = np.array(list(itertools.product(*ranges)), dtype=np.int64)
    distances = np.sqrt((((nodes - position) * grid.step) ** 2).sum(axis=1))
    for node in nodes[ties.argsort(distances)]:
        if not occupancy.is_free(node):
            continue
        there = q.copy()
        there[axes] = grid.coordinates(node)
        if field.is_clear(np.stack([q, there]), margin):
            yield np.asarray(node)
