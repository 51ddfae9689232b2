"""The sparse graph: all slice paths together, and connectivity where slices have no path of their own.

The paper takes the path of the first slice that has one, carries it back slice by slice towards the start, and cuts
it in each slice before the first contact. The same is done here on the goal's side (the last path is carried on
towards the goal, its tail kept after the last contact) and, from both sides and at both ends, across gaps in the
middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.arrays import BoolArray, IntArray, WordArray
from hplan.kernels import any_int, kernel
from hplan.search.lattice import Lattice
from hplan.search.layers import Layers
from hplan.search.node_set import NodeSet

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
    lattice: Lattice, free: WordArray, layers: Layers, start: IntArray, goal: IntArray, *, beyond: bool = False
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
    union = np.zeros_like(free)
    for node in (start, goal):
        union[lattice.row_of(node), node[-1] >> 6] |= np.uint64(1) << np.uint64(node[-1] & 63)
    descending = bool(start[-1] > goal[-1])
    restored = _join(free, layers.path_rows, layers.begins, layers.first, descending, union)
    if beyond:
        restored |= _join(free, layers.path_rows, layers.begins, layers.first, not descending, union)
    return Union(NodeSet.of(union), tuple((np.flatnonzero(restored) + layers.first).tolist()))


@kernel
def _join(
    free: WordArray, path_rows: IntArray, begins: IntArray, first: int, descending: bool, union: WordArray
) -> BoolArray:
    """Set the bits of all paths and restored parts; tell which slices were restored."""
    count = len(begins) - 1
    restored = np.zeros(count, dtype=np.bool_)
    previous = _NONE  # the last slice before `k` that has a path
    for k in range(count):
        path = path_rows[begins[k] : begins[k + 1]]
        if len(path) == 0:
            continue
        for row in path:
            union[row, (first + k) >> 6] |= np.uint64(1) << np.uint64((first + k) & 63)
        # The gap before this slice: on the side of the start or the goal one end is carried, in the middle both are,
        # from either side.
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
    return restored


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
