"""Timed motions from anywhere: common recipes of timing a path, and what fine samples of a motion show.

No recipe here limits the jerk, while hplan does where the robot's limits file asks for it; where that matters hplan
is shown both ways.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.base.polyline import stations
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.smoothing.shortcut import shorten
from hplan.timing.trajectory import Trajectory

#: Spacing of the samples at which motions of recipes are looked at [s].
FINE = 1e-3

#: Excess over a limit that counts as breaking it.
TOLERANCE = 1e-3

#: Numbers of shortcuts after which a polyline is tried with stops at its corners.
SHORTCUTS = (0, 5, 10, 20, 40, 80, 200)

#: Grid points at which toppra chooses the path speed: so many on the whole path, and on each of its segments.
GRID_POINTS, GRID_POINTS_EACH = 300, 10


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion as a function of time: positions at given times, and how long it lasts [s]."""

    duration: float
    positions: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Findings:
    """What fine samples of a motion show.

    Attributes:
        duration_s: How long it lasts.
        depth_mm: Largest depth in an obstacle; 0 without contact.
        outside_deg: Largest excess over a joint limit; 0 within.
        velocity: Largest share of a velocity limit, by differences.
        acceleration: Largest share of an acceleration limit, by second differences.
        torque: Largest share of a torque limit, by inverse dynamics.
    """

    duration_s: float
    depth_mm: float
    outside_deg: float
    velocity: float
    acceleration: float
    torque: float

    @property
    def collides(self) -> bool:
        """True if an obstacle is touched."""
        return self.depth_mm > 0.0

    @property
    def leaves_range(self) -> bool:
        """True if a joint limit is passed."""
        return self.outside_deg > 1e-6

    @property
    def breaks_limits(self) -> bool:
        """True if a velocity, acceleration or torque limit is broken."""
        return max(self.velocity, self.acceleration, self.torque) > 1.0 + TOLERANCE


def look_at(robot: Robot, checker: CoalScene, motion: TimedMotion) -> Findings:
    """Sample a motion every `FINE` seconds and see what it does."""
    count = max(3, int(np.ceil(motion.duration / FINE)) + 1)
    clock = np.linspace(0.0, motion.duration, count)
    h = clock[1]
    q = motion.positions(clock)
    v, a = (q[2:] - q[:-2]) / (2.0 * h), (q[2:] - 2.0 * q[1:-1] + q[:-2]) / h**2
    data = robot.model.createData()
    torque = np.array([pin.rnea(robot.model, data, *row) for row in zip(q[1:-1], v, a, strict=True)])
    touching = q[checker.in_collision(q)]
    depth = max((-float(checker.distances(row).min()) for row in touching), default=0.0)
    return Findings(
        duration_s=motion.duration,
        depth_mm=1e3 * max(0.0, depth),
        outside_deg=float(np.degrees(np.maximum(robot.lower - q, q - robot.upper).max().clip(0.0))),
        velocity=float((np.abs(v) / robot.velocity_limit).max()),
        acceleration=float((np.abs(a) / robot.acceleration_limit).max()),
        torque=float((np.abs(torque) / robot.torque_limit).max()),
    )


def of_rows(trajectory: Trajectory) -> TimedMotion:
    """The motion of a controller that joins the rows of a trajectory by cubics of their positions and velocities."""
    return TimedMotion(
        trajectory.duration, lambda clock: row_cubics(trajectory.time, trajectory.position, trajectory.velocity, clock)
    )


def row_cubics(time: FloatArray, position: FloatArray, velocity: FloatArray, clock: FloatArray) -> FloatArray:
    """Cubic Hermite interpolation of rows at the times of `clock`, (n,) -> (n, dof)."""
    i = np.clip(np.searchsorted(time, clock, side="right") - 1, 0, len(time) - 2)
    h = (time[i + 1] - time[i])[:, None]
    t = (clock - time[i])[:, None] / h
    rise = position[i + 1] - position[i]
    value: FloatArray = (
        position[i]
        + t * h * velocity[i]
        + t * t * (3.0 * rise - h * (2.0 * velocity[i] + velocity[i + 1]))
        + t * t * t * (h * (velocity[i] + velocity[i + 1]) - 2.0 * rise)
    )
    return value


