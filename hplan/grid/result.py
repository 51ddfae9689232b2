"""Result of a search: path, cost, and the effort of each stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from hplan.base.arrays import BoolArray, IntArray, Record
from hplan.grid.slice_search import SlicePaths

#: Stage that found the path, or that there is none: the union of the slices between start and goal (`none`); the union
#: of all slices; flooding, and the dense search on what it reached.
Fallback = Literal["none", "all_slices", "dense"]


@dataclass(frozen=True)
class Expansions:
    """Number of entries taken from the open lists, by stage.

    Attributes:
        layers: All slice searches together; where slices are searched by jump points, the jump points.
        sparse: Search on the union of the slice paths, and the rows that its bound settled beforehand.
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
