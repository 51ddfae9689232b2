"""The C-space of planar arms compared with coal, on random scenes of each kind of obstacle, with a turning base.

Configurations are the nodes of small planar grids with random offsets at random yaws. For each node three methods
decide whether it is free:

- the intervals of `hplan.planar.grid.occupancy`, on the sections of the obstacles at that yaw;
- the sign of the distance of `hplan.collision.compiled_field`;
- coal, on capsule links placed by Pinocchio, which shares no formula with the other two. It checks the solids, the
  original triangles of meshes, and all points of clouds.

Configurations in contact by coal must be occupied; others are *missed*, and must not exist. Configurations that coal
finds free by more than `SPARE` should be free; others are *lost*, and may be a fraction `MOST_LOST`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import pinocchio as pin
from studies.harness import Row, Study, StudyConfig
from studies.validation.random_worlds import direction, draw_obstacle, log_uniform, obstacle_of

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.coal_pairs import GeometryPairs
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import triangle_tree
from hplan.collision.compiled_field import ClearanceField
from hplan.geometry.cloud import Cloud
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import PreparedObstacles, prepare_obstacles
from hplan.planar.grid.sections import sections_at
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Mesh, PointCloud

#: Kinds of obstacles; each scene has one. Cylinders are polyhedra to the C-space, and slightly larger than for coal.
KINDS: Final = ("sphere", "capsule", "box", "mesh", "points", "fruits")

#: Maximum number of obstacles of a scene; number of fruits; half of the range of yaws of a scene; minimum distance of
#: obstacles from the shoulder, where all configurations would collide; maximum clearance of half of the scenes [m].
MOST, MOST_FRUITS, SECTOR, OFF_SHOULDER, CLEARANCE = 4, 20, math.radians(25.0), 0.15, 0.03

#: Distances this close to the clearance may be decided either way; coal approximates points by small triangles [m].
CONTACT_TOLERANCE, CLOUD_TOLERANCE = 1e-9, 5e-7

#: Configurations with this clearance should be free [m], except for a fraction of them.
SPARE, MOST_LOST = 2e-3, 0.01

#: Scenes of each kind, configurations of each scene, approximate nodes of each grid, and reported examples of faults.
SCENES, CONFIGURATIONS, NODES, EXAMPLES = 20, 20_000, 1_000, 5


def random_scene(robot: Robot, kind: str, number: int, *, seed: int = 0) -> tuple[Scene, tuple[float, float]]:
    """A scene of one kind of obstacle near random links, and the range of yaws at which the arm meets it."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    low, high = (robot.lower[0], robot.upper[0]) if family_of(robot).has_yaw else (0.0, 0.0)
    middle = rng.uniform(low, high)
    sector = max(low, middle - SECTOR), min(high, middle + SECTOR)

    def place(size: float) -> FloatArray:
        """A point near the axis of a random link, away from the shoulder."""
        while True:
            points = family_of(robot).arm.joint_points(
                rng.uniform(family_of(robot).arm.lower, family_of(robot).arm.upper)
            )
            link = int(rng.integers(family_of(robot).arm.link_count))
            on_axis = points[link] + rng.random() * (points[link + 1] - points[link])
            origin, axes = family_of(robot).plane_at(float(rng.uniform(*sector)))
            found: FloatArray = origin + on_axis @ axes[:2] + direction(rng) * rng.random() * (size + 0.05)
            if np.linalg.norm(found - origin) >= size + OFF_SHOULDER or rng.random() < 0.05:
                return found

    rest = tuple((0.5 * (robot.lower + robot.upper)).tolist())
    scene = Scene(
        name=f"{kind} {number}",
        start=Start(joints_rad=rest),
        goal=Goal(joints_rad=rest),
        clearance=float(rng.uniform(0.0, CLEARANCE)) if rng.random() < 0.5 else 0.0,
    )
    if kind == "fruits":
        center, spread = place(0.1), log_uniform(rng, 0.05, 0.4)
        places = center + spread * rng.normal(size=(int(rng.integers(1, MOST_FRUITS + 1)), 3))
        fruits = [
            Fruit(name=f"fruit {k}", center=tuple(at), radius=rng.uniform(0.02, 0.06))
            for k, at in enumerate(places.tolist())
        ]
        return scene.with_values(fruits=tuple(fruits)), sector
    items = [draw_obstacle(rng, f"{kind} {k}", kind, place) for k in range(int(rng.integers(1, MOST + 1)))]
    return scene.with_values(obstacles=tuple(map(obstacle_of, items))), sector


