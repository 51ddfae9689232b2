r"""Retimes a motion on its path: stops and speed factors.

Stops may start at any instant; speed factors may change while the motion runs.

The motion :math:`q(\tau)` is driven by a clock of its own, :math:`\tau(s)`. The points :math:`C(\tau_j)` that lie a
period :math:`h` apart on the new clock are the control points of a uniform cubic B-spline whose knots are the new
samples, as in `hplan.trajectory.cubics`: accelerations and velocities of the samples are differences of the points, so
limits that hold for the differences hold at all times, and the acceleration is continuous. From sample to sample the
step of the clock, :math:`\tau_{j+1} - \tau_j`, is the one nearest to the requested step that satisfies the velocity,
acceleration, jerk and torque limits. A motion slowed down uniformly satisfies every limit that it satisfies at full
speed, so such a step exists. If the jerk limits of several joints contradict one another, earlier requested steps are
reduced slightly.

**Seam.** :math:`C = q + e`. At the start of the new timing, the first three points reproduce the motion's own position,
velocity and acceleration; :math:`e`, about :math:`-h^2 \ddot q / 6`, is then faded out.

**Off the path.** A sample is a mean of points of the path with weights of the variance :math:`\sigma^2 \le u^2 / 3`,
:math:`u` the maximum of their steps, so each joint is off it by at most :math:`|e| + u^2 \max |\ddot q| / 6`, at all
times. Sampling is refined until the arm stays within `OFF_PATH`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base.arguments import is_number, number
from hplan.base.arrays import FloatArray, numbers
from hplan.collision.motion_coefficients import largest_sway
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.cubics import Rows, accelerations, evaluate, joined_rows, points_of, sample_spline
from hplan.trajectory.speed_profile import MOST_ROWS
from hplan.trajectory.time_steps import FADED, Clocks, Kept, run_clock

#: Speed factors over time: a number, (n, 2) rows of time and factor, or a function of the time.
Profile: TypeAlias = "float | Sequence[tuple[float, float]] | FloatArray | Callable[[float], float]"

#: Maximum displacement of the arm off the path [m], and how often the sampling rate may be doubled for it.
OFF_PATH, _DENSER = 1e-4, 8

#: A joint that reaches its limit may exceed it by this distance [rad].
LIMIT_TOLERANCE = 2e-7

#: Tolerances, as fractions: samples may exceed limits of velocity, acceleration and torque by the first, or by up to
#: the second if the motion itself exceeds them; jerk limits by the third. A larger excess of the motion itself is
#: permitted, but not increased.
SPARE, _MOST_SPARE, _SPARE_JERK = 7e-4, 9.5e-4, 0.03

#: Maximum duration of a retimed motion [s].
_LONGEST_S = 3600.0


def rescale(
    motion: Rows, robot: Robot, row: int, wanted: Callable[[FloatArray], FloatArray], *, final_s: float
) -> tuple[Rows, FloatArray, FloatArray, float] | None:
    """Retime a motion from a sample on.

    Sampling is refined until the motion stays on its path.

    Args:
        motion: The motion.
        robot: The arm, for its limits.
        row: Index of the first sample of the new timing.
        wanted: (n,) times since that sample -> (n,) speed factors.
        final_s: Later than this after that sample, the motion ends as soon as it is at rest [s].

    Returns:
        None if no timing is found. Otherwise the motion; for each sample its time in the original motion [s]; and upper
        bounds on the displacement of each joint (dof,) [rad] and of the arm [m] off the path.

    Raises:
        OptionError: The motion does not end with these factors.
    """
    rest = _Rest.build(motion.cut_before(row))
    period, path = float(rest.rows.time[1]), rest.rows.position
    for halving in range(_DENSER):
        found = _with_period(rest, robot, period * 0.5**halving, wanted, final_s)
        if found is None:
            continue
        q, off_m = found[0].position, float(largest_sway(robot, found[2]))
        within = (q >= np.minimum(robot.lower, path.min(axis=0)) - LIMIT_TOLERANCE).all() and (
            q <= np.maximum(robot.upper, path.max(axis=0)) + LIMIT_TOLERANCE
        ).all()
        if off_m <= OFF_PATH and within:
            clock = np.concatenate([motion.time[:row], motion.time[row] + found[1]])
            return joined_rows([motion.cut_after(row), found[0]]), clock, found[2], off_m
    return None


class _Rest(NamedTuple):
    """A motion from the first sample of the new timing on.

    Attributes:
        rows: Its samples.
        bezier: (pieces, 4, dof) its cubics.
        duration: (pieces,) their durations [s].
        bent: (pieces, 2, dof) their accelerations at both ends [rad/s^2].
    """

    rows: Rows
    bezier: FloatArray
    duration: FloatArray
    bent: FloatArray

    @classmethod
    def build(cls, rows: Rows) -> _Rest:
        """Build it from its samples."""
        bezier, duration = rows.pieces
        return cls(rows, bezier, duration, accelerations(bezier, duration))

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times; clamped to the motion's ends."""
        return evaluate(self.bezier, self.rows.time, clock)


