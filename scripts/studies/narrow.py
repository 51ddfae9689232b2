"""Narrow places: windows, traps and pinches, each problem from the seed and its own number alone.

- A *window* is a wall of four boxes; at the goal a link stands in its opening. The base turns, or is locked.
- A *trap* is a box about the tool at the goal, closed but for one opening, or open to the sides; sometimes the tool is
  in another one at the start.
- A *pinch* is a motion with corners, the base locked, to whose sweep balls are put so close that this room is left.

Openings are wider than the link by a gap, whether there is a motion or not; along a pinch there always is one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeAlias

import numpy as np
from studies.harness import Asked, Row, Study
from studies.measure import planned
from studies.peers import peer_row
from studies.validation.random_scenes import vector

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.planning.definition import check_problem
from hplan.planning.options import PlanOptions
from hplan.planning.task import PlanningCache
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere

#: Kinds of problems, and of arms: those that ship, and members of the family drawn with wide ranges.
KINDS = ("window", "window, base locked", "trap", "trap, base locked")
ARMS = ("harvester", "orchard_harvester", "drawn")

#: By how much openings are wider than the link [m], and what balls leave beside it [m].
GAPS, ROOMS = (0.01, 0.03, 0.05, 0.1), (2e-4, 5e-4, 2e-3, 6e-3)

#: One problem of so many is a pinch.
PER_PINCH = 6

#: Start and goal have so much clearance [m].
LEAST = 1e-3

#: Thickness of walls and how far they reach beyond their opening [m]; how far they may lean from the link's normal, and
#: how far the link may be from the opening's middle, as a fraction of the gap.
THICKNESS, WALL, LEAN_DEG, OFF_CENTER = 0.02, (0.3, 1.2), 8.0, 0.25

#: Room about the tool in a trap, to each side and ahead [m].
TRAP_ROOM = (0.05, 0.15)

#: Balls of a pinch, how many of them leave no more than the room, their radii, and what the others leave more [m].
BALLS, CLOSE_BALLS, RADII, FARTHER = (6, 12), (2, 4), (0.02, 0.25), (0.005, 0.06)

#: Spacing of the samples of a pinch's motion [rad].
SAMPLE = math.radians(0.1)

#: Where URDFs of drawn members are written to, which are read again.
_FOLDER = TemporaryDirectory()

#: Draws before other walls are drawn.
_DRAWS = 20

#: Start, goal, and what is drawn about them.
_Drawn: TypeAlias = tuple[FloatArray, FloatArray, Sequence[Box | Sphere]]


class NarrowProblem(NamedTuple):
    """A problem: its number, one of `KINDS` or `pinch`, gap or room [m], arm, robot and scene."""

    number: int
    kind: str
    gap_m: float
    arm: str
    robot: Robot
    scene: Scene


def narrow_problem(seed: int, number: int, kind: str, arm: str, gap: float) -> NarrowProblem:
    """The problem with a number, of one of `KINDS` or a `pinch`, for one of `ARMS`, with a gap or room [m]."""
    random = np.random.default_rng([seed, number])
    robot = drawn_member(seed, number) if arm == "drawn" else load_robot(arm)
    while True:
        locked = kind == "pinch" or kind.endswith("locked")
        if kind == "pinch":
            drawn: _Drawn | None = _pinch(robot, random, gap)
        else:
            goal = _configuration(robot, random)
            walls = (_window if kind.startswith("window") else _trap)(robot, goal, "goal", gap, random)
            drawn = None if walls is None else _with_start(robot, goal, walls, gap, (kind, locked), random)
        if drawn is None:
            continue
        start, goal, obstacles = drawn
        scene = Scene(
            name=f"narrow-{number}",
            start=Start(joints_rad=tuple(start.tolist())),
            goal=Goal(joints_rad=tuple(goal.tolist())),
            locked_joints=robot.joint_names[:1] if locked else (),
            obstacles=tuple(obstacles),
        )
        if _is_narrow(robot, scene):
            return NarrowProblem(number, kind, gap, arm, robot, scene)


def _is_narrow(robot: Robot, scene: Scene) -> bool:
    """True if planning takes base, start and goal, and the straight motion is not clear."""
    world = PlanningCache(robot).world(scene, PlanOptions())
    try:
        world.check_base(robot.yaw_of(scene.start.configuration))
        problem = check_problem(
            world, scene.start.configuration, scene.goal.configuration, locked_joints=scene.locked_joints
        )
    except HplanError:
        return False
    ends = np.stack([problem.start, problem.goal])
    return problem.spare_clearance >= LEAST and not world.field.is_clear(ends, 1e-6)


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
    return load_robot(write_robot(spec, Path(_FOLDER.name) / f"drawn_{seed}_{number}.urdf")[0])


def _configuration(robot: Robot, random: np.random.Generator) -> FloatArray:
    """Any configuration, its yaw within 90 degrees."""
    q: FloatArray = random.uniform(robot.lower, robot.upper)
    q[0] = random.uniform(-0.5 * math.pi, 0.5 * math.pi)
    return q


def _with_start(
    robot: Robot, goal: FloatArray, walls: list[Box], gap: float, how: tuple[str, bool], random: np.random.Generator
) -> _Drawn | None:
    """A start that is clear of the walls, sometimes with a trap of its own; None where none was found."""
    kind, locked = how
    for _ in range(_DRAWS):
        start = _configuration(robot, random)
        if locked:
            start[0] = goal[0]
        more = None
        if kind.startswith("trap") and random.random() < 0.3:
            more = _trap(robot, start, "start", gap, random)
        obstacles = walls + (more or [])
        checker = CoalScene(robot, obstacles)
        if min(float(checker.distances(q).min()) for q in (start, goal)) > LEAST:
            return start, goal, obstacles
    return None


def _link_frame(robot: Robot, q: FloatArray, link: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Both ends of a link's axis, and its frame as columns: along it, the plane's normal, and across it."""
    origin, axes = robot.plane_at(robot.yaw_of(q))
    points = origin + robot.arm.joint_points(q[robot.arm_slice]) @ axes[:2]
    along = (points[link + 1] - points[link]) / robot.arm.lengths[link]
    across = np.cross(along, axes[2])
    return points[link], points[link + 1], np.column_stack([along, -axes[2], -across])


