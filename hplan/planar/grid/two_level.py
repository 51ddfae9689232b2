"""Two-level method: slice paths, and a search on their union.

It is complete on the grid.

If the union of the slices between start and goal does not connect the two, all slices of the grid are tried (the path
may extend beyond). If that fails too, the whole grid is flooded: if start and goal are connected, the dense search
finds the path; otherwise no path exists.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import truth
from hplan.base.arrays import IntArray, WordArray, frozen
from hplan.planar.grid.astar import astar
from hplan.planar.grid.flood import flood_from, has_bit
from hplan.planar.grid.grid import Occupancy, checked_node
from hplan.planar.grid.lattice import Lattice, NodeSet
from hplan.planar.grid.restoration import union_of
from hplan.planar.grid.result import Expansions, Fallback, SearchResult, SlicePaths, StageTimes
from hplan.planar.grid.slice_search import search_slices


def two_level_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = True) -> SearchResult:
    """Search slices between start and goal, then their paths' union.

    Slices are taken along the last axis.

    Args:
        occupancy: Free nodes of the grid; at least two axes.
        start: (d,) node index.
        goal: (d,) node index.
        octile: False for the paper's searches, plain A* with the straight line as bound: on every slice that has a
            path, then on the union. By default both use the octile bound, and slices also the bounds from the previous
            slice's search.

    Returns:
        The result, with `path` None if and only if no path exists on the grid.

    Raises:
        InputError: Start or goal is not a node of the grid, or not free.
        OptionError: `octile` is neither True nor False.
    """
    truth("octile", octile)
    begin = time.perf_counter()
    start, goal = checked_node(occupancy, start, "start"), checked_node(occupancy, goal, "goal")
    lattice = Lattice.build(occupancy.grid.shape, occupancy.grid.step)
    free = lattice.add_border(occupancy.free_words)
    between = range(int(min(start[-1], goal[-1])), int(max(start[-1], goal[-1])) + 1)
    layers = search_slices(lattice, free, start, goal, between, octile=octile)
    layers_done = time.perf_counter()
    path, cost, expanded, restored, size = _join(lattice, free, layers, start, goal, octile=octile)
    sparse_done = time.perf_counter()

    counts = Expansions(layers.expansions, expanded, 0, layers.flooded)
    fallback: Fallback = "none"
    if path is None and len(between) < lattice.shape[-1]:
        fallback = "all_slices"
        layers = search_slices(lattice, free, start, goal, range(lattice.shape[-1]), octile=octile)
        path, cost, expanded, restored, size = _join(lattice, free, layers, start, goal, octile=octile, beyond=True)
        counts = counts.with_fallback(layers.expansions + expanded, layers.flooded)
    if path is None:
        fallback = "dense"
        reached, flooded = flood_from(lattice, free, start)
        counts = counts.with_fallback(0, flooded)
        if has_bit(reached, *lattice.node(goal)):
            path, cost, expanded = astar(lattice, NodeSet.from_words(reached), start, goal, octile=octile)
            counts = counts.with_fallback(expanded, 0)
    times = StageTimes(layers_done - begin, sparse_done - layers_done, time.perf_counter() - sparse_done)
    path = None if path is None else frozen(path)
    return SearchResult(path, cost, counts, times, layers, restored, size, fallback)


def _join(
    lattice: Lattice,
    free: WordArray,
    layers: SlicePaths,
    start: IntArray,
    goal: IntArray,
    *,
    octile: bool,
    beyond: bool = False,
) -> tuple[IntArray | None, float, int, tuple[int, ...], int]:
    """Search the union of slice paths.

    Restored segments start from one end and are mostly dead ends, so the search starts from the other end, except in
    the paper's variant.

    Returns:
        Path or None, cost, number of expansions, restored slices, and number of nodes of the union.
    """
    nodes, restored = union_of(lattice, free, layers, start, goal, beyond=beyond)
    has_path = layers.feasible
    if octile and has_path[goal[-1]] and not has_path[start[-1]]:
        path, cost, expansions = astar(lattice, nodes, goal, start, octile=True)
        path = None if path is None else np.ascontiguousarray(path[::-1])
    else:
        path, cost, expansions = astar(lattice, nodes, start, goal, octile=octile)
    return path, cost, expansions, restored, nodes.size
