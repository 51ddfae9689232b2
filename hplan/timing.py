r"""Time along a path: the fastest under velocity, acceleration and torque limits (toppra), sampled for a controller.

toppra finds the path speed on a grid of path parameters that holds the ends of the spline's pieces. Its constraints
are discretised by interpolation, which keeps the limits between grid points as well. The samples
:math:`q_k = q(s(k h))` of that motion are then taken as control points of a uniform cubic B-spline in time, and the
rows of the trajectory are its knots:

.. math::
    x_k = \tfrac16 (q_{k-1} + 4 q_k + q_{k+1}), \quad
    \dot x_k = \frac{q_{k+1} - q_{k-1}}{2 h}, \quad
    \ddot x_k = \frac{q_{k+1} - 2 q_k + q_{k-1}}{h^2}.

These are averages of the motion's own position, velocity and acceleration over :math:`\pm h`, so the limits hold for
them too. Between rows the acceleration is linear, so limits at the rows are limits in between, and a controller that
interpolates with cubic (position and velocity) or quintic (acceleration as well) polynomials runs exactly this
motion. It starts and ends with acceleration zero.

Jerk: where limits on it are given, each control point is first replaced by the mean of :math:`m` successive ones.
The acceleration then changes by no more than :math:`2 a / m` from row to row; velocity, acceleration and (but for its
curvature over that time) torque are again averages within their limits. The smallest :math:`m` that keeps the jerk is
taken. The price is :math:`(m - 1) h` of duration and a deviation from the path of at most :math:`a (m h)^2 / 24`
a joint, which the certificate sees, as it judges the rows.

In all the motion takes :math:`m + 1` to :math:`m + 2` periods longer than toppra's.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.arrays import FloatArray, readonly
from hplan.errors import OptionError, TimingError
from hplan.trajectory import Trajectory

#: Grid points of the path parameter, beside the knots.
GRID_POINTS = 150

#: Paths shorter than this are no motion [rad].
NO_MOTION = 1e-7


class GeometricPath(Protocol):
    """What timing needs of a path: a twice differentiable curve over [0, end]."""

    @property
    def breaks(self) -> FloatArray:
        """Parameters where pieces meet, the ends among them."""

    def evaluate(self, s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Points or derivatives at parameters."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a motion, one entry for each joint.

    Attributes:
        velocity: (dof,) [rad/s].
        acceleration: (dof,) [rad/s^2].
        torque: (dof,) [N m], or None where torque is not limited.
        jerk: (dof,) [rad/s^3], or None where jerk is not limited.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None
    jerk: FloatArray | None = None

    def scaled(self, speed: float) -> Limits:
        """The limits of the same motions at `speed` times their pace (torque stays: gravity does not slow down).

        Raises:
            OptionError: The speed is not in (0, 1].
        """
        if not 0.0 < speed <= 1.0:
            raise OptionError("speed", speed, "a factor in (0, 1]")
        jerk = None if self.jerk is None else readonly(self.jerk * speed**3)
        return Limits(readonly(self.velocity * speed), readonly(self.acceleration * speed**2), self.torque, jerk)


def time_path(
    path: GeometricPath,
    model: pin.Model,
    limits: Limits,
    *,
    rate_hz: float = 250.0,
    grid_points: int = GRID_POINTS,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
) -> Trajectory:
    """The fastest motion along a path.

    Args:
        path: The path; its parameter should run about as the joint-space length.
        model: Pinocchio's model, for torques; its joints are the path's.
        limits: Velocity, acceleration and, where given, torque and jerk limits.
        rate_hz: Rows per second.
        grid_points: Number of points at which the path speed is chosen, beside the ends of the path's pieces.
        start_speed: Joint-space speed along the path at its start [rad/s]; 0 starts from rest.
        end_speed: Joint-space speed along the path at its end [rad/s]; 0 comes to rest. Where it is not, the motion is
            slowed down by less than one period in all, and the speeds with it, to end on a row.

    Raises:
        TimingError: No motion within the limits exists; names the joint and the cause.
        OptionError: A rate that is not between 1 and 100000, or a speed that is negative.
    """
    if not (np.isfinite(rate_hz) and 1.0 <= rate_hz <= 100_000.0):
        raise OptionError("rate_hz", rate_hz, "a number of rows per second between 1 and 100000")
    for option, value in (("start_speed", start_speed), ("end_speed", end_speed)):
        if not (np.isfinite(value) and value >= 0.0):
            raise OptionError(option, value, "a finite speed along the path >= 0")
    names = tuple(model.names)[1:]
    if np.linalg.norm(np.diff(path.evaluate(path.breaks), axis=0), axis=1).sum() < NO_MOTION:
        return resting(model, path.evaluate(0.0))
    _check_limits(path, model, limits, _grid(path, grid_points, (0.0, 0.0)), names)
    ends = np.array([0.0, path.breaks[-1]])
    # Path speeds ds/dt at the ends; the parameter need not run exactly as the length.
    rates = np.array([start_speed, end_speed]) / np.linalg.norm(path.evaluate(ends, 1), axis=1)

    def profile_for(window: int) -> _Profile:
        """With as much constant speed at each end as the rows' averages reach over."""
        return _Profile.along(path, model, limits, grid_points, rates, 0.5 * (window + 1) / rate_hz)

    profile = profile_for(1)
    if limits.jerk is None:
        return _sample(profile, model, names, limits, 1.0 / rate_hz, 1)
    if not rates.any():
        return _with_jerk(lambda _: profile, model, names, limits, 1.0 / rate_hz)
    return _with_jerk(profile_for, model, names, limits, 1.0 / rate_hz)