def _leaning(frame: FloatArray, random: np.random.Generator) -> FloatArray:
    """A frame turned a little about its second and third axis."""
    a, b = np.radians(random.uniform(-LEAN_DEG, LEAN_DEG, 2)).tolist()
    about_y = np.array([[math.cos(a), 0.0, math.sin(a)], [0.0, 1.0, 0.0], [-math.sin(a), 0.0, math.cos(a)]])
    about_z = np.array([[math.cos(b), -math.sin(b), 0.0], [math.sin(b), math.cos(b), 0.0], [0.0, 0.0, 1.0]])
    turned: FloatArray = frame @ about_y @ about_z
    return turned


def _box(name: str, center: FloatArray, frame: FloatArray, size: tuple[float, float, float]) -> Box:
    """A box with edges along the axes of a frame."""
    pitch = -math.asin(max(-1.0, min(1.0, float(frame[2, 0]))))
    yaw, roll = math.atan2(frame[1, 0], frame[0, 0]), math.atan2(frame[2, 1], frame[2, 2])
    rpy = math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
    return Box(name=name, center=vector(center), size=size, rpy_deg=rpy)


def _opening(name: str, center: FloatArray, frame: FloatArray, half: float, rims: tuple[float, float]) -> list[Box]:
    """Four boxes about a square opening: half its width, and how far they reach beyond it to the sides and upwards."""
    wide, high = rims
    boxes: list[Box] = []
    for side in (-1.0, 1.0):
        up, aside = side * (half + 0.5 * high) * frame[:, 2], side * (half + 0.5 * wide) * frame[:, 1]
        boxes.append(_box(f"{name} {len(boxes)}", center + up, frame, (THICKNESS, 2.0 * (half + wide), high)))
        boxes.append(_box(f"{name} {len(boxes)}", center + aside, frame, (THICKNESS, wide, 2.0 * half)))
    return boxes


def _window(robot: Robot, q: FloatArray, name: str, gap: float, random: np.random.Generator) -> list[Box] | None:
    """A wall with a link, one of the last two, in its opening."""
    link = robot.arm.link_count - 1 - int(random.integers(2))
    first, last, frame = _link_frame(robot, q, link)
    center = first + random.uniform(0.35, 0.75) * (last - first)
    frame = _leaning(frame, random)
    center = center + OFF_CENTER * gap * random.uniform(-1.0, 1.0) * frame[:, 2]
    half = float(robot.arm.half_widths[link]) + 0.5 * gap
    return _opening(f"{name} wall", center, frame, half, (random.uniform(*WALL), random.uniform(*WALL)))