class _KindCounts:
    """The counts of one kind, scene by scene."""

    def __init__(self, robot: Robot, kind: str) -> None:
        self._robot, self._kind = robot, kind
        self._tolerance = CLOUD_TOLERANCE if kind == "points" else CONTACT_TOLERANCE
        keys = ("configurations", "colliding", "missed", "differing", "in_contact", "spare", "lost")
        self._counts, self._widest_m, self._examples = dict.fromkeys(keys, 0), 0.0, list[Row]()

    def add(self, number: int, configurations: int, seed: int) -> None:
        """Compare the methods in one scene."""
        robot, (scene, sector) = self._robot, random_scene(self._robot, self._kind, number, seed=seed)
        rng = np.random.default_rng([seed, number, KINDS.index(self._kind), 0])
        bodies = prepare_obstacles(scene.solids, clearance=scene.clearance)
        every, occupied = _at_random_yaws(robot, bodies, sector, configurations, rng)
        checker = CoalWithShapes(robot, scene)
        colliding = checker.collides(every, 0.0)
        spare = ~colliding
        spare[spare] = ~checker.collides(every[spare], SPARE)
        counts = self._counts
        counts["configurations"] += len(every)
        counts["colliding"] += int(colliding.sum())
        counts["missed"] += self._count(number, "intervals", checker, every[colliding & ~occupied], free=True)
        counts["spare"] += int(spare.sum())
        counts["lost"] += int((occupied & spare).sum())
        field = ClearanceField.build(robot, scene.solids, clearance=scene.clearance)
        clear = field.spare_clearances(every)
        counts["differing"] += self._count(number, "distances", checker, every[colliding & (clear > 0.0)], free=True)
        counts["differing"] += self._count(number, "contact", checker, every[~colliding & ~(clear > 0.0)], free=False)
        self._widest_m = max(self._widest_m, float(clear[occupied & ~colliding].max(initial=0.0)))

    def _count(self, number: int, side: str, checker: CoalWithShapes, q: FloatArray, *, free: bool) -> int:
        """Number of configurations with another verdict than coal's, except those in contact up to rounding."""
        if len(q) == 0:
            return 0
        sure = checker.collides(q, -self._tolerance) if free else ~checker.collides(q, self._tolerance)
        self._counts["in_contact"] += int((~sure).sum())
        for configuration in q[sure][: EXAMPLES - len(self._examples)]:
            example = {"scene": number, "side": side, "joints_rad": configuration.tolist()}
            self._examples.append(example | {"distance_m": checker.distance(configuration)})
        return int(sure.sum())

    def row(self) -> Row:
        """The counts; at fault if anything was missed or differs, or too much was lost."""
        counts = self._counts
        lost_share = counts["lost"] / max(1, counts["spare"])
        fault = counts["missed"] + counts["differing"] > 0 or lost_share > MOST_LOST
        more = {"lost_share": lost_share, "widest_mm": 1e3 * self._widest_m, "fault": fault}
        return {"name": self._kind, **counts, **more, "examples": self._examples}


def kind_row(robot: Robot, kind: str, scenes: int, configurations: int, *, seed: int = 0) -> Row:
    """Counts in random scenes of a kind.

    `configurations`; `colliding` by coal; `missed` by the intervals; `differing` verdicts of the distances;
    `in_contact` up to rounding, in neither of these; `spare`, free by more than `SPARE`, and `lost` of these;
    `widest_mm`, the maximum clearance of an occupied node; `examples` of faults.
    """
    counts = _KindCounts(robot, kind)
    for number in range(scenes):
        counts.add(number, configurations, seed)
    return counts.row()


