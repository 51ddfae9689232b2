"""Configurations with the tool at a point or a pose, and straight approaches to them, of robots of any kind.

Those of the planar family are in closed form (`hplan.kinematics`): its tool comes along the last link. Of any other
robot they are sought (`hplan.kinematics`), and the tool comes along the z axis of its frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, frozen
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import reach as reach_of_bodies
from hplan.errors import UnreachableError
from hplan.kinematics.approach_angles import Candidates
from hplan.kinematics.finer_angles import Refined, refined
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.kinematics.planar_inverse_kinematics import reach
from hplan.kinematics.straight_approach import ApproachPath, Stretches, standoffs
from hplan.kinematics.straight_line import StraightLine, lines_back
from hplan.kinematics.tool_at_point import approach_angles, tool_at_point
from hplan.robot.model import Robot

#: Where an approach is checked, as fractions of its length: whole steps of `hplan.kinematics.straight_line`.
_LOOKS = (0.25, 0.5, 0.75, 1.0)

#: Where no configuration is clear, so many directions are tried.
_MORE = 256

#: A straight approach.
ToolPath: TypeAlias = ApproachPath | StraightLine


class Approaches(NamedTuple):
    """Straight approaches of one length to several goals.

    Attributes:
        feasible: (k,) mask of the goals to which there is one.
        polylines: (k, points, dof) configurations from the goals to the stand-offs.
    """

    feasible: BoolArray
    polylines: FloatArray


def candidates_at(
    robot: Robot,
    position: ArrayLike,
    *,
    approach_deg: float | tuple[float, float] | None,
    count: int,
    start: FloatArray,
    locked: Sequence[str] = (),
) -> Candidates:
    """Configurations with the tool at a position; of a planar arm all of them, up to about `count` samples.

    Args:
        position: (3,) in `base_link` [m].
        approach_deg: Approach angle, or an interval of it; None for all [deg].
        count: About how many configurations, or directions of the tool.
        start: (dof,) configuration from which the arm comes.
        locked: Names of joints that keep their start values.

    Raises:
        HplanError: As `hplan.kinematics.planar_inverse_kinematics.reach` and `hplan.kinematics.tool_at_point`.
    """
    find = tool_at_point if robot.planar is None else reach
    return find(robot, position, approach_deg=approach_deg, count=count, start=start, locked=locked)


def candidates_at_pose(
    robot: Robot, pose: FloatArray, frame: str | None, start: FloatArray, locked: Sequence[str] = ()
) -> Candidates:
    """Configurations with a frame at a (4, 4) pose.

    Raises:
        HplanError: As `hplan.kinematics.inverse_kinematics`.
    """
    found = inverse_kinematics(robot, pose, start=start, frame=frame, locked=locked)
    return Candidates(found, approach_angles(robot, found, pose[:3, 3]))


def finer_candidates(
    robot: Robot,
    evenly: Candidates,
    within: Callable[[float | tuple[float, float] | None, int], Candidates],
    clearance: Callable[[FloatArray], float],
    enough: float,
    approach_deg: float | tuple[float, float] | None,
) -> Refined:
    """More configurations than those found, none of which has enough clearance.

    Of a planar arm those at angles about the best (`hplan.kinematics.finer_angles`); of any other those of more
    directions.

    Args:
        within: Configurations at an approach angle, within an interval or at all of them, about so many.
        clearance: Clearance of a (dof,) configuration [m].
        enough: Clearance that is enough [m].
        approach_deg: Approach angle or interval that is asked for; None for all [deg].
    """
    if robot.planar is not None:
        return refined(evenly, within, clearance, enough, approach_deg)
    try:
        more = within(approach_deg, _MORE)
    except UnreachableError:
        more = evenly
    rooms = np.array([clearance(q) for q in more.configurations])
    clear = rooms > enough
    found = Candidates(more.configurations[clear], more.approach[clear]) if clear.any() else None
    return Refined(found, len(rooms), float(rooms.max()))


def soonest(robot: Robot, found: Candidates, count: int) -> Candidates:
    """Those that are reached soonest, so many at most; of a planar arm all, which are fewer and not in that order."""
    if robot.planar is not None or len(found.approach) <= count:
        return found
    return Candidates(frozen(found.configurations[:count]), frozen(found.approach[:count]))


def straight_approaches(
    robot: Robot, goals: FloatArray, locked: Sequence[str], keeps_turn: bool
) -> Callable[[float], Approaches]:
    """Straight approaches to (k, dof) goals, by their length [m].

    Args:
        goals: (k, dof) configurations.
        keeps_turn: Whether the tool of a general (non-planar) arm may not turn about its axis.
    """
    if robot.planar is None:

        def drawn_back(length: float) -> Approaches:
            lines = lines_back(robot, goals, length, locked=locked, keeps_turn=keeps_turn)
            steps = len(lines.distances) - 1
            return Approaches(lines.reached > steps, lines.rows[:, [0, *(round(look * steps) for look in _LOOKS)]])

        return drawn_back
    back = Stretches.back_from(robot, goals, locked)

    def stretched(length: float) -> Approaches:
        looks = np.broadcast_to(length * np.array(_LOOKS), (len(goals), len(_LOOKS)))
        approached = np.concatenate([goals[:, None], back.configurations(goals, looks)], axis=1)
        return Approaches(back.largest(length) >= length, approached)

    return stretched


def tool_path(
    robot: Robot, goal: FloatArray, standoff: float, locked: Sequence[str] = (), keeps_turn: bool = False
) -> ToolPath:
    """The straight approach from a stand-off [m] to a (dof,) goal."""
    if robot.planar is None:
        return StraightLine(robot, goal, standoff, tuple(locked), keeps_turn)
    return ApproachPath(robot, goal, standoff, tuple(locked))


def largest_standoff(
    robot: Robot, goal: FloatArray, longest: float, locked: Sequence[str] = (), keeps_turn: bool = False
) -> float:
    """From how far the tool can come straight to a (dof,) goal, at most `longest` [m]."""
    if robot.planar is None:
        lines = lines_back(robot, goal[None], longest, locked=locked, keeps_turn=keeps_turn)
        return float(lines.distances[lines.reached[0] - 1])
    return float(standoffs(robot, goal[None], longest, locked=locked).largest[0])


def may_be_straight(robot: Robot, locked: Sequence[str]) -> bool:
    """True unless too few joints may move for any straight approach."""
    return robot.planar is None or sum(name not in locked for name in robot.arm.joint_names) >= 3


def tool_thickness(robot: Robot, deviation: float) -> float:
    """How far a tool at a point stands out towards it or, of a planar arm, about it, with joints off by so much [m].

    Args:
        deviation: By how much every joint may be off [rad].
    """
    if robot.planar is not None:
        return float(robot.arm.half_widths[-1] + robot.sway(deviation)[-1])
    frame = robot.model.frames[robot.frame_number(robot.tool_frame)].placement
    ahead = [0.0]
    for body, row in zip(collision_bodies(robot), reach_of_bodies(robot), strict=True):
        if body.joint == robot.tool_joint - 1:
            along = (body.core - frame.translation) @ frame.rotation[:, 2]
            ahead.append(float(along.max()) + body.rounding + deviation * float(row.sum()))
    return max(ahead)
