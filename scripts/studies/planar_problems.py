"""Random problems of planar arms with a locked base: discs in the arm plane, and pinches.

A pinch is a motion with corners between balls that leave a given distance from its sweep, so that a motion exists. Each
problem depends only on the seed and its number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.errors import HplanError, InputError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Occupancy
from hplan.planar.grid.occupancy import occupancy
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.planning.world import World
from hplan.robot.family.members import load_member
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

#: Spacing of the joint grid, and minimum distance of start and goal in joint space [deg].
STEP_DEG, APART_DEG = 1.0, 30.0

#: Pairs of nodes drawn before a scene's discs are drawn anew.
_PAIRS = 200

#: Number of balls of a pinch, number of those within the room, their radii, and the extra distance of the others [m].
BALLS, CLOSE_BALLS, RADII, FARTHER = (6, 12), (2, 4), (0.02, 0.25), (0.005, 0.06)

#: Spacing of the samples of a pinch's motion [rad].
SAMPLE = math.radians(0.1)

#: Start, goal, and the balls drawn around them.
_Drawn: TypeAlias = tuple[FloatArray, FloatArray, Sequence[Sphere]]


@dataclass(frozen=True, eq=False)
class PlanarScene:
    """A scene and its C-space.

    Attributes:
        scene: Obstacles, start and goal.
        space: Its C-space.
        start: (d,) node index.
        goal: (d,) node index.
    """

    scene: Scene
    space: Occupancy
    start: IntArray
    goal: IntArray


def random_scene(robot: Robot, seed: int, number: int) -> PlanarScene:
    """A random scene of 1 to 12 discs within reach, and clear of pedestal and turret; start and goal are free nodes."""
    random = np.random.default_rng([seed, number])
    grid = joint_grid(family_of(robot).arm, np.radians(STEP_DEG))
    reach = float(family_of(robot).arm.lengths.sum())
    while True:
        count = int(random.integers(1, 13))
        distance = random.uniform(0.11 * reach, reach, count)
        bearing = np.radians(random.uniform(-20.0, 200.0, count))
        radius = random.uniform(0.02, 0.25 if count < 5 else 0.12, count)
        centres = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])
        discs = _discs_in_plane(robot, np.column_stack([centres, radius]))
        space = occupancy(family_of(robot).arm, arm_sections(robot, discs), grid)
        free = np.flatnonzero(~space.occupied_mask.ravel())
        if len(free) < 2:
            continue
        for _ in range(_PAIRS):
            pair = np.stack(np.unravel_index(free[random.integers(len(free), size=2)], grid.shape), axis=1)
            ends = grid.coordinates(pair)
            if np.linalg.norm(ends[1] - ends[0]) >= np.radians(APART_DEG):
                break
        else:
            continue
        # The base is checked last, so that scenes with a free base have the same random numbers as without the check.
        scene = _planar_scene(robot, f"clutter-{number}", discs, ends[0], ends[1])
        world = World.of_scene(robot, scene, PlanOptions())
        try:
            world.check_base()
        except InputError:
            continue
        return PlanarScene(scene, space, pair[0].astype(np.int64), pair[1].astype(np.int64))


def _discs_in_plane(robot: Robot, discs: FloatArray) -> list[Sphere]:
    """Balls from (k, 3) discs: centre in the arm plane at yaw 0, and radius [m]."""
    centres = family_of(robot).plane_origin + discs[:, :2] @ family_of(robot).plane_axes
    return [
        Sphere(name=f"disc {i}", center=(float(x), float(y), float(z)), radius=float(radius))
        for i, ((x, y, z), radius) in enumerate(zip(centres, discs[:, 2], strict=True))
    ]


def _planar_scene(robot: Robot, name: str, discs: list[Sphere], start: FloatArray, goal: FloatArray) -> Scene:
    """The scene with the given planar joint angles at yaw 0."""
    yaw = (0.0,) if family_of(robot).has_yaw else ()
    return Scene(
        name=name,
        start=Start(joints_rad=(*yaw, *(float(q) for q in start))),
        goal=Goal(joints_rad=(*yaw, *(float(q) for q in goal))),
        locked_joints=robot.joint_names[:1] if family_of(robot).has_yaw else (),
        obstacles=tuple(discs),
    )


def pinch(seed: int, number: int, arm: str, room: float) -> tuple[Robot, Scene]:
    """Arm and scene of a numbered pinch with a room [m]."""
    random = np.random.default_rng([seed, number])
    robot = drawn_member(seed, number) if arm == "drawn" else load_robot(arm)
    while True:
        if (drawn := _draw_pinch(robot, random, room)) is None:
            continue
        start, goal, obstacles = drawn
        scene = Scene(
            name=f"narrow-{number}",
            start=Start(joints_rad=tuple(start.tolist())),
            goal=Goal(joints_rad=tuple(goal.tolist())),
            locked_joints=robot.joint_names[:1],
            obstacles=tuple(obstacles),
        )
        if _is_narrow(robot, scene):
            return robot, scene


def _is_narrow(robot: Robot, scene: Scene) -> bool:
    """True if planning takes base, start and goal, and the straight motion is not clear."""
    try:
        problem = Problem.from_scene(robot, scene, PlanOptions())
        problem.world.check_base()
        problem = problem.from_configurations(problem.start, scene.goal.configuration)
    except HplanError:
        return False
    ends = np.stack([problem.start, problem.goal])
    # Minimum clearance of start and goal [m].
    least = 1e-3
    return problem.spare_clearances[0] >= least and not problem.field.is_clear(ends, 1e-6)


@cache
def drawn_member(seed: int, number: int) -> Robot:
    """A member of the family with three or four links and wide joint ranges."""
    random = np.random.default_rng([seed, number, 1])
    count = int(random.integers(3, 5))
    lengths = np.sort(random.uniform(0.35, 1.0, count))[::-1]
    widths = np.sort(random.uniform(0.02, 0.05, count))[::-1]
    bends = np.radians(random.uniform(100.0, 170.0, (2, count - 1)))
    spec = ArmSpec(
        name=f"drawn_{number}",
        link_lengths=tuple(lengths.tolist()),
        link_half_widths=tuple(widths.tolist()),
        link_masses=tuple(random.uniform(1.0, 6.0, count).tolist()),
        lower=(-math.pi, math.radians(random.uniform(-90.0, -45.0)), *(-bends[0]).tolist()),
        upper=(math.pi, math.radians(random.uniform(120.0, 160.0)), *bends[1].tolist()),
        velocity=tuple(random.uniform(1.0, 2.5, count + 1).tolist()),
        effort=(500.0,) * (count + 1),
        acceleration=tuple(random.uniform(2.0, 6.0, count + 1).tolist()),
        shoulder_height=float(random.uniform(0.5, 0.9)),
    )
    return load_member(spec)


def _draw_pinch(robot: Robot, random: np.random.Generator, room: float) -> _Drawn | None:
    """A motion with one or two corners, and balls next to it."""
    arm = family_of(robot).arm
    corners = random.uniform(arm.lower, arm.upper, (int(random.integers(3, 5)), arm.link_count))
    parts = []
    for a, b in pairwise(corners):
        count = max(2, math.ceil(float(np.abs(b - a).max()) / SAMPLE))
        parts.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    swept = arm.joint_points(np.concatenate(parts))
    reach, origin = float(arm.lengths.sum()), family_of(robot).plane_origin
    balls: list[Sphere] = []
    close, count = int(random.integers(*CLOSE_BALLS)), int(random.integers(*BALLS))
    for _ in range(40 * count):
        bearing, distance = random.uniform(-math.pi, math.pi), reach * math.sqrt(random.uniform(0.05, 1.0))
        center = distance * np.array([math.cos(bearing), math.sin(bearing)])
        if center[1] < 0.1 - origin[2]:
            continue
        left = room if len(balls) < close else room + random.uniform(*FARTHER)
        radius = _least_distance(swept, arm.half_widths, center) - left
        if RADII[0] <= radius <= RADII[1]:
            place = origin + center @ family_of(robot).plane_axes
            balls.append(Sphere(name=f"ball {len(balls)}", center=tuple(place.tolist()), radius=radius))
        if len(balls) == count:
            yaw = [0.0] * family_of(robot).yaw_joints
            return np.array([*yaw, *corners[0]]), np.array([*yaw, *corners[-1]]), balls
    return None


def _least_distance(swept: FloatArray, half_widths: FloatArray, center: FloatArray) -> float:
    """Distance of a point in the plane from links on the way: (n, links + 1, 2) joint points [m]."""
    first, axis = swept[:, :-1], np.diff(swept, axis=1)
    along = (((center - first) * axis).sum(axis=2) / (axis**2).sum(axis=2)).clip(0.0, 1.0)
    distance = np.linalg.norm(first + along[..., None] * axis - center, axis=2) - half_widths
    return float(distance.min())
