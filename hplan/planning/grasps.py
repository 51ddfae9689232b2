"""Grasps of a fruit or point: goal configurations with straight approaches.

Each configuration with the tool at the point (`hplan.planning.specialist.GoalSampler`) gets a straight approach along
the tool axis (`Robot.tool_axis`). The approach starts at a stand-off of the requested distance, or of a shorter one if
that is infeasible. Only the last link may touch the target fruit, and only during the approach; if no straight approach
is collision-free, it may touch the fruit during the whole motion. If obstacles block all configurations at the centre
of a fruit, others within its `grasp_offset` are tried: a hand need not go deep between the fruit and its branch.

If the position of a fruit is uncertain, approaches differ in the probability that it is within the gripper's capture
range: its center is off by at most one length along the tool axis at the grasp and by at most another length across it.
The error is normal, with the fruit's own covariance and the shared one. The probability is the fraction of 4,096 evenly
distributed draws, the same for all approaches; it is accurate to about 0.2 %. Errors of the arm are not included.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.base.deadline import is_over
from hplan.collision.coal_scene import Contact
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.motion_coefficients import reach as reach_of_bodies
from hplan.errors import BlockedError, TiltedError, UnreachableError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.kinematics.straight_line import ToolLine, lines_back
from hplan.kinematics.tool_at_point import approach_angles
from hplan.planning.joint_ranges import LEAST_MARGIN, JointRanges
from hplan.planning.options import PlanOptions
from hplan.planning.specialist import goal_sampler_of, joint_ranges
from hplan.planning.world import World
from hplan.robot.limits import rest_to_rest
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel, name_margin
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene

#: Number of draws, and the maximum difference in probability from the best approach to count as equally good.
_DRAWS, SAME = 4096, 0.005


def capture_probabilities(
    approaches: FloatArray, covariance: FloatArray, capture_m: tuple[float, float], offsets: FloatArray | None = None
) -> FloatArray:
    """(k,) probabilities that a fruit is within capture range.

    Args:
        approaches: (k, 3) directions of the tool, of any length.
        covariance: (3, 3) covariance of the fruit's position [m^2].
        capture_m: Maximum offset of its center across the approach, and along it [m].
        offsets: (k, 3) offsets of the tool from its expected center [m]; None for none.
    """
    from scipy.special import ndtri

    # Multiples of the inverse powers of the root of x^4 = x + 1, modulo 1, fill a cube evenly.
    root = 1.2207440846057596
    even = (0.5 + np.arange(1, _DRAWS + 1)[:, None] * root ** -np.arange(1.0, 4.0)) % 1.0
    values, vectors = np.linalg.eigh(covariance)
    errors = (ndtri(even) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    ahead = approaches / np.linalg.norm(approaches, axis=1, keepdims=True)
    offsets = np.zeros(ahead.shape) if offsets is None else offsets
    along = errors @ ahead.T - (offsets * ahead).sum(axis=1)
    squared = (errors**2).sum(axis=1)[:, None] - 2.0 * errors @ offsets.T + (offsets**2).sum(axis=1)
    across = np.maximum(squared - along**2, 0.0)
    within: FloatArray = ((np.abs(along) <= capture_m[1]) & (across <= capture_m[0] ** 2)).mean(axis=0)
    return within


#: Approximate number of candidate configurations.
COUNT = 64

#: Maximum number of grasps used as goals of a route search if no straight motion leads to them.
SEARCHED = 8

#: Clearance assigned to a configuration that no motion reaches because a joint is blocked on the way [m].
_BEYOND = -1.0

#: Clearance of a grasp and its stand-off beyond the required clearance; half of it along the whole approach [m].
SPARE = 1e-3

#: Offsets from the centre that are tried in turn, as fractions of `Fruit.grasp_offset`; their (26, 3) directions; and
#: the approximate number of configurations at each of these points.
_OFFSETS = (0.5, 1.0)
_OFFSET_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_OFFSET_DIRECTIONS /= np.linalg.norm(_OFFSET_DIRECTIONS, axis=1, keepdims=True)
_OFFSET_COUNT = 16

#: Rounding error of a direction that points along an approach.
_NOT_DEEPER = 1e-9

#: Points of an approach that are checked, as fractions of its length: whole steps of `hplan.kinematics.straight_line`.
_CHECKED_FRACTIONS = (0.25, 0.5, 0.75, 1.0)

#: Values of that clearance in the order in which they are tried; the last one is the minimum [m].
ROOMS = (SPARE, 5e-4, 2e-4, 5e-5)


@dataclass(frozen=True, eq=False)
class Grasp(Record):
    """A configuration with the tool at the point, and its approach.

    Attributes:
        goal: (dof,) configuration with the tool at the point.
        standoff: (dof,) configuration at the start of the straight approach; the goal itself without an approach.
        distance: Length of the approach [m].
        approach: Approach angle of the tool (`hplan.kinematics.tool_at_point`) [rad].
        least_duration: Lower bound on the duration of any motion from the start through the stand-off to the goal [s].
        room: Clearance of grasp and stand-off beyond the required clearance, at most `SPARE` [m].
        keeps_turn: Whether the tool keeps its rotation about its axis during the approach.
        caught: Probability that the fruit is within the gripper's capture range; None without `capture_m`.
    """

    goal: FloatArray
    standoff: FloatArray
    distance: float
    approach: float
    least_duration: float
    room: float = SPARE
    keeps_turn: bool = False
    caught: float | None = None

    def path(self, robot: Robot, locked: Sequence[str] = ()) -> ToolLine | None:
        """The approach; None for a grasp without one."""
        return None if self.distance <= 0.0 else self.line(robot, locked, self.distance)

    def line(self, robot: Robot, locked: Sequence[str], length: float) -> ToolLine:
        """The straight approach of a length [m]."""
        return ToolLine(robot, self.goal, length, tuple(locked), self.keeps_turn)


@dataclass(frozen=True, eq=False)
class Target(Record):
    """A point or a pose that the tool has to reach.

    Attributes:
        what: Name of the target in error messages.
        position: (3,) the point, in `base_link` [m].
        world: The arm among all solids, for the motion to the stand-off.
        world_touching: The same for the approach: the last link may touch the fruit.
        approach_deg: Approach angle or an interval of it; None for all [deg].
        fruit: The fruit at the point; None for a bare point.
        least_standoff: Minimum length of the approach [m].
        pose: (4, 4) pose of `frame`; None for any orientation.
        frame: Name of the frame at the pose; None for the tool frame.
        rotation_tolerance: (3,) maximum rotation away from the pose, about its axes [rad]; None for none.
        capture_m: Maximum offset of the fruit's center that the gripper tolerates, across the approach and along
            it [m]; None to ignore the capture range.
        covariance: (3, 3) covariance of the fruit's position [m^2].
    """

    what: str
    position: ArrayLike
    world: World
    world_touching: World
    approach_deg: float | tuple[float, float] | None = None
    fruit: Fruit | None = None
    least_standoff: float = 0.0
    pose: FloatArray | None = None
    frame: str | None = None
    rotation_tolerance: FloatArray | None = None
    capture_m: tuple[float, float] | None = None
    covariance: FloatArray | None = None

    @classmethod
    def of_fruit(cls, world: World, fruit: Fruit, scene: Scene, options: PlanOptions) -> Target:
        """Return the target at a fruit's center.

        The minimum stand-off keeps the tool clear of the fruit.
        """
        least = fruit.radius + tool_thickness(world.robot, world.deviation) + world.clearance + 2.0 * SPARE
        return cls(
            f"fruit {fruit.name!r}", fruit.center, world, world.allow_touch(fruit.name, fruit.hangs_from),
            scene.goal.approach_deg, fruit, least, capture_m=options.capture_m,
            covariance=fruit.place_covariance + scene.shared_error,
        )  # fmt: skip

    def transit_world(self, grasp: Grasp) -> World:
        """World of the motion to the stand-off.

        Without an approach, that motion may touch the fruit.
        """
        return self.world_touching if grasp.distance == 0.0 else self.world


@dataclass(frozen=True, eq=False)
class Blocked(Record):
    """A target with a collision at every configuration that reaches it.

    Attributes:
        ranges: The intervals in which the joints can move.
        configurations: (n, dof), n >= 1, at evenly spaced approach angles.
        best: (dof,) the configuration with the maximum clearance, refined angles included.
        best_m: Its clearance [m]; -1 if a joint is blocked on every path to it.
        refined: Number of further configurations tried at finer approach angles.
    """

    target: Target
    ranges: JointRanges
    configurations: FloatArray
    best: FloatArray
    best_m: float
    refined: int

    @property
    def number_tried(self) -> int:
        """Total number of configurations tried."""
        return len(self.configurations) + self.refined

    def contact_at(self, q: FloatArray) -> Contact | None:
        """Return the contact that blocks a (dof,) configuration.

        It is at the configuration, or blocks a joint on every path to it.
        """
        wall = self.ranges.wall_before(q)
        return self.target.world_touching.checker.nearest_contact(q) if wall is None else wall.contact

    def error(self) -> BlockedError | TiltedError:
        """Error that names the obstacles blocking the configurations, the most frequent first.

        If the tool has to stay upright and none of the configurations holds it so, the error names the smallest tilt.
        """
        robot, upright = self.target.world_touching.robot, self.target.world_touching.upright
        if upright is not None:
            tilts = [upright.tilt_of(robot.forward_kinematics(q)) for q in self.configurations]
            if min(tilts) >= upright.max_tilt_rad:
                return TiltedError(self.target.what, min(tilts), upright.max_tilt_rad)
        nearest: list[Contact | None] = []
        for q in self.configurations:
            if nearest and is_over():
                break  # all are known to be blocked; the first ones suffice to name the obstacles
            nearest.append(self.contact_at(q))
        counts = Counter((contact.link, contact.obstacle) for contact in nearest if contact is not None)
        obstacles = [
            {"obstacle": obstacle, "link": link, "configurations": count}
            for (link, obstacle), count in counts.most_common()
        ]
        error = BlockedError(
            self.target.what,
            len(self.configurations),
            obstacles,
            refined=self.refined,
            best_clearance_m=self.best_m,
            needed_clearance_m=ROOMS[-1],
        )
        world = self.target.world_touching
        if world.deviation > 0.0:
            free = self.configurations[self.ranges.hold(self.configurations)]
            fraction = world.fraction_of_deviation(free, ROOMS[-1]) if len(free) else 0.0
            name_margin(error, TrackingModel(world.deviation), world.robot.slides, fraction)
        return error


def grasps(
    target: Target, start: FloatArray, *, standoff: float, locked: Sequence[str] = (), count: int = COUNT
) -> tuple[Grasp, ...]:
    """Return all grasps found of a target, or raise, as `grasps_or_blocked`.

    Raises:
        BlockedError: Obstacles block every configuration there, or a joint on every path to it; names them.
        TiltedError: The tool has to stay upright, and no configuration there holds it so.
        HplanError: As `grasps_or_blocked`.
    """
    found = grasps_or_blocked(target, start, standoff=standoff, locked=locked, count=count)
    if isinstance(found, Blocked):
        raise found.error()
    return found


def grasps_or_blocked(
    target: Target, start: FloatArray, *, standoff: float, locked: Sequence[str] = (), count: int = COUNT
) -> tuple[Grasp, ...] | Blocked:
    """Return the grasps found, sorted by minimum duration, or the blocked target.

    Args:
        target: The point to reach, and the worlds to reach it in.
        start: (dof,) start configuration.
        standoff: Requested length of the straight approach [m]; shorter ones are tried if it is infeasible.
        locked: Names of joints that keep their start values.
        count: Approximate number of candidate configurations if the approach angle is free.

    Raises:
        UnreachableError: No configuration that reaches the point was found, obstacles ignored.
        ConfigurationInCollisionError: The start is in contact with an obstacle that blocks a joint.
        InputError: The position or the approach is invalid.
        OptionError: As the robot's goal sampler.
    """
    ranges = joint_ranges(target.world.checker, start, LEAST_MARGIN)
    if ranges.walls:
        target.world.check_clear(start, "start")
    clear = _clear_candidates(target, ranges, start, locked, count)
    if isinstance(clear, Blocked):
        return clear
    found, room = clear
    robot, keeps_turn = target.world.robot, target.pose is not None
    if goal_sampler_of(robot).is_sorted:  # the quickest to reach
        found = found[:count]
    goals = frozen(found)
    lengths = _distances(standoff, target.least_standoff)

    @cache
    def approaches_of_length(length: float) -> tuple[BoolArray, FloatArray]:
        return straight_approaches(robot, goals, length, locked, keeps_turn)

    direct = {i: (0.0, goal) for i, goal in enumerate(goals)}
    for less in (room, *(less for less in ROOMS if less < room)):
        chosen = _clear_approaches(target, ranges, approaches_of_length, lengths, less)
        if chosen:
            approached = _sort_grasps(target, found, chosen, start)
            # Grasps with less clearance may fail certification, so direct motions follow them.
            return approached if less == room else (*approached, *_sort_grasps(target, found, direct, start))
    return _sort_grasps(target, found, direct, start)


def _sort_grasps(
    target: Target, found: FloatArray, chosen: dict[int, tuple[float, FloatArray]], start: FloatArray
) -> tuple[Grasp, ...]:
    """Return grasps for the chosen approaches, sorted by minimum duration.

    `chosen` maps the number of a candidate to approach length and stand-off.
    """
    numbers, robot = list(chosen), target.world.robot
    goals, begins = found[numbers], np.array([begin for _, begin in chosen.values()])
    distances = np.array([distance for distance, _ in chosen.values()])
    before = np.where(distances > 0.0, target.world.field.spare_clearances(begins), SPARE)
    rooms = np.minimum(np.minimum(target.world_touching.field.spare_clearances(goals), before), SPARE).tolist()
    limits = robot.velocity_limit, robot.acceleration_limit
    turns = np.abs(begins - start), np.abs(goals - begins)
    least = sum(rest_to_rest(turn, *limits).max(axis=1) for turn in turns)
    angles, shares = approach_angles(robot, goals).tolist(), None
    if target.capture_m is not None and target.covariance is not None:
        ahead = robot.forward_kinematics(goals)[:, :3, :3] @ robot.tool_axis
        offsets = robot.tool_positions(goals) - np.asarray(target.position)
        shares = capture_probabilities(ahead, target.covariance, target.capture_m, offsets)
    return tuple(
        Grasp(
            frozen(goals[i].copy()), chosen[numbers[i]][1], float(distances[i]), angles[i], float(least[i]), rooms[i],
            target.pose is not None, None if shares is None else float(shares[i]),
        )
        for i in ties.argsort(least).tolist()
        if shares is None or shares[i] >= shares.max() - SAME
    )  # fmt: skip


def select_promising(found: Sequence[Grasp], target: Target, start: FloatArray) -> list[Grasp]:
    """Return the first grasp with a straight motion, and some quicker ones.

    The latter are an even selection of the grasps before it.
    """
    clear = (
        target.transit_world(grasp).field.is_clear(np.stack([start, grasp.standoff]), 0.9 * grasp.room)
        for grasp in found
    )
    straight = next((number for number, is_clear in enumerate(clear) if is_clear), len(found))
    stride = max(1, math.ceil(straight / SEARCHED))
    return [*found[:straight:stride], *found[straight : straight + 1]]


def _clear_candidates(
    target: Target, ranges: JointRanges, start: FloatArray, locked: Sequence[str], count: int
) -> tuple[FloatArray, float] | Blocked:
    """Collision-free configurations with the tool at the point.

    Evenly spaced approach angles are tried first, finer ones if all of those collide, and then points off the centre.

    Returns:
        The configurations and their member of `ROOMS`; a `Blocked` if none is collision-free.

    Raises:
        UnreachableError: No configuration reaches the point.
    """
    robot, sampler = target.world.robot, goal_sampler_of(target.world.robot)

    def at_points(points: ArrayLike, count: int) -> FloatArray:
        angle = target.approach_deg
        return sampler.at_point(robot, points, approach_deg=angle, count=count, start=start, locked=tuple(locked))

    def evenly_spaced(count: int) -> tuple[FloatArray, FloatArray]:
        if target.pose is None:
            return measure(at_points(target.position, count))
        at_pose = inverse_kinematics(
            robot, target.pose, start=start, frame=target.frame, locked=locked,
            rotation_tolerance_rad=target.rotation_tolerance,
        )  # fmt: skip
        return measure(at_pose)

    def off_center(length: float) -> tuple[FloatArray, FloatArray]:
        """Candidates at a distance from the centre, none of them deeper in the fruit than it, as `evenly_spaced`."""
        center = np.asarray(target.position)
        found = at_points(center + length * _OFFSET_DIRECTIONS, _OFFSET_COUNT)
        poses = robot.forward_kinematics(found)
        ahead, offset = poses[:, :3, :3] @ robot.tool_axis, poses[:, :3, 3] - center
        return measure(found[(ahead * offset).sum(axis=1) <= _NOT_DEEPER])

    def measure(found: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Candidates, and the (k,) minimum clearance of each over all links [m]."""
        rooms: FloatArray = target.world_touching.field.spare_clearances(found)
        rooms[~ranges.hold(found)] = _BEYOND
        return found, rooms

    measured = [evenly_spaced(count)]
    if count < COUNT and measured[0][1].max() <= SPARE:
        measured = [evenly_spaced(COUNT)]
    configurations = measured[0][0]
    if measured[0][1].max() <= SPARE and target.pose is None:
        with suppress(UnreachableError):
            measured.append(evenly_spaced(sampler.more))
    offset = 0.0 if target.fruit is None else target.fruit.grasp_offset
    for length in (fraction * offset for fraction in _OFFSETS if offset > 0.0):
        best = max(float(rooms.max(initial=_BEYOND)) for _, rooms in measured)
        if -length < best <= ROOMS[-1]:  # the hand comes free by at most its offset
            with suppress(UnreachableError):
                measured.append(off_center(length))
    for room in ROOMS:
        for found, rooms in measured:
            clear = rooms > room
            if clear.any():
                return found[clear], room
    found, rooms = max(measured, key=lambda of: float(of[1].max(initial=-math.inf)))
    nearest = frozen(found[ties.argmax(rooms)])
    refined = sum(len(rooms) for _, rooms in measured[1:])
    return Blocked(target, ranges, configurations, nearest, float(rooms.max()), refined)


