"""Lower bounds of distances from oriented boxes grown by a radius.

Each shape lies in an oriented box grown by a radius. Projected on the axes of one of two boxes, the other one lies in a
box along these axes too, and the distance of two boxes with the same axes follows from their gap along each axis. This
distance minus both radii is at most the distance of the two shapes; the bound is the larger one of the two projections.
A cloud's box says little, as the floor and a branch overhead are in one: its points bound the distance, found in its
tree of balls. The box of a hull says little beside it: `hull_separation` takes the hull itself.
`hplan.collision.compiled_placements` places the joints, so a query does not wait for Pinocchio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray, TableArray, frozen
from hplan.base.kernels import inline, kernel
from hplan.collision.coal_arm import ArmParts
from hplan.collision.coal_cloud import SPECK_RADIUS_M
from hplan.collision.compiled_bodies import joint_table
from hplan.collision.compiled_clearance import pose_of
from hplan.collision.compiled_placements import place_joints
from hplan.errors import RobotFileError
from hplan.geometry.cloud import Cloud
from hplan.geometry.convex_distance import NEAREST, NO_TABLE, Wanted, core_distance, corner_table, plane_of_separation
from hplan.geometry.planes import is_behind
from hplan.geometry.sweep import STILL
from hplan.geometry.vectors import Vector, sub
from hplan.robot.model import Robot, made_once
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: Columns of a box: its rotation (row by row) and its centre in the frame of its joint; its half sizes; its radius; the
#: index of the joint that carries it, the number of joints for the base.
BOX = np.dtype(
    [
        ("rotation", np.float64, 9),
        ("centre", np.float64, 3),
        ("half", np.float64, 3),
        ("radius", np.float64),
        ("joint", np.int64),
    ],
    align=True,
)

#: A ball of a cloud's tree at least this fraction of the minimum distance away is not opened, and bounds the distance.
_NEARLY: Final = 0.9

#: Relative tolerances of distances from a leaf as a whole, and from a point.
_ROUGH: Final = 1e-2
_FINE: Final = 1e-3

#: Spans and corners of hulls, as in `PairBoxes`, and those without clouds.
Hulls: TypeAlias = tuple[IntArray, FloatArray]
NO_HULLS: Final[Hulls] = frozen(np.zeros((0, 3), dtype=np.int64)), frozen(np.empty(0))

#: Radius of a box around an unbounded shape [m]: finite, so that an infinite distance may be subtracted from a bound.
ANYWHERE: Final = 1e300


class PairBoxes(NamedTuple):
    """Boxes of all pairs of a checker, and the clouds in them.

    Attributes:
        boxes: (n,) the boxes.
        sides: (pairs, 2) indices of both boxes of each pair.
        trees: (n, 2) first node of the cloud in each box, and one past its last; the same if there is none.
        nodes: (m, 7) trees of the clouds, as in `hplan.geometry.cloud.Cloud`, one after the other.
        points: (3 k,) coordinates of their points [m].
        spans: (bodies, 3) range of the corners of the hull in each body's box, and its table, as `Span`; the same ends
            if the box, grown by its radius, is the body. Empty without clouds.
        corners: Coordinates of the hulls' corners in the frames of their joints, and tables.
    """

    boxes: TableArray
    sides: IntArray
    trees: IntArray
    nodes: FloatArray
    points: FloatArray
    spans: IntArray
    corners: FloatArray

    @classmethod
    def join(
        cls, bodies: TableArray, hulls: Hulls, solids: Sequence[Solid], boxes: TableArray, sides: IntArray
    ) -> PairBoxes:
        """Join the boxes of an arm's bodies with those of solids, and the clouds among these."""
        trees = np.zeros((len(bodies) + len(solids), 2), dtype=np.int64)
        nodes, points, first, begin = [np.empty((0, 7))], [np.empty(0)], 0, 0
        for number, solid in enumerate(solids, start=len(bodies)):
            if isinstance(solid, Cloud) and len(solid.tree):
                trees[number] = first, first + len(solid.tree)
                nodes.append(solid.tree + np.array([begin, begin, first, 0.0, 0.0, 0.0, 0.0]))
                points.append(solid.core.ravel())
                first, begin = first + len(solid.tree), begin + len(solid.core)
        joined = frozen(np.concatenate([bodies, boxes]))
        return cls(joined, sides, frozen(trees), frozen(np.concatenate(nodes)), frozen(np.concatenate(points)), *hulls)


