"""Scenes in which obstacles move: fruit and branches about the arm's motion, all joints free.

A scene follows from the seed and its number alone. What moves, and where to, follows from them too and from the motion
of the moment: some obstacles are put close to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from studies.validation.random_scenes import direction, vector

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.planning.task import PlanningCache
from hplan.problem.definition import check_problem
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere

#: Obstacles of a scene, and the share of them that are branches; the others are fruit.
OBSTACLES, BRANCHES = 40, 0.5

#: Radius of a fruit; radius and length of a branch [m].
FRUIT_RADIUS = (0.03, 0.06)
BRANCH_RADIUS, BRANCH_LENGTH = (0.005, 0.03), (0.2, 0.8)

#: Where their middles are: distance from the yaw axis and height [m], and how far beyond start and goal [deg].
DISTANCE, HEIGHT, BEYOND_DEG = (0.35, 1.9), (0.3, 2.2), 20.0

#: Angles of the planar joints at start and goal [deg], and how far their yaws are apart [deg].
JOINTS_DEG, APART_DEG = (5.0, 85.0), (30.0, 120.0)

#: Clearance that every obstacle leaves at start and goal [m].
ROOM = 0.02

#: How far an obstacle is shifted [m].
SHIFT = (0.01, 0.05)

#: Share of moves that put the obstacle close to the motion, and its distance from some link's axis then, beyond its
#: own radius, at most [m]; links are 2 to 5 cm thick there.
CLOSE_SHARE, CLOSE = 0.3, 0.1

Piece: TypeAlias = Sphere | Capsule


@dataclass(frozen=True)
class ObstacleMove:
    """How an obstacle moves.

    Attributes:
        piece: The obstacle as it is afterwards.
        close: Whether it was put close to the motion; else it was shifted.
    """

    piece: Piece
    close: bool

    @property
    def changes(self) -> dict[str, Any]:
        """What `Planner.move` is told."""
        piece = self.piece
        return {"center": piece.center} if isinstance(piece, Sphere) else {"start": piece.start, "end": piece.end}


def moving_scene(robot: Robot, seed: int, number: int) -> Scene:
    """The scene with a number, as it is before anything moves."""
    random = np.random.default_rng([seed, number])
    empty = _posed(robot, f"moving-{number}", random)
    yaws_deg = np.degrees([empty.start.configuration[0], empty.goal.configuration[0]])
    sector_deg = yaws_deg.min() - BEYOND_DEG, yaws_deg.max() + BEYOND_DEG
    pieces: list[Piece] = []
    while len(pieces) < OBSTACLES:
        piece = _piece(len(pieces), sector_deg, random)
        if leaves_room(robot, empty, [piece]):
            pieces.append(piece)
    return empty.with_obstacles(pieces)


def next_move(robot: Robot, scene: Scene, motion: FloatArray, random: np.random.Generator) -> ObstacleMove:
    """Draw a move that leaves the base, start and goal free.

    Args:
        robot: The arm.
        scene: The scene, all of whose obstacles are fruit and branches.
        motion: (n, dof) configurations of the motion of the moment.
        random: What to draw from.
    """
    while True:
        piece = scene.obstacles[int(random.integers(len(scene.obstacles)))]
        if not isinstance(piece, (Sphere, Capsule)):
            raise InputError(f"obstacle {piece.name!r} is neither fruit nor branch", obstacle=piece.name)
        close = bool(random.random() < CLOSE_SHARE)
        shift = _to_motion(robot, piece, motion, random) if close else random.uniform(*SHIFT) * direction(random)
        move = ObstacleMove(_shifted(piece, shift), close)
        if leaves_room(robot, scene, [move.piece]):
            return move


def leaves_room(robot: Robot, scene: Scene, pieces: Sequence[Piece]) -> bool:
    """True if planning takes base, start and goal of a scene among some obstacles, with `ROOM` to spare."""
    start, goal = scene.start.configuration, scene.goal.configuration
    world = PlanningCache(robot).world(scene.with_obstacles(pieces), PlanOptions())
    try:
        world.check_base(robot.yaw_of(start))
        return check_problem(world, start, goal).spare_clearance >= ROOM
    except InputError:
        return False


def _posed(robot: Robot, name: str, random: np.random.Generator) -> Scene:
    """Start and goal within the limits."""
    joints = random.uniform(*JOINTS_DEG, (2, robot.arm.link_count))
    start_deg, turn_deg = random.uniform(-45.0, 45.0), random.choice([-1.0, 1.0]) * random.uniform(*APART_DEG)
    return Scene(
        name=name,
        start=Start(joints_deg=(start_deg, *joints[0].tolist())),
        goal=Goal(joints_deg=(start_deg + turn_deg, *joints[1].tolist())),
    )


def _piece(number: int, sector_deg: tuple[float, float], random: np.random.Generator) -> Piece:
    """A branch or a fruit somewhere in a sector."""
    bearing = np.radians(random.uniform(*sector_deg))
    distance = random.uniform(*DISTANCE)
    middle = np.array([distance * np.cos(bearing), distance * np.sin(bearing), random.uniform(*HEIGHT)])
    if number >= BRANCHES * OBSTACLES:
        return Sphere(name=f"fruit {number}", center=vector(middle), radius=random.uniform(*FRUIT_RADIUS))
    half = 0.5 * random.uniform(*BRANCH_LENGTH) * direction(random)
    ends = {"from": vector(middle - half), "to": vector(middle + half)}
    return Capsule.model_validate({"name": f"branch {number}", "radius": random.uniform(*BRANCH_RADIUS), **ends})


def _to_motion(robot: Robot, piece: Piece, motion: FloatArray, random: np.random.Generator) -> FloatArray:
    """The shift that brings some point of an obstacle's core close to some link at some moment."""
    q = motion[int(random.integers(len(motion)))]
    origin, axes = robot.plane_at(robot.yaw_of(q))
    joints = origin + robot.arm.joint_points(q[robot.arm_slice]) @ axes[:2]
    link = int(random.integers(robot.arm.link_count))
    on_axis = joints[link] + random.random() * (joints[link + 1] - joints[link])
    place = on_axis + random.random() * (piece.rounding + CLOSE) * direction(random)
    ends = piece.core[[0, -1]]
    on_core: FloatArray = ends[0] + random.random() * (ends[1] - ends[0])
    shift: FloatArray = place - on_core
    return shift


def _shifted(piece: Piece, shift: FloatArray) -> Piece:
    """The obstacle elsewhere."""
    ends = [vector(end) for end in piece.core + shift]
    if isinstance(piece, Sphere):
        return piece.model_copy(update={"center": ends[0]})
    return piece.model_copy(update={"start": ends[0], "end": ends[1]})
