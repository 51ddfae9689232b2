r"""The C-space compared with coal on random scenes of every kind of obstacle, with a base that turns.

Of each scene `configurations` nodes are looked at, on small planar grids with random offsets at many yaws, so that
nearly every node stands at no round number. Three sides answer for each:

- the *intervals* of `hplan.planar.grid.occupancy` on the sections of `hplan.planar.grid.sections`, at that yaw;
- the *distances* of `hplan.collision.clearance_field`, by their sign;
- *coal* on capsule links placed by Pinocchio, which shares no formula with the other two. It is asked about the solids
  that keep the arm away, about the triangles of meshes as they were given, and all points of clouds.

Configurations that coal forbids the intervals must forbid: others are *missed*, and one is too many. Those that coal
has free by more than `SPARE` they should leave free: others are *lost*, and may be `MOST_LOST`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import pinocchio as pin
from studies.harness import Asked, Row, Study
from studies.validation.scenes import KINDS, Kind, random_scene

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import triangle_tree
from hplan.collision.geometry_pairs import GeometryPairs
from hplan.geometry.cloud import Cloud
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import PreparedObstacles, prepare_obstacles
from hplan.planar.grid.sections import sections_at
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Mesh, PointCloud

#: A configuration whose distance is this close to the clearance is in contact, which may be decided either way [m].
CONTACT_TOLERANCE: Final = 1e-9

#: Free by more than this, a configuration should be free for the planner [m].
SPARE: Final = 2e-3

#: Fraction of such configurations that may be forbidden.
MOST_LOST: Final = 0.01

#: Scenes of each kind, and configurations of each scene.
SCENES, CONFIGURATIONS = 20, 20_000

#: Nodes of a planar grid, about; a scene has as many grids, each at its yaw, as its configurations take.
NODES: Final = 1_000

#: Told in full of what was missed.
EXAMPLES: Final = 5


class _KindCounts:
    """The counts of one kind, scene by scene."""

    def __init__(self, robot: Robot, kind: Kind) -> None:
        self._robot, self._kind = robot, kind
        # coal takes points for tiny triangles: of clouds a distance may be this much too small [m].
        cloud_tolerance = 5e-7
        self._tolerance = cloud_tolerance if kind == "points" else CONTACT_TOLERANCE
        keys = ("configurations", "colliding", "missed", "differing", "in_contact", "spare", "lost")
        self._counts, self._widest_m, self._examples = dict.fromkeys(keys, 0), 0.0, list[Row]()

    def add(self, number: int, configurations: int, seed: int) -> None:
        """Look at one scene."""
        robot, made = self._robot, random_scene(self._robot, self._kind, number, seed=seed)
        rng = np.random.default_rng([seed, number, KINDS.index(self._kind), 0])
        bodies = prepare_obstacles(made.scene.solids, clearance=made.scene.clearance)
        every, forbidden = _at_random_yaws(robot, bodies, made.sector, configurations, rng)
        checker = _CoalWithShapes(robot, made.scene)
        colliding = checker.collides(every, 0.0)
        # A free configuration may still be nearer than `SPARE`.
        spare_clear = ~colliding
        spare_clear[spare_clear] = ~checker.collides(every[spare_clear], SPARE)
        counts = self._counts
        counts["configurations"] += len(every)
        counts["colliding"] += int(colliding.sum())
        counts["missed"] += self._sort(number, "intervals", checker, every[colliding & ~forbidden], free=True)
        counts["spare"] += int(spare_clear.sum())
        counts["lost"] += int((forbidden & spare_clear).sum())
        field = ClearanceField.of(robot, made.scene.solids, clearance=made.scene.clearance)
        clear = np.array([field.clearance(configuration) for configuration in every])
        counts["differing"] += self._sort(number, "distances", checker, every[colliding & (clear > 0.0)], free=True)
        counts["differing"] += self._sort(number, "contact", checker, every[~colliding & ~(clear > 0.0)], free=False)
        self._widest_m = max(self._widest_m, float(clear[forbidden & ~colliding].max(initial=0.0)))

    def _sort(self, number: int, side: str, checker: _CoalWithShapes, q: FloatArray, *, free: bool) -> int:
        """How many configurations are decided otherwise than by coal, not those in contact up to rounding."""
        if len(q) == 0:
            return 0
        sure = checker.collides(q, -self._tolerance) if free else ~checker.collides(q, self._tolerance)
        self._counts["in_contact"] += int((~sure).sum())
        for configuration in q[sure][: EXAMPLES - len(self._examples)]:
            told = {"scene": number, "side": side, "joints_rad": configuration.tolist()}
            self._examples.append(told | {"distance_m": checker.distance(configuration)})
        return int(sure.sum())

    def row(self) -> Row:
        """What was counted; at fault where anything was missed or differs, or too much was lost."""
        counts = self._counts
        lost_share = counts["lost"] / max(1, counts["spare"])
        fault = counts["missed"] + counts["differing"] > 0 or lost_share > MOST_LOST
        told = {"lost_share": lost_share, "widest_mm": 1e3 * self._widest_m, "fault": fault}
        return {"name": self._kind, **counts, **told, "examples": self._examples}


def kind_row(robot: Robot, kind: Kind, scenes: int, configurations: int, *, seed: int = 0) -> Row:
    """What is counted in random scenes of a kind.

    Its keys: `configurations` looked at; `colliding` for coal; `missed` of these by the intervals; `differing`, decided
    otherwise by the distances; `in_contact`, up to rounding, and in none of those counts; `spare`, free for coal by
    more than `SPARE`, and `lost` of these; `widest_mm`, the most to spare for coal where the intervals forbid;
    `examples` of what was missed or differs.

    Args:
        configurations: Of each scene; as many or a few more are looked at.
    """
    counts = _KindCounts(robot, kind)
    for number in range(scenes):
        counts.add(number, configurations, seed)
    return counts.row()


def _at_random_yaws(
    robot: Robot, bodies: PreparedObstacles, sector: tuple[float, float], configurations: int, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Grids at some yaws: (nodes, dof) configurations and (nodes,) whether each is forbidden."""
    q, forbidden = [], []
    for grid in _random_grids(robot, configurations, rng):
        yaw = float(rng.uniform(*sector))
        forbidden.append(occupancy(robot.arm, sections_at(robot, bodies, yaw), grid).occupied.ravel())
        planar = grid.coordinates(np.stack(np.unravel_index(np.arange(grid.size), grid.shape), axis=-1))
        q.append(np.column_stack([np.full(len(planar), yaw), planar]) if robot.has_yaw else planar)
    return np.concatenate(q), np.concatenate(forbidden)


