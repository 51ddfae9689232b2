"""Body placements at a configuration: forward kinematics in one compiled call."""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, TableArray
from hplan.base.kernels import kernel

#: Columns of a placed body: centre of its ball, start and vector of its axis segment.
PLACED = np.dtype([("centre", np.float64, 3), ("start", np.float64, 3), ("along", np.float64, 3)], align=True)


@kernel
def place_joints(q: FloatArray, joints: TableArray, frames: FloatArray) -> None:
    """Write the frames of joints and base at a configuration.

    (dof + 1, 12) or wider: for each frame its rotation, row by row, and its position.
    """
    dof = len(joints)
    for c in range(12):
        frames[dof, c] = 1.0 if c == 0 or c == 4 or c == 8 else 0.0
    for j in range(dof):
        joint = joints[j]
        below, here = frames[joint.parent], frames[j]
        constant, cosine, sine, position, shift = joint.constant, joint.cosine, joint.sine, joint.position, joint.shift
        cos, sin, value = math.cos(q[j]), math.sin(q[j]), q[j]
        for c in range(3):
            # A column of the joint's rotation in its parent's frame, then rotated by the parent.
            x, y, z = (
                constant[c] + cos * cosine[c] + sin * sine[c],
                constant[3 + c] + cos * cosine[3 + c] + sin * sine[3 + c],
                constant[6 + c] + cos * cosine[6 + c] + sin * sine[6 + c],
            )
            for r in range(3):
                here[3 * r + c] = below[3 * r] * x + below[3 * r + 1] * y + below[3 * r + 2] * z
        x = position[0] + value * shift[0]
        y = position[1] + value * shift[1]
        z = position[2] + value * shift[2]
        for r in range(3):
            here[9 + r] = below[9 + r] + below[3 * r] * x + below[3 * r + 1] * y + below[3 * r + 2] * z


@kernel
def place_bodies(q: FloatArray, bodies: TableArray, joints: TableArray, frames: FloatArray, placed: TableArray) -> None:
    """Write the (dof + 1, 12) frames and the body placements.

    The frames of all joints and, last, of the base.
    """
    place_joints(q, joints, frames)
    for b in range(len(bodies)):
        body, here = bodies[b], placed[b]
        frame = frames[body.joint]
        for r in range(3):
            x, y, z = frame[3 * r], frame[3 * r + 1], frame[3 * r + 2]
            here.centre[r] = frame[9 + r] + x * body.ball[0] + y * body.ball[1] + z * body.ball[2]
            here.start[r] = frame[9 + r] + x * body.axis_start[0] + y * body.axis_start[1] + z * body.axis_start[2]
            here.along[r] = x * body.axis_vector[0] + y * body.axis_vector[1] + z * body.axis_vector[2]
