"""The sparse graph: all slice paths together, and connectivity where slices have no path of their own.

The paper takes the path of the first slice that has one, carries it back slice by slice towards the start, and cuts
it in each slice before the first contact. The same is done here on the goal's side (the last path is carried on
towards the goal, its tail kept after the last contact) and, from both sides and at both ends, across gaps in the
middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, ShortArray, WordArray
from hplan.base.kernels import any_int, kernel
from hplan.search.lattice import Lattice
from hplan.search.node_set import NodeSet, ranked
from hplan.search.slice_search import SlicePaths

#: No slice.
_NONE = any_int(-1)


@dataclass(frozen=True, eq=False)
class Union:
    """The nodes of the sparse graph.

    Attributes:
        nodes: The nodes.
        restored: Slices without a path of their own that were given part of a neighbour's, ascending.
    """

    nodes: NodeSet
    restored: tuple[int, ...]


def union_of(
    lattice: Lattice, free: WordArray, layers: SlicePaths, start: IntArray, goal: IntArray, *, beyond: bool = False
) -> Union:
    """Join the slice paths, restore connectivity between them, and add start and goal.

    Args:
        lattice: Geometry of the whole grid.
        free: (rows, words) bits with border.
        layers: The slice paths.
        start: (d,) node index.
        goal: (d,) node index.
        beyond: Whether the slices go beyond start and goal, so that either end of a path may be wanted on either side.
    """
    words, rows, ranks, size, restored = _united(
        free,
        layers.path_rows,
        layers.begins,
        layers.first,
        lattice.row_of(start),
        int(start[-1]),
        lattice.row_of(goal),
        int(goal[-1]),
        beyond,
    )
    return Union(NodeSet(words, rows, ranks, size), tuple((np.flatnonzero(restored) + layers.first).tolist()))


@kernel
def _united(
    free: WordArray,
    path_rows: IntArray,
    begins: IntArray,
    first: int,
    start_row: int,
    start_bit: int,
    goal_row: int,
    goal_bit: int,
    beyond: bool,
) -> tuple[WordArray, IntArray, ShortArray, int, BoolArray]:
    """What makes the `NodeSet` of start, goal, all paths and restored parts; which slices were restored."""
    union, has_nodes = np.zeros(free.shape, dtype=np.uint64), np.zeros(free.shape[0], dtype=np.bool_)
    rows = np.empty(min(len(path_rows) + 2, free.shape[0]), dtype=np.int64)
    count = 0
    for row, bit in ((start_row, start_bit), (goal_row, goal_bit)):
        union[row, bit >> 6] |= np.uint64(1) << np.uint64(bit & 63)
        if not has_nodes[row]:
            has_nodes[row] = True
            rows[count] = row
            count += 1
    for k in range(len(begins) - 1):
        word, mask = (first + k) >> 6, np.uint64(1) << np.uint64((first + k) & 63)
        for row in path_rows[begins[k] : begins[k + 1]]:
            union[row, word] |= mask
            if not has_nodes[row]:
                has_nodes[row] = True
                rows[count] = row
                count += 1
    restored = np.zeros(len(begins) - 1, dtype=np.bool_)
    descending = start_bit > goal_bit
    _restore(free, path_rows, begins, first, descending, union, restored)
    if beyond:
        _restore(free, path_rows, begins, first, not descending, union, restored)
    rows = rows[:count].copy()
    ranks, size = ranked(union, rows)
    return union, rows, ranks, size, restored


@kernel
def _restore(
    free: WordArray,
    path_rows: IntArray,
    begins: IntArray,
    first: int,
    descending: bool,
    union: WordArray,
    restored: BoolArray,
) -> None:
    """Add parts of paths in the slices without: on the side of start or goal one end, in the middle both."""
    count = len(begins) - 1
    previous = _NONE  # the last slice before `k` that has a path
    for k in range(count):
        path = path_rows[begins[k] : begins[k + 1]]
        if len(path) == 0:
            continue
        if previous < k - 1:
            for head in (True, False):
                if previous >= 0 or head != descending:
                    _carry(free, path, first, k - 1, previous, head, union, restored)
                if previous >= 0:
                    before = path_rows[begins[previous] : begins[previous + 1]]
                    _carry(free, before, first, previous + 1, k, head, union, restored)
        previous = k
    if previous >= 0:
        path = path_rows[begins[previous] : begins[previous + 1]]
        _carry(free, path, first, previous + 1, count, descending, union, restored)


@kernel
def _carry(
    free: WordArray,
    path: IntArray,
    first: int,
    begin: int,
    end: int,
    head: bool,
    union: WordArray,
    restored: BoolArray,
) -> None:
    """Carry a path's head (or tail) from slice `begin` on until `end`, cut before the first contact in each."""
    kept = len(path)
    towards = 1 if end >= begin else -1
    for k in range(begin, end, towards):
        word, bit = (first + k) >> 6, np.uint64(1) << np.uint64((first + k) & 63)
        for i in range(kept):
            row = path[i] if head else path[len(path) - 1 - i]
            if not free[row, word] & bit:
                kept = i
                break
            union[row, word] |= bit
        if kept == 0:
            return
        restored[k] = True
