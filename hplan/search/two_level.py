"""The two-level method: slice paths, their sparse union, and a search on it; complete on the grid.

Where the union of the slices between start and goal does not join the two, all slices of the grid are tried (the way
may lead beyond). Where that fails too, the whole grid is flooded: if start and goal are connected, the dense search
finds the path; if they are not, there is none.
"""

from __future__ import annotations

import math
import time

from numpy.typing import ArrayLike

from hplan.arrays import IntArray, frozen
from hplan.grid import Occupancy
from hplan.search.astar import astar
from hplan.search.endpoints import checked_node
from hplan.search.flood import flood_from, has_bit
from hplan.search.lattice import Lattice
from hplan.search.layers import search_layers
from hplan.search.restoration import Union, union_of
from hplan.search.result import Expansions, Fallback, SearchResult, StageTimes
from hplan.search.row_bounds import row_bounds


def two_level_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = True) -> SearchResult:
    """Search every slice of the last axis between start and goal, then the union of their paths.

    Args:
        occupancy: Which nodes are free; at least two axes.
        start: (d,) node index.
        goal: (d,) node index.
        octile: False for the searches of the paper, plain A* with the straight line as bound: on every slice that
            has a path, then on the union. By default planar slices are searched by jump points, other slices with the
            octile bound, and the union with the distances of its projection (`row_bounds`); every slice path and the
            path on the union have the same cost, with fewer expansions.

    Returns:
        The result; its path is None exactly when no path exists on the grid.

    Raises:
        InputError: Start or goal is no node of the grid, or not free.
    """
    begin = time.perf_counter()
    start = checked_node(occupancy, start, "start")
    goal = checked_node(occupancy, goal, "goal")
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    free = lattice.bordered(occupancy.free_words)
    between = range(int(min(start[-1], goal[-1])), int(max(start[-1], goal[-1])) + 1)
    layers = search_layers(lattice, free, start, goal, between, octile=octile)
    slice_paths = layers.paths(lattice)
    layers_done = time.perf_counter()
    union = union_of(lattice, free, layers, start, goal)
    path, cost, sparse = _search_union(lattice, union, start, goal, octile=octile)
    sparse_done = time.perf_counter()

    counts = Expansions(layers.expansions, sparse, 0, layers.flooded)
    fallback: Fallback = "none"
    if path is None and len(between) < lattice.shape[-1]:
        fallback = "all_slices"
        layers = search_layers(lattice, free, start, goal, range(lattice.shape[-1]), octile=octile)
        slice_paths = layers.paths(lattice)
        union = union_of(lattice, free, layers, start, goal, beyond=True)
        path, cost, sparse = _search_union(lattice, union, start, goal, octile=octile)
        counts = counts.with_fallback(layers.expansions + sparse, layers.flooded)
    if path is None:
        fallback = "dense"
        reached, flooded = flood_from(lattice, free, lattice.row_of(start), int(start[-1]))
        counts = counts.with_fallback(0, flooded)
        if has_bit(reached, lattice.row_of(goal), int(goal[-1])):
            path, cost, dense = astar(lattice, reached, start, goal, octile=octile)
            counts = counts.with_fallback(dense, 0)
    end = time.perf_counter()
    return SearchResult(
        path=None if path is None else frozen(path),
        cost=cost if path is not None else math.inf,
        expansions=counts,
        times=StageTimes(layers_done - begin, sparse_done - layers_done, end - sparse_done),
        feasible_slices=layers.feasible,
        slice_paths=slice_paths,
        restored_slices=union.restored,
        sparse_nodes=union.nodes,
        fallback=fallback,
    )


def _search_union(
    lattice: Lattice, union: Union, start: IntArray, goal: IntArray, *, octile: bool
) -> tuple[IntArray | None, float, int]:
    """Path on the sparse graph, its cost and the expansions, those of its bound among them."""
    if not octile:
        return astar(lattice, union.words, start, goal, octile=False)
    bounds = row_bounds(lattice, union.words, lattice.row_of(goal))
    path, cost, expansions = astar(lattice, union.words, start, goal, octile=True, row_bounds=bounds)
    return path, cost, expansions + bounds.settled
