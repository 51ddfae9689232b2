r"""Time-optimal timing of a path (toppra), sampled for a controller.

toppra computes the path speed on a grid of path parameters that contains the ends of the spline's pieces
(`hplan.trajectory.topp`). The samples :math:`q_k = q(s(k h))` of that motion are then the control points of a uniform
cubic B-spline in time, and the samples of the trajectory are at its knots (`hplan.trajectory.cubics.sample_spline`).

These are averages of the motion's own position, velocity and acceleration over :math:`\pm h`, so its limits hold.
Between samples the acceleration is linear and the velocity lies in the convex hull of the differences
:math:`(q_{k+1} - q_k) / h`, so limits on both that hold there hold in between; and a controller that interpolates with
cubic (position and velocity) or quintic (acceleration as well) polynomials runs exactly this motion. It starts and ends
with zero acceleration.

With jerk limits, each control point is first replaced by the mean of :math:`m` successive ones. The acceleration then
changes by at most :math:`2 a / m` from sample to sample, and velocity and acceleration are again averages within their
limits. The minimum :math:`m` that satisfies the jerk limits is chosen. The cost is :math:`(m - 1) h` of duration and a
deviation from the path of at most :math:`a (m h)^2 / 24` for each joint. The certificate accounts for this deviation,
as it verifies the samples.

The motion takes :math:`m + 1` to :math:`m + 2` periods longer than toppra's. Remaining violations (small ones caused by
the grid spacing, which `hplan.trajectory.speed_profile` refines if they are larger, and torque, which is not a linear
function of the motion) are removed by slowing down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.deadline import check_deadline
from hplan.errors import HplanError, OptionError, TimingError
from hplan.robot.dynamics import InverseDynamics, joints_that_slide
from hplan.robot.limits import GeometricPath, Limits, check_rate
from hplan.trajectory.cubics import sample_spline
from hplan.trajectory.speed_profile import (
    EMPTY_PATH,
    LITTLE,
    MOST_GRID_POINTS,
    SpeedProfile,
    check_row_count,
    parameter_grid,
    refine,
)
from hplan.trajectory.trajectory import Trajectory

#: Number of grid points of the path parameter, in addition to the knots.
GRID_POINTS = 400

#: A motion is slowed down if it exceeds a limit by more than this fraction.
KEPT = 2e-4

#: If samples are farther apart than this, torque limits are also enforced at this spacing between them [s].
TORQUE_PERIOD_S = 0.01

#: Window sizes up to the first number are all tried; larger ones grow by the second factor.
_ONE_BY_ONE, _GROWTH = 128, 1.02

#: Maximum number of times a motion is slowed down.
_MOST_SLOWINGS = 20


def time_path(
    path: GeometricPath,
    model: pin.Model | InverseDynamics,
    limits: Limits,
    *,
    rate_hz: float = 250.0,
    grid: FloatArray | None = None,
) -> Trajectory:
    """Time-optimal motion along a path, from rest to rest.

    Args:
        path: The path; its parameter should be approximately the joint-space arc length.
        model: Pinocchio's model, for torques, or its inverse dynamics; its joints are the path's.
        limits: Velocity and acceleration limits, and optional torque and jerk limits.
        rate_hz: Samples per second.
        grid: (n,) increasing path parameters, from 0 to the end, of the grid for the path speed; None for a default
            grid that suits any path.

    Raises:
        TimingError: No motion within the limits exists; names the joint and the cause.
        OptionError: `rate_hz` is not between 1 and 100000, or the motion needs more than `MOST_ROWS` samples.
    """
    check_rate(rate_hz)
    dynamics = model if isinstance(model, InverseDynamics) else InverseDynamics.build(model)
    names = tuple(dynamics.model.names)[1:]
    whole = parameter_grid(path, GRID_POINTS) if grid is None else grid
    fine = path.evaluate(whole)
    if np.ptp(fine, axis=0).max() < EMPTY_PATH:
        return rest_at(dynamics.model, path.evaluate(0.0))
    _check_limits(path, dynamics, limits, whole, names)
    runs = np.linalg.norm(path.evaluate(np.array([0.0, path.breaks[-1]]), 1), axis=1)
    for where, run in zip(("start", "end"), runs, strict=True):
        if not run > 0.0:
            message = (
                f"the path has zero derivative at its {where}; its parameter should be close to the joint-space length"
            )
            raise TimingError(message, cause="parameter")
    check_deadline()
    profile = SpeedProfile.compute(path, dynamics, limits, whole)
    # With fewer grid points per sample than this, violations between them slow the whole motion down; longer motions
    # get more points, up to a number that takes a tenth of a second.
    wanted = int(0.8 * profile.arrival[-1] * rate_hz)
    if grid is None and wanted > len(whole):
        profile = SpeedProfile.compute(path, dynamics, limits, parameter_grid(path, min(wanted, MOST_GRID_POINTS)))
    period = 1.0 / rate_hz
    return _sample_refined(profile, dynamics, names, limits, period, _smoothing_window(profile, limits, period))


def rest_at(model: pin.Model, q: FloatArray) -> Trajectory:
    """Empty motion: a single sample at time 0, at rest."""
    zero = np.zeros((1, model.nv))
    torque = pin.rnea(model, model.createData(), q, zero[0], zero[0])
    return Trajectory(tuple(model.names)[1:], np.zeros(1), q[None], zero, zero, torque[None], joints_that_slide(model))


def _check_limits(
    path: GeometricPath, dynamics: InverseDynamics, limits: Limits, grid: FloatArray, names: tuple[str, ...]
) -> None:
    """Name the joint and the cause, because toppra reports only infeasibility."""
    moves = np.abs(path.evaluate(grid, 1)).max(axis=0) > 1e-9
    for what, values in (
        ("velocity", limits.velocity),
        ("acceleration", limits.acceleration),
        ("jerk", limits.jerk),
    ):
        if values is None:
            continue
        for joint in np.flatnonzero(moves & ~(values > 0.0)):
            raise TimingError(
                f"joint {names[joint]!r} must move, but its {what} limit is {values[joint]:g}",
                joint=names[joint],
                cause=f"{what} limit of zero",
            )
    if limits.torque is None:
        return
    static = dynamics.gravity(path.evaluate(grid[::8]))
    use = np.abs(static) / np.maximum(limits.torque, 1e-12)
    point, joint = np.unravel_index(int(use.argmax()), use.shape)
    if use[point, joint] > 1.0:
        raise TimingError(
            f"joint {names[joint]!r} needs {abs(static[point, joint]):.4g} N m to hold its position on the path, "
            f"its limit is {limits.torque[joint]:.4g} N m",
            joint=names[joint],
            cause="static torque exceeds the limit",
        )


def _smoothing_window(profile: SpeedProfile, limits: Limits, period: float) -> int:
    """Minimum number of control points to average that satisfies the jerk limits.

    2 a / (m h) <= jerk is always sufficient.
    """
    if limits.jerk is None:
        return 1
    jerk = limits.jerk
    moves = np.ptp(profile.path.evaluate(profile.grid), axis=0) > EMPTY_PATH
    enough = int(np.ceil((2.0 * limits.acceleration[moves] / (jerk[moves] * period)).max(initial=1.0)))
    if enough == 1:
        return 1
    # The acceleration change of the mean of m control points is the difference of two raw ones m samples apart, over m.
    raw = _average_rows(profile, replace(limits, jerk=None), period, 1).acceleration[:, moves]
    padded = np.concatenate([np.zeros_like(raw[:1]), raw, np.zeros_like(raw[:1])])
    allowed = jerk[moves] * period * (1.0 + 1e-6)
    for window in _window_sizes(min(enough, len(padded) - 1)):
        if (np.abs(padded[window:] - padded[:-window]) <= allowed * window).all():
            return window
    return enough


def _window_sizes(end: int) -> Iterator[int]:
    """Window sizes below `end` to try."""
    window = 1
    while window < end:
        yield window
        window = max(window + 1, int(window * _GROWTH)) if window >= _ONE_BY_ONE else window + 1


@dataclass(frozen=True, eq=False)
class _Rows:
    """Position, velocity and acceleration at the samples, and the profile's time-scaling factor."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    factor: float


