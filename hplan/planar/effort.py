"""Budgets of the effort presets for planar arms."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Self

from hplan.optimization.minimize_time import OptimizerEffort as OptimizerEffort
from hplan.optimization.several_starts import StartsEffort
from hplan.planar.grids import GridAttempt
from hplan.planning.effort import COARSE, FINE, FINEST, LAST, QUICK_START, Effort, TreesEffort, near_one
from hplan.planning.options import EffortName


@dataclass(frozen=True)
class PlanarEffort(Effort):
    """Search budget for a motion of a planar arm.

    Attributes:
        after_grid: Trees that search for alternatives to the grid path; None for no such search.
        coarse_grids: Coarse grids searched in addition to trees if the fine grid has too many nodes.
    """

    after_grid: TreesEffort | None = None
    coarse_grids: tuple[GridAttempt, ...] = ()
    long_stops_early: bool = False
    proof_nodes: float = math.inf

    def with_seed(self, seed: int) -> Self:
        """Return a copy with other random seeds."""
        trees = self.after_grid
        return replace(super().with_seed(seed), after_grid=None if trees is None else replace(trees, seed=seed))


_GRIDS: Final = (GridAttempt(2.0, growth_m=0.02), GridAttempt(2.0, growth_m=5e-3), GridAttempt(3.0, growth_m=0.01))

#: Effort presets of planar arms.
EFFORTS: dict[EffortName, Effort] = {
    "quick": PlanarEffort(
        trees=TreesEffort(1, 4_000),
        close=math.inf,
        starts=near_one(replace(COARSE, gain=0.01, trust=0.4), replace(LAST, steps=2)),
        leads=0,
        blended=FINE,
        begun=QUICK_START,
        pose_goals=4,
    ),
    "default": PlanarEffort(
        trees=TreesEffort(8, 4_000),
        after_grid=TreesEffort(2, 1_000),
        coarse_grids=_GRIDS,
        close=1.04,
        starts=StartsEffort(OptimizerEffort((COARSE, LAST)), rough=8, others=4, finished=1),
        leads=2,
        blended=FINE,
        begun=FINE,
        pose_goals=8,
    ),
    "best": PlanarEffort(
        trees=TreesEffort(16, 4_000),
        after_grid=TreesEffort(16, 4_000),
        coarse_grids=_GRIDS,
        close=1.005,
        starts=StartsEffort(OptimizerEffort((COARSE, *FINEST.levels)), rough=8, others=4, finished=2),
        leads=4,
        blended=FINEST,
        begun=FINEST,
        pose_goals=16,
        compared=6,
    ),
}
