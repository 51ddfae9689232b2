"""Twists of joint frames, and speed and acceleration bounds of body points."""

from __future__ import annotations

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.collision import flat_bodies as flat
from hplan.geometry.vectors import cross

#: Columns of a moving frame: after the pose the angular velocity of the bodies that the joint carries, and the velocity
#: of their point at the origin; and the number of columns.
TWIST, MOVING = 12, 18

#: Represents an unbounded acceleration.
_UNBOUNDED = 1e300


@kernel
def motion_bends(
    rates: FloatArray, changes: FloatArray, movers: FloatArray, numbers: FloatArray, bends: FloatArray
) -> None:
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
        movers: Moving bodies, as in `hplan.collision.flat_bodies.FlatBodies`.
        numbers: Joint and hull data, as in `hplan.collision.flat_bodies.FlatBodies`.
        bends: (bodies, 2) output.
    """
    at, first, dof = int(numbers[flat.REACHES]), int(numbers[flat.JOINTS]), len(rates)
    for k in range(movers.shape[0]):
        speed, bend, turning = 0.0, 0.0, 0.0
        for j in range(dof):
            reach = numbers[at + dof * k + j]
            if reach > 0.0:
                own = first + flat.JOINT_SIZE * j + flat.TURN
                turns = numbers[own] != 0.0 or numbers[own + 1] != 0.0 or numbers[own + 2] != 0.0
                rate = abs(rates[j])
                speed += reach * rate
                bend += reach * (abs(changes[j]) + 2.0 * turning * rate)
                if turns:
                    bend += reach * rate * rate
                    turning += rate
        if k >= int(numbers[flat.BODIES]) and not _is_carried(movers, numbers, k):
            bend = _UNBOUNDED
        bends[k, 0], bends[k, 1] = speed, bend


@kernel
def _is_carried(movers: FloatArray, numbers: FloatArray, k: int) -> bool:
    """True if the joint of a pair's inner body carries the outer."""
    dof, joints = int(numbers[flat.DOF]), int(numbers[flat.JOINTS])
    inner = int(movers[int(movers[k, flat.INNER]), flat.JOINT])
    j = int(movers[int(movers[k, flat.OUTER]), flat.JOINT])
    while j != inner and j < dof:
        j = int(numbers[joints + flat.JOINT_SIZE * j + flat.PARENT])
    return j == inner


@kernel
def find_twists(rates: FloatArray, numbers: FloatArray, frames: FloatArray) -> None:
    """Write the twists of the joints behind their frames.

    `frames` is (dof + 1, MOVING). `rates` are the (dof,) joint rates; the base has a zero twist.
    """
    for c in range(TWIST, MOVING):
        frames[len(rates), c] = 0.0
    joints = int(numbers[flat.JOINTS])
    for j in range(len(rates)):
        own = joints + flat.JOINT_SIZE * j
        below, rate = int(numbers[own + flat.PARENT]), rates[j]
        tx, ty, tz = numbers[own + flat.TURN], numbers[own + flat.TURN + 1], numbers[own + flat.TURN + 2]
        for c in range(TWIST, MOVING):
            frames[j, c] = frames[below, c]
        if tx == 0.0 and ty == 0.0 and tz == 0.0:
            for r in range(3):
                for c in range(3):
                    frames[j, TWIST + 3 + r] += rate * frames[below, 3 * r + c] * numbers[own + flat.SHIFT + c]
        else:
            axis = (
                rate * (frames[j, 0] * tx + frames[j, 1] * ty + frames[j, 2] * tz),
                rate * (frames[j, 3] * tx + frames[j, 4] * ty + frames[j, 5] * tz),
                rate * (frames[j, 6] * tx + frames[j, 7] * ty + frames[j, 8] * tz),
            )
            moved = cross((frames[j, 9], frames[j, 10], frames[j, 11]), axis)
            for c in range(3):
                frames[j, TWIST + c] += axis[c]
                frames[j, TWIST + 3 + c] += moved[c]
