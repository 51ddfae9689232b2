"""Obstacles that cross the arm's way while it moves, tracked or not: motions past them, splices and stops.

In each scene a few posts and balls stand still. One obstacle moves: a ball, an upright post, a branch, or the link of
another arm, which turns about its joint. It passes close to a link at a moment at which the arm might be there, at a
constant speed. It never comes near the arm at the start, so that waiting there is possible, and is gone from the goal
in the end. Everything is drawn from the seed and the scene's number alone.

Splices: the arm goes to and fro. Every so often what moves is replaced by another track (`crossing`), or one of those
that stand is somewhere else (`jumping`), now and then the goal is the other one, and the planner is asked for what
comes next from a time shortly ahead on. Of what then runs, a stop at a random instant is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from studies.harness import Asked, Row, Study
from studies.measure import or_error, outcome, planned, timed
from studies.outside import least_distance
from studies.validation.random_scenes import direction, vector

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.collision.moving_solids import MovingSolids
from hplan.errors import HplanError, InputError, RunningMotionBlockedError
from hplan.moving.obstacles_at import without_moving
from hplan.moving.path_in_time import MovingField, PathInTime
from hplan.moving.schedule import STEP_S
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.planning.plan import PlanResult
from hplan.problem.definition import check_problem
from hplan.problem.options import PlanOptions
from hplan.problem.world import World
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere
from hplan.scene.tracks import Track
from hplan.timing.trajectory import Trajectory, cubic_pieces
from hplan.verification.certificate import REST, certify
from hplan.verification.moving_obstacles import clear_until, moving_base_contacts

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

#: Steps of a scene in which motions are spliced, and share of those with a new goal.
STEPS, TURNING = 12, 0.5

#: How long until something moves, and how much later the new motion may take over [s].
PAUSE_S, AHEAD_S = (0.05, 0.4), 0.1

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
    waits = clear_until(robot, start, checker, np.zeros((1, robot.dof)), ROOM, 0.0)
    stays = clear_until(robot, goal, checker, np.zeros((1, robot.dof)), ROOM, scene.at_rest_s - 1e-3)
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
    cells = PathInTime(motion, field, robot, step_s=STEP_S, spare_s=0.0)
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
    clearance_m = least_distance(robot, scene, motion.positions, motion.duration)
    waiting_s = _waiting_s(robot, scene, alone.trajectory) if in_the_way else None
    return row | {
        "how": "waits" if told["waits_s"] > 0.0 else "slows down" if told["slows_down"] else how,
        "to_waiting": None if waiting_s is None else motion.duration / waiting_s,
        "to_unhindered": motion.duration / alone.trajectory.duration if in_the_way else None,
        "clearance_mm": 1e3 * clearance_m,
        "fault": row["fault"] or clearance_m <= 0.0,
    }


MOVING = Study(
    "moving",
    "an obstacle moves as the arm does; durations to those of waiting until all is clear",
    _row,
    ("certified", "ms", "in_the_way", "how", "to_waiting", "to_unhindered", "clearance_mm"),
    by="kind",
    count=(500, 4),
    warm=4,
)


def _splices(asked: Asked, number: int) -> list[Row]:
    """The steps of a scene; none where there is no motion to begin with. In odd ones something crosses."""
    robot, crossing = asked.arm(), number % 2 == 1
    random = np.random.default_rng([asked.seed, number, 3])
    scene = moving_scene(robot, asked.seed, number)
    scene = scene if crossing else without_moving(scene)
    ends = scene.start.configuration, scene.goal.configuration
    planner, rows, now = Planner(robot, scene), list[Row](), 0.0
    begun = or_error(planner.plan)
    while not isinstance(begun, HplanError) and planner.last is not None and len(rows) < STEPS:
        running, before = planner.last, planner.scene
        motion, begins_s = running.trajectory, running.begins_s
        now = min(now + float(random.uniform(*PAUSE_S)), motion.duration)
        at = min(now + AHEAD_S, motion.duration)
        moved = _crossed if crossing else _jumped
        # Drawn by times since the motion began.
        planner.scene = moved(robot, before.since(begins_s), motion, (now, at), random).since(-begins_s)
        if random.random() < TURNING:
            planner.aim(goal=_farther(ends, before.goal.configuration))
        scene = planner.scene
        clock = {"at": begins_s + at, "now": begins_s + now}
        found, ms = timed(lambda planner=planner, clock=clock: or_error(lambda: planner.replan(**clock)))  # type: ignore[misc]
        kind = "crossing" if crossing else "jumping"
        row = outcome(found, ms) | {"name": f"{scene.name} {len(rows)}", "kind": kind}
        if isinstance(found, HplanError):
            planner.scene = before
            rows.append(row | _told_stop(robot, scene, found))
        else:
            if not isinstance(found, SplicedResult):
                raise TypeError("a splice was asked for")
            stop = _stop(robot, planner, found.begins_s + float(random.uniform(0.0, found.trajectory.duration)))
            rows.append(row | _judged(robot, scene, running, found) | stop)
            rows[-1]["fault"] |= row["fault"] or stop["stop_fault"]
            now -= found.begins_s - begins_s
        if now > planner.last.trajectory.duration - PAUSE_S[0]:
            now, ended = 0.0, planner.last
            q = ended.trajectory.position[-1]
            planner.aim(start=Start(joints_rad=vector_of(q)), goal=_farther(ends, q))
            begins_s = ended.begins_s + ended.trajectory.duration
            begun = or_error(lambda planner=planner, begins_s=begins_s: planner.plan(begins_s=begins_s))  # type: ignore[misc]
    return rows


def vector_of(q: FloatArray) -> tuple[float, ...]:
    """A configuration as scenes hold it."""
    return tuple(q.tolist())


def _farther(ends: Sequence[FloatArray], q: FloatArray) -> Goal:
    """The end that is farther from a configuration."""
    return Goal(joints_rad=vector_of(max(ends, key=lambda end: float(np.abs(end - q).max()))))


def _crossed(
    robot: Robot, scene: Scene, motion: Trajectory, times: tuple[float, float], random: np.random.Generator
) -> Scene:
    """The scene with another track, clear of the base, and of the arm now; as it was where none is drawn.

    Args:
        robot: The arm.
        scene: The scene.
        motion: What runs.
        times: The time, and when a new motion may take over [s].
        random: The generator.
    """
    now, at = times
    kind = next(item.name for item in scene.obstacles if item.track is not None)
    for _ in range(20):
        moment_s = at + float(random.uniform(*MOMENT)) * (motion.duration - at)
        piece = passing_near(robot, kind, motion.positions(np.array([moment_s]))[0], moment_s, random)
        other = scene.with_obstacles([*(item for item in scene.obstacles if item.track is None), piece])
        moving = MovingSolids.of(other.listed_solids, other.movements)
        if moving is None or next(moving_base_contacts(robot, moving, 0.0, now, now + 30.0), None) is not None:
            continue
        # Nothing comes from nowhere: it is clear of the arm as it is now.
        checker = CoalScene(robot, other.listed_solids, movements=other.movements)
        if checker.distances(motion.positions(np.array([now]))[0], now).min() > ROOM:
            return other
    return scene


def _jumped(
    robot: Robot, scene: Scene, motion: Trajectory, times: tuple[float, float], random: np.random.Generator
) -> Scene:
    """The scene with one obstacle put near the arm at a moment of what runs; clear of start, goal and the arm now."""
    for _ in range(20):
        index = int(random.integers(len(scene.obstacles)))
        piece = scene.obstacles[index]
        if not isinstance(piece, Sphere | Capsule):
            raise InputError(f"obstacle {piece.name!r} is neither ball nor capsule", obstacle=piece.name)
        q = motion.positions(np.array([random.uniform(times[0], motion.duration)]))[0]
        place = _beside(robot, q, random) + piece.rounding * direction(random)
        ends = [vector(end) for end in piece.core[[0, -1]] + place - piece.core.mean(axis=0)]
        changes = {"center": ends[0]} if isinstance(piece, Sphere) else {"start": ends[0], "end": ends[1]}
        obstacles = list(scene.obstacles)
        obstacles[index] = piece.model_copy(update=changes)
        other = scene.with_obstacles(obstacles)
        checker, here = CoalScene(robot, other.solids), motion.positions(np.array([times[0]]))[0]
        free = (here, scene.start.configuration, scene.goal.configuration)
        if min(float(checker.distances(q).min()) for q in free) > ROOM:
            return other
    return scene


def _told_stop(robot: Robot, scene: Scene, error: HplanError) -> Row:
    """What is found of the stop that an error carries: clear wherever it is told."""
    if not isinstance(error, RunningMotionBlockedError) or error.stop is None:
        return {}
    least = least_distance(robot, scene.since(error.begins_s), error.stop.positions, error.stop.duration)
    return {"told_stop_mm": 1e3 * least, "fault": least <= 0.0}


def _judged(robot: Robot, scene: Scene, before: PlanResult, found: SplicedResult) -> Row:
    """What is found of a splice without the planner's own word for it."""
    motion = found.trajectory
    seam = int(np.searchsorted(motion.time, found.seam_s - 1e-9))
    paused = bool((np.abs(motion.velocity[seam + 1 : -1]).max(axis=1, initial=0.0) <= REST).any())
    by_old_clock = scene.model_copy(update={"start": found.scene.start})
    certified = certify(robot, found.scene, motion).verified
    certified = certified and certify(robot, by_old_clock, motion, begin_s=found.begins_s).verified
    least = least_distance(robot, found.scene, motion.positions, motion.duration)
    jumps = _jumps(before, found, seam)
    return {
        "becomes": "kept" if found.is_kept else "by a stop" if paused else "blended",
        "in_motion": None if found.is_kept else bool(np.abs(motion.velocity[seam]).max() > REST),
        "clearance_mm": 1e3 * least,
        **{f"jump_{order}": jump for order, jump in enumerate(jumps)},
        "fault": not certified or least <= 0.0,
    }


