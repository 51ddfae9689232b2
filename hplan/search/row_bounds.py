r"""Lower bounds that know the obstacles: distances on the projection along the last axis.

Forget on which bit a node stands and ask only whether its row has any set bit. A path then projects to a path over
rows. For any weight :math:`0 \le \lambda \le s` of one step along the last axis (:math:`s` its spacing), let a move
of projected length :math:`c` cost :math:`c_\lambda = \min(c, \sqrt{c^2 + s^2} - \lambda)`, and let
:math:`d_\lambda` be the distance to the goal's row in these costs. No move lowers
:math:`d_\lambda + \lambda |\Delta|` (:math:`\Delta` steps to go along the last axis) by more than its own cost, so
that sum is an admissible and consistent bound. It is taken for the two weights that are exact when every
step along the last axis is made together with the longest, or the shortest, move between rows; A* uses the larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.kernels import kernel
from hplan.search.heap import begin, pop, push
from hplan.search.lattice import Lattice
from hplan.search.node_set import NodeSet


@dataclass(frozen=True, eq=False)
class RowBounds:
    """Bounds of the way to a goal: `max over k of values[row, k] + weights[k] * |bit - goal bit|`.

    Attributes:
        values: (rows, 2) distance to the goal's row, for rows with nodes; inf where it is not connected.
        weights: (2,) weight of one step along the last axis.
        settled: Rows taken from the open list to find them.
    """

    values: FloatArray
    weights: FloatArray
    settled: int


def row_bounds(lattice: Lattice, nodes: NodeSet, goal_row: int) -> RowBounds:
    """The bounds for the nodes of a set.

    Args:
        lattice: Geometry of the grid.
        nodes: The nodes, the goal among them.
        goal_row: Bordered row of the goal.
    """
    values, weights, settled = _row_bounds(
        nodes.rows, lattice.rows, lattice.row_offsets, lattice.move_costs, lattice.step[-1], goal_row
    )
    return RowBounds(frozen(values), frozen(weights), settled)


@kernel
def _row_bounds(
    used: IntArray, rows: int, row_offsets: IntArray, move_costs: FloatArray, step: float, goal_row: int
) -> tuple[FloatArray, FloatArray, int]:
    """Dijkstra's algorithm from the goal's row over the rows used, once for each weight."""
    values = np.empty((rows, 2))
    keys, entries = np.empty(len(used)), np.empty(len(used), dtype=np.int32)
    slot = np.full(rows, -2, dtype=np.int32)
    centre = len(row_offsets) // 2
    shortest = np.inf
    for move in range(len(row_offsets)):
        if move != centre:
            shortest = min(shortest, move_costs[move, 1])
    longest = move_costs[0, 1]
    weights = np.array([np.hypot(longest, step) - longest, np.hypot(shortest, step) - shortest])
    settled = 0
    for k in range(2):
        for row in used:
            slot[row], values[row, k] = -1, np.inf
        costs = np.minimum(move_costs[:, 1], move_costs[:, 2] - weights[k])
        values[goal_row, k] = 0.0
        size = begin(keys, entries, slot, goal_row)
        while size > 0:
            row = pop(keys, entries, slot, size)
            size -= 1
            settled += 1
            base = values[row, k]
            for move in range(len(row_offsets)):
                beside = row + row_offsets[move]
                new = base + costs[move]
                if slot[beside] != -2 and new < values[beside, k]:
                    values[beside, k] = new
                    size = push(keys, entries, slot, size, new, beside)
    return values, weights, settled