def _at_random_yaws(
    robot: Robot, bodies: PreparedObstacles, sector: tuple[float, float], configurations: int, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """(nodes, dof) configurations of grids at random yaws, and (nodes,) whether each is occupied."""
    q, occupied = [], []
    for grid in _random_grids(robot, configurations, rng):
        yaw = float(rng.uniform(*sector))
        occupied.append(occupancy(family_of(robot).arm, sections_at(robot, bodies, yaw), grid).occupied_mask.ravel())
        planar = grid.coordinates(np.stack(np.unravel_index(np.arange(grid.size), grid.shape), axis=-1))
        q.append(np.column_stack([np.full(len(planar), yaw), planar]) if family_of(robot).has_yaw else planar)
    return np.concatenate(q), np.concatenate(occupied)


def _random_grids(robot: Robot, nodes: int, rng: np.random.Generator) -> Iterator[Grid]:
    """Grids of at least `nodes` nodes in total, each with a random offset within its cells."""
    links = family_of(robot).arm.link_count
    count = max(2, math.floor(min(nodes, NODES) ** (1.0 / links) + 1e-9))
    step = (family_of(robot).arm.upper - family_of(robot).arm.lower) / count
    for _ in range(math.ceil(nodes / count**links)):
        yield Grid(family_of(robot).arm.lower + rng.random(links) * step, step, (count,) * links)


class CoalWithShapes:
    """Contacts by coal with the solids of a scene, the triangles of its meshes, and all points of its clouds."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._solids = CoalScene(robot, scene.solids, clearance=scene.clearance)
        clouds = [
            Cloud(obstacle.name, obstacle.points, obstacle.radius, np.zeros((0, 7)))
            for obstacle in scene.obstacles
            if isinstance(obstacle, PointCloud)
        ]
        self._points = CoalScene(robot, clouds, clearance=scene.clearance) if clouds else None
        surfaces = [obstacle.surface for obstacle in scene.obstacles if isinstance(obstacle, Mesh)]
        self._surfaces = _Surfaces(self._solids, surfaces, scene.clearance) if surfaces else None

    def collides(self, q: FloatArray, beyond: float) -> BoolArray:
        """(n,) whether each of (n, dof) configurations is closer than the clearance plus `beyond` [m]."""
        found = self._solids.in_collision(q, margin=beyond)
        for others in (self._points, self._surfaces):
            if others is not None:
                found[~found] = others.in_collision(q[~found], margin=beyond)
        return found

    def distance(self, q: FloatArray) -> float:
        """Signed distance from the nearest solid minus the clearance [m]."""
        return self._solids.spare_clearance(q)


class _Surfaces:
    """The links and triangles; coal finds only intersections of triangles, which have no inside."""

    def __init__(self, links: CoalScene, surfaces: Sequence[tuple[FloatArray, Any]], clearance: float) -> None:
        trees = [
            pin.GeometryObject(f"surface:{index}", 0, pin.SE3.Identity(), triangle_tree(*surface))
            for index, surface in enumerate(surfaces)
        ]
        self._clearance = clearance
        self._geometry = GeometryPairs(links.robot.model, links.link_shapes, trees)

    def in_collision(self, q: FloatArray, *, margin: float) -> BoolArray:
        """(n,) whether each of (n, dof) configurations is closer to a triangle than clearance plus margin [m]."""
        kept = max(0.0, self._clearance + margin)
        return self._geometry.in_collision(q, np.full(self._geometry.count, kept))


def _row(config: StudyConfig, kind: str) -> Row:
    (configurations,) = config.values.get("configurations", (CONFIGURATIONS,))
    return kind_row(config.arm(), kind, config.count or SCENES, int(configurations), seed=config.seed)


def _kinds(_: StudyConfig) -> tuple[str, ...]:
    return KINDS


CSPACE = Study(
    "cspace",
    "the C-space against coal, on random scenes of each kind of obstacle (--count scenes of each)",
    _row,
    ("configurations", "colliding", "missed", "differing", "spare", "lost", "lost_share", "widest_mm"),
    problems=_kinds,
    by="name",
    count=(SCENES, 1),
    warm=0,
)
