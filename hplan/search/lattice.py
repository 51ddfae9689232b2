"""The grid as the searches see it: bit rows with a border, moves to all neighbours, one A* for any dimension.

A node is a row (all axes but the last) and a bit (the last axis). Rows have a border of occupied rows around them,
so that a neighbouring row is always one addition away. The same A* runs on the dense grid, on one slice of it and on
the sparse union of slice paths: they differ only in which bits are set.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numba as nb
import numpy as np

from hplan.arrays import FloatArray, IntArray, WordArray, readonly
from hplan.grid import words_for
from hplan.search.bits import popcount


@dataclass(frozen=True, eq=False)
class Lattice:
    """A grid's geometry for the kernels: bordered rows and the moves between them.

    Attributes:
        shape: Nodes along each axis.
        step: (d,) weight of one step along each axis.
        padded: Rows along each axis but the last, with the border.
        row_offsets: (moves,) distance to each neighbouring row, the row itself among them.
        move_costs: (moves, 3) cost of the move to that row and to bit -1, 0, +1.
        row_coordinates: (padded rows, d - 1) node index of each row along each axis but the last.
    """

    shape: tuple[int, ...]
    step: FloatArray
    padded: tuple[int, ...]
    row_offsets: IntArray
    move_costs: FloatArray
    row_coordinates: IntArray

    @classmethod
    def of(cls, shape: tuple[int, ...], step: FloatArray) -> Lattice:
        """The lattice of a grid with full connectivity (8 neighbours in 2-D, 26 in 3-D)."""
        padded = tuple(count + 2 for count in shape[:-1])
        strides = np.array([math.prod(padded[i + 1 :]) for i in range(len(padded))], dtype=np.int64)
        moves = np.array(list(itertools.product((-1, 0, 1), repeat=len(padded))), dtype=np.int64)
        moves = moves.reshape(-1, len(padded))
        row_squares = ((moves * step[:-1]) ** 2).sum(axis=1)
        bit_squares = (np.array([-1.0, 0.0, 1.0]) * step[-1]) ** 2
        indices = np.indices(padded).reshape(len(padded), math.prod(padded)).T
        return cls(
            shape=shape,
            step=step,
            padded=padded,
            row_offsets=readonly(moves @ strides, np.int64),
            move_costs=readonly(np.sqrt(row_squares[:, None] + bit_squares)),
            row_coordinates=readonly(indices - 1, np.int64),
        )

    @property
    def rows(self) -> int:
        """Number of rows with the border."""
        return math.prod(self.padded)

    @property
    def words(self) -> int:
        """Words in a row."""
        return words_for(self.shape[-1])

    def row_of(self, index: IntArray) -> int:
        """Bordered row of a node."""
        row = 0
        for place, count in zip(index[:-1], self.padded, strict=True):
            row = row * count + int(place) + 1
        return row

    def bordered(self, words: WordArray) -> WordArray:
        """Rows without border, (rows, words), put inside the border."""
        result = np.zeros((*self.padded, words.shape[1]), dtype=np.uint64)
        inside = tuple(slice(1, -1) for _ in self.padded)
        result[inside] = words.reshape(*self.shape[:-1], words.shape[1])
        return result.reshape(-1, words.shape[1])

    def indices(self, rows: IntArray, bits: IntArray) -> IntArray:
        """(m, d) node indices of bordered rows and bits."""
        return np.column_stack([self.row_coordinates[rows], bits])


def astar(
    lattice: Lattice,
    free: WordArray,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
) -> tuple[IntArray | None, float, int]:
    """Shortest path over the set bits of `free`.

    Deterministic: ties in f go to the node nearer the goal, then to the one found first.

    Args:
        lattice: Geometry of the grid.
        free: (rows, words) bits with border.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Bound the way to go by the shortest path on the free grid, the tightest bound that knows no
            obstacle; else by the straight line, as the paper does.

    Returns:
        The (m, d) path or None, its cost, and the number of expansions.
    """
    rows, bits, cost, expansions = _astar(
        free,
        _ranks(free),
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
    )
    if len(rows) == 0:
        return None, math.inf, int(expansions)
    return lattice.indices(rows, bits), float(cost), int(expansions)


@nb.njit(cache=True)
def _ranks(free: WordArray) -> IntArray:
    """Set bits before each word: the place of a node's word in arrays that hold set bits only."""
    ranks = np.empty(free.shape, dtype=np.int32)
    total = 0
    for row in range(free.shape[0]):
        for word in range(free.shape[1]):
            ranks[row, word] = total
            total += popcount(free[row, word])
    return ranks


