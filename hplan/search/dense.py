"""The baseline: A* on the whole grid."""

from __future__ import annotations

import time

from numpy.typing import ArrayLike

from hplan.base.arrays import frozen
from hplan.search.astar import astar
from hplan.search.endpoints import check_occupancy, checked_node
from hplan.search.grid import Occupancy
from hplan.search.lattice import Lattice
from hplan.search.node_set import NodeSet
from hplan.search.result import Expansions, SearchResult, StageTimes


def dense_search(occupancy: Occupancy, start: ArrayLike, goal: ArrayLike, *, octile: bool = False) -> SearchResult:
    """Shortest path over all free nodes, each joined to all its neighbours (26 in 3-D).

    Args:
        occupancy: Which nodes are free.
        start: (d,) node index.
        goal: (d,) node index.
        octile: Use the octile bound instead of the paper's straight line; same cost, fewer expansions.

    Raises:
        InputError: Start or goal is no node of the grid, or not free.
    """
    begin = time.perf_counter()
    check_occupancy(occupancy)
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    path, cost, expansions = astar(
        lattice,
        NodeSet.of(lattice.bordered(occupancy.free_words)),
        checked_node(occupancy, start, "start"),
        checked_node(occupancy, goal, "goal"),
        octile=octile,
    )
    return SearchResult(
        path=None if path is None else frozen(path),
        cost=cost,
        expansions=Expansions(fallback=expansions),
        times=StageTimes(fallback=time.perf_counter() - begin),
    )