def resting(model: pin.Model, q: FloatArray) -> Trajectory:
    """The empty motion: one row at time 0, at rest."""
    zero = np.zeros((1, model.nv))
    torque = pin.rnea(model, model.createData(), q, zero[0], zero[0])
    return Trajectory(tuple(model.names)[1:], np.zeros(1), q[None], zero, zero, torque[None])


def _grid(path: GeometricPath, points: int, leads: tuple[float, float]) -> FloatArray:
    """Equally spaced path parameters together with the ends of the pieces; none closer than a tenth of the spacing."""
    first, last = leads[0], float(path.breaks[-1]) - leads[1]
    inner = path.breaks[(path.breaks > first) & (path.breaks < last)]
    candidates = np.unique(np.concatenate([np.linspace(first, last, points), inner]))
    apart = np.diff(candidates, prepend=-np.inf) > 0.1 * (last - first) / points
    grid: FloatArray = candidates[apart]
    grid[-1] = last
    return grid


def _check_limits(
    path: GeometricPath, model: pin.Model, limits: Limits, grid: FloatArray, names: tuple[str, ...]
) -> None:
    """Say which joint and why before toppra can only say no."""
    moves = np.abs(path.evaluate(grid, 1)).max(axis=0) > 1e-9
    for what, values in (("velocity", limits.velocity), ("acceleration", limits.acceleration)):
        for joint in np.flatnonzero(moves & ~(values > 0.0)):
            raise TimingError(
                f"joint {names[joint]!r} must move, but its {what} limit is {values[joint]:g}",
                joint=names[joint],
                cause=f"{what} limit of zero",
            )
    if limits.torque is None:
        return
    data = model.createData()
    static = np.array([pin.computeGeneralizedGravity(model, data, q) for q in path.evaluate(grid)])
    use = np.abs(static) / np.maximum(limits.torque, 1e-12)
    point, joint = np.unravel_index(int(use.argmax()), use.shape)
    if use[point, joint] > 1.0:
        raise TimingError(
            f"joint {names[joint]!r} needs {abs(static[point, joint]):.4g} N m to stand still on the path, "
            f"its limit is {limits.torque[joint]:.4g} N m",
            joint=names[joint],
            cause="static torque exceeds the limit",
        )


