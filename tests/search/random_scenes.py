"""Random planar scenes: the reference arm among a few discs, with free start and goal nodes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from hplan.arrays import FloatArray, IntArray, readonly
from hplan.cspace import joint_grid, occupancy
from hplan.grid import Occupancy
from hplan.robot import PlanarArm
from hplan.search import dense_search, two_level_search
from hplan.section import LinkModel, RoundedPolygon, planar_sections

ARM = PlanarArm(
    ("shoulder", "elbow", "wrist"),
    ("upper_arm", "forearm", "hand"),
    readonly([1.0, 0.8, 0.4]),
    readonly([0.05, 0.04, 0.03]),
    readonly([1, 1, 1]),
    readonly([0, 0, 0]),
    readonly([0, 0, 0]),
    readonly([np.pi / 2] * 3),
)
GRID = joint_grid(ARM, np.radians(1.0))


@dataclass(frozen=True, eq=False)
class PlanarScene:
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


def random_planar_scene(rng: np.random.Generator) -> PlanarScene:
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
            return PlanarScene(discs, occupied, start, goal)


@dataclass(frozen=True)
class Comparison:
    """Two-level and dense search over many scenes.

    Attributes:
        with_path: Scenes in which the dense search finds a path.
        disagree: Scenes in which only one of the two finds a path.
        fallbacks: How often what carried the path of the two-level search.
        ratio_median: Median of the ratio of costs, two-level to dense.
        ratio_high: Its 99th percentile.
        ratio_worst: Its maximum.
    """

    with_path: int
    disagree: int
    fallbacks: Counter[str]
    ratio_median: float
    ratio_high: float
    ratio_worst: float


def compare(count: int, seed: int) -> Comparison:
    """Run both searches on `count` random scenes."""
    rng = np.random.default_rng(seed)
    ratios, fallbacks, disagree = [], Counter[str](), 0
    for _ in range(count):
        scene = random_planar_scene(rng)
        fast = two_level_search(scene.occupancy, scene.start, scene.goal)
        dense = dense_search(scene.occupancy, scene.start, scene.goal, octile=True)
        disagree += (fast.path is None) != (dense.path is None)
        if fast.path is not None:
            fallbacks[fast.fallback] += 1
            ratios.append(fast.cost / dense.cost if dense.cost > 0.0 else 1.0)
    median, high, worst = (float(value) for value in np.quantile(ratios, [0.5, 0.99, 1.0]))
    return Comparison(len(ratios), disagree, fallbacks, median, high, worst)
