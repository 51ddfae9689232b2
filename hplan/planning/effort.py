"""What may be spent on a motion, by the option `effort`: one table for planar arms, one for all others."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from hplan.optimization.minimize_time import Effort as OptimizerEffort
from hplan.optimization.minimize_time import Level
from hplan.optimization.several_starts import StartsEffort
from hplan.planning.options import EffortName, PlanOptions
from hplan.planning.sampling.several_trees import TreesEffort
from hplan.robot.model import Robot


@dataclass(frozen=True)
class GridAttempt:
    """A grid: how fine and wide the grid is, and how obstacles are mapped into it.

    Attributes:
        step_factor: Largest spacing of the grid as a multiple of the option `step_deg`.
        yaw_range_deg: How far the base may turn beyond start and goal; used where it turns [deg].
        growth_m: Growth of obstacles in the C-space [m].
    """

    step_factor: float = 1.0
    yaw_range_deg: float = 0.0
    growth_m: float = 0.0


#: Trees before goals are refused that have a grid as well; and none at all.
_LONG, NO_TREES = TreesEffort(2, 60_000), TreesEffort(0, 0)


@dataclass(frozen=True)
class Effort:
    """What may be spent on a motion.

    Attributes:
        trees: Pairs of trees that look for paths.
        planar: Those that look for other paths where the base is locked and a grid has been searched; None for none.
        grids: Coarse grids where the base is locked and a fine one has too many nodes to be searched first.
        close: With a motion of the first pair of trees that takes no more than so many times the least duration no
            others grow; nor is one that came at once improved.
        starts: Optimisation of path and timing together; None for none.
        leads: So many approaches that do not begin at rest are tried.
        blended: Optimisation of a transit that ends in motion.
        begun: Optimisation of a motion that begins in motion.
        pose_goals: To so many of the configurations with a frame at a pose motions are looked for, the nearest ones.
        compared: Motions by trees to so many goals are compared; the first that is found is taken where it is one.
        long: Trees that grow before goals are refused, beyond `trees`; none where there are no pairs of them.
        floods: Most nodes of grids that are flooded to show that there is no path; 0 for none.
        at_once: Whether the first motion is to come as soon as can be: by what finds most motions in a few
            milliseconds, to a few grasps, without regard to how quick it is. A quicker one near it follows.
    """

    trees: TreesEffort
    planar: TreesEffort | None
    grids: tuple[GridAttempt, ...]
    close: float
    starts: StartsEffort | None
    leads: int
    blended: OptimizerEffort
    begun: OptimizerEffort
    pose_goals: int
    compared: int = 1
    long: TreesEffort = _LONG
    floods: float = math.inf
    at_once: bool = False


#: A motion that takes no more than so many times the least duration is close to the fastest.
CLOSE = 1.15

#: One that takes more than so many times that may well lead past obstacles on a side that is not the best.
FAR = 1.3

#: Seeds of trees that follow one another: as many as the seeds of two plans are apart.
_SEEDS = 1000

_COARSE = Level(piece_s=0.08, pieces=(20, 40), steps=20, gain=2e-3, trust=0.2)
_LAST = Level(piece_s=0.03, pieces=(50, 120), steps=6, gain=5e-3, trust=0.05)
_GRIDS = (GridAttempt(2.0, growth_m=0.02), GridAttempt(2.0, growth_m=5e-3), GridAttempt(3.0, growth_m=0.01))
_FINE = OptimizerEffort((Level(piece_s=0.03, pieces=(50, 120), steps=12, gain=0.02, trust=0.2),))
_FINEST = OptimizerEffort((Level(piece_s=0.012, pieces=(60, 300), steps=20, gain=1e-4, trust=0.2),))


def _near_one(*levels: Level) -> StartsEffort:
    """Optimisation near one path."""
    return StartsEffort(OptimizerEffort(levels), rough=1, others=0, finished=1)


#: A motion that came at once is made quicker with few pieces, by long steps.
_AT_ONCE = _near_one(replace(_COARSE, steps=8, gain=0.02, trust=1.0, enough=0.02))

#: Of 400 random scenes of a UR5 and an iiwa twelve had a path that the first trees had missed. Others took 2,400 to
#: 60,000 looks, and of two pairs one found eleven of them within this many: a goal is refused after about a second.
_WITHIN_A_SECOND = TreesEffort(2, 45_000)

#: Of planar arms.
EFFORTS: dict[EffortName, Effort] = {
    "quick": Effort(
        trees=TreesEffort(1, 4_000),
        planar=None,
        grids=(),
        close=math.inf,
        starts=_near_one(replace(_COARSE, gain=0.01, trust=0.4), replace(_LAST, steps=2)),
        leads=0,
        blended=_FINE,
        begun=OptimizerEffort((Level(piece_s=0.05, pieces=(24, 60), steps=8, gain=0.05, trust=0.2),)),
        pose_goals=4,
    ),
    "default": Effort(
        trees=TreesEffort(8, 4_000),
        planar=TreesEffort(2, 1_000),
        grids=_GRIDS,
        close=1.04,
        starts=StartsEffort(OptimizerEffort((_COARSE, _LAST)), rough=8, others=4, finished=1),
        leads=2,
        blended=_FINE,
        begun=_FINE,
        pose_goals=8,
    ),
    "best": Effort(
        trees=TreesEffort(16, 4_000),
        planar=TreesEffort(16, 4_000),
        grids=_GRIDS,
        close=1.005,
        starts=StartsEffort(OptimizerEffort((_COARSE, *_FINEST.levels)), rough=8, others=4, finished=2),
        leads=4,
        blended=_FINEST,
        begun=_FINEST,
        pose_goals=16,
        compared=6,
    ),
}

#: Of general (non-planar) arms: they have more joints, no grids and no floods.
EFFORTS_OF_BODIES: dict[EffortName, Effort] = {
    "quick": replace(
        EFFORTS["quick"],
        trees=TreesEffort(1, 6_000),
        long=_WITHIN_A_SECOND,
        floods=0.0,
        starts=_near_one(replace(_COARSE, gain=0.15, trust=0.8, enough=0.05)),
    ),
    "default": replace(
        EFFORTS["default"],
        trees=TreesEffort(2, 6_000),
        long=_WITHIN_A_SECOND,
        planar=None,
        grids=(),
        floods=0.0,
        close=CLOSE,
        starts=StartsEffort(
            OptimizerEffort(
                (
                    replace(_COARSE, gain=0.02, trust=0.6, enough=7e-3),
                    replace(_LAST, steps=3, trust=0.2, enough=2e-3),
                )
            ),
            rough=2,
            others=0,
            finished=1,
        ),
    ),
    "best": replace(
        EFFORTS["best"],
        trees=TreesEffort(8, 12_000),
        long=TreesEffort(3, 60_000, seed=8),
        planar=None,
        grids=(),
        floods=0.0,
    ),
}


def effort_named(robot: Robot, name: EffortName) -> Effort:
    """What may be spent on motions of a robot."""
    return (EFFORTS if robot.planar is not None else EFFORTS_OF_BODIES)[name]


def efforts_of(robot: Robot, options: PlanOptions) -> tuple[Effort, ...]:
    """What may be spent on motions, one after the other, the last one what the options ask for.

    With a deadline a first motion comes at once. More starts of an optimiser need not lead to all that fewer lead to,
    so that what `default` finds counts for `best` too.
    """
    asked, quick = effort_named(robot, options.effort), effort_named(robot, "quick")
    first = replace(asked, starts=_AT_ONCE, begun=quick.begun, long=NO_TREES, floods=0.0, at_once=True)
    efforts = (
        *((first,) if options.deadline_s is not None else ()),
        *((effort_named(robot, "default"),) if options.effort == "best" else ()),
        asked,
    )
    return efforts if options.seed == 0 else tuple(_seeded(effort, _SEEDS * options.seed) for effort in efforts)


def _seeded(effort: Effort, seed: int) -> Effort:
    planar = None if effort.planar is None else replace(effort.planar, seed=seed)
    long = replace(effort.long, seed=seed + effort.long.seed)
    return replace(effort, trees=replace(effort.trees, seed=seed), planar=planar, long=long)
