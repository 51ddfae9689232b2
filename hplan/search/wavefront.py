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
    end_rows = np.array([lattice.row_of(node) for side in ends for node in side])
    end_bits = np.array([int(node[-1]) for side in ends for node in side])
    # Rows stand in lines along the axis before the last; neighbouring lines are given by their middle rows.
    line = lattice.padded[-1]
    shape = (lattice.rows // line, line * lattice.words)
    # Memory that no front comes near is never touched, and costs nothing.
    seen = np.zeros((2, lattice.rows, lattice.words), dtype=np.uint64)
    planes = np.zeros((2, 3, lattice.rows, lattice.words), dtype=np.uint64)
    row, bit, side, levels, flooded = _meet(
        free.reshape(shape),
        seen.reshape(2, *shape),
        planes.reshape(2, 3, *shape),
        lattice.row_offsets[1::3] // line,
        lattice.words,
        end_rows,
        end_bits,
        len(ends[0]),
    )
    if row < 0:
        return Wavefronts(None, int(flooded), ("start", "goal")[side], seen[side])
    halves = [
        _trace(
            planes[k],
            int(levels[k]),
            lattice.row_offsets,
            lattice.row_coordinates,
            lattice.step,
            end_rows[k * len(ends[0])],
            end_bits[k * len(ends[0])],
            row,
            bit,
        )
        for k in range(2)
    ]
    nodes = np.concatenate([halves[0][::-1], halves[1][1:]])
    return Wavefronts(
        frozen(lattice.indices(nodes[:, 0], nodes[:, 1])), int(flooded), "", seen[:, :0].reshape(0, lattice.words)
    )


@nb.njit(cache=True)
def _widen(front: WordArray, words: int, inner: WordArray, along: WordArray, spread: WordArray) -> None:
    """The nodes of a line, (length,), and their neighbours in the same line."""
    length = len(front)
    one, top = np.uint64(1), np.uint64(63)
    if words == 1:
        for k in range(length):
            along[k] = front[k] | (front[k] << one) | (front[k] >> one)
    else:
        for k in range(1, length - 1):
            along[k] = (
                front[k]
                | (front[k] << one)
                | (front[k] >> one)
                | ((front[k - 1] >> top) & inner[k])
                | ((front[k + 1] << top) & (inner[k + 1] << top))
            )
    # The first and last rows are border: they need no neighbours.
    for k in range(words, length - words):
        spread[k] = along[k] | along[k - words] | along[k + words]


@nb.njit(cache=True)
def _settle(
    free: WordArray, seen: WordArray, other: WordArray, fresh: WordArray, plane: WordArray
) -> tuple[int, int, bool]:
    """Add to a line what is free and unseen of `fresh`; how many nodes, the first word the other side has seen (or -1).

    Also whether free nodes are left in the line that are unseen.
    """
    zero = np.uint64(0)
    some, common, left = zero, zero, zero
    for k in range(len(free)):
        fresh[k] &= free[k] & ~seen[k]
        some |= fresh[k]
        common |= fresh[k] & other[k]
    if some == zero:
        return 0, -1, True
    added = 0
    for k in range(len(free)):
        seen[k] |= fresh[k]
        plane[k] |= fresh[k]
        left |= free[k] & ~seen[k]
        added += popcount(fresh[k])
    met = -1
    if common != zero:
        met = 0
        while fresh[met] & other[met] == zero:
            met += 1
    return added, met, left != zero


@nb.njit(cache=True)
def _meet(
    free: WordArray,
    seen: WordArray,
    planes: WordArray,
    beside: IntArray,
    words: int,
    end_rows: IntArray,
    end_bits: IntArray,
    starts: int,
) -> tuple[int, int, int, IntArray, int]:
    """Grow both fronts, line by line, until they meet or one is enclosed; fills `seen` and `planes`.

    A line is settled when some neighbouring line had news at the level before. The front of a level is its plane: what
    is older there has no unseen neighbours.

    Returns:
        Row and bit where they met (-1 where they did not), the side that is enclosed, the levels of both sides, and
        the nodes reached.
    """
    lines, length = free.shape
    rows = length // words
    one, zero = np.uint64(1), np.uint64(0)
    inner = np.ones(length, dtype=np.uint64)  # 1 for words whose lower neighbour is of the same row
    for k in range(0, length, words):
        inner[k] = zero
    along, fresh = np.zeros(length, dtype=np.uint64), np.zeros(length, dtype=np.uint64)
    spread = np.empty((lines, length), dtype=np.uint64)
    is_active, is_done = np.zeros((2, lines), dtype=np.bool_), np.zeros((2, lines), dtype=np.bool_)
    stamp = np.zeros(lines, dtype=np.int64)
    active = np.empty((2, lines), dtype=np.int64)
    wanted = np.empty(lines, dtype=np.int64)
    sizes, levels = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    flooded, steps = 0, 0
    for end in range(len(end_rows)):
        side = 0 if end < starts else 1
        line, k = end_rows[end] // rows, (end_rows[end] % rows) * words + (end_bits[end] >> 6)
        mask = one << np.uint64(end_bits[end] & 63)
        if not is_active[side, line]:
            is_active[side, line] = True
            active[side, sizes[side]] = line
            sizes[side] += 1
        flooded += 0 if seen[side, line, k] & mask else 1
        seen[side, line, k] |= mask
        planes[side, 0, line, k] |= mask
        if side == 1 and seen[0, line, k] & mask:
            return end_rows[end], end_bits[end], -1, levels, flooded
    while sizes[0] > 0 and sizes[1] > 0:
        side = 0 if sizes[0] <= sizes[1] else 1
        plane = levels[side] % 3
        steps += 1
        count = 0
        for i in range(sizes[side]):
            line = active[side, i]
            _widen(planes[side, plane, line], words, inner, along, spread[line])
            for offset in beside:
                other = line + offset
                if stamp[other] != steps:
                    stamp[other] = steps
                    if not is_done[side, other]:
                        wanted[count] = other
                        count += 1
        levels[side] += 1
        plane = levels[side] % 3
        sizes[side], size = 0, sizes[side]
        met_line, met_word = -1, -1
        following = 0
        for i in range(count):
            line = wanted[i]
            for k in range(length):
                fresh[k] = zero
            for offset in beside:
                if is_active[side, line + offset]:
                    near = spread[line + offset]
                    for k in range(words, length - words):
                        fresh[k] |= near[k]
            added, met, left = _settle(
                free[line], seen[side, line], seen[1 - side, line], fresh, planes[side, plane, line]
            )
            is_done[side, line] = not left
            if added > 0:
                flooded += added
                wanted[following] = line
                following += 1
                if met >= 0 and met_line < 0:
                    met_line, met_word = line, met
        for i in range(size):
            is_active[side, active[side, i]] = False
        for i in range(following):
            active[side, i] = wanted[i]
            is_active[side, wanted[i]] = True
        sizes[side] = following
        # What is met is of the last level on both sides: had the other front met it earlier, it would have gone on to
        # the node before it, and the fronts would have met there.
        if met_line >= 0:
            common = planes[side, plane, met_line, met_word] & seen[1 - side, met_line, met_word]
            row, bit = met_line * rows + met_word // words, 64 * (met_word % words) + lowest_bit(common)
            return row, bit, -1, levels, flooded
    return -1, -1, 0 if sizes[0] == 0 else 1, levels, flooded


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
) -> IntArray:
    """Go back from the meeting node to one end, level by level: (level + 1, 2) rows and bits."""
    one = np.uint64(1)
    axes = len(step)
    nodes = np.empty((level + 1, 2), dtype=np.int64)
    nodes[0, 0], nodes[0, 1] = row, bit
    for place in range(1, level + 1):
        plane = (level - place) % 3
        best_row, best_bit, best = -1, -1, np.inf
        for offset in offsets:
            beside = row + offset
            for turn in range(-1, 2):
                other = bit + turn
                if other < 0 or other >= 64 * planes.shape[2]:
                    continue
                if not (planes[plane, beside, other >> 6] >> np.uint64(other & 63)) & one:
                    continue
                square = ((other - end_bit) * step[axes - 1]) ** 2
                for axis in range(axes - 1):
                    square += ((coordinates[beside, axis] - coordinates[end_row, axis]) * step[axis]) ** 2
                if square < best:
                    best_row, best_bit, best = beside, other, square
        row, bit = best_row, best_bit
        nodes[place, 0], nodes[place, 1] = row, bit
    return nodes