def _random_grids(robot: Robot, nodes: int, rng: np.random.Generator) -> Iterator[Grid]:
    """Grids of `nodes` or a few more nodes in all, each shifted at random within its cells."""
    links = robot.arm.link_count
    count = max(2, math.floor(min(nodes, NODES) ** (1.0 / links) + 1e-9))
    step = (robot.arm.upper - robot.arm.lower) / count
    for _ in range(math.ceil(nodes / count**links)):
        yield Grid(robot.arm.lower + rng.random(links) * step, step, (count,) * links)


class _CoalWithShapes:
    """coal's answer for one scene: its solids, and the surfaces and points that they stand for."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._clearance = scene.clearance
        self._solids = CoalScene(robot, scene.solids, clearance=scene.clearance, single_joint_pairs=False)
        bare = [
            Cloud(obstacle.name, obstacle.points, obstacle.radius, np.zeros((0, 7)))
            for obstacle in scene.obstacles
            if isinstance(obstacle, PointCloud)
        ]
        self._points = CoalScene(robot, bare, clearance=scene.clearance, single_joint_pairs=False) if bare else None
        surfaces = [obstacle.surface for obstacle in scene.obstacles if isinstance(obstacle, Mesh)]
        self._surfaces = _Surfaces(self._solids, surfaces) if surfaces else None

    def collides(self, q: FloatArray, beyond: float) -> BoolArray:
        """Whether each of (n, dof) configurations is nearer to something than the clearance and a bit [m]."""
        margin = self._clearance + beyond
        found = self._solids.in_collision(q, margin=margin)
        for others in (self._points, self._surfaces):
            if others is not None:
                found[~found] = others.in_collision(q[~found], margin=margin)
        return found

    def distance(self, q: FloatArray) -> float:
        """Signed distance from the nearest solid beyond the clearance [m]."""
        return float(self._solids.distances(q).min() - self._clearance)


class _Surfaces:
    """The links against triangles, which are hollow to coal: only what touches one is seen."""

    def __init__(self, links: CoalScene, surfaces: Sequence[tuple[FloatArray, Any]]) -> None:
        trees = [
            pin.GeometryObject(f"surface:{index}", 0, pin.SE3.Identity(), triangle_tree(*surface))
            for index, surface in enumerate(surfaces)
        ]
        self._geometry = GeometryPairs(links.robot.model, links.link_shapes, trees)

    def in_collision(self, q: FloatArray, *, margin: float) -> BoolArray:
        """Whether each of (n, dof) configurations touches a triangle, or comes nearer than a margin [m]."""
        # Of trees coal knows no negative margin.
        return self._geometry.in_collision(q, np.full(self._geometry.count, max(0.0, margin)))


def _row(asked: Asked, kind: Kind) -> Row:
    (configurations,) = asked.values.get("configurations", (CONFIGURATIONS,))
    return kind_row(asked.arm(), kind, asked.count or SCENES, int(configurations), seed=asked.seed)


def _kinds(_: Asked) -> tuple[Kind, ...]:
    return KINDS


CSPACE = Study(
    "cspace",
    "the C-space against coal, on so many random scenes of each kind of obstacle (--count)",
    _row,
    ("configurations", "colliding", "missed", "differing", "spare", "lost", "lost_share", "widest_mm"),
    problems=_kinds,
    by="name",
    count=(SCENES, 1),
    warm=0,
)
