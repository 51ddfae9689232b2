"""Slices whose shortest path is as short as on an empty plane, found for 64 slices at once.

On an empty 8-connected plane all shortest paths make the same moves, some diagonal ones and some straight ones, each
kind in one direction; only their order differs. The places they can pass are a parallelogram. Going through it from the
goal, a few word operations a place tell in which slices the goal can be reached by such moves alone. Where the start is
among the places that reach it, the slice needs no other search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.search.bits import popcount


@dataclass(frozen=True, eq=False)
class MonotonePaths:
    """From where the goal is reached by the moves of an empty plane's shortest path.

    Attributes:
        slices: The slices looked at, ascending.
        start: Bordered row of the start.
        diagonal: Distance to the row after a diagonal move.
        straight: Distance to the row after a straight move.
        onward: (diagonal moves + 1, straight moves + 1, words) slices in which the goal is reached from the place after
            so many moves of either kind.
        others: (words,) slices free at both ends that have no such path.
        reached: Nodes from which the goal is reached.
    """

    slices: range
    start: int
    diagonal: int
    straight: int
    onward: WordArray
    others: WordArray
    reached: int

    @classmethod
    def of(cls, free: WordArray, width: int, start: int, goal: int, slices: range) -> MonotonePaths:
        """Those between two rows of planar slices.

        Args:
            free: (rows, words) bits with border.
            width: Bordered rows along axis j.
            start: Bordered row of the start.
            goal: Bordered row of the goal.
            slices: Neighbouring slices to look at, ascending.
        """
        return cls(slices, start, *_onward(free, width, start, goal, slices.start, slices.stop))

    def joined(self, path_rows: IntArray, begins: IntArray) -> tuple[IntArray, IntArray]:
        """Their paths together with those of other slices, each with its diagonal moves as early as can be.

        Args:
            path_rows: Rows of the others' paths one after the other.
            begins: (slices + 1,) where each slice's path begins in them.

        Returns:
            The rows of all paths, and where each slice's path begins in them.
        """
        return _join(self.onward, self.start, self.diagonal, self.straight, self.slices.start, path_rows, begins)


@kernel
def _onward(
    free: WordArray, width: int, start: int, goal: int, first: int, stop: int
) -> tuple[int, int, WordArray, WordArray, int]:
    """All of `MonotonePaths` from `diagonal` on; `onward` is filled last moves first."""
    along_i, along_j = abs(goal // width - start // width), abs(goal % width - start % width)
    move_i = width if goal // width > start // width else -width
    move_j = 1 if goal % width > start % width else -1
    diagonal, straight = move_i + move_j, move_i if along_i > along_j else move_j
    diagonals = min(along_i, along_j)
    straights = max(along_i, along_j) - diagonals
    words = free.shape[1]
    others = np.zeros(words, dtype=np.uint64)
    for number in range(first, stop):
        others[number >> 6] |= np.uint64(1) << np.uint64(number & 63)
    onward = np.empty((diagonals + 1, straights + 1, words), dtype=np.uint64)
    reached = 0
    for word in range(words):
        others[word] &= free[start, word] & free[goal, word]
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
    return diagonal, straight, onward, others, reached


@kernel
def _join(
    onward: WordArray,
    start: int,
    diagonal: int,
    straight: int,
    first: int,
    other_rows: IntArray,
    other_begins: IntArray,
) -> tuple[IntArray, IntArray]:
    """Rows of all paths slice after slice, and where each begins."""
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
