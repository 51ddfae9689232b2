"""Straight tool lines: along the tool axis, or to a pose.

The tool is drawn back from the goal along its axis (`Robot.tool_axis`) in short steps
(`hplan.kinematics.damped_steps.draw_back`); rotation about the axis is free or fixed. Cubic splines interpolate the
configurations as functions of the distance, with continuous second derivatives. A step that changes a joint by too much
is rejected: the arm is near a singular configuration there, or would switch to another solution branch. A goal that is
itself singular, for example with a straight elbow, is detected by a much shorter first step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.errors import ApproachError
from hplan.geometry.polyline import curve_length
from hplan.kinematics.damped_steps import ABOUT_Z, KEPT, draw_back, follow
from hplan.kinematics.inverse_kinematics import chain_of, with_direction
from hplan.robot.model import Robot

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

#: Maximum step of the tool [m], and minimum number of steps; numbers are multiples of it, so that quarters are whole.
STEP_M, _STEPS = 5e-3, 4

#: Maximum change of a joint per metre of tool motion: revolute [rad/m], prismatic [m/m].
TURNING, _SLIDING = 25.0, 10.0

#: Fraction of the first step that is checked against the same limit, for singular goals.
_AT_GOAL = 1.0 / 64.0


class Lines(NamedTuple):
    """Straight lines of the tool back from several goals.

    Attributes:
        distances: (m,) distances of the tool from the goals, from 0 to the requested one [m].
        rows: (k, m, dof) configurations at these distances; beyond `reached` the last one reached is repeated.
        reached: (k,) number of distances reached.
    """

    distances: FloatArray
    rows: FloatArray
    reached: IntArray


def lines_back(
    robot: Robot, goals: FloatArray, distance: float, *, locked: Sequence[str] = (), keeps_turn: bool = False
) -> Lines:
    """Return straight tool lines back from (k, dof) goals.

    Args:
        goals: (k, dof) configurations within the limits.
        distance: Requested distance [m].
        keeps_turn: Whether rotation of the tool about its axis is fixed.

    Raises:
        InputError: A locked joint does not exist.
    """
    count = _STEPS * math.ceil(distance / (STEP_M * _STEPS))
    distances: FloatArray = distance * np.arange(count + 1) / count
    chain = with_direction(chain_of(robot, np.eye(4), KEPT if keeps_turn else ABOUT_Z), robot.tool_axis)
    chain.moves[robot.locked_mask(locked)] = 0.0
    most = np.diff(distances, prepend=0.0)[:, None] * np.where(robot.slides, _SLIDING, TURNING)
    ends, rows = np.array(goals, dtype=np.float64), np.empty((len(goals), count + 1, robot.dof))
    begun, reached = np.zeros((2, len(goals)), dtype=np.int64)
    draw_back(ends, _AT_GOAL * distances[:2], _AT_GOAL * most[:2], chain, rows[:, :2].copy(), begun)
    draw_back(ends, distances, most, chain, rows, reached)
    stays = begun < 2
    rows[stays], reached[stays] = ends[stays, None], 1
    return Lines(distances, rows, reached)


def line_to(
    robot: Robot, start: FloatArray, pose: FloatArray, towards: FloatArray | None = None, *, locked: Sequence[str] = ()
) -> tuple[FloatArray, float]:
    """Return configurations along the straight tool line to a pose.

    The orientation changes evenly along the line.

    Args:
        start: (dof,) configuration within the limits.
        pose: (4, 4) homogeneous matrix in `base_link`.
        towards: (dof,) configuration that a redundant arm moves towards; None for minimum joint motion.

    Returns:
        (m, dof) closely spaced configurations, m >= 2, up to the last one reached; and the fraction of the line.
    """
    here = robot.forward_kinematics(start)
    shift, turn = pose[:3, 3] - here[:3, 3], pin.log3(here[:3, :3].T @ pose[:3, :3])
    # Maximum step of a rotating tool [rad]; equivalent to `STEP_M`.
    steps = max(_STEPS, math.ceil(np.linalg.norm(shift) / STEP_M), math.ceil(np.linalg.norm(turn) / 0.03))
    on_line = [
        (here[:3, :3] @ pin.exp3(part * turn), here[:3, 3] + part * shift) for part in np.arange(steps + 1) / steps
    ]
    poses = np.array([np.append(rotation.ravel(), place) for rotation, place in on_line])
    poses[-1] = np.append(pose[:3, :3].ravel(), pose[:3, 3])
    chain = chain_of(robot, pose, KEPT)
    # Lines to a pose keep this distance from the joint limits, or the start's if smaller, because an interpolating
    # curve may overshoot a little [rad, m].
    off_limits = 2e-3
    chain.lower[:] = np.minimum(robot.lower + off_limits, start)
    chain.upper[:] = np.maximum(robot.upper - off_limits, start)
    chain.moves[robot.locked_mask(locked)] = 0.0
    most = np.full((steps + 1, 1), STEP_M) * np.where(robot.slides, _SLIDING, TURNING)
    rows = np.repeat(start[None], steps + 1, axis=0)
    ends = np.array(start if towards is None else towards)
    reached = follow(poses, most, ends, float(towards is not None), chain, rows)
    return rows[: max(reached, 2)], (reached - 1) / steps


@dataclass(frozen=True, eq=False)
class ToolLine(Record):
    """A straight tool path from the stand-off to the goal.

    The parameter is the tool's distance, scaled to `length`.

    Attributes:
        goal: (dof,) configuration at the goal.
        standoff: Distance of the tool from its goal at the start of the path [m].
        keeps_turn: Whether rotation of the tool about its axis is fixed.
    """

    robot: Robot
    goal: FloatArray
    standoff: float
    locked: tuple[str, ...] = ()
    keeps_turn: bool = False

    @cached_property
    def _lines(self) -> Lines:
        """The sampled line."""
        back = lines_back(self.robot, self.goal[None], self.standoff, locked=self.locked, keeps_turn=self.keeps_turn)
        if back.reached[0] < len(back.distances):
            largest = float(back.distances[back.reached[0] - 1])
            detail = f"the tool can be withdrawn by {largest:.6g} m only"
            raise ApproachError(self.standoff, "line", detail, largest_standoff_m=largest)
        return back

    @cached_property
    def _spline(self) -> CubicSpline:
        """The joint spline over the distance from the goal."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(self._lines.distances, self._lines.rows[0])

    @cached_property
    def length(self) -> float:
        """Joint-space length, by Gauss-Legendre quadrature."""
        return curve_length(lambda t: np.linalg.norm(self._spline(t, 1), axis=-1), self._lines.distances)

    @property
    def end(self) -> float:
        """Last parameter; the first is 0."""
        return self.length

    @cached_property
    def breaks(self) -> FloatArray:
        """Increasing parameters of the spline's breakpoints, both ends included."""
        breaks = self.end * (1.0 - self._lines.distances[::-1] / self.standoff)
        breaks[-1] = self.end
        return frozen(breaks)

    def evaluate(self, s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Return points or derivatives with respect to the parameter.

        Args:
            s: (...) parameters in [0, end]; clipped to it.
            derivative: 0, 1 or 2.

        Returns:
            (..., dof) values.
        """
        fraction = np.clip(np.asarray(s, dtype=np.float64) / self.end, 0.0, 1.0)
        distance, rate = self.standoff * (1.0 - fraction), -self.standoff / self.end
        values: FloatArray = self._spline(distance, derivative)
        if derivative > 0:
            return values * rate**derivative + 0.0  # avoids negative zeros
        # Clip rounding errors, and overshoot of the spline beyond a limit.
        q = np.minimum(np.maximum(values, self.robot.lower), self.robot.upper)
        q[distance == self.standoff], q[distance == 0.0] = self._lines.rows[0, -1], self.goal
        return q
