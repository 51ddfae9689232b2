"""Time-optimal motion problem: constraints, first-order step, lower bound on the duration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.base.deadline import check_deadline, kernel_time_limit
from hplan.collision.compiled_bodies import thicker
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import piece_is_clear
from hplan.optimization.constraint_rows import NEAR_LIMIT, TorqueUse, torque_rows, with_rows
from hplan.optimization.first_order import MotionArrays, MotionLimits, clearance_cuts, first_order, least_time_scale
from hplan.optimization.interior_point import ProgramRows, solve_program
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.timed_spline import RESTING, BoundaryState, TimedSpline
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import Limits, rest_to_rest
from hplan.trajectory.retime import KEPT, torque_excess
from hplan.trajectory.spline import MovableSpline, blocked_pieces, pieces_are_clear

#: Fraction of the margin that the exact check of a step requires; the programs require all of it at their sample
#: points. If that is less than the distance [m], the check requires up to half of the margin: closer to contact a
#: certificate may fail.
_PROVED, _PROVABLE = 0.05, 3e-5


@dataclass(frozen=True, eq=False)
class TimeProblem(Record):
    """Constraints of a time-optimal motion.

    Attributes:
        field: Clearances to all obstacles.
        near: The clearances that programs use: without pairs that stay apart along the initial motion.
        options: Joint limits, movable joints and margin.
        limits: Velocity, acceleration, torque and jerk limits.
        dynamics: Inverse dynamics of the arm.
        rate_hz: Samples per second.
        ends: States at the start and at the end; None if both are at rest.
        sway: (moving bodies, dof) loss of each body's clearance by tracking errors, per unit of each joint's speed
            [m s/rad]; None if tracking errors do not depend on speed.
    """

    field: ClearanceField
    near: ClearanceField
    options: PostprocessOptions
    limits: Limits
    dynamics: InverseDynamics
    rate_hz: float
    ends: tuple[BoundaryState, BoundaryState] | None = None
    sway: FloatArray | None = None

    @cached_property
    def arrays(self) -> MotionLimits:
        """The limits for kernels."""
        limits, options = self.limits, self.options
        jerk = np.full_like(limits.velocity, np.inf) if limits.jerk is None else limits.jerk
        rates = np.stack([limits.velocity, limits.acceleration, jerk])
        sway = np.empty((0, len(options.lower))) if self.sway is None else self.sway
        return MotionLimits(options.lower, options.upper, rates, options.movable, sway)

    @property
    def proved_margin(self) -> float:
        """Clearance that the exact check of a step requires [m]."""
        margin = self.options.margin
        return max(_PROVED * margin, min(0.5 * margin, _PROVABLE))

    def is_clear(self, spline: TimedSpline) -> bool:
        """True if the whole motion is verified collision-free, tracking errors included."""
        if self.sway is not None:
            return self._is_clear_swaying(spline, self.sway)
        moved = MovableSpline(np.array(spline.control), spline.knots)
        clear = pieces_are_clear(moved, self.field.arrays, self.proved_margin)
        check_deadline()
        return bool(clear)

    def _is_clear_swaying(self, spline: TimedSpline, sway: FloatArray) -> bool:
        """True if each piece is clear with bodies inflated by tracking errors.

        The bodies grow by the tracking displacement bound at the piece's maximum velocity.
        """
        pieces, arrays = spline.path.pieces, self.field.arrays
        velocity = 3.0 * np.abs(np.diff(pieces, axis=1)) / np.diff(spline.path.breaks)[:, None, None]
        swayed = (velocity @ sway.T).max(axis=1)
        for piece, grown in zip(np.array(pieces), swayed, strict=True):
            bodies, pairs = thicker(arrays.bodies, arrays.pairs, grown)
            swollen = arrays._replace(bodies=bodies, pairs=pairs)
            clear = piece_is_clear(piece, swollen, self.proved_margin, 0.0)
            check_deadline()
            if not clear:
                return False
        return True

    def time_scale(self, spline: TimedSpline) -> float:
        """Time-scaling factor required by the velocity, acceleration and jerk limits."""
        time_scale = float(least_time_scale(np.array(spline.control), spline.knots, self.arrays))
        if spline.ends is None:
            return time_scale
        # The states at both ends are fixed, so the pieces there change their shape with the time scale. A factor below
        # 1 may therefore violate limits: only slowing down is applied.
        total, more = 1.0, time_scale
        # Maximum number of times the time scale is recomputed if the end states do not scale with it.
        for _ in range(4):
            if more <= 1.0:
                break
            total *= more
            slower = spline.at_time_scale(total)
            more = float(least_time_scale(np.array(slower.control), slower.knots, self.arrays))
        return total * max(1.0, more)

    def least_duration(self, turn: FloatArray, pieces: int) -> float:
        """Lower bound on a rest-to-rest spline's duration with equal pieces [s].

        Its accelerations are linear within a piece and start at 0, so none reaches its limit before the end of the
        first piece:
        a minimum-time motion with the corresponding jerk limit is at least as fast.

        Args:
            turn: (dof,) joint displacements.
            pieces: Number of pieces, all of the same duration.
        """
        limits, seconds = self.limits, 0.0
        jerk = self.arrays.rates[2]
        # Fixed-point iterations between the minimum duration of a spline and the duration of its pieces.
        for _ in range(4):
            growing = jerk if seconds == 0.0 else np.minimum(jerk, limits.acceleration * pieces / seconds)
            seconds = float(rest_to_rest(np.abs(turn), limits.velocity, limits.acceleration, growing).max())
        return seconds

    def torque_use(self, spline: TimedSpline) -> TorqueUse | None:
        """Use of the torque limits; None without torque limits."""
        limit = self.limits.torque
        return None if limit is None else TorqueUse.sample(spline, self.dynamics, limit)

    def torque_scale(self, spline: TimedSpline, allowed: float = 1.0) -> float:
        """Time-scaling factor required by the torque limits, at least 1.

        Args:
            allowed: The fraction of the torque limits that may be used.
        """
        use = self.torque_use(spline)
        if use is None or use.largest <= allowed:
            return 1.0
        return torque_excess(self.dynamics, use.states[0], use.use * use.limit, allowed / (1.0 + KEPT) * use.limit)

    def program(self, spline: TimedSpline, trust: float, *, least: float | None = None) -> ProgramRows:
        """Linear program of a step, to first order.

        Args:
            trust: Maximum change of a control point [rad].
            least: Minimum time scale; None for no minimum.
        """
        arrays, options = self.arrays, self.options
        rows = first_order(_arrays_of(spline), arrays, self.near.arrays, options.margin, trust)
        check_deadline()
        if least is not None:
            rows = with_rows(rows, _at_least(least))
        use = self.torque_use(spline)
        if use is not None and use.largest > NEAR_LIMIT:
            rows = with_rows(rows, torque_rows(use, spline, self.dynamics, arrays))
        return rows

    def solve(
        self, rows: ProgramRows, spline: TimedSpline, gap: tuple[float, float]
    ) -> tuple[FloatArray, float] | None:
        """Optimal step; None if the program has no solution.

        Args:
            rows: The program of a step from the spline.
            gap: Accuracy of the solution (`hplan.optimization.interior_point.solve_program`).

        Returns:
            (inner, movable) changes of the inner control points, and the time scale.
        """
        joints, inner = len(self.options.movable), len(spline.control) - 2 * RESTING
        found, unknowns = solve_program(rows, inner * joints, 4 * joints - 1, gap, kernel_time_limit())
        check_deadline()
        return (unknowns[:-1].reshape(inner, joints), float(unknowns[-1])) if found else None

    def cuts(self, moved: TimedSpline, change: FloatArray) -> ProgramRows | None:
        """Further rows for the program of a step that leads into contact; None if it is clear.

        Args:
            moved: The motion after the step, from rest to rest.
            change: (inner, movable) the step.
        """
        blocked = blocked_pieces(moved.path.pieces, self.field, self.proved_margin)
        if not blocked.any():
            return None
        motion, margin = _arrays_of(moved), self.options.margin
        rows = clearance_cuts(motion, change.ravel(), blocked, self.arrays, self.field.arrays, margin)
        check_deadline()
        return rows


def _arrays_of(spline: TimedSpline) -> MotionArrays:
    """A spline for kernels."""
    return MotionArrays(np.array(spline.control), spline.knots, spline.drift)


def _at_least(time_scale: float) -> ProgramRows:
    """Constraint row that requires a minimum time scale."""
    nothing = np.zeros(0, dtype=np.int32)
    alone = np.array([-1.0])
    return ProgramRows(np.zeros(2, dtype=np.int32), nothing, np.empty(0), alone, time_scale * alone, np.empty(0))
