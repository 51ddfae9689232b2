r"""Other timings of a motion, on its path: stops at any instant, and speed factors while it runs.

The motion :math:`q(\tau)` is run by a clock of its own, :math:`\tau(s)`. The points :math:`C(\tau_j)` that lie a period
:math:`h` apart on the new clock are the control points of a uniform cubic B-spline whose knots are the new rows, as in
`hplan.trajectory.retime`: accelerations and velocities of the rows are differences of the points, so limits that hold
for the differences hold at all times, and the acceleration is continuous. From row to row the step of the clock,
:math:`\tau_{j+1} - \tau_j`, is the one nearest to what is wanted at which velocity, acceleration, jerk and torque keep
their limits. A motion slowed down evenly keeps every limit that it keeps at full speed, so there is such a step; where
jerk limits of several joints contradict one another, what was wanted before is taken back a little.

**Seam.** :math:`C = q + e`. Where the new timing begins, the first three points are those that give the motion's own
position, velocity and acceleration there; :math:`e`, about :math:`-h^2 \ddot q / 6`, is faded out from there on.

**Off the path.** A row is a mean of points of the path with weights of the variance :math:`\sigma^2 \le u^2 / 3`,
:math:`u` the largest of their steps, so each joint is off it by at most :math:`|e| + u^2 \max |\ddot q| / 6`, at all
times. Rows are made as dense as brings the arm to within `OFF_PATH`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hplan.base.arguments import instance, number
from hplan.base.arrays import FloatArray, Record
from hplan.base.units import joint_unit
from hplan.collision.reach import largest_sway
from hplan.errors import OptionError, TimingError
from hplan.robot.model import Robot
from hplan.trajectory.speed_factors import Profile, check_factors, speed_factors
from hplan.trajectory.speed_profile import MOST_ROWS
from hplan.trajectory.time_steps import FADED, Clocks, Kept, run_clock
from hplan.trajectory.trajectory import Trajectory, check_joints, cubic_pieces, joined

#: How far the arm may leave the path [m], and how often rows may be made twice as dense for it.
OFF_PATH, DENSER = 1e-4, 8

#: By so little a joint that comes to its limit may pass it [rad].
AT_LIMIT = 2e-7

#: By so much of a limit rows may pass it where the motion itself does not, and at most unless it does: of velocity,
#: acceleration and torque; and of jerk.
SPARE, MOST_SPARE, SPARE_JERK = 7e-4, 9.5e-4, 0.03

#: Speed and acceleration at the last row of a motion that still count as rest [rad/s], [rad/s^2].
REST = 1e-6

#: A row so little before a time is at it [s].
SAME_TIME = 1e-9

#: Longest motion that a profile may lead to [s].
LONGEST_S = 3600.0


@dataclass(frozen=True, eq=False)
class Retimed(Record):
    """A motion on the path of another one.

    Attributes:
        trajectory: The motion, on the same clock as the other one up to where they part.
        row: The row at which they part.
        clock: (samples,) for each row the time at which the other motion is there [s].
        off_path: (dof,) bound of how far each joint is off the path at any time [rad].
        off_path_m: Bound of how far the arm is off it [m].
    """

    trajectory: Trajectory
    row: int
    clock: FloatArray
    off_path: FloatArray
    off_path_m: float


def stopped(trajectory: Trajectory, t: float, robot: Robot) -> Retimed:
    """The motion with the quickest stop on its path from the first row at or after a time on.

    Where the motion itself comes to rest as early, that is the stop.

    Args:
        trajectory: The motion; its joints are the robot's.
        t: The time, within the motion [s].
        robot: The arm, for its limits.

    Raises:
        OptionError: A time before the motion or after it.
        InputError: A motion of other joints.
        TimingError: The motion neither ends at rest, nor was a stop found.
    """
    _check_kinds(trajectory, robot)
    number(
        "t", t, f"a time between 0 and the motion's end at {trajectory.duration:.6g} s",
        lambda value: 0.0 <= value <= trajectory.duration,
    )  # fmt: skip
    row = int(np.searchsorted(trajectory.time, t - SAME_TIME))
    if _is_at_rest(trajectory, row):
        return _cut(trajectory, row, robot)
    rests, found = _is_at_rest(trajectory, -1), None
    if row < trajectory.samples - 1:
        found = _retimed(trajectory, robot, row, np.zeros_like, final_s=0.0)
    if found is not None and (not rests or found.trajectory.duration < trajectory.duration):
        return found
    if rests:
        return _cut(trajectory, trajectory.samples - 1, robot)
    raise TimingError("no stop within the limits was found, and the motion does not end at rest", cause="no stop")


def scaled(trajectory: Trajectory, profile: Profile, robot: Robot) -> Retimed:
    """The motion at other speeds, on its path.

    Factors are followed as closely as limits allow: what they ask for at once is reached over a ramp. A pause is a
    factor of 0; where the last factor of rows is 0, the motion ends at rest when it gets there.

    Args:
        trajectory: The motion; its joints are the robot's.
        profile: Fraction of the motion's own speed over the time of the new motion: a number, (n, 2) rows of time [s]
            and factor, linear in between and constant after the last one (at a time given twice it steps), or a
            function of the time [s]. More than 1 is taken where the whole motion has room for it.
        robot: The arm, for its limits.

    Raises:
        OptionError: A factor that is negative, not finite or beyond what limits allow; times that decrease or are
            negative; factors with which the motion does not end.
        InputError: A motion of other joints.
        TimingError: No motion within the limits was found.
    """
    _check_kinds(trajectory, robot)
    factors, last_s, last = speed_factors(profile)
    if trajectory.samples == 1:
        return _cut(trajectory, 0, robot)
    own = factors(trajectory.time)
    differs = np.flatnonzero((own[:-1] != 1.0) | (own[1:] != 1.0))
    if len(differs) == 0:
        return _cut(trajectory, trajectory.samples - 1, robot)
    row = int(differs[0])
    check_factors(trajectory, robot, float(own.max()))
    begin = float(trajectory.time[row])

    def wanted(clock: FloatArray) -> FloatArray:
        values = factors(begin + clock)
        if values.max(initial=0.0) > 1.0:
            check_factors(trajectory, robot, float(values.max()))
        return values

    final = last_s - begin if last == 0.0 else math.inf
    found = _retimed(trajectory, robot, row, wanted, final_s=final)
    if found is None and not _is_at_rest(trajectory, -1):
        velocity, acceleration = trajectory.velocity[-1], trajectory.acceleration[-1]
        joint = int((np.abs(velocity) if velocity.any() else np.abs(acceleration)).argmax())
        unit = joint_unit(robot.slides[joint])
        raise TimingError(
            f"the motion ends with joint {robot.joint_names[joint]!r} at {abs(velocity[joint]):.3g} {unit.velocity} "
            f"with an acceleration of {abs(acceleration[joint]):.3g} {unit.acceleration}: at other speeds it would end "
            "otherwise; only one that ends without either can be run so",
            joint=robot.joint_names[joint],
            cause="not at rest at the end",
        )
    if found is None:
        raise TimingError("no motion at these speed factors keeps the limits", cause="speed factors")
    return found


def _check_kinds(trajectory: Trajectory, robot: Robot) -> None:
    """Refuse what is no trajectory of a robot."""
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    instance("robot", robot, Robot, "load_robot")
    check_joints(trajectory, robot)


def _cut(trajectory: Trajectory, row: int, robot: Robot) -> Retimed:
    """The motion up to a row at which it is at rest."""
    kept = trajectory if row == trajectory.samples - 1 else trajectory.until(row)
    return Retimed(kept, row, kept.time, np.zeros(robot.dof), 0.0)


def _is_at_rest(trajectory: Trajectory, row: int) -> bool:
    """True without speed and acceleration at a row."""
    return float(max(np.abs(trajectory.velocity[row]).max(), np.abs(trajectory.acceleration[row]).max())) <= REST


def _period(trajectory: Trajectory, row: int) -> float:
    """Time to the next row [s]."""
    row = min(row, trajectory.samples - 2)
    return float(trajectory.time[row + 1] - trajectory.time[row])


def _retimed(
    trajectory: Trajectory,
    robot: Robot,
    row: int,
    wanted: Callable[[FloatArray], FloatArray],
    *,
    final_s: float,
) -> Retimed | None:
    """The motion at other speeds from a row on, its rows as dense as keeps it on the path; None where none is found.

    Args:
        trajectory: The motion.
        robot: The arm.
        row: Where the new timing begins.
        wanted: (n,) times since then -> (n,) speed factors.
        final_s: From this time after the row on the motion is at its end as soon as it is at rest.
    """
    rest = trajectory.since(row)
    period = _period(rest, 0)
    for halving in range(DENSER):
        found = _with_period(rest, robot, period * 0.5**halving, wanted, final_s)
        q = rest.position if found is None else found.trajectory.position
        within = (q >= np.minimum(robot.lower, rest.position.min(axis=0)) - AT_LIMIT).all() and (
            q <= np.maximum(robot.upper, rest.position.max(axis=0)) + AT_LIMIT
        ).all()
        if found is not None and found.off_path_m <= OFF_PATH and within:
            before = trajectory.until(row)
            whole = joined([before, found.trajectory]) if row > 0 else found.trajectory
            clock = np.concatenate([before.time[:-1], trajectory.time[row] + found.clock])
            return Retimed(whole, row, clock, found.off_path, found.off_path_m)
    return None


def _with_period(
    rest: Trajectory, robot: Robot, period: float, wanted: Callable[[FloatArray], FloatArray], final_s: float
) -> Retimed | None:
    """The motion at other speeds, with rows a period apart, from its first row on; None where no timing is found."""
    begins_at_rest = _is_at_rest(rest, 0)
    limits = _kept(rest, robot, period)
    rows = int((2.0 if final_s == 0.0 else 4.0) * rest.duration / period) + 64
    while True:
        if rows > MOST_ROWS or rows * period > LONGEST_S:
            raise OptionError(
                "profile", "a function", f"factors with which a motion of {rest.duration:.4g} s at full speed ends "
                f"within {LONGEST_S:g} s and {MOST_ROWS:,} rows; after {0.5 * rows * period:.4g} s this one has not",
            )  # fmt: skip
        factors = wanted(np.arange(rows, dtype=np.float64) * period)
        begin = _Begin.of(rest, period, float(factors[0]) if begins_at_rest else 1.0)
        clocks = Clocks(*_pieces(rest), begin.points, begin.clock, begin.fade, factors)
        final = rows if not math.isfinite(final_s) else math.ceil(final_s / period)
        outcome, count, clock, points = run_clock(clocks, limits, period, final)
        if outcome == 2:
            return None
        if outcome == 0:
            break
        rows *= 2
    if clock[count - 1] > rest.duration and not _is_at_rest(rest, -1):
        return None
    return _with_rows(rest, robot, period, clock[:count], points[:count])


class _Begin(NamedTuple):
    """The first points of a new timing.

    Attributes:
        points: (3, dof) control points.
        clock: (3,) their times on the motion's own clock [s].
        fade: (3, dof) the offset from the path at the last of them, its derivative by the time [rad/s], and, in the
            first column of the last row, how long it is faded out [s].
    """

    points: FloatArray
    clock: FloatArray
    fade: FloatArray

    @classmethod
    def of(cls, rest: Trajectory, period: float, factor: float) -> _Begin:
        """From the state at a motion's first row; the factor is that of its speed, 1 where it is in motion there."""
        q, v, a = rest.position[0], rest.velocity[0], rest.acceleration[0]
        middle = q - period**2 / 6.0 * a
        points = np.stack(
            [middle - period * v + 0.5 * period**2 * a, middle, middle + period * v + 0.5 * period**2 * a]
        )
        clock = np.array([-1.0, 0.0, 1.0]) * (period * factor)
        fade = np.zeros((3, rest.position.shape[1]))
        if factor > 0.0 and (v.any() or a.any()):
            fade[0] = points[2] - rest.positions(clock[2:])[0]
            fade[1] = (fade[0] - (points[1] - q)) / period
        else:
            points[:] = q
            clock[:] = np.minimum(clock, 0.0)
        fade[2, 0] = min(FADED * period, rest.duration - clock[2])
        return cls(points, clock, fade)


