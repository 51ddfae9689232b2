"""Search on a grid: dense A*, and the two-level method. Knows nodes and costs, nothing of robots."""

from hplan.search.astar import dense_search
from hplan.search.flood import reachable, slices_with_path
from hplan.search.result import Expansions, Fallback, SearchResult, StageTimes
from hplan.search.two_level import two_level_search

__all__ = [
    "Expansions",
    "Fallback",
    "SearchResult",
    "StageTimes",
    "dense_search",
    "reachable",
    "slices_with_path",
    "two_level_search",
]