def _distances(standoff: float, least: float) -> list[float]:
    """Approach lengths to try, the requested one first [m]."""
    if standoff <= 0.0 and least <= 0.0:
        return []
    # Stand-offs tried in turn, as fractions of the requested one.
    shorter = {max(least, fraction * standoff) for fraction in (1.0, 0.5, 0.2)}
    return sorted(shorter, reverse=True)


def _clear_approaches(
    target: Target,
    ranges: JointRanges,
    along: Callable[[float], tuple[BoolArray, FloatArray]],
    lengths: Sequence[float],
    room: float,
) -> dict[int, tuple[float, FloatArray]]:
    """Return approach length and stand-off of goals with collision-free approaches.

    The approach is checked along a polyline of a few points; the certificate covers the exact path, `Grasp.path`.
    """
    chosen: dict[int, tuple[float, FloatArray]] = {}
    enough = goal_sampler_of(target.world.robot).enough
    for length in lengths:
        feasible, approaches = along(length)
        every = len(approaches)
        if chosen and len(chosen) >= (every if enough is None else min(enough, every)):
            break
        begins = approaches[:, -1]
        clear = feasible & ranges.hold(begins)
        clear[clear] = target.world.field.spare_clearances(begins[clear]) > room
        for i in np.flatnonzero(clear).tolist():
            if i not in chosen and target.world_touching.field.is_clear(approaches[i], 0.5 * room):
                chosen[i] = length, frozen(begins[i].copy())
    return chosen


