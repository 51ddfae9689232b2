"""Tool configurations at a point or pose, and straight approaches.

The configurations at a point come from the robot's goal sampler (`hplan.planning.specialist`), those at a pose from a
numerical search. The tool approaches along its axis (`Robot.tool_axis`), see `hplan.kinematics.straight_line`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, frozen
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import reach as reach_of_bodies
from hplan.kinematics.approach_angles import Candidates
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.kinematics.straight_line import StraightLine, lines_back
from hplan.kinematics.tool_at_point import approach_angles
from hplan.planning.specialist import goal_sampler_of
from hplan.robot.model import Robot

#: Points of an approach that are checked, as fractions of its length: whole steps of `hplan.kinematics.straight_line`.
_LOOKS = (0.25, 0.5, 0.75, 1.0)


class Approaches(NamedTuple):
    """Straight approaches of one length to several goals.

    Attributes:
        feasible: (k,) mask of the goals with an approach.
        polylines: (k, points, dof) configurations from the goals to the stand-offs.
    """

    feasible: BoolArray
    polylines: FloatArray


class Tool:
    """Configurations and straight approaches of a robot's tool."""

    def __init__(self, robot: Robot, locked: Sequence[str] = (), keeps_turn: bool = False) -> None:
        """Set up the tool of a robot.

        Args:
            locked: Names of joints that keep their start values.
            keeps_turn: Whether the tool keeps its rotation about its axis on approaches.
        """
        self._robot, self._locked, self._keeps_turn = robot, tuple(locked), keeps_turn
        self._sampler = goal_sampler_of(robot)

    @property
    def enough(self) -> int | None:
        """Number of approaches after which shorter ones are not searched.

        None to search all lengths.
        """
        return self._sampler.enough

    @property
    def more(self) -> int:
        """Number of directions or samples tried in a second pass.

        The second pass follows if all of a smaller number collide.
        """
        return self._sampler.more

    def at(
        self, position: ArrayLike, *, approach_deg: float | tuple[float, float] | None, count: int, start: FloatArray
    ) -> Candidates:
        """Return configurations with the tool at a position.

        Args:
            position: (3,) in `base_link` [m].
            approach_deg: Approach angle, or an interval (low, high) [deg]; None for all.
            count: Approximate number of configurations, or of tool directions.
            start: (dof,) start configuration.

        Raises:
            HplanError: As `hplan.kinematics.tool_at_point.tool_at_point`.
        """
        return self._sampler.at_point(
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
        """Return at most `count` configurations, the quickest to reach.

        All of a sampler that does not sort them.
        """
        if not self._sampler.is_sorted or len(found.approach) <= count:
            return found
        return Candidates(frozen(found.configurations[:count]), frozen(found.approach[:count]))

    def approaches(self, goals: FloatArray, length: float) -> Approaches:
        """Return straight approaches of a length [m] to (k, dof) goals."""
        lines = lines_back(self._robot, goals, length, locked=self._locked, keeps_turn=self._keeps_turn)
        steps = len(lines.distances) - 1
        return Approaches(lines.reached > steps, lines.rows[:, [0, *(round(look * steps) for look in _LOOKS)]])

    def path(self, goal: FloatArray, standoff: float) -> StraightLine:
        """Return the straight approach from a stand-off [m] to a (dof,) goal."""
        return StraightLine(self._robot, goal, standoff, self._locked, self._keeps_turn)

    def largest_standoff(self, goal: FloatArray, longest: float) -> float:
        """Maximum length of a straight approach, up to `longest` [m]."""
        lines = lines_back(self._robot, goal[None], longest, locked=self._locked, keeps_turn=self._keeps_turn)
        return float(lines.distances[lines.reached[0] - 1])

    def thickness(self, deviation: float) -> float:
        """Extent of the tool beyond its frame, tracking error included [m].

        It is measured along the tool axis.

        Args:
            deviation: Tracking error of every joint [rad].
        """
        robot = self._robot
        frame = robot.model.frames[robot.frame_number(robot.tool_frame)].placement
        ahead = [0.0]
        for body, row in zip(collision_bodies(robot), reach_of_bodies(robot), strict=True):
            if body.joint == robot.tool_joint - 1:
                along = (body.core - frame.translation) @ (frame.rotation @ robot.tool_axis)
                ahead.append(float(along.max()) + body.rounding + deviation * float(row.sum()))
        return max(ahead)
