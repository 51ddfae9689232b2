"""Completeness where A* would be too slow: two wavefronts over whole words of nodes, one from each end.

A wavefront of level `l` holds the nodes that `l` moves reach and fewer do not. All neighbours of 64 nodes are found by
a few word operations, so millions of nodes are settled in milliseconds; where the fronts meet, the path has as few
moves as any. Levels are kept modulo 3, in bit planes: a neighbour's level differs by one at most, so the residue tells
which way leads back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, WordArray, frozen
from hplan.base.kernels import kernel
from hplan.search.bits import lowest_bit, popcount
from hplan.search.flood import flood_from, has_bit, in_lines
from hplan.search.lattice import Lattice

#: Nodes reached by wavefronts before a flood is asked first whether they can meet at all.
PATIENT = 10_000_000


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
    ends = np.atleast_2d(starts), np.atleast_2d(goals)
    found = _fronts(lattice, free, ends, PATIENT)
    if found.path is not None or found.enclosed:
        return found
    # Large regions: whether they are one is settled much faster by a flood.
    goals_region, of_goals = flood_from(lattice, free, ends[1])
    if any(has_bit(goals_region, lattice.row_of(node), int(node[-1])) for node in ends[0]):
        return _fronts(lattice, free, ends, 64 * free.size)
    starts_region, of_starts = flood_from(lattice, free, ends[0])
    if of_starts < of_goals:
        return Wavefronts(None, of_starts + of_goals, "start", starts_region)
    return Wavefronts(None, of_starts + of_goals, "goal", goals_region)


def _fronts(lattice: Lattice, free: WordArray, ends: tuple[IntArray, IntArray], most: int) -> Wavefronts:
    """What two wavefronts find; neither a path nor an end enclosed where they reached `most` nodes before."""
    end_rows = np.array([lattice.row_of(node) for side in ends for node in side])
    end_bits = np.array([int(node[-1]) for side in ends for node in side])
    shape, beside = in_lines(lattice)
    # Memory that no front comes near is never touched, and costs nothing.
    seen = np.zeros((2, lattice.rows, lattice.words), dtype=np.uint64)
    planes = np.zeros((2, 3, lattice.rows, lattice.words), dtype=np.uint64)
    row, bit, side, levels, flooded = _meet(
        free.reshape(shape),
        seen.reshape(2, *shape),
        planes.reshape(2, 3, *shape),
        beside,
        lattice.words,
        end_rows,
        end_bits,
        len(ends[0]),
        most,
    )
    nothing = np.empty((0, lattice.words), dtype=np.uint64)
    if row < 0:
        return Wavefronts(None, int(flooded), ("start", "goal", "")[side], nothing if side < 0 else seen[side].copy())
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
    return Wavefronts(frozen(lattice.indices(nodes[:, 0], nodes[:, 1])), int(flooded), "", nothing)


@kernel
def _meet(
    free: WordArray,
    seen: WordArray,
    planes: WordArray,
    beside: IntArray,
    words: int,
    end_rows: IntArray,
    end_bits: IntArray,
    starts: int,
    most: int,
) -> tuple[int, int, int, IntArray, int]:
    """Grow both fronts, line by line, until they meet or one is enclosed; fills `seen` and `planes`.

    A line is settled where some neighbouring line had news at the level before, and only along the rows beside these.
    The front of a level is its plane: what is older there has no unseen neighbours. Words are taken from
    flat arrays by unsigned indices: these cannot be negative, and so the loops can take several words at once.

    Returns:
        Row and bit where they met (-1 where they did not), the side that is enclosed (-1 where they met, or where more
        than `most` nodes were reached before), the levels of both sides, and the nodes reached.
    """
    lines, length = free.shape
    rows = length // words
    one, top, zero, lowest = np.uint64(1), np.uint64(63), np.uint64(0), np.uintp(1)
    inner = np.ones(length, dtype=np.uint64)  # 1 for words whose lower neighbour is of the same row
    for k in range(0, length, words):
        inner[k] = zero
    along, fresh = np.zeros(length, dtype=np.uint64), np.zeros(length, dtype=np.uint64)
    spread = np.empty(lines * length, dtype=np.uint64)
    free_words, seen_words, plane_words = free.ravel(), seen.ravel(), planes.ravel()
    is_active = np.zeros((2, lines), dtype=np.bool_)
    left = np.full((2, lines), -1, dtype=np.int32)  # free nodes that are unseen; -1: not counted yet
    lows, highs = np.empty((2, lines), dtype=np.int32), np.empty((2, lines), dtype=np.int32)  # words with news
    next_lows, next_highs = np.empty(lines, dtype=np.int32), np.empty(lines, dtype=np.int32)
    stamp = np.zeros(lines, dtype=np.int32)
    active = np.empty((2, lines), dtype=np.int32)
    wanted = np.empty(lines, dtype=np.int32)
    sizes, levels, news = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    flooded, steps = 0, 0
    for number in range(len(end_rows)):
        side = 0 if number < starts else 1
        line, k = end_rows[number] // rows, (end_rows[number] % rows) * words + (end_bits[number] >> 6)
        mask = one << np.uint64(end_bits[number] & 63)
        if not is_active[side, line]:
            is_active[side, line] = True
            lows[side, line], highs[side, line] = length, 0
            active[side, sizes[side]] = line
            sizes[side] += 1
        lows[side, line], highs[side, line] = min(lows[side, line], k), max(highs[side, line], k + 1)
        news[side] += 0 if seen[side, line, k] & mask else 1
        seen[side, line, k] |= mask
        planes[side, 0, line, k] |= mask
        if side == 1 and seen[0, line, k] & mask:
            return end_rows[number], end_bits[number], -1, levels, news[0] + news[1]
    flooded = news[0] + news[1]
    while news[0] > 0 and news[1] > 0:
        if flooded > most:
            return -1, -1, -1, levels, flooded
        side = 0 if news[0] <= news[1] else 1
        plane = levels[side] % 3
        steps += 1
        count = 0
        for i in range(sizes[side]):
            line = active[side, i]
            # The nodes of whole rows and their neighbours in the same line: first along the rows, then across them, one
            # more row on either side.
            low = (lows[side, line] // words - 1) * words
            high = ((highs[side, line] - 1) // words + 2) * words
            lows[side, line], highs[side, line] = low, high
            base, plane_base = np.uintp(line * length), np.uintp(((3 * side + plane) * lines + line) * length)
            begin, end, row = np.uintp(low + words), np.uintp(high - words), np.uintp(words)
            if words == 1:
                for k in range(begin, end):
                    front = plane_words[plane_base + k]
                    along[k] = front | (front << one) | (front >> one)
            else:
                for k in range(begin, end):
                    front = plane_words[plane_base + k]
                    below = (plane_words[plane_base + k - lowest] >> top) * inner[k]
                    above = (plane_words[plane_base + k + lowest] << top) * inner[k + lowest]
                    along[k] = front | (front << one) | (front >> one) | below | above
            for k in range(begin, end):
                spread[base + k] = along[k - row] | along[k] | along[k + row]
            for k in range(row):
                spread[base + begin - row + k], spread[base + end + k] = along[begin + k], along[end - row + k]
            for k in range(begin, end):
                along[k] = zero
            for offset in beside:
                other = line + offset
                if stamp[other] != steps and left[side, other] != 0:
                    stamp[other] = steps
                    wanted[count] = other
                    count += 1
        levels[side] += 1
        plane = levels[side] % 3
        size = sizes[side]
        met_line, met_word, following, added = -1, -1, 0, 0
        for i in range(count):
            line = wanted[i]
            if left[side, line] < 0:
                nodes = 0
                for k in range(length):
                    nodes += popcount(free[line, k] & ~seen[side, line, k])
                left[side, line] = nodes
                if nodes == 0:
                    continue
            # Gather what comes from the neighbouring lines.
            low, high = length, 0
            for offset in beside:
                if is_active[side, line + offset]:
                    low, high = min(low, lows[side, line + offset]), max(high, highs[side, line + offset])
            for k in range(np.uintp(low), np.uintp(high)):
                fresh[k] = zero
            for offset in beside:
                other = line + offset
                if is_active[side, other]:
                    begin, end = np.uintp(lows[side, other]), np.uintp(highs[side, other])
                    base = np.uintp(other * length)
                    for k in range(begin, end):
                        fresh[k] |= spread[base + k]
            # Add what is free and unseen of it.
            some, base, fresh_nodes = zero, np.uintp(line * length), 0
            seen_base = np.uintp((side * lines + line) * length)
            plane_base = np.uintp(((3 * side + plane) * lines + line) * length)
            for k in range(np.uintp(low), np.uintp(high)):
                fresh[k] &= free_words[base + k] & ~seen_words[seen_base + k]
                some |= fresh[k]
            if some != zero:
                for k in range(np.uintp(low), np.uintp(high)):
                    seen_words[seen_base + k] |= fresh[k]
                    plane_words[plane_base + k] |= fresh[k]
                    fresh_nodes += popcount(fresh[k])
            if fresh_nodes == 0:
                continue
            left[side, line] -= fresh_nodes
            added += fresh_nodes
            if met_line < 0:
                for k in range(low, high):
                    if fresh[k] & seen[1 - side, line, k]:
                        met_line, met_word = line, k
                        break
            while fresh[low] == zero:
                low += 1
            while fresh[high - 1] == zero:
                high -= 1
            next_lows[line], next_highs[line] = low, high
            wanted[following] = line
            following += 1
        for i in range(size):
            is_active[side, active[side, i]] = False
        for i in range(following):
            line = wanted[i]
            active[side, i] = line
            is_active[side, line] = True
            lows[side, line], highs[side, line] = next_lows[line], next_highs[line]
        sizes[side], news[side] = following, added
        flooded += added
        # What is met is of the last level on both sides: had the other front met it earlier, it would have gone on to
        # the node before it, and the fronts would have met there.
        if met_line >= 0:
            common = planes[side, plane, met_line, met_word] & seen[1 - side, met_line, met_word]
            row, bit = met_line * rows + met_word // words, 64 * (met_word % words) + lowest_bit(common)
            return row, bit, -1, levels, flooded
    return -1, -1, 0 if news[0] == 0 else 1, levels, flooded


@kernel
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
