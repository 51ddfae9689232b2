r"""The C-space compared with coal on random scenes of every kind of obstacle, with a base that turns.

Of each scene `configurations` nodes are looked at, on small planar grids with random offsets at many yaws, so that
nearly every node stands at no round number. Three sides answer for each:

- the *intervals* of `hplan.grid.occupancy` on the sections of `hplan.grid.sections`, at that yaw;
- the *distances* of `hplan.collision.clearance_field`, by their sign;
- *coal* on capsule links placed by Pinocchio, which shares no formula with the other two. It is asked about the solids
  that keep the arm away, about the triangles of meshes as they were given, and all points of clouds.

Configurations that coal forbids the intervals must forbid: others are *missed*, and one is too many. Those that coal
has free by more than `SPARE` they should leave free: others are *lost*, and may be `MOST_LOST`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

import numpy as np
import pinocchio as pin
from studies.validation.scenes import KINDS, Kind, RandomScene, random_scene

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import triangle_tree
from hplan.collision.geometry_pairs import GeometryPairs
from hplan.errors import OptionError
from hplan.grid.grid import Grid
from hplan.grid.occupancy import occupancy
from hplan.grid.prepared_obstacles import PreparedObstacles, prepare_obstacles
from hplan.grid.sections import sections_at
from hplan.planning.report import versions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Mesh, PointCloud
from hplan.scene.solids import Cloud

#: A configuration whose distance is this close to the clearance is in contact, which may be decided either way [m].
CONTACT_TOLERANCE: Final = 1e-9

#: Free by more than this, a configuration should be free for the planner [m].
SPARE: Final = 2e-3

#: Fraction of such configurations that may be forbidden.
MOST_LOST: Final = 0.01

#: Scenes of each kind, and configurations of each scene.
SCENES, CONFIGURATIONS = 200, 20_000

#: Nodes of a planar grid, about; a scene has as many grids, each at its yaw, as its configurations take.
NODES: Final = 1_000

#: coal takes points for tiny triangles: of clouds a distance may be this much too small [m].
_CLOUD_TOLERANCE: Final = 5e-7

#: Told in full of what was missed.
EXAMPLES: Final = 5


@dataclass(frozen=True)
class Missed:
    """A configuration that one side has free and coal in collision, or the other way about.

    Attributes:
        scene: Number of the scene.
        side: `intervals`, `distances` (free for this side) or `contact` (in contact for the distances alone).
        joints_rad: The configuration.
        distance_m: Coal's signed distance from the solids beyond the clearance [m].
    """

    scene: int
    side: str
    joints_rad: tuple[float, ...]
    distance_m: float


@dataclass(frozen=True)
class KindResult:
    """All scenes of one kind of obstacle.

    Attributes:
        kind: What the scenes hold.
        scenes: Number of scenes.
        configurations: Configurations of all scenes.
        colliding: Those that coal has in collision.
        missed: Those of them that the intervals have free.
        in_contact: Not among the missed: free for the intervals or the distances, in contact for coal up to
            rounding.
        differing: Configurations that the distances decide otherwise than coal.
        spare: Those that coal has free by more than `SPARE`.
        lost: Those of them that the intervals forbid.
        widest_gap_m: Largest distance beyond the clearance at a node that is forbidden and free for coal [m].
        seconds: Time of all scenes [s].
        examples: Some of what was missed or differs.
    """

    kind: Kind
    scenes: int
    configurations: int
    colliding: int
    missed: int
    in_contact: int
    differing: int
    spare: int
    lost: int
    widest_gap_m: float
    seconds: float
    examples: tuple[Missed, ...]

    @property
    def lost_share(self) -> float:
        """Lost nodes as a fraction of those that coal has free by more than `SPARE`; 0 where there are none."""
        return self.lost / max(1, self.spare)

    @property
    def ok(self) -> bool:
        """True if nothing was missed, distances agree, and no more was lost than may be."""
        return self.missed == self.differing == 0 and self.lost_share <= MOST_LOST


@dataclass(frozen=True)
class KindsValidation:
    """The result of comparing random scenes with coal.

    Attributes:
        robot: Name of the robot.
        seed: Seed of the scenes.
        scenes: Scenes of each kind.
        configurations: Configurations of each scene that were asked for.
        results: One for each kind.
        total_s: Time of it all [s].
    """

    robot: str
    seed: int
    scenes: int
    configurations: int
    results: tuple[KindResult, ...]
    total_s: float

    @property
    def ok(self) -> bool:
        """True if all results are."""
        return all(result.ok for result in self.results)

    def as_dict(self) -> dict[str, Any]:
        """The numbers, as `hplan.planning.report.write_report` writes them."""
        results = [{"ok": row.ok, "lost_share": row.lost_share, **asdict(row)} for row in self.results]
        return {"ok": self.ok, **asdict(self), "results": results, "versions": versions()}


def validate_kinds(
    robot: Robot,
    kinds: Sequence[Kind] = KINDS,
    *,
    scenes: int = SCENES,
    configurations: int = CONFIGURATIONS,
    seed: int = 0,
    told: Callable[[KindResult], None] = lambda _: None,
) -> KindsValidation:
    """Compare the C-space with coal on random scenes of each kind.

    Args:
        robot: The arm.
        kinds: Kinds of obstacles.
        scenes: Scenes of each kind.
        configurations: Configurations of each scene; as many or a few more are looked at.
        seed: Seed of the scenes.
        told: Handed each result.

    Raises:
        OptionError: No kind or an unknown one, or a number below 1 (of the seed: below 0).
    """
    begin = time.perf_counter()
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise OptionError("kinds", unknown[0] if unknown else (), f"some of {', '.join(KINDS)}")
    for name, value, least in (("scenes", scenes, 1), ("configurations", configurations, 1), ("seed", seed, 0)):
        if value < least:
            raise OptionError(name, value, f"a whole number >= {least}")
    results = []
    for kind in kinds:
        tally = _KindCounts(robot, kind)
        for number in range(scenes):
            tally.add(number, random_scene(robot, kind, number, seed=seed), configurations, seed)
        results.append(tally.result())
        told(results[-1])
    return KindsValidation(
        robot=robot.name,
        seed=seed,
        scenes=scenes,
        configurations=configurations,
        results=tuple(results),
        total_s=time.perf_counter() - begin,
    )


#: Fields of `KindResult` that are counted.
_COUNTS: Final = tuple(field.name for field in fields(KindResult) if field.type == "int")


class _KindCounts:
    """The counts of one kind, scene by scene."""

    def __init__(self, robot: Robot, kind: Kind) -> None:
        self._robot, self._kind = robot, kind
        self._tolerance = _CLOUD_TOLERANCE if kind == "points" else CONTACT_TOLERANCE
        self._begin = time.perf_counter()
        self._counts = dict.fromkeys(_COUNTS, 0)
        self._widest = 0.0
        self._examples: list[Missed] = []

    def add(self, number: int, made: RandomScene, configurations: int, seed: int) -> None:
        """Look at one scene."""
        robot, clearance = self._robot, made.scene.clearance
        rng = np.random.default_rng([seed, number, KINDS.index(self._kind), 0])
        bodies = prepare_obstacles(made.scene.solids, clearance=clearance)
        every, forbidden = _at_random_yaws(robot, bodies, made.sector, configurations, rng)
        checker = _CoalWithShapes(robot, made.scene)
        colliding = checker.collides(every, 0.0)
        # A free configuration may still be nearer than `SPARE`.
        spare_clear = ~colliding
        spare_clear[spare_clear] = ~checker.collides(every[spare_clear], SPARE)
        counts = self._counts
        counts["scenes"] += 1
        counts["configurations"] += len(every)
        counts["colliding"] += int(colliding.sum())
        counts["missed"] += self._sort(number, "intervals", checker, every[colliding & ~forbidden], free=True)
        counts["spare"] += int(spare_clear.sum())
        counts["lost"] += int((forbidden & spare_clear).sum())
        field = ClearanceField.of(robot, made.scene.solids, clearance=clearance)
        clear = np.array([field.clearance(configuration) for configuration in every])
        counts["differing"] += self._sort(number, "distances", checker, every[colliding & (clear > 0.0)], free=True)
        counts["differing"] += self._sort(number, "contact", checker, every[~colliding & ~(clear > 0.0)], free=False)
        self._widest = max(self._widest, float(clear[forbidden & ~colliding].max(initial=0.0)))

    def _sort(self, number: int, side: str, checker: _CoalWithShapes, q: FloatArray, *, free: bool) -> int:
        """How many configurations are decided otherwise than by coal, not those in contact up to rounding."""
        if len(q) == 0:
            return 0
        sure = checker.collides(q, -self._tolerance) if free else ~checker.collides(q, self._tolerance)
        self._counts["in_contact"] += int((~sure).sum())
        for configuration in q[sure][: EXAMPLES - len(self._examples)]:
            distance = checker.distance(configuration)
            self._examples.append(Missed(number, side, tuple(configuration.tolist()), distance))
        return int(sure.sum())

    def result(self) -> KindResult:
        """The result."""
        return KindResult(
            kind=self._kind,
            **self._counts,
            widest_gap_m=self._widest,
            seconds=time.perf_counter() - self._begin,
            examples=tuple(self._examples),
        )


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
