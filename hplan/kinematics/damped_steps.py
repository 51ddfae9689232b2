"""Multi-start inverse kinematics by damped least squares, in one compiled call.

The error consists of the position error and the rotation vector of the remaining rotation, both in `base_link`; with a
free rotation, only the rotation that aligns the z axes. Each step solves the normal equations with Levenberg-Marquardt
damping, which increases if a step makes the error larger. Joints at a limit that a step would exceed are fixed in it.

If the solution is not unique, the result is near the start: up to the damping, steps lie in the row space of the
Jacobian. Tracking a frame along a line in short steps therefore moves the joints without a jump (`follow`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, TableArray
from hplan.base.kernels import kernel
from hplan.collision.compiled_placements import place_joints

#: Tolerances of a reached pose [m, rad].
PLACE_M, TURN_RAD = 1e-7, 1e-7

#: Maximum number of steps from one start.
_STEPS = 100

#: Initial damping, its factors after a step that helps and one that does not, and the maximum before a start fails.
_DAMPING, _LESS, _MORE, _MOST = 1e-3, 0.2, 8.0, 1e9

#: Minimum damping, against a singular matrix.
_LEAST = 1e-12

#: Constrained components of a frame's pose: all; all but the rotation about its z axis; position only; or only the
#: direction of its z axis, up to an angle.
KEPT, ABOUT_Z, ANY_TURN, UPRIGHT = 0.0, 1.0, 2.0, 3.0

#: A frame tilted too far is brought to within this fraction of the permitted angle.
_TILT_FRACTION = 0.9


class Chain(NamedTuple):
    """Robot and pose constraint, as arrays.

    Attributes:
        joints: Joints from `hplan.collision.compiled_bodies.joint_table`.
        moves: (dof,) 1 for joints that may move and carry the frame, else 0.
        lower: (dof,) lower limits.
        upper: (dof,) upper limits.
        carrier: (1,) index of the joint that carries the frame; `dof` for the base.
        placement: (12,) the frame on its joint: rotation matrix, row by row, and position [m].
        pose: (12,) target pose in `base_link`, in the same format.
        free_turn: (2,) `KEPT`, `ABOUT_Z`, `ANY_TURN` or `UPRIGHT`; maximum tilt of the z axis for the last one [rad].
    """

    joints: TableArray
    moves: FloatArray
    lower: FloatArray
    upper: FloatArray
    carrier: FloatArray
    placement: FloatArray
    pose: FloatArray
    free_turn: FloatArray


@kernel
def solve_all(starts: FloatArray, chain: Chain, solutions: FloatArray, found: BoolArray) -> None:
    """Solve from each of (k, dof) starts.

    Args:
        starts: (k, dof) start configurations.
        chain: Robot and target pose.
        solutions: (k, dof) final configurations; written.
        found: (k,) whether the pose is reached; written.
    """
    for row in range(starts.shape[0]):
        write(starts[row], solutions[row])
        found[row] = solve(chain, solutions[row])


@kernel
def solve_each(starts: FloatArray, poses: FloatArray, chain: Chain, solutions: FloatArray, found: BoolArray) -> None:
    """Solve from each start with a pose of its own.

    Args:
        starts: (k, dof) start configurations.
        poses: (k, 12) target poses.
        chain: The robot; its pose is overwritten.
        solutions: (k, dof) final configurations; written.
        found: (k,) whether the pose is reached; written.
    """
    for row in range(starts.shape[0]):
        write(poses[row], chain.pose)
        write(starts[row], solutions[row])
        found[row] = solve(chain, solutions[row])


@kernel
def draw_back(
    goals: FloatArray, distances: FloatArray, most: FloatArray, chain: Chain, rows: FloatArray, reached: IntArray
) -> None:
    """Retract the frame from configurations along its z axis, by short steps.

    The chain defines whether the frame keeps its rotation about the axis; its pose is overwritten.

    Args:
        goals: (k, dof) configurations.
        distances: (m,) distances of retraction, increasing from 0 [m].
        most: (m, dof) maximum change of each joint in the step up to each distance.
        chain: The robot.
        rows: (k, m, dof) the configurations; those beyond `reached` repeat the last one.
        reached: (k,) number of reached distances.
    """
    frames, tool, back = np.empty((goals.shape[1] + 1, 12)), np.empty(12), np.empty(3)
    poses = np.empty((distances.shape[0], 12))
    for k in range(goals.shape[0]):
        write(goals[k], rows[k, 0])
        place_frame(chain, goals[k], frames, tool)
        for r in range(3):
            back[r] = -tool[3 * r + 2]
        for i in range(distances.shape[0]):
            write(tool, poses[i])
            for r in range(3):
                poses[i, 9 + r] = tool[9 + r] + distances[i] * back[r]
        reached[k] = follow(poses, most, goals[k], 0.0, chain, rows[k])


@kernel
def follow(
    poses: FloatArray, most: FloatArray, towards: FloatArray, drawn: float, chain: Chain, rows: FloatArray
) -> int:
    """Track a sequence of poses; return the number of reached poses.

    Each configuration is solved from the previous one.

    Args:
        poses: (m, 12) poses, in the format of the chain's pose, which is overwritten.
        most: (m, dof) maximum change of each joint in the step up to each pose.
        towards: (dof,) configuration that joints also move to if `drawn` is 1, by an equal part of the rest with each
            step.
        drawn: 1 to move towards that configuration, 0 not to.
        chain: The robot.
        rows: (m, dof) the configurations; the first is the input, those not reached repeat the last reached one.
    """
    count = len(poses)
    reached = count
    for i in range(1, count):
        write(rows[i - 1], rows[i])
        if i >= reached:
            continue
        for j in range(rows.shape[1]):
            if chain.moves[j] > 0.0:
                rows[i, j] += drawn * (towards[j] - rows[i, j]) / (count - i)
        write(poses[i], chain.pose)
        kept = solve(chain, rows[i])
        for j in range(rows.shape[1]):
            kept = kept and abs(rows[i, j] - rows[i - 1, j]) <= most[i, j]
        if not kept:
            reached = i
            write(rows[i - 1], rows[i])
    return reached


@kernel
def write(source: FloatArray, target: FloatArray) -> None:
    """Copy numbers, without an assignment of slices.

    Numba would compile the shape check of the assignment, with its message, which takes time.
    """
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def solve(chain: Chain, q: FloatArray) -> bool:
    """Move a (dof,) configuration until the frame is at the pose.

    Returns whether the pose was reached.
    """
    dof = q.shape[0]
    lower, upper = chain.lower, chain.upper
    frames, error, jacobian = np.empty((dof + 1, 12)), np.empty(6), np.empty((6, dof))
    tried, tried_error, tried_jacobian = np.empty(dof), np.empty(6), np.empty((6, dof))
    matrix, step, pull = np.empty((dof, dof)), np.empty(dof), np.empty(dof)
    damping = _DAMPING
    linearise(chain, q, frames, error, jacobian)
    for _ in range(_STEPS):
        if is_there(error):
            return True
        for j in range(dof):
            pull[j] = 0.0
            for r in range(6):
                pull[j] += jacobian[r, j] * error[r]
        for j in range(dof):
            at_limit = (q[j] >= upper[j] and pull[j] > 0.0) or (q[j] <= lower[j] and pull[j] < 0.0)
            if at_limit:
                pull[j] = 0.0
                for r in range(6):
                    jacobian[r, j] = 0.0
        normal_matrix(jacobian, damping, matrix)
        cholesky_solve(matrix, pull, step)
        for j in range(dof):
            tried[j] = min(max(q[j] + step[j], lower[j]), upper[j])
        linearise(chain, tried, frames, tried_error, tried_jacobian)
        if sum_of_squares(tried_error) < sum_of_squares(error):
            write(tried, q)
            write(tried_error, error)
            for r in range(6):
                write(tried_jacobian[r], jacobian[r])
            damping = max(damping * _LESS, _LEAST)
        else:
            damping *= _MORE
            if damping > _MOST:
                return False
    return is_there(error)


@kernel
def is_there(error: FloatArray) -> bool:
    """True if the (6,) error is within the tolerances."""
    place = error[0] * error[0] + error[1] * error[1] + error[2] * error[2]
    turn = error[3] * error[3] + error[4] * error[4] + error[5] * error[5]
    return bool(place <= PLACE_M * PLACE_M and turn <= TURN_RAD * TURN_RAD)


@kernel
def sum_of_squares(error: FloatArray) -> float:
    """Sum of the squares of (6,) numbers."""
    total = 0.0
    for r in range(6):
        total += error[r] * error[r]
    return total


@kernel
def normal_matrix(jacobian: FloatArray, damping: float, matrix: FloatArray) -> None:
    """Write the (dof, dof) matrix of the damped normal equations."""
    dof = matrix.shape[0]
    for i in range(dof):
        for j in range(dof):
            total = 0.0
            for r in range(6):
                total += jacobian[r, i] * jacobian[r, j]
            matrix[i, j] = total
        matrix[i, i] += damping


@kernel
def cholesky_solve(matrix: FloatArray, right: FloatArray, solution: FloatArray) -> None:
    """Solve a symmetric positive definite system.

    The matrix is overwritten by its Cholesky factor.
    """
    count = matrix.shape[0]
    for i in range(count):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(total, 1e-300)) if i == j else total / matrix[j, j]
    for i in range(count):
        total = right[i]
        for k in range(i):
            total -= matrix[i, k] * solution[k]
        solution[i] = total / matrix[i, i]
    for i in range(count - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, count):
            total -= matrix[k, i] * solution[k]
        solution[i] = total / matrix[i, i]


@kernel
def linearise(chain: Chain, q: FloatArray, frames: FloatArray, error: FloatArray, jacobian: FloatArray) -> None:
    """Write joint frames, the (6,) pose error and the (6, dof) Jacobian."""
    joints, moves, pose, given = chain.joints, chain.moves, chain.pose, chain.free_turn[0]
    free, turned, placed = given in (ABOUT_Z, UPRIGHT), given != ANY_TURN, given != UPRIGHT
    tool = np.empty(12)
    place_frame(chain, q, frames, tool)
    for r in range(3):
        error[r], error[3 + r] = (pose[9 + r] - tool[9 + r] if placed else 0.0), 0.0
    if turned:
        turn_left(tool, pose, free, error)
    if not placed:
        lean = math.sqrt(sum_of_squares(error))
        for r in range(3, 6):
            error[r] = (
                error[r] * (1.0 - _TILT_FRACTION * chain.free_turn[1] / lean) if lean > chain.free_turn[1] else 0.0
            )
    zx, zy, zz = tool[2], tool[5], tool[8]
    for j in range(q.shape[0]):
        for r in range(6):
            jacobian[r, j] = 0.0
        if moves[j] == 0.0:
            continue
        joint, frame = joints[j], frames[j]
        below, axis = frames[joint.parent], joint.axis
        if joint.slides:
            if not placed:
                continue
            ax, ay, az = joint.shift[0], joint.shift[1], joint.shift[2]
            for r in range(3):
                jacobian[r, j] = below[3 * r] * ax + below[3 * r + 1] * ay + below[3 * r + 2] * az
            continue
        ax, ay, az = axis[0], axis[1], axis[2]
        x = frame[0] * ax + frame[1] * ay + frame[2] * az
        y = frame[3] * ax + frame[4] * ay + frame[5] * az
        z = frame[6] * ax + frame[7] * ay + frame[8] * az
        px, py, pz = tool[9] - frame[9], tool[10] - frame[10], tool[11] - frame[11]
        if placed:
            jacobian[0, j], jacobian[1, j], jacobian[2, j] = y * pz - z * py, z * px - x * pz, x * py - y * px
        if not turned:
            continue
        along = zx * x + zy * y + zz * z if free else 0.0
        jacobian[3, j], jacobian[4, j], jacobian[5, j] = x - along * zx, y - along * zy, z - along * zz


@kernel
def place_frame(chain: Chain, q: FloatArray, frames: FloatArray, tool: FloatArray) -> None:
    """Write the frames of all joints and the chain's (12,) pose."""
    placement = chain.placement
    place_joints(q, chain.joints, frames)
    carrier = frames[int(chain.carrier[0])]
    for r in range(3):
        for c in range(3):
            tool[3 * r + c] = (
                carrier[3 * r] * placement[c]
                + carrier[3 * r + 1] * placement[3 + c]
                + carrier[3 * r + 2] * placement[6 + c]
            )
        tool[9 + r] = carrier[9 + r] + (
            carrier[3 * r] * placement[9] + carrier[3 * r + 1] * placement[10] + carrier[3 * r + 2] * placement[11]
        )


