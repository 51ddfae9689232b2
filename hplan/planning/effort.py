"""Search and optimization budgets of the effort presets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from hplan.optimization.minimize_time import Level, OptimizerEffort
from hplan.planning.options import EffortName, PlanOptions


@dataclass(frozen=True)
class Effort:
    """Search and optimization budget of a motion.

    Attributes:
        pairs: Number of pairs of trees that search for paths.
        queries: Maximum number of distance queries of each pair.
        close: A motion within this multiple of the lower bound on its duration ends the search.
        starts: Optimization of path and timing together.
        leads: Maximum number of approaches that do not begin at rest.
        blended: Optimization of a transit that ends in motion.
        begun: Optimization of a motion that begins in motion.
        pose_goals: Maximum number of configurations at a pose that serve as goals, the nearest first.
        compared: Number of goals whose motions by trees are compared; with 1 the first motion found is taken.
        long_pairs: Number of pairs of longer trees before a goal is refused, for up to seven joints; 0 for none.
        long_queries: Maximum number of distance queries of each of them.
        long_seed: Seed of the first of them, relative to `seed`. With the same seeds trees grow on.
        long_stops_early: True if long trees stop once a motion within `FAR_FROM_BOUND` of the lower bound is found.
        proof_nodes: Maximum number of grid nodes that a proof of infeasibility may visit; 0 for no proofs.
        at_once: True if the first motion is required as soon as possible: with the cheapest search, to few grasps, and
            however slow it is. A faster one near it follows.
        seed: Seed of the first pair of trees; the others have the following ones.
    """

    pairs: int
    queries: int
    close: float
    starts: OptimizerEffort
    leads: int
    blended: OptimizerEffort
    begun: OptimizerEffort
    pose_goals: int
    compared: int = 1
    long_pairs: int = 2
    long_queries: int = 60_000
    long_seed: int = 0
    long_stops_early: bool = True
    proof_nodes: float = 0.0
    at_once: bool = False
    seed: int = 0


#: A motion within this multiple of the lower bound on its duration is close to the fastest.
CLOSE = 1.15

#: A motion beyond this multiple may well pass obstacles on the wrong side.
FAR_FROM_BOUND = 1.3

#: Distance between the tree seeds of two plans whose option `seed` differs by one.
_SEEDS = 1000

#: Levels of the optimizer, from few segments to one per sample.
COARSE = Level(piece_s=0.08, pieces=(20, 40), steps=20, gain=2e-3, trust=0.2)
LAST = Level(piece_s=0.03, pieces=(50, 120), steps=6, gain=5e-3, trust=0.05)
FINE = OptimizerEffort((Level(piece_s=0.03, pieces=(50, 120), steps=12, gain=0.02, trust=0.2),))
FINEST = OptimizerEffort((Level(piece_s=0.012, pieces=(60, 300), steps=20, gain=1e-4, trust=0.2),))
QUICK_START = OptimizerEffort((Level(piece_s=0.05, pieces=(24, 60), steps=8, gain=0.06, trust=0.8, is_brief=True),))

#: A first motion is improved with few segments and long steps.
_FIRST_SOLUTION = OptimizerEffort((replace(COARSE, steps=8, gain=0.02, trust=1.0, enough=0.02),))

#: Of 400 random scenes of a UR5 and an iiwa, twelve had a path that the first trees had missed. Other pairs needed
#: 2,400 to 60,000 distance queries, and one of two pairs found eleven of the twelve within this many: a goal is refused
#: after about a second.
_WITHIN_A_SECOND = 45_000

#: The presets of all robots without a specialist (`hplan.planning.specialist`).
EFFORTS: dict[EffortName, Effort] = {
    "quick": Effort(
        pairs=1,
        queries=6_000,
        close=math.inf,
        starts=OptimizerEffort((replace(COARSE, gain=0.15, trust=0.8, enough=0.05),)),
        leads=0,
        blended=FINE,
        begun=QUICK_START,
        pose_goals=4,
        long_queries=_WITHIN_A_SECOND,
    ),
    "default": Effort(
        pairs=2,
        queries=6_000,
        close=CLOSE,
        starts=OptimizerEffort(
            (
                replace(COARSE, gain=0.02, trust=0.6, enough=7e-3),
                replace(LAST, steps=3, gain=0.03, trust=0.2, enough=2e-3),
            ),
            rough=2,
        ),
        leads=2,
        blended=FINE,
        begun=FINE,
        pose_goals=8,
        long_queries=_WITHIN_A_SECOND,
    ),
    "best": Effort(
        pairs=8,
        queries=12_000,
        close=1.005,
        starts=OptimizerEffort((COARSE, *FINEST.levels), rough=8, others=4, finished=2),
        leads=4,
        blended=FINEST,
        begun=FINEST,
        pose_goals=16,
        compared=6,
        long_pairs=3,
        long_seed=8,
    ),
}


def efforts_of(presets: Mapping[EffortName, Effort], options: PlanOptions) -> tuple[Effort, ...]:
    """The budgets of successive searches; the last is the requested one.

    With a deadline, or if it is requested, a first motion comes at once. An optimizer with more starts need not find
    everything that one with fewer starts finds, so `best` includes `default`.
    """
    requested, quick = presets[options.effort], presets["quick"]
    first = replace(requested, starts=_FIRST_SOLUTION, begun=quick.begun, long_pairs=0, proof_nodes=0.0, at_once=True)
    efforts = (
        *((first,) if options.at_once or options.deadline_s is not None else ()),
        *((presets["default"],) if options.effort == "best" else ()),
        requested,
    )
    return efforts if options.seed == 0 else tuple(replace(effort, seed=_SEEDS * options.seed) for effort in efforts)
