"""Linearized constraints on torques: rows of the linear program of a timed spline."""

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

#: Usable fraction of the torque limits: between the sample times torque is slightly higher.
ALLOWED = 0.995

#: Fraction of the limits left for motion if gravity uses all of them, so that a slow motion exists.
_LEFT = 0.05

#: Number of sample times in each piece.
_TORQUE_TIMES = 2

#: Step of the finite differences, in rad, rad/s and rad/s^2.
_DIFFERENCE = 1e-5


@dataclass(frozen=True, eq=False)
class TorqueUse:
    """Torques of a motion at sample times.

    Attributes:
        clock: (times,) the times [s].
        states: (3, times, dof) positions, velocities and accelerations.
        use: (times, dof) torques as fractions of their limits.
        limit: (dof,) torque limits [N m].
    """

    clock: FloatArray
    states: FloatArray
    use: FloatArray
    limit: FloatArray

    @classmethod
    def sample(cls, spline: TimedSpline, dynamics: InverseDynamics, limit: FloatArray) -> TorqueUse:
        """Torques at `_TORQUE_TIMES` sample times of each piece."""
        clock = spline.clock(_TORQUE_TIMES)
        states = np.stack([spline.path.evaluate(clock, order) for order in range(3)])
        return cls(clock, states, dynamics.torques(*states) / limit, limit)

    @property
    def largest(self) -> float:
        """Maximum use of a torque limit, as a fraction."""
        return float(np.abs(self.use).max(initial=0.0))


def torque_rows(found: TorqueUse, spline: TimedSpline, dynamics: InverseDynamics, limits: MotionLimits) -> ProgramRows:
    """One constraint row for each torque near its limit: at most `ALLOWED`."""
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
    # With the time scale s, the part of the torque without gravity scales by 1/s^2. Multiplied by s^2, the limit holds
    # if that part is at most s^2 times the torque that gravity leaves; the tangent at s = 1 is a lower bound on it.
    gravity = sign * (dynamics.gravity(states[0]) / limit)[which, joints]
    room = np.maximum(ALLOWED - gravity, _LEFT)
    by_time_scale = -2.0 * room
    if drift.any():
        by_time_scale += sum(np.einsum("mr,rm->r", picked[order], basis[order] @ drift) for order in range(3))
    upper = room + gravity - np.abs(found.use[times, joints]) + by_time_scale
    return rows_of(np.asarray(blocks), by_time_scale, upper)


def rows_of(blocks: FloatArray, by_time_scale: FloatArray, upper: FloatArray) -> ProgramRows:
    """One-sided constraint rows from (rows, inner, movable) coefficients."""
    from scipy import sparse

    matrix = sparse.csr_matrix(blocks.reshape(len(blocks), blocks.shape[1] * blocks.shape[2]))
    return ProgramRows(matrix.indptr, matrix.indices, matrix.data, by_time_scale, upper, np.empty(0))


def with_rows(rows: ProgramRows, more: ProgramRows) -> ProgramRows:
    """Append one-sided constraint rows to a program."""
    return ProgramRows(
        np.concatenate([rows.starts, rows.starts[-1] + more.starts[1:]]),
        np.concatenate([rows.columns, more.columns]),
        np.concatenate([rows.entries, more.entries]),
        np.concatenate([rows.time_scale, more.time_scale]),
        np.concatenate([rows.upper, more.upper]),
        rows.lower,
    )
