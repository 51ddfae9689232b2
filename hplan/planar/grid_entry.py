"""Connects start and goal to nearby free grid nodes by collision-free motions."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import CertificationError
from hplan.optimization.repair import leave_contact
from hplan.planar.grid.grid import Occupancy
from hplan.planar.grids import grid_axes
from hplan.planning.problem import Problem

#: A configuration within this distance of a node counts as the node [steps].
_ON_NODE = 1e-6

#: Maximum number of nodes that a joint may move to either side.
_REACH = 2


class GridEntry(NamedTuple):
    """Grid nodes connected to the start or goal.

    Attributes:
        waypoints: (k, dof) configurations from the start or goal to the point where the nodes are connected; usually
            only one.
        nodes: The nodes, at least one, the nearest first.
    """

    waypoints: FloatArray
    nodes: list[IntArray]


def grid_entry(problem: Problem, space: Occupancy, which: Literal["start", "goal"], margin: float) -> GridEntry:
    """Find nearby grid nodes connected to the start or goal.

    In a tight place the nodes are those connected to the end of a path out of it.

    Args:
        margin: Clearance required of the connecting motions at every evaluated configuration [m].

    Raises:
        CertificationError: No node can be connected.
    """
    q = problem.start if which == "start" else problem.goal
    for waypoints in itertools.chain(
        [q[None]], leave_contact(q, problem.field, problem.lower[0], problem.upper[0], margin)
    ):
        nodes = list(joined_nodes(space, waypoints[-1], grid_axes(problem), problem.field, margin))
        if nodes:
            return GridEntry(waypoints, nodes)
    raise CertificationError(
        f"no motion from the {which} to a free grid node can be verified collision-free; a smaller step may help",
        which=which,
    )


def joined_nodes(
    occupancy: Occupancy, q: FloatArray, axes: IntArray, field: ClearanceField, margin: float
) -> Iterator[IntArray]:
    """Yield free nodes reached by a collision-free straight motion, the nearest first.

    Args:
        q: (dof,) configuration; joints without a grid axis keep their values.
        axes: (d,) the joint of each grid axis.
        margin: Clearance required at every evaluated configuration of the motion [m].

    Yields:
        (d,) node indices within `_REACH` steps; only the configuration's own node if it lies on a node.
    """
    grid = occupancy.grid
    position = grid.position(q[axes])
    nearest = grid.nearest_node(q[axes])
    if np.abs(position - nearest).max() <= _ON_NODE:
        if occupancy.is_free(nearest):
            yield nearest
        return
    low, high = np.floor(position).astype(int) - _REACH + 1, np.ceil(position).astype(int) + _REACH - 1
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
