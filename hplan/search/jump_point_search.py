"""Jump point search on all slices of a 3-D grid in one pass (Harabor & Grastien, AAAI 2011).

Most shortest paths over an 8-connected plane are the same steps in another order. Jump point search keeps the one
that moves diagonally first, and so opens only *jump points*: places where an obstacle's corner lets a path turn. It
needs of the costs only that a diagonal step is longer than either straight one and shorter than both together, so the
axes may have unequal steps. Cutting corners is allowed, as everywhere in this package.

A place (i, j) of the plane is one word, each bit a slice. Where corners are, and whether a scan from a place in
a direction meets a jump point before an obstacle (`lead`), are a few word operations for 64 slices together
(`jump_leads`). The searches then scan only where it pays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray, WordArray
from hplan.base.kernels import inlined, kernel
from hplan.search.heap import NEW, begin, pop, push
from hplan.search.jump_leads import SIDES, STRAIGHTS, TURNS, direction_offsets, fill_leads

#: For each direction the directions that go on from a jump point without a corner, one bit each.
_ONWARD = np.array([0b1, 0b10, 0b100, 0b1000, 0b10101, 0b100110, 0b1001001, 0b10001010])
_EVERY = 0b11111111


class _Work(NamedTuple):
    """Arrays of a search, used again for every slice; what they say of a place holds if `seen` names the slice."""

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
    free: WordArray,
    feasible: WordArray,
    width: int,
    first: int,
    last: int,
    start: int,
    goal: int,
    steps: FloatArray,
) -> tuple[IntArray, IntArray, int]:
    """Shortest path from the start's row to the goal's in each feasible slice from `first` to `last`.

    Args:
        free: (rows, words) bits with border.
        feasible: (words,) slices that have a path.
        width: Bordered rows along axis j.
        first: First slice to search.
        last: Last slice to search.
        start: Bordered row in which every path starts.
        goal: Bordered row in which every path ends.
        steps: (2,) weights of a step along axes i and j.

    Returns:
        Rows of all paths one after the other, (last - first + 2,) where each slice's path begins in them, and the
        number of expansions: jump points taken from the open lists.
    """
    rows = free.shape[0]
    plane = np.empty(rows, dtype=np.uint64)
    lead = np.zeros((8, rows), dtype=np.uint64)
    offsets = direction_offsets(width)
    diagonal = math.hypot(steps[0], steps[1])
    lengths = np.array([steps[1], steps[1], steps[0], steps[0], diagonal, diagonal, diagonal, diagonal])
    work = _Work(
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
    base = first - 64  # `plane` and `lead` hold the 64 slices from here on
    for number in range(first, last + 1):
        begin = begins[number - first]
        begins[number - first + 1] = begin
        if not (feasible[number >> 6] >> np.uint64(number & 63)) & np.uint64(1):
            continue
        if number >= base + 64:
            base = number
            _take_slices(free, base, plane)
            fill_leads(plane, lead, width, goal)
        expansions += _search_slice(plane, lead, number, base, width, start, goal, offsets, lengths, work)
        length = 1
        row = goal
        while row != start:
            length += _between(row, parent[row], offsets[arrival[row]])
            row = parent[row]
        while begin + length > len(path_rows):
            path_rows = np.concatenate((path_rows, np.empty_like(path_rows)))
        row = goal
        place = begin + length - 1
        path_rows[place] = row
        while row != start:
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
def _search_slice(
    plane: WordArray,
    lead: WordArray,
    number: int,
    base: int,
    width: int,
    start: int,
    goal: int,
    offsets: IntArray,
    lengths: FloatArray,
    work: _Work,
) -> int:
    """A* over the jump points of one slice that has a path; leaves `parent` and `arrival` in `work`.

    A place reached at the same cost from several directions goes on in the directions of all of them.

    Args:
        plane: (places,) free bits of 64 slices.
        lead: (8, places) from where a scan meets a jump point.
        number: Slice to search.
        base: Slice of the lowest bit.
        width: Places along axis j with border.
        start: Place of the start.
        goal: Place of the goal.
        offsets: (8,) distance to the neighbouring place in each direction.
        lengths: (8,) length of a step in each direction.
        work: Arrays to use.

    Returns:
        The number of expansions.
    """
    seen, cost, parent, arrival, pending, tried, slot, keys, entries = work
    bit = np.uint64(1) << np.uint64(number - base)
    goal_i, goal_j = goal // width, goal % width
    whole = _octile(start, width, goal_i, goal_j, lengths)
    # Keys as in `astar`: f in steps of 1e-10 of the whole, ties by the way to go.
    share = 1.0 / max(whole, 1e-12)
    tolerance = 1e-12 * whole
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
            side, other_side = offsets[SIDES[k, 0]], offsets[SIDES[k, 1]]
            turn, other_turn = offsets[TURNS[k, 0]], offsets[TURNS[k, 1]]
            found = place
            scanning = True
            while scanning:
                found += offset
                stop = (~plane[found + side] & plane[found + turn]) | (
                    ~plane[found + other_side] & plane[found + other_turn]
                )
                if k >= 4:
                    stop |= lead[STRAIGHTS[k, 0], found] | lead[STRAIGHTS[k, 1], found]
                scanning = found != goal and stop & bit == np.uint64(0)
            new = cost[place] + _between(found, place, offset) * lengths[k]
            if seen[found] != number:
                seen[found], cost[found], slot[found] = number, np.inf, NEW
            if new > cost[found] + tolerance:
                continue
            onward = _ONWARD[k]
            if not plane[found + side] & bit:
                onward |= 1 << TURNS[k, 0]
            if not plane[found + other_side] & bit:
                onward |= 1 << TURNS[k, 1]
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
            key = math.floor((new + ahead) * share * 1e10 + 0.5) + min(0.9, 0.1 * ahead * share)
            size = push(keys, entries, slot, size, key, found)
    return expansions


@inlined
def _octile(place: int, width: int, goal_i: int, goal_j: int, lengths: FloatArray) -> float:
    """Length of the shortest path in an empty plane."""
    along_i, along_j = abs(place // width - goal_i), abs(place % width - goal_j)
    both = min(along_i, along_j)
    length: float = both * lengths[4] + (along_i - both) * lengths[2] + (along_j - both) * lengths[0]
    return length
