r"""Fastest motion of independent joints from a state in motion to rest at a goal, all arriving together.

The motion is a cubic B-spline with pieces of equal duration h. Each joint makes a step :math:`s_k` from one control
point to the next. Velocity and acceleration limits bound the steps and their changes,

.. math:: |s_k| \le h \bar v, \quad |s_k - s_{k-1}| \le h^2 \bar a,

and pieces of at least :math:`2 \bar a / \bar\jmath` keep the jerk limits. The largest steps to rest after n pieces are
bounded by full acceleration from the state, by the velocity limit and by full braking to the end; the smallest steps
by the mirror image. A joint that accelerates near its velocity limit brakes in the first piece, so that the velocity
stays within the limit between the control points. All constraints are convex, so a combination of both reaches any
position between their ends. The motion has the minimum number of pieces that lets each joint reach its goal.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.base.kernels import inline, kernel
from hplan.optimization.minimize_time import LONGEST_MOTION_S
from hplan.optimization.timed_spline import BoundaryState, TimedSpline, even_breaks
from hplan.robot.limits import Limits

#: Minimum duration of a piece [s]. Shorter ones change the acceleration more abruptly and take longer to verify.
_PIECE_S = 0.02

#: Minimum number of pieces that are longer than this [s]: fewer take up to 1.7 times as long as a program's motion.
_FEWEST_PIECES = 8
_COARSE_S = 0.1

#: A joint that accelerates near its velocity limit may exceed it by this fraction: half of what certificates allow.
_EXCESS = 5e-4


def fastest_arrival(state: BoundaryState, goal: FloatArray, limits: Limits, rate_hz: float) -> TimedSpline | None:
    """Fastest motion from a state to rest at a goal, in free space and without torque limits.

    None if it takes too long, if low jerk limits leave it too few pieces, or if a joint accelerates so near its
    velocity limit that it exceeds it. Its pieces meet at samples.

    Args:
        state: State at the start, within the limits.
        goal: (dof,) configuration at the end [rad].
        limits: Velocity, acceleration and jerk limits.
        rate_hz: Samples per second.

    Examples:
        >>> still, one = BoundaryState.at_rest(np.zeros(1)), np.ones(1)
        >>> motion = fastest_arrival(still, one, Limits(one, one), 250.0)
        >>> round(motion.duration, 3), motion.positions(np.array([0.0, motion.duration])).tolist()
        (2.02, [[0.0], [1.0]])
    """
    piece_s = _PIECE_S if limits.jerk is None else max(_PIECE_S, float((2.0 * limits.acceleration / limits.jerk).max()))
    rows = max(1, math.ceil(piece_s * rate_hz - 1e-9))
    task = np.stack([state.position, state.velocity, state.acceleration, goal, limits.velocity, limits.acceleration])
    rows, steps = _fastest_steps(task, rows, rate_hz, int(LONGEST_MOTION_S * rate_hz / rows))
    is_coarse = rows / rate_hz > _COARSE_S and len(steps) < _FEWEST_PIECES
    if len(steps) == 0 or is_coarse:
        return None
    breaks = even_breaks(len(steps) * rows / rate_hz, len(steps))
    knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
    control = np.concatenate([state.controls((rows / rate_hz, rows / rate_hz)), steps])
    control[3:] = control[2] + np.cumsum(steps, axis=0)
    return TimedSpline(frozen(control), frozen(knots)).with_ends((state, BoundaryState.at_rest(goal)))


@kernel
def _fastest_steps(task: FloatArray, rows: int, rate_hz: float, most: int) -> tuple[int, FloatArray]:
    """Steps between the control points of the fastest motion.

    Args:
        task: (6, dof) position, velocity and acceleration at the start, position at the end, and the limits of velocity
            and acceleration.
        rows: Minimum number of samples in a piece. Numbers up to twice this one are tried.
        rate_hz: Samples per second.
        most: Maximum number of pieces.

    Returns:
        The number of samples in a piece, and (pieces, dof) the steps after the third control point, the last two 0;
        no steps if the motion would have more than the maximum number of pieces.
    """
    found, pieces = rows, 0
    for each in range(rows, 2 * rows):
        joints = _in_pieces(task, each / rate_hz)
        low = 2  # a number that does not suffice
        for j in range(len(joints)):
            low = max(low, math.ceil(abs(joints[j, 0]) / joints[j, 2]))
            if joints[j, 0] - joints[j, 2] > joints[j, 4] or joints[j, 0] + joints[j, 2] < joints[j, 5]:
                low = most  # no braking keeps the velocity limit
        high = low + 1
        while high <= most and not _are_reached(joints, high):
            low, high = high, 2 * high
        while high - low > 1 and high <= 2 * most:
            middle = (low + high) // 2
            if _are_reached(joints, middle):
                high = middle
            else:
                low = middle
        if high <= most and (pieces == 0 or high * each < pieces * found):
            found, pieces = each, high
    steps, joints = np.zeros((pieces, task.shape[1])), _in_pieces(task, found / rate_hz)
    for j in range(len(joints)):
        least, largest = _totals(joints[j], pieces)
        part = (joints[j, 1] - least) / (largest - least) if largest > least else 0.0
        for number in range(1, pieces - 1):
            low_step, high_step = _bounds(joints[j], pieces, number)
            steps[number - 1, j] = low_step + part * (high_step - low_step)
    return found, steps


@kernel
def _in_pieces(task: FloatArray, piece_s: float) -> FloatArray:
    """(dof, 6) step before the third control point, turn after it, and limits.

    They are those of changes of steps, of steps, and the largest and the smallest next step.
    """
    joints = np.empty((task.shape[1], 6))
    for j in range(len(joints)):
        change = piece_s**2 * task[2, j]
        joints[j, 0] = piece_s * task[1, j] + 0.5 * change
        joints[j, 1] = task[3, j] - (task[0, j] + piece_s * task[1, j] + change / 3.0)
        joints[j, 2], joints[j, 3] = piece_s**2 * task[5, j], piece_s * task[4, j]
        joints[j, 4], joints[j, 5] = np.inf, -np.inf
        sign, push = math.copysign(1.0, task[2, j]), abs(task[2, j])
        room = (1.0 + _EXCESS) * task[4, j] - sign * task[1, j]
        if 0.5 * piece_s * push > room:
            # The acceleration is linear within the piece: if it falls by f, the velocity grows by
            # a^2 h / (2 f).
            fall = 0.5 * piece_s * push**2 / room if room > 0.0 else np.inf
            joints[j, 4 if sign > 0.0 else 5] = joints[j, 0] + sign * piece_s**2 * (push - fall)
    return joints


@inline
def _bounds(joint: FloatArray, pieces: int, number: int) -> tuple[float, float]:
    """Smallest and largest step with a number, counted from 1."""
    rest = (pieces - 1 - number) * joint[2]
    slower = max(joint[0] - number * joint[2], joint[5] - (number - 1) * joint[2])
    faster = min(joint[0] + number * joint[2], joint[4] + (number - 1) * joint[2])
    return max(slower, min(-joint[3], faster), -rest), min(faster, max(joint[3], slower), rest)


@kernel
def _totals(joint: FloatArray, pieces: int) -> tuple[float, float]:
    """Sums of the smallest and of the largest steps."""
    least, largest = 0.0, 0.0
    for number in range(1, pieces - 1):
        low, high = _bounds(joint, pieces, number)
        least += low
        largest += high
    return least, largest


@kernel
def _are_reached(joints: FloatArray, pieces: int) -> bool:
    """True if each joint can reach its goal with a number of pieces."""
    for joint in joints:
        least, largest = _totals(joint, pieces)
        if not least <= joint[1] <= largest:
            return False
    return True
