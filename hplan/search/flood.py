"""What the start is connected to, found for whole words of nodes at once.

Neighbouring rows are joined by word operations, so one sweep over the rows moves the front in 64 slices together.
Sweeps alternate in direction until nothing changes: the fixed point is the connected component, whatever the order.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from hplan.arrays import IntArray, WordArray
from hplan.search.bits import popcount
from hplan.search.lattice import Lattice


def flood_slices(lattice: Lattice, free: WordArray, start_row: int) -> tuple[WordArray, int]:
    """Flood each slice of the last axis on its own from the start's row.

    Args:
        lattice: Geometry of the grid.
        free: (rows, words) bits with border.
        start_row: Bordered row in which every slice starts.

    Returns:
        (rows, words) reached bits and their number.
    """
    seeds = np.zeros_like(free)
    seeds[start_row] = free[start_row]
    return _flood(free, seeds, lattice.row_offsets, False)


def flood_from(lattice: Lattice, free: WordArray, row: int, bit: int) -> tuple[WordArray, int]:
    """Flood the whole grid from one free node, slices joined.

    Returns:
        (rows, words) bits of all nodes connected to it, and their number.
    """
    seeds = np.zeros_like(free)
    seeds[row, bit >> 6] = np.uint64(1) << np.uint64(bit & 63)
    return _flood(free, seeds, lattice.row_offsets, True)


@nb.njit(cache=True)
def _flood(free: WordArray, reached: WordArray, row_offsets: IntArray, across: bool) -> tuple[WordArray, int]:
    """Grow `reached` inside `free`; `across` lets it pass from bit to bit as well."""
    rows, words = free.shape
    margin = 0
    for offset in row_offsets:
        margin = max(margin, abs(offset))
    one = np.uint64(1)
    top = np.uint64(63)
    front = np.empty(words, dtype=np.uint64)
    changed = True
    forward = True
    while changed:
        changed = False
        for i in range(margin, rows - margin):
            row = i if forward else rows - 1 - i
            open_bits = False
            for word in range(words):
                front[word] = reached[row, word]
                if free[row, word] != reached[row, word]:
                    open_bits = True
            if not open_bits:
                continue
            for offset in row_offsets:
                for word in range(words):
                    front[word] |= reached[row + offset, word]
            if across:
                # One step up and down along the bits, then along runs of free bits until nothing moves.
                moving = True
                while moving:
                    moving = False
                    carry = np.uint64(0)
                    for word in range(words):
                        above = front[word + 1] << top if word + 1 < words else np.uint64(0)
                        spread = front[word] | (front[word] << one) | (front[word] >> one) | carry | above
                        carry = front[word] >> top
                        grown = spread & free[row, word]
                        if grown & ~reached[row, word] != np.uint64(0):
                            reached[row, word] |= grown
                            changed = True
                            moving = True
                    for word in range(words):
                        front[word] = reached[row, word]
            else:
                for word in range(words):
                    grown = front[word] & free[row, word]
                    if grown != reached[row, word]:
                        reached[row, word] = grown
                        changed = True
        forward = not forward
    count = 0
    for row in range(rows):
        for word in range(words):
            count += popcount(reached[row, word])
    return reached, count
