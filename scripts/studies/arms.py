"""Random scenes of general arms.

A random scene has its own seed, (seed, number). Boxes, balls, capsules and clouds are within reach of the tool, over a
floor just below the base; start and goal are drawn uniformly from the joint ranges (at most half a turn to either side)
until the arm keeps `FREE_M` clear of everything, and the tool positions are at least `APART` of the reach apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.measure import planned, timed
from studies.outside import contacts, polyline_is_clear
from studies.peers import ompl_path, seed_ompl, world_of
from studies.validation.random_worlds import direction

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.collision.collision_bodies import collision_bodies
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Obstacle, PointCloud, Sphere

#: Kinds of scenes, in turn: how many boxes, balls, capsules and clouds.
KINDS = ((10, 8, 8, 0), (4, 4, 4, 2), (14, 0, 0, 0), (0, 16, 0, 0), (0, 0, 18, 0), (0, 0, 0, 4), (8, 6, 6, 1))

#: Clearance of start and goal, as coal has it [m].
FREE_M = 3e-3

#: Minimum distance between the tool positions at start and goal, as a fraction of the reach.
APART = 0.4

#: Distances of obstacles from the base's axis and height, as fractions of the reach.
NEAREST, FARTHEST = 0.25, 1.0

#: Configurations drawn for the ends of a scene, before its obstacles are drawn again.
DRAWS = 400


def random_scene(robot: Robot, seed: int, number: int) -> Scene:
    """The scene with a number; its kind is `KINDS[number % len(KINDS)]`."""
    rng = np.random.default_rng([seed, number])
    extent = reach_of(robot, rng)
    while True:
        obstacles = _obstacles(robot, rng, KINDS[number % len(KINDS)], extent)
        ends = free_ends(robot, rng, obstacles, extent)
        if ends is not None:
            return scene_between(f"random {seed}-{number}", *ends, obstacles)


def reach_of(robot: Robot, rng: np.random.Generator) -> float:
    """Maximum distance of the tool from the base, over 500 configurations [m]."""
    q = rng.uniform(*_ranges(robot), (500, robot.dof))
    return float(np.linalg.norm(robot.tool_positions(q), axis=1).max())


def scene_between(name: str, start: FloatArray, goal: FloatArray, obstacles: Sequence[Obstacle]) -> Scene:
    """The scene of two (dof,) configurations and some obstacles."""
    ends = {"start": {"joints_rad": tuple(start.tolist())}, "goal": {"joints_rad": tuple(goal.tolist())}}
    return Scene.model_validate({"format": "hplan-scene/1", "name": name, "obstacles": tuple(obstacles), **ends})


def _ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """(dof,) lower and upper joint limits, at most half a turn to either side."""
    return np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)


def _obstacles(
    robot: Robot, rng: np.random.Generator, counts: tuple[int, int, int, int], extent: float
) -> list[Obstacle]:
    """The floor, and random obstacles clear of the base."""
    bottom = min(-0.01, _lowest(robot))
    # Thickness of the floor, and its depth below the base [m].
    floor_m = 0.05
    floor = Box(name="floor", center=(0.0, 0.0, bottom - 0.5 * floor_m - 0.01), size=(4.0, 4.0, floor_m))
    found: list[Obstacle] = [floor]
    for kind in (kind for kind, count in enumerate(counts) for _ in range(count)):
        name = f"{('box', 'ball', 'capsule', 'cloud')[kind]} {len(found)}"
        while base_contacts(robot, (one := _obstacle(rng, kind, name, extent)).solids):
            pass
        found.append(one)
    return found


def _obstacle(rng: np.random.Generator, kind: int, name: str, extent: float) -> Obstacle:
    """One obstacle somewhere in reach."""
    turn, height = rng.uniform(-np.pi, np.pi), rng.uniform(-0.1, 0.9) * extent
    far = rng.uniform(NEAREST, FARTHEST) * np.sqrt(max(extent**2 - height**2, 0.1 * extent**2))
    center = np.array([far * np.cos(turn), far * np.sin(turn), height])
    if kind == 0:
        size = tuple(rng.uniform(0.03, 0.35, 3).tolist())
        return Box(name=name, center=tuple(center), size=size, rpy_deg=tuple(rng.uniform(-90.0, 90.0, 3).tolist()))
    if kind == 1:
        return Sphere(name=name, center=tuple(center), radius=rng.uniform(0.03, 0.13))
    if kind == 2:
        half = direction(rng) * rng.uniform(0.1, 0.4)
        ends = {"from": tuple(center - half), "to": tuple(center + half)}
        return Capsule.model_validate({"name": name, "radius": rng.uniform(0.01, 0.05), **ends})
    count = int(rng.integers(300, 1500))
    around = rng.normal(size=(count, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    stretch = rng.uniform(0.05, 0.25, 3)
    points = center + around * stretch + rng.normal(size=(count, 3)) * 0.01
    return PointCloud.from_points(name, points, radius=rng.uniform(0.004, 0.012))


def _lowest(robot: Robot) -> float:
    """Height of the lowest point of the static bodies [m]."""
    still = [body.core[:, 2].min() - body.rounding for body in collision_bodies(robot) if body.joint < 0]
    return float(min(still, default=0.0))


def free_ends(
    robot: Robot, rng: np.random.Generator, obstacles: Sequence[Obstacle], extent: float
) -> tuple[FloatArray, FloatArray] | None:
    """(dof,) start and goal clear of obstacles, for an arm of this reach; None if too few draws are free."""
    return free_ends_of(robot, rng.uniform(*_ranges(robot), (DRAWS, robot.dof)), obstacles, extent)


def free_ends_of(
    robot: Robot, drawn: FloatArray, obstacles: Sequence[Obstacle], extent: float
) -> tuple[FloatArray, FloatArray] | None:
    """The first two of (n, dof) configurations that are clear of obstacles and apart; None if there are none."""
    checker = CoalScene(robot, tuple(solid for obstacle in obstacles for solid in obstacle.solids))
    start = None
    for q in drawn:
        if not (checker.pair_distances(q) - checker.required_distance(FREE_M) > 0.0).all():
            continue
        if start is None:
            start = q
        elif np.linalg.norm(np.subtract(*robot.tool_positions(np.array([start, q])))) >= APART * extent:
            return start, q
    return None


#: Resolutions of OMPL's motion checks, tried in turn, as fractions of the space's extent; its time limit [s].
FINE, FIND_S = (0.002, 0.0005), 5.0


def _random(config: StudyConfig, number: int) -> Row:
    """Results of a straight motion, OMPL's RRTConnect and hplan; contacts by coal."""
    robot = config.arm()
    scene = random_scene(robot, config.seed, number)
    goal = scene.goal.configuration
    straight = polyline_is_clear(robot, scene, np.array([scene.start.configuration, goal]))
    row: Row = {"name": scene.name, "straight": straight}
    if config.peer is not None:
        seed_ompl(config.seed)
        world, row["peer_solved"], row["peer_ms"] = world_of(robot, scene), False, 0.0
        for fine in FINE:
            path, ms = timed(lambda fine=fine: ompl_path(world, scene, goal, seconds=FIND_S, resolution=fine))  # type: ignore[misc]
            row["peer_ms"] += ms
            row["peer_solved"] = path is not None and polyline_is_clear(robot, scene, path)
            if path is None or row["peer_solved"]:
                break
    found, result = planned(robot, scene, PlanOptions(effort=config.effort))
    row |= result | {"missed": not result["certified"] and row.get("peer_solved", False)}
    if found is not None:
        row["contacts"] = sum(contacts(robot, scene, found.trajectory))
    return row | {"fault": row.get("contacts", 0) > 0 or row.get("fault", False)}


RANDOM = Study(
    "random",
    "random scenes of any arm (--robot), each motion looked at by coal every half millisecond",
    _random,
    ("straight", "certified", "missed", "ms", "duration_s", "origin", "contacts", "peer_solved", "peer_ms"),
    count=(200, 3),
    peers=("RRTConnect",),
    needs=("robot",),
    warm=2,
)
