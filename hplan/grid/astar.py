r"""One A* for any dimension: it runs on the dense grid, on one slice of it and on the sparse union of slice paths.

They differ only in which bits are set. Three lower bounds guide it: the straight line, the shortest path on the free
grid (octile), and distances that know the obstacles, on the projection along the last axis (`row_bounds`).
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import truth
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import inlined, kernel
from hplan.grid.bits import lowest_bit, popcount
from hplan.grid.grid import Occupancy, checked_node
from hplan.grid.heap import begin, pop, priority, push
from hplan.grid.lattice import Lattice, LatticeArrays, Node, NodeSet
from hplan.grid.result import Expansions, SearchResult, StageTimes

#: The deadline is checked after one more than so many expansions.
_OFTEN = 255


def dense_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = False) -> SearchResult:
    """The baseline: shortest path over all free nodes, each joined to all its neighbours (26 in 3-D).

    Args:
        occupancy: Which nodes are free.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Use the octile bound instead of the paper's straight line; same cost, fewer expansions.

    Raises:
        InputError: Start or goal is no node of the grid, or not free.
        OptionError: `octile` is neither True nor False.
    """
    begun = time.perf_counter()
    truth("octile", octile)
    source, target = checked_node(occupancy, start, "start"), checked_node(occupancy, goal, "goal")
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    nodes = NodeSet.of(lattice.bordered(occupancy.free_words))
    path, cost, expansions = astar(lattice, nodes, source, target, octile=octile)
    return SearchResult(
        path=None if path is None else frozen(path),
        cost=cost,
        expansions=Expansions(fallback=expansions),
        times=StageTimes(fallback=time.perf_counter() - begun),
    )


class RowBounds(NamedTuple):
    """Lower bounds of the cost to a goal: `max over k of values[row, k] + weights[k] * |bit - goal bit|`.

    Attributes:
        values: (rows, 2) distance to the goal's row, for rows with nodes; inf where it is not connected.
        weights: (2,) weight of one step along the last axis.
        settled: Rows taken from the open list to find them.
    """

    values: FloatArray
    weights: FloatArray
    settled: int


def row_bounds(lattice: Lattice, nodes: NodeSet, goal_row: int) -> RowBounds:
    r"""Lower bounds that know the obstacles: distances on the projection along the last axis.

    Forget on which bit a node stands: a row is free if any of its bits is set. A path then projects to a path over
    rows. For any weight :math:`0 \le \lambda \le s` of one step along the last axis (:math:`s` its spacing), let a move
    of projected length :math:`c` cost :math:`c_\lambda = \min(c, \sqrt{c^2 + s^2} - \lambda)`, and let
    :math:`d_\lambda` be the distance to the goal's row in these costs. No move lowers
    :math:`d_\lambda + \lambda |\Delta|` (:math:`\Delta` steps to go along the last axis) by more than its own cost, so
    that sum is an admissible and consistent bound. It is taken for the two weights that are exact when every
    step along the last axis is made together with the longest, or the shortest, move between rows; A* uses the larger.

    Args:
        nodes: The nodes, the goal among them.
        goal_row: Bordered row of the goal.
    """
    bounds = _row_bounds(nodes.rows, lattice.rows, lattice.arrays, goal_row)
    check_deadline()
    return bounds


@kernel
def _row_bounds(used: IntArray, rows: int, lattice: LatticeArrays, goal_row: int) -> RowBounds:
    """Dijkstra's algorithm from the goal's row over the rows used, once for each weight."""
    row_offsets, move_costs, step = lattice.row_offsets, lattice.move_costs, lattice.step[-1]
    values = np.empty((rows, 2))
    keys, entries = np.empty(len(used)), np.empty(len(used), dtype=np.int32)
    slot = np.full(rows, -2, dtype=np.int32)
    centre = len(row_offsets) // 2
    shortest = np.inf
    for move in range(len(row_offsets)):
        if move != centre:
            shortest = min(shortest, move_costs[move, 1])
    longest = move_costs[0, 1]
    costs, weights = np.empty(len(row_offsets)), np.empty(2)
    settled = 0
    for k in range(2):
        aside = longest if k == 0 else shortest
        weights[k] = math.hypot(aside, step) - aside
        for move in range(len(row_offsets)):
            costs[move] = min(move_costs[move, 1], move_costs[move, 2] - weights[k])
        for row in used:
            slot[row], values[row, k] = -1, np.inf
        values[goal_row, k] = 0.0
        size = begin(keys, entries, slot, goal_row)
        while size > 0:
            row = pop(keys, entries, slot, size)
            size -= 1
            settled += 1
            if settled & _OFTEN == 0 and is_up(lattice.until):
                break
            base = values[row, k]
            for move in range(len(row_offsets)):
                neighbour = row + row_offsets[move]
                new = base + costs[move]
                if slot[neighbour] != -2 and new < values[neighbour, k]:
                    values[neighbour, k] = new
                    size = push(keys, entries, slot, size, new, neighbour)
    return RowBounds(values, weights, settled)


def astar(
    lattice: Lattice,
    nodes: NodeSet,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
    bounds: RowBounds | None = None,
) -> tuple[IntArray | None, float, int]:
    """Shortest path over the nodes of a set.

    Deterministic: ties in f go to the node nearer the goal, then to the one found first.

    Args:
        start: (d,) node index.
        goal: (d,) node index.
        octile: Bound the cost to go by the shortest path on the free grid, the tightest bound that knows no
            obstacle; else by the straight line, as the paper does.
        bounds: Bound the cost to go by these instead.

    Returns:
        The (m, d) path or None, its cost, and the number of expansions.
    """
    path, cost, expansions = _astar(
        nodes, lattice.shape[-1], lattice.node(start), lattice.node(goal), lattice.arrays, octile, bounds
    )
    check_deadline()
    return (path if len(path) else None), cost, expansions


@inlined
def bound(row_coordinates: IntArray, step: FloatArray, row: int, bit: int, goal: Node, octile: bool) -> float:
    """Lower bound of the cost from a node to the goal that knows no obstacle.

    The octile bound in any dimension and with unequal steps: take the axes in the order of steps to go; all move
    together until the one with the fewest arrives, then the others. (The cost of a move is a submodular function of
    the axes it uses, and its Lovasz extension, this sum, is the least cost that covers the steps to go.)
    """
    axes = len(step)
    if not octile:
        delta = (bit - goal.bit) * step[axes - 1]
        square = delta * delta
        for axis in range(axes - 1):
            delta = (row_coordinates[row, axis] - row_coordinates[goal.row, axis]) * step[axis]
            square += delta * delta
        return math.sqrt(square)
    if axes == 2:
        first = abs(row_coordinates[row, 0] - row_coordinates[goal.row, 0])
        second = abs(bit - goal.bit)
        both = min(first, second)
        diagonal = math.sqrt(step[0] * step[0] + step[1] * step[1])
        flat: float = both * diagonal + (first - both) * step[0] + (second - both) * step[1]
        return flat
    total = 0.0
    done = 0
    while True:
        # The next axis to arrive, and the length of the move that all unfinished axes make together.
        following = -1
        square = 0.0
        for axis in range(axes):
            if axis == axes - 1:
                togo = abs(bit - goal.bit)
            else:
                togo = abs(row_coordinates[row, axis] - row_coordinates[goal.row, axis])
            if togo > done:
                square += step[axis] * step[axis]
                if following < 0 or togo < following:
                    following = togo
        if following < 0:
            return total
        total += (following - done) * math.sqrt(square)
        done = following


@inlined
def _ahead(
    row_coordinates: IntArray, step: FloatArray, row: int, bit: int, goal: Node, octile: bool, bounds: Any
) -> float:
    """Lower bound of the cost from a node to the goal: the row bounds where there are any, else `bound`."""
    if bounds is None:
        return bound(row_coordinates, step, row, bit, goal, octile)
    togo = abs(bit - goal.bit)
    known: float = max(
        bounds.values[row, 0] + bounds.weights[0] * togo, bounds.values[row, 1] + bounds.weights[1] * togo
    )
    return known


@kernel
def _astar(
    nodes: NodeSet,
    bit_count: int,
    start: Node,
    goal: Node,
    lattice: LatticeArrays,
    octile: bool,
    bounds: Any,  # RowBounds or None: the branches that use them are then compiled away
) -> tuple[IntArray, float, int]:
    """A* over set bits; path as (m, d) node indices (empty without a path), cost, expansions."""
    words, ranks = nodes.words, nodes.ranks
    row_offsets, move_costs, row_coordinates, step, until = lattice
    cost = np.full(nodes.size, np.inf)
    parent = np.full(nodes.size, -1, dtype=np.int32)
    place = np.empty(nodes.size, dtype=np.int64)  # row * bit_count + bit
    keys, entries = np.empty(nodes.size), np.empty(nodes.size, dtype=np.int32)
    slot = np.full(nodes.size, -1, dtype=np.int32)
    whole = _ahead(row_coordinates, step, start.row, start.bit, goal, octile, bounds)
    scale, tolerance = 1.0 / max(whole, 1e-12), 1e-12 * whole
    one, top, three = np.uint64(1), np.uint64(63), np.uint64(7)
    before = words[start.row, start.bit >> 6] & ((one << np.uint64(start.bit & 63)) - one)
    first = ranks[start.row, start.bit >> 6] + popcount(before)
    cost[first] = 0.0
    place[first] = start.row * bit_count + start.bit
    size = 0
    if whole < np.inf:
        size = begin(keys, entries, slot, first)
    expansions = 0
    found = -1
    while size > 0:
        node = pop(keys, entries, slot, size)
        size -= 1
        expansions += 1
        row, bit = place[node] // bit_count, place[node] % bit_count
        base = cost[node]
        if row == goal.row and bit == goal.bit:
            found = node
            break
        if expansions & _OFTEN == 0 and is_up(until):
            break
        word, position = bit >> 6, np.uint64(bit & 63)
        for move in range(len(row_offsets)):
            neighbour = row + row_offsets[move]
            # The bits before, at, and after this one in the neighbouring row; nodes are numbered in order of bits.
            bits, other = words[neighbour, word], ranks[neighbour, word] - 1
            if position == np.uint64(0):
                near = (bits << one) & three
                if word > 0:
                    before = words[neighbour, word - 1] >> top
                    near |= before
                    other -= np.int64(before)
            else:
                near = (bits >> (position - one)) & three
                other += popcount(bits & ((one << (position - one)) - one))
                if position == top and word + 1 < words.shape[1]:
                    near |= (words[neighbour, word + 1] & one) << np.uint64(2)
            while near != np.uint64(0):
                turn = lowest_bit(near)
                near &= near - one
                other += 1
                new = base + move_costs[move, turn]
                if new >= cost[other] - tolerance:  # closed nodes are never improved: all bounds are consistent
                    continue
                there = bit + turn - 1
                cost[other] = new
                parent[other] = node
                place[other] = neighbour * bit_count + there
                ahead = _ahead(row_coordinates, step, neighbour, there, goal, octile, bounds)
                size = push(keys, entries, slot, size, priority(new, ahead, scale), other)
    length, node = 0, found
    while node >= 0:
        length, node = length + 1, parent[node]
    axes, node = len(step) - 1, found
    path = np.empty((length, axes + 1), dtype=np.int64)
    for i in range(length - 1, -1, -1):
        for axis in range(axes):
            path[i, axis] = row_coordinates[place[node] // bit_count, axis]
        path[i, axes], node = place[node] % bit_count, parent[node]
    return path, cost[found] if found >= 0 else np.inf, expansions
