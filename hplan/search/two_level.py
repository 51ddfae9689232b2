"""The two-level method: slice paths, their sparse union, and a search on it; complete on the grid.

Where the union does not join start and goal, the whole grid is flooded. If they are connected, the dense search finds
the path; if they are not, there is none.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import IntArray, WordArray
from hplan.grid import Occupancy
from hplan.search.endpoints import checked_node
from hplan.search.flood import flood_from
from hplan.search.lattice import Lattice, astar
from hplan.search.layers import search_layers
from hplan.search.restoration import restore
from hplan.search.result import Expansions, Fallback, SearchResult, StageTimes


def two_level_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = True) -> SearchResult:
    """Search every slice of the last axis between start and goal, then the union of their paths.

    Args:
        occupancy: Which nodes are free; at least two axes.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Bound the way to go by the octile distance (fewer expansions); False for the paper's straight line.

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
    slices = range(min(start[-1], goal[-1]), max(start[-1], goal[-1]) + 1)
    layers = search_layers(lattice, free, start, goal, slices, octile=octile)
    layers_done = time.perf_counter()

    parts = restore(occupancy, layers.paths, int(start[-1]), int(goal[-1]))
    pieces = [*layers.paths.values(), *(part for row in parts.values() for part in row)]
    union = _union(lattice, [*pieces, start[None], goal[None]])
    path, cost, sparse_expansions = astar(lattice, union, start, goal, octile=octile)
    sparse_done = time.perf_counter()

    flooded, fallback_expansions = layers.flooded, 0
    fallback: Fallback = "none"
    if path is None:
        fallback = "dense"
        reached, count = flood_from(lattice, free, lattice.row_of(start), int(start[-1]))
        flooded += count
        word, bit = int(goal[-1]) >> 6, int(goal[-1]) & 63
        if (int(reached[lattice.row_of(goal), word]) >> bit) & 1:
            path, cost, fallback_expansions = astar(lattice, reached, start, goal, octile=octile)
    return SearchResult(
        path=path,
        cost=cost if path is not None else math.inf,
        expansions=Expansions(layers.expansions, sparse_expansions, fallback_expansions, flooded),
        times=StageTimes(layers_done - begin, sparse_done - layers_done, time.perf_counter() - sparse_done),
        feasible_slices=layers.feasible,
        slice_paths=layers.paths,
        restored_slices=tuple(sorted(parts)),
        sparse_nodes=int(np.bitwise_count(union).sum()),
        fallback=fallback,
    )


def _union(lattice: Lattice, pieces: list[IntArray]) -> WordArray:
    """Bordered bit rows with every node of the pieces set."""
    nodes = np.concatenate(pieces)
    inside = tuple(nodes[:, axis] + 1 for axis in range(nodes.shape[1] - 1))
    rows = np.ravel_multi_index(inside, lattice.padded)
    bits = nodes[:, -1]
    union = np.zeros((lattice.rows, lattice.words), dtype=np.uint64)
    np.bitwise_or.at(union, (rows, bits >> 6), np.uint64(1) << (bits & 63).astype(np.uint64))
    return union
