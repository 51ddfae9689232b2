"""From a fruit, or a point, to grasps: where the tool ends, where its straight approach begins.

All configurations with the tool at the point come from closed-form inverse kinematics
(`hplan.planar.inverse_kinematics`); each has an approach along the last link (`hplan.planar.straight_approach`), from a
stand-off that is as long as asked for where that can be had, else shorter. Only the last link may touch the fruit that
is reached for, and only on the approach; where no straight approach is clear, on the whole way.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record, frozen
from hplan.errors import BlockedError
from hplan.planar.inverse_kinematics import Candidates, reach
from hplan.planar.straight_approach import ApproachPath, standoffs
from hplan.planning.finer_angles import Refined, refined
from hplan.problem.joint_ranges import LEAST_MARGIN, JointRanges, joint_ranges
from hplan.problem.world import World
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel, name_margin
from hplan.scene.model import Fruit

#: Configurations that are looked at, about.
COUNT = 64

#: Stand-offs tried in turn, as shares of the one asked for.
SHARES = (1.0, 0.5, 0.2)

#: To how many grasps routes are searched where no straight motion leads to them.
SEARCHED = 8

#: Where an approach is looked at, as shares of its length.
_LOOKS = (0.25, 0.5, 0.75, 1.0)

#: What counts as the clearance of a configuration that no motion leads to, as a joint is blocked before [m].
BEYOND = -1.0

#: Clearance that a grasp and its stand-off have beyond the one to keep, and half of it all along the approach [m].
SPARE = 1e-3


@dataclass(frozen=True, eq=False)
class Grasp(Record):
    """One way to have the tool at the point.

    Attributes:
        goal: (dof,) configuration with the tool at the point.
        standoff: (dof,) configuration where the straight approach begins; the goal itself where there is none.
        distance: Length of the approach [m].
        approach: Absolute angle of the last link in the arm plane [rad].
        least_duration: What no motion from the start over the stand-off to the goal can undercut [s].
    """

    goal: FloatArray
    standoff: FloatArray
    distance: float
    approach: float
    least_duration: float

    def transit_among(self, world: World, near: World) -> World:
        """What the way to the stand-off has to keep clear of; without an approach it leads to the fruit itself."""
        return near if self.distance == 0.0 else world

    def path(self, robot: Robot, locked: tuple[str, ...] = ()) -> ApproachPath | None:
        """The approach, or None where there is none."""
        return ApproachPath(robot, self.goal, self.distance, locked) if self.distance > 0.0 else None


def grasps(
    world: World,
    near: World,
    position: ArrayLike,
    start: FloatArray,
    *,
    what: str,
    standoff: float,
    least_standoff: float = 0.0,
    approach_deg: float | tuple[float, float] | None = None,
    locked: Sequence[str] = (),
) -> tuple[Grasp, ...]:
    """All ways found to have the tool at a point, by the least duration that any motion there can have.

    Args:
        world: The arm among everything, for the way to the stand-off.
        near: The same for the approach: the last link may touch the fruit.
        position: (3,) the point, in `base_link` [m].
        start: (dof,) configuration from which the arm comes.
        what: What is at the point, for errors.
        standoff: Length of the straight approach asked for [m]; where it cannot be had, shorter ones are tried.
        least_standoff: Shortest approach [m].
        approach_deg: Approach angle or an interval of it; None for all [deg].
        locked: Names of joints that keep their start values.

    Raises:
        UnreachableError: No configuration reaches the point, whatever is in the way.
        BlockedError: Obstacles are in the way of all that do, or block a joint on every way there; names them.
        ConfigurationInCollisionError: The start touches something that blocks a joint.
        InputError: A position or an approach that is none.
        OptionError: As `reach`.
    """
    robot = world.robot
    ranges = joint_ranges(world.checker, start, LEAST_MARGIN)
    if ranges.walls:
        world.check_clear(start, "start")

    def within(approach_deg: float | tuple[float, float] | None, count: int) -> Candidates:
        return reach(robot, position, approach_deg=approach_deg, count=count, start=start, locked=locked)

    def clearance(q: FloatArray) -> float:
        return near.field.clearance(q) if ranges.wall_before(q) is None else BEYOND

    found = within(approach_deg, COUNT)
    clear = np.array([clearance(q) > SPARE for q in found.configurations])
    if clear.any():
        found = Candidates(found.configurations[clear], found.approach[clear])
    else:
        finer = refined(found, within, clearance, SPARE, approach_deg)
        if finer.candidates is None:
            error = _blocked(what, near, ranges, found.configurations, finer)
            if near.deviation > 0.0:
                free = [q for q in found.configurations if ranges.wall_before(q) is None]
                share = near.share_of_deviation(np.array(free), SPARE) if free else 0.0
                name_margin(error, TrackingModel(near.deviation), share)
            raise error
        found = finer.candidates
    goals, angles = frozen(found.configurations), found.approach
    chosen: dict[int, tuple[float, FloatArray]] = {}
    # A straight approach takes three joints in the arm plane.
    straight = sum(name not in locked for name in robot.arm.joint_names) >= 3
    for distance in _distances(standoff, least_standoff) if straight else ():
        left = [i for i in range(len(goals)) if i not in chosen]
        if not left:
            break
        for i, begin in zip(left, _clear_standoffs(world, near, ranges, goals[left], distance, locked), strict=True):
            if begin is not None:
                chosen[i] = (distance, begin)
    if not chosen:
        chosen = {i: (0.0, goal) for i, goal in enumerate(goals)}
    ways = [
        Grasp(goals[i], begin, distance, float(angles[i]), _least_duration(robot, start, begin, goals[i]))
        for i, (distance, begin) in chosen.items()
    ]
    return tuple(ways[i] for i in ties.argsort([grasp.least_duration for grasp in ways]).tolist())


def promising(ways: Sequence[Grasp], world: World, near: World, start: FloatArray) -> list[Grasp]:
    """The first grasp that a straight motion leads to, and a few that promise more, evenly taken from all of those."""
    straight = next(
        (
            number
            for number, grasp in enumerate(ways)
            if grasp.transit_among(world, near).field.is_clear(np.stack([start, grasp.standoff]), SPARE)
        ),
        len(ways),
    )
    stride = max(1, math.ceil(straight / SEARCHED))
    return [*ways[:straight:stride], *ways[straight : straight + 1]]


def least_standoff(world: World, fruit: Fruit) -> float:
    """Where the tool is clear of the fruit it is going to take [m]."""
    arm, sway = world.robot.arm, world.robot.sway(world.deviation)
    return fruit.radius + float(arm.half_widths[-1] + sway[-1]) + world.clearance + 2.0 * SPARE


def _distances(standoff: float, least: float) -> list[float]:
    """Lengths of the approach to try, the one asked for first."""
    if standoff <= 0.0 and least <= 0.0:
        return []
    shorter = {max(least, share * standoff) for share in SHARES}
    return sorted(shorter, reverse=True)


def _clear_standoffs(
    world: World,
    near: World,
    ranges: JointRanges,
    goals: FloatArray,
    distance: float,
    locked: Sequence[str],
) -> list[FloatArray | None]:
    """For each goal the configuration at the stand-off, if arm and approach are clear of obstacles there.

    The approach is looked at along a polyline of a few points; `Grasp.path` is the exact one, and the certificate
    judges that.
    """
    stages = [standoffs(world.robot, goals, distance * share, locked=locked) for share in _LOOKS]
    ways = np.stack([goals, *(stage.configurations for stage in stages)], axis=1)
    begins: list[FloatArray | None] = []
    for feasible, way in zip(stages[-1].feasible, ways, strict=True):
        usable = (
            feasible
            and ranges.wall_before(way[-1]) is None
            and world.field.clearance(way[-1]) > SPARE
            and near.field.is_clear(way, 0.5 * SPARE)
        )
        begins.append(frozen(way[-1].copy()) if usable else None)
    return begins


def _least_duration(robot: Robot, start: FloatArray, standoff: FloatArray, goal: FloatArray) -> float:
    """What no motion from the start over the stand-off to the goal can undercut [s]."""
    limits = robot.velocity_limit, robot.acceleration_limit
    return sum(least_duration(a, b, *limits) for a, b in ((start, standoff), (standoff, goal)))


def _blocked(what: str, near: World, ranges: JointRanges, configurations: FloatArray, finer: Refined) -> BlockedError:
    """The error that names what is in the way, the most frequent first."""
    walls = [ranges.wall_before(q) for q in configurations]
    nearest = [
        near.checker.nearest(q) if wall is None else wall.contact for q, wall in zip(configurations, walls, strict=True)
    ]
    counts = Counter((contact.link, contact.obstacle) for contact in nearest if contact is not None)
    obstacles = [
        {"obstacle": obstacle, "link": link, "configurations": count}
        for (link, obstacle), count in counts.most_common()
    ]
    return BlockedError(what, len(configurations), obstacles, refined=finer.tried, best_clearance_m=finer.best_m)
