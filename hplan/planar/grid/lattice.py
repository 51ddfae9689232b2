"""Search lattice of a grid.

Bit rows with a border, and the moves to all neighbours.

A node is a row (all axes but the last) and a bit (the last axis). A border of occupied rows surrounds the rows, so that
a neighbouring row is always one addition away. One slice of the last axis is the same bit of every row.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record, ShortArray, WordArray, readonly
from hplan.base.deadline import kernel_time_limit
from hplan.base.kernels import kernel
from hplan.planar.grid.bits import popcount
from hplan.planar.grid.grid import words_for


class Node(NamedTuple):
    """Node representation of the kernels: bordered row, and bit of the row."""

    row: int
    bit: int


class LatticeArrays(NamedTuple):
    """Arrays of a `Lattice` for the kernels, and their deadline (`hplan.base.deadline`)."""

    row_offsets: IntArray
    move_costs: FloatArray
    row_coordinates: IntArray
    step: FloatArray
    until: FloatArray


@dataclass(frozen=True, eq=False)
class Lattice(Record):
    """Geometry of a grid: bordered rows and the moves between them.

    Attributes:
        step: (d,) weight of one step along each axis.
        padded: Number of rows along each axis but the last, border included.
        row_offsets: (moves,) offset to each neighbouring row, including the row itself.
        move_costs: (moves, 3) cost of the move to that row and to bit -1, 0, +1.
    """

    shape: tuple[int, ...]
    step: FloatArray
    padded: tuple[int, ...]
    row_offsets: IntArray
    move_costs: FloatArray

    @classmethod
    def build(cls, shape: tuple[int, ...], step: FloatArray) -> Lattice:
        """Lattice of a grid with full connectivity.

        8 neighbours in 2-D, 26 in 3-D.

        The last few lattices are cached: planning repeats on the same grid, and a lattice contains geometry only.
        """
        return _lattice(shape, step.tobytes())

    @property
    def row_coordinates(self) -> IntArray:
        """(padded rows, d - 1) node index of each row.

        The index omits the last axis. Floods do not use it.
        """
        return _row_coordinates(self.padded)

    @property
    def arrays(self) -> LatticeArrays:
        """Arrays for the kernels, with their deadline."""
        return LatticeArrays(self.row_offsets, self.move_costs, self.row_coordinates, self.step, kernel_time_limit())

    @property
    def rows(self) -> int:
        """Number of rows, border included."""
        return math.prod(self.padded)

    @property
    def words(self) -> int:
        """Number of words per row."""
        return words_for(self.shape[-1])

    def row_of(self, index: IntArray) -> int:
        """Bordered row of a node."""
        row = 0
        for place, count in zip(index[:-1].tolist(), self.padded, strict=True):
            row = row * count + place + 1
        return row

    def node(self, index: IntArray) -> Node:
        """Bordered row and bit of a node, from its (d,) index."""
        return Node(self.row_of(index), int(index[-1]))

    def mask(self, slices: range) -> WordArray:
        """(words,) with the bits of neighbouring slices set."""
        bits = (1 << slices.stop) - (1 << slices.start)
        return np.frombuffer(bits.to_bytes(8 * self.words, "little"), dtype=np.uint64)

    def add_border(self, words: WordArray) -> WordArray:
        """Add the border to (rows, words) rows."""
        result = np.zeros((*self.padded, words.shape[1]), dtype=np.uint64)
        result[self._interior] = words.reshape(*self.shape[:-1], words.shape[1])
        return result.reshape(-1, words.shape[1])

    def remove_border(self, words: WordArray) -> WordArray:
        """Remove the border from (rows, words) rows."""
        inside = words.reshape(*self.padded, words.shape[1])[self._interior]
        return np.ascontiguousarray(inside).reshape(-1, words.shape[1])

    def indices(self, rows: IntArray, bits: IntArray) -> IntArray:
        """(m, d) node indices of bordered rows and bits."""
        nodes = np.empty((len(rows), len(self.shape)), dtype=np.int64)
        nodes[:, :-1] = self.row_coordinates[rows]
        nodes[:, -1] = bits
        return nodes

    @property
    def _interior(self) -> tuple[slice, ...]:
        return tuple(slice(1, -1) for _ in self.padded)


@lru_cache(maxsize=8)
def _lattice(shape: tuple[int, ...], step_bytes: bytes) -> Lattice:
    step = np.frombuffer(step_bytes)
    padded = tuple(count + 2 for count in shape[:-1])
    axes = len(padded)
    strides = np.array([math.prod(padded[i + 1 :]) for i in range(axes)], dtype=np.int64)
    moves = np.array(list(itertools.product((-1, 0, 1), repeat=axes)), dtype=np.int64).reshape(3**axes, axes)
    row_squares = ((moves * step[:-1]) ** 2).sum(axis=1)
    bit_squares = (np.array([-1.0, 0.0, 1.0]) * step[-1]) ** 2
    return Lattice(
        shape=shape,
        step=step,
        padded=padded,
        row_offsets=readonly(moves @ strides, np.int64),
        move_costs=readonly(np.sqrt(row_squares[:, None] + bit_squares)),
    )


@lru_cache(maxsize=4)
def _row_coordinates(padded: tuple[int, ...]) -> IntArray:
    """Node indices of rows.

    They are cached separately, because grids that differ only in the last axis share them.
    """
    indices = np.indices(padded).reshape(len(padded), math.prod(padded)).T
    return readonly(indices - 1, np.int64)


class NodeSet(NamedTuple):
    """Set bits, numbered row by row: the nodes available to a search.

    Attributes:
        words: (rows, words) bits with border.
        rows: (k,) rows with set bits, in numbering order.
        ranks: (rows, words) number of the first node of each word; written for rows with set bits only.
        size: Number of nodes.
    """

    words: WordArray
    rows: IntArray
    ranks: ShortArray
    size: int

    @classmethod
    def from_words(cls, words: WordArray) -> NodeSet:
        """Node set of (rows, words) bits."""
        return number_nodes(words, np.flatnonzero(words.any(axis=1)))


@kernel
def number_nodes(words: WordArray, rows: IntArray) -> NodeSet:
    """Node set, (rows, words) bits, of the given rows only."""
    ranks = np.empty(words.shape, dtype=np.int32)
    size = 0
    for row in rows:
        for word in range(words.shape[1]):
            ranks[row, word] = size
            size += popcount(words[row, word])
    return NodeSet(words, rows, ranks, size)
