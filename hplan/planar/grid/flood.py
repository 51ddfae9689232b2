"""Connected components of free nodes by flooding whole 64-bit words.

Word operations connect neighbouring rows, so one sweep over the rows advances the front in 64 slices together. Sweeps
alternate in direction until nothing changes: the fixed point is the connected component, independent of the order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, IntArray, WordArray, frozen
from hplan.base.deadline import check_deadline, is_up, kernel_time_limit
from hplan.base.kernels import kernel
from hplan.planar.grid.bits import lowest_bit, popcount
from hplan.planar.grid.grid import Occupancy, checked_node
from hplan.planar.grid.lattice import Lattice

#: A border row, which is never reached.
_NOWHERE = 0

#: The deadline is checked at lines whose number has all of these bits clear.
_LINE_MASK = 15


def flood_slices(
    lattice: Lattice, free: WordArray, start_row: int, wanted: WordArray, goal_row: int | None = None
) -> tuple[WordArray, int]:
    """Flood slices of the last axis independently from the start's row.

    Args:
        free: (rows, words) bits with border.
        start_row: Bordered row of every slice's start.
        wanted: (words,) bits of the slices to flood.
        goal_row: Stop when every requested slice that is free in this row is reached there; None to reach all nodes.

    Returns:
        (rows, words) reached bits and their number.
    """
    reached = np.zeros_like(free)
    reached[start_row] = free[start_row] & wanted
    enough = reached[start_row] & free[start_row if goal_row is None else goal_row]
    shape, neighbours = in_lines(lattice)
    if goal_row is None:
        goal_row, enough = _NOWHERE, np.ones_like(enough)
    count = _flood(
        free.reshape(shape),
        reached.reshape(shape),
        neighbours[neighbours != 0],
        (False, goal_row),
        enough,
        kernel_time_limit(),
    )
    check_deadline()
    return reached, int(count)


def flood_from(lattice: Lattice, free: WordArray, nodes: IntArray) -> tuple[WordArray, int]:
    """Flood the whole grid from free nodes, with slices connected.

    Args:
        free: (rows, words) bits with border.
        nodes: (k, d) or (d,) node indices.

    Returns:
        (rows, words) bits of all nodes connected to them, and their number.
    """
    reached = np.zeros_like(free)
    for node in np.atleast_2d(nodes):
        reached[lattice.row_of(node), node[-1] >> 6] |= np.uint64(1) << np.uint64(node[-1] & 63)
    shape, neighbours = in_lines(lattice)
    enough = np.ones(lattice.words, dtype=np.uint64)
    count = _flood(
        free.reshape(shape), reached.reshape(shape), neighbours, (True, _NOWHERE), enough, kernel_time_limit()
    )
    check_deadline()
    return reached, int(count)


def in_lines(lattice: Lattice) -> tuple[tuple[int, int], IntArray]:
    """Arrange rows in lines along the second-to-last axis.

    Returns:
        The shape (lines, words of a line), and the offsets of the neighbouring lines, including the line itself (0).
    """
    line = lattice.padded[-1]
    return (lattice.rows // line, line * lattice.words), lattice.row_offsets[1::3] // line


def reachable_nodes(occupancy: Occupancy, start: ArrayLike) -> BoolArray:
    """Nodes that can be reached from a node.

    Args:
        occupancy: Free nodes of the grid.
        start: (d,) node index.

    Returns:
        Read-only mask of the grid's shape.

    Raises:
        InputError: The start is not a node of the grid, or not free.
    """
    node = checked_node(occupancy, start, "start")
    lattice = Lattice.build(occupancy.grid.shape, occupancy.grid.step)
    reached, _ = flood_from(lattice, lattice.add_border(occupancy.free_words), node)
    return frozen(bits_of(lattice.remove_border(reached))[:, : lattice.shape[-1]].reshape(lattice.shape))


def slices_with_path(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike) -> BoolArray:
    """Slices of the last axis with their own path.

    From the row of the start to that of the goal.

    Args:
        occupancy: Free nodes of the grid.
        start: (d,) node index of a free node.
        goal: (d,) node index of a free node.

    Returns:
        Read-only (slices,) mask.

    Raises:
        InputError: Start or goal is not a node of the grid, or not free.
    """
    source, target = checked_node(occupancy, start, "start"), checked_node(occupancy, goal, "goal")
    lattice = Lattice.build(occupancy.grid.shape, occupancy.grid.step)
    free, goal_row = lattice.add_border(occupancy.free_words), lattice.row_of(target)
    every = lattice.mask(range(lattice.shape[-1]))
    reached, _ = flood_slices(lattice, free, lattice.row_of(source), every, goal_row)
    return frozen(bits_of(reached[goal_row])[: lattice.shape[-1]])


def bits_of(words: WordArray) -> BoolArray:
    """Unpack (..., words) into single bits, (..., 64 * words)."""
    return np.unpackbits(words.view(np.uint8), axis=-1, bitorder="little").view(np.bool_)


def has_bit(words: WordArray, row: int, bit: int) -> bool:
    """True if a bit of (rows, words) is set."""
    return bool((int(words[row, bit >> 6]) >> (bit & 63)) & 1)


@kernel
def _flood(
    free: WordArray, reached: WordArray, neighbours: IntArray, how: tuple[bool, int], enough: WordArray,
    until: FloatArray,
) -> int:  # fmt: skip
    """Grow `reached` inside `free`; return the number of reached bits.

    Both arrays are (lines, rows of a line * words). `how` states whether slices are connected, and the goal's row.

    A line with newly reached neighbours first takes one step from all of them, then propagates along its rows and, if
    slices are connected, along its bits. The flood may end when the (words,) bits `enough` are reached in the goal's
    row.
    """
    (joined, goal_row), (lines, length) = how, free.shape
    words, zero = len(enough), np.uint64(0)
    goal_line, goal_word = goal_row * words // length, goal_row * words % length
    front, wide = np.zeros(length, dtype=np.uint64), np.zeros(length, dtype=np.uint64)
    # Lines without free bits, including the border, never wait. The start lines proceed without new neighbours.
    may_wait, is_source, left = np.empty(lines, dtype=np.bool_), np.empty(lines, dtype=np.bool_), 0
    for line in range(lines):
        bits, some = zero, zero
        for k in range(length):
            bits |= free[line, k]
            some |= reached[line, k]
        may_wait[line], is_source[line] = bits != zero, some != zero
        left += is_source[line]
    waiting, forward = is_source.copy(), True
    while left > 0:
        for i in range(lines):
            line = i if forward else lines - 1 - i
            if not waiting[line]:
                continue
            waiting[line] = False
            left -= 1
            if line & _LINE_MASK == 0 and is_up(until):
                return 0
            here, inside = reached[line], free[line]
            for k in range(length):
                front[k] = here[k]
            for offset in neighbours:
                near = reached[line + offset]
                for k in range(length):
                    front[k] |= near[k]
            # The first and the last row of a line belong to the border.
            for k in range(words, length - words):
                wide[k] = front[k - words] | front[k] | front[k + words]
            if joined:
                _step_along_bits(wide, front, words)
            else:
                front, wide = wide, front
            news = zero
            for k in range(length):
                front[k] &= inside[k]
                news |= front[k] & ~here[k]
            if news == zero and not is_source[line]:
                continue
            is_source[line] = False
            for word in range(words):
                run = zero
                for k in range(word, length, words):
                    run = (run & inside[k]) | front[k]
                    front[k] = run
                run = zero
                for k in range(length - words + word, -1, -words):
                    run = (run & inside[k]) | front[k]
                    here[k] = run
            if joined:
                _run_along_bits(here, inside, words)
            if line == goal_line:
                missing = zero
                for word in range(words):
                    missing |= enough[word] ^ here[goal_word + word]
                if missing == zero:
                    left = 0
                    break
            for offset in neighbours:
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
def _step_along_bits(bits: WordArray, wide: WordArray, words: int) -> None:
    """Write a line's bits and their last-axis neighbours to `wide`.

    The bits of the line's border are skipped.
    """
    one, top, zero = np.uint64(1), np.uint64(63), np.uint64(0)
    for k in range(words, len(bits) - words):
        wide[k] = bits[k] | (bits[k] << one) | (bits[k] >> one)
        if words > 1:
            wide[k] |= bits[k - 1] >> top if k % words > 0 else zero
            wide[k] |= bits[k + 1] << top if k % words < words - 1 else zero


@kernel
def _run_along_bits(here: WordArray, inside: WordArray, words: int) -> None:
    """Propagate bits along the last axis through free bits `inside`."""
    one, top, zero = np.uint64(1), np.uint64(63), np.uint64(0)
    for begin in range(words, len(here) - words, words):
        carry = zero
        for k in range(begin, begin + words):
            # Adding a bit to a run of free bits carries to the end of the run.
            bits, room = here[k] | (carry & inside[k]), inside[k]
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


@kernel
def slice_sizes(words: WordArray) -> IntArray:
    """(64 * words,) number of set bits in each slice.

    Of (rows, words).
    """
    sizes = np.zeros(64 * words.shape[1], dtype=np.int64)
    one = np.uint64(1)
    for row in range(words.shape[0]):
        for word in range(words.shape[1]):
            bits = words[row, word]
            while bits != np.uint64(0):
                sizes[64 * word + lowest_bit(bits)] += 1
                bits &= bits - one
    return sizes
