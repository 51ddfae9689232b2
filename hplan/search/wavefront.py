"""Completeness where A* would be too slow: two wavefronts over whole words of nodes, one from each end.

A wavefront of level `l` holds the nodes that `l` moves reach and fewer do not. All neighbours of 64 nodes are found by
a few word operations, so millions of nodes are settled in milliseconds; where the fronts meet, the path has as few
moves as any. Levels are kept modulo 3, in bit planes: a neighbour's level differs by one at most, so the residue tells
which neighbours lead back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, ShortArray, WordArray, frozen
from hplan.base.deadline import check_deadline, is_up, until
from hplan.base.kernels import kernel
from hplan.search.bits import lowest_bit, popcount
from hplan.search.flood import flood_from, has_bit, in_lines
from hplan.search.lattice import Lattice, LatticeArrays, Node

#: Nodes reached by wavefronts before a flood is asked first whether they can meet at all.
PATIENT = 10_000_000


@dataclass(frozen=True, eq=False)
class Wavefronts:
    """The outcome of two wavefronts: a path, or the end that is enclosed.

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
    found = _grow(lattice, free, ends, PATIENT)
    if found.path is not None or found.enclosed:
        return found
    # In large regions a flood settles much faster if the ends are connected.
    goals_region, of_goals = flood_from(lattice, free, ends[1])
    if any(has_bit(goals_region, lattice.row_of(node), int(node[-1])) for node in ends[0]):
        return _grow(lattice, free, ends, 64 * free.size)
    starts_region, of_starts = flood_from(lattice, free, ends[0])
    if of_starts < of_goals:
        return Wavefronts(None, of_starts + of_goals, "start", starts_region)
    return Wavefronts(None, of_starts + of_goals, "goal", goals_region)


def _grow(lattice: Lattice, free: WordArray, ends: tuple[IntArray, IntArray], most: int) -> Wavefronts:
    """Grow both wavefronts; the result has neither a path nor an end enclosed where they reach `most` nodes before."""
    shape, neighbours = in_lines(lattice)
    # Memory that no front comes near is never touched, and costs nothing.
    seen = np.zeros((2, lattice.rows, lattice.words), dtype=np.uint64)
    planes = np.zeros((2, 3, lattice.rows, lattice.words), dtype=np.uint64)
    bits = free.reshape(shape), seen.reshape(2, *shape), planes.reshape(2, 3, *shape)
    inner = (np.arange(shape[1]) % lattice.words > 0).astype(np.uint64)
    grid = _LineBits(*bits, neighbours, inner, lattice.words, until())
    nodes = np.array([lattice.node(index) for side in ends for index in side])
    row, bit, side, levels, flooded = _meet(grid, nodes, len(ends[0]), most)
    check_deadline()
    nothing = np.empty((0, lattice.words), dtype=np.uint64)
    if row < 0:
        return Wavefronts(None, int(flooded), ("start", "goal", "")[side], nothing if side < 0 else seen[side].copy())
    met = Node(row, bit)
    back, onward = (_trace(planes[k], levels[k], lattice.arrays, lattice.node(ends[k][0]), met) for k in range(2))
    nodes = np.concatenate([back[::-1], onward[1:]])
    return Wavefronts(frozen(lattice.indices(nodes[:, 0], nodes[:, 1])), int(flooded), "", nothing)


class _LineBits(NamedTuple):
    """Bits of a grid for two fronts, its rows in lines along the axis before the last; side 0 is that of the start.

    Attributes:
        free: (lines, length) free bits.
        seen: (2, lines, length) bits that were reached.
        planes: (2, 3, lines, length) bits reached by level modulo 3.
        neighbours: Offsets of the neighbouring lines, the line itself among them.
        inner: (length,) 1 for words whose lower neighbour is of the same row.
        words: Words of a row.
        until: How long it may take (`hplan.base.deadline`).
    """

    free: WordArray
    seen: WordArray
    planes: WordArray
    neighbours: IntArray
    inner: WordArray
    words: int
    until: FloatArray


class _Fronts(NamedTuple):
    """Progress of both fronts; side 0 is that of the start.

    Attributes:
        active: (2, lines) the lines with news at the last level.
        sizes: (2,) how many these are.
        is_active: (2, lines) True for these.
        lows: (2, lines) first word with news in each of them.
        highs: (2, lines) one after the last word with news.
        unseen: (2, lines) free nodes that were not reached; -1: not counted yet.
        levels: (2,) the last level.
        news: (2,) nodes of the last level.
        spread: (lines, length) news of the lines of one front and their neighbours within the line.
        wanted: (lines,) the lines that this may reach.
    """

    active: ShortArray
    sizes: IntArray
    is_active: BoolArray
    lows: ShortArray
    highs: ShortArray
    unseen: ShortArray
    levels: IntArray
    news: IntArray
    spread: WordArray
    wanted: ShortArray


