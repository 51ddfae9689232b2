"""First level: a search of its own on every slice of the last axis.

A slice has a path exactly when flooding it from the start's place reaches the goal's place; only then is it searched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np

from hplan.arrays import BoolArray, IntArray, WordArray, frozen
from hplan.search.flood import flood_slices
from hplan.search.lattice import Lattice, astar


@dataclass(frozen=True, eq=False)
class Layers:
    """The slices between start and goal, searched.

    Attributes:
        feasible: (slices,) whether each slice of the whole grid has a path of its own.
        paths: For each searched slice with a path its (m, d) node indices.
        expansions: Expansions in all slices.
        flooded: Nodes reached by flooding.
    """

    feasible: BoolArray
    paths: dict[int, IntArray]
    expansions: int
    flooded: int


def search_layers(
    lattice: Lattice,
    free: WordArray,
    start: IntArray,
    goal: IntArray,
    slices: range,
    *,
    octile: bool,
) -> Layers:
    """Search each of `slices` from the start's place in it to the goal's.

    Args:
        lattice: Geometry of the whole grid.
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Slices to search.
        octile: As for `astar`.
    """
    reached, flooded = flood_slices(lattice, free, lattice.row_of(start))
    goal_words = reached[lattice.row_of(goal)]
    numbers = np.arange(lattice.shape[-1])
    feasible = (goal_words[numbers >> 6] >> (numbers & 63).astype(np.uint64)) & np.uint64(1) != 0
    flat = Lattice.of(lattice.shape[:-1], lattice.step[:-1])
    paths: dict[int, IntArray] = {}
    expansions = 0
    for number in slices:
        if not feasible[number]:
            continue
        mask = _slice_bits(reached, number, lattice.shape[-2] + 2, flat.words)
        path, _, expanded = astar(flat, mask, start[:-1], goal[:-1], octile=octile)
        expansions += expanded
        if path is not None:
            paths[number] = np.column_stack([path, np.full(len(path), number)])
    return Layers(frozen(feasible), paths, expansions, flooded)


@nb.njit(cache=True)
def _slice_bits(rows: WordArray, number: int, padded: int, words: int) -> WordArray:
    """One slice as bit rows of its own: the axis before the last, without its border, along the bits."""
    count = rows.shape[0] // padded
    result = np.zeros((count, words), dtype=np.uint64)
    shift = np.uint64(number & 63)
    word = number >> 6
    for r in range(count):
        for b in range(padded - 2):
            bit = (rows[r * padded + b + 1, word] >> shift) & np.uint64(1)
            result[r, b >> 6] |= bit << np.uint64(b & 63)
    return result
