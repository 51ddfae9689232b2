"""First level: a search of its own on every slice of the last axis, all in one pass.

A slice has a path exactly when flooding it from the start's row reaches the goal's row; only then is it searched, by
A* over its rows. A search leaves better bounds of the way to the goal for the next one: what was expanded at the cost g
is no nearer to it than the length of the path less g (adaptive A*; Koenig and Likhachev, AAMAS 2006). Rows that are
free in the next slice and were not in this one lower them again, from row to row as far as they do (generalized
adaptive A*; Sun, Koenig and Yeoh, AAMAS 2008). So neighbouring slices, which differ by little, cost little.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray, WordArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import kernel
from hplan.grid.astar import bound
from hplan.grid.flood import bits_of, flood_slices
from hplan.grid.heap import NEW, begin, pop, priority, push
from hplan.grid.lattice import Lattice, LatticeArrays, Node
from hplan.grid.result import SlicePaths


def search_slices(
    lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, slices: range, *, octile: bool = True
) -> SlicePaths:
    """Search each of `slices` from the start's row to the goal's.

    Args:
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Neighbouring slices, ascending.
        octile: Bound by the shortest path on the free grid, and by what the searches before have shown; else by the
            straight line alone, as the paper does.
    """
    start_row, goal_row = lattice.row_of(start), lattice.row_of(goal)
    reached, flooded = flood_slices(lattice, free, start_row, lattice.mask(slices), goal_row)
    wanted = np.flatnonzero(bits_of(reached[goal_row] & lattice.mask(slices)))
    # From where there is none: paths are longest there, and what is shown of long ones lasts.
    if len(wanted) and wanted[0] == slices[0] and wanted[-1] < slices[-1]:
        wanted = wanted[::-1].copy()
    rows, begins, expansions = _search(free, wanted, start_row, goal_row, lattice.arrays, octile)
    check_deadline()
    lengths = np.zeros(len(slices), dtype=np.int64)
    lengths[wanted - slices[0]] = np.diff(begins)
    if len(wanted) > 1 and wanted[0] > wanted[-1]:
        rows = np.concatenate([rows[begins[k] : begins[k + 1]] for k in range(len(wanted) - 1, -1, -1)])
    return SlicePaths(
        lattice, slices[0], frozen(rows), frozen(np.concatenate([[0], np.cumsum(lengths)])), expansions, flooded
    )


class _Open(NamedTuple):
    """The open list of a search, and room for as many rows."""

    slot: ShortArray
    keys: FloatArray
    entries: ShortArray
    rows: ShortArray


@kernel
def _search(
    free: WordArray, wanted: IntArray, start: int, goal: int, lattice: LatticeArrays, octile: bool
) -> tuple[IntArray, IntArray, int]:
    """Rows of the paths of slices one after the other, where each begins, and the number of expansions."""
    rows, offsets, costs = free.shape[0], lattice.row_offsets, lattice.move_costs
    cost, parent, seen = np.empty(rows), np.empty(rows, dtype=np.int32), np.full(rows, -1, dtype=np.int32)
    slot, entries, closed = (
        np.empty(rows, dtype=np.int32),
        np.empty(rows, dtype=np.int32),
        np.empty(rows, dtype=np.int32),
    )
    waiting = _Open(slot, np.empty(rows), entries, closed)
    ahead, one = np.empty(rows), np.uint64(1)
    # A slice is a grid of its own, the axis before the last along its bits.
    places, flat = lattice.row_coordinates, lattice.step[:-1]
    target = Node(goal, places[goal, len(flat) - 1])
    for row in range(rows):
        ahead[row] = bound(places, flat, row, places[row, len(flat) - 1], target, octile)
    path_rows, begins, expansions = np.empty(4096, dtype=np.int64), np.zeros(len(wanted) + 1, dtype=np.int64), 0
    for k in range(len(wanted)):
        number, begins[k + 1] = wanted[k], begins[k]
        if is_up(lattice.until):
            break
        if octile and k > 0:
            _lower(free, number, wanted[k - 1], lattice, ahead, waiting)
        word, shift = number >> 6, np.uint64(number & 63)
        scale, tolerance = 1.0 / max(ahead[start], 1e-12), 1e-12 * ahead[start]
        seen[start], cost[start], parent[start], slot[start] = number, 0.0, -1, NEW
        size, done = begin(waiting.keys, entries, slot, start), 0
        while size > 0:
            row = pop(waiting.keys, entries, slot, size)
            size -= 1
            expansions += 1
            if row == goal:
                break
            closed[done], done = row, done + 1
            for move in range(len(offsets)):
                other = row + offsets[move]
                if not (free[other, word] >> shift) & one:
                    continue
                if seen[other] != number:
                    seen[other], cost[other], slot[other] = number, np.inf, NEW
                new = cost[row] + costs[move, 1]
                if new >= cost[other] - tolerance:
                    continue
                cost[other], parent[other] = new, row
                size = push(waiting.keys, entries, slot, size, priority(new, ahead[other], scale), other)
        for i in range(done if octile else 0):
            ahead[closed[i]] = max(ahead[closed[i]], cost[goal] - cost[closed[i]])
        length, row = 0, goal
        while row >= 0:
            length, row = length + 1, parent[row]
        place, row = begins[k] + length, goal
        begins[k + 1] = place
        while place > len(path_rows):
            path_rows = np.concatenate((path_rows, np.empty_like(path_rows)))
        while row >= 0:
            place -= 1
            path_rows[place], row = row, parent[row]
    return path_rows[: begins[-1]].copy(), begins, expansions


@kernel
def _lower(
    free: WordArray, number: int, before: int, lattice: LatticeArrays, ahead: FloatArray, waiting: _Open
) -> None:
    """Lower bounds of the way to the goal that hold in one slice so far that they hold in another."""
    slot, keys, entries, fresh = waiting
    offsets, costs, one = lattice.row_offsets, lattice.move_costs, np.uint64(1)
    word, shift, last, back = number >> 6, np.uint64(number & 63), before >> 6, np.uint64(before & 63)
    count, size, least = 0, 0, 1e-10 * lattice.step[0]
    for row in range(free.shape[0]):
        slot[row] = NEW
        if (free[row, word] >> shift) & ~(free[row, last] >> back) & one:
            ahead[row], fresh[count], count = np.inf, row, count + 1
    for i in range(count):
        row = fresh[i]
        for move in range(len(offsets)):
            other = row + offsets[move]
            if (free[other, word] >> shift) & one:
                ahead[row] = min(ahead[row], ahead[other] + costs[move, 1])
        if ahead[row] < np.inf:
            size = push(keys, entries, slot, size, ahead[row], row)
    while size > 0:
        row = pop(keys, entries, slot, size)
        size -= 1
        for move in range(len(offsets)):
            other, new = row + offsets[move], ahead[row] + costs[move, 1]
            if new < ahead[other] - least and (free[other, word] >> shift) & one:
                ahead[other] = new
                size = push(keys, entries, slot, size, new, other)
