r"""toppra with limits at the middle of each grid interval, and its two passes compiled.

Between grid points the path acceleration :math:`u = \ddot s` is constant and :math:`x = \dot s^2` linear in s. A
limit of the form :math:`|a u + b x + c| \le g` enforced at grid points (collocation) is passed in between, and
enforced at both ends of each interval (interpolation) leaves some of it unused everywhere; both errors are of the
order of the spacing. Enforced at the middle, where :math:`x_m = x_i + \Delta s \, u`, the error alternates in sign
and its average over an interval is of second order. The rows of a trajectory are such averages
(`hplan.trajectory.retime`), so there the limits are used in full and kept to within a fraction that timing then takes
back.

toppra states the problem: at each grid point its constraints give half-planes of (u, x). From the end backward, the
set of x from which the end can be reached is an interval, whose two ends are linear programs in two variables; forward,
the largest u that stays in these intervals is taken. `algorithm.TOPPRA` does so with a call from Python for each
program, which takes many times what solving it takes; here both passes are one compiled call.

This module is imported lazily: toppra, with scipy, takes a quarter of a second.
"""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.base.lazy_import import deferred
from hplan.errors import TimingError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import GeometricPath, Limits

with deferred("matplotlib", "matplotlib.pyplot"):  # toppra wants it for plots that nobody asks for here
    import toppra
    from toppra import constraint
    from toppra.algorithm.algorithm import ParameterizationAlgorithm, ParameterizationReturnCode

logging.getLogger("toppra").setLevel(logging.ERROR)

#: What toppra is given for a limit of zero, which only joints that do not move may have.
_TINY = 1e-9

#: Paths shorter than this are given a longer parameter [rad].
_SHORT = 0.01

#: toppra's bounds of u and x, its tolerances of a half-plane and of parallel lines, its weight of u in the programs of
#: the backward pass (of points with the same x, one with small u), what its forward pass takes from x at each step
#: against rounding, by how much a start may miss its interval, and how often x is lowered where no u is found.
_BOUND, _KEPT, _PARALLEL, _LEAN, _DROP, _NEAR, _TRIES = 1e8, 1e-10, 1e-8, 1e-9, 1e-8, 1e-5, 10


def fastest_speed(
    path: GeometricPath, dynamics: InverseDynamics, limits: Limits, grid: FloatArray, rates: FloatArray
) -> FloatArray:
    """Path speed ds/dt at the grid points of the fastest motion.

    Args:
        path: The path.
        dynamics: Torques of the robot's motions.
        limits: Velocity, acceleration and, where given, torque limits.
        grid: (n,) increasing path parameters.
        rates: (2,) path speeds at the ends.

    Raises:
        TimingError: There is no motion within the limits; `cause` is toppra's code.
    """
    # toppra's tolerances are absolute; on a short path a longer parameter brings ds/dt to about 10.
    span = float(grid[-1] - grid[0])
    scale = 10.0 / np.sqrt(max(float(limits.acceleration.max()), _TINY) * span) if span < _SHORT else 1.0
    constraints: list[Any] = [
        _Velocity(np.maximum(limits.velocity, _TINY)),
        _Acceleration(np.maximum(limits.acceleration, _TINY)),
    ]
    if limits.torque is not None:
        constraints.append(_Torque(dynamics, np.maximum(limits.torque, _TINY)))
    view = _Path(path, grid, scale)
    instance = Passes(constraints, view, gridpoints=scale * grid)
    _, speed, _ = instance.compute_parameterization(scale * float(rates[0]), scale * float(rates[1]))
    if speed is None or not np.isfinite(speed).all():
        code = instance.problem_data.return_code.name
        raise TimingError(f"toppra finds no motion along the path ({code})", cause=code)
    return np.maximum(np.asarray(speed, dtype=np.float64), 0.0) / scale