@made_once
def joints_as_pinocchio(robot: Robot) -> TableArray:
    """Joints of a robot for kernels, verified against Pinocchio.

    Raises:
        RobotFileError: The kernels place a joint elsewhere than Pinocchio, so nothing could be proved about the robot.
    """
    joints, data, frames = joint_table(robot), robot.model.createData(), np.empty((robot.dof + 1, 12))
    for q in np.random.default_rng(0).uniform(robot.lower, robot.upper, (8, robot.dof)):
        place_joints(q, joints, frames)
        pin.forwardKinematics(robot.model, data, q)
        for joint, place in enumerate(data.oMi.tolist()[1:]):
            off = np.abs(frames[joint] - np.append(place.rotation.ravel(), place.translation)).max()
            if not off <= 1e-9 * (1.0 + np.abs(place.translation).max()):
                reason = f"joint {robot.joint_names[joint]!r} is {off:.3g} from its placement in Pinocchio"
                raise RobotFileError(robot.urdf_path, reason)
    return joints


def boxes_about(parts: ArmParts) -> TableArray:
    """(bodies,) boxes around an arm's `all_shapes`, in their joints' frames."""
    dof, boxes = parts.robot.dof, np.zeros(len(parts.all_shapes), BOX)
    for box, shape, bare in zip(boxes, parts.all_shapes, parts.bare_shapes, strict=True):
        centre, half = bare.core
        place: pin.SE3 = shape.placement
        box["rotation"], box["centre"] = place.rotation.ravel(), place.act(centre)
        box["half"], box["radius"] = half, bare.radius + bare.rounding
        box["joint"] = (shape.parentJoint - 1) % (dof + 1)
    return frozen(boxes)


def hulls_in_boxes(parts: ArmParts) -> Hulls:
    """Hulls in the boxes around an arm's `all_shapes`: `spans` and `corners`, as in `PairBoxes`."""
    spans, corners, first = np.zeros((len(parts.all_shapes), 3), dtype=np.int64), [np.empty(0)], 0
    for span, shape, bare in zip(spans, parts.all_shapes, parts.bare_shapes, strict=True):
        if isinstance(bare.geometry, coal.ConvexBase):
            hull = bare.corners @ shape.placement.rotation.T + shape.placement.translation
            end = first + hull.size
            table = corner_table(hull, first, end)
            span[:] = first, end, end if len(table) else 0
            corners += [hull.ravel(), table]
            first = end + len(table)
    return frozen(spans), frozen(np.concatenate(corners))


def boxes_about_solids(solids: Sequence[Solid], dof: int) -> TableArray:
    """(n,) boxes around the obstacles as coal has them, never too small by rounding errors."""
    boxes = np.zeros(len(solids), BOX)
    boxes["joint"], boxes["rotation"] = dof, np.eye(3).ravel()
    capsules = [number for number, solid in enumerate(solids) if type(solid) is Capsule]
    for number, solid in enumerate(solids):
        box = boxes[number]
        if type(solid) is Sphere:
            box["centre"], box["radius"] = solid.center, solid.radius
        elif type(solid) is Capsule:
            box["radius"] = solid.radius
        elif type(solid) is Box:
            box["rotation"], box["centre"] = solid.rotation.ravel(), solid.center
            box["half"] = [0.5 * size for size in solid.size]
        elif type(solid) is Cylinder:
            box["rotation"], box["centre"] = solid.rotation.ravel(), solid.center
            box["half"] = solid.radius, solid.radius, 0.5 * solid.length
        else:
            core = solid.core
            low, high = core.min(axis=0), core.max(axis=0)
            box["centre"], box["half"] = 0.5 * (low + high), 0.5 * (high - low)
            box["radius"] = SPECK_RADIUS_M if isinstance(solid, Cloud) else solid.rounding
    _stand_along(boxes, capsules, np.array([solids[k].core for k in capsules]))
    size = np.abs(np.concatenate([boxes["centre"], boxes["half"]], axis=1)).sum(axis=1)
    boxes["radius"] = boxes["radius"] * (1.0 + 1e-12) + 1e-12 * (1.0 + size)
    return boxes


