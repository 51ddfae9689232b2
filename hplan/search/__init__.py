"""Search on a grid: dense A*, and the two-level method. Knows nodes and costs, nothing of robots."""

from hplan.search.dense import dense_search
from hplan.search.result import Expansions, SearchResult, StageTimes
from hplan.search.two_level import two_level_search

__all__ = ["Expansions", "SearchResult", "StageTimes", "dense_search", "two_level_search"]
