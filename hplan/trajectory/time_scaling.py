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
from typing import TypeAlias

import numpy as np

from hplan.base.arguments import is_number, number
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.collision.motion_coefficients import largest_sway
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot, made_once
from hplan.trajectory.cubics import Rows
from hplan.trajectory.speed_profile import MOST_ROWS
from hplan.trajectory.time_steps import Course, TimingLimits, retime

#: Speed factors over time: a number, (n, 2) rows of time and factor, or a function of the time.
Profile: TypeAlias = "float | Sequence[tuple[float, float]] | FloatArray | Callable[[float], float]"

#: Maximum displacement of the arm off the path [m], and how often the sampling rate may be doubled for it.
OFF_PATH, _DENSER = 1e-4, 8

#: Maximum duration of a retimed motion [s].
_LONGEST_S = 3600.0


def rescale(
    motion: Rows, course: Course, robot: Robot, row: int, wanted: Callable[[FloatArray], FloatArray], *, final_s: float
) -> tuple[Rows, FloatArray, FloatArray, float] | None:
    """Retime a motion from a sample on.

    Sampling is refined until the motion stays on its path.

    Args:
        motion: The motion.
        course: The motion, prepared.
        robot: The arm, for its limits.
        row: Index of the first sample of the new timing, not the last.
        wanted: (n,) times since that sample -> (n,) speed factors.
        final_s: Later than this after that sample, the motion ends as soon as it is at rest [s].

    Returns:
        None if no timing is found. Otherwise the motion; for each sample its time in the original motion [s]; and upper
        bounds on the displacement of each joint (dof,) [rad] and of the arm [m] off the path.

    Raises:
        OptionError: The motion does not end with these factors.
    """
    limits, begin_s = timing_limits(robot), motion.time[row]
    # A moving arm's first step takes a period, so it will be off the path by at least this times the period squared.
    bent = (np.abs(motion.acceleration[row]) + course.largest[5, row]) / 6.0
    least_off = 0.0 if motion.is_at_rest(row) else (1.0 - 1e-9) * float(largest_sway(robot, bent))
    for halving in range(_DENSER):
        period = float(motion.time[row + 1] - begin_s) * 0.5**halving
        if period**2 * least_off > OFF_PATH:
            continue
        found = _with_period(course, row, limits, period, wanted, final_s)
        if found is None:
            continue
        is_within, clock, states, off = found
        off_m = float(largest_sway(robot, off))
        if off_m <= OFF_PATH and is_within:
            torque = robot.dynamics.torques(*states)
            torque[0] = motion.torque[row]
            time = np.arange(len(clock), dtype=np.float64) * period
            # The sample where the motions part is that of the motion itself.
            parts = (time[1:] + begin_s, *(values[1:] for values in (*states, torque)))
            joined = (np.concatenate([old[: row + 1], new]) for old, new in zip(motion, parts, strict=True))
            return Rows(*joined), np.concatenate([motion.time[:row], begin_s + clock]), off, off_m
    return None


@made_once
def timing_limits(robot: Robot) -> TimingLimits:
    """Limits of an arm for new timings."""
    dynamics, endless = robot.dynamics, np.full(robot.dof, np.inf)
    jerk = endless if robot.jerk_limit is None else robot.jerk_limit
    joints = robot.lower, robot.upper, robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, jerk
    bodies = np.zeros((0, 1, 1)) if dynamics.bodies is None else dynamics.bodies
    return TimingLimits(readonly(np.stack(joints)), readonly(bodies), readonly(dynamics.model.gravity.linear))


def _with_period(
    course: Course,
    row: int,
    limits: TimingLimits,
    period: float,
    wanted: Callable[[FloatArray], FloatArray],
    final_s: float,
) -> tuple[bool, FloatArray, FloatArray, FloatArray] | None:
    """Retime a motion at a fixed sampling period, as `retime`; None if not found."""
    duration_s = float(course.time[-1] - course.time[row])
    rows = int((2.0 if final_s == 0.0 else 4.0) * duration_s / period) + 64
    while True:
        if rows > MOST_ROWS or rows * period > _LONGEST_S:
            raise OptionError(
                "profile", "a function", f"factors with which a motion of {duration_s:.4g} s at full speed ends "
                f"within {_LONGEST_S:g} s and {MOST_ROWS:,} samples; after {0.5 * rows * period:.4g} s it has not",
            )  # fmt: skip
        factors = wanted(np.arange(rows, dtype=np.float64) * period)
        final = rows if not math.isfinite(final_s) else math.ceil(final_s / period)
        found = retime(course, row, limits, factors, period, final)
        if found[0] != 1:
            return found[1:] if found[0] == 0 else None
        rows *= 2


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
