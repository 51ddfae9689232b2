"""First level: independent searches on all slices of the last axis.

All in one pass.

A slice has a path if and only if flooding it from the start's row reaches the goal's row; only then does A* search its
rows. A search improves the lower bounds of the cost to go for the next search: the cost to go from a row expanded at
cost g is at least the length of the path minus g (adaptive A*; Koenig and Likhachev, AAMAS 2006). Rows that become free
in the next slice lower these bounds again, from row to row (generalized adaptive A*; Sun, Koenig and Yeoh, AAMAS 2008).
If the path is free in the next slice too, its length is an upper bound there: rows visited only by longer paths are not
put on the open list, and their bounds are lowered in a later slice, if at all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray, WordArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import kernel
from hplan.planar.grid.astar import bound
from hplan.planar.grid.flood import bits_of, flood_slices
from hplan.planar.grid.heap import NEW, begin, pop, priority, push
from hplan.planar.grid.lattice import Lattice, LatticeArrays, Node
from hplan.planar.grid.result import SlicePaths


def search_slices(
    lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, slices: range, *, octile: bool = True
) -> SlicePaths:
    """Search each of `slices` from the start's row to the goal's.

    Args:
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Neighbouring slices, ascending.
        octile: True to use the shortest path on the free grid and the results of previous searches as bounds; False to
            use only the straight line, as in the paper.
    """
    start_row, goal_row = lattice.row_of(start), lattice.row_of(goal)
    reached, flooded = flood_slices(lattice, free, start_row, lattice.mask(slices), goal_row)
    wanted = np.flatnonzero(bits_of(reached[goal_row] & lattice.mask(slices)))
    # Start next to slices without a path: paths are longest there, and bounds from long paths stay valid.
    if len(wanted) and wanted[0] == slices[0] and wanted[-1] < slices[-1]:
        wanted = wanted[::-1].copy()
    # Search from the end whose own slice has a path: the other end's exit is then known, and is the longer part.
    from_goal = octile and len(wanted) > 0 and bool(goal[-1] in wanted and start[-1] not in wanted)
    ends = (goal_row, start_row) if from_goal else (start_row, goal_row)
    rows, begins, expansions = _search_rows(free, wanted, ends, lattice.arrays, octile, from_goal)
    check_deadline()
    lengths = np.zeros(len(slices), dtype=np.int64)
    lengths[wanted - slices[0]] = np.diff(begins)
    if len(wanted) > 1 and wanted[0] > wanted[-1]:
        rows = np.concatenate([rows[begins[k] : begins[k + 1]] for k in range(len(wanted) - 1, -1, -1)])
    return SlicePaths(
        lattice, slices[0], frozen(rows), frozen(np.concatenate([[0], np.cumsum(lengths)])), expansions, flooded
    )


class _Open(NamedTuple):
    """Open list of a search."""

    slot: ShortArray
    keys: FloatArray
    entries: ShortArray


class _Changes(NamedTuple):
    """Rows that a change of slice may affect.

    Attributes:
        rows: (k,) rows that are free in some of the searched slices and occupied in others.
        late: (rows,) rows; those whose bounds may still have to be lowered come first.
        least: (rows,) lower bound of the length of paths through these rows; infinite for the other rows.
        behind: (rows,) lower bound of the length of paths from the start's row.
    """

    rows: ShortArray
    late: ShortArray
    least: FloatArray
    behind: FloatArray


@kernel
def _search_rows(
    free: WordArray, wanted: IntArray, ends: tuple[int, int], lattice: LatticeArrays, octile: bool, backward: bool
) -> tuple[IntArray, IntArray, int]:
    """Search slices between two rows, in the order given.

    Returns:
        Concatenated rows of the slices' paths, the start index of each path, and the number of expansions.
        With `backward` each path is reversed.
    """
    (start, goal), rows, offsets, costs = ends, free.shape[0], lattice.row_offsets, lattice.move_costs
    cost, parent, seen = np.empty(rows), np.empty(rows, dtype=np.int32), np.full(rows, -1, dtype=np.int32)
    slot, entries, closed = np.full(rows, NEW, dtype=np.int32), np.empty(rows, np.int32), np.empty(rows, np.int32)
    waiting = _Open(slot, np.empty(rows), entries)
    ahead, behind, one = np.empty(rows), np.empty(rows), np.uint64(1)
    # A slice is a separate grid with the second-to-last axis along its bits.
    places, flat = lattice.row_coordinates, lattice.step[:-1]
    source, target = Node(start, places[start, len(flat) - 1]), Node(goal, places[goal, len(flat) - 1])
    for row in range(rows):
        ahead[row] = bound(places, flat, row, places[row, len(flat) - 1], target, octile)
        behind[row] = bound(places, flat, row, places[row, len(flat) - 1], source, octile)
    changes, late = _Changes(*_changes(free, wanted), behind), 0
    path_rows, begins, expansions = np.empty(4096, dtype=np.int64), np.zeros(len(wanted) + 1, dtype=np.int64), 0
    for k in range(len(wanted)):
        number, begins[k + 1], limit = wanted[k], begins[k], np.inf
        if is_up(lattice.until):
            break
        word, shift = number >> 6, np.uint64(number & 63)
        if octile and k > 0:
            limit = cost[goal] * (1.0 + 1e-9)
            for i in range(begins[k - 1], begins[k]):
                if not (free[path_rows[i], word] >> shift) & one:
                    limit = np.inf
                    break
            late = _lower(free, (number, wanted[k - 1], late), limit, lattice, ahead, waiting, changes)
        scale, tolerance = 1.0 / max(ahead[start], 1e-12), 1e-12 * ahead[start]
        seen[start], cost[start], parent[start], slot[start], size, done = number, 0.0, -1, NEW, 0, 0
        length = _follow(free, (number, start, goal), lattice, ahead, closed, backward) if octile and k > 0 else 0
        if length > 0:
            cost[goal], expansions = ahead[start], expansions + length
        else:
            size = begin(waiting.keys, entries, slot, start)
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
                    seen[other], cost[other] = number, np.inf
                new = cost[row] + costs[move, 1]
                if new >= cost[other] - tolerance or new + ahead[other] > limit:
                    continue
                cost[other], parent[other] = new, row
                size = push(waiting.keys, entries, slot, size, priority(new, ahead[other], scale), other)
        for i in range(size):
            slot[entries[i]] = NEW
        for i in range(done if octile else 0):
            ahead[closed[i]] = max(ahead[closed[i]], cost[goal] - cost[closed[i]])
        if length == 0 and backward:
            length = _follow(free, (number, start, goal), lattice, ahead, closed, backward)
        if length == 0:
            row = goal
            while row >= 0:
                length, row = length + 1, parent[row]
            row = goal
            for i in range(length):
                closed[length - 1 - i], row = row, parent[row]
        begins[k + 1] = begins[k] + length
        while begins[k + 1] > len(path_rows):
            path_rows = np.concatenate((path_rows, np.empty_like(path_rows)))
        for i in range(length):
            path_rows[begins[k] + i] = closed[length - 1 - i if backward else i]
    return path_rows[: begins[-1]].copy(), begins, expansions


@kernel
def _follow(
    free: WordArray, which: tuple[int, int, int], lattice: LatticeArrays, ahead: FloatArray, path: ShortArray,
    backward: bool,
) -> int:  # fmt: skip
    """Follow exact bounds from the start's row to the goal's.

    Args:
        which: The slice, and the rows of start and goal.
        path: (rows,) output array of the path's rows.
        backward: True to prefer the moves that a forward search makes last, so that the paths have the same shape.

    Returns:
        Number of rows of the path; 0 if a bound along it is not exact.
    """
    (number, row, goal), one, count = which, np.uint64(1), 1
    costs, word, shift = lattice.move_costs[:, 1], number >> 6, np.uint64(number & 63)
    # On exact bounds the cost of a move is the decrease of the bound.
    moves = np.argsort(costs)[1:] if backward else np.argsort(-costs)[:-1]
    offsets, costs = lattice.row_offsets[moves], costs[moves]
    path[0], tolerance = row, 1e-10 * lattice.step[0]
    while row != goal:
        following = -1
        for move in range(len(offsets)):
            other = row + offsets[move]
            if costs[move] + ahead[other] <= ahead[row] + tolerance and (free[other, word] >> shift) & one:
                following = other
                break
        if following < 0:
            return 0
        path[count], row, count = following, following, count + 1
    return count


@kernel
def _changes(free: WordArray, wanted: IntArray) -> tuple[ShortArray, ShortArray, FloatArray]:
    """Find the rows that are free in only some requested slices."""
    rows, zero = free.shape[0], np.uint64(0)
    mask, changing, count = np.zeros(free.shape[1], dtype=np.uint64), np.empty(rows, dtype=np.int32), 0
    for number in wanted:
        mask[number >> 6] |= np.uint64(1) << np.uint64(number & 63)
    for row in range(rows):
        some, missing = zero, zero
        for word in range(len(mask)):
            bits = free[row, word] & mask[word]
            some, missing = some | bits, missing | (bits ^ mask[word])
        if some != zero and missing != zero:
            changing[count], count = row, count + 1
    return changing[:count], np.empty(rows, dtype=np.int32), np.full(rows, np.inf)


@kernel
def _lower(
    free: WordArray, which: tuple[int, int, int], limit: float, lattice: LatticeArrays, ahead: FloatArray,
    waiting: _Open, changes: _Changes,
) -> int:  # fmt: skip
    """Lower cost-to-go bounds until they hold in the next slice.

    They then hold on paths of at most the length `limit`.

    Args:
        which: The next slice, the previous slice, and the number of late rows.

    Returns:
        The number of late rows afterwards.
    """
    (slot, _, entries), (changing, late, lengths, behind), (number, before, count) = waiting, changes, which
    offsets, costs, one = lattice.row_offsets, lattice.move_costs, np.uint64(1)
    word, shift, last, back = number >> 6, np.uint64(number & 63), before >> 6, np.uint64(before & 63)
    size, kept, tolerance = 0, 0, 1e-10 * lattice.step[0]
    for row in changing:
        if (free[row, word] >> shift) & ~(free[row, last] >> back) & one:
            if lengths[row] == np.inf:
                late[count], count = row, count + 1
            ahead[row], lengths[row] = np.inf, 0.0
    for i in range(count):
        row, new = late[i], np.inf
        if lengths[row] > limit:
            late[kept], kept = row, kept + 1
            continue
        lengths[row] = np.inf
        if not (free[row, word] >> shift) & one:
            continue
        for move in range(len(offsets)):
            other = row + offsets[move]
            if (free[other, word] >> shift) & one:
                new = min(new, ahead[other] + costs[move, 1])
        if new >= ahead[row] - tolerance:
            continue
        length = new + behind[row]
        if length <= limit:
            ahead[row] = new
            slot[row], entries[size], size = 0, row, size + 1
        else:
            late[kept], lengths[row], kept = row, length, kept + 1
    head = 0
    while size > 0:
        row = entries[head]
        head, size, slot[row] = head + 1 if head + 1 < len(entries) else 0, size - 1, NEW
        for move in range(len(offsets)):
            other, new = row + offsets[move], ahead[row] + costs[move, 1]
            if new >= ahead[other] - tolerance or not (free[other, word] >> shift) & one:
                continue
            length = new + behind[other]
            if length <= limit:
                ahead[other] = new
                if slot[other] < 0:
                    tail = head + size if head + size < len(entries) else head + size - len(entries)
                    slot[other], entries[tail], size = 0, other, size + 1
                continue
            if lengths[other] == np.inf:
                late[kept], kept = other, kept + 1
            lengths[other] = min(lengths[other], length)
    return kept
