r"""Time along a path: the fastest under velocity, acceleration and torque limits (toppra), sampled for a controller.

toppra finds the path speed on a grid of path parameters that holds the ends of the spline's pieces. Its constraints
are discretised by interpolation, which keeps the limits between grid points as well. The samples
:math:`q_k = q(s(k h))` of that motion are then taken as control points of a uniform cubic B-spline in time, and the rows of the trajectory are its knots:

.. math::
    x_k = \tfrac16 (q_{k-1} + 4 q_k + q_{k+1}), \quad
    \dot x_k = \frac{q_{k+1} - q_{k-1}}{2 h}, \quad
    \ddot x_k = \frac{q_{k+1} - 2 q_k + q_{k-1}}{h^2}.

These are averages of the motion's own position, velocity and acceleration over :math:`\pm h`, so the limits hold for
them too. Between rows the acceleration is linear, so limits at the rows are limits in between, and a controller that
interpolates with cubic (position and velocity) or quintic (acceleration as well) polynomials runs exactly this
motion. It takes two to three periods longer than toppra's and starts and ends with acceleration zero.
"""

from __future__ import annotations

import logging
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
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None

    def scaled(self, speed: float) -> Limits:
        """The limits of the same motions at `speed` times their pace (torque stays: gravity does not slow down).

        Raises:
            OptionError: The speed is not in (0, 1].
        """
        if not 0.0 < speed <= 1.0:
            raise OptionError("speed", speed, "a factor in (0, 1]")
        return Limits(readonly(self.velocity * speed), readonly(self.acceleration * speed**2), self.torque)


def time_path(
    path: GeometricPath,
    model: pin.Model,
    limits: Limits,
    *,
    rate_hz: float = 250.0,
    grid_points: int = GRID_POINTS,
) -> Trajectory:
    """The fastest motion along a path, from rest to rest.

    Args:
        path: The path; its parameter should run about as the joint-space length.
        model: Pinocchio's model, for torques; its joints are the path's.
        limits: Velocity, acceleration and, where given, torque limits.
        rate_hz: Rows per second.
        grid_points: Number of points at which the path speed is chosen, beside the ends of the path's pieces.

    Raises:
        TimingError: No motion within the limits exists; names the joint and the cause.
        OptionError: A rate or grid that is not positive.
    """
    if not (np.isfinite(rate_hz) and 1.0 <= rate_hz <= 100_000.0):
        raise OptionError("rate_hz", rate_hz, "a number of rows per second between 1 and 100000")
    names = tuple(model.names)[1:]
    if np.linalg.norm(np.diff(path.evaluate(path.breaks), axis=0), axis=1).sum() < NO_MOTION:
        return resting(model, path.evaluate(0.0))
    grid = _grid(path, grid_points)
    _check_limits(path, model, limits, grid, names)
    speed = _path_speed(path, model, limits, grid)
    return _sample(path, model, names, grid, speed, limits, 1.0 / rate_hz)


def resting(model: pin.Model, q: FloatArray) -> Trajectory:
    """The empty motion: one row at time 0, at rest."""
    zero = np.zeros((1, model.nv))
    torque = pin.rnea(model, model.createData(), q, zero[0], zero[0])
    return Trajectory(tuple(model.names)[1:], np.zeros(1), q[None], zero, zero, torque[None])


def _grid(path: GeometricPath, points: int) -> FloatArray:
    """Equally spaced path parameters together with the ends of the pieces; none closer than a tenth of the spacing."""
    end = float(path.breaks[-1])
    even = np.linspace(0.0, end, points)
    candidates = np.unique(np.concatenate([even, path.breaks]))
    apart = np.diff(candidates, prepend=-end) > 0.1 * end / points
    grid = candidates[apart]
    grid[-1] = end
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


def _path_speed(path: GeometricPath, model: pin.Model, limits: Limits, grid: FloatArray) -> FloatArray:
    """Path speed ds/dt at the grid points, by toppra."""
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
    instance = algorithm.TOPPRA(constraints, _toppra_path(path, toppra), gridpoints=grid)
    _, speed, _ = instance.compute_parameterization(0.0, 0.0)
    if speed is None or not np.isfinite(speed).all():
        code = str(instance.problem_data.return_code).rsplit(".", 1)[-1]
        raise TimingError(f"toppra finds no motion along the path ({code})", cause=code)
    return np.maximum(np.asarray(speed, dtype=np.float64), 0.0)


def _toppra_path(path: GeometricPath, toppra: Any) -> Any:
    """The path as toppra's interface."""
    dof = path.evaluate(0.0).shape[-1]

    class Adapter(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        @property
        def dof(self) -> int:
            return int(dof)

        @property
        def path_interval(self) -> FloatArray:
            return np.array([0.0, path.breaks[-1]])

        @property
        def waypoints(self) -> tuple[FloatArray, FloatArray]:
            return path.breaks, path.evaluate(path.breaks)

        def __call__(self, path_positions: ArrayLike, order: int = 0) -> FloatArray:
            return path.evaluate(path_positions, order)

    return Adapter()


def _sample(
    path: GeometricPath,
    model: pin.Model,
    names: tuple[str, ...],
    grid: FloatArray,
    speed: FloatArray,
    limits: Limits,
    period: float,
) -> Trajectory:
    """Rows at multiples of the period (see the module's text)."""
    # Path acceleration is constant between grid points, so each takes 2 ds / (sum of speeds).
    lasting = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
    arrival = np.concatenate([[0.0], np.cumsum(lasting)])
    stretch = 1.0
    while True:
        duration = arrival[-1] * stretch
        rows = int(np.ceil(duration / period - 1e-9)) + 3
        # The motion begins one period after the first row; one control point stands before it and one after the end.
        clock = np.asarray((np.arange(-1, rows + 1) - 1.0) * period / stretch, dtype=np.float64)
        q = path.evaluate(_parameter_at(clock, grid, speed, arrival))
        velocity = (q[2:] - q[:-2]) / (2.0 * period)
        acceleration = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / period**2
        # Between grid points the limits may be passed by the square of their spacing; pace is taken back by as much.
        excess = max(_largest_use(velocity, limits.velocity), np.sqrt(_largest_use(acceleration, limits.acceleration)))
        if excess <= 1.0 + 1e-9:
            break
        stretch *= excess
    position = (q[:-2] + 4.0 * q[1:-1] + q[2:]) / 6.0
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *row) for row in zip(position, velocity, acceleration, strict=True)])
    return Trajectory(names, np.arange(rows, dtype=np.float64) * period, position, velocity, acceleration, torque)


def _largest_use(values: FloatArray, limit: FloatArray) -> float:
    """Largest share of a limit, over joints that move."""
    return float((np.abs(values).max(axis=0) / np.maximum(limit, 1e-9)).max())


def _parameter_at(clock: FloatArray, grid: FloatArray, speed: FloatArray, arrival: FloatArray) -> FloatArray:
    """Path parameter at times; at rest before the start and after the end."""
    time = np.clip(clock, 0.0, arrival[-1])
    interval = np.clip(np.searchsorted(arrival, time, side="right") - 1, 0, len(arrival) - 2)
    since = time - arrival[interval]
    acceleration = (speed[interval + 1] - speed[interval]) / (arrival[interval + 1] - arrival[interval])
    parameter: FloatArray = grid[interval] + since * (speed[interval] + 0.5 * acceleration * since)
    return parameter