def _trap(robot: Robot, q: FloatArray, name: str, gap: float, random: np.random.Generator) -> list[Box] | None:
    """A box about the tool that the last link reaches into; a U where its sides are left open."""
    link = robot.arm.link_count - 1
    first, last, frame = _link_frame(robot, q, link)
    width = float(robot.arm.half_widths[link])
    center = first + random.uniform(0.4, 0.75) * (last - first)
    wide, high, ahead = random.uniform(*TRAP_ROOM, 3).tolist()
    half = width + 0.5 * gap
    boxes = _opening(f"{name} trap", center, frame, half, (wide, high))
    depth = float(np.linalg.norm(last - center)) + width + ahead
    middle, back = center + 0.5 * depth * frame[:, 0], center + depth * frame[:, 0]
    whole = 2.0 * (half + wide), 2.0 * (half + high)
    boxes.append(_box(f"{name} trap back", back, frame, (THICKNESS, *whole)))
    for side in (-1.0, 1.0):
        up, aside = side * (half + high) * frame[:, 2], side * (half + wide) * frame[:, 1]
        boxes.append(_box(f"{name} trap {len(boxes)}", middle + up, frame, (depth, whole[0], THICKNESS)))
        if random.random() < 0.7:
            boxes.append(_box(f"{name} trap {len(boxes)}", middle + aside, frame, (depth, THICKNESS, whole[1])))
    return boxes


def _pinch(robot: Robot, random: np.random.Generator, room: float) -> _Drawn | None:
    """A motion with a corner or two, and balls in the arm plane beside what it sweeps."""
    arm = robot.arm
    corners = random.uniform(arm.lower, arm.upper, (int(random.integers(3, 5)), arm.link_count))
    parts = []
    for a, b in pairwise(corners):
        count = max(2, math.ceil(float(np.abs(b - a).max()) / SAMPLE))
        parts.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    swept = arm.joint_points(np.concatenate(parts))
    reach, origin = float(arm.lengths.sum()), robot.plane_origin
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
            place = origin + center @ robot.plane_axes
            balls.append(Sphere(name=f"ball {len(balls)}", center=vector(place), radius=radius))
        if len(balls) == count:
            yaw = [0.0] * robot.yaw_joints
            return np.array([*yaw, *corners[0]]), np.array([*yaw, *corners[-1]]), balls
    return None


def _least_distance(swept: FloatArray, half_widths: FloatArray, center: FloatArray) -> float:
    """Distance of a point in the plane from links on the way: (n, links + 1, 2) joint points [m]."""
    first, axis = swept[:, :-1], np.diff(swept, axis=1)
    along = (((center - first) * axis).sum(axis=2) / (axis**2).sum(axis=2)).clip(0.0, 1.0)
    distance = np.linalg.norm(first + along[..., None] * axis - center, axis=2) - half_widths
    return float(distance.min())


def numbered_problem(seed: int, number: int) -> NarrowProblem:
    """The problem with a number: kinds, arms and gaps in turn."""
    turn, place = divmod(number, PER_PINCH)
    if place == PER_PINCH - 1:
        return narrow_problem(seed, 10**5 + turn, "pinch", ARMS[turn % 3], ROOMS[turn // 3 % 4])
    other = number - turn  # windows and traps are numbered without the pinches
    return narrow_problem(seed, number, KINDS[other % 4], ARMS[other // 4 % 3], GAPS[other // 12 % 4])


def _row(asked: Asked, number: int) -> Row:
    problem = numbered_problem(asked.seed, number)
    _, row = planned(problem.robot, problem.scene, PlanOptions(effort=asked.effort))
    row |= peer_row(asked, problem.robot, problem.scene, row.get("duration_s"))
    row["missed"] = not row["solved"] and row.get("peer_solved", False)
    place = "pinch" if problem.kind == "pinch" else "opening"
    return row | {
        "name": f"{problem.number}: {problem.kind}, {1e3 * problem.gap_m:g} mm, {problem.arm}",
        "gap": f"{place} {1e3 * problem.gap_m:g} mm",
    }


NARROW = Study(
    "narrow",
    "windows, traps and pinches for three kinds of arm",
    _row,
    ("certified", "missed", "origin", "ms", "duration_s", "peer_solved", "peer_ms", "to_peer"),
    by="gap",
    count=(240, 12),
    warm=4,
)
