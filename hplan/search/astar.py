"""One A* for any dimension: it runs on the dense grid, on one slice of it and on the sparse union of slice paths.

They differ only in which bits are set.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray, WordArray
from hplan.base.kernels import inlined, kernel
from hplan.search.bits import lowest_bit, popcount
from hplan.search.heap import begin, pop, push
from hplan.search.lattice import Lattice
from hplan.search.node_set import NodeSet
from hplan.search.row_bounds import RowBounds


def astar(
    lattice: Lattice,
    nodes: NodeSet,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
    row_bounds: RowBounds | None = None,
) -> tuple[IntArray | None, float, int]:
    """Shortest path over the nodes of a set.

    Deterministic: ties in f go to the node nearer the goal, then to the one found first.

    Args:
        lattice: Geometry of the grid.
        nodes: The nodes that the path may use.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Bound the way to go by the shortest path on the free grid, the tightest bound that knows no
            obstacle; else by the straight line, as the paper does.
        row_bounds: Bound the way to go by these instead.

    Returns:
        The (m, d) path or None, its cost, and the number of expansions.
    """
    path, cost, expansions = _astar(
        nodes.words,
        nodes.ranks,
        nodes.size,
        lattice.shape[-1],
        lattice.row_of(start),
        int(start[-1]),
        lattice.row_of(goal),
        int(goal[-1]),
        lattice.row_offsets,
        lattice.move_costs,
        lattice.row_coordinates,
        lattice.step,
        octile,
        None if row_bounds is None else row_bounds.values,
        None if row_bounds is None else row_bounds.weights,
    )
    return (path if len(path) else None), cost, expansions


@inlined
def _bound(
    row_coordinates: IntArray,
    step: FloatArray,
    row: int,
    bit: int,
    goal_row: int,
    goal_bit: int,
    octile: bool,
) -> float:
    """Lower bound of the cost from a node to the goal.

    The octile bound in any dimension and with unequal steps: take the axes in the order of steps to go; all move
    together until the one with the fewest arrives, then the others. (The cost of a move is a submodular function of
    the axes it uses, and its Lovasz extension, this sum, is the cheapest way to cover the steps to go.)
    """
    axes = len(step)
    if not octile:
        delta = (bit - goal_bit) * step[axes - 1]
        square = delta * delta
        for axis in range(axes - 1):
            delta = (row_coordinates[row, axis] - row_coordinates[goal_row, axis]) * step[axis]
            square += delta * delta
        return math.sqrt(square)
    if axes == 2:
        first = abs(row_coordinates[row, 0] - row_coordinates[goal_row, 0])
        second = abs(bit - goal_bit)
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
                togo = abs(bit - goal_bit)
            else:
                togo = abs(row_coordinates[row, axis] - row_coordinates[goal_row, axis])
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
    free: WordArray,
    ranks: ShortArray,
    nodes: int,
    bit_count: int,
    start_row: int,
    start_bit: int,
    goal_row: int,
    goal_bit: int,
    row_offsets: IntArray,
    move_costs: FloatArray,
    row_coordinates: IntArray,
    step: FloatArray,
    octile: bool,
    bounds: Any,  # row bounds and their weights, or None: the branches that use them are then compiled away
    weights: Any,
) -> tuple[IntArray, float, int]:
    """A* over set bits; path as (m, d) node indices (empty without a path), cost, expansions."""
    words = free.shape[1]
    cost = np.full(nodes, np.inf)
    parent = np.full(nodes, -1, dtype=np.int32)
    place = np.empty(nodes, dtype=np.int64)  # row * bit_count + bit
    moves = len(row_offsets)
    keys, entries = np.empty(nodes), np.empty(nodes, dtype=np.int32)
    slot = np.full(nodes, -1, dtype=np.int32)

    one, top, three = np.uint64(1), np.uint64(63), np.uint64(7)
    start = ranks[start_row, start_bit >> 6] + popcount(
        free[start_row, start_bit >> 6] & ((one << np.uint64(start_bit & 63)) - one)
    )
    if bounds is None:
        whole = _bound(row_coordinates, step, start_row, start_bit, goal_row, goal_bit, octile)
    else:
        togo = abs(start_bit - goal_bit)
        whole = max(bounds[start_row, 0] + weights[0] * togo, bounds[start_row, 1] + weights[1] * togo)
    # f is compared in steps of 1e-10 of the whole, so that sums of the same moves in another order are a tie; in a
    # tie the fraction, ever smaller towards the goal, decides.
    share = 1.0 / max(whole, 1e-12)
    tolerance = 1e-12 * whole
    cost[start] = 0.0
    place[start] = start_row * bit_count + start_bit
    size = 0
    if whole < np.inf:
        size = begin(keys, entries, slot, start)
    expansions = 0
    found = -1
    while size > 0:
        node = pop(keys, entries, slot, size)
        size -= 1
        expansions += 1
        row, bit = place[node] // bit_count, place[node] % bit_count
        base = cost[node]
        if row == goal_row and bit == goal_bit:
            found = node
            break
        word, position = bit >> 6, np.uint64(bit & 63)
        for move in range(moves):
            # The bits beside, at, and after this one in the neighbouring row; nodes are numbered in order of bits.
            beside = row + row_offsets[move]
            bits = free[beside, word]
            other = ranks[beside, word] - 1
            if position == np.uint64(0):
                near = (bits << one) & three
                if word > 0:
                    before = free[beside, word - 1] >> top
                    near |= before
                    other -= np.int64(before)
            else:
                near = (bits >> (position - one)) & three
                other += popcount(bits & ((one << (position - one)) - one))
                if position == top and word + 1 < words:
                    near |= (free[beside, word + 1] & one) << np.uint64(2)
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
                place[other] = beside * bit_count + there
                if bounds is None:
                    ahead = _bound(row_coordinates, step, beside, there, goal_row, goal_bit, octile)
                else:
                    togo = abs(there - goal_bit)
                    ahead = max(bounds[beside, 0] + weights[0] * togo, bounds[beside, 1] + weights[1] * togo)
                key = math.floor((new + ahead) * share * 1e10 + 0.5) + min(0.9, 0.1 * ahead * share)
                size = push(keys, entries, slot, size, key, other)
    length = 0
    node = found
    while node >= 0:
        node = parent[node]
        length += 1
    axes = row_coordinates.shape[1]
    path = np.empty((length, axes + 1), dtype=np.int64)
    node = found
    for i in range(length - 1, -1, -1):
        for axis in range(axes):
            path[i, axis] = row_coordinates[place[node] // bit_count, axis]
        path[i, axes] = place[node] % bit_count
        node = parent[node]
    return path, cost[found] if found >= 0 else np.inf, expansions