def _pieces(rest: Trajectory) -> tuple[FloatArray, FloatArray]:
    """The motion's cubics and the times of its rows."""
    return np.ascontiguousarray(cubic_pieces(rest)[0]), np.array(rest.time)


def _kept(rest: Trajectory, robot: Robot, period: float) -> Kept:
    """The limits that a new timing keeps: the robot's, or what the motion itself uses where that is more."""
    bezier, duration = cubic_pieces(rest)
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    own = np.maximum(np.abs(bent).max(axis=(0, 1)), np.abs(rest.acceleration).max(axis=0))
    acceleration = _allowed(robot.acceleration_limit, own)
    velocity = _allowed(robot.velocity_limit, np.abs(rest.velocity).max(axis=0))
    torque = _allowed(robot.torque_limit, np.abs(rest.torque).max(axis=0))
    jerk = np.full(robot.dof, np.inf)
    if robot.jerk_limit is not None:
        # Where the acceleration jumps from one cubic to the next it changes within a period.
        jumps = np.abs(bent[1:, 0] - bent[:-1, 1]).max(axis=0, initial=0.0)
        own = (np.abs(bent[:, 1] - bent[:, 0]) / duration[:, None]).max(axis=0)
        # A jump of the acceleration so small is none [rad/s^2].
        smooth = 1e-4
        jerk = np.maximum(robot.jerk_limit, own + np.where(jumps > smooth, jumps, 0.0) / period) * (1.0 + SPARE_JERK)
    dynamics = robot.dynamics
    bodies = np.zeros((0, 1, 1)) if dynamics.bodies is None else dynamics.bodies
    steps = np.stack([velocity * period, acceleration * period**2, jerk * period**3])
    return Kept(steps, torque, bodies, np.array(dynamics.model.gravity.linear))


