"""Paths for slices between start and goal that do not join: fold, turn, unfold.

A *column* is a row that is free in all slices from the start's to the goal's. With slices by yaw it is a pose in which
the base can turn freely. The path goes in the start's slice to a column, through all slices there, and in the goal's
slice to the goal.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.search.flood import bits_of, flood_from
from hplan.search.lattice import Lattice
from hplan.search.slice_search import SliceSearch, slice_words


def by_column(
    lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, slice_search: SliceSearch
) -> tuple[IntArray | None, int, int]:
    """Path through the column that is nearest to start and goal together.

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
    row = _nearest_column(lattice, free, masks[0] & masks[1], start, goal)
    if row is None:
        return None, 0, flooded
    place = lattice.row_coordinates[row]
    there, first, more = slice_search(flat, masks[0], start[:-1], place)
    back, second, still_more = slice_search(flat, masks[1], place, goal[:-1])
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


def _nearest_column(
    lattice: Lattice, free: WordArray, reached: WordArray, start: IntArray, goal: IntArray
) -> int | None:
    """Row, of those reached in both end slices, that is free between them and nearest to start and goal together."""
    lines, bits = np.nonzero(bits_of(reached))
    rows = lines * lattice.padded[-1] + bits + 1
    first, last = sorted((int(start[-1]), int(goal[-1])))
    between = lattice.mask(range(first, last + 1))
    rows = rows[((free[rows] & between) == between).all(axis=1)]
    if not len(rows):
        return None
    places, step = lattice.row_coordinates[rows], lattice.step[:-1]
    there, back = (np.linalg.norm((places - node[:-1]) * step, axis=1) for node in (start, goal))
    return int(rows[np.argmin(there + back)])