@kernel
def _meet(grid: _LineBits, ends: IntArray, starts: int, most: int) -> tuple[int, int, int, IntArray, int]:
    """Grow both fronts from (k, 2) ends until they meet or one is enclosed; fills `seen` and `planes`.

    A line is settled where some neighbouring line had news at the level before, and only along the rows next to these.
    The front of a level is its plane: what is older there has no unseen neighbours.

    Returns:
        Row and bit where they met (-1 where they did not), the side that is enclosed (-1 where they met, or where more
        than `most` nodes were reached before), the levels of both sides, and the nodes reached.
    """
    lines, length = grid.free.shape
    rows = length // grid.words
    state = _Fronts(
        active=np.empty((2, lines), dtype=np.int32),
        sizes=np.zeros(2, dtype=np.int64),
        is_active=np.zeros((2, lines), dtype=np.bool_),
        lows=np.full((2, lines), length, dtype=np.int32),
        highs=np.zeros((2, lines), dtype=np.int32),
        unseen=np.full((2, lines), -1, dtype=np.int32),
        levels=np.zeros(2, dtype=np.int64),
        news=np.zeros(2, dtype=np.int64),
        spread=np.empty((lines, length), dtype=np.uint64),
        wanted=np.empty(lines, dtype=np.int32),
    )
    levels, news = state.levels, state.news
    for number in range(len(ends)):
        side, row, bit = 0 if number < starts else 1, ends[number, 0], ends[number, 1]
        line, k = row // rows, row % rows * grid.words + (bit >> 6)
        mask = np.uint64(1) << np.uint64(bit & 63)
        if not state.is_active[side, line]:
            state.is_active[side, line] = True
            state.active[side, state.sizes[side]] = line
            state.sizes[side] += 1
        state.lows[side, line] = min(state.lows[side, line], k)
        state.highs[side, line] = max(state.highs[side, line], k + 1)
        news[side] += 0 if grid.seen[side, line, k] & mask else 1
        grid.seen[side, line, k] |= mask
        grid.planes[side, 0, line, k] |= mask
        if side == 1 and grid.seen[0, line, k] & mask:
            return row, bit, -1, levels, news[0] + news[1]
    flooded = news[0] + news[1]
    while news[0] > 0 and news[1] > 0:
        if flooded > most or is_up(grid.until):
            return -1, -1, -1, levels, flooded
        side = 0 if news[0] <= news[1] else 1
        count = _spread(grid, state, side)
        met_line, k = _gather(grid, state, side, count)
        flooded += news[side]
        # What is met is of the last level on both sides: had the other front met it earlier, it would have gone on to
        # the node before it, and the fronts would have met there.
        if met_line >= 0:
            common = grid.planes[side, levels[side] % 3, met_line, k] & grid.seen[1 - side, met_line, k]
            row, bit = met_line * rows + k // grid.words, 64 * (k % grid.words) + lowest_bit(common)
            return row, bit, -1, levels, flooded
    return -1, -1, 0 if news[0] == 0 else 1, levels, flooded


