"""What the start is connected to, found for whole words of nodes at once.

Neighbouring rows are joined by word operations, so one sweep over the rows moves the front in 64 slices together.
Sweeps alternate in direction until nothing changes: the fixed point is the connected component, whatever the order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, IntArray, WordArray, frozen
from hplan.base.kernels import kernel
from hplan.search.bits import lowest_bit, popcount
from hplan.search.endpoints import check_occupancy, checked_node
from hplan.search.grid import Occupancy
from hplan.search.lattice import Lattice


def flood_slices(
    lattice: Lattice, free: WordArray, start_row: int, wanted: WordArray, goal_row: int | None = None
) -> tuple[WordArray, int]:
    """Flood slices of the last axis, each on its own, from the start's row.

    Args:
        lattice: Geometry of the grid.
        free: (rows, words) bits with border.
        start_row: Bordered row in which every slice starts.
        wanted: (words,) the slices to flood.
        goal_row: Stop where every wanted slice that is free in this row is reached there; None to reach all nodes.

    Returns:
        (rows, words) reached bits and their number.
    """
    reached = np.zeros_like(free)
    reached[start_row] = free[start_row] & wanted
    goal = start_row if goal_row is None else goal_row
    enough = free[goal] & reached[start_row]
    if goal_row is None:
        enough = ~enough  # which is never what is reached there
    line = lattice.padded[-1]
    shape, beside = in_lines(lattice)
    beside = beside[beside != 0]
    count = _flood_slices(
        free.reshape(shape), reached.reshape(shape), lattice.words, beside, start_row // line,
        goal // line, goal % line * lattice.words, enough,
    )  # fmt: skip
    return reached, int(count)


def flood_from(lattice: Lattice, free: WordArray, nodes: IntArray) -> tuple[WordArray, int]:
    """Flood the whole grid from free nodes, slices joined.

    Args:
        lattice: Geometry of the grid.
        free: (rows, words) bits with border.
        nodes: (k, d) or (d,) node indices.

    Returns:
        (rows, words) bits of all nodes connected to them, and their number.
    """
    reached = np.zeros_like(free)
    for node in np.atleast_2d(nodes):
        reached[lattice.row_of(node), node[-1] >> 6] |= np.uint64(1) << np.uint64(node[-1] & 63)
    shape, beside = in_lines(lattice)
    count = _flood_whole(free.reshape(shape), reached.reshape(shape), lattice.words, beside)
    return reached, int(count)


def in_lines(lattice: Lattice) -> tuple[tuple[int, int], IntArray]:
    """How rows stand in lines along the axis before the last, (lines, words of a line), and where the lines beside are.

    Neighbouring lines are given by their middle rows; the line itself is among them.
    """
    line = lattice.padded[-1]
    return (lattice.rows // line, line * lattice.words), lattice.row_offsets[1::3] // line


def reachable(occupancy: Occupancy, start: ArrayLike) -> BoolArray:
    """Which nodes can be reached from a node.

    Args:
        occupancy: Which nodes are free.
        start: (d,) node index.

    Returns:
        Read-only mask of the grid's shape.

    Raises:
        InputError: The start is no node of the grid, or not free.
    """
    node = checked_node(occupancy, start, "start")
    check_occupancy(occupancy)
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    free = lattice.bordered(occupancy.free_words)
    reached, _ = flood_from(lattice, free, node)
    bits = np.unpackbits(lattice.unbordered(reached).view(np.uint8), axis=1, bitorder="little")
    return frozen(bits.view(np.bool_)[:, : lattice.shape[-1]].reshape(lattice.shape))


def slices_with_path(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike) -> BoolArray:
    """Which slices of the last axis have a path of their own from the start's place to the goal's.

    Args:
        occupancy: Which nodes are free.
        start: (d,) node index of a free node.
        goal: (d,) node index of a free node.

    Returns:
        Read-only (slices,) mask.

    Raises:
        InputError: Start or goal is no node of the grid, or not free.
    """
    check_occupancy(occupancy)
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    start_row = lattice.row_of(checked_node(occupancy, start, "start"))
    goal_row = lattice.row_of(checked_node(occupancy, goal, "goal"))
    free = lattice.bordered(occupancy.free_words)
    every = lattice.mask(range(lattice.shape[-1]))
    reached, _ = flood_slices(lattice, free, start_row, every, goal_row)
    return frozen(bits_of(reached[goal_row])[: lattice.shape[-1]])


def bits_of(words: WordArray) -> BoolArray:
    """The bits of (words,) one by one."""
    return np.unpackbits(words.view(np.uint8), bitorder="little").view(np.bool_)


def has_bit(words: WordArray, row: int, bit: int) -> bool:
    """Whether a bit of (rows, words) is set."""
    return bool((int(words[row, bit >> 6]) >> (bit & 63)) & 1)


@kernel
def _flood_slices(
    free: WordArray,
    reached: WordArray,
    words: int,
    beside: IntArray,
    start_line: int,
    goal_line: int,
    goal_place: int,
    enough: WordArray,
) -> int:
    """Grow `reached` inside `free`, both (lines, rows of a line * words); returns the number of bits reached.

    It may end where `reached` is `enough` from `goal_place` on in the goal's line.
    """
    lines, length = free.shape
    zero = np.uint64(0)
    front = np.empty(length, dtype=np.uint64)
    # A line waits where a neighbour has news for it. Lines without free bits, the border among them, never do.
    may_wait = np.empty(lines, dtype=np.bool_)
    for line in range(lines):
        bits = zero
        for k in range(length):
            bits |= free[line, k]
        may_wait[line] = bits != zero
    waiting = np.zeros(lines, dtype=np.bool_)
    waiting[start_line] = True
    left = 1
    fresh = True
    forward = True
    while left > 0:
        for i in range(lines):
            line = i if forward else lines - 1 - i
            if not waiting[line]:
                continue
            waiting[line] = False
            left -= 1
            here, inside = reached[line], free[line]
            for k in range(length):
                front[k] = here[k]
            for offset in beside:
                near = reached[line + offset]
                for k in range(length - 2 * words):
                    front[k + words] |= near[k] | near[k + words] | near[k + 2 * words]
            news = zero
            for k in range(length):
                front[k] &= inside[k]
                news |= front[k] ^ here[k]
            if news == zero and not fresh:
                continue
            fresh = False
            for word in range(words):
                run = zero
                for k in range(word, length, words):
                    run = (run & inside[k]) | front[k]
                    front[k] = run
                run = zero
                for k in range(length - words + word, -1, -words):
                    run = (run & inside[k]) | front[k]
                    here[k] = run
            if line == goal_line:
                missing = zero
                for word in range(words):
                    missing |= enough[word] ^ here[goal_place + word]
                if missing == zero:
                    left = 0
                    break
            for offset in beside:
                other = line + offset
                if not waiting[other] and may_wait[other]:
                    waiting[other] = True
                    left += 1
        forward = not forward
    count = 0
    for line in range(lines):
        for k in range(length):
            count += popcount(reached[line, k])
    return count


@kernel
def _flood_whole(free: WordArray, reached: WordArray, words: int, beside: IntArray) -> int:
    """Grow `reached` inside `free`, both (lines, rows of a line * words), over all axes; returns the bits reached.

    In a line whose neighbours have news the flood first takes one step from them, then runs along rows and along bits.
    """
    lines, length = free.shape
    zero, one, top = np.uint64(0), np.uint64(1), np.uint64(63)
    front, wide = np.empty(length, dtype=np.uint64), np.zeros(length, dtype=np.uint64)
    may_wait, waiting = np.zeros(lines, dtype=np.bool_), np.zeros(lines, dtype=np.bool_)
    for line in range(lines):
        some = zero
        for k in range(length):
            may_wait[line] = may_wait[line] or free[line, k] != zero
            some |= reached[line, k]
        if some != zero:
            for offset in beside:
                waiting[line + offset] = True
    left = 0
    for line in range(lines):
        waiting[line] = waiting[line] and may_wait[line]
        left += waiting[line]
    forward = True
    while left > 0:
        for i in range(lines):
            line = i if forward else lines - 1 - i
            if not waiting[line]:
                continue
            waiting[line] = False
            left -= 1
            here, inside = reached[line], free[line]
            for k in range(length):
                front[k] = here[k]
            for offset in beside:
                near = reached[line + offset]
                for k in range(length):
                    front[k] |= near[k]
            # One step along rows and bits; the first and the last row are border.
            for k in range(words, length - words):
                wide[k] = front[k - words] | front[k] | front[k + words]
            news = zero
            for k in range(words, length - words):
                bits = wide[k] | (wide[k] << one) | (wide[k] >> one)
                if words > 1:
                    bits |= wide[k - 1] >> top if k % words > 0 else zero
                    bits |= wide[k + 1] << top if k % words < words - 1 else zero
                front[k] = bits & inside[k]
                news |= front[k] & ~here[k]
            if news == zero:
                continue
            for word in range(words):
                run = zero
                for k in range(words + word, length - words, words):
                    run = (run & inside[k]) | front[k]
                    front[k] = run
                run = zero
                for k in range(length - 2 * words + word, -1, -words):
                    run = (run & inside[k]) | front[k]
                    front[k] = run
            for begin in range(words, length - words, words):
                carry = zero
                for k in range(begin, begin + words):
                    # Added to a run of free bits, a bit carries to the end of the run.
                    bits, room = front[k] | (carry & inside[k]), inside[k]
                    bits |= room & ((room + bits) ^ room)
                    here[k] = bits
                    carry = bits >> top
                carry = zero
                for k in range(begin + words - 1, begin - 1, -1):
                    bits, room = here[k] | ((carry << top) & inside[k]), inside[k]
                    for shift in (1, 2, 4, 8, 16, 32):
                        bits |= room & (bits >> np.uint64(shift))
                        room &= room >> np.uint64(shift)
                    here[k] = bits
                    carry = bits & one
            for offset in beside:
                other = line + offset
                if not waiting[other] and may_wait[other]:
                    waiting[other] = True
                    left += 1
        forward = not forward
    count = 0
    for line in range(lines):
        for k in range(length):
            count += popcount(reached[line, k])
    return count


@kernel
def slice_sizes(words: WordArray) -> IntArray:
    """(64 * words,) number of set bits in each slice of (rows, words)."""
    sizes = np.zeros(64 * words.shape[1], dtype=np.int64)
    one = np.uint64(1)
    for row in range(words.shape[0]):
        for word in range(words.shape[1]):
            bits = words[row, word]
            while bits != np.uint64(0):
                sizes[64 * word + lowest_bit(bits)] += 1
                bits &= bits - one
    return sizes
