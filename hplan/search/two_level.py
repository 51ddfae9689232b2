"""The two-level method: slice paths, their sparse union, and a search on it; complete on the grid.

Planar slices are searched on their own. Slices of three and more axes (a base that turns, arms of more links) are
two-level problems themselves: the paper's layering applied once more.

Where the union of the slices between start and goal does not join the two, all slices of the grid are tried (the way
may lead beyond). Where that fails too, the whole grid is flooded: if start and goal are connected, the dense search
finds the path; if they are not, there is none. With four axes and more, where there would be too many slices to try, a
column is looked for first, then two wavefronts settle it. There a path found in one slice also serves all others in
which it is free; only slices left over are searched.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from numpy.typing import ArrayLike

from hplan.base.arrays import IntArray, WordArray, frozen
from hplan.search.astar import astar
from hplan.search.column import by_column
from hplan.search.endpoints import check_occupancy, checked_node
from hplan.search.flood import flood_from, has_bit
from hplan.search.grid import Occupancy
from hplan.search.lattice import Lattice
from hplan.search.node_set import NodeSet
from hplan.search.restoration import union_of
from hplan.search.result import Expansions, Fallback, SearchResult, StageTimes, path_cost
from hplan.search.row_bounds import row_bounds
from hplan.search.slice_search import SlicePaths, SliceSearch, search_layers
from hplan.search.wavefront import meet

#: Axes from which on the fallback is by wavefronts.
MANY_AXES = 4


def two_level_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = True) -> SearchResult:
    """Search every slice of the last axis between start and goal, then the union of their paths.

    Args:
        occupancy: Which nodes are free; at least two axes.
        start: (d,) node index.
        goal: (d,) node index.
        octile: False for the searches of the paper, plain A* with the straight line as bound: on every slice that
            has a path, then on the union. By default planar slices are searched by jump points, slices of more axes by
            this method itself, and the union with the distances of its projection (`row_bounds`).

    Returns:
        The result; its path is None exactly when no path exists on the grid.

    Raises:
        InputError: Start or goal is no node of the grid, or not free.
    """
    start = checked_node(occupancy, start, "start")
    goal = checked_node(occupancy, goal, "goal")
    check_occupancy(occupancy)
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    begin = time.perf_counter()
    found = _two_level(lattice, lattice.bordered(occupancy.free_words), start, goal, octile=octile)
    return SearchResult(
        path=None if found.path is None else frozen(found.path),
        cost=found.cost,
        expansions=found.counts,
        times=StageTimes(
            time.perf_counter() - begin - found.times.sparse - found.times.fallback,
            found.times.sparse,
            found.times.fallback,
        ),
        layers=found.layers,
        restored_slices=found.joined.restored,
        sparse_nodes=found.joined.nodes,
        fallback=found.fallback,
    )


@dataclass(frozen=True, eq=False)
class _Joined:
    """What the union of slice paths led to: path, cost, expansions; slices restored, nodes of the union."""

    path: IntArray | None
    cost: float
    expansions: int
    restored: tuple[int, ...]
    nodes: int


@dataclass(frozen=True, eq=False)
class _Found:
    """What one two-level search found, and by what."""

    path: IntArray | None
    cost: float
    counts: Expansions
    times: StageTimes
    layers: SlicePaths
    joined: _Joined
    fallback: Fallback


def _two_level(lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray, *, octile: bool) -> _Found:
    """The search on bordered rows; start and goal are free nodes."""
    begin = time.perf_counter()
    between = range(int(min(start[-1], goal[-1])), int(max(start[-1], goal[-1])) + 1)
    slice_search = _slice_search(len(lattice.shape) - 1, octile=octile)
    many = octile and len(lattice.shape) >= MANY_AXES
    layers = search_layers(lattice, free, start, goal, between, slice_search, carried=many)
    layers_done = time.perf_counter()
    joined = _join(lattice, free, layers, start, goal, octile=octile)
    path, cost = joined.path, joined.cost
    sparse_done = time.perf_counter()

    counts = Expansions(layers.expansions, joined.expansions, 0, layers.flooded)
    fallback: Fallback = "none"
    if path is None and slice_search is not None and len(lattice.shape) >= MANY_AXES:
        fallback = "column"
        path, expanded, flooded = by_column(lattice, free, start, goal, slice_search)
        counts = counts.with_fallback(expanded, flooded)
        cost = math.inf if path is None else path_cost(path, lattice.step)
    if path is None and len(lattice.shape) >= MANY_AXES:
        fallback = "wavefront"
        fronts = meet(lattice, free, start, goal)
        path = fronts.path
        counts = counts.with_fallback(0, fronts.flooded)
        cost = math.inf if path is None else path_cost(path, lattice.step)
    if path is None and fallback == "none" and len(between) < lattice.shape[-1]:
        fallback = "all_slices"
        layers = search_layers(lattice, free, start, goal, range(lattice.shape[-1]), slice_search)
        joined = _join(lattice, free, layers, start, goal, octile=octile, beyond=True)
        path, cost = joined.path, joined.cost
        counts = counts.with_fallback(layers.expansions + joined.expansions, layers.flooded)
    if path is None and fallback != "wavefront":
        fallback = "dense"
        reached, flooded = flood_from(lattice, free, start)
        counts = counts.with_fallback(0, flooded)
        if has_bit(reached, lattice.row_of(goal), int(goal[-1])):
            path, cost, dense = astar(lattice, NodeSet.of(reached), start, goal, octile=octile)
            counts = counts.with_fallback(dense, 0)
    times = StageTimes(layers_done - begin, sparse_done - layers_done, time.perf_counter() - sparse_done)
    return _Found(path, cost if path is not None else math.inf, counts, times, layers, joined, fallback)


def _slice_search(axes: int, *, octile: bool) -> SliceSearch | None:
    """How slices of this many axes are searched."""
    if octile and axes == 2:
        return None

    def plain(
        lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray
    ) -> tuple[IntArray | None, float, int, int]:
        return *astar(lattice, NodeSet.of(free), start, goal, octile=octile), 0

    def nested(
        lattice: Lattice, free: WordArray, start: IntArray, goal: IntArray
    ) -> tuple[IntArray | None, float, int, int]:
        found = _two_level(lattice, free, start, goal, octile=octile)
        return found.path, found.cost, found.counts.total, found.counts.flooded

    return nested if octile and axes > 2 else plain


def _join(
    lattice: Lattice,
    free: WordArray,
    layers: SlicePaths,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
    beyond: bool = False,
) -> _Joined:
    """Search the union of slice paths; the expansions of its bound are among the search's."""
    union = union_of(lattice, free, layers, start, goal, beyond=beyond)
    bounds = row_bounds(lattice, union.nodes, lattice.row_of(goal)) if octile else None
    path, cost, expansions = astar(lattice, union.nodes, start, goal, octile=octile, row_bounds=bounds)
    settled = 0 if bounds is None else bounds.settled
    return _Joined(path, cost, expansions + settled, union.restored, union.nodes.size)