def straight_approaches(
    robot: Robot, goals: FloatArray, length: float, locked: Sequence[str] = (), keeps_turn: bool = False
) -> tuple[BoolArray, FloatArray]:
    """Straight approaches of a length [m] to (k, dof) goals.

    Args:
        locked: Names of joints that keep their start values.
        keeps_turn: Whether the tool keeps its rotation about its axis.

    Returns:
        (k,) mask of the goals with an approach, and (k, points, dof) configurations from the goals to the stand-offs.
    """
    lines = lines_back(robot, goals, length, locked=locked, keeps_turn=keeps_turn)
    steps = len(lines.distances) - 1
    return lines.reached > steps, lines.rows[:, [0, *(round(part * steps) for part in _CHECKED_FRACTIONS)]]


def tool_thickness(robot: Robot, deviation: float) -> float:
    """Extent of the tool beyond its frame, tracking error included [m].

    It is measured along the tool axis.

    Args:
        deviation: Tracking error of every joint [rad].
    """
    frame = robot.model.frames[robot.frame_number(robot.tool_frame)].placement
    ahead = [0.0]
    for body, row in zip(collision_bodies(robot), reach_of_bodies(robot), strict=True):
        if body.joint == robot.tool_joint - 1:
            along = (body.core - frame.translation) @ (frame.rotation @ robot.tool_axis)
            ahead.append(float(along.max()) + body.rounding + deviation * float(row.sum()))
    return max(ahead)
