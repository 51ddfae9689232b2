"""Jump point search on all slices of a 3-D grid in one pass (Harabor & Grastien, AAAI 2011).

Most shortest paths over an 8-connected plane are the same steps in another order. Jump point search keeps the one
that moves diagonally first, and so opens only *jump points*: places where an obstacle's corner lets a path turn. It
needs of the costs only that a diagonal step is longer than either straight one and shorter than both together, so the
axes may have unequal steps. Cutting corners is allowed, as everywhere in this package.

A place (i, j) of the plane is one word, each bit a slice. The corners, and the places from which a scan in a direction
meets a jump point before an obstacle (`lead`), take a few word operations for 64 slices together. The searches then
scan only where it pays.

Directions are numbered 0 to 7: +j, -j, +i, -i, then (+i, +j), (+i, -j), (-i, +j), (-i, -j). A path that arrives at a
place in direction k may turn there to `_TURNS[k]`, off the diagonal-first order, only around a corner: where the place
in direction `_SIDES[k]` is occupied and the one in direction `_TURNS[k]` is free.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray, WordArray
from hplan.base.deadline import is_up
from hplan.base.kernels import inlined, kernel
from hplan.grid.heap import NEW, begin, pop, priority, push

#: (8, 2) the directions in which an obstacle lets a path turn.
_SIDES = np.array([[2, 3], [2, 3], [0, 1], [0, 1], [1, 3], [0, 3], [1, 2], [0, 2]])
#: (8, 2) the directions it can then turn to.
_TURNS = np.array([[4, 6], [5, 7], [4, 5], [6, 7], [5, 6], [4, 7], [7, 4], [6, 5]])
#: (8, 2) the straight parts of each direction.
_STRAIGHTS = np.array([[0, 0], [1, 1], [2, 2], [3, 3], [0, 2], [1, 2], [0, 3], [1, 3]])
#: For each direction the directions that go on from a jump point without a corner, one bit each.
_ONWARD = np.array([0b1, 0b10, 0b100, 0b1000, 0b10101, 0b100110, 0b1001001, 0b10001010])
_EVERY = 0b11111111


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


class _SliceBlock(NamedTuple):
    """A block of 64 slices.

    Attributes:
        free: (places,) free bits, with a border of occupied places.
        lead: (8, places) for each direction the slices in which a scan meets a jump point or the goal; 0 in the border.
        ends: Start and goal.
        offsets: (8,) distance to the neighbouring place in each direction.
        lengths: (8,) length of a step in each direction.
    """

    free: WordArray
    lead: WordArray
    ends: PlaneEnds
    offsets: IntArray
    lengths: FloatArray


class _SearchArrays(NamedTuple):
    """Arrays of a search, used again for every slice; entries of a place are valid if `seen` names the slice."""

    seen: ShortArray
    cost: FloatArray
    parent: ShortArray
    arrival: ShortArray  # direction from the parent
    pending: ShortArray  # directions to go on in, one bit each
    tried: ShortArray  # directions already gone
    slot: ShortArray
    keys: FloatArray
    entries: ShortArray


@kernel
def jump_slices(
    free: WordArray, feasible: WordArray, first: int, last: int, ends: PlaneEnds, steps: FloatArray, until: FloatArray
) -> tuple[IntArray, IntArray, int]:
    """Shortest path from the start's row to the goal's in each feasible slice from `first` to `last`.

    Args:
        free: (rows, words) bits with border.
        feasible: (words,) slices that have a path.
        ends: Rows in which every path starts and ends.
        steps: (2,) weights of a step along axes i and j.
        until: How long it may take (`hplan.base.deadline`).

    Returns:
        Rows of all paths one after the other, (last - first + 2,) where each slice's path begins in them, and the
        number of expansions: jump points taken from the open lists.
    """
    rows = free.shape[0]
    diagonal = math.hypot(steps[0], steps[1])
    lengths = np.array([steps[1], steps[1], steps[0], steps[0], diagonal, diagonal, diagonal, diagonal])
    offsets = _offsets(ends.width)
    plane = _SliceBlock(np.empty(rows, dtype=np.uint64), np.zeros((8, rows), dtype=np.uint64), ends, offsets, lengths)
    work = _SearchArrays(
        seen=np.full(rows, -1, dtype=np.int32),
        cost=np.empty(rows),
        parent=np.empty(rows, dtype=np.int32),
        arrival=np.empty(rows, dtype=np.int32),
        pending=np.empty(rows, dtype=np.int32),
        tried=np.empty(rows, dtype=np.int32),
        slot=np.empty(rows, dtype=np.int32),
        keys=np.empty(rows),
        entries=np.empty(rows, dtype=np.int32),
    )
    parent, arrival = work.parent, work.arrival
    path_rows = np.empty(4096, dtype=np.int64)
    begins = np.zeros(last - first + 2, dtype=np.int64)
    expansions = 0
    base = first - 64  # `plane` holds the 64 slices from here on
    for number in range(first, last + 1):
        begin = begins[number - first]
        begins[number - first + 1] = begin
        if not (feasible[number >> 6] >> np.uint64(number & 63)) & np.uint64(1):
            continue
        if is_up(until):
            break
        if number >= base + 64:
            base = number
            _take_slices(free, base, plane.free)
            _fill_leads(plane)
        expansions += _search_slice(plane, number, np.uint64(1) << np.uint64(number - base), work)
        length = 1
        row = ends.goal
        while row != ends.start:
            length += _between(row, parent[row], offsets[arrival[row]])
            row = parent[row]
        while begin + length > len(path_rows):
            path_rows = np.concatenate((path_rows, np.empty_like(path_rows)))
        row = ends.goal
        place = begin + length - 1
        path_rows[place] = row
        while row != ends.start:
            for _ in range(_between(row, parent[row], offsets[arrival[row]])):
                place -= 1
                path_rows[place] = path_rows[place + 1] - offsets[arrival[row]]
            row = parent[row]
        begins[number - first + 1] = begin + length
    return path_rows[: begins[-1]].copy(), begins, expansions


@inlined
def _between(row: int, other: int, offset: int) -> int:
    """Steps of one direction from `other` to `row`."""
    return (row - other) // offset


@kernel
def _take_slices(free: WordArray, first: int, plane: WordArray) -> None:
    """Fill (rows,) `plane` with 64 slices from `first` on."""
    rows, words = free.shape
    word, shift = first >> 6, np.uint64(first & 63)
    if shift != np.uint64(0) and word + 1 < words:
        for row in range(rows):
            plane[row] = (free[row, word] >> shift) | (free[row, word + 1] << (np.uint64(64) - shift))
    else:
        for row in range(rows):
            plane[row] = free[row, word] >> shift


@kernel
def _offsets(width: int) -> IntArray:
    """(8,) distance to the neighbouring place in each direction, with `width` places along axis j."""
    return np.array([1, -1, width, -width, width + 1, width - 1, 1 - width, -width - 1])


@kernel
def _fill_leads(plane: _SliceBlock) -> None:
    """Fill `lead`: the places from which a scan meets a jump point, or the goal, before it meets an obstacle."""
    for k in range(8):
        if k < 2:
            _lead_along_j(plane, k)
        else:
            _lead_along_i(plane, k)
        # The places that see the goal in this direction.
        bits, place = plane.free[plane.ends.goal], plane.ends.goal - plane.offsets[k]
        while bits != np.uint64(0):
            plane.lead[k, place] |= bits
            bits &= plane.free[place]
            place -= plane.offsets[k]


@kernel
def _lead_along_j(plane: _SliceBlock, k: int) -> None:
    """`lead` in direction 0 or 1, from place to place: a scan stops at a corner of the next one, or goes on there."""
    width, step = plane.ends.width, plane.offsets[k]
    grid, lead = plane.free.reshape(-1, width), plane.lead[k].reshape(-1, width)
    for i in range(1, len(grid) - 1):
        above, here, below, to = grid[i - 1], grid[i], grid[i + 1], lead[i]
        bits = np.uint64(0)
        for n in range(2, width - 1):
            j = width - 1 - n if k == 0 else n
            bits |= (~below[j + step] & below[j + 2 * step]) | (~above[j + step] & above[j + 2 * step])
            bits &= here[j + step]
            to[j] = bits


@kernel
def _lead_along_i(plane: _SliceBlock, k: int) -> None:
    """`lead` in directions 2 to 7, row by row: a diagonal scan also stops where a straight one meets a jump point."""
    free, lead, width, offset = plane.free, plane.lead, plane.ends.width, plane.offsets[k]
    side, other_side = plane.offsets[_SIDES[k, 0]], plane.offsets[_SIDES[k, 1]]
    turn, other_turn = plane.offsets[_TURNS[k, 0]], plane.offsets[_TURNS[k, 1]]
    rows, along_j = len(free) // width, offset - width if offset > 0 else offset + width
    count = width - 2 - abs(along_j)
    for n in range(2, rows - 1):
        # A run of places of a row, and the places next to them in this direction.
        place = (rows - 1 - n if offset > 0 else n) * width + (2 if along_j < 0 else 1)
        a, b = place + offset, place + offset + count
        to, inside, beyond = lead[k, place : place + count], free[a:b], lead[k, a:b]
        straight, other_straight = lead[_STRAIGHTS[k, 0], a:b], lead[_STRAIGHTS[k, 1], a:b]
        lateral, other_lateral = free[a + side : b + side], free[a + other_side : b + other_side]
        ahead, other_ahead = free[a + turn : b + turn], free[a + other_turn : b + other_turn]
        for m in range(count):
            corner = (~lateral[m] & ahead[m]) | (~other_lateral[m] & other_ahead[m])
            to[m] = inside[m] & (corner | straight[m] | other_straight[m] | beyond[m])


@kernel
def _search_slice(plane: _SliceBlock, number: int, bit: Any, work: _SearchArrays) -> int:
    """A* over the jump points of one slice that has a path; leaves `parent` and `arrival` in `work`.

    A place reached at the same cost from several directions goes on in the directions of all of them.

    Args:
        plane: The block of slices that it is one of.
        bit: Its bit in the words of the block, uint64.

    Returns:
        The number of expansions.
    """
    free, lead, ends, offsets, lengths = plane
    width, start, goal = ends
    seen, cost, parent, arrival, pending, tried, slot, keys, entries = work
    goal_i, goal_j = goal // width, goal % width
    whole = _octile(start, width, goal_i, goal_j, lengths)
    scale, tolerance = 1.0 / max(whole, 1e-12), 1e-12 * whole
    seen[start], cost[start], slot[start] = number, 0.0, NEW
    pending[start], tried[start] = _EVERY, 0
    size = begin(keys, entries, slot, start)
    expansions = 0
    while size > 0:
        place = pop(keys, entries, slot, size)
        size -= 1
        expansions += 1
        if place == goal:
            break
        directions = pending[place]
        pending[place] = 0
        tried[place] |= directions
        for k in range(8):
            if not (directions >> k) & 1 or not lead[k, place] & bit:
                continue
            # Scan to the jump point; `lead` has shown that there is one.
            offset = offsets[k]
            side, other_side = offsets[_SIDES[k, 0]], offsets[_SIDES[k, 1]]
            turn, other_turn = offsets[_TURNS[k, 0]], offsets[_TURNS[k, 1]]
            found = place
            scanning = True
            while scanning:
                found += offset
                stop = ~free[found + side] & free[found + turn]
                stop |= ~free[found + other_side] & free[found + other_turn]
                if k >= 4:
                    stop |= lead[_STRAIGHTS[k, 0], found] | lead[_STRAIGHTS[k, 1], found]
                scanning = found != goal and stop & bit == np.uint64(0)
            new = cost[place] + _between(found, place, offset) * lengths[k]
            if seen[found] != number:
                seen[found], cost[found], slot[found] = number, np.inf, NEW
            if new > cost[found] + tolerance:
                continue
            onward = _ONWARD[k]
            if not free[found + side] & bit:
                onward |= 1 << _TURNS[k, 0]
            if not free[found + other_side] & bit:
                onward |= 1 << _TURNS[k, 1]
            if new < cost[found] - tolerance:
                cost[found], parent[found], arrival[found] = new, place, k
                pending[found], tried[found] = onward, 0
            elif onward & ~(pending[found] | tried[found]):
                pending[found] |= onward & ~tried[found]
                if slot[found] >= 0:
                    continue
            else:
                continue
            ahead = _octile(found, width, goal_i, goal_j, lengths)
            size = push(keys, entries, slot, size, priority(new, ahead, scale), found)
    return expansions


@inlined
def _octile(place: int, width: int, goal_i: int, goal_j: int, lengths: FloatArray) -> float:
    """Length of the shortest path in an empty plane."""
    along_i, along_j = abs(place // width - goal_i), abs(place % width - goal_j)
    both = min(along_i, along_j)
    length: float = both * lengths[4] + (along_i - both) * lengths[2] + (along_j - both) * lengths[0]
    return length
