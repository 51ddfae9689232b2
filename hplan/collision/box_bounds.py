"""Lower bounds of distances from oriented boxes grown by a radius.

Each shape lies in an oriented box grown by a radius. Projected on the axes of one of two boxes, the other one lies in a
box along these axes too, and the distance of two boxes with the same axes follows from their gap along each axis. This
distance minus both radii is at most the distance of the two shapes; the bound is the larger one of the two projections.
`hplan.collision.placed_bodies` places the joints, so a query does not wait for Pinocchio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.kernels import kernel
from hplan.collision.arm_pairs import ArmParts
from hplan.collision.flat_bodies import joints_alone
from hplan.collision.placed_bodies import place_joints
from hplan.errors import RobotFileError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot, made_once
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: Columns of a box: its rotation (row by row) and its centre in the frame of its joint; its half sizes; its radius; the
#: index of the joint that carries it, the number of joints for the base.
TURN, CENTRE, HALF, RADIUS, JOINT, COLUMNS = 0, 9, 12, 15, 16, 17

#: Radius of a box around an unbounded shape [m]: finite, so that an infinite distance may be subtracted from a bound.
ANYWHERE: Final = 1e300


@made_once
def joints_as_pinocchio(robot: Robot) -> FloatArray:
    """Joint numbers of a robot for kernels, verified against Pinocchio.

    Raises:
        RobotFileError: The kernels place a joint elsewhere than Pinocchio, so nothing could be proved about the robot.
    """
    numbers, data, frames = joints_alone(robot), robot.model.createData(), np.empty((robot.dof + 1, 12))
    for q in np.random.default_rng(0).uniform(robot.lower, robot.upper, (8, robot.dof)):
        place_joints(q, numbers, frames)
        pin.forwardKinematics(robot.model, data, q)
        for joint, place in enumerate(data.oMi.tolist()[1:]):
            off = np.abs(frames[joint] - np.append(place.rotation.ravel(), place.translation)).max()
            if not off <= 1e-9 * (1.0 + np.abs(place.translation).max()):
                reason = f"joint {robot.joint_names[joint]!r} is {off:.3g} from its placement in Pinocchio"
                raise RobotFileError(robot.urdf_path, reason)
    return numbers


def boxes_about(parts: ArmParts) -> FloatArray:
    """(bodies, COLUMNS) boxes around an arm's `all_shapes`, in their joints' frames."""
    dof, boxes = parts.robot.dof, np.zeros((len(parts.all_shapes), COLUMNS))
    for box, shape, bare in zip(boxes, parts.all_shapes, parts.bare_shapes, strict=True):
        centre, half = bare.core
        place: pin.SE3 = shape.placement
        box[TURN:CENTRE], box[CENTRE:HALF] = place.rotation.ravel(), place.act(centre)
        box[HALF:RADIUS], box[RADIUS] = half, bare.radius + bare.rounding
        box[JOINT] = (shape.parentJoint - 1) % (dof + 1)
    return frozen(boxes)


def boxes_about_solids(solids: Sequence[Solid], dof: int) -> FloatArray:
    """(n, COLUMNS) boxes around the obstacles, never too small by rounding errors."""
    boxes = np.zeros((len(solids), COLUMNS))
    boxes[:, JOINT] = dof
    boxes[:, TURN:CENTRE] = np.eye(3).ravel()
    capsules = [number for number, solid in enumerate(solids) if type(solid) is Capsule]
    for number, solid in enumerate(solids):
        box = boxes[number]
        if type(solid) is Sphere:
            box[CENTRE:HALF], box[RADIUS] = solid.center, solid.radius
        elif type(solid) is Capsule:
            box[CENTRE:HALF], box[HALF:RADIUS], box[RADIUS] = solid.start, solid.end, solid.radius
        elif isinstance(solid, Cloud) and len(solid.tree):
            box[CENTRE:HALF], box[RADIUS] = solid.tree[0, 3:6], solid.tree[0, 6] + solid.rounding
        elif type(solid) is Box:
            box[TURN:CENTRE], box[CENTRE:HALF] = solid.rotation.ravel(), solid.center
            box[HALF:RADIUS] = [0.5 * size for size in solid.size]
        elif type(solid) is Cylinder:
            box[TURN:CENTRE], box[CENTRE:HALF] = solid.rotation.ravel(), solid.center
            box[HALF:RADIUS] = solid.radius, solid.radius, 0.5 * solid.length
        else:
            core = solid.core
            low, high = core.min(axis=0), core.max(axis=0)
            box[CENTRE:HALF], box[HALF:RADIUS], box[RADIUS] = 0.5 * (low + high), 0.5 * (high - low), solid.rounding
    _stand_along(boxes, capsules)
    boxes[:, RADIUS] = boxes[:, RADIUS] * (1.0 + 1e-12) + 1e-12 * (1.0 + np.abs(boxes[:, CENTRE:RADIUS]).sum(axis=1))
    return boxes


def _stand_along(boxes: FloatArray, capsules: Sequence[int]) -> None:
    """Rotate boxes so that z points along their segments.

    On entry the columns of centre and half sizes hold both ends of the segment.
    """
    ends = boxes[capsules, CENTRE:RADIUS].reshape(-1, 2, 3)
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    length = np.sqrt((half * half).sum(axis=1))
    z = np.where(length[:, None] > 0.0, half / np.maximum(length, 1e-300)[:, None], [0.0, 0.0, 1.0])
    # Perpendicular to the segment and to the base axis least aligned with it.
    x = np.cross(z, np.eye(3)[np.abs(z).argmin(axis=1)])
    x /= np.sqrt((x * x).sum(axis=1))[:, None]
    boxes[capsules, TURN:CENTRE] = np.stack([x, np.cross(z, x), z], axis=2).reshape(-1, 9)
    boxes[capsules, CENTRE:HALF] = 0.5 * (ends[:, 0] + ends[:, 1])
    boxes[capsules, HALF:RADIUS] = np.column_stack([0.0 * length, 0.0 * length, length])


@kernel
def lower_bounds(q: FloatArray, pairs: IntArray, sides: IntArray, boxes: FloatArray, numbers: FloatArray) -> FloatArray:
    """(k,) lower bounds of the distances of pairs at a configuration [m].

    `apart` computes each bound.

    Args:
        pairs: (k,) indices of pairs.
        sides: (pairs, 2) indices of both boxes of each pair.
        numbers: Joint numbers from `hplan.collision.flat_bodies.joints_alone`.
    """
    frames, work, bounds = np.empty((len(q) + 1, 12)), np.empty((2, 12)), np.empty(len(pairs))
    place_joints(q, numbers, frames)
    for i in range(len(pairs)):
        bounds[i] = apart(frames, boxes, sides[pairs[i]], work)
    return bounds


@kernel
def apart(frames: FloatArray, boxes: FloatArray, both: IntArray, work: FloatArray) -> float:
    """Lower bound of two boxes' distance [m]; -`ANYWHERE` unless positive.

    Args:
        frames: (dof + 1, 12) frames of joints and base, as `place_joints` writes them.
        both: (2,) indices of the boxes.
        work: (2, 12) buffer for the rotations and centres of both.
    """
    for side in range(2):
        box, placed = boxes[both[side]], work[side]
        frame = frames[int(box[JOINT])]
        for r in range(3):
            x, y, z = frame[3 * r], frame[3 * r + 1], frame[3 * r + 2]
            for c in range(3):
                placed[3 * r + c] = x * box[c] + y * box[3 + c] + z * box[6 + c]
            placed[9 + r] = x * box[CENTRE] + y * box[CENTRE + 1] + z * box[CENTRE + 2] + frame[9 + r]
    largest = 0.0
    for side in range(2):
        one, other = work[side], work[1 - side]
        half, others = boxes[both[side]], boxes[both[1 - side]]
        x, y, z = other[9] - one[9], other[10] - one[10], other[11] - one[11]
        square = 0.0
        for i in range(3):
            u, v, w = one[i], one[3 + i], one[6 + i]
            beyond = abs(u * x + v * y + w * z) - half[HALF + i]
            for j in range(3):
                beyond -= abs(u * other[j] + v * other[3 + j] + w * other[6 + j]) * others[HALF + j]
            if beyond > 0.0:
                square += beyond * beyond
        largest = max(largest, square)
    # Rounding errors never make it too large.
    gap: float = math.sqrt(largest) * (1.0 - 1e-12) - (boxes[both[0], RADIUS] + boxes[both[1], RADIUS]) - 1e-12
    return gap if gap > 0.0 else -ANYWHERE
