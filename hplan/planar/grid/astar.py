r"""A* in any dimension.

On the dense grid, one slice, or the sparse union of slice paths.

The three differ only in the bits that are set. Two lower bounds guide the search: the straight line, and the shortest
path on the free grid (octile).
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import truth
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import inline, kernel
from hplan.planar.grid.bits import lowest_bit, popcount
from hplan.planar.grid.grid import Occupancy, checked_node
from hplan.planar.grid.heap import begin, pop, priority, push
from hplan.planar.grid.lattice import Lattice, LatticeArrays, Node, NodeSet
from hplan.planar.grid.result import Expansions, SearchResult, StageTimes

#: Bit mask of the expansion counter; the deadline is checked every `_OFTEN + 1` expansions.
_OFTEN = 255


def dense_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = False) -> SearchResult:
    """Baseline: shortest path over all free nodes.

    With full connectivity: 26 neighbours in 3-D.

    Args:
        occupancy: Free nodes of the grid.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Use the octile bound instead of the paper's straight line; same cost, fewer expansions.

    Raises:
        InputError: Start or goal is not a node of the grid, or not free.
        OptionError: `octile` is neither True nor False.
    """
    begun = time.perf_counter()
    truth("octile", octile)
    source, target = checked_node(occupancy, start, "start"), checked_node(occupancy, goal, "goal")
    lattice = Lattice.build(occupancy.grid.shape, occupancy.grid.step)
    nodes = NodeSet.from_words(lattice.add_border(occupancy.free_words))
    path, cost, expansions = astar(lattice, nodes, source, target, octile=octile)
    return SearchResult(
        path=None if path is None else frozen(path),
        cost=cost,
        expansions=Expansions(fallback=expansions),
        times=StageTimes(fallback=time.perf_counter() - begun),
    )


def astar(
    lattice: Lattice,
    nodes: NodeSet,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
) -> tuple[IntArray | None, float, int]:
    """Shortest path over the nodes of a set.

    Deterministic: ties in f go to the node nearer the goal, then to the node found first.

    Args:
        start: (d,) node index.
        goal: (d,) node index.
        octile: True to bound the cost to go by the shortest path on the free grid, the tightest bound that ignores
            obstacles; False for the straight line, as in the paper.

    Returns:
        The (m, d) path or None, its cost, and the number of expansions.
    """
    path, cost, expansions = _astar(
        nodes, lattice.shape[-1], lattice.node(start), lattice.node(goal), lattice.arrays, octile
    )
    check_deadline()
    return (path if len(path) else None), cost, expansions


@inline
def bound(row_coordinates: IntArray, step: FloatArray, row: int, bit: int, goal: Node, octile: bool) -> float:
    """Obstacle-free lower bound of the cost from a node to the goal.

    The octile bound in any dimension and with unequal steps: sort the axes by their steps to go; all move together
    until the axis with the fewest steps arrives, then the others. (The cost of a move is a submodular function of its
    axes, and the Lovasz extension of that function, this sum, is the minimum cost that covers the steps to go.)
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
        # The next axis to arrive, and the length of the joint move of all unfinished axes.
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


@kernel
def _astar(
    nodes: NodeSet,
    bit_count: int,
    start: Node,
    goal: Node,
    lattice: LatticeArrays,
    octile: bool,
) -> tuple[IntArray, float, int]:
    """A* over set bits; returns path, cost and expansions.

    The path is an array of (m, d) node indices, empty if no path exists.
    """
    words, ranks = nodes.words, nodes.ranks
    row_offsets, move_costs, row_coordinates, step, until = lattice
    cost = np.full(nodes.size, np.inf)
    parent = np.full(nodes.size, -1, dtype=np.int32)
    place = np.empty(nodes.size, dtype=np.int64)  # row * bit_count + bit
    keys, entries = np.empty(nodes.size), np.empty(nodes.size, dtype=np.int32)
    slot = np.full(nodes.size, -1, dtype=np.int32)
    whole = bound(row_coordinates, step, start.row, start.bit, goal, octile)
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
            # Bits before, at, and after this bit in the neighbouring row; nodes are numbered in order of bits.
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
                ahead = bound(row_coordinates, step, neighbour, there, goal, octile)
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
