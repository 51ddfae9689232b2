"""Obstacles that cross the arm's way while it moves: motions past them.

In each scene a few posts and balls stand still. One obstacle moves: a ball, an upright post, a branch, or the link of
another arm, which turns about its joint. It passes close to a link at a moment at which the arm might be there, at a
constant speed. It never comes near the arm at the start, so that waiting there is possible, and is gone from the goal
in the end. Everything is drawn from the seed and the scene's number alone.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from hplan.planning.definition import check_problem
from studies.harness import Asked, Row, Study
from studies.measure import planned
from studies.outside import contacts
from studies.validation.random_scenes import direction, vector

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.certificate.moving_obstacles import clear_until, moving_base_contacts
from hplan.collision.coal_scene import CoalScene
from hplan.collision.moving_solids import MovingSolids
from hplan.errors import InputError
from hplan.planning.moving.obstacles_at import without_moving
from hplan.planning.moving.path_in_time import MovingField, PathInTime
from hplan.planning.moving.schedule import STEP_S
from hplan.planning.options import PlanOptions
from hplan.planning.world import World
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory

#: What moves, in turn; every other four scenes the base is locked.
KINDS = ("ball", "post", "branch", "other arm")

#: Angles of the planar joints at start and goal [deg], and how far apart their yaws are where the base turns [deg].
JOINTS_DEG, APART_DEG = (0.0, 85.0), (15.0, 60.0)

#: Obstacles that stand still, and clearance of start and goal [m].
STANDING, ROOM = 3, 0.02

#: Speed of what moves [m/s], how far it comes from and goes to [m], and its distance from a link's axis, beyond its
#: radius, at the moment at which it may meet the arm [m].
SPEED, WAY, CLOSE = (0.2, 1.5), 1.6, 0.08

#: When that may be, as part of a little more than the least duration of a motion.
MOMENT, LONGER = (0.1, 0.9), 1.3

#: Radius of a ball, and of what is long; length of what is long [m]; how far another arm's link turns [deg].
BALL, ROD, LENGTH, TURN_DEG = (0.05, 0.25), (0.02, 0.06), (0.4, 1.2), (60.0, 160.0)

Piece: TypeAlias = Sphere | Capsule


def moving_scene(robot: Robot, seed: int, number: int) -> Scene:
    """The scene with a number: drawn until start and goal are free, the start at all times, the goal in the end."""
    random = np.random.default_rng([seed, number])
    while True:
        scene = _drawn(robot, seed, number, random)
        if scene is not None:
            return scene


def kind_of(number: int) -> str:
    """What moves in the scene with a number."""
    return KINDS[number % len(KINDS)]


def passing_near(robot: Robot, kind: str, q: FloatArray, moment_s: float, random: np.random.Generator) -> Piece:
    """An obstacle of a kind that passes close to a link of the arm at (dof,) `q` at a moment [s]."""
    return _passing(kind, _beside(robot, q, random), moment_s, random)


def _drawn(robot: Robot, seed: int, number: int, random: np.random.Generator) -> Scene | None:
    turns = number // len(KINDS) % 2 == 1
    joints = random.uniform(*JOINTS_DEG, (2, robot.arm.link_count))
    apart = random.choice([-1.0, 1.0]) * random.uniform(*APART_DEG) if turns else 0.0
    empty = Scene(
        name=f"moving-{seed}-{number}",
        start=Start(joints_deg=(0.0, *joints[0].tolist())),
        goal=Goal(joints_deg=(float(apart), *joints[1].tolist())),
        locked_joints=() if turns else ("base_yaw",),
    )
    start, goal = empty.start.configuration, empty.goal.configuration
    duration = LONGER * least_duration(start, goal, robot.velocity_limit, robot.acceleration_limit)
    moment = random.uniform(*MOMENT)
    q = start + moment * (goal - start)
    piece = passing_near(robot, kind_of(number), q, moment * duration, random)
    scene = empty.with_obstacles([*(_standing(index, random) for index in range(STANDING)), piece])
    moving = MovingSolids.of(scene.listed_solids, scene.movements)
    if moving is None or next(moving_base_contacts(robot, moving, 0.0, 0.0, 30.0), None) is not None:
        return None
    try:
        still = World.of(robot, scene.with_obstacles(scene.obstacles[:-1]).solids)
        still.check_base(0.0)
        room = check_problem(still, start, goal, locked_joints=scene.locked_joints).spare_clearance
    except InputError:
        return None
    checker = CoalScene(robot, scene.listed_solids, movements=scene.movements)
    waits = clear_until(start, checker, np.zeros((1, robot.dof)), ROOM, 0.0)
    stays = clear_until(goal, checker, np.zeros((1, robot.dof)), ROOM, scene.at_rest_s - 1e-3)
    return scene if room >= ROOM and waits == stays == math.inf else None


def _standing(index: int, random: np.random.Generator) -> Piece:
    """A ball or a post somewhere."""
    bearing, distance = random.uniform(-1.2, 1.2), random.uniform(0.6, 2.2)
    x, y = float(distance * math.cos(bearing)), float(distance * math.sin(bearing))
    if index == 0:
        low = float(random.uniform(0.0, 1.0))
        ends = {"from": (x, y, low), "to": (x, y, low + float(random.uniform(*LENGTH)))}
        return Capsule.model_validate({"name": f"standing {index}", "radius": float(random.uniform(*ROD)), **ends})
    return Sphere(
        name=f"standing {index}", center=(x, y, float(random.uniform(0.3, 2.4))), radius=float(random.uniform(*BALL))
    )


def _beside(robot: Robot, q: FloatArray, random: np.random.Generator) -> FloatArray:
    """A point close to some link's axis at a configuration."""
    origin, axes = robot.plane_at(robot.yaw_of(q))
    joints = origin + robot.arm.joint_points(q[robot.arm_slice]) @ axes[:2]
    link = int(random.integers(robot.arm.link_count))
    point: FloatArray = joints[link] + random.random() * (joints[link + 1] - joints[link])
    return point + random.random() * CLOSE * direction(random)


