"""Result of a search: path, cost, and the effort of each stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, Record, frozen
from hplan.grid.lattice import Lattice

#: Stage that found the path, or that there is none: the union of the slices between start and goal (`none`); the union
#: of all slices; flooding, and the dense search on what it reached.
Fallback = Literal["none", "all_slices", "dense"]


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


@dataclass(frozen=True)
class Expansions:
    """Number of entries taken from the open lists, by stage.

    Attributes:
        layers: All slice searches together.
        sparse: Search on the union of the slice paths.
        fallback: Dense search, and all else that came after the union had failed.
        flooded: Nodes reached by flooding, whole words of them at once, which settles what is connected. They are not
            expansions.
    """

    layers: int = 0
    sparse: int = 0
    fallback: int = 0
    flooded: int = 0

    @property
    def total(self) -> int:
        """Sum of all expansions."""
        return self.layers + self.sparse + self.fallback

    def with_fallback(self, expansions: int, flooded: int) -> Expansions:
        """These counts with more of the fallback."""
        return replace(self, fallback=self.fallback + expansions, flooded=self.flooded + flooded)


@dataclass(frozen=True)
class StageTimes:
    """Wall-clock time of each stage [s]."""

    layers: float = 0.0
    sparse: float = 0.0
    fallback: float = 0.0

    @property
    def total(self) -> float:
        """Sum of all stages [s]."""
        return self.layers + self.sparse + self.fallback


@dataclass(frozen=True, eq=False)
class SearchResult(Record):
    """A path over grid nodes, and the effort of finding it.

    Attributes:
        path: (m, d) node indices from start to goal, or None where none exists (shown by flooding).
        cost: Length of the path, each axis weighed by the grid's step (rad for a joint grid); inf without a path.
        expansions: Expansions by stage.
        times: Times by stage.
        layers: The slices searched last; None for the dense search.
        restored_slices: Slices without a path of their own that were given part of a neighbour's.
        sparse_nodes: Nodes of the union of the slice paths.
        fallback: Stage beyond the union of the slices between start and goal that was needed last.
    """

    path: IntArray | None
    cost: float
    expansions: Expansions
    times: StageTimes
    layers: SlicePaths | None = None
    restored_slices: tuple[int, ...] = ()
    sparse_nodes: int = 0
    fallback: Fallback = "none"

    @property
    def feasible_slices(self) -> BoolArray | None:
        """(slices,) True for each slice searched that has a path of its own; None for the dense search."""
        return None if self.layers is None else self.layers.feasible

    @cached_property
    def slice_paths(self) -> dict[int, IntArray]:
        """For each slice searched that has a path, that path as (m, d) node indices; empty for the dense search."""
        return {} if self.layers is None else self.layers.paths()