def toppra_motion(robot: Robot, path: FloatArray, *, defaults: bool = False) -> TimedMotion | None:
    """A cubic spline through waypoints, timed by toppra under velocity, acceleration and torque limits.

    Args:
        robot: The arm.
        path: (m, dof) waypoints.
        defaults: As toppra comes: parameters 0 to 1 in equal parts, `ParametrizeSpline`, torque by collocation. Else
            as its users are advised: parameters by length, waypoints among the grid points,
            `ParametrizeConstAccel`, all by interpolation.

    Returns:
        The motion, or None where toppra finds none.
    """
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path = path[np.concatenate([[True], length > 1e-9])]
    station = stations(path)
    spline = toppra.SplineInterpolator(np.linspace(0.0, 1.0, len(path)) if defaults else station, path)
    data = robot.model.createData()

    def inverse_dynamics(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return np.array(pin.rnea(robot.model, data, q, v, a))

    def both(limit: FloatArray) -> FloatArray:
        return np.stack([-limit, limit], axis=1)

    scheme: Any = {} if defaults else {"discretization_scheme": constraint.DiscretizationType.Interpolation}
    constraints = [
        constraint.JointVelocityConstraint(both(robot.velocity_limit)),
        constraint.JointAccelerationConstraint(both(robot.acceleration_limit), **scheme),
        constraint.JointTorqueConstraint(inverse_dynamics, both(robot.torque_limit), np.zeros(robot.dof), **scheme),
    ]
    chosen: Any = {}
    if not defaults:
        share = np.arange(GRID_POINTS_EACH) / GRID_POINTS_EACH
        each = (station[:-1, None] + np.diff(station)[:, None] * share).ravel()
        grid = np.union1d(np.linspace(0.0, station[-1], GRID_POINTS), each)
        grid = grid[np.diff(grid, prepend=-np.inf) > 1e-6 * station[-1]]
        grid[-1] = station[-1]
        chosen = {"parametrizer": "ParametrizeConstAccel", "gridpoints": grid}
    trajectory = algorithm.TOPPRA(constraints, spline, **chosen).compute_trajectory()
    if trajectory is None:
        return None
    return TimedMotion(
        float(trajectory.duration), lambda t: np.asarray(trajectory(np.clip(t, 0.0, trajectory.duration)))
    )


def quickest_polyline(robot: Robot, path: FloatArray, field: ClearanceField, margin: float) -> FloatArray:
    """The shortened path that is quickest with stops at its corners, after more or fewer shortcuts.

    Many shortcuts give the shortest path, but one with many corners; without any it goes from each waypoint to the
    farthest that can be seen.
    """
    polylines = [shorten(path, field, margin=margin, rounds=rounds) for rounds in SHORTCUTS]
    return min(polylines, key=lambda polyline: stopping_duration(robot, polyline))


def stopping_duration(robot: Robot, path: FloatArray) -> float:
    """Duration of straight motions from waypoint to waypoint, at rest at each [s].

    Each is the time-optimal trapezoid under velocity and acceleration limits; torque is not looked at, in favour of
    this recipe.
    """
    total = 0.0
    for turn in np.diff(path, axis=0):
        moves = np.abs(turn) > 1e-12
        if not moves.any():
            continue
        speed = float((robot.velocity_limit[moves] / np.abs(turn[moves])).min())
        pace = float((robot.acceleration_limit[moves] / np.abs(turn[moves])).min())
        total += 2.0 / np.sqrt(pace) if speed * speed >= pace else 1.0 / speed + speed / pace
    return total
