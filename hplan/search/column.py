"""Where the slices between start and goal do not join: fold, turn, unfold.

A *column* is a place that is free in all slices between start's and goal's. With slices by yaw it is a pose in which
the base can turn freely. The way goes in the start's slice to a column, through all slices there, and in the goal's
slice to the goal.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.search.flood import flood_from
from hplan.search.lattice import Lattice
from hplan.search.slice_search import SliceSearch, slice_words


def by_column(
    lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, slice_search: SliceSearch
) -> tuple[IntArray | None, int, int]:
    """A way through the column that is nearest to start and goal together.

    Args:
        lattice: Geometry of the whole grid, at least three axes.
        free: (rows, words) bits with border.
        start: (d,) node index of a free node.
        goal: (d,) node index of a free node.
        slice_search: Searches a slice.

    Returns:
        The (m, d) path, or None where no column is connected to both within their slices; expansions; nodes flooded.
    """
    flat = Lattice.of(lattice.shape[:-1], lattice.step[:-1])
    masks, flooded = [], 0
    for node in (start, goal):
        reached, count = flood_from(flat, slice_words(lattice, free, int(node[-1])), node[:-1])
        masks.append(reached)
        flooded += count
    row = _nearest_column(
        free,
        int(min(start[-1], goal[-1])),
        int(max(start[-1], goal[-1])),
        masks[0],
        masks[1],
        lattice.padded[-1],
        lattice.row_coordinates,
        lattice.step,
        lattice.row_of(start),
        lattice.row_of(goal),
    )
    if row < 0:
        return None, 0, flooded
    place = lattice.row_coordinates[row]
    there, _, first, more = slice_search(flat, masks[0], start[:-1], place)
    back, _, second, still_more = slice_search(flat, masks[1], place, goal[:-1])
    flooded += more + still_more
    if there is None or back is None:
        return None, first + second, flooded
    towards = 1 if goal[-1] >= start[-1] else -1
    turn = np.arange(start[-1], goal[-1] + towards, towards)
    parts = [
        np.column_stack([there[:-1], np.full(len(there) - 1, start[-1])]),
        np.column_stack([np.repeat(place[None], len(turn), axis=0), turn]),
        np.column_stack([back[1:], np.full(len(back) - 1, goal[-1])]),
    ]
    return np.concatenate(parts), first + second, flooded


@kernel
def _nearest_column(
    free: WordArray,
    first: int,
    last: int,
    from_start: WordArray,
    from_goal: WordArray,
    padded: int,
    coordinates: IntArray,
    step: FloatArray,
    start_row: int,
    goal_row: int,
) -> int:
    """Row that is free from bit `first` to `last`, reached in both end slices, with the least way there and back."""
    one, every = np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)
    axes = coordinates.shape[1]
    best, found = math.inf, -1
    for row in range(free.shape[0]):
        line, b = row // padded, row % padded - 1
        if b < 0 or b >= padded - 2:
            continue
        reached = from_start[line, b >> 6] & from_goal[line, b >> 6]
        if not (reached >> np.uint64(b & 63)) & one:
            continue
        whole = True
        for word in range(first >> 6, (last >> 6) + 1):
            mask = every
            if word == first >> 6:
                mask &= every << np.uint64(first & 63)
            if word == last >> 6:
                mask &= every >> np.uint64(63 - (last & 63))
            if free[row, word] & mask != mask:
                whole = False
                break
        if not whole:
            continue
        there, back = 0.0, 0.0
        for axis in range(axes):
            there += ((coordinates[row, axis] - coordinates[start_row, axis]) * step[axis]) ** 2
            back += ((coordinates[row, axis] - coordinates[goal_row, axis]) * step[axis]) ** 2
        length = math.sqrt(there) + math.sqrt(back)
        if length < best:
            best, found = length, row
    return found