def _sample(
    profile: SpeedProfile, dynamics: InverseDynamics, names: tuple[str, ...], limits: Limits, period: float, window: int
) -> tuple[Trajectory, float]:
    """Sample the trajectory, slowed down as required by the torque limits.

    Torque is not a linear function of the motion, so the time-scaling factor is found iteratively.
    """
    factor = 1.0
    for _ in range(_MOST_SLOWINGS):
        check_deadline()
        rows = _average_rows(profile, limits, period, window, factor)
        torque = dynamics.torques(rows.position, rows.velocity, rows.acceleration)
        excess = 0.0
        if limits.torque is not None:
            excess = torque_excess(dynamics, rows.position, torque, limits.torque)
            if period > TORQUE_PERIOD_S:
                q, v, a = _sample_between(rows, period)
                excess = max(excess, torque_excess(dynamics, q, dynamics.torques(q, v, a), limits.torque))
        if excess <= 1.0:
            time = np.arange(len(torque), dtype=np.float64) * period
            made = time, rows.position, rows.velocity, rows.acceleration, torque, joints_that_slide(dynamics.model)
            return Trajectory(names, *made), rows.factor
        factor = rows.factor * excess
    reason = "no time-scaling factor was found at which the motion keeps the torque limits"
    raise TimingError(reason, cause="torque limit not kept")