def _with_period(
    rest: _Rest, robot: Robot, period: float, wanted: Callable[[FloatArray], FloatArray], final_s: float
) -> tuple[Rows, FloatArray, FloatArray] | None:
    """Retime a motion at a fixed sampling period; None if not found."""
    limits, duration_s, rests = _keep_or_repair(rest, robot, period), rest.rows.duration, rest.rows.is_at_rest
    rows = int((2.0 if final_s == 0.0 else 4.0) * duration_s / period) + 64
    while True:
        if rows > MOST_ROWS or rows * period > _LONGEST_S:
            raise OptionError(
                "profile", "a function", f"factors with which a motion of {duration_s:.4g} s at full speed ends "
                f"within {_LONGEST_S:g} s and {MOST_ROWS:,} samples; after {0.5 * rows * period:.4g} s it has not",
            )  # fmt: skip
        factors = wanted(np.arange(rows, dtype=np.float64) * period)
        begin = _Begin.build(rest, period, float(factors[0]) if rests(0) else 1.0)
        clocks = Clocks(rest.bezier, np.array(rest.rows.time), begin.points, begin.clock, begin.fade, factors)
        final = rows if not math.isfinite(final_s) else math.ceil(final_s / period)
        outcome, count, clock, points = run_clock(clocks, limits, period, final)
        if outcome == 2:
            return None
        if outcome == 0:
            break
        rows *= 2
    if clock[count - 1] > duration_s and not rests(-1):
        return None
    return _with_rows(rest, robot, period, clock[:count], points[:count])


class _Begin(NamedTuple):
    """First control points of a new timing.

    Attributes:
        points: (3, dof) control points.
        clock: (3,) their times on the motion's own clock [s].
        fade: (3, dof) the offset from the path at the last of them, its derivative with respect to time [rad/s], and,
            in the first column of the last row, the fading time [s].
    """

    points: FloatArray
    clock: FloatArray
    fade: FloatArray

    @classmethod
    def build(cls, rest: _Rest, period: float, factor: float) -> _Begin:
        """Start from the state at a motion's first sample.

        Args:
            rest: The motion from that sample on.
            period: Time between samples [s].
            factor: Initial speed factor; 1 if the motion is not at rest there.
        """
        _, q, v, a = (values[0] for values in rest.rows[:4])
        points = points_of(q, v, a, period)
        clock = np.array([-1.0, 0.0, 1.0]) * (period * factor)
        fade = np.zeros((3, len(q)))
        if factor > 0.0 and (v.any() or a.any()):
            fade[0] = points[2] - rest.positions(clock[2:])[0]
            fade[1] = (fade[0] - (points[1] - q)) / period
        else:
            points[:] = q
            clock[:] = np.minimum(clock, 0.0)
        fade[2, 0] = min(FADED * period, rest.rows.duration - clock[2])
        return cls(points, clock, fade)


def _keep_or_repair(rest: _Rest, robot: Robot, period: float) -> Kept:
    """Limits of a new timing: the robot's, or the motion's if higher."""
    _, _, velocity, acceleration, torque = rest.rows
    bent, duration = rest.bent, rest.duration
    own = np.maximum(np.abs(bent).max(axis=(0, 1)), np.abs(acceleration).max(axis=0))
    acceleration = _usable_limits(robot.acceleration_limit, own)
    velocity = _usable_limits(robot.velocity_limit, np.abs(velocity).max(axis=0))
    torque = _usable_limits(robot.torque_limit, np.abs(torque).max(axis=0))
    jerk = np.full(robot.dof, np.inf)
    if robot.jerk_limit is not None:
        # A jump of the acceleration from one cubic to the next takes one period.
        jumps = np.abs(bent[1:, 0] - bent[:-1, 1]).max(axis=0, initial=0.0)
        own = (np.abs(bent[:, 1] - bent[:, 0]) / duration[:, None]).max(axis=0)
        # Smaller jumps of the acceleration are ignored [rad/s^2].
        smooth = 1e-4
        jerk = np.maximum(robot.jerk_limit, own + np.where(jumps > smooth, jumps, 0.0) / period) * (1.0 + _SPARE_JERK)
    dynamics = robot.dynamics
    bodies = np.zeros((0, 1, 1)) if dynamics.bodies is None else dynamics.bodies
    steps = np.stack([velocity * period, acceleration * period**2, jerk * period**3])
    return Kept(steps, torque, bodies, np.array(dynamics.model.gravity.linear))


