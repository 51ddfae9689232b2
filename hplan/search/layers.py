"""First level: a search of its own on every slice of the last axis.

A slice has a path exactly when flooding it from the start's place reaches the goal's place; only then is it searched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numba as nb
import numpy as np

from hplan.arrays import BoolArray, IntArray, WordArray, frozen
from hplan.grid import words_for
from hplan.search.flood import flood_slices
from hplan.search.jump import jump_slices
from hplan.search.lattice import Lattice

#: Searches one slice, given as a grid of its own, from a node to a node: the (m, d) path or None, its cost, expansions,
#: nodes flooded.
SliceSearch: TypeAlias = Callable[[Lattice, WordArray, IntArray, IntArray], tuple[IntArray | None, float, int, int]]


@dataclass(frozen=True, eq=False)
class Layers:
    """Neighbouring slices, searched.

    Attributes:
        first: First of the searched slices.
        feasible: (slices,) whether each slice of the whole grid has a path of its own.
        path_rows: (m,) bordered rows of all paths, slice after slice, each from the start's place to the goal's.
        begins: (searched slices + 1,) where each slice's path begins in `path_rows`; of length 0 where it has none.
        expansions: Expansions in all slices.
        flooded: Nodes reached by flooding.
    """

    first: int
    feasible: BoolArray
    path_rows: IntArray
    begins: IntArray
    expansions: int
    flooded: int

    def paths(self, lattice: Lattice) -> dict[int, IntArray]:
        """For each searched slice with a path its (m, d) node indices."""
        lengths = np.diff(self.begins)
        slices = np.repeat(np.arange(self.first, self.first + len(lengths)), lengths)
        nodes = frozen(lattice.indices(self.path_rows, slices))
        begins = self.begins.tolist()
        return {
            self.first + k: nodes[begins[k] : begins[k + 1]] for k in range(len(lengths)) if begins[k] < begins[k + 1]
        }


def search_layers(
    lattice: Lattice,
    free: WordArray,
    start: IntArray,
    goal: IntArray,
    slices: range,
    slice_search: SliceSearch | None = None,
) -> Layers:
    """Search each of `slices` from the start's place in it to the goal's.

    Args:
        lattice: Geometry of the whole grid.
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Neighbouring slices, ascending.
        slice_search: Searches one slice after the other; None searches planar slices by jump points, all in one pass.
    """
    start_row, goal_row = lattice.row_of(start), lattice.row_of(goal)
    first, last = slices[0], slices[-1]
    reached, flooded = flood_slices(lattice, free, start_row)
    feasible = np.unpackbits(reached[goal_row].view(np.uint8), bitorder="little").view(np.bool_)[: lattice.shape[-1]]
    if slice_search is None:
        path_rows, begins, expansions = jump_slices(
            free, reached[goal_row], lattice.padded[1], first, last, start_row, goal_row, lattice.step[:-1]
        )
    else:
        path_rows, begins, expansions, more = _each_slice(
            lattice, reached, np.flatnonzero(feasible), first, last, start, goal, slice_search
        )
        flooded += more
    return Layers(first, frozen(feasible), frozen(path_rows), frozen(begins), int(expansions), flooded)


def _each_slice(
    lattice: Lattice,
    reached: WordArray,
    feasible: IntArray,
    first: int,
    last: int,
    start: IntArray,
    goal: IntArray,
    slice_search: SliceSearch,
) -> tuple[IntArray, IntArray, int, int]:
    """As `jump_slices`, each slice in turn by `slice_search`; the nodes that it flooded come last."""
    flat = Lattice.of(lattice.shape[:-1], lattice.step[:-1])
    strides = np.array([lattice.row_of(node) for node in np.eye(len(start), dtype=np.int64)[:-1]])
    origin = lattice.row_of(np.zeros(len(start), dtype=np.int64))
    strides -= origin
    lengths = np.zeros(last - first + 1, dtype=np.int64)
    parts = [np.empty(0, dtype=np.int64)]
    expansions = flooded = 0
    for number in feasible[(feasible >= first) & (feasible <= last)].tolist():
        mask = slice_words(lattice, reached, number)
        path, _, expanded, more = slice_search(flat, mask, start[:-1], goal[:-1])
        expansions += expanded
        flooded += more
        if path is not None:
            parts.append(path @ strides + origin)
            lengths[number - first] = len(path)
    return np.concatenate(parts), np.concatenate([[0], np.cumsum(lengths)]), expansions, flooded


def slice_words(lattice: Lattice, words: WordArray, number: int) -> WordArray:
    """One slice of bordered (rows, words) as a grid of its own, the axis before the last along the bits."""
    sliced: WordArray = _slice_bits(words, number, lattice.padded[-1], words_for(lattice.shape[-2]))
    return sliced


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
