r"""toppra with limits at the middle of each grid interval.

Between grid points the path acceleration :math:`u = \ddot s` is constant and :math:`x = \dot s^2` linear in s. A
limit of the form :math:`|a u + b x + c| \le g` enforced at grid points (collocation) is passed in between, and
enforced at both ends of each interval (interpolation) leaves some of it unused everywhere; both errors are of the
order of the spacing. Enforced at the middle, where :math:`x_m = x_i + \Delta s \, u`, the error alternates in sign
and its average over an interval is of second order. The rows of a trajectory are such averages
(`hplan.timing`), so there the limits are used in full and kept to within a share that timing then takes back.

This module is imported lazily: toppra takes half a second.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pinocchio as pin
import toppra
from numpy.typing import ArrayLike
from toppra import algorithm, constraint

from hplan.arrays import FloatArray
from hplan.errors import TimingError
from hplan.path import GeometricPath, Limits

logging.getLogger("toppra").setLevel(logging.ERROR)

#: What toppra is given for a limit of zero, which only joints that do not move may have.
_TINY = 1e-9

#: Paths shorter than this are given a longer parameter [rad].
_SHORT = 0.01


def fastest_speed(
    path: GeometricPath, model: pin.Model, limits: Limits, grid: FloatArray, rates: FloatArray
) -> FloatArray:
    """Path speed ds/dt at the grid points of the fastest motion.

    Args:
        path: The path.
        model: Pinocchio's model, for torques.
        limits: Velocity, acceleration and, where given, torque limits.
        grid: (n,) increasing path parameters.
        rates: (2,) path speeds at the ends.

    Raises:
        TimingError: There is no motion within the limits; `cause` is toppra's code.
    """
    velocity = np.maximum(limits.velocity, _TINY)
    constraints: list[Any] = [
        constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        _Acceleration(np.maximum(limits.acceleration, _TINY)),
    ]
    if limits.torque is not None:
        constraints.append(_Torque(model, np.maximum(limits.torque, _TINY)))
    # toppra's tolerances are absolute; on a short path a longer parameter brings ds/dt to about 10.
    span = float(grid[-1] - grid[0])
    scale = 10.0 / np.sqrt(max(float(limits.acceleration.max()), _TINY) * span) if span < _SHORT else 1.0
    view = _Path(path, grid, scale)
    instance = algorithm.TOPPRA(constraints, view, gridpoints=scale * grid, solver_wrapper="seidel")
    _, speed, _ = instance.compute_parameterization(scale * float(rates[0]), scale * float(rates[1]))
    if speed is None or not np.isfinite(speed).all():
        code = instance.problem_data.return_code.name
        raise TimingError(f"toppra finds no motion along the path ({code})", cause=code)
    return np.maximum(np.asarray(speed, dtype=np.float64), 0.0) / scale


class _Path(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """The part of a path that a grid covers, as toppra's interface; its parameter is the path's times `scale`."""

    def __init__(self, path: GeometricPath, grid: FloatArray, scale: float) -> None:
        self._path, self._grid, self._scale = path, grid, scale

    @property
    def dof(self) -> int:
        return int(self._path.evaluate(0.0).shape[-1])

    @property
    def path_interval(self) -> FloatArray:
        return self._scale * np.array([self._grid[0], self._grid[-1]])

    @property
    def waypoints(self) -> tuple[FloatArray, FloatArray]:
        return self._scale * self._grid, self._path.evaluate(self._grid)

    def __call__(self, path_positions: ArrayLike, order: int = 0) -> FloatArray:
        return self._path.evaluate(np.asarray(path_positions) / self._scale, order) / self._scale**order


class _AtMiddles(constraint.LinearConstraint):  # type: ignore[misc]
    """|a u + b x + c| <= limit at the middle of each interval, in toppra's canonical form at its first grid point."""

    def __init__(self, limit: FloatArray) -> None:
        super().__init__()
        self.identical = True
        self._limit = limit

    def coefficients(
        self, q: FloatArray, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The (n, dof) coefficients a, b, c from position and derivatives of the path."""
        raise NotImplementedError

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *_: Any) -> tuple[Any, ...]:
        """Return toppra's a, b, c, F, g, ubound, xbound; the last grid point has no interval, and so no limit."""
        half = 0.5 * np.diff(gridpoints)
        middle = gridpoints[:-1] + half
        a, b, c = self.coefficients(path(middle), path(middle, 1), path(middle, 2))
        a = a + 2.0 * half[:, None] * b
        dof = a.shape[1]
        bounds = np.vstack([np.eye(dof), -np.eye(dof)])
        last = np.zeros((1, dof))
        stacked = (np.vstack([part, last]) for part in (a, b, c))
        return (*stacked, bounds, np.tile(self._limit, 2), None, None)


class _Acceleration(_AtMiddles):
    """Joint acceleration q' u + q'' x."""

    def coefficients(
        self, q: FloatArray, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        return first, second, np.zeros_like(q)


class _Torque(_AtMiddles):
    """Joint torque by inverse dynamics, M(q) q' u + (M(q) q'' + C(q, q') q') x + g(q)."""

    def __init__(self, model: pin.Model, limit: FloatArray) -> None:
        super().__init__(limit)
        self._model, self._data = model, model.createData()

    def coefficients(
        self, q: FloatArray, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        model, data = self._model, self._data
        still = np.zeros(model.nv)
        gravity = np.array([pin.rnea(model, data, row, still, still) for row in q])
        inertia = np.array([pin.rnea(model, data, row, still, turn) for row, turn in zip(q, first, strict=True)])
        moving = np.array(
            [pin.rnea(model, data, row, turn, bend) for row, turn, bend in zip(q, first, second, strict=True)]
        )
        return inertia - gravity, moving - gravity, gravity
