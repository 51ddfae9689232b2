"""The bodies of a robot, its joints and its own pairs as arrays of numbers, for kernels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.arm_pairs import ArmParts, arm_parts
from hplan.collision.collision_bodies import GROUND, CollisionBody, ball_about, collision_bodies
from hplan.collision.reach import carriers, joint_axis, points_reach
from hplan.collision.touching_pairs import required_distances, self_pairs
from hplan.robot.model import Robot, made_once
from hplan.scene.corner_table import corner_table

#: Columns of a body: its joint (`dof` for the ground), first and last place of its points among the numbers (last is
#: one past) and that of their table (`hplan.scene.corner_table`; 0 for none), its radius, then the centre (3) of a ball
#: that holds it and the ball's radius, a segment (start and vector, 3 each) with a radius that holds it, and 1 where
#: obstacles are to keep clear of it: joints move it, and no other one holds it.
JOINT, FIRST, LAST, TABLE, ROUNDING, BALL, BALL_RADIUS, AXIS, AXIS_RADIUS, MEETS = 0, 1, 2, 3, 4, 5, 8, 9, 15, 16

#: Columns of a pair: its bodies, the one whose motion is seen from the other first, and the distance of their hulls at
#: which they touch; then the distances of the centres of their balls, and of their segments, beyond which they are
#: farther apart than that; and 1, where a body has 0.
OUTER, INNER, TOUCHING, BALLS, AXES, IS_PAIR = 0, 1, 2, 3, 4, 17

COLUMNS = 18

#: A body of so many coordinates at most is its segment, grown by its radius.
THIN = 6

#: Numbers at the head: how many bodies and how many joints there are; where joints, and where reaches begin.
BODIES, DOF, JOINTS, REACHES, HEAD = 0, 1, 2, 3, 4

#: Numbers of a joint: with q its value, it is turned in its parent's frame by the first nine, the next nine by cos(q)
#: and the next by sin(q), row by row; and stands at a place, shifted by q times a direction (3 each); its parent's
#: number (`dof` for the base) follows, and the axis that it turns about in its own frame (3), zeros if it slides.
PLACE, SHIFT, PARENT, TURN, JOINT_SIZE = 27, 30, 33, 34, 37


@dataclass(frozen=True, eq=False)
class FlatBodies(Record):
    """Moving bodies of a robot as rows, and the numbers that they refer to.

    Attributes:
        movers: (bodies + pairs, COLUMNS) each body in the order of `collision_bodies`, then capsules that stand for
            cylinders with a ball at either end; of a planar arm the capsules of its links, then what of turret and
            pedestal they can touch. Then each pair of its own that is checked.
        numbers: Flat: the head, the joints, the reaches ((bodies + pairs, dof), row by row), the points of all bodies,
            each with its table.
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
        """The bodies of a robot.

        Args:
            own_clearance: Clearance that pairs are to keep [m].
            deviation: By how much every joint may be off [rad, m]: bodies are as much thicker as it may displace them.
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
    """Bodies grown, and pairs that are to keep more, by (bodies + pairs,) distances [m]."""
    movers, is_pair = movers.copy(), movers[:, IS_PAIR] > 0.0
    for columns, chosen in (((ROUNDING, BALL_RADIUS, AXIS_RADIUS), ~is_pair), ((TOUCHING, BALLS, AXES), is_pair)):
        for column in columns:
            movers[chosen, column] += by[chosen]
    return movers


def _of_any_arm(robot: Robot) -> FlatBodies:
    """The bodies that a URDF has, where pairs may touch."""
    own, pairs = collision_bodies(robot), self_pairs(robot)
    capsules = list(_capsules(own))
    bodies = [*own, *(capsule for capsule, _ in capsules)]
    held = {part for _, parts in capsules for part in parts}
    meets = [body.joint != GROUND and number not in held for number, body in enumerate(bodies)]
    return _flat(robot, bodies, meets, pairs.checked)


def _of_parts(parts: ArmParts) -> FlatBodies:
    """What of a planar arm meets obstacles, then what of turret and pedestal its links can touch."""
    (both, _), links = parts.movers, len(parts.shapes)
    return _flat(parts.robot, parts.bodies, np.arange(len(parts.bodies)) < links, both[links:].tolist())


def _flat(
    robot: Robot, bodies: Sequence[CollisionBody], meets: Sequence[bool] | BoolArray, pairs: Sequence[tuple[int, int]]
) -> FlatBodies:
    """Bodies, which of them obstacles are to keep clear of, and pairs of them that are not to touch."""
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
    """Capsules that hold a cylinder and a ball of its radius at either end, as URDFs have capsules; and what they hold.

    Obstacles keep clear of such a capsule alone, which is round.
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
                # How far balls may be from the ends of the cylinder that they make a capsule of [m].
                if ball.kind == "sphere" and ball.joint == tube.joint and off <= 1e-9:
                    parts.append(other)
                    away = max(away, off)
                    break
        if len(parts) == 3:
            yield replace(tube, core=frozen(ends), rounding=radius + away, kind="capsule", growth=0.0), tuple(parts)


@made_once
def joint_numbers(robot: Robot) -> FloatArray:
    """(dof, JOINT_SIZE) numbers of the joints; found once."""
    return frozen(np.array([_of_joint(robot, j) for j in range(robot.dof)]))


@made_once
def joints_alone(robot: Robot) -> FloatArray:
    """Numbers of a robot without bodies: the head and the joints."""
    return frozen(np.concatenate([[0.0, robot.dof, HEAD, HEAD], joint_numbers(robot).ravel()]))


def _of_joint(robot: Robot, joint: int) -> FloatArray:
    """(JOINT_SIZE,) numbers of a joint."""
    model = robot.model
    axis, slides = joint_axis(robot, joint)
    place = model.jointPlacements[joint + 1]
    numbers = np.zeros(JOINT_SIZE)
    # Rodrigues' formula; of a joint that slides the rotation stays.
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
    """Start and vector of a segment, and the radius about it that holds some points.

    Along the direction in which the points are spread farthest, pulled in from its ends by the radius.
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
