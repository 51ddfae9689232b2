r"""toppra with limits at the middle of each grid interval, and its two passes compiled.

Between grid points the path acceleration :math:`u = \ddot s` is constant and :math:`x = \dot s^2` linear in s. A
limit of the form :math:`|a u + b x + c| \le g` enforced at grid points (collocation) is passed in between, and
enforced at both ends of each interval (interpolation) leaves some of it unused everywhere; both errors are of the
order of the spacing. Enforced at the middle, where :math:`x_m = x_i + \Delta s \, u`, the error alternates in sign
and its average over an interval is of second order. The rows of a trajectory are such averages
(`hplan.trajectory.retime`), so there the limits are used in full and kept to within a fraction that timing then takes
back.

toppra's constraints state the problem: in their canonical form they give half-planes of (u, x). From the end backward,
the set of x from which the end can be reached is an interval, whose two ends are linear programs in two variables;
forward, the largest u that stays in these intervals is taken. `toppra.algorithm.TOPPRA` does so with a call from Python
for each program, which takes many times what solving it takes, and its constraint of torque with one for each point;
here both passes are one compiled call, and torques come from one. The tests hold the passes against toppra's own.

This module is imported lazily: toppra, with scipy, takes a quarter of a second.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.base.lazy_import import deferred
from hplan.errors import TimingError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import GeometricPath, Limits

with deferred("matplotlib", "matplotlib.pyplot"):  # toppra wants it for plots that nobody asks for here
    from toppra import constraint

logging.getLogger("toppra").setLevel(logging.ERROR)

#: What toppra is given for a limit of zero, which only joints that do not move may have.
_TINY = 1e-9

#: toppra's bounds of u and x, its tolerances of a half-plane and of parallel lines, its weight of u in the programs of
#: the backward pass (of points with the same x, one with small u), what its forward pass takes from x at each step
#: against rounding, by how much a start may miss its interval, and how often x is lowered where no u is found.
_BOUND, _KEPT, _PARALLEL, _LEAN, _DROP, _NEAR, _TRIES = 1e8, 1e-10, 1e-8, 1e-9, 1e-8, 1e-5, 10


def fastest_speed(path: GeometricPath, dynamics: InverseDynamics, limits: Limits, grid: FloatArray) -> FloatArray:
    """Path speed ds/dt at the grid points of the fastest motion from rest to rest.

    Args:
        limits: Velocity, acceleration and, where given, torque limits.
        grid: (n,) increasing path parameters.

    Raises:
        TimingError: There is no motion within the limits; `cause` is toppra's code.
    """
    # toppra's tolerances are absolute; where a path is shorter than 0.01 rad, a longer parameter brings ds/dt to
    # about 10.
    span = float(grid[-1] - grid[0])
    scale = 10.0 / np.sqrt(max(float(limits.acceleration.max()), _TINY) * span) if span < 0.01 else 1.0
    scaled = scale * grid
    rows = half_planes(PathView(path, len(limits.velocity), scale), dynamics, limits, scaled)
    speed, _, _ = passes(rows, np.diff(scaled), np.zeros(2))
    return np.maximum(speed, 0.0) / scale


@dataclass(frozen=True)
class PathView:
    """A path as toppra's constraints ask for it; its parameter is the path's times `scale`."""

    path: GeometricPath
    dof: int
    scale: float

    def __call__(self, positions: FloatArray, order: int = 0) -> FloatArray:
        """Points or derivatives at (n,) parameters, (n, dof)."""
        return self.path.evaluate(positions / self.scale, order) / self.scale**order


def half_planes(view: PathView, dynamics: InverseDynamics, limits: Limits, grid: FloatArray) -> FloatArray:
    """(n, 6 + m, 3) half-planes a u + b x + c <= 0 at each grid point.

    Four are the bounds of u and x, two are left for the interval of the next grid point. The last grid point has no
    interval after it, and so no limit of acceleration or torque.
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
    linear = [(a, b, c, np.maximum(limits.acceleration, _TINY))]
    if limits.torque is not None:
        # M(q) q' u + (M(q) q'' + C(q, q') q') x + g(q), in toppra's form.
        q, still = view(middle), np.zeros_like(a)
        gravity = dynamics.torques(q, still, still)
        inertia, moving = dynamics.torques(q, still, a) - gravity, dynamics.torques(q, a, b) - gravity
        linear.append((inertia, moving, gravity, np.maximum(limits.torque, _TINY)))
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
    """Those of toppra for limits of velocity and acceleration; each writes a text of them, which takes long."""
    limits = [np.maximum(np.frombuffer(each), _TINY) for each in (velocity, acceleration)]
    collocation = constraint.DiscretizationType.Collocation
    return constraint.JointVelocityConstraint(limits[0]), constraint.JointAccelerationConstraint(limits[1], collocation)


def passes(rows: FloatArray, steps: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Both of toppra's passes: (n,) path speeds, (n - 1,) path accelerations and (n, 2) controllable sets of x.

    Args:
        rows: (n, 6 + m, 3) half-planes, as `half_planes` gives them; two of each point are filled in.
        steps: (n - 1,) lengths of the grid's intervals.
        rates: (2,) path speeds at the ends.

    Raises:
        TimingError: There is no motion within the limits; `cause` is toppra's code.
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
