"""The paper's method: analytic C-space and search on a joint grid.

`occupancy` implements equations (1)-(3), `sections` the planar sections that they apply to; `astar` is the dense A*,
`two_level` the paper's two-level method. The search depends on nodes and costs only, not on robots.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hplan.base.lazy_import import lazy_names

if TYPE_CHECKING:
    from hplan.planar.grid.astar import dense_search
    from hplan.planar.grid.flood import reachable_nodes, slices_with_path
    from hplan.planar.grid.result import Expansions, Fallback, SearchResult, StageTimes
    from hplan.planar.grid.two_level import two_level_search

__all__ = [
    "Expansions",
    "Fallback",
    "SearchResult",
    "StageTimes",
    "dense_search",
    "reachable_nodes",
    "slices_with_path",
    "two_level_search",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.planar.grid.astar": "dense_search",
        "hplan.planar.grid.flood": "reachable_nodes slices_with_path",
        "hplan.planar.grid.result": "Expansions Fallback SearchResult StageTimes",
        "hplan.planar.grid.two_level": "two_level_search",
    },
)
