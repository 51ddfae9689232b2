"""Budgets of the effort presets for planar arms."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from hplan.optimization.minimize_time import OptimizerEffort
from hplan.planar.grids import GridAttempt
from hplan.planning.effort import COARSE, FINE, FINEST, LAST, QUICK_START, Effort
from hplan.planning.options import EffortName


@dataclass(frozen=True)
class PlanarEffort(Effort):
    """Search budget for a motion of a planar arm.

    Attributes:
        after_grid_pairs: Number of pairs of trees that search for alternatives to the grid path; 0 for no such search.
        after_grid_queries: Maximum number of distance queries of each of them.
        coarse_grids: Coarse grids searched in addition to trees if the fine grid has too many nodes.
    """

    after_grid_pairs: int = 0
    after_grid_queries: int = 0
    coarse_grids: tuple[GridAttempt, ...] = ()
    long_stops_early: bool = False
    proof_nodes: float = math.inf


_GRIDS: Final = (GridAttempt(2.0, growth_m=0.02), GridAttempt(2.0, growth_m=5e-3), GridAttempt(3.0, growth_m=0.01))

#: Effort presets of planar arms.
EFFORTS: dict[EffortName, Effort] = {
    "quick": PlanarEffort(
        pairs=1,
        queries=4_000,
        close=math.inf,
        starts=OptimizerEffort((replace(COARSE, gain=0.01, trust=0.4), replace(LAST, steps=2))),
        leads=0,
        blended=FINE,
        begun=QUICK_START,
        pose_goals=4,
    ),
    "default": PlanarEffort(
        pairs=8,
        queries=4_000,
        after_grid_pairs=2,
        after_grid_queries=1_000,
        coarse_grids=_GRIDS,
        close=1.04,
        starts=OptimizerEffort((COARSE, LAST), rough=8, others=4),
        leads=2,
        blended=FINE,
        begun=FINE,
        pose_goals=8,
    ),
    "best": PlanarEffort(
        pairs=16,
        queries=4_000,
        after_grid_pairs=16,
        after_grid_queries=4_000,
        coarse_grids=_GRIDS,
        close=1.005,
        starts=OptimizerEffort((COARSE, *FINEST.levels), rough=8, others=4, finished=2),
        leads=4,
        blended=FINEST,
        begun=FINEST,
        pose_goals=16,
        compared=6,
    ),
}
