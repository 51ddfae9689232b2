"""Sparse graph of slice paths, with connectivity restored across gaps.

The paper takes the path of the first slice that has one, copies it slice by slice back towards the start, and cuts it
in each slice before the first contact. This module does the same on the goal's side (the last path is copied towards
the goal, and its tail after the last contact is kept) and, from both sides and at both ends, across gaps in the middle.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.planar.grid.lattice import Lattice, Node, NodeSet, number_nodes
from hplan.planar.grid.result import SlicePaths


def union_of(
    lattice: Lattice, free: WordArray, layers: SlicePaths, start: IntArray, goal: IntArray, *, beyond: bool = False
) -> tuple[NodeSet, tuple[int, ...]]:
    """Join the slice paths, start and goal, with restored connectivity.

    Args:
        free: (rows, words) bits with border.
        start: (d,) node index.
        goal: (d,) node index.
        beyond: True if the slices extend beyond start and goal, so that either end of a path may be required on either
            side.

    Returns:
        The nodes of the sparse graph, and the ascending slices without their own path that received part of a
        neighbour's path.
    """
    ends = lattice.node(start), lattice.node(goal)
    nodes, restored = _unite_paths(free, layers.path_rows, layers.begins, layers.first, *ends, beyond)
    return nodes, tuple(np.flatnonzero(restored).tolist())


@kernel
def _unite_paths(
    free: WordArray, path_rows: IntArray, begins: IntArray, first: int, start: Node, goal: Node, beyond: bool
) -> tuple[NodeSet, BoolArray]:
    """Union of start, goal, all paths and restored segments.

    Also a mask of the restored slices.
    """
    union, has_nodes = np.zeros(free.shape, dtype=np.uint64), np.zeros(free.shape[0], dtype=np.bool_)
    rows = np.empty(min(len(path_rows) + 2, free.shape[0]), dtype=np.int64)
    count = 0
    for row, bit in (start, goal):
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
    restored = np.zeros(64 * free.shape[1], dtype=np.bool_)
    descending = start.bit > goal.bit
    _restore(free, path_rows, begins, first, descending, union, restored)
    if beyond:
        _restore(free, path_rows, begins, first, not descending, union, restored)
    return number_nodes(union, rows[:count].copy()), restored


@kernel
def _restore(
    free: WordArray, path_rows: IntArray, begins: IntArray, first: int, descending: bool, union: WordArray,
    restored: BoolArray,
) -> None:  # fmt: skip
    """Add path segments to slices without a path.

    Slices on the side of start or goal receive one end of a path, slices in the middle both ends.
    """
    count = len(begins) - 1
    previous = -1  # the last slice before this one that has a path
    for k in range(count):
        path = path_rows[begins[k] : begins[k + 1]]
        if len(path) == 0:
            continue
        if previous < k - 1:
            for head in (True, False):
                if previous >= 0 or head != descending:
                    _carry(free, path, first + k - 1, first + previous, head, union, restored)
                if previous >= 0:
                    before = path_rows[begins[previous] : begins[previous + 1]]
                    _carry(free, before, first + previous + 1, first + k, head, union, restored)
        previous = k
    if previous >= 0:
        path = path_rows[begins[previous] : begins[previous + 1]]
        _carry(free, path, first + previous + 1, first + count, descending, union, restored)


@kernel
def _carry(
    free: WordArray, path: IntArray, begin: int, end: int, head: bool, union: WordArray, restored: BoolArray
) -> None:
    """Copy a path's head (or tail) to slices `begin` to `end`.

    It is cut before the first contact.
    """
    kept = len(path)
    for number in range(begin, end, 1 if end >= begin else -1):
        word, bit = number >> 6, np.uint64(1) << np.uint64(number & 63)
        for i in range(kept):
            row = path[i] if head else path[len(path) - 1 - i]
            if not free[row, word] & bit:
                kept = i
                break
            union[row, word] |= bit
        if kept == 0:
            return
        restored[number] = True
