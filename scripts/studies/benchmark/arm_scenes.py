"""Random scenes for any arm that stands upright: boxes, balls, capsules and clouds within its reach, two free poses.

Each scene comes of its own seed, (seed, number). Its obstacles stand where the tool gets to, over a floor just below
the base; start and goal are drawn uniformly from the joint ranges (at most half a turn to either side) until the arm
keeps `FREE_M` clear of everything, and the tool lies `APART` of the reach apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.bodies.collision_bodies import collision_bodies
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Obstacle, PointCloud, Sphere

#: Kinds of scenes, in turn: how many boxes, balls, capsules and clouds.
KINDS = ((10, 8, 8, 0), (4, 4, 4, 2), (14, 0, 0, 0), (0, 16, 0, 0), (0, 0, 18, 0), (0, 0, 0, 4), (8, 6, 6, 1))

#: Clearance of start and goal, as coal has it [m].
FREE_M = 3e-3

#: Least distance of the tool at the start from that at the goal, as a fraction of the reach.
APART = 0.4

#: Where obstacles stand, as fractions of the reach from the base's axis and height.
NEAREST, FARTHEST = 0.25, 1.0

#: Thickness of the floor, and its depth below the base [m].
FLOOR_M = 0.05

#: Configurations drawn for the ends of a scene, before its obstacles are drawn again.
DRAWS = 400


def random_scene(robot: Robot, seed: int, number: int) -> Scene:
    """One scene.

    Args:
        robot: The arm.
        seed: Of all scenes.
        number: Of this one, from 0 on; its kind is `KINDS[number % len(KINDS)]`.
    """
    rng = np.random.default_rng([seed, number])
    extent = reach_of(robot, rng)
    while True:
        obstacles = _obstacles(robot, rng, KINDS[number % len(KINDS)], extent)
        ends = free_ends(robot, rng, obstacles, extent)
        if ends is not None:
            return scene_between(f"random {seed}-{number}", *ends, obstacles)


def reach_of(robot: Robot, rng: np.random.Generator) -> float:
    """Largest distance of the tool from the base, of 500 configurations [m]."""
    q = rng.uniform(*_ranges(robot), (500, robot.dof))
    return float(np.linalg.norm(robot.tool_positions(q), axis=1).max())


def scene_between(name: str, start: FloatArray, goal: FloatArray, obstacles: Sequence[Obstacle]) -> Scene:
    """The scene of two (dof,) configurations and some obstacles."""
    ends = {"start": {"joints_rad": tuple(start.tolist())}, "goal": {"joints_rad": tuple(goal.tolist())}}
    return Scene.model_validate({"format": "hplan-scene/1", "name": name, "obstacles": tuple(obstacles), **ends})


def _ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """(dof,) lower and upper ends of the joint ranges, at most half a turn to either side."""
    return np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)


def _obstacles(
    robot: Robot, rng: np.random.Generator, counts: tuple[int, int, int, int], extent: float
) -> list[Obstacle]:
    """The floor, and so many boxes, balls, capsules and clouds that nothing of which the base holds touches."""
    bottom = min(-0.01, _lowest(robot))
    floor = Box(name="floor", center=(0.0, 0.0, bottom - 0.5 * FLOOR_M - 0.01), size=(4.0, 4.0, FLOOR_M))
    found: list[Obstacle] = [floor]
    kinds = [kind for kind, count in enumerate(counts) for _ in range(count)]
    for kind in kinds:
        while True:
            one = _obstacle(rng, kind, f"{('box', 'ball', 'capsule', 'cloud')[kind]} {len(found)}", extent)
            if not base_contacts(robot, one.solids):
                found.append(one)
                break
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
        half = _direction(rng) * rng.uniform(0.1, 0.4)
        ends = {"from": tuple(center - half), "to": tuple(center + half)}
        return Capsule.model_validate({"name": name, "radius": rng.uniform(0.01, 0.05), **ends})
    count = int(rng.integers(300, 1500))
    around = rng.normal(size=(count, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    stretch = rng.uniform(0.05, 0.25, 3)
    points = center + around * stretch + rng.normal(size=(count, 3)) * 0.01
    return PointCloud.of(name, points, radius=rng.uniform(0.004, 0.012))


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.normal(size=3)
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit


def _lowest(robot: Robot) -> float:
    """Height of the lowest point of what stands still [m]."""
    still = [body.core[:, 2].min() - body.rounding for body in collision_bodies(robot) if body.joint < 0]
    return float(min(still, default=0.0))


def free_ends(
    robot: Robot, rng: np.random.Generator, obstacles: Sequence[Obstacle], extent: float
) -> tuple[FloatArray, FloatArray] | None:
    """(dof,) start and goal; None where too few of the draws are free.

    Args:
        robot: The arm.
        rng: What configurations are drawn with.
        obstacles: What they are to be free of.
        extent: Reach of the arm [m].
    """
    checker = CoalScene(robot, tuple(solid for obstacle in obstacles for solid in obstacle.solids))
    start = None
    for q in rng.uniform(*_ranges(robot), (DRAWS, robot.dof)):
        if not (checker.pair_distances(q) - checker.kept(FREE_M) > 0.0).all():
            continue
        if start is None:
            start = q
        elif np.linalg.norm(np.subtract(*robot.tool_positions(np.array([start, q])))) >= APART * extent:
            return start, q
    return None
