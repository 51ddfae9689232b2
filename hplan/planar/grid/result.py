"""Result of a search: path, cost, and the effort of each stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, Record, frozen
from hplan.planar.grid.lattice import Lattice

#: Stage that found the path or proved that no path exists: the union of the slices between start and goal (`none`); the
#: union of all slices; flooding, with the dense search on the flooded nodes.
Fallback = Literal["none", "all_slices", "dense"]


@dataclass(frozen=True, eq=False)
class SlicePaths(Record):
    """Paths of neighbouring slices, each searched independently.

    Attributes:
        path_rows: (m,) bordered rows of all paths, slice after slice, each from the start's row to the goal's.
        begins: (searched slices + 1,) start of each slice's path in `path_rows`; the length is 0 for a slice without a
            path.
    """

    lattice: Lattice
    first: int
    path_rows: IntArray
    begins: IntArray
    expansions: int
    flooded: int

    @property
    def feasible(self) -> BoolArray:
        """(slices,) True for each searched slice with its own path."""
        feasible = np.zeros(self.lattice.shape[-1], dtype=np.bool_)
        feasible[self.first : self.first + len(self.begins) - 1] = np.diff(self.begins) > 0
        return frozen(feasible)

    def paths(self) -> dict[int, IntArray]:
        """Path of each searched slice with one, as (m, d) indices."""
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
        fallback: Dense search, and all other searches after the union failed.
        flooded: Number of nodes reached by flooding, which works on whole words and decides connectivity. They are not
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
        """Return the counts with additional fallback expansions."""
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
        path: (m, d) node indices from start to goal; None if no path exists (proved by flooding).
        cost: Length of the path, each axis weighted by the grid's step (rad for a joint grid); inf without a path.
        expansions: Expansions by stage.
        times: Times by stage.
        layers: The slices searched last; None for the dense search.
        restored_slices: Slices without their own path that received part of a neighbour's path.
        sparse_nodes: Number of nodes of the union of the slice paths.
        fallback: Last stage required beyond the union of the slices between start and goal.
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
        """(slices,) True for each searched slice with its own path.

        None for the dense search.
        """
        return None if self.layers is None else self.layers.feasible

    @cached_property
    def slice_paths(self) -> dict[int, IntArray]:
        """(m, d) path of each searched slice that has one.

        The paths are node indices. The mapping is empty for the dense search.
        """
        return {} if self.layers is None else self.layers.paths()
