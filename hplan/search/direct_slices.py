"""Slices whose shortest path is as short as on an empty plane, found for 64 slices at once.

On an empty 8-connected plane all shortest paths make the same moves, some diagonal ones and some straight ones, each
kind in one direction; only their order differs. The places they can pass are a parallelogram. Going through it from the
goal, a few word operations a place tell in which slices the goal can be reached by such moves alone. Where the start is
among the places that reach it, the slice needs no other search.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.search.bits import popcount


class PlaneEnds(NamedTuple):
    """Start and goal of searches on planar slices.

    Attributes:
        width: Bordered rows along axis j.
        start: Bordered row in which every path starts.
        goal: Bordered row in which every path ends.
    """

    width: int
    start: int
    goal: int


class DirectPaths(NamedTuple):
    """Paths of planar slices made of the moves of an empty plane's shortest path.

    Attributes:
        first: First of the slices looked at.
        start: Bordered row of the start.
        diagonal: Distance to the row after a diagonal move.
        straight: Distance to the row after a straight move.
        onward: (diagonal moves + 1, straight moves + 1, words) slices in which the goal is reached from the place after
            so many moves of either kind.
        others: (words,) slices free at both ends that have no such path.
        reached: Nodes from which the goal is reached.
    """

    first: int
    start: int
    diagonal: int
    straight: int
    onward: WordArray
    others: WordArray
    reached: int


@kernel
def direct_paths(free: WordArray, ends: PlaneEnds, wanted: WordArray, first: int) -> DirectPaths:
    """Direct paths between two rows of planar slices.

    Args:
        free: (rows, words) bits with border.
        ends: Start and goal.
        wanted: (words,) the slices to look at.
        first: First of these.
    """
    width, start, goal = ends
    along_i, along_j = abs(goal // width - start // width), abs(goal % width - start % width)
    move_i = width if goal // width > start // width else -width
    move_j = 1 if goal % width > start % width else -1
    diagonal, straight = move_i + move_j, move_i if along_i > along_j else move_j
    diagonals = min(along_i, along_j)
    straights = max(along_i, along_j) - diagonals
    others = np.empty(len(wanted), dtype=np.uint64)
    onward = np.empty((diagonals + 1, straights + 1, len(wanted)), dtype=np.uint64)
    reached = 0
    for word in range(len(wanted)):
        others[word] = wanted[word] & free[start, word] & free[goal, word]
        for d in range(diagonals, -1, -1):
            for s in range(straights, -1, -1):
                bits = others[word] if d == diagonals and s == straights else np.uint64(0)
                if d < diagonals:
                    bits |= onward[d + 1, s, word]
                if s < straights:
                    bits |= onward[d, s + 1, word]
                bits &= free[start + d * diagonal + s * straight, word]
                onward[d, s, word] = bits
                reached += popcount(bits)
        others[word] &= ~onward[0, 0, word]
    return DirectPaths(first, start, diagonal, straight, onward, others, reached)


@kernel
def with_others(direct: DirectPaths, other_rows: IntArray, other_begins: IntArray) -> tuple[IntArray, IntArray]:
    """Direct paths together with those of other slices, each with its diagonal moves as early as can be.

    Args:
        direct: The direct paths.
        other_rows: Rows of the others' paths one after the other.
        other_begins: (slices + 1,) where each slice's path begins in them.

    Returns:
        The rows of all paths, slice after slice, and where each slice's path begins in them.
    """
    first, start, diagonal, straight, onward, _, _ = direct
    length, count = onward.shape[0] + onward.shape[1] - 1, len(other_begins) - 1
    begins = np.zeros(count + 1, dtype=np.int64)
    for k in range(count):
        word, bit = (first + k) >> 6, np.uint64(1) << np.uint64((first + k) & 63)
        own = length if onward[0, 0, word] & bit else other_begins[k + 1] - other_begins[k]
        begins[k + 1] = begins[k] + own
    rows = np.empty(begins[-1], dtype=np.int64)
    for k in range(count):
        word, bit = (first + k) >> 6, np.uint64(1) << np.uint64((first + k) & 63)
        if not onward[0, 0, word] & bit:
            for i in range(begins[k + 1] - begins[k]):
                rows[begins[k] + i] = other_rows[other_begins[k] + i]
            continue
        row, d = start, 0
        for i in range(length):
            rows[begins[k] + i] = row
            if d < onward.shape[0] - 1 and onward[d + 1, i - d, word] & bit:
                row, d = row + diagonal, d + 1
            else:
                row += straight
    return rows, begins
