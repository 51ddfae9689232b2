"""Configurations with the tool at a point or a pose, and straight approaches to them, of robots of any kind.

Configurations of the planar family are in closed form, those of any other robot are sought; the tool of either comes
along its axis (`Robot.tool_axis`), as `hplan.kinematics.straight_line` finds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, frozen
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import reach as reach_of_bodies
from hplan.kinematics.approach_angles import Candidates
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.kinematics.planar_inverse_kinematics import reach
from hplan.kinematics.straight_line import StraightLine, lines_back
from hplan.kinematics.tool_at_point import approach_angles, tool_at_point
from hplan.robot.model import Robot

#: Where an approach is checked, as fractions of its length: whole steps of `hplan.kinematics.straight_line`.
_LOOKS = (0.25, 0.5, 0.75, 1.0)


class Approaches(NamedTuple):
    """Straight approaches of one length to several goals.

    Attributes:
        feasible: (k,) mask of the goals to which there is one.
        polylines: (k, points, dof) configurations from the goals to the stand-offs.
    """

    feasible: BoolArray
    polylines: FloatArray


class Tool:
    """Where the tool of an arm can be, and how it comes there straight; of a general (non-planar) arm.

    Attributes:
        enough: Where so many grasps have an approach, no shorter ones are looked for.
        more: How many directions, of a planar arm configurations, are tried where none of fewer is clear.
    """

    enough: float = 8
    more = 256
    _is_sorted = True

    def __init__(self, robot: Robot, locked: Sequence[str] = (), keeps_turn: bool = False) -> None:
        """Of a robot.

        Args:
            locked: Names of joints that keep their start values.
            keeps_turn: Whether the tool of a general (non-planar) arm may not turn about its axis on approaches.
        """
        self._robot, self._locked, self._keeps_turn = robot, tuple(locked), keeps_turn

    def at(
        self, position: ArrayLike, *, approach_deg: float | tuple[float, float] | None, count: int, start: FloatArray
    ) -> Candidates:
        """Configurations with the tool at a position; of a planar arm all of them, up to about `count` samples.

        Args:
            position: (3,) in `base_link` [m].
            approach_deg: Approach angle, or an interval of it; None for all [deg].
            count: About how many configurations, or directions of the tool.
            start: (dof,) configuration from which the arm comes.

        Raises:
            HplanError: As `hplan.kinematics.planar_inverse_kinematics.reach` and `hplan.kinematics.tool_at_point`.
        """
        return tool_at_point(
            self._robot, position, approach_deg=approach_deg, count=count, start=start, locked=self._locked
        )

    def at_pose(self, pose: FloatArray, frame: str | None, start: FloatArray) -> Candidates:
        """Configurations with a frame at a (4, 4) pose.

        Raises:
            HplanError: As `hplan.kinematics.inverse_kinematics`.
        """
        found = inverse_kinematics(self._robot, pose, start=start, frame=frame, locked=self._locked)
        return Candidates(found, approach_angles(self._robot, found, pose[:3, 3]))

    def soonest(self, found: Candidates, count: int) -> Candidates:
        """Those that are reached soonest, so many at most; of a planar arm all: fewer, and not in that order."""
        if not self._is_sorted or len(found.approach) <= count:
            return found
        return Candidates(frozen(found.configurations[:count]), frozen(found.approach[:count]))

    def approaches(self, goals: FloatArray, length: float) -> Approaches:
        """Straight approaches of a length [m] to (k, dof) goals."""
        lines = lines_back(self._robot, goals, length, locked=self._locked, keeps_turn=self._keeps_turn)
        steps = len(lines.distances) - 1
        return Approaches(lines.reached > steps, lines.rows[:, [0, *(round(look * steps) for look in _LOOKS)]])

    def path(self, goal: FloatArray, standoff: float) -> StraightLine:
        """The straight approach from a stand-off [m] to a (dof,) goal."""
        return StraightLine(self._robot, goal, standoff, self._locked, self._keeps_turn)

    def largest_standoff(self, goal: FloatArray, longest: float) -> float:
        """From how far the tool can come straight to a (dof,) goal, at most `longest` [m]."""
        lines = lines_back(self._robot, goal[None], longest, locked=self._locked, keeps_turn=self._keeps_turn)
        return float(lines.distances[lines.reached[0] - 1])

    def thickness(self, deviation: float) -> float:
        """How far a tool at a point stands out towards it or, of a planar arm, about it [m].

        Args:
            deviation: By how much every joint may be off [rad].
        """
        robot = self._robot
        frame = robot.model.frames[robot.frame_number(robot.tool_frame)].placement
        ahead = [0.0]
        for body, row in zip(collision_bodies(robot), reach_of_bodies(robot), strict=True):
            if body.joint == robot.tool_joint - 1:
                along = (body.core - frame.translation) @ frame.rotation[:, 2]
                ahead.append(float(along.max()) + body.rounding + deviation * float(row.sum()))
        return max(ahead)


class _PlanarTool(Tool):
    """That of a planar arm."""

    enough = math.inf
    more = 512
    _is_sorted = False

    def at(
        self, position: ArrayLike, *, approach_deg: float | tuple[float, float] | None, count: int, start: FloatArray
    ) -> Candidates:
        return reach(self._robot, position, approach_deg=approach_deg, count=count, start=start, locked=self._locked)

    def thickness(self, deviation: float) -> float:
        return float(self._robot.arm.half_widths[-1] + self._robot.sway(deviation)[-1])


def tool_of(robot: Robot, locked: Sequence[str] = (), keeps_turn: bool = False) -> Tool:
    """The tool of a robot, as `Tool`."""
    return (Tool if robot.planar is None else _PlanarTool)(robot, locked, keeps_turn)