def _stand_along(boxes: TableArray, capsules: Sequence[int], ends: FloatArray) -> None:
    """Place boxes, by index, so that z points along their segments.

    `ends` holds both ends of each segment.
    """
    ends = ends.reshape(-1, 2, 3)
    half = 0.5 * (ends[:, 1] - ends[:, 0])
    length = np.sqrt((half * half).sum(axis=1))
    z = np.where(length[:, None] > 0.0, half / np.maximum(length, 1e-300)[:, None], [0.0, 0.0, 1.0])
    # Perpendicular to the segment and to the base axis least aligned with it.
    x = np.cross(z, np.eye(3)[np.abs(z).argmin(axis=1)])
    x /= np.sqrt((x * x).sum(axis=1))[:, None]
    boxes["rotation"][capsules] = np.stack([x, np.cross(z, x), z], axis=2).reshape(-1, 9)
    boxes["centre"][capsules] = 0.5 * (ends[:, 0] + ends[:, 1])
    boxes["half"][capsules] = np.column_stack([0.0 * length, 0.0 * length, length])


@kernel
def lower_bounds(q: FloatArray, pairs: IntArray, boxes: PairBoxes, joints: TableArray) -> FloatArray:
    """(k,) lower bounds of the distances of pairs at a configuration [m].

    `box_separation` computes each bound.

    Args:
        pairs: (k,) indices of pairs.
        joints: Joints from `joints_as_pinocchio`.
    """
    frames, work, bounds = np.empty((len(q) + 1, 12)), np.empty((2, 12)), np.empty(len(pairs))
    place_joints(q, joints, frames)
    for i in range(len(pairs)):
        bounds[i] = box_separation(frames, boxes, pairs[i], work)
    return bounds


@kernel
def box_separation(frames: FloatArray, all_boxes: PairBoxes, pair: int, work: FloatArray) -> float:
    """Lower bound of the distance of a pair [m]; -`ANYWHERE` unless positive.

    Args:
        frames: (dof + 1, 12) frames of joints and base, as `place_joints` writes them.
        all_boxes: The boxes of all pairs.
        pair: Index of the pair.
        work: (2, 12 or more) buffer for the rotations and centres of both.
    """
    boxes, both = all_boxes.boxes, all_boxes.sides[pair]
    for side in range(2):
        _place_box(frames, boxes, both[side], work[side])
    largest = 0.0
    for side in range(2):
        one, other = work[side], work[1 - side]
        half, others = boxes[both[side]].half, boxes[both[1 - side]].half
        x, y, z = other[9] - one[9], other[10] - one[10], other[11] - one[11]
        square = 0.0
        for i in range(3):
            u, v, w = one[i], one[3 + i], one[6 + i]
            beyond = abs(u * x + v * y + w * z) - half[i]
            for j in range(3):
                beyond -= abs(u * other[j] + v * other[3 + j] + w * other[6 + j]) * others[j]
            if beyond > 0.0:
                square += beyond * beyond
        largest = max(largest, square)
    largest = math.sqrt(largest)
    first, end = all_boxes.trees[both[1]]
    if first < end:
        largest = max(largest, _cloud_separation(work[0], boxes[both[0]].half, all_boxes, first, end))
    # Rounding errors never make it too large.
    gap: float = largest * (1.0 - 1e-12) - (boxes[both[0]].radius + boxes[both[1]].radius) - 1e-12
    return gap if gap > 0.0 else -ANYWHERE


@kernel
def _place_box(frames: FloatArray, boxes: TableArray, number: int, placed: FloatArray) -> None:
    """Write rotation and centre of a box in the frame of the base, (12,)."""
    box = boxes[number]
    frame, rotation, centre = frames[box.joint], box.rotation, box.centre
    for r in range(3):
        x, y, z = frame[3 * r], frame[3 * r + 1], frame[3 * r + 2]
        for c in range(3):
            placed[3 * r + c] = x * rotation[c] + y * rotation[3 + c] + z * rotation[6 + c]
        placed[9 + r] = x * centre[0] + y * centre[1] + z * centre[2] + frame[9 + r]