@nb.njit(cache=True, inline="always")
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
        return both * diagonal + (first - both) * step[0] + (second - both) * step[1]
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


@nb.njit(cache=True)
def _astar(
    free: WordArray,
    ranks: IntArray,
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
) -> tuple[IntArray, IntArray, float, int]:
    """A* over set bits; path as rows and bits (empty without a path), cost, expansions."""
    last = free.shape[0] - 1
    nodes = ranks[last, free.shape[1] - 1] + popcount(free[last, free.shape[1] - 1])
    cost = np.full(nodes, np.inf)
    parent = np.full(nodes, -1, dtype=np.int32)
    place = np.empty(nodes, dtype=np.int64)  # row * bit_count + bit
    moves = len(row_offsets)

    # Open list: a binary heap of (key, node); `slot` says where in it a node stands (-1 new, -2 expanded).
    heap_key, heap_node = np.empty(nodes), np.empty(nodes, dtype=np.int32)
    slot = np.full(nodes, -1, dtype=np.int32)

    one = np.uint64(1)
    start = ranks[start_row, start_bit >> 6] + popcount(
        free[start_row, start_bit >> 6] & ((one << np.uint64(start_bit & 63)) - one)
    )
    whole = _bound(row_coordinates, step, start_row, start_bit, goal_row, goal_bit, octile)
    # f is compared in steps of 1e-10 of the whole, so that sums of the same moves in another order are a tie; in a
    # tie the fraction, ever smaller towards the goal, decides.
    scale = 1e10 / max(whole, 1e-12)
    tolerance = 1e-12 * whole
    cost[start] = 0.0
    place[start] = start_row * bit_count + start_bit
    heap_key[0], heap_node[0] = 0.0, start
    slot[start] = 0
    size = 1
    expansions = 0
    found = -1
    while size > 0:
        node = heap_node[0]
        # Take the last entry down from the top.
        size -= 1
        key, carried = heap_key[size], heap_node[size]
        hole = 0
        child = 1
        while child < size:
            if child + 1 < size and heap_key[child + 1] < heap_key[child]:
                child += 1
            if heap_key[child] >= key:
                break
            heap_key[hole], heap_node[hole] = heap_key[child], heap_node[child]
            slot[heap_node[hole]] = hole
            hole = child
            child = 2 * hole + 1
        heap_key[hole], heap_node[hole] = key, carried
        slot[carried] = hole
        slot[node] = -2
        expansions += 1
        row, bit = place[node] // bit_count, place[node] % bit_count
        base = cost[node]
        if row == goal_row and bit == goal_bit:
            found = node
            break
        for move in range(moves):
            beside = row + row_offsets[move]
            for turn in range(3):
                there = bit + turn - 1
                if there < 0 or there >= bit_count:
                    continue
                word = free[beside, there >> 6]
                mask = one << np.uint64(there & 63)
                if word & mask == np.uint64(0):
                    continue
                other = ranks[beside, there >> 6] + popcount(word & (mask - one))
                new = base + move_costs[move, turn]
                if new >= cost[other] - tolerance:  # closed nodes are never improved: both bounds are consistent
                    continue
                cost[other] = new
                parent[other] = node
                place[other] = beside * bit_count + there
                ahead = _bound(row_coordinates, step, beside, there, goal_row, goal_bit, octile)
                key = math.floor((new + ahead) * scale + 0.5) + min(0.9, 0.1 * ahead / max(whole, 1e-12))
                hole = slot[other]
                if hole < 0:
                    hole = size
                    size += 1
                while hole > 0:
                    above = (hole - 1) >> 1
                    if heap_key[above] <= key:
                        break
                    heap_key[hole], heap_node[hole] = heap_key[above], heap_node[above]
                    slot[heap_node[hole]] = hole
                    hole = above
                heap_key[hole], heap_node[hole] = key, other
                slot[other] = hole
    if found < 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.inf, expansions
    length = 1
    node = found
    while parent[node] >= 0:
        node = parent[node]
        length += 1
    rows, bits = np.empty(length, dtype=np.int64), np.empty(length, dtype=np.int64)
    node = found
    for i in range(length - 1, -1, -1):
        rows[i], bits[i] = place[node] // bit_count, place[node] % bit_count
        node = parent[node]
    return rows, bits, cost[found], expansions
