"""What may be spent on a motion, by the option `effort`: one table for planar arms, one for all others."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hplan.optimization.minimize_time import Effort, Level
from hplan.optimization.several_starts import StartsEffort
from hplan.planning.options import EffortName
from hplan.planning.sampling.several_trees import TreesEffort
from hplan.planning.task import GridAttempt, PlanningContext

_COARSE = Level(piece_s=0.08, pieces=(20, 40), steps=20, gain=2e-3, trust=0.2)

#: A motion that takes no more than so many times the least duration is close to the fastest.
CLOSE = 1.15


@dataclass(frozen=True)
class PlanningEffort:
    """What may be spent on a motion.

    Attributes:
        trees: Pairs of trees that look for paths.
        planar: Those that look for other paths where the base is locked and a grid has been searched; None for none.
        grids: Coarse grids where the base is locked and a fine one has too many nodes to be searched first.
        close: With a motion of the first pair of trees that takes no more than so many times the least duration no
            others grow.
        starts: Optimisation of path and timing together; None for none.
        leads: So many approaches that do not begin at rest are tried.
        blended: Optimisation of a transit that ends in motion.
        begun: Optimisation of a motion that begins in motion.
        pose_goals: To so many of the configurations with a frame at a pose motions are looked for, the nearest ones.
    """

    trees: TreesEffort
    planar: TreesEffort | None
    grids: tuple[GridAttempt, ...]
    close: float
    starts: StartsEffort | None
    leads: int
    blended: Effort
    begun: Effort
    pose_goals: int


_GRIDS = (GridAttempt(2.0, growth_m=0.02), GridAttempt(2.0, growth_m=5e-3), GridAttempt(3.0, growth_m=0.01))
_FINE = Effort((Level(piece_s=0.03, pieces=(50, 120), steps=12, gain=0.02, trust=0.2),))
_FINEST = Effort((Level(piece_s=0.012, pieces=(60, 300), steps=20, gain=1e-4, trust=0.2),))

#: Of planar arms.
EFFORTS: dict[EffortName, PlanningEffort] = {
    "quick": PlanningEffort(
        trees=TreesEffort(2, 12_000),
        planar=None,
        grids=(),
        close=CLOSE,
        starts=StartsEffort(
            Effort((Level(piece_s=0.03, pieces=(50, 120), steps=4, gain=2e-2, trust=0.2),)),
            rough=1,
            others=0,
            finished=1,
        ),
        leads=0,
        blended=_FINE,
        begun=Effort((Level(piece_s=0.05, pieces=(24, 60), steps=8, gain=0.05, trust=0.2),)),
        pose_goals=4,
    ),
    "default": PlanningEffort(
        trees=TreesEffort(4, 12_000),
        planar=TreesEffort(2, 3_000),
        grids=_GRIDS,
        close=1.08,
        starts=StartsEffort(
            Effort((_COARSE, Level(piece_s=0.03, pieces=(50, 120), steps=3, gain=5e-3, trust=0.05))),
            rough=4,
            others=1,
            finished=2,
        ),
        leads=2,
        blended=_FINE,
        begun=_FINE,
        pose_goals=8,
    ),
    "best": PlanningEffort(
        trees=TreesEffort(16, 12_000),
        planar=TreesEffort(16, 12_000),
        grids=_GRIDS,
        close=1.005,
        starts=StartsEffort(Effort((_COARSE, *_FINEST.levels)), rough=8, others=4, finished=2),
        leads=4,
        blended=_FINEST,
        begun=_FINEST,
        pose_goals=16,
    ),
}

#: Of general (non-planar) arms, an evaluation of whose clearance takes ten times as long.
EFFORTS_OF_BODIES: dict[EffortName, PlanningEffort] = {
    "quick": replace(EFFORTS["quick"], trees=TreesEffort(1, 6_000)),
    "default": replace(
        EFFORTS["default"],
        trees=TreesEffort(2, 6_000),
        planar=None,
        grids=(),
        close=CLOSE,
        starts=StartsEffort(
            Effort(
                (
                    replace(_COARSE, enough=7e-3),
                    Level(piece_s=0.03, pieces=(50, 120), steps=2, gain=5e-3, trust=0.05, enough=2e-3),
                ),
                between_rows=True,
            ),
            rough=2,
            others=0,
            finished=1,
        ),
    ),
    "best": replace(EFFORTS["best"], trees=TreesEffort(8, 12_000), planar=None, grids=()),
}


def effort_of(context: PlanningContext) -> PlanningEffort:
    """What may be spent on motions of a context."""
    return (EFFORTS_OF_BODIES if context.robot.planar is None else EFFORTS)[context.options.effort]


def optimization_of(context: PlanningContext) -> StartsEffort | None:
    """What may be spent on their optimisation; None where a short path is asked for, not a fast motion."""
    return effort_of(context).starts if context.options.objective == "duration" else None
