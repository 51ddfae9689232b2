r"""toppra with limits at grid interval midpoints, and its two passes compiled.

Between grid points the path acceleration :math:`u = \ddot s` is constant and :math:`x = \dot s^2` linear in s. A limit
of the form :math:`|a u + b x + c| \le g` enforced at grid points (collocation) is exceeded in between, and enforced at
both ends of each interval (interpolation) leaves some of it unused everywhere; both errors are of the order of the
spacing. Enforced at the middle, where :math:`x_m = x_i + \Delta s \, u`, the error alternates in sign and its average
over an interval is of second order. The samples of a trajectory are such averages (`hplan.trajectory.retime`), so the
limits are used fully and violated only by a fraction that timing then removes.

toppra's constraints define the problem: in their canonical form they give half-planes of (u, x). From the end backward,
the set of x that can reach the end is an interval whose two ends are linear programs in two variables; forward, the
maximum u that stays in these intervals is taken. `toppra.algorithm.TOPPRA` does so with a call from Python for each
program, which takes many times longer than solving it, and its torque constraint with one for each point; here both
passes are one compiled call, and all torques are computed in one call. The tests compare the passes with toppra's own.

This module is imported lazily: toppra, with scipy, takes a quarter of a second.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.base.lazy_import import defer_imports
from hplan.errors import TimingError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import GeometricPath, Limits

with defer_imports("matplotlib", "matplotlib.pyplot"):  # for toppra's plots only, which are not used here
    from toppra import constraint

logging.getLogger("toppra").setLevel(logging.ERROR)

#: Replaces a limit of zero in toppra's constraints, which only joints that do not move may have.
_ZERO_LIMIT = 1e-9

#: Constants of toppra: its bounds of u and x; its tolerances for a half-plane and for parallel lines; its weight of u
#: in the programs of the backward pass (among points with the same x, it selects a small u); the reduction of x in each
#: step of its forward pass against rounding errors; the tolerance of a start outside its interval; and how often x is
#: lowered if no u is found.
_BOUND, _KEPT, _PARALLEL, _LEAN, _DROP, _NEAR, _TRIES = 1e8, 1e-10, 1e-8, 1e-9, 1e-8, 1e-5, 10


def fastest_speed(path: GeometricPath, dynamics: InverseDynamics, limits: Limits, grid: FloatArray) -> FloatArray:
    """Time-optimal path speed ds/dt at the grid points, from rest to rest.

    Args:
        path: The path.
        dynamics: Inverse dynamics of the arm, for the torque limits.
        limits: Velocity, acceleration and, if given, torque limits.
        grid: (n,) increasing path parameters.

    Raises:
        TimingError: No motion within the limits exists; `cause` is toppra's code.
    """
    # toppra's tolerances are absolute: for a path shorter than 0.01 rad, the parameter is scaled so that ds/dt is about
    # 10.
    span = float(grid[-1] - grid[0])
    scale = 10.0 / np.sqrt(max(float(limits.acceleration.max()), _ZERO_LIMIT) * span) if span < 0.01 else 1.0
    scaled = scale * grid
    rows = half_planes(PathView(path, len(limits.velocity), scale), dynamics, limits, scaled)
    speed, _, _ = passes(rows, np.diff(scaled), np.zeros(2))
    return np.maximum(speed, 0.0) / scale


@dataclass(frozen=True)
class PathView:
    """Path with the interface of toppra's constraints.

    Its parameter is the path's times `scale`.
    """

    path: GeometricPath
    dof: int
    scale: float

    def __call__(self, positions: FloatArray, order: int = 0) -> FloatArray:
        """(n, dof) points or derivatives at (n,) parameters."""
        return self.path.evaluate(positions / self.scale, order) / self.scale**order


def half_planes(view: PathView, dynamics: InverseDynamics, limits: Limits, grid: FloatArray) -> FloatArray:
    """Constraints as half-planes a u + b x + c <= 0.

    Returns (n, 6 + m, 3) coefficients (a, b, c) at each grid point.

    The first four are the bounds of u and x; two are reserved for the interval of the next grid point. The last grid
    point has no interval after it, and therefore no limit of acceleration or torque.
    """
    half = 0.5 * np.diff(grid)
    middle = grid[:-1] + half
    bounds = np.tile([-_BOUND, _BOUND, -_BOUND, _BOUND], (len(grid), 1))
    velocity, acceleration = _constraints(limits.velocity.tobytes(), limits.acceleration.tobytes())
    bounds[:, 2:] = np.clip(velocity.compute_constraint_params(view, grid)[6], 0.0, _BOUND)
    fixed = np.zeros((len(grid), 6, 3))
    fixed[:, 0:4, 0], fixed[:, 0:4, 1] = (-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0)
    fixed[:, 0:4, 2] = bounds * (1.0, -1.0, 1.0, -1.0)
    found = [fixed]
    a, b, c = acceleration.compute_constraint_params(view, middle)[:3]
    linear = [(a, b, c, np.maximum(limits.acceleration, _ZERO_LIMIT))]
    if limits.torque is not None:
        # M(q) q' u + (M(q) q'' + C(q, q') q') x + g(q), in toppra's form.
        q, still = view(middle), np.zeros_like(a)
        gravity = dynamics.torques(q, still, still)
        inertia, moving = dynamics.torques(q, still, a) - gravity, dynamics.torques(q, a, b) - gravity
        linear.append((inertia, moving, gravity, np.maximum(limits.torque, _ZERO_LIMIT)))
    for a, b, c, limit in linear:
        planes = np.stack([a + 2.0 * half[:, None] * b, b, c], axis=2)
        for side in (1.0, -1.0):
            kept = side * planes
            kept[:, :, 2] -= limit
            last = np.zeros((1, *kept.shape[1:]))
            last[:, :, 2] = -limit
            found.append(np.concatenate([kept, last]))
    return np.concatenate(found, axis=1)


@lru_cache(maxsize=64)
def _constraints(
    velocity: bytes, acceleration: bytes
) -> tuple[constraint.JointVelocityConstraint, constraint.JointAccelerationConstraint]:
    """Velocity and acceleration constraints for toppra, cached.

    Each constructor writes a description of the limits, which is slow.
    """
    limits = [np.maximum(np.frombuffer(each), _ZERO_LIMIT) for each in (velocity, acceleration)]
    collocation = constraint.DiscretizationType.Collocation
    return constraint.JointVelocityConstraint(limits[0]), constraint.JointAccelerationConstraint(limits[1], collocation)


def passes(rows: FloatArray, steps: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Run both passes of toppra.

    Args:
        rows: (n, 6 + m, 3) half-planes, as from `half_planes`; two of each point are filled in.
        steps: (n - 1,) lengths of the grid's intervals.
        rates: (2,) path speeds at the ends.

    Returns:
        (n,) path speeds, (n - 1,) path accelerations and (n, 2) controllable sets of x.

    Raises:
        TimingError: No motion within the limits exists; `cause` is toppra's code.
    """
    sets, x, u = np.full((len(rows), 2), np.nan), np.full(len(rows), np.nan), np.zeros(len(rows) - 1)
    start, end = (float(rate) ** 2 for rate in rates)
    _controllable(rows, steps, end, sets)
    within = sets[0, 0] <= start + _NEAR and start <= sets[0, 1] + _NEAR
    if within:
        greedy(rows, steps, sets, start, x, u)
    if not np.isfinite(x).all():
        code = "ErrUnknown" if within else "FailUncontrollable"
        raise TimingError(f"toppra finds no motion along the path ({code})", cause=code)
    return np.sqrt(x), u, sets


@kernel
def _controllable(rows: FloatArray, steps: FloatArray, end: float, sets: FloatArray) -> None:
    """Backward pass: write the controllable interval of x at each grid point.

    An x in this interval can reach x = end.

    The minimum and the maximum x at each grid point are linear programs in (u, x), solved by adding one half-plane
    after the other (Seidel): if the current optimum is outside the next one, the new optimum lies on its border,
    between the half-planes before it. If a program is infeasible, the remaining intervals are left unchanged.
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
                # The border: its point nearest to the origin, plus t times (-b, a).
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
    """Forward pass: the maximum u at each grid point within the sets.

    The half-planes are those the backward pass has completed. As in toppra, x is lowered a few times if rounding leaves
    no feasible u. If none is found, the remaining x are left unchanged.
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