def _passing(kind: str, point: FloatArray, moment_s: float, random: np.random.Generator) -> Piece:
    """An obstacle that is at a point at a moment."""
    speed = random.uniform(*SPEED)
    if kind == "ball":
        radius, core = random.uniform(*BALL), [point]
    else:
        along = np.array([0.0, 0.0, 1.0]) if kind == "post" else direction(random)
        length, part = random.uniform(*LENGTH), random.random()
        radius, core = random.uniform(*ROD), [point - part * length * along, point + (1.0 - part) * length * along]
    if kind == "other arm":
        track = _turning(core[0], along, float(np.linalg.norm(point - core[0])), speed, moment_s, random)
    else:
        way = WAY * direction(random)
        span = WAY / speed
        track = Track(times_s=(moment_s - span, moment_s + span), shifts_m=(vector(-way), vector(way)))
    common = {"name": kind, "radius": float(radius), "track": track}
    if kind == "ball":
        return Sphere(center=vector(core[0]), **common)
    return Capsule(start=vector(core[0]), end=vector(core[1]), **common)


def _turning(
    joint: FloatArray, along: FloatArray, reach: float, speed: float, moment_s: float, random: np.random.Generator
) -> Track:
    """The track of a link that turns about its joint, across its axis, and is back where it is drawn at a moment."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(along, direction(random))
    axis /= np.linalg.norm(axis)
    half = math.radians(random.uniform(*TURN_DEG)) / 2.0
    span = half * max(reach, 0.1) / speed
    angles = [vector(Rotation.from_rotvec(turn * axis).as_euler("xyz", degrees=True)) for turn in (-half, 0.0, half)]
    times = (moment_s - span, moment_s, moment_s + span)
    still = (0.0, 0.0, 0.0)
    return Track(times_s=times, shifts_m=(still,) * 3, rpy_deg=tuple(angles), about=vector(joint))


def _waiting_s(robot: Robot, scene: Scene, motion: Trajectory) -> float | None:
    """Duration of standing still until a motion is clear for good, and of the motion [s]; None for never."""
    field = MovingField(robot, scene, sigmas=3.0, tracking_error=0.0)
    cells = PathInTime(motion, field, step_s=STEP_S, spare_s=0.0)
    clear = [cells.clear(row) for row in range(math.ceil(max(0.0, field.at_rest_s) / STEP_S) + 2)]
    goes = 1 + max((row for row, free in enumerate(clear) if not free.all()), default=-1)
    if goes == len(clear) or not all(free[0] for free in clear[:goes]):
        return None
    return goes * STEP_S + motion.duration


def _row(asked: Asked, number: int) -> Row | None:
    """One scene; None where there is no motion even without what moves."""
    robot = asked.arm()
    scene = moving_scene(robot, asked.seed, number)
    alone, _ = planned(robot, without_moving(scene))
    if alone is None:
        return None
    found, row = planned(robot, scene, PlanOptions(effort=asked.effort))
    in_the_way = not certify(robot, scene, alone.trajectory).verified
    row |= {"name": f"{scene.name} {kind_of(number)}", "kind": kind_of(number), "in_the_way": in_the_way}
    if found is None:
        return row
    motion, told = found.trajectory, found.report["in_time"]
    how = "around" if "around" in told["path"] else "at once"
    waiting_s = _waiting_s(robot, scene, alone.trajectory) if in_the_way else None
    return row | {
        "how": "waits" if told["waits_s"] > 0.0 else "slows down" if told["slows_down"] else how,
        "to_waiting": None if waiting_s is None else motion.duration / waiting_s,
        "to_unhindered": motion.duration / alone.trajectory.duration if in_the_way else None,
        "contacts": (touching := sum(contacts(robot, scene, motion))),
        "fault": row["fault"] or touching > 0,
    }


MOVING = Study(
    "moving",
    "an obstacle moves as the arm does; durations to those of waiting until all is clear",
    _row,
    ("certified", "ms", "in_the_way", "how", "to_waiting", "to_unhindered", "contacts"),
    by="kind",
    count=(500, 4),
    warm=4,
)