def _usable_limits(limit: FloatArray, own: FloatArray) -> FloatArray:
    """(dof,) usable limits: slightly above the motion's own use, within `_MOST_SPARE`.

    A stop of a motion that is already a stop therefore satisfies its limits, too.
    """
    most = np.maximum(own, limit * (1.0 + _MOST_SPARE))
    return np.maximum(limit * (1.0 + SPARE), np.minimum(own * (1.0 + SPARE), most))


def _with_rows(
    rest: _Rest, robot: Robot, period: float, clock: FloatArray, points: FloatArray
) -> tuple[Rows, FloatArray, FloatArray]:
    """Motion with given control points, original times, joint displacements off path."""
    states = sample_spline(points, period)
    ends = zip(states, rest.rows[1:4], (points[-1], 0.0, 0.0), strict=True)
    for values, first, last in ends:
        values[0], values[-1] = first[0], last
    torque = robot.dynamics.torques(*states)
    torque[0] = rest.rows.torque[0]
    rows = Rows(np.arange(len(torque), dtype=np.float64) * period, *states, torque)
    on_path = rest.positions(np.clip(clock, 0.0, None))
    on_path += np.minimum(clock, 0.0)[:, None] * rest.rows.velocity[0]  # before the seam the path is extended backwards
    # From the path itself: the column of accelerations need not agree with it.
    largest = np.abs(rest.bent).max(axis=(0, 1))
    step = float(np.diff(clock).max())
    off = np.abs(points - on_path)[1:].max(axis=0) + step**2 / 6.0 * largest
    return rows, np.clip(clock[1:-1], 0.0, rest.rows.duration), off


def speed_factors(profile: Profile) -> tuple[Callable[[FloatArray], FloatArray], float, float]:
    """Convert a profile to a function of (n,) times.

    Returns:
        The function; the time and the factor of the profile's last row; infinite and NaN without rows.

    Raises:
        OptionError: `profile` is not a positive factor, a nonempty (n, 2) array with nonnegative, nondecreasing times,
            or a function; or a factor is negative or not finite.

    Examples:
        >>> factors, end_s, last = speed_factors([(0.0, 1.0), (2.0, 0.5)])
        >>> factors(np.array([1.0, 3.0])).tolist(), end_s, last
        ([0.75, 0.5], 2.0, 0.5)
    """
    expected = "a factor >= 0, (n, 2) rows of time and factor >= 0, or a function of time that returns a factor"
    if is_number(profile):
        factor = number("profile", profile, "a factor > 0", lambda value: value > 0.0)
        return lambda clock: np.full(len(clock), factor), math.inf, math.nan
    if callable(profile):
        given = profile

        def called(clock: FloatArray) -> FloatArray:
            values = [given(time) for time in clock.tolist()]
            for time, value in zip(clock.tolist(), values, strict=True):
                if not (is_number(value) and value >= 0.0):
                    raise OptionError(f"profile({time:g})", value, "a finite factor >= 0")
            return np.array(values, dtype=np.float64)

        return called, math.inf, math.nan
    try:
        rows = numbers("profile", profile, (None, 2))
    except InputError as error:
        raise OptionError("profile", profile, expected) from error
    if len(rows) == 0 or not (np.diff(rows[:, 0]) >= 0.0).all() or (rows < 0.0).any():
        raise OptionError("profile", profile, f"{expected}; times must not decrease")
    return lambda clock: np.interp(clock, *rows.T), float(rows[-1, 0]), float(rows[-1, 1])


def check_factors(motion: Rows, robot: Robot, factor: float) -> None:
    """Check that limits permit a factor above 1 for the whole motion.

    Raises:
        OptionError: The factor exceeds a limit; names the joint and its limit.
    """
    if factor <= 1.0:
        return
    gravity = robot.dynamics.gravity(motion.position)
    moved = motion.torque - gravity
    with np.errstate(divide="ignore", invalid="ignore"):
        most = {
            "velocity": robot.velocity_limit / np.abs(motion.velocity).max(axis=0),
            "acceleration": np.sqrt(robot.acceleration_limit / np.abs(motion.acceleration).max(axis=0)),
            "torque": np.sqrt(
                np.where(moved != 0.0, (robot.torque_limit - np.sign(moved) * gravity) / np.abs(moved), np.inf)
                .clip(min=0.0)
                .min(axis=0)
            ),
        }
    if robot.jerk_limit is not None:
        jerk = np.abs(np.diff(motion.acceleration, axis=0) / np.diff(motion.time)[:, None]).max(axis=0)
        with np.errstate(divide="ignore"):
            most["jerk"] = np.cbrt(robot.jerk_limit / jerk)
    what = min(most, key=lambda name: float(most[name].min()))
    joint = int(most[what].argmin())
    allowed = max(1.0, float(most[what][joint]))
    if factor > allowed * (1.0 + 1e-9):
        raise OptionError(
            "profile", factor,
            f"factors up to {allowed:.4g}: joint {robot.joint_names[joint]!r} reaches its {what} limit",
        )  # fmt: skip
