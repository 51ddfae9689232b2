"""Torque limits to first order about a timed spline, as rows of a linear program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.optimization.first_order import MotionLimits
from hplan.optimization.interior_point import ProgramRows
from hplan.optimization.timed_spline import RESTING, TimedSpline
from hplan.robot.dynamics import InverseDynamics

#: Torques below this fraction of their limits are left out of a program.
NEAR_LIMIT = 0.75

#: Fraction of the limits that may be used: between the times looked at, torque is a little higher.
ALLOWED = 0.995

#: Fraction of the limits that is left for motion where gravity takes all of it, so that there is a slow one.
_LEFT = 0.05

#: Times looked at in each piece.
_TIMES = 2

#: Step of the differences, in rad, rad/s and rad/s^2.
_DIFFERENCE = 1e-5


@dataclass(frozen=True, eq=False)
class TorqueUse:
    """Torques of a motion at some times.

    Attributes:
        clock: (times,) the times [s].
        states: (3, times, dof) positions, velocities and accelerations.
        use: (times, dof) torques as fractions of their limits.
        limit: (dof,) the limits [N m].
    """

    clock: FloatArray
    states: FloatArray
    use: FloatArray
    limit: FloatArray

    @classmethod
    def of(cls, spline: TimedSpline, dynamics: InverseDynamics, limit: FloatArray) -> TorqueUse:
        """The torques at `_TIMES` of each piece."""
        clock = spline.clock(_TIMES)
        states = np.stack([spline.path.evaluate(clock, order) for order in range(3)])
        return cls(clock, states, dynamics.torques(*states) / limit, limit)

    @property
    def largest(self) -> float:
        """Largest use of a limit."""
        return float(np.abs(self.use).max(initial=0.0))


def torque_rows(found: TorqueUse, spline: TimedSpline, dynamics: InverseDynamics, limits: MotionLimits) -> ProgramRows:
    """A row for each torque near its limit: `ALLOWED` of it may be used."""
    limit = found.limit
    times, joints = np.nonzero(np.abs(found.use) > NEAR_LIMIT)
    movable = limits.movable
    at, which = np.unique(times, return_inverse=True)
    states, sign = found.states[:, at], np.sign(found.use[times, joints])
    derivatives = np.empty((3, len(movable), len(at), len(limit)))
    for order in range(3):
        for number, joint in enumerate(movable.tolist()):
            changed = np.array(states)
            changed[order, :, joint] += _DIFFERENCE
            derivatives[order, number] = (dynamics.torques(*changed) / limit - found.use[at]) / _DIFFERENCE
    picked = sign * derivatives[:, :, which, joints]  # (3, movable, rows)
    basis = [spline.weights(found.clock[times], order) for order in range(3)]
    blocks = sum(picked[order].T[:, None, :] * basis[order][:, RESTING:-RESTING, None] for order in range(3))
    drift = spline.drift[:, movable]
    # Slower by the time scale s, what is not gravity's is over s^2: times s^2, the torque is kept where that part is at
    # most s^2 times what gravity leaves; the tangent at s = 1 lies below.
    gravity = sign * (dynamics.gravity(states[0]) / limit)[which, joints]
    room = np.maximum(ALLOWED - gravity, _LEFT)
    by_time_scale = -2.0 * room
    if drift.any():
        by_time_scale += sum(np.einsum("mr,rm->r", picked[order], basis[order] @ drift) for order in range(3))
    upper = room + gravity - np.abs(found.use[times, joints]) + by_time_scale
    return rows_of(np.asarray(blocks), by_time_scale, upper)


def rows_of(blocks: FloatArray, by_time_scale: FloatArray, upper: FloatArray) -> ProgramRows:
    """Rows of one side, by (rows, inner, movable) entries of the changes of the inner control points."""
    from scipy import sparse

    matrix = sparse.csr_matrix(blocks.reshape(len(blocks), blocks.shape[1] * blocks.shape[2]))
    return ProgramRows(matrix.indptr, matrix.indices, matrix.data, by_time_scale, upper, np.empty(0))


def with_rows(rows: ProgramRows, more: ProgramRows) -> ProgramRows:
    """A program with more rows, all of one side, at its end."""
    return ProgramRows(
        np.concatenate([rows.starts, rows.starts[-1] + more.starts[1:]]),
        np.concatenate([rows.columns, more.columns]),
        np.concatenate([rows.entries, more.entries]),
        np.concatenate([rows.time_scale, more.time_scale]),
        np.concatenate([rows.upper, more.upper]),
        rows.lower,
    )