@kernel
def _spread(grid: _LineBits, state: _Fronts, side: int) -> int:
    """Fill `spread` with the last level of a side and its neighbours in the same line; returns the lines wanted.

    Whole rows are taken, first along them, then across them, one more row on either side. Words are taken from flat
    arrays by unsigned indices: these cannot be negative, and so the loops can take several words at once.
    """
    lines, length = grid.free.shape
    words, neighbours, wanted = grid.words, grid.neighbours, state.wanted
    active, lows, highs, unseen = state.active[side], state.lows[side], state.highs[side], state.unseen[side]
    one, top, zero, lowest = np.uint64(1), np.uint64(63), np.uint64(0), np.uintp(1)
    inner, along, is_wanted = grid.inner, np.zeros(length, dtype=np.uint64), np.zeros(lines, dtype=np.bool_)
    spread, plane = state.spread.ravel(), grid.planes[side, state.levels[side] % 3].ravel()
    count = 0
    for i in range(state.sizes[side]):
        line = active[i]
        low = (lows[line] // words - 1) * words
        high = ((highs[line] - 1) // words + 2) * words
        lows[line], highs[line] = low, high
        base = np.uintp(line * length)
        begin, end, row = np.uintp(low + words), np.uintp(high - words), np.uintp(words)
        if words == 1:
            for k in range(begin, end):
                front = plane[base + k]
                along[k] = front | (front << one) | (front >> one)
        else:
            for k in range(begin, end):
                front = plane[base + k]
                below = (plane[base + k - lowest] >> top) * inner[k]
                above = (plane[base + k + lowest] << top) * inner[k + lowest]
                along[k] = front | (front << one) | (front >> one) | below | above
        for k in range(begin, end):
            spread[base + k] = along[k - row] | along[k] | along[k + row]
        for k in range(row):
            spread[base + begin - row + k], spread[base + end + k] = along[begin + k], along[end - row + k]
        for k in range(begin, end):
            along[k] = zero
        for offset in neighbours:
            other = line + offset
            if not is_wanted[other] and unseen[other] != 0:
                is_wanted[other] = True
                wanted[count] = other
                count += 1
    return count


@kernel
def _gather(grid: _LineBits, state: _Fronts, side: int, count: int) -> tuple[int, int]:
    """Settle the next level of a side in `count` lines wanted; line and word where it meets the other side, or -1."""
    lines, length = grid.free.shape
    neighbours, wanted, active = grid.neighbours, state.wanted, state.active[side]
    state.levels[side] += 1
    is_active, lows, highs, unseen = state.is_active[side], state.lows[side], state.highs[side], state.unseen[side]
    next_lows, next_highs = np.empty(lines, dtype=np.int32), np.empty(lines, dtype=np.int32)
    fresh, zero = np.zeros(length, dtype=np.uint64), np.uint64(0)
    free, seen, spread = grid.free.ravel(), grid.seen[side].ravel(), state.spread.ravel()
    plane = grid.planes[side, state.levels[side] % 3].ravel()
    theirs, met_line, met_word, following, news = grid.seen[1 - side].ravel(), -1, -1, 0, 0
    for i in range(count):
        line = wanted[i]
        base = np.uintp(line * length)
        if unseen[line] < 0:
            nodes = 0
            for k in range(np.uintp(length)):
                nodes += popcount(free[base + k] & ~seen[base + k])
            unseen[line] = nodes
            if nodes == 0:
                continue
        low, high = length, 0
        for offset in neighbours:
            if is_active[line + offset]:
                low, high = min(low, lows[line + offset]), max(high, highs[line + offset])
        for k in range(np.uintp(low), np.uintp(high)):
            fresh[k] = zero
        for offset in neighbours:
            other = line + offset
            if is_active[other]:
                other_base = np.uintp(other * length)
                for k in range(np.uintp(lows[other]), np.uintp(highs[other])):
                    fresh[k] |= spread[other_base + k]
        # Add what is free and unseen of it.
        some, fresh_nodes = zero, 0
        for k in range(np.uintp(low), np.uintp(high)):
            fresh[k] &= free[base + k] & ~seen[base + k]
            some |= fresh[k]
        if some == zero:
            continue
        for k in range(np.uintp(low), np.uintp(high)):
            seen[base + k] |= fresh[k]
            plane[base + k] |= fresh[k]
            fresh_nodes += popcount(fresh[k])
        unseen[line] -= fresh_nodes
        news += fresh_nodes
        if met_line < 0:
            for k in range(low, high):
                if fresh[k] & theirs[base + np.uintp(k)]:
                    met_line, met_word = line, k
                    break
        while fresh[low] == zero:
            low += 1
        while fresh[high - 1] == zero:
            high -= 1
        next_lows[line], next_highs[line] = low, high
        wanted[following] = line
        following += 1
    for i in range(state.sizes[side]):
        is_active[active[i]] = False
    for i in range(following):
        line = wanted[i]
        active[i], is_active[line] = line, True
        lows[line], highs[line] = next_lows[line], next_highs[line]
    state.sizes[side], state.news[side] = following, news
    return met_line, met_word


@kernel
def _trace(planes: WordArray, level: int, lattice: LatticeArrays, end: Node, met: Node) -> IntArray:
    """Go back from the node where the fronts met to one end, level by level: (level + 1, 2) rows and bits."""
    coordinates, step = lattice.row_coordinates, lattice.step
    axes = len(step)
    row, bit = met.row, met.bit
    nodes = np.empty((level + 1, 2), dtype=np.int64)
    nodes[0, 0], nodes[0, 1] = row, bit
    for place in range(1, level + 1):
        plane = (level - place) % 3
        best_row, best_bit, best = -1, -1, np.inf
        for offset in lattice.row_offsets:
            neighbour = row + offset
            for turn in range(-1, 2):
                other = bit + turn
                if other < 0 or other >= 64 * planes.shape[2]:
                    continue
                if not (planes[plane, neighbour, other >> 6] >> np.uint64(other & 63)) & np.uint64(1):
                    continue
                square = ((other - end.bit) * step[axes - 1]) ** 2
                for axis in range(axes - 1):
                    square += ((coordinates[neighbour, axis] - coordinates[end.row, axis]) * step[axis]) ** 2
                if square < best:
                    best_row, best_bit, best = neighbour, other, square
        row, bit = best_row, best_bit
        nodes[place, 0], nodes[place, 1] = row, bit
    return nodes