def _jumps(before: PlanResult, found: SplicedResult, seam: int) -> list[float]:
    """Largest differences of position, velocity and acceleration at the seam, and from what ran until then."""
    motion = found.trajectory
    first = int(np.searchsorted(before.trajectory.time, found.begins_s - before.begins_s - 1e-9))
    names = ("position", "velocity", "acceleration")
    ran = [
        getattr(motion, name)[: seam + 1] - getattr(before.trajectory, name)[first : first + seam + 1] for name in names
    ]
    jumps = [float(np.abs(one).max()) for one in ran]
    if not 0 < seam < motion.samples - 1:
        return jumps
    bezier, duration = cubic_pieces(motion)
    h = duration[:, None, None]
    values = (bezier, 3.0 * np.diff(bezier, axis=1) / h, 6.0 * np.diff(bezier, n=2, axis=1) / h**2)
    at_seam = [float(np.abs(value[seam, 0] - value[seam - 1, -1]).max()) for value in values]
    return [max(each) for each in zip(jumps, at_seam, strict=True)]


def _stop(robot: Robot, planner: Planner, t: float) -> Row:
    """A stop at an instant of what runs: clear by coal wherever it is certified."""
    found, ms = timed(lambda: planner.stop_at(t))
    certified, motion = found.certificate.verified, found.trajectory
    scene = planner.scene.since(found.begins_s)
    least = least_distance(robot, scene, motion.positions, motion.duration) if certified else math.nan
    told = {"stop_certified": certified, "stop_ms": ms, "stop_bound_mm": 1e3 * found.off_path_m}
    return told | {"stop_fault": certified and least <= 0.0}


SPLICES = Study(
    "splices",
    "the running motion goes on while something crosses its way or jumps: splices and stops",
    _splices,
    (
        *("certified", "ms", "becomes", "in_motion", "clearance_mm", "jump_0", "jump_1", "jump_2"),
        *("stop_certified", "stop_ms", "stop_bound_mm", "told_stop_mm", "origin"),
    ),
    by="kind",
    count=(100, 2),
)
