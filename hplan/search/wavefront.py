"""Completeness where A* would be too slow: two wavefronts over whole words of nodes, one from each end.

A wavefront of level `l` holds the nodes that `l` moves reach and fewer do not. All neighbours of 64 nodes are found by
a few word operations, so millions of nodes are settled in milliseconds; where the fronts meet, the path has as few
moves as any. Levels are kept modulo 3, in bit planes: a neighbour's level differs by one at most, so the residue tells
which way leads back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np

from hplan.arrays import FloatArray, IntArray, WordArray, frozen
from hplan.search.bits import lowest_bit, popcount
from hplan.search.lattice import Lattice


@dataclass(frozen=True, eq=False)
class Wavefronts:
    """What two wavefronts found.

    Attributes:
        path: (m, d) node indices, or None where start and goal are not connected.
        flooded: Nodes reached by either front.
        enclosed: Which end was shown to be enclosed, `start` or `goal`; empty with a path.
        reached: (rows, words) all nodes connected to that end, with border; empty with a path.
    """

    path: IntArray | None
    flooded: int
    enclosed: str
    reached: WordArray


def meet(lattice: Lattice, free: WordArray, starts: IntArray, goals: IntArray) -> Wavefronts:
    """Path with the fewest moves over the set bits of `free`, or the component that shows there is none.

    Deterministic: of all such paths one that stays near the straight lines to both (first) ends.

    Args:
        lattice: Geometry of the grid.
        free: (rows, words) bits with border.
        starts: (k, d) or (d,) free nodes; the path begins at any of them.
        goals: (m, d) or (d,) free nodes; the path ends at any of them.
    """
    ends = [np.atleast_2d(starts), np.atleast_2d(goals)]
    rows, bits, flooded, side, reached = _meet(
        free,
        lattice.row_offsets,
        lattice.row_coordinates,
        lattice.step,
        np.array([lattice.row_of(node) for end in ends for node in end]),
        np.array([int(node[-1]) for end in ends for node in end]),
        len(ends[0]),
    )
    if len(rows) > 0:
        return Wavefronts(frozen(lattice.indices(rows, bits)), int(flooded), "", reached)
    return Wavefronts(None, int(flooded), ("start", "goal")[side], reached)


@nb.njit(cache=True)
def _spread(free: WordArray, seen: WordArray, front: WordArray, rows: IntArray, count: int, offsets: IntArray,
            following: WordArray, found: IntArray) -> int:  # fmt: skip
    """Write the unseen free neighbours of a front into `following`, the rows they are in into `found`."""
    words = free.shape[1]
    one, top, zero = np.uint64(1), np.uint64(63), np.uint64(0)
    size = 0
    for i in range(count):
        row = rows[i]
        for word in range(words):
            bits = front[row, word]
            spread = bits | (bits << one) | (bits >> one)
            if word > 0:
                spread |= front[row, word - 1] >> top
            if word + 1 < words:
                spread |= front[row, word + 1] << top
            if spread == zero:
                continue
            for offset in offsets:
                beside = row + offset
                fresh = spread & free[beside, word] & ~seen[beside, word]
                if fresh == zero:
                    continue
                already = zero
                for other in range(words):
                    already |= following[beside, other]
                if already == zero:
                    found[size] = beside
                    size += 1
                following[beside, word] |= fresh
    return size


@nb.njit(cache=True)
def _meet(
    free: WordArray,
    offsets: IntArray,
    coordinates: IntArray,
    step: FloatArray,
    end_rows: IntArray,
    end_bits: IntArray,
    starts: int,
) -> tuple[IntArray, IntArray, int, int, WordArray]:
    """Rows and bits of the path (empty without one), nodes reached, the enclosed side, what it reaches."""
    rows, words = free.shape
    one, zero = np.uint64(1), np.uint64(0)
    seen = np.zeros((2, rows, words), dtype=np.uint64)
    planes = np.zeros((2, 3, rows, words), dtype=np.uint64)
    fronts = np.zeros((2, 2, rows, words), dtype=np.uint64)  # the front and the one after it, for each side
    active = np.empty((2, 2, rows), dtype=np.int64)
    sizes, levels, current = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    flooded = 0
    meeting_row, meeting_bit = -1, -1
    for end in range(len(end_rows)):
        side = 0 if end < starts else 1
        row, bit, word = end_rows[end], end_bits[end], end_bits[end] >> 6
        mask = one << np.uint64(bit & 63)
        already = zero
        for other in range(words):
            already |= seen[side, row, other]
        if already == zero:
            active[side, 0, sizes[side]] = row
            sizes[side] += 1
        flooded += 1 if not seen[side, row, word] & mask else 0
        seen[side, row, word] |= mask
        planes[side, 0, row, word] |= mask
        fronts[side, 0, row, word] |= mask
        if side == 1 and seen[0, row, word] & mask and meeting_row < 0:
            meeting_row, meeting_bit = row, bit
    while meeting_row < 0:
        side = 0 if sizes[0] <= sizes[1] else 1
        here, after = current[side], 1 - current[side]
        size = _spread(
            free, seen[side], fronts[side, here], active[side, here], sizes[side], offsets, fronts[side, after],
            active[side, after],
        )  # fmt: skip
        for i in range(sizes[side]):
            row = active[side, here, i]
            for word in range(words):
                fronts[side, here, row, word] = zero
        if size == 0:
            return np.empty(0, np.int64), np.empty(0, np.int64), flooded, side, seen[side].copy()
        levels[side] += 1
        plane = levels[side] % 3
        for i in range(size):
            row = active[side, after, i]
            for word in range(words):
                bits = fronts[side, after, row, word]
                seen[side, row, word] |= bits
                planes[side, plane, row, word] |= bits
                flooded += popcount(bits)
                common = bits & seen[1 - side, row, word]
                if common != zero and meeting_row < 0:
                    meeting_row, meeting_bit = row, 64 * word + lowest_bit(common)
        sizes[side], current[side] = size, after
    # The meeting node is of the last level on both sides: had the other front met it earlier, it would have gone on to
    # the node before it, and the fronts would have met there.
    counts = np.zeros(2, dtype=np.int64)
    path_rows, path_bits = np.empty(levels[0] + levels[1] + 1, np.int64), np.empty(levels[0] + levels[1] + 1, np.int64)
    for side in range(2):
        counts[side] = _trace(
            planes[side], levels[side], offsets, coordinates, step, end_rows[side * starts], end_bits[side * starts],
            meeting_row, meeting_bit, side, counts[0], path_rows, path_bits,
        )  # fmt: skip
    total = counts[0] + 1 + counts[1]
    return path_rows[:total].copy(), path_bits[:total].copy(), flooded, -1, np.zeros((0, words), dtype=np.uint64)


@nb.njit(cache=True)
def _trace(
    planes: WordArray,
    level: int,
    offsets: IntArray,
    coordinates: IntArray,
    step: FloatArray,
    end_row: int,
    end_bit: int,
    row: int,
    bit: int,
    side: int,
    before: int,
    path_rows: IntArray,
    path_bits: IntArray,
) -> int:
    """Go back from the meeting node to one end, level by level; returns the moves made.

    The start's part is written so that the path runs from start to meeting node, the goal's part after it.
    """
    one = np.uint64(1)
    axes = len(step)
    moves = level
    path_rows[moves if side == 0 else before] = row
    path_bits[moves if side == 0 else before] = bit
    while level > 0:
        level -= 1
        best_row, best_bit, best = -1, -1, np.inf
        for offset in offsets:
            beside = row + offset
            for turn in range(-1, 2):
                other = bit + turn
                if other < 0 or other >= 64 * planes.shape[2]:
                    continue
                if not (planes[level % 3, beside, other >> 6] >> np.uint64(other & 63)) & one:
                    continue
                square = ((other - end_bit) * step[axes - 1]) ** 2
                for axis in range(axes - 1):
                    square += ((coordinates[beside, axis] - coordinates[end_row, axis]) * step[axis]) ** 2
                if square < best:
                    best_row, best_bit, best = beside, other, square
        row, bit = best_row, best_bit
        place = level if side == 0 else before + moves - level
        path_rows[place], path_bits[place] = row, bit
    return moves
