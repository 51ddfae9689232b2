r"""Inverse dynamics of whole motions in one compiled call (recursive Newton-Euler).

The algorithm runs on Pinocchio's models. Outward from the base, each body's angular velocity :math:`\omega`, angular
acceleration :math:`\alpha` and the acceleration :math:`a` of its joint (gravity taken as an acceleration of the base)
follow from the parent's motion. Force and moment at the joint are

.. math:: f = m (a + \alpha \times c + \omega \times (\omega \times c)), \quad
    n = I \alpha + \omega \times I \omega + c \times f,

with mass m, centre c and inertia I about it; inward, each body's force and moment are added to its parent's, and the
torque is their component along the joint's axis. All quantities are in the frame of the body's own joint, as in
Pinocchio.

`pin.rnea` computes the same for one state; called from Python, the call costs more than the computation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, Record, readonly
from hplan.base.kernels import kernel

#: Pinocchio's joints with one axis that is fixed in the joint's own frame.
TURNING_JOINTS = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
SLIDING_JOINTS = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")

# Layout of a body's rows. In its parent's frame, a joint at q has the rotation FIXED + cos(q) EVEN + sin(q) ODD and the
# position PLACE + q SHIFT.
_FIXED = 0  # three rows
_EVEN = 3  # three rows
_ODD = 6  # three rows
_PLACE_COLUMN = 9
_SHIFT = 10
_TURN_COLUMN = 11  # rotation axis, or zeros
_SLIDE = 12  # sliding direction, or zeros
_CENTRE = 13  # the body's centre of mass
_INERTIA = 14  # three rows: inertia about the centre
_NUMBERS = 17  # mass, rotor inertia, parent's index (-1 for the base)


def joints_that_slide(model: pin.Model) -> tuple[bool, ...]:
    """Whether each joint of a model is prismatic: in metres, with forces."""
    return tuple(joint.shortname() in SLIDING_JOINTS for joint in model.joints.tolist()[1:])


def joint_axis(model: pin.Model, joint: int) -> tuple[FloatArray, bool]:
    """(3,) unit axis of a joint, and whether it is prismatic.

    The axis is in the joint's own frame.
    """
    moved = model.joints[joint]
    data = moved.createData()
    moved.calc(data, np.zeros(1))
    slide, turn = np.array(data.S, dtype=np.float64).reshape(2, 3)
    return (slide, True) if slide.any() else (turn, False)


@dataclass(frozen=True, eq=False)
class InverseDynamics(Record):
    """Pinocchio's model, with its joints and bodies as one flat array.

    Attributes:
        model: Pinocchio's model.
        bodies: (nv, 18, 3) each joint and its body; None if the model has joints without a single fixed axis; Pinocchio
            then computes the torques.
        sizes: (nv, 7) for each body: distance from its parent's joint to its own (at 0 if prismatic), distance of its
            centre from its joint, its mass, the maximum eigenvalue of its inertia about the centre, its parent's index
            (nv for the base), 1 if its joint is prismatic, else 0, and its rotor inertia; None together with `bodies`.
    """

    model: pin.Model
    bodies: FloatArray | None
    sizes: FloatArray | None

    @classmethod
    def build(cls, model: pin.Model) -> InverseDynamics:
        """Build the inverse dynamics of a model."""
        joints = model.joints.tolist()[1:]
        if any(joint.shortname() not in TURNING_JOINTS + SLIDING_JOINTS for joint in joints):
            return cls(model, None, None)
        bodies = [_body_of_joint(model, number, joint) for number, joint in enumerate(joints, start=1)]
        rows = readonly(np.array(bodies).reshape(-1, 18, 3))
        return cls(model, rows, _compute_sizes(rows))

    def torques(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Inverse dynamics: (n, nv) torques [N m].

        Args:
            q: (n, nq) positions.
            v: (n, nv) velocities.
            a: (n, nv) accelerations.
        """
        if self.bodies is None:
            data = self.model.createData()
            found = [pin.rnea(self.model, data, *row) for row in zip(q, v, a, strict=True)]
            return np.array(found).reshape(len(q), self.model.nv)
        torque = np.empty((len(q), len(self.bodies)))
        q, v, a = (np.ascontiguousarray(values, dtype=np.float64) for values in (q, v, a))
        newton_euler(q, v, a, self.bodies, np.array(self.model.gravity.linear), torque)
        return torque

    def gravity(self, q: FloatArray) -> FloatArray:
        """(n, nv) torques that hold (n, nq) positions at rest [N m]."""
        rest = np.zeros((len(q), self.model.nv))
        return self.torques(q, rest, rest)


def _body_of_joint(model: pin.Model, number: int, joint: pin.JointModel) -> FloatArray:
    """(18, 3) rows of one joint and its body."""
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    slide, turn = np.array(data.S).reshape(2, 3)
    place, inertia = model.jointPlacements[number], model.inertias[number]
    rows = np.zeros((18, 3))
    # Rodrigues' formula; for a prismatic joint it reduces to the fixed rotation.
    along = np.outer(turn, turn) if turn.any() else np.eye(3)
    rows[_FIXED : _FIXED + 3] = place.rotation @ along
    rows[_EVEN : _EVEN + 3] = place.rotation @ (np.eye(3) - along)
    rows[_ODD : _ODD + 3] = place.rotation @ pin.skew(turn)
    rows[_PLACE_COLUMN], rows[_SHIFT] = place.translation, place.rotation @ slide
    rows[_TURN_COLUMN], rows[_SLIDE] = turn, slide
    rows[_CENTRE], rows[_INERTIA : _INERTIA + 3] = inertia.lever, inertia.inertia
    rows[_NUMBERS] = inertia.mass, model.armature[number - 1], model.parents[number] - 1
    return rows


