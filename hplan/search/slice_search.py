"""First level: a search of its own on every slice of the last axis.

A slice has a path exactly when flooding it from the start's place reaches the goal's place; only then is it searched.
Planar slices in which the path of an empty plane is free, in some order of its moves, need neither. Slices of many
axes take longer to search than to look at: a path found in one is taken over by all others in which it is free, and
only the rest are searched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, Record, WordArray, frozen
from hplan.base.kernels import kernel
from hplan.search.direct_slices import MonotonePaths
from hplan.search.flood import bits_of, flood_slices
from hplan.search.grid import words_for
from hplan.search.jump_point_search import jump_slices
from hplan.search.lattice import Lattice

#: Searches one slice, given as a grid of its own, from a node to a node: the (m, d) path or None, its cost, expansions,
#: nodes flooded.
SliceSearch: TypeAlias = Callable[[Lattice, WordArray, IntArray, IntArray], tuple[IntArray | None, float, int, int]]


@dataclass(frozen=True, eq=False)
class SlicePaths(Record):
    """Neighbouring slices, searched.

    Attributes:
        lattice: Geometry of the whole grid.
        first: First of the searched slices.
        path_rows: (m,) bordered rows of all paths, slice after slice, each from the start's place to the goal's.
        begins: (searched slices + 1,) where each slice's path begins in `path_rows`; of length 0 where it has none.
        expansions: Expansions in all slices.
        flooded: Nodes reached by flooding, and by the moves of an empty plane's shortest path.
    """

    lattice: Lattice
    first: int
    path_rows: IntArray
    begins: IntArray
    expansions: int
    flooded: int

    @property
    def feasible(self) -> BoolArray:
        """(slices,) whether each slice has a path of its own; False for those that were not to be searched."""
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


def search_layers(
    lattice: Lattice,
    free: WordArray,
    start: IntArray,
    goal: IntArray,
    slices: range,
    slice_search: SliceSearch | None = None,
    *,
    carried: bool = False,
) -> SlicePaths:
    """Search each of `slices` from the start's place in it to the goal's.

    Args:
        lattice: Geometry of the whole grid.
        free: (rows, words) bits with border.
        start: (d,) node index; its last entry does not matter.
        goal: (d,) node index; its last entry does not matter.
        slices: Neighbouring slices, ascending.
        slice_search: Searches one slice after the other; None searches planar slices by jump points, all in one pass.
        carried: Whether slices take over the path of one searched before, where it is free in them.
    """
    if slice_search is None:
        return _planar(lattice, free, lattice.row_of(start), lattice.row_of(goal), slices)
    if carried:
        return _carried(lattice, free, start, goal, slices, slice_search)
    reached, flooded = flood_slices(lattice, free, lattice.row_of(start), lattice.mask(slices))
    feasible = bits_of(reached[lattice.row_of(goal)])[: lattice.shape[-1]]
    found = _Searched(lattice, slices)
    for number in np.flatnonzero(feasible).tolist():
        found.search(number, reached, start, goal, slice_search)
    return found.layers(flooded)


def _planar(lattice: Lattice, free: WordArray, start_row: int, goal_row: int, slices: range) -> SlicePaths:
    """Planar slices, 64 at once."""
    width = lattice.padded[1]
    monotone = MonotonePaths.of(free, width, start_row, goal_row, slices)
    flooded, expansions, others = monotone.reached, 0, monotone.others
    path_rows, begins = np.empty(0, dtype=np.int64), np.zeros(len(slices) + 1, dtype=np.int64)
    if others.any():
        reached, count = flood_slices(lattice, free, start_row, others, goal_row)
        flooded += count
        others = reached[goal_row]
        if others.any():
            path_rows, begins, expansions = jump_slices(
                free, others, width, slices[0], slices[-1], start_row, goal_row, lattice.step[:-1]
            )
    path_rows, begins = monotone.joined(path_rows, begins)
    return SlicePaths(lattice, slices[0], frozen(path_rows), frozen(begins), expansions, flooded)


def _carried(
    lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, slices: range, slice_search: SliceSearch
) -> SlicePaths:
    """As `search_layers`, where slices in which a path found before is free take it over."""
    found = _Searched(lattice, slices)
    left = bits_of(free[lattice.row_of(start)] & free[lattice.row_of(goal)])[: lattice.shape[-1]]
    left[: slices[0]] = left[slices[-1] + 1 :] = False
    inside, flooded = free, 0
    while left.any():
        number = int(left.argmax())
        rows = found.search(number, inside, start, goal, slice_search)
        left[number] = False
        if rows is not None:
            taken = left & bits_of(np.bitwise_and.reduce(free[rows]))[: lattice.shape[-1]]
            taken[number] = True
            for other in np.flatnonzero(taken).tolist():
                found.rows[other] = rows
            left &= ~taken
        elif inside is free:
            # There are slices without: which ones is settled for all of them at once.
            inside, flooded = flood_slices(lattice, free, lattice.row_of(start), lattice.mask(slices))
            left &= bits_of(inside[lattice.row_of(goal)])[: lattice.shape[-1]]
    return found.layers(flooded)


class _Searched:
    """The paths of slices that are searched one by one."""

    def __init__(self, lattice: Lattice, slices: range) -> None:
        """None yet, of these slices."""
        self._lattice, self._slices = lattice, slices
        self._flat = Lattice.of(lattice.shape[:-1], lattice.step[:-1])
        axes = len(lattice.shape)
        self._origin = lattice.row_of(np.zeros(axes, dtype=np.int64))
        self._strides = np.array([lattice.row_of(node) for node in np.eye(axes, dtype=np.int64)[:-1]]) - self._origin
        self._expansions = self._flooded = 0
        self.rows: dict[int, IntArray] = {}

    def search(
        self, number: int, inside: WordArray, start: IntArray, goal: IntArray, slice_search: SliceSearch
    ) -> IntArray | None:
        """Search one slice; the rows of its path."""
        mask = slice_words(self._lattice, inside, number)
        path, _, expansions, flooded = slice_search(self._flat, mask, start[:-1], goal[:-1])
        self._expansions += expansions
        self._flooded += flooded
        if path is None:
            return None
        rows: IntArray = path @ self._strides + self._origin
        self.rows[number] = rows
        return rows

    def layers(self, flooded: int) -> SlicePaths:
        """All of them, in order."""
        none = np.empty(0, dtype=np.int64)
        parts = [self.rows.get(number, none) for number in self._slices]
        begins = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
        return SlicePaths(
            self._lattice,
            self._slices[0],
            frozen(np.concatenate(parts)),
            frozen(begins),
            self._expansions,
            self._flooded + flooded,
        )


def slice_words(lattice: Lattice, words: WordArray, number: int) -> WordArray:
    """One slice of bordered (rows, words) as a grid of its own, the axis before the last along the bits."""
    sliced: WordArray = _slicebits_of(words, number, lattice.padded[-1], words_for(lattice.shape[-2]))
    return sliced


@kernel
def _slicebits_of(rows: WordArray, number: int, padded: int, words: int) -> WordArray:
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
