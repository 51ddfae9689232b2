"""Body placements at a configuration: forward kinematics in one compiled call."""

from __future__ import annotations

import math

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.collision import flat_bodies as flat

#: Columns of a placed body: centre of its ball from `CENTRE` on, start and vector of its axis from `START` and `ALONG`
#: on; and the number of columns.
CENTRE, START, ALONG, PLACED = 0, 3, 6, 9


@kernel
def place_joints(q: FloatArray, numbers: FloatArray, frames: FloatArray) -> None:
    """Write the frames of joints and base at a configuration.

    (dof + 1, 12) or wider: for each frame its rotation, row by row, and its position.
    """
    dof, joints = int(numbers[flat.DOF]), int(numbers[flat.JOINTS])
    for c in range(12):
        frames[dof, c] = 1.0 if c == 0 or c == 4 or c == 8 else 0.0
    for j in range(dof):
        at = joints + flat.JOINT_SIZE * j
        below, here = frames[int(numbers[at + flat.PARENT])], frames[j]
        cos, sin, value = math.cos(q[j]), math.sin(q[j]), q[j]
        for c in range(3):
            # A column of the joint's rotation in its parent's frame, then rotated by the parent.
            x, y, z = (
                numbers[at + c] + cos * numbers[at + 9 + c] + sin * numbers[at + 18 + c],
                numbers[at + 3 + c] + cos * numbers[at + 12 + c] + sin * numbers[at + 21 + c],
                numbers[at + 6 + c] + cos * numbers[at + 15 + c] + sin * numbers[at + 24 + c],
            )
            for r in range(3):
                here[3 * r + c] = below[3 * r] * x + below[3 * r + 1] * y + below[3 * r + 2] * z
        x = numbers[at + flat.PLACE] + value * numbers[at + flat.SHIFT]
        y = numbers[at + flat.PLACE + 1] + value * numbers[at + flat.SHIFT + 1]
        z = numbers[at + flat.PLACE + 2] + value * numbers[at + flat.SHIFT + 2]
        for r in range(3):
            here[9 + r] = below[9 + r] + below[3 * r] * x + below[3 * r + 1] * y + below[3 * r + 2] * z


@kernel
def place_bodies(
    q: FloatArray, movers: FloatArray, numbers: FloatArray, frames: FloatArray, placed: FloatArray
) -> None:
    """Write the (dof + 1, 12) frames and the body placements.

    The frames of all joints and, last, of the base.
    """
    place_joints(q, numbers, frames)
    for b in range(placed.shape[0]):
        frame, body = frames[int(movers[b, flat.JOINT])], movers[b]
        for r in range(3):
            x, y, z = frame[3 * r], frame[3 * r + 1], frame[3 * r + 2]
            placed[b, CENTRE + r] = (
                frame[9 + r] + x * body[flat.BALL] + y * body[flat.BALL + 1] + z * body[flat.BALL + 2]
            )
            placed[b, START + r] = (
                frame[9 + r] + x * body[flat.AXIS] + y * body[flat.AXIS + 1] + z * body[flat.AXIS + 2]
            )
            placed[b, ALONG + r] = x * body[flat.AXIS + 3] + y * body[flat.AXIS + 4] + z * body[flat.AXIS + 5]
