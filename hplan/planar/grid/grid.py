"""Grid over a box, such as joint space, and its occupancy.

Occupancy uses one bit per node, with the last axis along the bits of 64-bit words: a forbidden interval of the last
joint is then a few masks, and one word operation floods 64 slices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import instance
from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, WordArray, as_array, frozen, numbers, readonly
from hplan.errors import InputError, OptionError

#: Maximum number of nodes of a grid (one bit each: 256 MB).
MAX_NODES = 2**31

#: Largest limit of a grid, far beyond any joint's; differences of larger values overflow.
_LARGEST_LIMIT = 1e12


@dataclass(frozen=True, eq=False)
class Grid(Record):
    """Equally spaced nodes over a box.

    Attributes:
        lower: (d,) coordinates of node 0.
        step: (d,) spacing, positive.
        shape: Number of nodes along each axis.
    """

    lower: FloatArray
    step: FloatArray
    shape: tuple[int, ...]

    @classmethod
    def from_limits(cls, lower: ArrayLike, upper: ArrayLike, step: ArrayLike) -> Grid:
        """Grid whose first and last nodes are the limits.

        If a range is not a whole number of steps, its step is reduced until it is. Equal limits give one node.

        Args:
            lower: (d,) lower limits.
            upper: (d,) upper limits.
            step: Maximum spacing, one number or (d,).

        Raises:
            OptionError: A step is not positive and finite, the limits are in the wrong order or not finite, or the grid
                has more than `MAX_NODES` nodes.
        """
        try:
            low, high = numbers("lower", lower, (None,)), numbers("upper", upper, (None,))
        except InputError as error:
            raise OptionError("limits", (lower, upper), f"finite lower and upper limits: {error}") from error
        expected = f"a positive finite spacing, one number or {low.size}"
        try:
            steps = numbers("step", step, (low.size,) if isinstance(step, np.ndarray | list | tuple) else ())
        except InputError as error:
            raise OptionError("step", step, expected) from error
        if not (steps > 0.0).all():
            raise OptionError("step", step, expected)
        if low.shape != high.shape or not ((np.abs([low, high]) <= _LARGEST_LIMIT).all() and (low <= high).all()):
            raise OptionError(
                "limits",
                (low.tolist(), high.tolist()),
                f"finite lower limits, none above its upper limit, all within +-{_LARGEST_LIMIT:g}",
            )
        counts = np.where(low < high, np.maximum(1.0, np.ceil((high - low) / steps - 1e-9)), 0.0)
        with np.errstate(over="ignore"):
            nodes = float(np.prod(counts + 1.0))
        if nodes > MAX_NODES:
            raise OptionError("step", step, f"a spacing that gives at most {MAX_NODES} nodes")
        shape = tuple(int(count) + 1 for count in counts)
        return cls(
            readonly(low), readonly(np.where(counts > 0.0, (high - low) / np.maximum(1.0, counts), steps)), shape
        )

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape, dtype=np.int64))

    def coordinates(self, index: ArrayLike) -> FloatArray:
        """Coordinates of nodes, (..., d) indices -> (..., d)."""
        coordinates: FloatArray = self.lower + np.asarray(index) * self.step
        return coordinates

    def position(self, coordinates: ArrayLike) -> FloatArray:
        """Coordinates in steps from node 0, (..., d) -> (..., d)."""
        position: FloatArray = (np.asarray(coordinates) - self.lower) / self.step
        return position

    def nearest_node(self, coordinates: ArrayLike) -> IntArray:
        """Index of the nearest node, (d,) -> (d,)."""
        rounded = np.rint(self.position(coordinates)).astype(np.int64)
        return np.clip(rounded, 0, np.array(self.shape) - 1)

    def axis(self, number: int) -> FloatArray:
        """Coordinates of the nodes along one axis."""
        return self.coordinates(np.arange(self.shape[number])[:, None])[:, number]


@dataclass(frozen=True, eq=False)
class Occupancy(Record):
    """Free nodes of a grid, packed into words.

    Attributes:
        free_words: (rows, words) uint64; bit `b` of word `w` of row `r` is set if the node with flat index `r` over all
            axes but the last and index `64 w + b` along the last is free. Bits past the end are 0.
    """

    grid: Grid
    free_words: WordArray

    @classmethod
    def from_mask(cls, grid: Grid, occupied: BoolArray) -> Occupancy:
        """Pack a mask of the grid's shape, True where occupied.

        Raises:
            InputError: The mask's shape differs from the grid's.
        """
        instance("grid", grid, Grid, "Grid.from_limits")
        occupied = instance("occupied", occupied, np.ndarray)
        if occupied.dtype != np.bool_:
            raise OptionError("occupied", f"an array of {occupied.dtype}", "an array of Booleans")
        if occupied.shape != grid.shape:
            raise InputError(
                f"occupancy mask has shape {occupied.shape}, the grid {grid.shape}",
                shape=list(occupied.shape),
                expected=list(grid.shape),
            )
        words = words_for(grid.shape[-1])
        bits = np.zeros((grid.size // grid.shape[-1], words * 64), dtype=np.uint8)
        bits[:, : grid.shape[-1]] = ~occupied.reshape(-1, grid.shape[-1])
        packed = np.packbits(bits, axis=1, bitorder="little").view(np.uint64)
        return cls(grid, frozen(np.ascontiguousarray(packed)))

    @cached_property
    def occupied_mask(self) -> BoolArray:
        """Mask of the grid's shape, True where occupied."""
        bits = np.unpackbits(self.free_words.view(np.uint8), axis=1, bitorder="little")
        return frozen((bits[:, : self.grid.shape[-1]] == 0).reshape(self.grid.shape))

    @property
    def occupied_count(self) -> int:
        """Number of occupied nodes."""
        return self.grid.size - int(np.bitwise_count(self.free_words).sum())

    def is_free(self, index: ArrayLike) -> bool:
        """True if the node with the given (d,) index is free."""
        *prefix, last = np.asarray(index).tolist()
        row = 0
        for place, count in zip(prefix, self.grid.shape, strict=False):
            row = row * count + place
        return bool((int(self.free_words[row, last // 64]) >> (last % 64)) & 1)


def checked_node(occupancy: Occupancy, index: ArrayLike, which: str) -> IntArray:
    """Validate the index of a free node; return it as (d,).

    Raises:
        OptionError: `occupancy` is not an `Occupancy`.
        InputError: The index is not a node of the grid, or the node is occupied.
    """
    instance("occupancy", occupancy, Occupancy, "Occupancy.from_mask")
    try:
        node = as_array(index)
    except ValueError:
        node = np.empty(0)
    shape = occupancy.grid.shape
    if node.shape != (len(shape),) or not np.issubdtype(node.dtype, np.integer):
        raise InputError(f"{which}: expected {len(shape)} whole numbers, got {index!r}", which=which)
    node_index = node.tolist()
    if not all(0 <= number < count for number, count in zip(node_index, shape, strict=True)):
        message = f"{which}: node {node_index} is outside the grid of shape {shape}"
        raise InputError(message, which=which, node=node_index)
    if not occupancy.is_free(node):
        raise InputError(f"{which}: node {node_index} is occupied", which=which, node=node_index)
    return node.astype(np.int64)


def words_for(bits: int) -> int:
    """Number of 64-bit words that hold `bits` bits."""
    return (bits + 63) // 64