def _compute_sizes(bodies: FloatArray) -> FloatArray:
    """Compute `InverseDynamics.sizes` from its `bodies`."""
    parent = bodies[:, _NUMBERS, 2]
    columns = (
        np.linalg.norm(bodies[:, _PLACE_COLUMN], axis=1),
        np.linalg.norm(bodies[:, _CENTRE], axis=1),
        bodies[:, _NUMBERS, 0],
        np.linalg.norm(bodies[:, _INERTIA : _INERTIA + 3], ord=2, axis=(1, 2)),
        np.where(parent < 0.0, len(bodies), parent),
        bodies[:, _SLIDE].any(axis=1),
        np.abs(bodies[:, _NUMBERS, 1]),
    )
    return readonly(np.column_stack(columns))


@kernel
def newton_euler(
    q: FloatArray, v: FloatArray, a: FloatArray, bodies: FloatArray, gravity: FloatArray, torque: FloatArray
) -> None:
    """Write the (n, nv) torques of (n, nv) positions, velocities and accelerations."""
    count = bodies.shape[0]
    turn = np.empty((count, 3, 3))  # rotation to the parent's frame
    arm = np.empty((count, 3))  # from the parent's joint to this one, in the parent's frame
    # Per body, with the base last: angular velocity, angular acceleration, acceleration; then force and moment.
    motion = np.empty((count + 1, 3, 3))
    load = np.empty((count, 2, 3))
    given, swing, momentum = np.empty((3, 3)), np.empty(3), np.empty(3)
    for c in range(3):
        motion[count, 0, c], motion[count, 1, c], motion[count, 2, c] = 0.0, 0.0, -gravity[c]
    for row in range(q.shape[0]):
        for i in range(count):
            body, own, above = bodies[i], motion[i], motion[int(bodies[i, _NUMBERS, 2])]
            cos, sin, speed, push = math.cos(q[row, i]), math.sin(q[row, i]), v[row, i], a[row, i]
            for r in range(3):
                arm[i, r] = body[_PLACE_COLUMN, r] + q[row, i] * body[_SHIFT, r]
                for c in range(3):
                    turn[i, r, c] = body[_FIXED + r, c] + cos * body[_EVEN + r, c] + sin * body[_ODD + r, c]
            # The parent's motion at this joint, rotated into this joint's frame.
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                swing[c] = above[0, d] * arm[i, e] - above[0, e] * arm[i, d]
                given[0, c], given[1, c] = above[0, c], above[1, c]
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                given[2, c] = above[2, c] + above[1, d] * arm[i, e] - above[1, e] * arm[i, d]
                given[2, c] += above[0, d] * swing[e] - above[0, e] * swing[d]
            for k in range(3):
                for c in range(3):
                    own[k, c] = turn[i, 0, c] * given[k, 0] + turn[i, 1, c] * given[k, 1] + turn[i, 2, c] * given[k, 2]
            # Contribution of the joint itself.
            for c in range(3):
                own[0, c] += speed * body[_TURN_COLUMN, c]
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                own[1, c] += push * body[_TURN_COLUMN, c]
                own[1, c] += speed * (own[0, d] * body[_TURN_COLUMN, e] - own[0, e] * body[_TURN_COLUMN, d])
                own[2, c] += push * body[_SLIDE, c]
                own[2, c] += 2.0 * speed * (own[0, d] * body[_SLIDE, e] - own[0, e] * body[_SLIDE, d])
                swing[c] = own[0, d] * body[_CENTRE, e] - own[0, e] * body[_CENTRE, d]
                momentum[c] = 0.0
                for r in range(3):
                    momentum[c] += body[_INERTIA + c, r] * own[0, r]
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                at_centre = own[2, c] + own[1, d] * body[_CENTRE, e] - own[1, e] * body[_CENTRE, d]
                at_centre += own[0, d] * swing[e] - own[0, e] * swing[d]
                load[i, 0, c] = body[_NUMBERS, 0] * at_centre
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                load[i, 1, c] = own[0, d] * momentum[e] - own[0, e] * momentum[d]
                load[i, 1, c] += body[_CENTRE, d] * load[i, 0, e] - body[_CENTRE, e] * load[i, 0, d]
                for r in range(3):
                    load[i, 1, c] += body[_INERTIA + c, r] * own[1, r]
        for i in range(count - 1, -1, -1):
            body, parent = bodies[i], int(bodies[i, _NUMBERS, 2])
            torque[row, i] = body[_NUMBERS, 1] * a[row, i]
            for c in range(3):
                torque[row, i] += body[_SLIDE, c] * load[i, 0, c] + body[_TURN_COLUMN, c] * load[i, 1, c]
            if parent < 0:
                continue
            for k in range(2):
                for c in range(3):
                    given[k, c] = 0.0
                    for r in range(3):
                        given[k, c] += turn[i, c, r] * load[i, k, r]
            for c in range(3):
                d, e = (c + 1) % 3, (c + 2) % 3
                load[parent, 0, c] += given[0, c]
                load[parent, 1, c] += given[1, c] + arm[i, d] * given[0, e] - arm[i, e] * given[0, d]
