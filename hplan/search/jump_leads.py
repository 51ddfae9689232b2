"""Where jump points are, for 64 slices at once.

Directions are numbered 0 to 7: +j, -j, +i, -i, then (+i, +j), (+i, -j), (-i, +j), (-i, -j). A path that arrives at a
place in direction k may turn there to `TURNS[k]`, off the diagonal-first order, only around a corner: where the place
in direction `SIDES[k]` is occupied and the one in direction `TURNS[k]` is free.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.base.kernels import kernel

#: (8, 2) the directions in which an obstacle lets a path turn.
SIDES = np.array([[2, 3], [2, 3], [0, 1], [0, 1], [1, 3], [0, 3], [1, 2], [0, 2]])
#: (8, 2) the directions it can then turn to.
TURNS = np.array([[4, 6], [5, 7], [4, 5], [6, 7], [5, 6], [4, 7], [7, 4], [6, 5]])
#: (8, 2) the straight parts of each direction.
STRAIGHTS = np.array([[0, 0], [1, 1], [2, 2], [3, 3], [0, 2], [1, 2], [0, 3], [1, 3]])


@kernel
def direction_offsets(width: int) -> IntArray:
    """(8,) distance to the neighbouring place in each direction, with `width` places along axis j."""
    return np.array([1, -1, width, -width, width + 1, width - 1, 1 - width, -width - 1])


@kernel
def fill_leads(plane: WordArray, lead: WordArray, width: int, goal: int) -> None:
    """Find from which places a scan meets a jump point, or the goal, before it meets an obstacle.

    Args:
        plane: (places,) free bits, with a border of occupied places.
        lead: (8, places) the answer, one bit a slice; its border must be 0.
        width: Places along axis j with border.
        goal: Place of the goal.
    """
    grid, tables = plane.reshape(-1, width), lead.reshape(8, -1, width)
    _lead_along_j(grid, tables)
    _lead_along_i(grid, tables)
    for k in range(4):
        _lead_to_goal(plane, lead[k], goal, direction_offsets(width)[k])
    _lead_diagonally(grid, tables)
    for k in range(4, 8):
        _lead_to_goal(plane, lead[k], goal, direction_offsets(width)[k])


@kernel
def _lead_along_j(grid: WordArray, lead: WordArray) -> None:
    rows, columns = grid.shape
    for i in range(1, rows - 1):
        above, here, below = grid[i - 1], grid[i], grid[i + 1]
        forward, backward = lead[0, i], lead[1, i]
        bits = np.uint64(0)
        for j in range(columns - 3, 0, -1):
            bits |= (~below[j + 1] & below[j + 2]) | (~above[j + 1] & above[j + 2])
            bits &= here[j + 1]
            forward[j] = bits
        bits = np.uint64(0)
        for j in range(2, columns - 1):
            bits |= (~below[j - 1] & below[j - 2]) | (~above[j - 1] & above[j - 2])
            bits &= here[j - 1]
            backward[j] = bits


@kernel
def _lead_along_i(grid: WordArray, lead: WordArray) -> None:
    rows, columns = grid.shape
    for k in (2, 3):
        sign = 1 if k == 2 else -1
        for n in range(2, rows - 1):
            i = rows - 1 - n if k == 2 else n
            near, far = grid[i + sign], grid[i + 2 * sign]
            here, there = lead[k, i], lead[k, i + sign]
            for j in range(columns - 2):
                corner = (~near[j] & far[j]) | (~near[j + 2] & far[j + 2])
                here[j + 1] = near[j + 1] & (corner | there[j + 1])


@kernel
def _lead_diagonally(grid: WordArray, lead: WordArray) -> None:
    """A diagonal scan stops at corners, and where a straight scan would meet a jump point."""
    rows, columns = grid.shape
    for straight in (2, 3):
        sign = 1 if straight == 2 else -1
        for n in range(2, rows - 1):
            i = rows - 1 - n if straight == 2 else n
            here, near, far = grid[i], grid[i + sign], grid[i + 2 * sign]
            along_i = lead[straight, i + sign]
            k = 2 * straight
            to, beyond, along_j = lead[k, i], lead[k, i + sign], lead[0, i + sign]
            for j in range(columns - 3):
                corner = (~near[j + 1] & far[j + 1]) | (~here[j + 2] & here[j + 3])
                to[j + 1] = near[j + 2] & (corner | along_i[j + 2] | along_j[j + 2] | beyond[j + 2])
            k += 1
            to, beyond, along_j = lead[k, i], lead[k, i + sign], lead[1, i + sign]
            for j in range(columns - 3):
                corner = (~near[j + 2] & far[j + 2]) | (~here[j + 1] & here[j])
                to[j + 2] = near[j + 1] & (corner | along_i[j + 1] | along_j[j + 1] | beyond[j + 1])


@kernel
def _lead_to_goal(plane: WordArray, lead: WordArray, goal: int, offset: int) -> None:
    """Mark the places that see the goal in one direction."""
    bits = plane[goal]
    place = goal - offset
    while bits != np.uint64(0):
        lead[place] |= bits
        bits &= plane[place]
        place -= offset