def _allowed(limit: FloatArray, own: FloatArray) -> FloatArray:
    """(dof,) what may be used of limits: a little more than the motion itself uses, if that stays within `MOST_SPARE`.

    So a stop of a motion that is a stop already keeps its limits too.
    """
    most = np.maximum(own, limit * (1.0 + MOST_SPARE))
    return np.maximum(limit * (1.0 + SPARE), np.minimum(own * (1.0 + SPARE), most))


def _with_rows(rest: Trajectory, robot: Robot, period: float, clock: FloatArray, points: FloatArray) -> Retimed:
    """The motion with control points, and how far it is off the path."""
    count = len(points) - 2
    change = np.diff(points, axis=0)
    position = (points[:-2] + 4.0 * points[1:-1] + points[2:]) / 6.0
    velocity = (change[1:] + change[:-1]) / (2.0 * period)
    acceleration = np.diff(change, axis=0) / period**2
    position[0], velocity[0], acceleration[0] = rest.position[0], rest.velocity[0], rest.acceleration[0]
    position[-1], velocity[-1], acceleration[-1] = points[-1], 0.0, 0.0
    torque = robot.dynamics.torques(position, velocity, acceleration)
    torque[0] = rest.torque[0]
    time = np.arange(count, dtype=np.float64) * period
    trajectory = Trajectory(rest.joint_names, time, position, velocity, acceleration, torque, robot.slides)
    on_path = rest.positions(np.clip(clock, 0.0, None))
    on_path += np.minimum(clock, 0.0)[:, None] * rest.velocity[0]  # before the seam, where the path goes on backwards
    # Of the path itself: the column of accelerations may say anything.
    bezier, duration = cubic_pieces(rest)
    largest = np.abs(6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2).max(axis=(0, 1))
    step = float(np.diff(clock).max())
    off = np.abs(points - on_path)[1:].max(axis=0) + step**2 / 6.0 * largest
    return Retimed(trajectory, 0, np.clip(clock[1:-1], 0.0, rest.duration), off, float(largest_sway(robot, off)))