class _Path(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """The part of a path that a grid covers, as toppra's interface; its parameter is the path's times `scale`."""

    def __init__(self, path: GeometricPath, grid: FloatArray, scale: float) -> None:
        self._path, self._grid, self._scale = path, grid, scale
        # Constraints ask for the same points, one after the other.
        self._known: dict[tuple[int, bytes], FloatArray] = {}

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
        positions = np.asarray(path_positions, dtype=np.float64)
        asked = (order, positions.tobytes())
        if asked not in self._known:
            self._known[asked] = self._path.evaluate(positions / self._scale, order) / self._scale**order
        return self._known[asked]


class _Velocity(constraint.LinearConstraint):  # type: ignore[misc]
    """|q'| ds/dt <= limit at the grid points, as a bound of x.

    `JointVelocityConstraint` without its loops.
    """

    def __init__(self, limit: FloatArray) -> None:
        super().__init__()
        self._limit = limit

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *_: Any) -> tuple[Any, ...]:
        """Return toppra's a, b, c, F, g, ubound, of which there are none, and xbound."""
        fastest = (self._limit / np.maximum(np.abs(path(gridpoints, 1)), 1e-300)).min(axis=1)
        bound = np.stack([np.zeros(len(fastest)), np.minimum(fastest, math.sqrt(_BOUND)) ** 2], axis=1)
        return None, None, None, None, None, None, bound


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

    def __init__(self, dynamics: InverseDynamics, limit: FloatArray) -> None:
        super().__init__(limit)
        self._dynamics = dynamics

    def coefficients(
        self, q: FloatArray, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        still = np.zeros_like(q)
        gravity = self._dynamics.torques(q, still, still)
        inertia = self._dynamics.torques(q, still, first)
        moving = self._dynamics.torques(q, first, second)
        return inertia - gravity, moving - gravity, gravity


class Passes(ParameterizationAlgorithm):  # type: ignore[misc]
    """`algorithm.TOPPRA` with both passes compiled: its results and return codes, for constraints that are linear."""

    def compute_parameterization(self, sd_start: float, sd_end: float, return_data: bool = False) -> tuple[Any, ...]:
        """Path accelerations (n - 1,), path speeds (n,), no further variables; with `return_data` the sets (n, 2) too.

        All but the last are None where no motion was found; `problem_data.return_code` says why.
        """
        rows = self._half_planes()
        sets, x, u = np.full((len(rows), 2), np.nan), np.full(len(rows), np.nan), np.zeros(len(rows) - 1)
        steps = np.diff(self.gridpoints)
        _controllable(rows, steps, sd_end**2, sets)
        start = sd_start**2
        within = sets[0, 0] <= start + _NEAR and start <= sets[0, 1] + _NEAR
        extra = (sets,) if return_data else ()
        if not within:
            self._problem_data.return_code = ParameterizationReturnCode.FailUncontrollable
            return (None, None, None, *extra)
        greedy(rows, steps, sets, start, x, u)
        speed = np.sqrt(x)
        code = ParameterizationReturnCode
        self._problem_data.return_code = code.ErrUnknown if np.isnan(speed).any() else code.Ok
        self._problem_data.K, self._problem_data.sd_vec, self._problem_data.sdd_vec = sets, speed, u
        return (u, speed, np.zeros((len(u), 0)), *extra)

    def _half_planes(self) -> FloatArray:
        """(n, 6 + m, 3) half-planes a u + b x + c <= 0 at each grid point.

        Four are the bounds of u and x, two are left for the interval of the next grid point.
        """
        bounds = np.tile([-_BOUND, _BOUND, -_BOUND, _BOUND], (len(self.gridpoints), 1))
        found = []
        for given in self.constraints:
            a, b, c, faces, offsets, of_u, of_x = given.compute_constraint_params(self.path, self.gridpoints)
            if a is not None:
                faces = np.swapaxes(faces, -1, -2)
                found.append(np.stack([_through(a, faces), _through(b, faces), _through(c, faces) - offsets], axis=2))
            for first, bound in ((0, of_u), (2, of_x)):
                if bound is not None:
                    np.maximum(bounds[:, first], bound[:, 0], out=bounds[:, first])
                    np.minimum(bounds[:, first + 1], bound[:, 1], out=bounds[:, first + 1])
        fixed = np.zeros((len(bounds), 6, 3))
        fixed[:, 0:4, 0], fixed[:, 0:4, 1] = (-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0)
        fixed[:, 0:4, 2] = bounds * (1.0, -1.0, 1.0, -1.0)
        return np.concatenate([fixed, *found], axis=1)


def _through(values: FloatArray, faces: FloatArray) -> FloatArray:
    """(n, m) values by faces that are the same at all grid points, (k, m), or not, (n, k, m)."""
    product: FloatArray = values @ faces if faces.ndim == 2 else (values[:, None] @ faces)[:, 0]
    return product


@kernel
def _controllable(rows: FloatArray, steps: FloatArray, end: float, sets: FloatArray) -> None:
    """Backward: the least and the largest x at each grid point from which x = end can be reached; else left as it is.

    Each is a linear program in (u, x), solved by taking in one half-plane after the other (Seidel): where the best
    point so far is outside the next one, the best point lies on its border, between the half-planes before it.
    """
    last, count = rows.shape[0] - 1, rows.shape[1]
    sets[last, 0], sets[last, 1] = end, end
    for i in range(last - 1, -1, -1):
        rows[i, 4, 0], rows[i, 4, 1], rows[i, 4, 2] = -2.0 * steps[i], -1.0, sets[i + 1, 0]
        rows[i, 5, 0], rows[i, 5, 1], rows[i, 5, 2] = 2.0 * steps[i], 1.0, -sets[i + 1, 1]
        for side in range(2):
            aim_u, aim_x = (-_LEAN, 1.0) if side == 1 else (_LEAN, -1.0)
            u = -rows[i, 1, 2] if aim_u > 0.0 else rows[i, 0, 2]
            x = -rows[i, 3, 2] if aim_x > 0.0 else rows[i, 2, 2]
            if rows[i, 0, 2] > -rows[i, 1, 2] or rows[i, 2, 2] > -rows[i, 3, 2]:
                return
            for k in range(4, count):
                a, b, c = rows[i, k, 0], rows[i, k, 1], rows[i, k, 2]
                if a * u + b * x + c < _KEPT:
                    continue
                square = a * a + b * b
                if not square > 0.0:
                    return
                # The border: its point nearest to the origin, and from there t times (-b, a).
                u0, x0 = -a * c / square, -b * c / square
                low, high = -np.inf, np.inf
                for j in range(k):
                    along = a * rows[i, j, 1] - b * rows[i, j, 0]
                    beyond = rows[i, j, 0] * u0 + rows[i, j, 1] * x0 + rows[i, j, 2]
                    if along > _KEPT:
                        high = min(high, -beyond / along)
                    elif along < -_KEPT:
                        low = max(low, -beyond / along)
                    elif beyond > _PARALLEL:
                        return
                if low > high:
                    return
                t = high if a * aim_x - b * aim_u > _KEPT else low
                u, x = u0 - t * b, x0 + t * a
            sets[i, side] = x
        sets[i, 0] = max(sets[i, 0], 0.0)


@kernel
def greedy(rows: FloatArray, steps: FloatArray, sets: FloatArray, start: float, x: FloatArray, u: FloatArray) -> None:
    """Forward: the largest u at each grid point that stays within the sets; where there is none, the rest of x is left.

    The half-planes are those the backward pass has completed. As in toppra, x is lowered a few times where rounding
    leaves no u.
    """
    x[0] = start
    i, tries = 0, 0
    while i < len(u):
        most, clear = _BOUND, True
        for k in range(rows.shape[1]):
            rest = rows[i, k, 1] * x[i] + rows[i, k, 2]
            if rows[i, k, 0] > 0.0 and rows[i, k, 0] * most + rest >= _KEPT:
                most = -rest / rows[i, k, 0]
        for k in range(rows.shape[1]):
            clear = clear and rows[i, k, 0] * most + rows[i, k, 1] * x[i] + rows[i, k, 2] <= _KEPT
        if clear:
            u[i] = most
            following = x[i] + 2.0 * steps[i] * most
            following = max(following - _DROP, 0.9999 * following)
            x[i + 1] = min(sets[i + 1, 1], max(sets[i + 1, 0], following))
            i, tries = i + 1, 0
        elif tries < _TRIES:
            x[i] = max(x[i] - _DROP, 0.999 * x[i])
            tries += 1
        else:
            return