def _path_speed(
    path: GeometricPath, model: pin.Model, limits: Limits, grid: FloatArray, rates: FloatArray
) -> FloatArray:
    """Path speed ds/dt at the grid points, by toppra; `rates` are those at the ends."""
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    interpolation = constraint.DiscretizationType.Interpolation
    # A joint that does not move may have a limit of zero, which toppra refuses.
    velocity = np.maximum(limits.velocity, 1e-9)
    acceleration = np.maximum(limits.acceleration, 1e-9)
    constraints: list[Any] = [
        constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1), discretization_scheme=interpolation
        ),
    ]
    if limits.torque is not None:
        data = model.createData()

        def inverse_dynamics(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
            return np.array(pin.rnea(model, data, q, v, a))

        constraints.append(
            constraint.JointTorqueConstraint(
                inverse_dynamics,
                np.stack([-limits.torque, limits.torque], axis=1),
                np.zeros(model.nv),
                discretization_scheme=interpolation,
            )
        )
    instance = algorithm.TOPPRA(constraints, _toppra_path(path, grid, toppra), gridpoints=grid)
    _, speed, _ = instance.compute_parameterization(float(rates[0]), float(rates[1]))
    if speed is None or not np.isfinite(speed).all():
        code = str(instance.problem_data.return_code).rsplit(".", 1)[-1]
        raise TimingError(f"toppra finds no motion along the path ({code})", cause=code)
    return np.maximum(np.asarray(speed, dtype=np.float64), 0.0)


def _toppra_path(path: GeometricPath, grid: FloatArray, toppra: Any) -> Any:
    """The part of the path that the grid covers, as toppra's interface."""
    dof = path.evaluate(0.0).shape[-1]

    class Adapter(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        @property
        def dof(self) -> int:
            return int(dof)

        @property
        def path_interval(self) -> FloatArray:
            return np.array([grid[0], grid[-1]])

        @property
        def waypoints(self) -> tuple[FloatArray, FloatArray]:
            return grid, path.evaluate(grid)

        def __call__(self, path_positions: ArrayLike, order: int = 0) -> FloatArray:
            return path.evaluate(path_positions, order)

    return Adapter()


@dataclass(frozen=True, eq=False)
class _Profile:
    """The fastest motion along a path, in continuous time.

    The path speed is linear in time between grid points. Before the first grid point and after the last one it is
    constant, on the path's tangent where that leads beyond its ends.

    Attributes:
        path: The path.
        grid: (n,) path parameters.
        speed: (n,) ds/dt there.
        arrival: (n,) times.
    """

    path: GeometricPath
    grid: FloatArray
    speed: FloatArray
    arrival: FloatArray

    @classmethod
    def along(
        cls,
        path: GeometricPath,
        model: pin.Model,
        limits: Limits,
        grid_points: int,
        rates: FloatArray,
        lead: float,
    ) -> _Profile:
        """By toppra, with `lead` seconds of constant speed at each end."""
        leads = (float(rates[0]) * lead, float(rates[1]) * lead)
        if sum(leads) >= 0.5 * path.breaks[-1]:
            raise TimingError("the path is too short for its start and end speeds", cause="speed at the ends")
        grid = _grid(path, grid_points, leads)
        speed = _path_speed(path, model, limits, grid, rates)
        # The path acceleration is constant between grid points, so each interval takes 2 ds / (sum of its speeds).
        lasting = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
        return cls(path, grid, speed, np.concatenate([[0.0], np.cumsum(lasting)]))

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at times."""
        time = np.clip(clock, 0.0, self.arrival[-1])
        interval = np.clip(np.searchsorted(self.arrival, time, side="right") - 1, 0, len(self.arrival) - 2)
        since = time - self.arrival[interval]
        lasting = self.arrival[interval + 1] - self.arrival[interval]
        acceleration = (self.speed[interval + 1] - self.speed[interval]) / lasting
        parameter = self.grid[interval] + since * (self.speed[interval] + 0.5 * acceleration * since)
        parameter += np.where(clock < 0.0, self.speed[0], self.speed[-1]) * (clock - time)
        q = self.path.evaluate(parameter)
        end = float(self.path.breaks[-1])
        beyond = np.where(parameter > end, parameter - end, np.minimum(parameter, 0.0))
        if beyond.any():
            q = q + beyond[:, None] * self.path.evaluate(np.where(beyond > 0.0, end, 0.0), 1)
        return q


def _with_jerk(
    profile_for: Callable[[int], _Profile], model: pin.Model, names: tuple[str, ...], limits: Limits, period: float
) -> Trajectory:
    """The trajectory with the fewest control points averaged that keeps the jerk limits."""
    jerk = np.asarray(limits.jerk)
    moves = np.abs(np.diff(profile_for(1).positions(profile_for(1).arrival), axis=0)).max(axis=0) > 0.0
    for joint in np.flatnonzero(moves & ~(jerk > 0.0)):
        raise TimingError(
            f"joint {names[joint]!r} must move, but its jerk limit is {jerk[joint]:g}",
            joint=names[joint],
            cause="jerk limit of zero",
        )
    # 2 a / (m h) <= jerk always suffices; what the motion really needs is found by bisection.
    low, high = 1, max(1, int(np.ceil((2.0 * limits.acceleration / np.maximum(jerk, 1e-9))[moves].max() / period)))
    best: Trajectory | None = None
    while best is None or low < high:
        window = (low + high) // 2
        trajectory = _sample(profile_for(window), model, names, limits, period, window)
        steps = np.diff(trajectory.acceleration, axis=0) / period
        if window == high or _largest_use(steps, jerk) <= 1.0 + 1e-6:
            best, high = trajectory, window
        else:
            low = window + 1
    return best


def _sample(
    profile: _Profile, model: pin.Model, names: tuple[str, ...], limits: Limits, period: float, window: int
) -> Trajectory:
    """Rows at multiples of the period (see the module's text), `window` control points averaged."""
    stretch = 1.0
    moving_end = profile.speed[-1] > 0.0
    while True:
        duration = profile.arrival[-1] * stretch
        if moving_end:
            stretch *= max(1.0, np.ceil(duration / period - 1e-9)) * period / duration
            duration = profile.arrival[-1] * stretch
        steps = max(1, int(np.ceil(duration / period - 1e-9))) + window + 1
        # Row i stands on control points i to i + window + 1; those of the first are all before the motion begins,
        # those of the last all after it has ended.
        clock = (np.arange(steps + window + 2, dtype=np.float64) - (window + 1)) * (period / stretch)
        control = profile.positions(clock)
        if window > 1:
            total = np.cumsum(np.concatenate([np.zeros((1, control.shape[1])), control - control[0]]), axis=0)
            control = control[0] + (total[window:] - total[:-window]) / window
        velocity = (control[2:] - control[:-2]) / (2.0 * period)
        acceleration = (control[2:] - 2.0 * control[1:-1] + control[:-2]) / period**2
        # Between grid points the limits may be passed by the square of their spacing; pace is taken back by as much.
        excess = max(_largest_use(velocity, limits.velocity), np.sqrt(_largest_use(acceleration, limits.acceleration)))
        if excess <= 1.0 + 1e-6:
            break
        stretch *= excess
    position = (control[:-2] + 4.0 * control[1:-1] + control[2:]) / 6.0
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *row) for row in zip(position, velocity, acceleration, strict=True)])
    time = np.arange(len(position), dtype=np.float64) * period
    return Trajectory(names, time, position, velocity, acceleration, torque)


def _largest_use(values: FloatArray, limit: FloatArray) -> float:
    """Largest share of a limit, over joints that move (a limit of zero is for those that do not)."""
    peak = np.abs(values).max(axis=0)
    return float(np.where(peak < 1e-9, 0.0, peak / np.maximum(limit, 1e-9)).max())
