"""Quickest stop of each joint on its own, leaving the path.

The control points of the motion's uniform cubic B-spline (`hplan.trajectory.cubics`) start with the three that define
the state. Each next one changes the joint's step towards rest as far as the limits of second and third differences
permit; a change that could no longer be reduced to zero in time is not started. The motion therefore continues from the
state without a jump, up to the acceleration, and satisfies the velocity, acceleration and jerk limits at all times. It
leaves the path of the arm.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.robot.model import Robot
from hplan.trajectory.cubics import points_of, sample_spline
from hplan.trajectory.trajectory import Trajectory


def braking(
    robot: Robot,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    period: float,
    push: FloatArray,
    *,
    desired: FloatArray | None = None,
) -> Trajectory | None:
    """Quickest stop of each joint; None if it takes too many samples.

    Args:
        robot: The arm, for its jerk limits and its dynamics.
        position: (dof,) current position [rad].
        velocity: (dof,) current velocity [rad/s].
        acceleration: (dof,) current acceleration [rad/s^2].
        period: Time between samples [s].
        push: (dof,) maximum accelerations [rad/s^2].
        desired: (dof,) velocity that the joints approach in the first period, before they stop; None to stop at once.
    """
    most = np.maximum(push, np.abs(acceleration)) * period**2
    jerk = np.full(robot.dof, np.inf) if robot.jerk_limit is None else robot.jerk_limit * period**3
    points = list(points_of(position, velocity, acceleration, period))
    change = acceleration * period**2
    step = period * velocity + 0.5 * change
    if desired is not None:
        change = _change(step - period * desired, change, most, jerk)
        step = step + change
        points.append(points[-1] + step)
    while (step != 0.0).any() or (change != 0.0).any():
        # Maximum number of samples of a stop.
        if len(points) > 20_000:
            return None
        change = _change(step, change, most, jerk)
        step = np.where(np.abs(step + change) <= 1e-15, 0.0, step + change)
        points.append(points[-1] + step)
    points += [points[-1]] * (2 if (points[-1] != points[-2]).any() else 1)
    rows = sample_spline(np.array(points), period)
    ends = zip(rows, (position, velocity, acceleration), (points[-1], 0.0, 0.0), strict=True)
    for values, first, last in ends:
        values[0], values[-1] = first, last
    time = np.arange(len(rows[0]), dtype=np.float64) * period
    return Trajectory(robot.joint_names, time, *rows, robot.dynamics.torques(*rows), robot.slides)


def _change(step: FloatArray, change: FloatArray, most: FloatArray, jerk: FloatArray) -> FloatArray:
    """(dof,) changes of the steps from one sample to the next."""
    away = np.abs(step)
    # Jerk used to plan the end of a stop ahead: this fraction of the limit.
    ahead = np.minimum(0.9 * jerk, 1e9)
    still = np.where(away > ahead, 0.5 * (np.sqrt(ahead**2 + 8.0 * ahead * np.minimum(away, 1e9)) - ahead), away)
    wanted = -np.sign(step) * np.minimum(np.where(np.isfinite(jerk), still, away), most)
    allowed: FloatArray = np.clip(wanted, np.maximum(change - jerk, -most), np.minimum(change + jerk, most))
    return allowed