def _sample_refined(
    profile: SpeedProfile, dynamics: InverseDynamics, names: tuple[str, ...], limits: Limits, period: float, window: int
) -> Trajectory:
    """Sample the rest-to-rest trajectory; refine the grid before slowing down.

    The grid is refined if the trajectory would otherwise be slowed down as a whole.
    """
    coarse: HplanError | Trajectory
    try:
        coarse, factor = _sample(profile, dynamics, names, limits, period, window)
        if factor <= 1.0 + LITTLE:
            return coarse
    except (OptionError, TimingError) as error:
        coarse = error
    finer = refine(profile, dynamics, limits, period)
    if finer is not profile:
        return _sample(finer, dynamics, names, limits, period, _smoothing_window(finer, limits, period))[0]
    if isinstance(coarse, HplanError):
        raise coarse
    return coarse


def _sample_between(rows: _Rows, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations between samples, where acceleration is linear."""
    parts = int(np.ceil(period / TORQUE_PERIOD_S - 1e-9))
    t = (np.arange(1, parts) * (period / parts))[:, None, None]
    a, jerk = rows.acceleration[:-1], np.diff(rows.acceleration, axis=0) / period
    q, v = rows.position[:-1], rows.velocity[:-1]
    states = q + t * (v + t * (0.5 * a + t * jerk / 6.0)), v + t * (a + 0.5 * t * jerk), a + t * jerk
    position, velocity, acceleration = (values.reshape(-1, q.shape[1]) for values in states)
    return position, velocity, acceleration


def torque_excess(dynamics: InverseDynamics, position: FloatArray, torque: FloatArray, limit: FloatArray) -> float:
    """Time-scaling factor required by the torque limits; 0 if they hold.

    Gravity torques do not decrease with speed.
    """
    over = np.abs(torque) > limit * (1.0 + KEPT)
    if not over.any():
        return 0.0
    gravity = dynamics.gravity(position)
    room = np.maximum(limit - np.abs(gravity), 1e-3 * limit)
    return float(max(1.0 + 1e-4, np.sqrt((np.abs(torque - gravity) / room)[over].max())))


def _average_rows(profile: SpeedProfile, limits: Limits, period: float, window: int, factor: float = 1.0) -> _Rows:
    """Samples at multiples of the period, with `window` control points averaged.

    See the module's text. Between grid points velocity and acceleration exceed their limits slightly, which slows the
    motion down.
    """
    for _ in range(_MOST_SLOWINGS):
        duration = profile.arrival[-1] * factor
        check_row_count(duration / period + window, duration, 1.0 / period)
        steps = max(1, int(np.ceil(duration / period - 1e-9))) + window + 1
        # Sample i depends on control points i to i + window + 1. The first sample's control points all lie before the
        # start of the motion, the last sample's all after its end.
        clock = (np.arange(steps + window + 2, dtype=np.float64) - (window + 1)) * (period / factor)
        control = profile.positions(clock)
        if window > 1:
            total = np.cumsum(np.concatenate([np.zeros((1, control.shape[1])), control - control[0]]), axis=0)
            control = control[0] + (total[window:] - total[:-window]) / window
        position, velocity, acceleration = sample_spline(control, period)
        moves = np.ptp(control, axis=0) > EMPTY_PATH
        excess = max(
            _largest_use(np.diff(control, axis=0) / period, limits.velocity, moves),
            np.sqrt(_largest_use(acceleration, limits.acceleration, moves)),
        )
        if limits.jerk is not None:
            jerk = np.diff(acceleration, axis=0, prepend=0.0, append=0.0) / period
            excess = max(excess, math.cbrt(_largest_use(jerk, limits.jerk, moves)))
        if excess <= 1.0 + KEPT:
            _make_exact(position, velocity, acceleration, control, profile)
            return _Rows(position, velocity, acceleration, factor)
        factor *= excess
    raise TimingError("no time-scaling factor was found at which the motion keeps its limits", cause="limits not kept")


def _make_exact(
    position: FloatArray, velocity: FloatArray, acceleration: FloatArray, control: FloatArray, profile: SpeedProfile
) -> None:
    """Remove rounding errors from stationary joints and from rest at the ends."""
    still = np.ptp(control, axis=0) <= 1e-12
    position[:, still] = profile.ends[0, still]
    for end in (0, -1):
        position[end] = profile.ends[end]
        velocity[end] = acceleration[end] = 0.0


def _largest_use(values: FloatArray, limit: FloatArray, joints: BoolArray) -> float:
    """Maximum use of a limit over the selected joints."""
    use = np.abs(values).max(axis=0) / np.maximum(limit, 1e-12)
    return float(use[joints].max(initial=0.0))