@kernel
def hull_separation(frames: FloatArray, all_boxes: PairBoxes, pair: int, enough: float, work: FloatArray) -> float:
    """Lower bound of the distance of a hull from a cloud [m]; -`ANYWHERE` unless positive, and for other pairs.

    The hull is compared with the hulls of the leaves of the cloud's tree that are near its box, and with their points.

    Args:
        frames: (dof + 1, 12) frames of joints and base, as `place_joints` writes them.
        all_boxes: The boxes of all pairs.
        pair: Index of the pair.
        enough: The bound is at most this [m].
        work: (2, WORK) buffer for the placed box, and of `core_distance`.
    """
    boxes, nodes, points, body = all_boxes.boxes, all_boxes.nodes, all_boxes.points, all_boxes.sides[pair, 0]
    number, end = all_boxes.trees[all_boxes.sides[pair, 1]]
    if body >= len(all_boxes.spans) or number == end:
        return -ANYWHERE
    span = all_boxes.spans[body, 0], all_boxes.spans[body, 1], all_boxes.spans[body, 2]
    if span[0] == span[1]:
        return -ANYWHERE
    placed, near = work[0], work[1]
    _place_box(frames, boxes, body, placed)
    half, pose, middle = boxes[body].half, pose_of(frames, boxes[body].joint), (placed[9], placed[10], placed[11])
    radii = boxes[body].radius + boxes[all_boxes.sides[pair, 1]].radius
    if radii >= ANYWHERE:
        return -ANYWHERE
    least = enough + radii
    while number < end:
        centre = nodes[number, 3], nodes[number, 4], nodes[number, 5]
        following = int(nodes[number, 2])
        if _from_box(placed, half, centre) - nodes[number, 6] * (1.0 + 1e-12) >= least:
            number = following
            continue
        if following == number + 1:
            first, last = 3 * int(nodes[number, 0]), 3 * int(nodes[number, 1])
            near[NEAREST], near[NEAREST + 1], near[NEAREST + 2] = sub(middle, centre)
            wanted, lot = Wanted(least, least, _ROUGH, 0.0, STILL), (first, last, NO_TABLE)
            if core_distance(all_boxes.corners, span, pose, points, lot, wanted, near) < least:
                plane = plane_of_separation(all_boxes.corners, span, pose, near)
                for p in range(first, last, 3):
                    point = points[p], points[p + 1], points[p + 2]
                    if not is_behind(plane, point, least) and _from_box(placed, half, point) < least:
                        near[NEAREST], near[NEAREST + 1], near[NEAREST + 2] = sub(middle, point)
                        wanted, lot = Wanted(least, -math.inf, _FINE, 0.0, STILL), (p, p + 3, NO_TABLE)
                        least = min(least, core_distance(all_boxes.corners, span, pose, points, lot, wanted, near))
        number += 1
    # Rounding errors never make it too large.
    gap: float = least * (1.0 - 1e-12) - radii - 1e-12
    return gap if gap > 0.0 else -ANYWHERE


@kernel
def _cloud_separation(placed: FloatArray, half: FloatArray, all_boxes: PairBoxes, first: int, end: int) -> float:
    """Lower bound of the distance of a placed box from a cloud's points, in the frame of the base [m].

    Args:
        placed: (12,) rotation and centre of the box.
        half: (3,) its half sizes [m].
        all_boxes: The clouds.
        first: First node of the cloud.
        end: One past its last node.
    """
    nodes, points = all_boxes.nodes, all_boxes.points
    least, unopened, number = math.inf, math.inf, first
    while number < end:
        center = nodes[number, 3], nodes[number, 4], nodes[number, 5]
        bound = _from_box(placed, half, center) - nodes[number, 6] * (1.0 + 1e-12)
        following = int(nodes[number, 2])
        if bound >= _NEARLY * least:
            unopened, number = min(unopened, bound), following
            continue
        if following == number + 1:
            for p in range(int(nodes[number, 0]), int(nodes[number, 1])):
                least = min(least, _from_box(placed, half, (points[3 * p], points[3 * p + 1], points[3 * p + 2])))
        number += 1
    return min(least, unopened)


@inline
def _from_box(placed: FloatArray, half: FloatArray, point: Vector) -> float:
    """Distance of a point from a placed box [m]."""
    x, y, z = point[0] - placed[9], point[1] - placed[10], point[2] - placed[11]
    square = 0.0
    for i in range(3):
        beyond = max(0.0, abs(placed[i] * x + placed[3 + i] * y + placed[6 + i] * z) - half[i])
        square += beyond * beyond
    return math.sqrt(square)
