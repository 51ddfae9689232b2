"""Cells of a grid numbered as they first appear: a hash table with open addressing, in kernels.

A table is an array of numbers of cells, empty places -1, its size a power of two. The cells themselves are rows of
three whole numbers; two cells are one if all three are the same, so that no two are ever taken for one another.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import IntArray, ShortArray
from hplan.base.kernels import inlined, kernel


@inlined
def cell_hash(i: int, j: int, k: int) -> int:
    """A number whose last bits differ from cell to cell, neighbours included."""
    mixed = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed ^= np.uint64(k) * np.uint64(0x165667B19E3779F9)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return np.int64(mixed >> np.uint64(34))  # type: ignore[return-value]  # an int to numba


@kernel
def cell_place(i: int, j: int, k: int, cells: IntArray, table: ShortArray) -> int:
    """The place in the table where a cell's number stands, or where it belongs: there stands -1."""
    mask = len(table) - 1
    place = cell_hash(i, j, k) & mask
    number = table[place]
    while number >= 0 and (cells[number, 0] != i or cells[number, 1] != j or cells[number, 2] != k):
        place = (place + 1) & mask
        number = table[place]
    return place


@kernel
def larger_table(cells: IntArray, count: int, size: int) -> ShortArray:
    """A table of a size, more than `count`, that holds the first `count` cells."""
    table = np.full(size, -1, dtype=np.int32)
    for number in range(count):
        table[cell_place(cells[number, 0], cells[number, 1], cells[number, 2], cells, table)] = number
    return table


@kernel
def number_cells(rows: IntArray) -> tuple[ShortArray, int]:
    """Number equal rows alike, in the order in which they first appear.

    Args:
        rows: (n, 3) whole numbers.

    Returns:
        (n,) numbers, and how many different ones there are.
    """
    size = 64
    while size < 2 * rows.shape[0]:
        size *= 2
    numbers = np.empty(rows.shape[0], dtype=np.int32)
    cells = np.empty((rows.shape[0], 3), dtype=np.int64)
    table = np.full(size, -1, dtype=np.int32)
    count = 0
    for row in range(rows.shape[0]):
        i, j, k = rows[row, 0], rows[row, 1], rows[row, 2]
        place = cell_place(i, j, k, cells, table)
        if table[place] < 0:
            table[place] = count
            cells[count, 0], cells[count, 1], cells[count, 2] = i, j, k
            count += 1
        numbers[row] = table[place]
    return numbers, count
