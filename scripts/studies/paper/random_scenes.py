"""Random planar scenes: the reference arm among a few discs, with free start and goal nodes.

`compare` runs the two-level and the dense search on each. Start and goal may lie in different parts of the free space,
so that some scenes have no path; both searches must say so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np
from studies.planar_cspace import RoundedPolygon, joint_grid, planar_sections

from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.grid import Fallback, dense_search, two_level_search
from hplan.grid.grid import Occupancy
from hplan.grid.occupancy import occupancy
from hplan.grid.sections import LinkModel
from hplan.robot.planar_family import PlanarArm

#: The arm of the paper's example: lengths and half-widths [m], limits [rad].
ARM = PlanarArm(
    ("shoulder", "elbow", "wrist"),
    ("upper_arm", "forearm", "hand"),
    readonly([1.0, 0.8, 0.4]),
    readonly([0.05, 0.04, 0.03]),
    readonly([0, 0, 0]),
    readonly([1, 1, 1]),
    readonly([0, 0, 0]),
    readonly([0, 0, 0]),
    readonly([np.pi / 2] * 3),
)
#: Its joint grid, step 1 deg.
GRID = joint_grid(ARM, np.radians(1.0))


@dataclass(frozen=True, eq=False)
class DiscScene:
    """Discs, the occupancy they make of the reference joint grid, and two free nodes of it.

    Attributes:
        discs: (k, 3) centre x, centre y, radius [m].
        occupancy: Occupancy of the grid 0..90 deg, step 1 deg.
        start: (3,) node index.
        goal: (3,) node index.
    """

    discs: FloatArray
    occupancy: Occupancy
    start: IntArray
    goal: IntArray


def disc_occupancy(discs: FloatArray, link_model: LinkModel = "capsule") -> Occupancy:
    """Occupancy of the reference grid with (k, 3) discs."""
    polygons = [RoundedPolygon(disc[None, :2], float(disc[2])) for disc in np.asarray(discs)]
    return occupancy(ARM, planar_sections(polygons, ARM.half_widths, link_model=link_model), GRID)


def random_planar_scene(rng: np.random.Generator) -> DiscScene:
    """1 to 12 discs within reach; start and goal drawn from the free nodes."""
    while True:
        count = int(rng.integers(1, 13))
        distance = rng.uniform(0.25, 2.2, count)
        bearing = np.radians(rng.uniform(-20.0, 200.0, count))
        radius = rng.uniform(0.02, 0.25 if count < 5 else 0.12, count)
        discs = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), radius])
        occupied = disc_occupancy(discs)
        free = np.argwhere(~occupied.occupied)
        if len(free) > 1:
            start, goal = free[rng.integers(len(free), size=2)]
            return DiscScene(discs, occupied, start, goal)


@dataclass(frozen=True)
class SearchComparison:
    """Two-level and dense search over many scenes.

    Attributes:
        scenes: Scenes drawn.
        seed: Seed they are drawn from.
        with_path: Scenes in which the dense search finds a path.
        disagree: Scenes in which only one of the two finds a path.
        fallbacks: How often the two-level search needed each fallback, in the scenes in which it finds a path.
        ratio_median: Median of the ratio of costs, two-level to dense; None where no scene has a path.
        ratio_high: Its 99th percentile.
        ratio_worst: Its maximum.
    """

    scenes: int
    seed: int
    with_path: int
    disagree: int
    fallbacks: dict[Fallback, int]
    ratio_median: float | None
    ratio_high: float | None
    ratio_worst: float | None


def compare(count: int, seed: int, progress: Callable[[int], None] = lambda _: None) -> SearchComparison:
    """Run both searches on so many random scenes of a seed; told after each how many are done."""
    rng = np.random.default_rng(seed)
    ratios, fallbacks, with_path, disagree = [], Counter[Fallback](), 0, 0
    for done in range(1, count + 1):
        scene = random_planar_scene(rng)
        fast = two_level_search(scene.occupancy, scene.start, scene.goal)
        dense = dense_search(scene.occupancy, scene.start, scene.goal, octile=True)
        with_path += dense.path is not None
        disagree += (fast.path is None) != (dense.path is None)
        if fast.path is not None:
            fallbacks[fast.fallback] += 1
            if dense.path is not None:
                ratios.append(fast.cost / dense.cost if dense.cost > 0.0 else 1.0)
        progress(done)
    quantiles = np.quantile(ratios, [0.5, 0.99, 1.0]).tolist() if ratios else [None] * 3
    return SearchComparison(
        count, seed, with_path, disagree, {name: fallbacks[name] for name in get_args(Fallback)}, *quantiles
    )
