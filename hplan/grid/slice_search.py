"""First level: a search of its own on every slice of the last axis.

A slice has a path exactly when flooding it from the start's row reaches the goal's row; only then is it searched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, Record, WordArray, frozen
from hplan.base.deadline import check_deadline, until
from hplan.base.kernels import kernel
from hplan.grid.flood import bits_of, flood_slices
from hplan.grid.grid import words_for
from hplan.grid.jump_point_search import PlaneEnds, jump_slices
from hplan.grid.lattice import Lattice, NodeSet

#: Searches one slice, given as a grid of its own, from a node to a node: the (m, d) path or None, cost and expansions.
SliceSearch: TypeAlias = Callable[[Lattice, NodeSet, IntArray, IntArray], tuple[IntArray | None, float, int]]


@dataclass(frozen=True, eq=False)
class SlicePaths(Record):
    """The paths of neighbouring slices, each searched on its own.

    Attributes:
        path_rows: (m,) bordered rows of all paths, slice after slice, each from the start's row to the goal's.
        begins: (searched slices + 1,) where each slice's path begins in `path_rows`; of length 0 where it has none.
    """

    lattice: Lattice
    first: int
    path_rows: IntArray
    begins: IntArray
    expansions: int
    flooded: int

    @property
    def feasible(self) -> BoolArray:
        """(slices,) True for each slice that was to be searched and has a path of its own."""
        feasible = np.zeros(self.lattice.shape[-1], dtype=np.bool_)
        feasible[self.first : self.first + len(self.begins) - 1] = np.diff(self.begins) > 0
        return frozen(feasible)

    def paths(self) -> dict[int, IntArray]:
        """For each searched slice with a path its (m, d) node indices."""
        lengths = np.diff(self.begins)
        slices = np.repeat(np.arange(self.first, self.first + len(lengths)), lengths)
        nodes = frozen(self.lattice.indices(self.path_rows, slices))
        begins = self.begins.tolist()
        return {
            self.first + k: nodes[begins[k] : begins[k + 1]] for k in range(len(lengths)) if begins[k] < begins[k + 1]
        }


def search_slices(
    lattice: Lattice,
    free: WordArray,
    start: IntArray,
    goal: IntArray,
    slices: range,
    slice_search: SliceSearch | None = None,
) -> SlicePaths:
    """Search each of `slices` from the start's row to the goal's.

    Args:
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Neighbouring slices, ascending.
        slice_search: Searches one slice after the other; None searches planar slices by jump points, all in one pass.
    """
    start_row, goal_row = lattice.row_of(start), lattice.row_of(goal)
    if slice_search is None:
        return _planar(lattice, free, start_row, goal_row, slices)
    flat, mask = Lattice.of(lattice.shape[:-1], lattice.step[:-1]), lattice.mask(slices)
    reached, flooded = flood_slices(lattice, free, start_row, mask)
    found: dict[int, IntArray] = {}
    expansions = 0
    for number in np.flatnonzero(bits_of(reached[goal_row] & mask)).tolist():
        nodes = NodeSet.of(slice_words(lattice, reached, number))
        path, _, expanded = slice_search(flat, nodes, start[:-1], goal[:-1])
        expansions += expanded
        if path is not None:
            found[number] = np.ravel_multi_index(tuple(path.T + 1), lattice.padded)
    none = np.empty(0, dtype=np.int64)
    parts = [found.get(number, none) for number in slices]
    begins = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    return SlicePaths(lattice, slices[0], frozen(np.concatenate(parts)), frozen(begins), expansions, flooded)


def _planar(lattice: Lattice, free: WordArray, start_row: int, goal_row: int, slices: range) -> SlicePaths:
    """Paths of planar slices, 64 at once."""
    reached, flooded = flood_slices(lattice, free, start_row, lattice.mask(slices), goal_row)
    ends = PlaneEnds(lattice.padded[1], start_row, goal_row)
    path_rows, begins, expansions = jump_slices(
        free, reached[goal_row], slices[0], slices[-1], ends, lattice.step[:-1], until()
    )
    check_deadline()
    return SlicePaths(lattice, slices[0], frozen(path_rows), frozen(begins), expansions, flooded)


def slice_words(lattice: Lattice, words: WordArray, number: int) -> WordArray:
    """One slice of bordered (rows, words) as a grid of its own, the axis before the last along the bits."""
    return _slice_words(words, number, lattice.padded[-1], words_for(lattice.shape[-2]))


@kernel
def _slice_words(rows: WordArray, number: int, padded: int, words: int) -> WordArray:
    """One slice; `padded` counts the rows along the axis before the last, `words` holds them without their border."""
    count = rows.shape[0] // padded
    result = np.zeros((count, words), dtype=np.uint64)
    shift = np.uint64(number & 63)
    word = number >> 6
    for r in range(count):
        for b in range(padded - 2):
            bit = (rows[r * padded + b + 1, word] >> shift) & np.uint64(1)
            result[r, b >> 6] |= bit << np.uint64(b & 63)
    return result
