"""Arrays of a robot's bodies, joints and self-collision pairs, for kernels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.arm_pairs import ArmParts, arm_parts
from hplan.collision.collision_bodies import GROUND, CollisionBody, ball_about, collision_bodies
from hplan.collision.reach import carriers, joint_axis, points_reach
from hplan.collision.touching_pairs import required_distances, self_pairs
from hplan.geometry.convex_distance import corner_table
from hplan.robot.model import Robot, made_once

#: Columns of a body: its joint (`dof` for the ground); offsets of the start and end of its points in the numbers, and
#: of their table (`hplan.geometry.convex_distance`; 0 for none); its rounding radius; centre (3) and radius of a
#: bounding ball; start and vector (3 each) and radius of a bounding capsule; and 1 if it is checked against obstacles,
#: because joints move it and no other body contains it.
JOINT, FIRST, LAST, TABLE, ROUNDING, BALL, BALL_RADIUS, AXIS, AXIS_RADIUS, MEETS = 0, 1, 2, 3, 4, 5, 8, 9, 15, 16

#: Columns of a pair: its bodies, first the one whose motion relative to the other is considered; the distance of their
#: hulls at contact; the distances of the ball centres and of the segments beyond which contact is excluded; and 1, to
#: distinguish it from a body, which has 0.
OUTER, INNER, TOUCHING, BALLS, AXES, IS_PAIR = 0, 1, 2, 3, 4, 17

COLUMNS = 18

#: A body with at most this number of coordinates is exactly its bounding capsule.
THIN = 6

#: Numbers of the head: number of bodies, number of joints, offsets of the joints and of the motion-bound coefficients.
BODIES, DOF, JOINTS, REACHES, HEAD = 0, 1, 2, 3, 4

#: Numbers of a joint with value q: three 3x3 matrices A, B, C by rows, for its rotation A + B cos(q) + C sin(q) in the
#: parent's frame; its position and the direction of its shift by q (3 each); its parent's index (`dof` for the base);
#: and its rotation axis in its own frame (3), zeros for a prismatic joint.
PLACE, SHIFT, PARENT, TURN, JOINT_SIZE = 27, 30, 33, 34, 37


@dataclass(frozen=True, eq=False)
class FlatBodies(Record):
    """Moving bodies of a robot as rows that refer to numbers.

    Attributes:
        movers: (bodies + pairs, COLUMNS) rows: the bodies in the order of `collision_bodies`, then capsules that
            replace cylinders with a ball at either end; for a planar arm the capsules of its links, then the shapes of
            turret and pedestal that they can touch. After the bodies, the checked self-collision pairs.
        numbers: Flat array: the head, the joints, the motion-bound coefficients ((bodies + pairs, dof) by rows), and
            the points of all bodies, each with its table.
    """

    movers: FloatArray
    numbers: FloatArray

    @property
    def reaches(self) -> FloatArray:
        """(bodies + pairs, dof) motion-bound coefficients (`hplan.collision.reach`)."""
        first, dof = int(self.numbers[REACHES]), int(self.numbers[DOF])
        return self.numbers[first : first + len(self.movers) * dof].reshape(-1, dof)

    @classmethod
    def of(cls, robot: Robot, own_clearance: float = 0.0, deviation: float = 0.0) -> FlatBodies:
        """Flatten the bodies of a robot.

        Args:
            robot: The robot.
            own_clearance: Required clearance of the self-collision pairs [m].
            deviation: Maximum deviation of every joint [rad, m]; bodies are grown by their displacement bound.
        """
        if robot.planar is None:
            still = robot.cached("flat bodies", lambda: _of_any_arm(robot))
            farthest = self_pairs(robot).farthest
        else:
            parts = arm_parts(robot, "capsule", deviation, own_clearance, single_joint_pairs=False)
            still = robot.cached(("flat bodies", *parts.key), lambda: _of_parts(parts))
            farthest = np.full(len(parts.own), np.inf)
        kept = np.append(np.zeros(int(still.numbers[BODIES])), required_distances(farthest, own_clearance))
        return cls(frozen(thicker(still.movers, deviation * still.reaches.sum(axis=1) + kept)), still.numbers)


def thicker(movers: FloatArray, by: FloatArray) -> FloatArray:
    """Grow bodies and required distances by (bodies + pairs,) [m]."""
    movers, is_pair = movers.copy(), movers[:, IS_PAIR] > 0.0
    for columns, chosen in (((ROUNDING, BALL_RADIUS, AXIS_RADIUS), ~is_pair), ((TOUCHING, BALLS, AXES), is_pair)):
        for column in columns:
            movers[chosen, column] += by[chosen]
    return movers


def _of_any_arm(robot: Robot) -> FlatBodies:
    """Bodies of a general (non-planar) arm, and its checked pairs."""
    own, pairs = collision_bodies(robot), self_pairs(robot)
    capsules = list(_capsules(own))
    bodies = [*own, *(capsule for capsule, _ in capsules)]
    held = {part for _, parts in capsules for part in parts}
    meets = [body.joint != GROUND and number not in held for number, body in enumerate(bodies)]
    return _flat(robot, bodies, meets, pairs.checked)


def _of_parts(parts: ArmParts) -> FlatBodies:
    """Shapes of a planar arm, and base shapes it can touch."""
    (both, _), links = parts.movers, len(parts.shapes)
    return _flat(parts.robot, parts.bodies, np.arange(len(parts.bodies)) < links, both[links:].tolist())


def _flat(
    robot: Robot, bodies: Sequence[CollisionBody], meets: Sequence[bool] | BoolArray, pairs: Sequence[tuple[int, int]]
) -> FlatBodies:
    """Flatten bodies and pairs.

    `meets` marks the bodies that are checked against obstacles.
    """
    joints, count = joint_numbers(robot), len(bodies)
    alone = np.array([points_reach(robot, body.core, body.joint) for body in bodies]).reshape(-1, robot.dof)
    reaches = np.concatenate([alone, np.zeros((len(pairs), robot.dof))])
    carried = [carriers(robot, body.joint) for body in bodies]
    first = HEAD + joints.size + reaches.size
    head = [count, robot.dof, HEAD, HEAD + joints.size]
    rows, points = np.zeros((len(reaches), COLUMNS)), list[FloatArray]()
    for row, body in enumerate(bodies):
        rows[row, JOINT] = robot.dof if body.joint == GROUND else body.joint
        end = first + body.core.size
        table = corner_table(body.core, first, end)
        rows[row, FIRST], rows[row, LAST], rows[row, TABLE] = first, end, end if len(table) else 0
        points += [body.core.ravel(), table]
        first = end + len(table)
        rows[row, ROUNDING] = body.rounding
        rows[row, BALL:BALL_RADIUS], radius = ball_about(body.core)
        rows[row, BALL_RADIUS] = radius * (1.0 + 1e-12) + body.rounding
        rows[row, AXIS:AXIS_RADIUS], radius = _axis(body.core)
        rows[row, AXIS_RADIUS] = radius * (1.0 + 1e-12) + body.rounding
        rows[row, MEETS] = float(meets[row])
    for row, (i, j) in enumerate(pairs, start=count):
        rows[row, OUTER], rows[row, INNER] = (i, j) if len(carried[i]) > len(carried[j]) else (j, i)
        rows[row, TOUCHING] = bodies[i].rounding + bodies[j].rounding
        rows[row, BALLS] = rows[i, BALL_RADIUS] + rows[j, BALL_RADIUS]
        rows[row, AXES] = rows[i, AXIS_RADIUS] + rows[j, AXIS_RADIUS]
        rows[row, IS_PAIR] = 1.0
        between = sorted(set(carried[i]) ^ set(carried[j]))
        reaches[row, between] = (alone[i] + alone[j])[between]
    return FlatBodies(frozen(rows), frozen(np.concatenate([head, joints.ravel(), reaches.ravel(), *points])))


def _capsules(bodies: Sequence[CollisionBody]) -> Iterator[tuple[CollisionBody, tuple[int, ...]]]:
    """Capsules around a cylinder with a ball at either end.

    URDFs describe capsules in this way. Each capsule comes with the indices of the three bodies that it contains. Only
    the capsule is checked against obstacles, because it is smooth.
    """
    for number, tube in enumerate(bodies):
        if tube.kind != "cylinder" or tube.joint == GROUND:
            continue
        ends = tube.core.reshape(2, -1, 3).mean(axis=1)
        radius = float(np.linalg.norm(tube.core[0] - ends[0])) - tube.growth
        parts, away = [number], 0.0
        for end in ends:
            for other, ball in enumerate(bodies):
                off = float(np.linalg.norm(ball.core[0] - end)) + abs(ball.rounding - radius)
                # Tolerance of centre and radius of a ball at the end of a cylinder [m].
                if ball.kind == "sphere" and ball.joint == tube.joint and off <= 1e-9:
                    parts.append(other)
                    away = max(away, off)
                    break
        if len(parts) == 3:
            yield replace(tube, core=frozen(ends), rounding=radius + away, kind="capsule", growth=0.0), tuple(parts)


@made_once
def joint_numbers(robot: Robot) -> FloatArray:
    """(dof, JOINT_SIZE) numbers of the joints, cached."""
    return frozen(np.array([_of_joint(robot, j) for j in range(robot.dof)]))


@made_once
def joints_alone(robot: Robot) -> FloatArray:
    """Numbers of a robot without bodies: head and joints, cached."""
    return frozen(np.concatenate([[0.0, robot.dof, HEAD, HEAD], joint_numbers(robot).ravel()]))


def _of_joint(robot: Robot, joint: int) -> FloatArray:
    """(JOINT_SIZE,) numbers of a joint."""
    model = robot.model
    axis, slides = joint_axis(robot, joint)
    place = model.jointPlacements[joint + 1]
    numbers = np.zeros(JOINT_SIZE)
    # Rodrigues' formula; the rotation of a prismatic joint is constant.
    along = np.eye(3) if slides else np.outer(axis, axis)
    across = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    numbers[0:9] = (place.rotation @ along).ravel()
    numbers[9:18] = (place.rotation @ (np.eye(3) - along)).ravel()
    numbers[18:27] = np.zeros(9) if slides else (place.rotation @ across).ravel()
    numbers[PLACE:SHIFT] = place.translation
    numbers[SHIFT:PARENT] = place.rotation @ axis if slides else 0.0
    parent = int(model.parents[joint + 1]) - 1
    numbers[PARENT] = robot.dof if parent < 0 else parent
    numbers[TURN:JOINT_SIZE] = 0.0 if slides else axis
    return numbers


def _axis(core: FloatArray) -> tuple[FloatArray, float]:
    """Start, vector and radius of a bounding capsule of some points.

    The segment has the direction of the maximum spread of the points; its ends are moved inward by the radius.
    """
    middle = core.mean(axis=0)
    direction = np.linalg.svd(core - middle, full_matrices=False)[2][0]
    along = (core - middle) @ direction
    aside = core - middle - np.outer(along, direction)
    centre = 0.5 * (aside.min(axis=0) + aside.max(axis=0))
    radius = float(np.linalg.norm(aside - centre, axis=1).max())
    low, high = float(along.min()) + radius, float(along.max()) - radius
    if len(core) <= 2:
        low, high = float(along.min()), float(along.max())
    if low > high:
        low = high = 0.5 * (low + high)
    start = middle + centre + low * direction
    vector = (high - low) * direction
    length = high - low
    at = np.clip((core - start) @ direction, 0.0, length)
    needed = float(np.linalg.norm(core - start - np.outer(at, direction), axis=1).max())
    return np.concatenate([start, vector]), needed