@kernel
def turn_left(tool: FloatArray, pose: FloatArray, free: bool, error: FloatArray) -> None:
    """Write the rotation vector from one frame to another, in `base_link`.

    It is written to the last three of the (6,) numbers of `error`.

    Args:
        tool: (12,) present pose.
        pose: (12,) target pose.
        free: Whether only the z axes are to be aligned.
        error: (6,) numbers; changed.
    """
    if free:
        # The shortest rotation of one z axis to the other.
        x = tool[5] * pose[8] - tool[8] * pose[5]
        y = tool[8] * pose[2] - tool[2] * pose[8]
        z = tool[2] * pose[5] - tool[5] * pose[2]
        cosine = tool[2] * pose[2] + tool[5] * pose[5] + tool[8] * pose[8]
        sine = math.sqrt(x * x + y * y + z * z)
        if sine < 1e-12 and cosine < 0.0:  # opposite: rotate about any perpendicular axis
            error[3], error[4], error[5] = math.pi * tool[0], math.pi * tool[3], math.pi * tool[6]
            return
        angle = math.atan2(sine, cosine)
    else:
        # The rotation pose tool^T; twice the sine times its axis is its skew part.
        x, y, z, trace = 0.0, 0.0, 0.0, 0.0
        for c in range(3):
            x += 0.5 * (pose[6 + c] * tool[3 + c] - pose[3 + c] * tool[6 + c])
            y += 0.5 * (pose[c] * tool[6 + c] - pose[6 + c] * tool[c])
            z += 0.5 * (pose[3 + c] * tool[c] - pose[c] * tool[3 + c])
            trace += pose[c] * tool[c] + pose[3 + c] * tool[3 + c] + pose[6 + c] * tool[6 + c]
        sine = math.sqrt(x * x + y * y + z * z)
        angle = math.atan2(sine, 0.5 * (trace - 1.0))
        if sine < 1e-12 and trace < 0.0:  # half a turn: about any axis, to be nearer in the next step
            error[3], error[4], error[5] = math.pi * tool[0], math.pi * tool[3], math.pi * tool[6]
            return
    scale = angle / sine if sine > 1e-12 else 1.0
    error[3], error[4], error[5] = scale * x, scale * y, scale * z
