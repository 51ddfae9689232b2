"""Slices whose shortest path is as short as on an empty plane, found for 64 slices at once.

On an empty 8-connected plane all shortest paths make the same moves, some diagonal ones and some straight ones, each
kind in one direction; only their order differs. The places they can pass are a parallelogram. Going through it from the
goal, a few word operations a place tell in which slices the goal can be reached by such moves alone. Where the start is
among the places that reach it, the slice needs no other search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.arrays import IntArray, WordArray
from hplan.kernels import kernel
from hplan.search.bits import popcount


@dataclass(frozen=True, eq=False)
class MonotonePaths:
    """From where the goal is reached by the moves of an empty plane's shortest path.

    Attributes:
        start: Bordered row of the start.
        diagonal: Distance to the row after a diagonal move.
        straight: Distance to the row after a straight move.
        onward: (diagonal moves + 1, straight moves + 1, words) slices in which the goal is reached from the place after
            so many moves of either kind.
        reached: Nodes from which it is.
    """

    start: int
    diagonal: int
    straight: int
    onward: WordArray
    reached: int

    @classmethod
    def of(cls, free: WordArray, width: int, start: int, goal: int, wanted: WordArray) -> MonotonePaths:
        """Those between two rows of planar slices.

        Args:
            free: (rows, words) bits with border.
            width: Bordered rows along axis j.
            start: Bordered row of the start.
            goal: Bordered row of the goal.
            wanted: (words,) the slices to look at.
        """
        (start_i, start_j), (goal_i, goal_j) = divmod(start, width), divmod(goal, width)
        along_i, along_j = abs(goal_i - start_i), abs(goal_j - start_j)
        move_i, move_j = (width if goal_i > start_i else -width), (1 if goal_j > start_j else -1)
        straight = move_i if along_i > along_j else move_j
        diagonals = min(along_i, along_j)
        onward = np.empty((diagonals + 1, max(along_i, along_j) - diagonals + 1, free.shape[1]), dtype=np.uint64)
        reached = _fill(free, wanted, start, move_i + move_j, straight, onward)
        return cls(start, move_i + move_j, straight, onward, int(reached))

    @property
    def found(self) -> WordArray:
        """(words,) the slices that have such a path."""
        found: WordArray = self.onward[0, 0]
        return found

    def joined(self, first: int, last: int, path_rows: IntArray, begins: IntArray) -> tuple[IntArray, IntArray]:
        """Their paths together with those of other slices, each with its diagonal moves as early as can be.

        Args:
            first: First slice.
            last: Last slice.
            path_rows: Rows of the others' paths one after the other.
            begins: (last - first + 2,) where each slice's path begins in them.

        Returns:
            The rows of all paths, and where each slice's path begins in them.
        """
        return _join(self.onward, self.start, self.diagonal, self.straight, first, last, path_rows, begins)


@kernel
def _fill(free: WordArray, wanted: WordArray, start: int, diagonal: int, straight: int, onward: WordArray) -> int:
    """Fill `onward`, last moves first; returns the number of bits in it."""
    diagonals, straights, words = onward.shape
    reached = 0
    for d in range(diagonals - 1, -1, -1):
        for s in range(straights - 1, -1, -1):
            row = start + d * diagonal + s * straight
            for word in range(words):
                bits = wanted[word]
                if d < diagonals - 1 or s < straights - 1:
                    bits = np.uint64(0)
                if d < diagonals - 1:
                    bits |= onward[d + 1, s, word]
                if s < straights - 1:
                    bits |= onward[d, s + 1, word]
                bits &= free[row, word]
                onward[d, s, word] = bits
                reached += popcount(bits)
    return reached


@kernel
def _join(
    onward: WordArray,
    start: int,
    diagonal: int,
    straight: int,
    first: int,
    last: int,
    other_rows: IntArray,
    other_begins: IntArray,
) -> tuple[IntArray, IntArray]:
    """Rows of all paths slice after slice, and where each begins."""
    length = onward.shape[0] + onward.shape[1] - 1
    begins = np.zeros(last - first + 2, dtype=np.int64)
    for k in range(last - first + 1):
        word, bit = (first + k) >> 6, np.uint64(1) << np.uint64((first + k) & 63)
        own = length if onward[0, 0, word] & bit else other_begins[k + 1] - other_begins[k]
        begins[k + 1] = begins[k] + own
    rows = np.empty(begins[-1], dtype=np.int64)
    for k in range(last - first + 1):
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
