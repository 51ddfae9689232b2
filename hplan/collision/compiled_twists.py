"""Twists of joint frames, and speed and acceleration bounds of body points."""

from __future__ import annotations

from hplan.base.arrays import FloatArray, TableArray
from hplan.base.kernels import kernel
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.geometry.vectors import cross

#: Columns of a moving frame: after the pose the angular velocity of the bodies that the joint carries, and the velocity
#: of their point at the origin; and the number of columns.
TWIST, MOVING = 12, 18

#: Represents an unbounded acceleration.
_UNBOUNDED_ACCELERATION = 1e300


@kernel
def motion_bends(rates: FloatArray, changes: FloatArray, field: FieldArrays, bends: FloatArray) -> None:
    r"""Write upper bounds of moving bodies' point speeds and accelerations.

    A point at :math:`p` has :math:`\ddot p = \sum_j \partial_j p \, \ddot q_j + \sum_{ij} \partial_{ij} p \, \dot q_i
    \dot q_j`. Of two joints let j be the one nearer to the body. The velocity :math:`\partial_j p`, no longer than j's
    motion-bound coefficient, is rotated about the axis of i at unit rate: :math:`\partial_{ij} p = a_i \times
    \partial_j p`
    is no longer either, and zero if i is prismatic. Relative to a body that carries another, only the joints between
    them
    count.

    Args:
        rates: (dof,) upper bounds of the joint rates.
        changes: (dof,) upper bounds of the joint accelerations.
        field: The arm; its obstacles do not matter.
        bends: (bodies + pairs, 2) output.
    """
    bodies, pairs, joints, reaches = field.bodies, field.pairs, field.joints, field.reaches
    for k in range(len(bodies) + len(pairs)):
        speed, bend, turning = 0.0, 0.0, 0.0
        for j in range(len(rates)):
            reach = reaches[k, j]
            if reach > 0.0:
                rate = abs(rates[j])
                speed += reach * rate
                bend += reach * (abs(changes[j]) + 2.0 * turning * rate)
                if not joints[j].slides:
                    bend += reach * rate * rate
                    turning += rate
        if k >= len(bodies):
            pair = pairs[k - len(bodies)]
            if not _is_carried(bodies[pair.outer].joint, bodies[pair.inner].joint, joints):
                bend = _UNBOUNDED_ACCELERATION
        bends[k, 0], bends[k, 1] = speed, bend


@kernel
def _is_carried(outer: int, inner: int, joints: TableArray) -> bool:
    """True if the joint of a pair's inner body carries the outer's."""
    while outer != inner and outer < len(joints):
        outer = joints[outer].parent
    return outer == inner


@kernel
def find_twists(rates: FloatArray, joints: TableArray, frames: FloatArray) -> None:
    """Write the twists of the joints behind their frames.

    `frames` is (dof + 1, MOVING). `rates` are the (dof,) joint rates; the base has a zero twist.
    """
    for c in range(TWIST, MOVING):
        frames[len(rates), c] = 0.0
    for j in range(len(rates)):
        joint, rate = joints[j], rates[j]
        below, turn, shift = joint.parent, joint.axis, joint.shift
        for c in range(TWIST, MOVING):
            frames[j, c] = frames[below, c]
        if joint.slides:
            for r in range(3):
                for c in range(3):
                    frames[j, TWIST + 3 + r] += rate * frames[below, 3 * r + c] * shift[c]
        else:
            axis = (
                rate * (frames[j, 0] * turn[0] + frames[j, 1] * turn[1] + frames[j, 2] * turn[2]),
                rate * (frames[j, 3] * turn[0] + frames[j, 4] * turn[1] + frames[j, 5] * turn[2]),
                rate * (frames[j, 6] * turn[0] + frames[j, 7] * turn[1] + frames[j, 8] * turn[2]),
            )
            moved = cross((frames[j, 9], frames[j, 10], frames[j, 11]), axis)
            for c in range(3):
                frames[j, TWIST + c] += axis[c]
                frames[j, TWIST + 3 + c] += moved[c]
